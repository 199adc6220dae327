# SPDX-License-Identifier: Apache-2.0
"""Run a trial in-process and record the same topics as the nodes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from impact_rs_control.closed_loop import RobotCell, Tick, make_plant, run_closed_loop, without_garbage_collection
from impact_rs_control.plan import TrialPlan
from impact_rs_sim.physics import Physics
from impact_rs_sim.plant.plant import Measurement, PlantExtension, Truth
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.robots.urdf import WORLD, write_description, write_object_description
from impact_rs_sim.scene import Scene, standing
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.messages import TF_PERIOD_S, Frame, MessageMaker, RosbagsTypes
from impact_rs_trials.bags.outcome import TickLog, Verdict, judge
from impact_rs_trials.bags.streams import Stream, StreamMaker
from impact_rs_trials.bags.trial_info import TrialInfo
from impact_rs_trials.bags.writer import BagWriter

FIXED_TOLERANCE = 1e-9  # [-], m; a placement that changes by less does not depend on the joint positions


def descriptions(physics: Physics) -> dict[str, str]:
    """URDFs by topic: all arms with the support, every arm alone, the object, and its neighbours."""
    arms = {name: (arm.facts, arm.end_effector, arm.base) for name, arm in physics.arms.items()}
    return {
        topics.ROBOT_DESCRIPTION: physics.description(),
        **{topics.robot_description(name): write_description({name: arm}, None) for name, arm in arms.items()},
        **{
            topics.robot_description(name): write_object_description(
                body.size, (body.mass, body.com_offset, np.diag(body.inertia)), body.shape, name
            )
            for name, body in physics.bodies.items()
        },
    }


class FrameSource:
    """Frames for ``/tf`` and ``/tf_static`` from measurements: links in chains, object and support.

    Args:
        scene: The scene.
        prefix: Prefix of every frame, ``cell_a/``, if several graphs share ``/tf``; the prefixed ``world`` then is
            a child of the common ``world``, at the same pose.
        links: Whether frames of links are included; if not, robot_state_publisher publishes them.

    Attributes:
        static: Frames that never move in their parent: support, bases, pads, frames fixed to a link.
    """

    def __init__(self, scene: Scene, prefix: str = "", links: bool = True) -> None:
        self._models = scene.models
        self._pads = {name: arm.end_effector.pad_placement for name, arm in scene.physics.arms.items()}
        self._links = links
        self._prefix = prefix
        self._supported = scene.physics.support_height is not None
        self._every = max(1, round(TF_PERIOD_S / scene.scenario.timing.control_period))
        bodies = dict(zip(scene.physics.bodies, (scene.object, *standing(scene.physics, scene.object)), strict=True))
        self._bodies = {name: pin.SE3(body.rotation, body.position) for name, body in bodies.items()}
        self._fixed: set[str] = set()
        frames_at_zero, frames_at_one = (
            self._named({name: np.full(model.joint_count, q) for name, model in self._models.items()})
            for q in (0.0, 1.0)
        )
        self.static = [
            frame
            for frame, moved_frame in zip(frames_at_zero, frames_at_one, strict=True)
            if frame.placement.isApprox(moved_frame.placement, FIXED_TOLERANCE)
        ]
        self._fixed = {frame.name for frame in self.static}

    def due(self, tick: int) -> bool:
        """Whether transforms are published in this tick."""
        return tick % self._every == 0

    def frames(self, measurement: Measurement) -> list[Frame]:
        """Every frame that moves, at a measurement."""
        tracked = {"object": measurement.object} if measurement.object is not None else {}
        return self.at(
            {name: arm.position for name, arm in measurement.arms.items()},
            {name: (pose.position, pose.quaternion) for name, pose in (tracked | measurement.neighbours).items()},
        )

    def at(self, arms: dict[str, Array], poses: Mapping[str, tuple[Array, Array]]) -> list[Frame]:
        """Like :meth:`frames`, from joint positions by arm, and position and quaternion of the tracked objects."""
        for name, (position, quaternion) in poses.items():
            self._bodies[name] = pin.SE3(pin.Quaternion(quaternion).matrix(), position)
        bodies = [
            Frame(self._prefix + WORLD, self._prefix + name, placement) for name, placement in self._bodies.items()
        ]
        return [*(frame for frame in self._named(arms) if frame.name not in self._fixed), *bodies]

    def _named(self, arms: dict[str, Array]) -> list[Frame]:
        """Every frame except object and neighbours, with its prefix."""
        frames = [Frame(WORLD, "support", pin.SE3.Identity())] if self._supported else []
        for name, model in self._models.items():
            parent, parent_placement = WORLD, pin.SE3.Identity()
            for link, placement in model.link_placements(arms[name]).items() if self._links else ():
                child = f"{name}_{link}"
                frames.append(Frame(parent, child, parent_placement.actInv(placement)))
                parent, parent_placement = child, placement
            frames.append(Frame(f"{name}_end_effector", f"{name}_pad", self._pads[name]))
        if not self._prefix:
            return frames
        prefixed = [Frame(self._prefix + frame.parent, self._prefix + frame.name, frame.placement) for frame in frames]
        return [Frame(WORLD, self._prefix + WORLD, pin.SE3.Identity()), *prefixed]


def occasional_messages(
    maker: MessageMaker, tick: int, measurement: Measurement, truth: Truth | None, frames: FrameSource
) -> Iterator[tuple[str, Any]]:
    """Messages of the plant that are not published in every tick, with their topics."""
    if measurement.object is not None:
        yield topics.OBJECT_POSE, maker.object_pose(tick, measurement.object)
    for name, measured in measurement.neighbours.items():
        yield topics.pose(name), maker.object_pose(tick, measured)
    if truth is not None and truth.object is not None:
        for name, state in {"object": truth.object, **truth.neighbours}.items():
            yield topics.truth_pose(name), maker.truth_object_pose(tick, state)
            yield topics.truth_twist(name), maker.truth_object_twist(tick, state)
    if frames.due(tick):
        yield topics.TF, maker.transforms(tick, frames.frames(measurement))
        yield topics.CLOCK, maker.clock(tick)


def add_tick(streams: Mapping[str, Stream], tick: Tick, truth: Truth | None) -> None:
    """Add the signals of a tick to the streams of plant and controller; topics below ``/truth`` need ``truth``."""
    for arm, measured in tick.measurement.arms.items():
        streams[topics.joint_states(arm)].add(tick.number, measured)
        streams[topics.motor_states(arm)].add(tick.number, measured)
    for arm, state in () if truth is None else truth.arms.items():
        streams[topics.truth_joint_states(arm)].add(tick.number, state)
        streams[topics.truth_contact_wrench(arm)].add(tick.number, state)
    for arm, command in tick.commands.items():
        streams[topics.joint_command(arm)].add(tick.number, command)
        streams[topics.controller_state(arm)].add(tick.number, command)


def record_trial(
    plan: TrialPlan,
    info: TrialInfo,
    path: Path,
    physics: Physics | None = None,
    extension: PlantExtension | None = None,
) -> tuple[Verdict, dict[str, Array]]:
    """Run one trial in lockstep and write its bag.

    Args:
        plan: The trial.
        info: Identity of the trial; its seed determines scatter and noise, and it says which simulator moves the plant.
        path: Folder of the bag.
        physics: True physics of the plant; None: the scenario's.
        extension: Effects of the plant beyond its physics.

    Returns:
        How it ended, and net feedback ``(3,)`` [m/s] by arm.

    Raises:
        InputError: The bag exists or cannot be written.
    """
    plant = make_plant(plan, info.seed, physics, extension, info.simulator)
    return record_cell(plan, info, path, plant, plant.truth)


def record_cell(
    plan: TrialPlan, info: TrialInfo, path: Path, cell: RobotCell, truth: Callable[[], Truth] | None = None
) -> tuple[Verdict, dict[str, Array]]:
    """Run one trial in lockstep on any robot cell, and write its bag; closes the cell.

    Args:
        plan: The trial.
        info: Identity of the trial.
        path: Folder of the bag.
        cell: The robot cell, at the start of the trial.
        truth: Returns the true state at the present tick; None: it is unknown, and the bag has no topics below
            ``/truth``.

    Returns:
        How it ended, and net feedback ``(3,)`` [m/s] by arm.

    Raises:
        InputError: The bag exists or cannot be written.
    """
    try:
        maker, frames = MessageMaker(RosbagsTypes(), plan), FrameSource(plan.scene)
        neighbours = [neighbour.name for neighbour in plan.scene.physics.neighbours]
        arms, has_truth = list(plan.arms), truth is not None
        with without_garbage_collection(), BagWriter.create(path, arms, has_truth, neighbours=neighbours) as bag:
            bag.describe(info)
            bag.write(topics.TRIAL_INFO, 0, maker.trial_info(info))
            for topic, urdf in descriptions(plan.scene.physics).items():
                bag.write(topic, 0, maker.robot_description(urdf))
            bag.write(topics.TF_STATIC, 0, maker.transforms(0, frames.static))
            ticks, stream_maker = TickLog(plan), StreamMaker(plan)
            streams = {**stream_maker.of_plant(), **stream_maker.of_controller()}
            tick: Tick
            try:
                for tick in run_closed_loop(plan, cell):
                    now = maker.nanoseconds(tick.number)
                    state = None if truth is None else truth()
                    add_tick(streams, tick, state)
                    for topic, message in occasional_messages(maker, tick.number, tick.measurement, state, frames):
                        bag.write(topic, now, message)
                    for arm, command in tick.commands.items():
                        if command.detection is not None:
                            bag.write(
                                topics.impact_event(arm), now, maker.impact_event(tick.number, arm, command.detection)
                            )
                    ticks.append(tick)
            finally:  # an interrupted trial is readable up to its end
                for topic, stream in streams.items():
                    bag.write_rows(topic, *stream.take())
            verdict = judge(plan, ticks.record())
            bag.finish(verdict.outcome, verdict.reason)
            return verdict, {arm: command.net_feedback for arm, command in tick.commands.items()}
    finally:
        cell.close()
