# SPDX-License-Identifier: Apache-2.0
"""Run a trial in-process and record what the nodes would record."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from impact_rs_control.closed_loop import RobotCell, Tick, make_plant, run_closed_loop, without_garbage_collection
from impact_rs_control.plan import TrialPlan
from impact_rs_sim.physics import Physics
from impact_rs_sim.plant import Measurement, PlantExtension, Truth
from impact_rs_sim.robot import Array
from impact_rs_sim.scene import Scene
from impact_rs_sim.urdf import WORLD, write_description, write_object_description
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.messages import TF_PERIOD, Frame, MessageMaker, RosbagsTypes
from impact_rs_trials.bags.outcome import Verdict, Witness, judge
from impact_rs_trials.bags.trial_info import TrialInfo
from impact_rs_trials.bags.writer import BagWriter


def descriptions(plan: TrialPlan) -> dict[str, str]:
    """URDFs by topic: the arms beside the support, every arm alone, and the object."""
    physics, thing = plan.scene.physics, plan.scene.physics.object
    arms = {name: (arm.facts, arm.end_effector, arm.base) for name, arm in physics.arms.items()}
    return {
        topics.ROBOT_DESCRIPTION: physics.description(),
        **{topics.robot_description(name): write_description({name: arm}, None) for name, arm in arms.items()},
        topics.OBJECT_DESCRIPTION: write_object_description(
            thing.size, thing.mass, thing.com_offset, np.diag(thing.inertia)
        ),
    }


class FrameSource:
    """Frames for ``/tf``, from measurements alone: the links of every arm one after the other, object and support.

    Args:
        scene: The scene.
        prefix: Prefix of every frame, ``cell_a/``, where other graphs are on the same ``/tf``; its ``world`` then is
            a child of the ``world`` of all, at the same place.
    """

    def __init__(self, scene: Scene, prefix: str = "") -> None:
        self._models = scene.models
        self._prefix = prefix
        self._supported = scene.physics.support_height is not None
        self._every = max(1, round(TF_PERIOD / scene.scenario.timing.control_period))
        self._object = pin.SE3(scene.object.rotation, scene.object.position)

    def due(self, tick: int) -> bool:
        """Whether transforms are published in this tick."""
        return tick % self._every == 0

    def frames(self, measurement: Measurement) -> list[Frame]:
        """Every frame at a measurement."""
        seen = measurement.object
        return self.at(
            {name: arm.position for name, arm in measurement.arms.items()},
            None if seen is None else (seen.position, seen.quaternion),
        )

    def at(self, arms: dict[str, Array], seen: tuple[Array, Array] | None) -> list[Frame]:
        """The same from joint positions by arm, and position and quaternion of the object where it was seen."""
        frames = [Frame(WORLD, "support", pin.SE3.Identity())] if self._supported else []
        for name, model in self._models.items():
            parent, before = WORLD, pin.SE3.Identity()
            for link, placement in model.link_placements(arms[name]).items():
                child = f"{name}_{link}"
                frames.append(Frame(parent, child, before.actInv(placement)))
                parent, before = child, placement
        if seen is not None:
            position, quaternion = seen
            self._object = pin.SE3(pin.Quaternion(quaternion).matrix(), position)
        frames.append(Frame(WORLD, "object", self._object))
        if not self._prefix:
            return frames
        named = [Frame(self._prefix + one.parent, self._prefix + one.name, one.placement) for one in frames]
        return [Frame(WORLD, self._prefix + WORLD, pin.SE3.Identity()), *named]


def plant_messages(
    maker: MessageMaker, tick: int, measurement: Measurement, truth: Truth | None, frames: FrameSource
) -> Iterator[tuple[str, Any]]:
    """What the plant publishes in one tick: measurements first, they are awaited; no truth where nobody knows it."""
    for arm, measured in measurement.arms.items():
        yield topics.joint_states(arm), maker.joint_states(tick, arm, measured)
    for arm, measured in measurement.arms.items():
        yield topics.motor_states(arm), maker.motor_states(tick, arm, measured)
    for arm, state in () if truth is None else truth.arms.items():
        yield topics.truth_joint_states(arm), maker.joint_states(tick, arm, state)
        yield topics.truth_contact_wrench(arm), maker.truth_contact_wrench(tick, state)
    yield from occasional_messages(maker, tick, measurement, truth, frames)


def occasional_messages(
    maker: MessageMaker, tick: int, measurement: Measurement, truth: Truth | None, frames: FrameSource
) -> Iterator[tuple[str, Any]]:
    """What the plant does not publish in every tick."""
    if measurement.object is not None:
        yield topics.OBJECT_POSE, maker.object_pose(tick, measurement.object)
    if truth is not None and truth.object is not None:
        yield topics.TRUTH_OBJECT_POSE, maker.truth_object_pose(tick, truth.object)
        yield topics.TRUTH_OBJECT_TWIST, maker.truth_object_twist(tick, truth.object)
    if frames.due(tick):
        yield topics.TF, maker.transforms(tick, frames.frames(measurement))
        yield topics.CLOCK, maker.clock(tick)


def controller_messages(maker: MessageMaker, tick: int, commands: dict[str, Any]) -> Iterator[tuple[str, Any]]:
    """What the controller publishes in one tick: torques first, they are awaited."""
    for arm, command in commands.items():
        yield topics.joint_command(arm), maker.joint_command(tick, arm, command.torque)
    for arm, command in commands.items():
        yield topics.controller_state(arm), maker.controller_state(tick, arm, command)
        if command.detection is not None:
            yield topics.impact_event(arm), maker.impact_event(tick, arm, command.detection)


def record_trial(
    plan: TrialPlan,
    info: TrialInfo,
    path: Path,
    physics: Physics | None = None,
    extension: PlantExtension | None = None,
) -> tuple[Verdict, dict[str, Array]]:
    """Run one trial in lockstep and write its bag.

    Args:
        plan: What to do.
        info: Identity; its seed makes the scatter and the noise.
        path: Folder of the bag.
        physics: True physics of the plant; None: the scenario's.
        extension: What the plant does beyond its physics.

    Returns:
        How it ended, and net feedback ``(3,)`` [m/s] by arm.

    Raises:
        InputError: The bag exists or cannot be written.
    """
    plant = make_plant(plan, info.seed, physics, extension)
    return record_cell(plan, info, path, plant, plant.truth)


def record_cell(
    plan: TrialPlan, info: TrialInfo, path: Path, cell: RobotCell, truth: Callable[[], Truth] | None = None
) -> tuple[Verdict, dict[str, Array]]:
    """Run one trial in lockstep on whatever robot cell, and write its bag; closes the cell.

    Args:
        plan: What to do.
        info: Identity of the trial.
        path: Folder of the bag.
        cell: The robot cell, at the start of the trial.
        truth: Tells its true state at the present tick; None: nobody knows, and the bag has no topics below ``/truth``.

    Returns:
        How it ended, and net feedback ``(3,)`` [m/s] by arm.

    Raises:
        InputError: The bag exists or cannot be written.
    """
    try:
        maker, frames = MessageMaker(RosbagsTypes(), plan), FrameSource(plan.scene)
        with without_garbage_collection(), BagWriter.create(path, list(plan.arms), truth is not None) as bag:
            bag.describe(info)
            bag.write(topics.TRIAL_INFO, 0, maker.trial_info(info))
            for topic, urdf in descriptions(plan).items():
                bag.write(topic, 0, maker.robot_description(urdf))
            witness = Witness(plan)
            tick: Tick
            for tick in run_closed_loop(plan, cell):
                now = maker.nanoseconds(tick.number)
                told = None if truth is None else truth()
                for topic, message in plant_messages(maker, tick.number, tick.measurement, told, frames):
                    bag.write(topic, now, message)
                for topic, message in controller_messages(maker, tick.number, tick.commands):
                    bag.write(topic, now, message)
                witness.see(tick)
            verdict = judge(plan, witness.record())
            bag.finish(verdict.outcome, verdict.reason)
            return verdict, {arm: command.net_feedback for arm, command in tick.commands.items()}
    finally:
        cell.close()
