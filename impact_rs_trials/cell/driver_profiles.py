# SPDX-License-Identifier: Apache-2.0
"""Drivers of robots: names, rates, conventions and limits, for rehearsals and for the manual.

Latencies are assumptions: driver, cell and controller on one real-time machine. No number here was measured on a robot.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

from impact_rs_sim.errors import InputError, did_you_mean
from impact_rs_sim.scenarios.scenario import Scenario


@dataclass(frozen=True)
class DriverProfile:
    """A driver behind ros2_control.

    Attributes:
        name: Name of the profile.
        robots: Robots of ``config/robots`` with this driver.
        joints: Parameter ``joints`` of the cell.
        states: Topic of the joint states.
        commands: Topic of the torques.
        period: Period of the states [s]; None: the period of the scenario.
        adds_gravity: Whether the driver adds the gravity torque to a commanded torque.
        torque_rate: Largest rate of a torque that the driver accepts [N m/s].
        state_latency: Time from the measurement until the cell has the state [s]; assumed.
        command_latency: Time from the cell's torque until the driver has it [s]; assumed.
        source: Source of the other numbers.
        states_end: Whether joint states end when the robot has stopped itself.
        blocking: Reasons why the cell cannot run with the released version of this driver; empty: not known.
    """

    name: str
    robots: tuple[str, ...]
    joints: str
    states: str
    commands: str
    period: float | None
    adds_gravity: bool
    torque_rate: float
    state_latency: float
    command_latency: float
    source: str
    states_end: bool
    blocking: tuple[str, ...] = ()

    def joints_of(self, arms: Collection[str]) -> str:
        """The parameter ``joints`` for these arms; several arms have their name and ``_`` before each joint's."""
        if len(arms) == 1 or "{arm}" in self.joints:
            return self.joints
        return ",".join(f"{{arm}}_{name}" for name in self.joints.split(","))


UR_JOINTS = (
    "shoulder_pan_joint,shoulder_lift_joint,elbow_joint,wrist_1_joint,wrist_2_joint,wrist_3_joint"  # of ur_description
)

PROFILES = {
    profile.name: profile
    for profile in (
        DriverProfile(
            name="franka_ros2",
            robots=("franka_fr3", "franka_fer"),
            joints="fr3_joint{number}",
            states="/franka/joint_states",
            commands="/effort_controller/commands",
            period=0.001,
            adds_gravity=True,
            torque_rate=1000.0,
            state_latency=0.0002,
            command_latency=0.0002,
            source="FCI: 1 kHz, gravity compensated; libfranka rate_limiting.h: kMaxTorqueRate 1000 N m/s",
            states_end=True,  # franka_hardware_interface.cpp: read() answers a reflex with ERROR, broadcasters end
        ),
        DriverProfile(
            name="ur_robot_driver",
            robots=("ur5e", "ur10e"),
            joints=UR_JOINTS,
            states="/joint_states",
            commands="/forward_effort_controller/commands",
            period=0.002,
            adds_gravity=True,
            torque_rate=1000.0,
            state_latency=0.0005,
            command_latency=0.0005,
            source="e-Series: RTDE at 500 Hz; direct torque from PolyScope 5.23; the rate of torques is assumed",
            states_end=False,  # assumed
            blocking=(
                "no torques of the link side: effort in /joint_states is the motor current [A], or a torque made of "
                "it, without the gravity torque, and the robot has no torque sensors at its joints",
            ),
        ),
        DriverProfile(
            name="lbr_fri_ros2_stack",
            robots=("kuka_iiwa7", "kuka_iiwa14"),
            joints="lbr_A{number}",
            states="/lbr/joint_states",
            commands="/lbr/effort_controller/commands",
            period=0.001,
            adds_gravity=True,
            torque_rate=1000.0,
            state_latency=0.0003,
            command_latency=0.0003,
            source="FRI: send period from 1 ms, torques on top of gravity; the rate of torques is assumed",
            states_end=True,  # system_interface.cpp: read() answers the end of COMMANDING_ACTIVE with ERROR
            blocking=(
                "no torque-only mode: the robot adds commanded torques to the springs of its joint impedance, which "
                "pull the arm back, and the cell does not know them",
                "torques of an effort controller are not passed on: the driver writes torques only while commanded "
                "positions stand beside them",  # torque_command.cpp
            ),
        ),
        DriverProfile(
            name="ros2_control",
            robots=(),
            joints="{arm}_joint{number}",
            states="/joint_states",
            commands="/ARM/effort_controller/commands",
            period=None,
            adds_gravity=False,
            torque_rate=1000.0,
            state_latency=0.0002,
            command_latency=0.0002,
            source="defaults of the cell; gravity is not compensated",
            states_end=False,
        ),
    )
}


def profile_of(scenario: Scenario, name: str | None = None) -> DriverProfile:
    """The driver of a scenario's robots.

    Args:
        scenario: The scenario.
        name: Name of a profile; None: the profile of the first arm's robot, or ``ros2_control``.

    Raises:
        InputError: There is no such profile.
    """
    if name is None:
        facts = next(iter(scenario.robots.values())).facts
        matching = (profile for profile in PROFILES.values() if facts in profile.robots)
        return next(matching, PROFILES["ros2_control"])
    if name not in PROFILES:
        raise InputError(f"no driver {name!r}{did_you_mean(name, PROFILES)}; known drivers: {', '.join(PROFILES)}")
    return PROFILES[name]
