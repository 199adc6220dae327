# SPDX-License-Identifier: Apache-2.0
"""Assumed drive parameters of an arm with known links and unknown drives.

Motor inertia and stiffness are scaled from a Franka arm by the torque limits. The damping meets two conditions: the
torque loop is stable with the lightest link at its period, and the controller does not excite the resonance of the
joint. At resonance a link-side velocity feedback d has the loop gain d m / D, with m the inertia at the spring; a gain
above 1 causes a limit cycle at the torque limit.

A prismatic joint gets the drive of a revolute joint behind a pinion, whose radius r is the speed limit of the prismatic
joint over that of a Franka joint. A force F is the torque r F; inertia, stiffness and damping are divided by r^2.
"""

from __future__ import annotations

import numpy as np

from impact_rs_sim.robot_check import inverse_mass_matrices, link_inertias
from impact_rs_sim.robots.drive_stability import joint_stability
from impact_rs_sim.robots.robot import EndEffector, RobotFacts
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_sim.scenarios.robot_spec import DriveNumber

# Of a Franka arm: B_rho and K over the torque limit of its large joints, B_theta over B_rho.
ROTOR_INERTIA = 0.6 / 87.0  # kg m^2 / (N m)
STIFFNESS_PER_TORQUE = 14000.0 / 87.0  # N m/rad / (N m)
REDUCED = 1.0 / 3.0  # [-]
MAX_STIFFNESS_NM_RAD = 14000.0  # N m/rad, of a Franka arm's large joints; gears of stronger joints are not much stiffer
DAMPING_OVER_STIFFNESS_S = 12.0 / 14000.0  # s
FRANKA_SPEED_LIMIT_RAD_S = 2.175  # rad/s, of the joint whose drive is scaled
MAX_SHARE_OF_UNSTABLE_DAMPING = 0.25  # of the damping at which the torque loop loses its stability [-]; assumed
# 1/s, damping over the inertia at the spring. At the joint's resonance the velocity feedback 2 sqrt(400 / s^2) has the
# gain 40 m / D: twice the smallest sufficient damping, as a Franka arm has it.
MAX_DAMPING_RATE_PER_S = 80.0


def assumed_numbers(facts: RobotFacts) -> tuple[DriveNumber, ...]:
    """Names of the numbers of :func:`assumed_drive` that are assumed; a rotor inertia in the robot facts is not."""
    published = facts.reflected_rotor_inertia_other_source_kg_m2 is not None
    rotor: tuple[DriveNumber, ...] = () if published else ("motor_inertia_rotor",)
    reduced: tuple[DriveNumber, ...] = ("motor_inertia_reduced",) if facts.joint_torque_loop else ()
    return (*rotor, *reduced, "stiffness", "damping")


def assumed_drive(facts: RobotFacts, end_effector: EndEffector, period: float) -> dict[str, list[float]]:
    """Motor inertia, stiffness and damping per joint: published, or scaled from a Franka arm for a stable loop.

    Args:
        facts: The robot.
        end_effector: Its end effector.
        period: Period of the torque loop [s].
    """
    slides = np.array(facts.joint_types) == "prismatic"
    radius = np.where(slides, np.array(facts.limits.velocity_rad_s) / FRANKA_SPEED_LIMIT_RAD_S, 1.0)
    torque = radius * np.array(facts.limits.torque_Nm)
    usual_rotor = np.maximum(ROTOR_INERTIA * torque, 0.05) / np.square(radius)
    rotor = np.array(facts.reflected_rotor_inertia_other_source_kg_m2 or usual_rotor)
    reduced = REDUCED * rotor if facts.joint_torque_loop else rotor
    stiffness = np.minimum(STIFFNESS_PER_TORQUE * torque, MAX_STIFFNESS_NM_RAD) / np.square(radius)
    links = link_inertias(inverse_mass_matrices(RobotModel(facts, end_effector)))
    lightest, usual = links.min(axis=0), np.median(links, axis=0)
    damping = np.maximum(DAMPING_OVER_STIFFNESS_S * stiffness, MAX_DAMPING_RATE_PER_S / (1.0 / usual + 1.0 / reduced))
    for joint, inertia in enumerate(lightest):
        limits = joint_stability(float(inertia), float(reduced[joint]), 1.0, 0.0, period)
        stiffness[joint] = min(stiffness[joint], MAX_SHARE_OF_UNSTABLE_DAMPING * limits.stiffness_below)
        limits = joint_stability(float(inertia), float(reduced[joint]), float(stiffness[joint]), 1.0, period)
        damping[joint] = min(damping[joint], MAX_SHARE_OF_UNSTABLE_DAMPING * limits.damping_below)
    values = {
        "motor_inertia_rotor": rotor,
        "motor_inertia_reduced": reduced,
        "stiffness": stiffness,
        "damping": damping,
    }
    if not facts.joint_torque_loop:
        del values["motor_inertia_reduced"]
    return {name: [float(f"{value:.3g}") for value in row] for name, row in values.items()}
