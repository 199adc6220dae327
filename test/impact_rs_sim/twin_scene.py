# SPDX-License-Identifier: Apache-2.0
"""A mass on a rail with a pad that hits a box: scenes of the twin with closed forms."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin

from impact_rs_sim.drive import DriveStart
from impact_rs_sim.physics import ArmPhysics, JointFriction, ObjectPhysics, Physics
from impact_rs_sim.robots.robot import Array, EndEffector, RobotFacts
from impact_rs_sim.scene import ArmState, BodyState
from impact_rs_sim.twin import Result, TwinJob, simulate

PERIOD = 0.00025  # s
RAIL_MASS, BOX_MASS = 4.0, 1.0  # kg
SIZE = np.array([0.2, 0.16, 0.16])  # m, of the box
PAD = (0.1, 0.1, 0.02)  # m
TOWARDS_Y = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])  # axes of the rail: its z is y of A
AGAINST_Y = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


def rail(start: Array, axes: Array, mass: float = RAIL_MASS, **pad: Any) -> ArmPhysics:
    """A mass that slides along the z of ``axes`` from ``start`` [m], where the face of its pad is at q = 0."""
    facts = RobotFacts.model_validate(
        {
            "source": "by hand",
            "joints": [{"type": "prismatic", "xyz": (0, 0, 0), "rpy": (0, 0, 0)}],
            "flange": {"xyz": (0, 0, 0)},
            "limits": {"position_min_rad": [-9], "position_max_rad": [9], "velocity_rad_s": [9], "torque_Nm": [9]},
            "links": [{"mass": mass - 0.1, "com": (0, 0, 0), "inertia": (0.01, 0, 0, 0.01, 0, 0.01)}],
        }
    )
    body = EndEffector(0.1, np.zeros(3), 1e-4 * np.eye(3), 0.0, 0.0, PAD, pad.pop("tilt", (0.0, 0.0)))
    one, zero = np.ones(1), np.zeros(1)
    values: dict[str, Any] = {"pad_stiffness": 2e5, "pad_damping": 0.0} | pad
    return ArmPhysics(
        facts=facts,
        base=pin.SE3(axes, start),
        end_effector=body,
        motor_inertia_rotor=one,
        motor_inertia_reduced=one,
        stiffness=1e4 * one,
        damping=zero,
        friction=JointFriction.none(1),
        torque_offset=zero,
        torque_gain=one,
        actuation_delay=0.0,
        impact_position=np.zeros(3),
        **values,
    )


def scene(arms: dict[str, ArmPhysics], **changes: Any) -> Physics:
    """Rails and a box, without gravity and support unless ``changes`` say otherwise."""
    inertia = BOX_MASS / 12.0 * (np.sum(np.square(SIZE)) - np.square(SIZE))
    values: dict[str, Any] = {
        "arms": arms,
        "object": ObjectPhysics(BOX_MASS, SIZE, inertia, np.zeros(3)),
        "support_height": None,
        "support_size": (2.0, 2.0),
        "support_friction": 0.3,
        "pad_friction": 0.0,
        "restitution": 0.0,
        "gravity": np.zeros(3),
    }
    return Physics(**(values | changes))


def resting(**changes: Any) -> BodyState:
    """The box at the origin, at rest, and level."""
    return replace(BodyState(np.zeros(3), np.eye(3), np.zeros(6)), **changes)


def run(
    physics: Physics,
    speeds: Sequence[float],
    box: BodyState,
    duration: float,
    force: float = 0.0,
    refinement: int = 1,
    period: float = PERIOD,
) -> Result:
    """Rails that start at q = 0 with these speeds [m/s], under a constant force [N]."""
    ticks = round(duration / period)
    still = np.full(1, force)
    job = TwinJob(
        physics,
        {name: ArmState(np.zeros(1), np.full(1, speed)) for name, speed in zip(physics.arms, speeds, strict=True)},
        dict.fromkeys(physics.arms, DriveStart(still, np.zeros(1))),
        dict.fromkeys(physics.arms, still[None]),
        dict.fromkeys(physics.arms, np.zeros(ticks, dtype=np.int32)),
        np.arange(ticks + 1) * period,
        period,
        object=box,
        joint_torque=True,
        refinement=refinement,
    )
    (result,) = simulate([job])
    assert not result.failed and not result.failure and result.residual < 1e-9
    return result
