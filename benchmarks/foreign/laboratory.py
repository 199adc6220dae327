# SPDX-License-Identifier: Apache-2.0
"""Campaigns of a laboratory that is not ours.

What a researcher elsewhere would bring: the MuJoCo cell under a Cartesian impedance controller that knows nothing of
impacts, two boxes pushed from two poses, one of them askew, and free motion, recorded with the names, topics and clocks
of :mod:`examples.laboratory`, and an ``experiment.yaml``. The truth lies beside it.
"""

from __future__ import annotations

import functools
import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
from mujoco_cell import Further, Modification, MujocoCell
from rosbags.rosbag2 import StoragePlugin, Writer

from benchmarks.foreign.campaign import OUTSIDE
from benchmarks.foreign.laws import LAWS, Law
from benchmarks.hidden import Entry
from examples.laboratory import EXPERIMENT, START, STORE, messages
from impact_rs_sim.physics import Physics
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_sim.scenarios.scenario import Scenario
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_sim.scene import BodyState, Scene
from impact_rs_trials.blind import RUNS, TRUTH, Hidden, draw_truth, hide, named_values
from impact_rs_trials.workers import Map
from tools.discrepancy import oblique

BOXES = ("parcel", "juice")
CONDITIONS = {"pose_a_fast": ("case_1", 1.0), "pose_a_slow": ("case_1", 0.6), "pose_b_fast": ("case_2", 1.0)}
ASKEW = {"case_1": ((0.0, 0.0), (0.0, 0.0)), "case_2": ((0.02, -0.03), (0.1, 0.05))}  # rad; share of the speed
RUN_UP, RAMP, AFTER = 0.2, 0.5, 0.5  # m, s, s
STIFFNESS = np.array([400.0] * 3 + [25.0] * 3)  # N/m, N m/rad
DAMPING = np.array([50.0] * 3 + [2.5] * 3)  # N s/m, N m s/rad
FREE = {"slow": 0.12, "fast": 0.3}  # Hz
AMPLITUDE, FREE_TIME = 0.3, 4.0  # rad, s
JOINT_STIFFNESS, JOINT_DAMPING = 60.0, 6.0  # N m/rad, N m s/rad

Controller = Callable[[float, Array, Array], Array]


@dataclass(frozen=True)
class Hit:
    """Scene of a push at the moment of impact, and how fast it is meant to be [-]."""

    scene: Scene
    speed: float


def hit_of(name: str, condition: str) -> Hit:
    """The push of an object in a condition."""
    case, speed = CONDITIONS[condition]
    return Hit(Scene.resolve(oblique(load_scenario("push"), case, *ASKEW[case]), name, case), speed)


def impedance(hit: Hit) -> tuple[Controller, Array, float]:
    """A spring towards a point that passes the box; joint position at its start, ``(n,)`` [rad], and duration [s]."""
    ((name, model),) = hit.scene.models.items()
    at_impact = hit.scene.arms[name]
    goal = model.placement(at_impact.position)
    velocity = hit.speed * (model.jacobian(at_impact.position) @ at_impact.velocity)[:3]
    direction = velocity / np.linalg.norm(velocity)
    first = pin.SE3(goal.rotation, goal.translation - RUN_UP * direction)
    start = model.inverse_kinematics(first, {0: float(at_impact.position[0])}, at_impact.position)
    speed = float(np.linalg.norm(velocity))

    def reference(now: float) -> tuple[Array, Array]:
        share = min(now / RAMP, 1.0)
        distance = speed * (RAMP * (share**3 - share**4 / 2.0) + max(now - RAMP, 0.0))
        return first.translation + distance * direction, speed * (3.0 * share**2 - 2.0 * share**3) * direction

    def torque(now: float, q: Array, dq: Array) -> Array:
        position, rate = reference(now)
        jacobian, present = model.jacobian(q), model.placement(q)
        pose_error = np.concatenate(
            (position - present.translation, present.rotation @ pin.log3(present.rotation.T @ goal.rotation))
        )
        force = STIFFNESS * pose_error + DAMPING * (np.concatenate((rate, np.zeros(3))) - jacobian @ dq)
        free = np.eye(q.size) - np.linalg.pinv(jacobian) @ jacobian
        return np.asarray(jacobian.T @ force + model.terms(q, dq).bias + free @ (10.0 * (start - q) - 2.0 * dq))

    return torque, start, RAMP / 2.0 + RUN_UP / speed + AFTER


def excursion(model: RobotModel, middle: Array, rate: float) -> Controller:
    """Joints that swing about a posture, each at a rate of its own."""
    rates = 2.0 * np.pi * rate * (1.0 + 0.15 * np.arange(middle.size))

    def torque(now: float, q: Array, dq: Array) -> Array:
        ramp = min(now / 0.5, 1.0)
        position = middle + ramp * AMPLITUDE * np.sin(rates * now)
        speed = ramp * AMPLITUDE * rates * np.cos(rates * now)
        return np.asarray(JOINT_STIFFNESS * (position - q) + JOINT_DAMPING * (speed - dq) + model.terms(q, dq).bias)

    return torque


def lasting(scenario: Scenario, duration: float) -> Scenario:
    """A scenario whose trials last so long [s]."""
    timing = scenario.timing.model_copy(update={"duration": duration})
    return scenario.model_copy(update={"timing": timing})


@dataclass(frozen=True)
class RunTask:
    """One run of a campaign; everything a worker needs."""

    path: str
    object: str
    condition: str
    seed: int
    entry: Entry


@functools.lru_cache
def hidden_in(entry: Entry) -> list[Hidden]:
    """What an entry hides, as it can be in every box of the campaign."""
    worlds = [hit_of(name, condition).scene.physics for name in BOXES for condition in CONDITIONS]
    return draw_truth(entry.seed, entry.kind, entry.effect, entry.magnitude, worlds=worlds)


def record(task: RunTask) -> None:
    """Run the cell with what an entry hides, and write its bag; a finished one stands."""
    path = Path(task.path)
    if (path / "metadata.yaml").exists():
        return
    entry = task.entry
    modify = further = None
    if entry.effect in LAWS:
        law, magnitude = LAWS[entry.effect], entry.magnitude or 0.0
        further = functools.partial(_pushed, law, magnitude)
    elif entry.kind == "outside":
        modify = functools.partial(OUTSIDE[str(entry.effect)], magnitude=entry.magnitude or 0.0)
    record_run(path, task.object, task.condition, task.seed, hidden_in(entry), modify, further)


def _pushed(law: Law, magnitude: float, model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """A law as the cell calls it."""
    law(model, data, magnitude)


def record_run(
    path: Path,
    object_name: str,
    condition: str,
    seed: int,
    hidden: list[Hidden],
    modify: Callable[[Physics], Modification] | None = None,
    further: Further | None = None,
) -> None:
    """Run the cell under the laboratory's controller, and write its bag.

    Args:
        path: New folder of the bag.
        object_name: Object; ``none``: free motion.
        condition: Of ``CONDITIONS``, or of ``FREE``.
        seed: Of scatter and noise.
        hidden: Effects that its physics have.
        modify: Makes what physics cannot say.
        further: Adds forces before every step.
    """
    if object_name == "none":
        scene = Scene.resolve(load_scenario("push"), "juice", "case_1")
        ((name, model),) = scene.models.items()
        start = scene.arms[name].position
        torque, duration = excursion(model, start, FREE[condition]), FREE_TIME
        body = BodyState(scene.object.position + [5.0, 5.0, 0.0], np.eye(3), np.zeros(6))
    else:
        hit = hit_of(object_name, condition)
        scene, body = hit.scene, hit.scene.object
        (name,) = scene.models
        torque, start, duration = impedance(hit)
    physics = hide(scene.physics, hidden)
    built = None if modify is None else modify(physics)
    cell = MujocoCell(
        lasting(scene.scenario, duration), physics, {name: start}, body, seed, modify=built, further=further
    )
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        topics: dict[str, Any] = {}
        for number in range(round(duration / 0.001)):
            measured = cell.measure()
            arm = measured.arms[name]
            command = torque(measured.time, arm.position, arm.velocity)
            shown = measured if object_name != "none" else SimpleNamespace(arms=measured.arms, object=None)
            tick = SimpleNamespace(number=number, measurement=shown, commands={"arm": SimpleNamespace(torque=command)})
            for topic, late, message in messages(tick):  # type: ignore[arg-type]
                if topic not in topics:
                    topics[topic] = bag.add_connection(topic, message.__msgtype__, typestore=STORE)  # type: ignore[attr-defined]
                log = START * 10**9 + number * 1_000_000 + late
                bag.write(topics[topic], log, STORE.serialize_cdr(message, message.__msgtype__))  # type: ignore[attr-defined]
            cell.step({name: command})


def rows(entry: Entry, folder: Path, repeats: int = 2) -> Iterator[tuple[RunTask, str]]:
    """Every run, with its row in the table."""
    kinds = [(object_name, condition) for object_name in BOXES for condition in CONDITIONS]
    kinds += [("none", condition) for condition in FREE]
    for number, (object_name, condition) in enumerate([kind for kind in kinds for _ in range(repeats)], start=1):
        name = f"run_{number:02d}"
        kind = "free motion" if object_name == "none" else "hit"
        yield (
            RunTask(str(folder / name), object_name, condition, 100 * entry.seed + number, entry),
            f"{name},{object_name},{kind},{condition}",
        )


def make(entry: Entry, directory: Path, map_tasks: Map) -> None:
    """Record a campaign, or what is missing of it, with its truth beside it."""
    folder = directory / RUNS
    folder.mkdir(parents=True, exist_ok=True)
    planned = list(rows(entry, folder))
    for _ in map_tasks(record, [task for task, _ in planned]):
        pass
    (folder / "runs.csv").write_text("\n".join(["bag,object,kind,condition", *(row for _, row in planned)]) + "\n")
    (folder / "experiment.yaml").write_text(EXPERIMENT)
    (robot,) = load_scenario("push").robots.values()
    joints = robot.robot_facts.joint_types
    effects = [{"name": item.name, "parameters": named_values(item, joints)} for item in hidden_in(entry)]
    outside = entry.effect if entry.kind == "outside" else None
    (directory / TRUTH).write_text(json.dumps({"kind": entry.kind, "outside": outside, "effects": effects}) + "\n")
