# SPDX-License-Identifier: Apache-2.0
"""Checks of robot facts before a simulation.

Each check is one line: subject, outcome and its number. An error that would falsify a simulation fails; an unusual
number is a warning.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from impact_rs_sim.errors import InputError
from impact_rs_sim.plant.bullet_world import mass_matrices
from impact_rs_sim.proportion import reach_of
from impact_rs_sim.robots.drive_stability import JointStability, joint_stability, spectral_radius
from impact_rs_sim.robots.robot import UNITS, Array, EndEffector, Inertial, JointType, JointUnits, RobotFacts
from impact_rs_sim.robots.robot_model import GRAVITY_M_S2, RobotModel
from impact_rs_sim.rotations import AXES
from impact_rs_sim.scenarios.robot_spec import Robot
from impact_rs_sim.scenarios.scenario import Scenario
from impact_rs_sim.scenarios.trial_settings import ASSUMED_MOTOR_INERTIA

Outcome = Literal["ok", "warning", "failed"]

SAMPLED_CONFIGURATIONS = 100  # uniform within the joint limits
SEED = 0  # of these configurations, so that checks are repeatable
MAX_ENGINE_DIFFERENCE = 1e-6  # over the largest entry of M [-]; Bullet reads parts of a URDF in single precision
TRIANGLE_INEQUALITY_TOLERANCE = 1e-3  # violation of the triangle inequality by rounding of published moments [-]
MOMENT_ACCURACY = 0.02  # of published moments (rounded, or identified), over the largest moment [-]
# Density of a motor of steel and copper without a gap. Shipped arms: 1,100 in the median, at most 4,540.
MAX_DENSITY_KG_M3 = 5000.0
MIN_DENSITY_KG_M3 = 50.0  # of a hollow link; a ball of this density is an upper bound of the size of a link
MAX_GYRATION_RATIO = 2.0  # radius of gyration over the length of a link; a rod has 0.29, shipped arms at most 1.2
MAX_MASS_RATIO = 4.0  # mass of a link over the heaviest of the four next to it; shipped arms at most 2.1
MAX_LOAD_RATIO = 3.0  # load at full reach by the torque limits over the mass of the arm; shipped arms 0.2 to 1.3
MIN_EQUAL_LIMITS = 3  # joints of an arm whose equal limits are suspicious
MOTION_VERB: dict[JointType, str] = {"revolute": "turn", "prismatic": "slide"}
EFFORT_NOUN: dict[JointType, str] = {"revolute": "torque", "prismatic": "force"}
SPECTRAL_RADIUS_ROUNDING = 1e-9  # without damping the spectral radius is 1 up to rounding


@dataclass(frozen=True)
class Check:
    """One check.

    Attributes:
        name: Subject of the check.
        outcome: Passed, warning or failed.
        found: Finding with units.
    """

    name: str
    outcome: Outcome
    found: str


def check_facts(facts: RobotFacts) -> list[Check]:
    """Checks of a robot with an empty flange."""
    checks = [_check_inertias(facts), _check_bodies(facts), _check_limits(facts), *_assumed_facts(facts)]
    if any(check.outcome == "failed" for check in checks):
        return checks  # engines differ in how they treat an inconsistent body
    if not facts.is_chain:
        return checks  # Bullet takes chains only
    model = RobotModel(facts, empty_flange())
    positions = random_positions(model)
    return [*checks, _check_engines(model, positions), _check_gravity(model, positions)]


def check_drives(facts: RobotFacts, scenario: Scenario) -> list[Check]:
    """Checks of the drives of all arms of a scenario with these facts, with their end effectors.

    Raises:
        InputError: No arm has these facts.
    """
    checks = []
    for name, robot in scenario.robots.items():
        if robot.robot_facts == facts:
            checks += _check_drive(name, robot, scenario.timing.drive_period)
            checks += _assumed_drive(name, robot, scenario.uncertainty.motor_inertia)
    if not checks:
        raise InputError(f"no arm of scenario {scenario.name!r} is this robot; its arms: {', '.join(scenario.robots)}")
    return checks


def failures_of(scenario: Scenario) -> list[Check]:
    """Failed checks of inertias, limits and drives of the arms of a scenario; these need no simulator."""
    checks = []
    for name, robot in scenario.robots.items():
        facts_failures = failures_of_facts(robot.robot_facts)
        checks += facts_failures or _check_drive(name, robot, scenario.timing.drive_period)
    return [check for check in checks if check.outcome == "failed"]


def failures_of_facts(facts: RobotFacts) -> list[Check]:
    """Failed checks of an arm without its drive: inertias and limits."""
    return [check for check in (_check_inertias(facts), _check_limits(facts)) if check.outcome == "failed"]


def empty_flange() -> EndEffector:
    """End effector of one milligram, because a body needs a mass."""
    return EndEffector(
        mass=1e-6,
        com=np.zeros(3),
        inertia=1e-12 * np.eye(3),
        length=0.0,
        mount_yaw=0.0,
        pad_size=(0.001, 0.001, 0.001),
    )


def random_positions(model: RobotModel) -> Array:
    """Repeatable random joint positions within the limits, ``(k, n)`` [rad]."""
    rng = np.random.default_rng(SEED)
    limits = model.facts.limits
    ends = limits.position_min_rad, limits.position_max_rad
    drawn = rng.uniform(*ends, (SAMPLED_CONFIGURATIONS, model.facts.joint_count))
    return np.array([model.position_of(joints) for joints in drawn])


def inverse_mass_matrices(model: RobotModel) -> Array:
    """M^-1 at :func:`random_positions`, joints only, ``(k, n, n)`` [1/(kg m^2)]; a floating base moves freely."""
    base = model.facts.base_size
    return np.linalg.inv(np.array([model.mass_matrix(q) for q in random_positions(model)]))[:, base:, base:]


def link_inertias(inverse_mass_matrices: Array) -> Array:
    """Effective inertia about each joint with all others free, 1 / (M^-1)_ii, ``(k, n)`` [kg m^2]."""
    return 1.0 / np.diagonal(inverse_mass_matrices, axis1=1, axis2=2)


def _label(facts: RobotFacts, number: int) -> str:
    """Link by its number from 1, with its name in the file that it comes from."""
    name = facts.links[number - 1].name
    return f"link {number} ({name})" if name else f"link {number}"


def _check_inertias(facts: RobotFacts) -> Check:
    """Check that moments of inertia are positive and obey the triangle inequality."""
    name, largest_ratio, errors = "inertias are those of bodies", 0.0, []
    bodies: dict[str, Inertial] = {_label(facts, number): link for number, link in enumerate(facts.links, start=1)}
    if facts.floating_base is not None:
        bodies["floating_base"] = facts.floating_base
    for label, link in bodies.items():
        moments, axes = np.linalg.eigh(link.inertia_matrix)
        about = [f"about {_direction(axis)}" for axis in axes.T]
        negative = [axis_index for axis_index in range(3) if moments[axis_index] <= 0.0]
        errors += [
            f"{label}: principal moment {moments[axis_index]:.3g} kg m^2 {about[axis_index]}, expected > 0"
            for axis_index in negative
        ]
        if negative:
            continue
        ratio = moments[2] / (moments[0] + moments[1])
        if ratio > 1.0 + TRIANGLE_INEQUALITY_TOLERANCE:
            errors.append(
                f"{label}: largest principal moment is {ratio:.3g} of the sum of the others "
                f"({moments[2]:.3g} kg m^2 {about[2]}), expected <= 1"
            )
        largest_ratio = max(largest_ratio, ratio)
    if errors:
        return Check(name, "failed", "; ".join(errors))
    return Check(name, "ok", f"largest principal moment at most {largest_ratio:.3g} of the sum of the others")


def _direction(axis: Array) -> str:
    """Name of the link axis nearest to a principal axis ``(3,)``."""
    return AXES[int(np.argmax(np.abs(axis)))]


def _check_bodies(facts: RobotFacts) -> Check:
    """Check masses, sizes and densities of the links for plausibility; all findings in one check."""
    name, findings, densities = "links are like those of arms", [], []
    masses = [link.mass for link in facts.links]
    steps: dict[int, list[float]] = {number: [] for number in range(len(facts.links) + 1)}
    for number, (joint, parent) in enumerate(zip(facts.joints, facts.parents, strict=True), start=1):
        for end in (number, parent):
            steps[end].append(float(np.linalg.norm(joint.xyz)))
    steps[facts.flange_link].append(float(np.linalg.norm(facts.flange.xyz)))
    for number, link in enumerate(facts.links, start=1):
        label, moments = _label(facts, number), np.asarray(np.linalg.eigvalsh(link.inertia_matrix), dtype=float)
        if moments[0] <= 0.0:
            continue  # no body at all
        density = density_lower_bound(link.mass, moments)
        densities.append(density)
        if density > MAX_DENSITY_KG_M3:
            findings.append(
                f"{label}: a body of {link.mass:.3g} kg with principal moments of "
                f"{', '.join(f'{moment:.2g}' for moment in moments)} kg m^2 is denser than {density:.2g} kg/m^3 "
                f"somewhere, expected at most {MAX_DENSITY_KG_M3:g}: moments too small?"
            )
        ball = float((3.0 * link.mass / (4.0 * np.pi * MIN_DENSITY_KG_M3)) ** (1.0 / 3.0))
        length = max(*steps[number], float(np.linalg.norm(link.com)), ball)
        too_long = [
            f"{moment:.3g} kg m^2 about {axis} (radius of gyration {np.sqrt(moment / link.mass):.2g} m)"
            for axis, moment in zip(AXES, np.diag(link.inertia_matrix), strict=True)
            if moment > link.mass * (MAX_GYRATION_RATIO * length) ** 2
        ]
        if too_long:
            findings.append(
                f"{label}: {', '.join(too_long)}, "
                f"expected at most {MAX_GYRATION_RATIO:g} times the {length:.2g} m of the link"
            )
        neighbours = [*masses[max(0, number - 3) : number - 1], *masses[number : number + 2]]
        if neighbours and link.mass > MAX_MASS_RATIO * max(neighbours):
            masses_text = ", ".join(f"{mass:.3g}" for mass in neighbours)
            findings.append(
                f"{label}: {link.mass:.3g} kg beside neighbours of {masses_text} kg, "
                f"expected at most {MAX_MASS_RATIO:g} times the heaviest of them"
            )
    if findings:
        return Check(name, "warning", "; ".join(findings))
    if not densities:
        return Check(name, "ok", "no link moves on the base")
    return Check(
        name, "ok", f"{sum(masses):.3g} kg in all, links of {min(densities):.2g} to {max(densities):.2g} kg/m^3"
    )


def density_lower_bound(mass: float, moments: Array) -> float:
    """Lower bound of the largest density in a body, for any shape [kg/m^3].

    Among all bodies of bounded density the homogeneous ellipsoid has the smallest determinant of the second moments of
    mass. With principal moments I its half axes are a_i^2 = 5 (I_1 + I_2 + I_3 - 2 I_i) / (2 m), and its density
    m / (4/3 pi a_1 a_2 a_3) is a lower bound for all bodies with these moments.

    Args:
        mass: Mass m [kg].
        moments: Principal moments I, ``(3,)``, assumed accurate to 2 % of the largest [kg m^2].
    """
    second = np.maximum(np.sum(moments) / 2.0 - moments, MOMENT_ACCURACY * np.max(moments))
    return float(mass / (4.0 / 3.0 * np.pi * np.sqrt(np.prod(5.0 * second / mass))))


def _check_limits(facts: RobotFacts) -> Check:
    name, limits = "limits are sane", facts.limits
    spans: dict[JointType, list[float]] = {}
    ranges = zip(facts.moving, limits.position_min_rad, limits.position_max_rad, strict=True)
    for number, (joint, lower, upper) in enumerate(ranges, start=1):
        if lower >= upper:
            range_text = f"joint {number}: position from {lower:g} to {upper:g} {joint.units.position}"
            return Check(name, "failed", f"{range_text}, expected lower < upper")
        spans.setdefault(joint.type, []).append(upper - lower)
    texts = (
        f"{MOTION_VERB[kind]} by {min(of):.3g} to {max(of):.3g} {UNITS[kind].position}" for kind, of in spans.items()
    )
    return Check(name, "ok", f"joints {', '.join(texts)}" if spans else "no joint moves")


def _assumed_facts(facts: RobotFacts) -> list[Check]:
    """A warning if the facts hold estimates or assumptions."""
    if not facts.assumed:
        return []
    return [Check("facts are measured or published", "warning", f"assumed: {'; '.join(facts.assumed)}")]


def _assumed_drive(arm: str, robot: Robot, stated: float) -> list[Check]:
    """A warning if the drive holds assumptions, with the stated relative uncertainty of B [-]."""
    drive = robot.drive
    if not drive.assumed:
        return []
    text = f"assumed: {', '.join(drive.assumed)}"
    if drive.assumes_motor_inertia:
        text += f"; intervals of predictions take the motor inertia for known to {100.0 * stated:g} %"
        if stated < ASSUMED_MOTOR_INERTIA:
            text += f": set uncertainty.motor_inertia to {ASSUMED_MOTOR_INERTIA:g}"
    return [Check(f"drive of {arm} is measured or published", "warning", text)]


def _check_engines(model: RobotModel, positions: Array) -> Check:
    pinocchio_matrices = np.array([model.mass_matrix(q) for q in positions])
    bullet_matrices = mass_matrices(model.facts, model.end_effector, positions)
    scale = np.abs(pinocchio_matrices).max(axis=(1, 2))
    difference = float((np.abs(pinocchio_matrices - bullet_matrices).max(axis=(1, 2)) / scale).max())
    outcome: Outcome = "ok" if difference <= MAX_ENGINE_DIFFERENCE else "failed"
    return Check("Pinocchio and Bullet see the same arm", outcome, f"mass matrices differ by {difference:.1e} of M")


def _check_gravity(model: RobotModel, positions: Array) -> Check:
    name = "the joints carry the arm"
    share = np.abs([model.gravity_torque(q) for q in positions]) / model.torque_max
    joint = int(share.max(axis=0).argmax())
    kind = EFFORT_NOUN[model.facts.joints[joint].type]
    text = f"joint {joint + 1}: gravity takes up to {100.0 * share.max():.3g} % of the {kind} limit"
    warnings = _placeholders(model, positions)
    return Check(name, "warning" if share.max() > 1.0 or warnings else "ok", "; ".join([text, *warnings]))


def _placeholders(model: RobotModel, positions: Array) -> list[str]:
    """Warnings about limits that look like placeholders: all equal, or far beyond the needs of the arm."""
    limits, warnings = model.facts.limits, []
    if model.joint_count < MIN_EQUAL_LIMITS:
        return []  # a motor that is much too strong is usual there
    if len(set(limits.torque_Nm)) == len(set(limits.velocity_rad_s)) == 1:
        units = model.facts.units[0]
        warnings.append(
            f"all joints have the same limits, {limits.torque_Nm[0]:g} {units.effort} and {limits.velocity_rad_s[0]:g} "
            f"{units.velocity}: placeholders of a URDF?"
        )
    weight = np.max(np.abs([model.gravity_torque(q) for q in positions]), axis=0)
    lever = np.max(np.abs([model.jacobian(q)[2] for q in positions]), axis=0)
    carries = lever > 0.01 * reach_of(model.facts)
    mass = sum(link.mass for link in model.facts.links)
    load = (model.torque_max[carries] - weight[carries]) / (GRAVITY_M_S2 * lever[carries])
    if load.size and np.min(load) > MAX_LOAD_RATIO * mass:
        warnings.append(
            f"torque limits carry {np.min(load):.3g} kg at full reach, {np.min(load) / mass:.2g} times the {mass:.3g} "
            f"kg of the arm, expected at most {MAX_LOAD_RATIO:g} times: placeholders of a URDF, or masses too small?"
        )
    return warnings


def _check_drive(arm: str, robot: Robot, period: float) -> list[Check]:
    drive = robot.drive
    model = RobotModel(robot.robot_facts, robot.end_effector.build())
    inverses = inverse_mass_matrices(model)
    lightest = link_inertias(inverses).min(axis=0)
    checks = []
    for joint, link_inertia in enumerate(lightest):
        values = drive.reflected_inertia[joint], drive.stiffness[joint], drive.damping[joint]
        stability = joint_stability(float(link_inertia), *values, period)
        if stability.spectral_radius >= 1.0 - SPECTRAL_RADIUS_ROUNDING:
            units = robot.robot_facts.units[joint]
            checks.append(_instability_text(arm, joint, units, stability, drive.damping[joint], period))
    motors, stiffness, damping = (
        np.array(values) for values in (drive.reflected_inertia, drive.stiffness, drive.damping)
    )
    radius = max(spectral_radius(inverse + np.diag(1.0 / motors), stiffness, damping, period) for inverse in inverses)
    outcome: Outcome = (
        "ok"
        if radius < 1.0 - SPECTRAL_RADIUS_ROUNDING
        else "warning"
        if radius <= 1.0 + SPECTRAL_RADIUS_ROUNDING
        else "failed"
    )
    text = f"spectral radius of all joints together {radius:.6g} at {1e3 * period:g} ms, expected < 1"
    return [*checks, Check(f"drive of {arm} is stable", outcome, text)]


def _instability_text(
    arm: str, joint: int, units: JointUnits, stability: JointStability, damping: float, period: float
) -> Check:
    """Description of an unstable joint, and remedies."""
    name = f"drive of {arm}, joint {joint + 1}"
    radius = (
        f"spectral radius {stability.spectral_radius:.6g} with {stability.link_inertia:.3g} {units.inertia} on the link"
    )
    if damping == 0.0:
        return Check(
            name,
            "failed" if stability.spectral_radius > 1.0 + SPECTRAL_RADIUS_ROUNDING else "warning",
            f"{radius}: no damping",
        )
    remedies = [f"timing.drive_period < {stability.period_below:.3g} s (now {period:g})"]
    if stability.damping_below > 0.0:
        remedies.insert(0, f"drive.damping < {stability.damping_below:.3g} {units.damping} (now {damping:g})")
    if stability.stiffness_below > 0.0:
        remedies.insert(0, f"drive.stiffness < {stability.stiffness_below:.3g} {units.stiffness}")
    return Check(name, "failed", f"{radius}; what would do: {', or '.join(remedies)}")
