# SPDX-License-Identifier: Apache-2.0
"""Tables of impacts with a known truth: cubes that are dropped on a plane, and pushes of the scenario ``push``."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pinocchio as pin

from impact_rs_sim.effects import library
from impact_rs_sim.impact_map.measured import (
    MeasuredImpact,
    points_of_scene,
    points_that_touch,
    solve_measured,
)
from impact_rs_sim.physics import ObjectPhysics, Physics
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_sim.scene import ArmState, BodyState, Scene

UP = np.array([0.0, 0.0, 1.0])
SIZE = np.full(3, 0.1)  # m
MASS = 0.4  # kg
ASSUMED_FRICTION = 0.5
NOISE = (0.01, 0.1, 0.005)  # m/s, rad/s, and of joints rad/s


def cube(
    friction: float = ASSUMED_FRICTION, restitution: float = 0.0, com: Sequence[float] = (0.0, 0.0, 0.0)
) -> Physics:
    """A free cube over a plane."""
    item = ObjectPhysics(MASS, SIZE, np.full(3, MASS * 0.01 / 6.0), np.array(com, dtype=float))
    return Physics({}, item, None, (np.inf, np.inf), friction, 0.0, restitution)


def tossed(rng: np.random.Generator) -> MeasuredImpact:
    """A cube in any orientation that comes down in any way."""
    while True:
        turn = pin.Quaternion(*rng.standard_normal(4)).normalized().matrix()
        twist = np.concatenate((rng.uniform(-1.0, 1.0, 2), [-rng.uniform(0.8, 2.0)], rng.normal(0.0, 3.0, 3)))
        body = BodyState(rng.normal(0.0, 0.1, 3), turn, twist)
        impact = MeasuredImpact({}, body, points_that_touch(body, SIZE, UP))
        if impact.closing_speed(cube(), {}) > 0.3:
            return impact


def _twist(tail: str) -> list[str]:
    return [f"v{axis}_{tail} [m/s]" for axis in "xyz"] + [f"w{axis}_{tail} [rad/s]" for axis in "xyz"]


POSE = ["x [m]", "y [m]", "z [m]", "qx [-]", "qy [-]", "qz [-]", "qw [-]"]
CUBE_HEADER = [
    *POSE, *_twist("before"), *_twist("after"), "mass [kg]", "size_x [m]", "size_y [m]", "size_z [m]",
    "friction [-]", "restitution [-]",
]  # fmt: skip


def cube_rows(truth: Physics, count: int, seed: int = 0, noise: bool = True) -> list[list[float]]:
    """Rows of cubes that do what ``truth`` says, and are believed to be ``cube()``."""
    rng = np.random.default_rng(seed)
    rows = []
    for _ in range(count):
        impact = tossed(rng)
        after, _ = solve_measured(truth, impact)
        if noise:
            after = after + np.repeat(NOISE[:2], 3) * rng.standard_normal(6)
        body = impact.object
        quaternion = pin.Quaternion(body.rotation).coeffs()
        rows.append([*body.position, *quaternion, *body.twist, *after, MASS, *SIZE, ASSUMED_FRICTION, 0.0])
    return rows


def arm_table(
    hidden: Mapping[str, Sequence[float]], repeats: int, seed: int = 0
) -> tuple[list[str], list[list[object]]]:
    """Header and rows of impacts of the arm, two objects in every case, with hidden effects."""
    rng = np.random.default_rng(seed)
    setting = load_scenario("push")
    name = next(iter(setting.robots))
    count = setting.robots[name].robot_facts.joint_count
    header = ["object", "condition", *(f"q{joint + 1} [rad]" for joint in range(count))]
    header += [f"dq{joint + 1}_{tail} [rad/s]" for tail in ("before", "after") for joint in range(count)]
    header += [*POSE, *_twist("before"), *_twist("after")]
    rows: list[list[object]] = []
    for item in list(setting.objects)[:2]:
        for case in setting.cases:
            scene = Scene.resolve(setting, item, case)
            truth = scene.physics
            for effect, values in hidden.items():
                truth = library()[effect].apply_vector(truth, np.array(values))
            for _ in range(repeats):
                state = scene.arms[name]
                speed = state.velocity * rng.uniform(0.7, 1.3) + rng.normal(0.0, 0.02, count)
                arms = {name: ArmState(state.position + rng.normal(0.0, 0.002, count), speed)}
                place = scene.object.position + rng.normal(0.0, (0.02, 0.001, 0.0003))
                turn = scene.object.rotation @ pin.utils.rotate("z", rng.normal(0.0, 0.01))
                body = BodyState(place, turn, np.zeros(6))
                points = points_of_scene(scene.physics, arms, body, scene.models)
                after, _ = solve_measured(truth, MeasuredImpact(arms, body, points))
                after = after + rng.standard_normal(count + 6) * np.repeat((NOISE[2], 0.005, 0.02), (count, 3, 3))
                joints = [*arms[name].position, *speed, *after[:count]]
                rows.append([item, case, *joints, *place, *pin.Quaternion(turn).coeffs(), *body.twist, *after[count:]])
    return header, rows


def write_csv(path: Path, header: Sequence[str], rows: Sequence[Sequence[object]]) -> Path:
    """Write a table."""
    with path.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([header, *rows])
    return path
