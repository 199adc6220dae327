# SPDX-License-Identifier: Apache-2.0
"""One-joint arms whose motion can be written down, and a plant that runs them.

Link 1 and the end effector lie along +x of the link: centres of mass at ``LINK_COM`` and at E, which is ``REACH`` away
from the axis. The axis points up (``UP``: a turntable that no weight moves, and whose pad lies like a tray) or along +y
(``ACROSS``: a pendulum). So

    M = I_link + m_link l^2 + I_E + m_E L^2,      (M + B) ddq = tau + ...,      p = M dq + B dtheta,   dp/dt = tau + ...

where the momentum p knows nothing of the flexible transmission between them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from impact_rs_sim.effects import Effect, library
from impact_rs_sim.physics import ArmPhysics, JointFriction, ObjectPhysics, Physics
from impact_rs_sim.plant.plant import Plant
from impact_rs_sim.robots.robot import Array, EndEffector, RobotFacts
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_sim.scene import BodyState

UP = (0.0, 0.0, 0.0)  # roll, pitch, yaw of the joint in the base [rad]
ACROSS = (-np.pi / 2.0, 0.0, 0.0)
GRAVITY = 9.81  # m/s^2
LINK_MASS, LINK_COM, LINK_INERTIA = 2.0, 0.2, 0.02  # kg, m, kg m^2
TOOL_MASS, REACH, TOOL_INERTIA = 0.5, 0.4, 0.002
MASS_MATRIX = LINK_INERTIA + LINK_MASS * LINK_COM**2 + TOOL_INERTIA + TOOL_MASS * REACH**2  # kg m^2
MOTOR_INERTIA = 0.15  # kg m^2, B_theta
FIRST_MOMENT = LINK_MASS * LINK_COM + TOOL_MASS * REACH  # kg m
STIFFNESS = 14000.0  # N m/rad
BOX = 0.1  # m, edge of the object
PAD = 0.6  # m, edge of the pad


def bench(axis: tuple[float, float, float] = UP) -> Physics:
    """A one-joint arm, and a box of 1 kg without a support."""
    sphere = (LINK_INERTIA, 0.0, 0.0, LINK_INERTIA, 0.0, LINK_INERTIA)
    facts = RobotFacts.model_validate(
        {
            "source": "bench",
            "joints": [{"xyz": (0.0, 0.0, 0.0), "rpy": axis}],
            "flange": {"xyz": (REACH, 0.0, 0.0)},
            "limits": {
                "position_min_rad": [-10.0],
                "position_max_rad": [10.0],
                "velocity_rad_s": [100.0],
                "torque_Nm": [100.0],
            },
            "links": [{"mass": LINK_MASS, "com": (LINK_COM, 0.0, 0.0), "inertia": sphere}],
        }
    )
    tool = EndEffector(TOOL_MASS, np.zeros(3), TOOL_INERTIA * np.eye(3), 0.0, 0.0, (PAD, PAD, 0.02))
    arm = ArmPhysics(
        facts=facts,
        base=pin.SE3.Identity(),
        end_effector=tool,
        motor_inertia_rotor=np.array([0.45]),
        motor_inertia_reduced=np.array([MOTOR_INERTIA]),
        stiffness=np.array([STIFFNESS]),
        damping=np.array([12.0]),
        friction=JointFriction.none(1),
        torque_offset=np.zeros(1),
        torque_gain=np.ones(1),
        actuation_delay=0.0,
        pad_stiffness=2.0e4,
        pad_damping=200.0,
        impact_position=np.array([REACH, 0.0, 0.0]),
    )
    box = ObjectPhysics(1.0, np.full(3, BOX), np.full(3, BOX**2 / 6.0), np.zeros(3))
    return Physics(
        arms={"arm": arm},
        object=box,
        support_height=None,
        support_size=(4.0, 4.0),
        support_friction=0.3,
        pad_friction=0.5,
        restitution=0.0,
    )


def switched_on(physics: Physics, name: str, **values: float) -> Physics:
    """Physics with an effect of the library; parameters that are not named stay nominal."""
    effect: Effect = library()[name]
    vector = {scalar.name: scalar.nominal for scalar in effect.scalars(physics.joint_count)}
    assert set(values) <= set(vector)
    return effect.apply_vector(physics, np.array(list({**vector, **values}.values())))


@dataclass(frozen=True)
class Motion:
    """What the plant did, one row per control period: times ``(k,)``, joint signals ``(k,)``, box ``(k, 3)``."""

    time: Array
    position: Array
    velocity: Array
    motor_position: Array
    motor_velocity: Array
    torque: Array
    box: Array
    box_velocity: Array

    @property
    def momentum(self) -> Array:
        """M dq + B dtheta of the arm of the bench, ``(k,)`` [N m s]."""
        return MASS_MATRIX * self.velocity + MOTOR_INERTIA * self.motor_velocity


def run(
    physics: Physics,
    torque: Callable[[float], float] = lambda time: 0.0,
    seconds: float = 0.4,
    start: float = 0.0,
    box: tuple[float, float, float] = (50.0, 0.0, 0.0),
    box_twist: tuple[float, ...] = (0.0,) * 6,
) -> Motion:
    """Motion under a desired torque [N m] of time [s], from rest at ``start`` [rad]; the box starts where it is put."""
    scenario = load_scenario("push")
    still = scenario.scatter.model_copy(update=dict.fromkeys(type(scenario.scatter).model_fields, 0.0))
    scenario = scenario.model_copy(update={"scatter": still})
    body = BodyState(np.array(box), np.eye(3), np.array(box_twist))
    plant = Plant.for_trial(scenario, physics, {"arm": np.array([start])}, body, seed=0)
    rows = []
    try:
        for _ in range(round(seconds / scenario.timing.control_period)):
            arm, thing = plant.truth().arms["arm"], plant.world.object_state()
            joint = (arm.position, arm.velocity, arm.motor_position, arm.motor_velocity, arm.torque)
            rows.append((plant.time, *(float(value[0]) for value in joint), *thing.position, *thing.twist[:3]))
            plant.step({"arm": np.array([torque(plant.time)])})
    finally:
        plant.close()
    table = np.array(rows)
    return Motion(*table[:, :6].T, table[:, 6:9], table[:, 9:12])


def slope(times: Array, values: Array, begin: float, end: float) -> float:
    """Mean rate of change between two times [s]."""
    inside = (times >= begin - 1e-9) & (times <= end + 1e-9)
    return float(np.polyfit(times[inside], values[inside], 1)[0])


def with_support(physics: Physics, height: float) -> Physics:
    """The same with a table whose surface is at ``height`` [m]."""
    return replace(physics, support_height=height)
