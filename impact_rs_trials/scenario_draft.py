# SPDX-License-Identifier: Apache-2.0
"""Draft of a scenario for any arm: drive, pose and support are determined, the rest is copied from a shipped scenario.

The impact pose is chosen among random poses of the arm. For each pose the end effector follows its whole path with
minimum-norm joint velocity. The score combines the distance from joint limits, the smallest singular value of the
Jacobian, and the used share of speed and torque. The best poses whose plans keep clear of support and ground are
simulated in turn until a trial succeeds.
"""

from __future__ import annotations

import itertools
import math
import re
import tempfile
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pinocchio as pin
from ruamel.yaml.comments import CommentedMap, CommentedSeq

from impact_rs_control.plan import plan_trial
from impact_rs_sim.assumed_drive import REDUCED, ROTOR_INERTIA, assumed_drive, assumed_numbers
from impact_rs_sim.errors import Infeasible, InputError
from impact_rs_sim.paths import config_directory
from impact_rs_sim.robot_check import failures_of, failures_of_facts, random_positions
from impact_rs_sim.robots.robot import Array, RobotFacts, joined_units
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_sim.scenarios.object_proposal import ProposedObject
from impact_rs_sim.scenarios.object_spec import ObjectSpec
from impact_rs_sim.scenarios.robot_spec import ImpactPose
from impact_rs_sim.scenarios.scenario import Scenario
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_sim.scenarios.trial_settings import ASSUMED_MOTOR_INERTIA
from impact_rs_sim.scene import Scene
from impact_rs_sim.schema import parse_yaml, validate
from impact_rs_trials.bags.record import record_trial
from impact_rs_trials.bags.trial_info import TrialInfo, TrialKey
from impact_rs_trials.edited_yaml import (
    COMMENT_COLUMN,
    Noted,
    edited_text,
    in_one_line,
    read_edited,
    rounded,
    row,
    scalar,
    section,
    separate,
)
from impact_rs_trials.spec import TrialSpec

Report = Callable[[str, int, int], None]
Kind = Literal["push", "grab", "excite"]
KINDS: tuple[Kind, ...] = ("push", "grab", "excite")

SEARCHED_POSES = 150  # drawn within the joint limits
SIMULATED_POSES = 6  # the best ones
SEED = 0  # of these poses: a draft gives one scenario
PATH_STEP_M = 0.02  # along the path of the pad
COMFORTABLE = {"revolute": 0.3, "prismatic": 0.1}  # rad, m from a limit; more is no better
MAX_DEFLECTION_RATIO = 0.5  # velocity across the pad's normal over velocity along it, by an impulse along it
MIN_SINGULAR_VALUE = 0.1  # of the Jacobian (m, rad); more is no better
SPEED_FACTORS = (1.0, 0.8, 0.6, 0.45)  # of the shipped speeds, tried until the joints are fast enough
THRESHOLD_FACTORS = (1.0, 1.5, 2.0, 3.0, 4.0)  # of the shipped detection threshold: a heavy arm needs more
QUIET_THRESHOLD_FACTOR = 1.3  # safety: the simulated trials use a threshold lower by this factor
NORMAL, UP = np.array([0.0, -1.0, 0.0]), np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Pose:
    """Pose of an arm at the impact.

    Attributes:
        position: Position of E, ``(3,)`` [m].
        q: Joint positions, ``(n,)`` [rad].
        score: 0 (a limit is reached on the path) to 1 (far from all limits).
    """

    position: Array
    q: Array
    score: float


@dataclass(frozen=True)
class Draft:
    """A scenario that works.

    Attributes:
        text: Scenario file, YAML with comments.
        scenario: The scenario of that text.
        speed: Share of the shipped scenario's speeds.
        tried: Number of simulated poses that failed.
        choices: Choices with reasons, by key of the scenario; also in the head of ``text``.
    """

    text: str
    scenario: Scenario
    speed: float
    tried: int
    choices: Mapping[str, str]


class _TooEarly(Infeasible):
    """An impact was detected too early; a higher threshold of the detection may help."""


def draft(
    facts_name: str,
    facts: RobotFacts,
    kind: Kind,
    report: Report = lambda *_: None,
    proposed: ProposedObject | None = None,
) -> Draft:
    """A working scenario for an arm, with the boxes of the shipped scenario or another object.

    Args:
        facts_name: Robot of the scenario: a name in ``config/robots`` or a path.
        facts: The robot.
        kind: Shipped scenario that is the template.
        report: Progress callback, called with (step, done, total).
        proposed: Object in place of the boxes; None: boxes of the shipped scenario.

    Raises:
        InputError: An arm with fewer than six joints, which cannot keep a pad upright on its path, or no arm; an object
            for ``excite``, which hits nothing.
        Infeasible: No pose works.
    """
    if proposed is not None and kind == "excite":
        raise InputError("excite moves freely and hits nothing: leave the object out, or take push or grab")
    facts.check_chain("a scenario with trials", "--robot")
    if facts.joint_count < 6:
        raise InputError(
            f"{facts_name} has {facts.joint_count} joints: a pad that keeps its orientation on its way needs six; "
            "write a scenario for impact-rs map by hand, with robots.NAME.impact.joint_position, or use recordings"
        )
    if failures_of_robot := failures_of_facts(facts):
        raise InputError(f"{facts_name}: {failures_of_robot[0].name}: {failures_of_robot[0].found}")
    shipped = load_scenario(kind)
    effector = next(iter(shipped.robots.values())).end_effector
    model = RobotModel(facts, replace(effector.build(), mount_yaw=0.0))
    reachable = []
    for number, reached in enumerate(itertools.islice(upright_poses(model, SEED), SEARCHED_POSES)):
        report("poses", number, SEARCHED_POSES)
        if reached is not None:
            reachable.append(reached)
    drive = assumed_drive(facts, model.end_effector, shipped.timing.drive_period)
    motors = np.array(drive.get("motor_inertia_reduced", drive["motor_inertia_rotor"]))
    failures: list[str] = []
    for round_, speed in enumerate(SPEED_FACTORS):
        rated = sorted(
            (_with_score(model, reached, shipped, speed, motors) for reached in reachable),
            key=lambda candidate: -candidate.score,
        )
        texts = (
            (pose, scenario_text(facts_name, facts, kind, model, pose, speed, proposed=proposed))
            for pose in rated
            if pose.score > 0.0
        )
        clear = (pose for pose, text in texts if _can_be_planned(_read(text, facts)))
        for number, pose in enumerate(itertools.islice(clear, SIMULATED_POSES)):
            report("trials of poses", round_ * SIMULATED_POSES + number, len(SPEED_FACTORS) * SIMULATED_POSES)
            for threshold in THRESHOLD_FACTORS:
                text = scenario_text(facts_name, facts, kind, model, pose, speed, threshold, proposed)
                try:
                    scenario = _read(text, facts)
                    lower = scenario.control.detection.threshold / QUIET_THRESHOLD_FACTOR
                    _simulate(scenario.with_settings({"control.detection.threshold": lower}))
                except _TooEarly as error:
                    failures.append(str(error))
                except InputError as error:
                    failures.append(str(error))
                    break
                else:
                    search = (
                        f"of {SEARCHED_POSES} random places {len(reachable)} could be reached with the pad upright, "
                        f"and {sum(candidate.score > 0.0 for candidate in rated)} kept clear of all limits on their "
                        f"way; this one has score {pose.score:.2f} of 1, and {failures_text(failures)}"
                    )
                    choices = choices_of(facts, kind, model, pose, speed, threshold, search)
                    if proposed is not None:
                        choices = {f"objects.{proposed.name}": "; ".join(proposed.origins)} | choices
                    return Draft(_with_explanations(text, choices), scenario, speed, len(failures), choices)
    last_failure = f"; the last that was simulated: {failures[-1]}" if failures else ""
    raise Infeasible(f"no pose of {facts_name} among {SEARCHED_POSES} works for a {kind}{last_failure}")


def upright_poses(model: RobotModel, seed: int) -> Iterator[Pose | None]:
    """Endless random poses with the pad upright and its normal along -y; None if a random position is out of reach.

    Args:
        model: The arm.
        seed: Same seed, same poses.
    """
    rng = np.random.default_rng(seed)
    shoulder = model.link_placements(np.zeros(model.joint_count))["link2"].translation
    reach = max(float(np.linalg.norm(model.placement(q).translation - shoulder)) for q in random_positions(model))
    while True:
        yield _random_pose(model, reach, float(shoulder[2]), rng)


def _random_pose(model: RobotModel, reach: float, shoulder: float, rng: np.random.Generator) -> Pose | None:
    """A pose with the pad upright and its normal along -y; None if a random position is out of reach.

    Args:
        model: The arm.
        reach: Distance of E from joint 2 at which the arm begins to stretch [m].
        shoulder: Height of that joint [m].
        rng: Random generator for position and joint guess.
    """
    distance, azimuth = reach * rng.uniform(0.4, 0.85), rng.uniform(-0.5, 0.5)
    height = max(shoulder + reach * rng.uniform(-0.35, 0.35), 0.25)
    middle = 0.5 * (model.position_min + model.position_max)
    guess = middle + 0.5 * (model.position_max - middle) * rng.uniform(-1.0, 1.0, model.joint_count)
    position = np.array([distance * np.cos(azimuth), distance * np.sin(azimuth), height])
    impact_pose = ImpactPose(
        position=tuple(position), pad_normal=tuple(NORMAL), pad_up=tuple(UP), joint_guess=tuple(guess)
    )
    try:
        q = model.inverse_kinematics(impact_pose.placement, {}, guess, further_starts=0)
    except Infeasible:
        return None
    return Pose(position, q, 0.0)


def _with_score(model: RobotModel, pose: Pose, scenario: Scenario, share: float, motors: Array) -> Pose:
    """A pose with its score for the path of the fastest case and for the deflection of the pad by an impact."""
    velocities = [share * np.array(next(iter(case.robots.values())).ante_velocity) for case in scenario.cases.values()]
    fastest = max(velocities, key=lambda velocity: float(np.linalg.norm(velocity)))
    timing = scenario.timing
    if scenario.excursion is not None:
        paths = [share * np.array(scenario.excursion.start), share * np.array(scenario.excursion.end)]
    else:
        after = fastest[scenario.axis_index] * np.eye(3)[scenario.axis_index]
        paths = [-0.5 * timing.approach * fastest, 0.5 * timing.push * max(scenario.velocity_scales) * after]
    worst = min(_path_score(model, pose.q, path, float(np.linalg.norm(fastest))) for path in paths)
    return replace(pose, score=worst * max(0.0, 1.0 - _deflection(model, pose.q, motors) / MAX_DEFLECTION_RATIO))


def _deflection(model: RobotModel, q: Array, motors: Array) -> float:
    """Ratio of tangential to normal pad velocity caused by a normal impulse [-].

    A pad that moves upwards carries a part of the object's weight, which changes the friction of the support.
    """
    linear = model.jacobian(q)[:3]
    pad_velocity = linear @ np.linalg.solve(model.mass_matrix(q) + np.diag(motors), linear.T @ NORMAL)
    return float(np.linalg.norm(pad_velocity - (pad_velocity @ NORMAL) * NORMAL) / (pad_velocity @ NORMAL))


def _path_score(model: RobotModel, start: Array, path: Array, speed: float) -> float:
    """Smallest score on a straight path of E, followed with minimum-norm joint velocity."""
    length = float(np.linalg.norm(path))
    direction = np.append(path / length, np.zeros(3))
    target, q, worst = model.placement(start), start.copy(), 1.0
    comfortable = np.array([COMFORTABLE[joint.type] for joint in model.facts.joints])
    for travelled in np.arange(0.0, length + PATH_STEP_M, PATH_STEP_M):
        jacobian = model.jacobian(q)
        inverse = np.linalg.pinv(jacobian)
        margin = float((np.minimum(q - model.position_min, model.position_max - q) / comfortable).min())
        singular_value = float(np.linalg.svd(jacobian, compute_uv=False)[5])
        speed_share = float((np.abs(inverse @ direction) * speed / model.velocity_max).max())
        torque_share = float((np.abs(model.gravity_torque(q)) / model.torque_max).max())
        shares = (margin, singular_value / MIN_SINGULAR_VALUE, 2.0 * (1.0 - speed_share), 2.0 * (1.0 - torque_share))
        worst = min(worst, float(np.prod(np.clip(shares, 0.0, 1.0))))
        if worst == 0.0:
            break
        placement = model.placement(q)
        target_position = target.translation + direction[:3] * (travelled + PATH_STEP_M)
        error = np.append(
            target_position - placement.translation,
            placement.rotation @ pin.log3(placement.rotation.T @ target.rotation),
        )
        q = q + inverse @ error
    return worst


def scenario_text(
    facts_name: str,
    facts: RobotFacts,
    kind: Kind,
    model: RobotModel,
    pose: Pose,
    speed: float,
    threshold: float = 1.0,
    proposed: ProposedObject | None = None,
) -> str:
    """The scenario file.

    Args:
        facts_name: Name or path of the robot.
        facts: The robot.
        kind: Shipped template; keys that do not depend on the arm are copied from it.
        model: The arm with its end effector.
        pose: Pose at the impact.
        speed: Share of the shipped scenario's speeds.
        threshold: Threshold of the detection over the shipped one.
        proposed: Object in place of the shipped ones.
    """
    content = read_edited(config_directory() / "scenarios" / f"{kind}.yaml")
    content["name"] = f"{kind}_{re.sub(r'[^A-Za-z0-9_-]', '_', Path(facts_name).stem)}"
    if proposed is not None:
        content["objects"] = section({proposed.name: _object(proposed.spec)})
        content["name"] += f"_{proposed.name}"
    bodies = [ObjectSpec.model_validate(dict(item)) for item in content["objects"].values()]
    tallest = max(2.0 * body.reach(UP) for body in bodies)
    content["support"]["height"] = round(float(pose.position[2]) - 0.5 * tallest, 3)
    detection = content["control"]["detection"]
    detection["threshold"] = rounded(threshold * detection["threshold"])
    detection.yaml_add_eol_comment("N", "threshold", column=COMMENT_COLUMN)
    mirrored = None
    if kind == "grab":
        mirrored = pose.position + NORMAL * bodies[0].reach(-NORMAL)
        content["object_position"] = row(mirrored[:2].round(4))
    if kind == "excite":  # a shorter way at a lower speed takes as long
        excursion = content["excursion"]
        for key in ("start", "end"):
            excursion[key] = row(speed * np.array(excursion[key]))
        excursion["joint_1"] = rounded(speed * excursion["joint_1"])
        if facts.joint_count == 6:
            del excursion["joint_1"]
    drive = assumed_drive(facts, model.end_effector, float(content["timing"]["drive_period"]))
    content["robots"] = section(
        {
            name: _robot(facts_name, facts, robot["end_effector"], drive, pose, mirrored if index else None)
            for index, (name, robot) in enumerate(content["robots"].items())
        }
    )
    content["cases"] = _cases(content["cases"], facts, pose, speed)
    separate(content, "objects")
    if ("motor_inertia_reduced" if facts.joint_torque_loop else "motor_inertia_rotor") in assumed_numbers(facts):
        comment = "relative; it is assumed: from none to three times the number"
        content["uncertainty"] = section({"motor_inertia": Noted(ASSUMED_MOTOR_INERTIA, comment)})
        separate(content, "uncertainty")
    content.yaml_set_start_comment(
        f"Made by impact-rs scenario new for {facts_name}, with pose and drive found and the rest from {kind}:\n"
        "SI units everywhere; the inertial frame has z up (REP-103).\n"
        "The drive is an assumption, scaled from a Franka arm: replace it by the numbers of your robot, then run\n"
        f"impact-rs robot check {facts_name} --scenario THIS_FILE"
    )
    return edited_text(content)


def failures_text(failures: Sequence[str]) -> str:
    """Simulated trials before a draft worked, in words."""
    if not failures:
        return "its trials ended well at once"
    return f"{len(failures)} attempt{'s' * (len(failures) > 1)} before it failed, the last with {failures[-1]}"


def choices_of(
    facts: RobotFacts, kind: Kind, model: RobotModel, pose: Pose, speed: float, threshold: float, search: str
) -> dict[str, str]:
    """Choices of a draft with reasons, by key of the scenario.

    Args:
        facts: The robot.
        kind: Shipped scenario that is the template.
        model: The arm with its end effector.
        pose: Pose at the impact.
        speed: Share of the shipped scenario's speeds.
        threshold: Threshold of the detection over the shipped one.
        search: Description of the search for the pose.
    """
    rotor_inertia_published = facts.reflected_rotor_inertia_other_source_kg_m2 is not None
    rotor = (
        "B_rho as the robot facts state it"
        if rotor_inertia_published
        else f"B_rho assumed, {ROTOR_INERTIA:.4f} kg m^2 per N m of torque limit"
    )
    loop = (
        f"B_theta = {REDUCED:.2f} B_rho assumed"
        if facts.joint_torque_loop
        else "rigid, as the robot facts know no torque loop"
    )
    revolute = np.array([joint.type == "revolute" for joint in facts.joints])
    margins = np.minimum(pose.q - model.position_min, model.position_max - pose.q)
    nearest = int(np.argmin(margins / np.where(revolute, COMFORTABLE["revolute"], COMFORTABLE["prismatic"])))
    choices = {
        "end_effector": f"that of {kind}, not yours: replace mass, centre, inertia and length",
        "drive": f"{rotor}; {loop}; stiffness from the torque limits of a Franka arm, as far as the torque loop is "
        "stable; damping against the resonance of the joint: replace all four by the numbers of your robot",
        "impact": f"{search}; joint {nearest + 1} is nearest to its limit there, "
        f"{margins[nearest]:.2f} {facts.units[nearest].position} away",
        "support.height": "half the height of the tallest object below the pad, which then hits the middle of a face",
        "cases": f"velocities of {kind}"
        + (f" times {speed:g}: the joints are too slow for more" if speed < 1.0 else ", which these joints can follow")
        + ("; joint_1 holds the posture that seven joints leave open" if facts.joint_count > 6 else ""),
        "control.detection.threshold": f"that of {kind}"
        + (
            f" times {threshold:g}: with less a trial took its own motion for an impact"
            if threshold > 1.0
            else f"; trials run at 1/{QUIET_THRESHOLD_FACTOR:g} of it saw no impact too early"
        ),
    }
    if kind == "excite":
        del choices["support.height"]
    return choices | {"all other keys": f"as in {kind}, word for word"}


def _with_explanations(text: str, choices: Mapping[str, str]) -> str:
    """A scenario file with its choices in the comment at its head."""
    first, remaining = text.split("\n", 1)
    lines = [
        line
        for key, reason in choices.items()
        for line in textwrap.wrap(f"{key}: {reason}.", 116, initial_indent="# * ", subsequent_indent="#   ")
    ]
    return "\n".join([first, *lines, remaining])


def _robot(
    facts_name: str,
    facts: RobotFacts,
    effector: Mapping[str, Any],
    drive: Mapping[str, list[float]],
    pose: Pose,
    mirrored: Array | None,
) -> CommentedMap:
    """An arm of a scenario file; a second arm is rotated by 180 degrees about the middle of the object."""
    sign, base, yaw, position = 1.0, np.zeros(3), 0.0, pose.position
    if mirrored is not None:
        sign, yaw = -1.0, np.pi
        base = 2.0 * mirrored * [1.0, 1.0, 0.0]
        position = 2.0 * mirrored - pose.position
        position[2] = pose.position[2]
    pad, units = effector["pad"], facts.units

    def of_joints(quantity: str) -> str:
        return joined_units(getattr(unit, quantity) for unit in units)

    rigid = "motor_inertia_reduced" not in drive
    drive_section: dict[str, Any] = {"type": Noted("rigid", "no torque loop: the links carry B_rho")} if rigid else {}
    for key, unit, symbol in (
        ("motor_inertia_rotor", "inertia", "B_rho"),
        ("motor_inertia_reduced", "inertia", "B_theta"),
        ("stiffness", "stiffness", "K"),
        ("damping", "damping", "D"),
    ):
        if key in drive:
            drive_section[key] = Noted(row(drive[key]), f"{of_joints(unit)}, {symbol}")
    return section(
        {
            "facts": scalar(facts_name),
            "base": section({"position": Noted(row(base), "m"), "yaw": Noted(rounded(yaw), "rad")}),
            "end_effector": section(
                {
                    "mass": Noted(effector["mass"], "kg"),
                    "com": Noted(row(effector["com"]), "m, in frame E (middle of the pad's face, +z outwards)"),
                    "inertia": Noted(row(effector["inertia"]), "kg m^2"),
                    "length": Noted(effector["length"], "m, flange to pad face"),
                    "pad": section(
                        {
                            "size": Noted(row(pad["size"]), "m"),
                            "stiffness": Noted(float(pad["stiffness"]), "N/m, whole face"),
                            "damping": Noted(float(pad["damping"]), "N s/m, whole face"),
                        }
                    ),
                }
            ),
            "drive": section({**drive_section, "assumed": row(assumed_numbers(facts))}),
            "impact": section(
                {
                    "position": Noted(row(position), "m"),
                    "pad_normal": row(sign * NORMAL),
                    "pad_up": row(UP),
                    "joint_guess": Noted(row(pose.q), of_joints("position")),
                }
            ),
        }
    )


def _object(spec: Mapping[str, Any]) -> CommentedMap:
    """An object of a scenario file; corners keep all of their digits, so that triangles of one plane are one face."""
    units = {
        "mass": "kg",
        "size": "m",
        "com_offset": "m, from the middle of size",
        "inertia": "kg m^2, about the centre of mass",
        "rpy": "rad",
    }
    entries: dict[str, Any] = {}
    for key, value in spec.items():
        if key == "corners":
            entries[key] = CommentedSeq(CommentedSeq(corner) for corner in value)
            for sequence in (*entries[key], entries[key]):
                sequence.fa.set_flow_style()
        elif key in units:
            entries[key] = Noted(row(value) if isinstance(value, list) else rounded(value), units[key])
        else:
            entries[key] = scalar(value)
    return section(entries)


def _cases(cases: Mapping[str, Any], facts: RobotFacts, pose: Pose, speed: float) -> CommentedMap:
    """Cases with speeds that the arm can reach; redundant arms hold joint 1 as in the shipped cases."""
    sections: dict[str, CommentedMap] = {}
    written: list[dict[str, dict[str, Any]]] = []
    first = next(iter(next(iter(cases.values()))["robots"]))
    joint_1_of_first_case = float(next(iter(cases.values()))["robots"][first]["joint_1"])
    for name, case in cases.items():
        # A second arm is the first one rotated, not mirrored: its joint 1 moves in the same direction.
        joint_1 = rounded(float(pose.q[0]) + float(case["robots"][first]["joint_1"]) - joint_1_of_first_case)
        posture = {"joint_1": joint_1} if facts.joint_count > 6 else {}
        arms = {
            arm: {
                "ante_velocity": row((speed * np.array(robot_case["ante_velocity"], dtype=float)).round(4)),
                **posture,
            }
            for arm, robot_case in case["robots"].items()
        }
        if arms not in written:
            comment = f"m/s, {facts.units[0].position}"
            robots = section({arm: Noted(in_one_line(robot_case), comment) for arm, robot_case in arms.items()})
            sections[name] = section({"label": case["label"], "robots": robots})
            written.append(arms)
    return section(sections)


def _read(text: str, facts: RobotFacts) -> Scenario:
    """The scenario of a text, whose robots are ``facts``.

    Raises:
        InputError: It breaks the schema.
    """
    data = parse_yaml(text, "the new scenario")
    for robot in data["robots"].values():
        robot["facts"] = facts.model_dump()
    return validate(Scenario, data, "the new scenario")


def _sets(scenario: Scenario) -> list[tuple[str, str]]:
    """Every case with the heaviest object, and the first case with the lightest object."""
    by_mass = sorted(scenario.objects, key=lambda name: scenario.object(name).mass or math.inf)
    sets = [(by_mass[-1], case) for case in scenario.cases] + [(by_mass[0], next(iter(scenario.cases)))]
    return list(dict.fromkeys(sets))


def _can_be_planned(scenario: Scenario) -> bool:
    """Whether arms keep clear of support and ground, and reach every start."""
    try:
        for object_name, case in _sets(scenario):
            plan_trial(Scene.resolve(scenario, object_name, case))
    except Infeasible:
        return False
    return True


def _simulate(scenario: Scenario) -> None:
    """Run the trials of :func:`_sets`.

    Raises:
        Infeasible: A drive is unstable, a pose cannot be reached, or a trial does not end well.
    """
    for check in failures_of(scenario):
        raise Infeasible(f"{check.name}: {check.found}")
    with tempfile.TemporaryDirectory() as directory:
        for object_name, case in _sets(scenario):
            plan = TrialSpec.of(scenario, object_name, case).plan
            key = TrialKey(object_name, case, 1.0, 0)
            verdict, _ = record_trial(plan, TrialInfo.of(plan, key, SEED, ""), Path(directory) / key.name)
            if verdict.outcome != "OK":
                kind = _TooEarly if verdict.outcome == "EARLY" else Infeasible
                raise kind(f"{object_name} {case}: {verdict.outcome}, {verdict.reason}")
