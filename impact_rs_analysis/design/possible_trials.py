# SPDX-License-Identifier: Apache-2.0
"""Candidate trials of a cell: cases at other speeds, off-centre, oblique, and along other directions.

A variant of a scenario is the scenario with some settings, as in ``impact-rs campaign --set``. Trials beyond reach or
limits are found by a forecast (:mod:`impact_rs_analysis.design.forecast`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from impact_rs_sim.errors import InputError
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.scenarios.scenario import Scenario
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_sim.scenarios.trial_settings import Case, CaseRobot
from impact_rs_trials.envelope import CellEnvelope
from impact_rs_trials.runs import label_of
from impact_rs_trials.spec import TrialSpec

SLOW_CASE_RATIO = 0.5  # speed over that of the slowest case: sticking and Stribeck friction show there
OFF_CENTRE_RATIO = 0.15  # of the width of the narrowest object: it turns, and the pad still hits a face
MAX_VERTICAL_NORMAL = 1e-6  # z component of a pad's unit normal; a steeper pad has no side [-]
SLIP_FRICTION_RATIO = 2.0  # sliding over closing speed, in friction coefficients: the pad slips, and friction shows
MAX_APPROACH_ANGLE_RAD = np.radians(45.0)  # from the normal


@dataclass(frozen=True)
class Envelope:
    """Limits of the cell, in addition to the limits of the robot.

    Attributes:
        speed: Largest approach speed [m/s]; None: the speed of the fastest case of each scenario.
        force: Largest mean contact force over some milliseconds [N]; None: any.
        cell: Trials allowed on a real cell; None: every trial that can be planned.
    """

    speed: float | None = None
    force: float | None = None
    cell: CellEnvelope | None = None

    def __post_init__(self) -> None:
        for key, value, unit in (("speed", self.speed, "m/s"), ("force", self.force, "N")):
            if value is not None and not value > 0.0:
                raise InputError(f"expected a limit > 0 {unit}", key=key, value=value)

    @property
    def fastest(self) -> float | None:
        """Largest approach speed of both limits [m/s]; None: no limit."""
        if self.cell is None:
            return self.speed
        return self.cell.speed if self.speed is None else min(self.speed, self.cell.speed)


NO_ENVELOPE = Envelope()


@dataclass(frozen=True)
class PossibleTrial:
    """A trial that may be planned.

    Attributes:
        scenario: Name or path of the scenario file.
        settings: Settings of the variant that replace values of the file, without the case.
        new_case: The case; None: the scenario file has it.
        spec: The trial.
        what: The trial in words.
    """

    scenario: str
    settings: Mapping[str, Any] = field(hash=False)
    new_case: Case | None = field(hash=False)
    spec: TrialSpec
    what: str

    @property
    def name(self) -> str:
        """Name of its condition."""
        return label_of(self.spec)

    @property
    def of_file(self) -> bool:
        """Whether the scenario file has this trial."""
        return not self.settings and self.new_case is None


def possible_trials(scenarios: Sequence[str], envelope: Envelope = NO_ENVELOPE) -> list[PossibleTrial]:
    """Every trial that may be planned, sorted by name.

    Args:
        scenarios: Names or paths.
        envelope: Envelope of the cell.

    Raises:
        InputError: There is no such scenario, two have one name, or the envelope of the cell allows no trial.
    """
    by_name: dict[str, PossibleTrial] = {}
    names: dict[str, str] = {}
    for path in dict.fromkeys(scenarios):
        scenario = load_scenario(path)
        if scenario.name in names:
            raise InputError(f"scenarios {names[scenario.name]!r} and {path!r} have one name, {scenario.name!r}")
        names[scenario.name] = path
        by_name |= {trial.name: trial for trial in trials_of(path, scenario, envelope)}
    trials = [by_name[name] for name in sorted(by_name)]
    return trials if envelope.cell is None else _inside(trials, envelope.cell)


def _inside(trials: Sequence[PossibleTrial], cell: CellEnvelope) -> list[PossibleTrial]:
    """The trials that the envelope of a cell allows."""
    complaints = [_complaint(trial, cell) for trial in trials]
    inside = [trial for trial, complaint in zip(trials, complaints, strict=True) if not complaint]
    if not inside:
        raise InputError(
            f"none of {len(trials)} trials lies inside the envelope, {trials[0].name} because: {complaints[0]}; "
            "raise a limit, or name further scenarios in it"
        )
    return inside


def _complaint(trial: PossibleTrial, cell: CellEnvelope) -> str:
    """Why a trial is outside the envelope of a cell, or cannot be planned; empty: it is inside."""
    try:
        return cell.complaint(trial.spec)
    except InputError as error:  # out of reach
        return str(error)


def trials_of(path: str, scenario: Scenario, envelope: Envelope = NO_ENVELOPE) -> Iterator[PossibleTrial]:
    """Every trial of one scenario that may be planned.

    Args:
        path: Its name or path.
        scenario: The scenario.
        envelope: Envelope of the cell.
    """
    cases = _cases(scenario, envelope.fastest or max(map(_speed, scenario.cases.values())))
    for settings, aside in _variants(scenario):
        yield from _of_variant(path, scenario, settings, aside, cases)
    if _side(scenario) is not None:
        for where, aside, slanted in _oblique(cases, scenario.contact.friction):
            yield from _of_variant(path, scenario, {"name": f"{scenario.name}_from_{where}"}, aside, slanted)


def _of_variant(
    path: str, scenario: Scenario, settings: Mapping[str, Any], aside: str, cases: Mapping[str, Case]
) -> Iterator[PossibleTrial]:
    """Trials of a variant: every object and case."""
    new = {name: case for name, case in cases.items() if name not in scenario.cases}
    added = {f"cases.{name}": case.model_dump(mode="json") for name, case in new.items()}
    varied = scenario.with_settings({**settings, **added})
    for name, case in cases.items():
        for item in scenario.objects:
            hit = "there and back" if scenario.excursion is not None else f"{scenario.name} of {item}"
            of_file = max((label for label in scenario.cases if name.startswith(label)), key=len)
            pose = name if name in scenario.cases else f"pose of {of_file}"
            words = f"{hit} at {_speed(case):.2g} m/s{aside} ({pose})"
            yield PossibleTrial(path, settings, new.get(name), TrialSpec.of(varied, item, name), words)


def _variants(scenario: Scenario) -> Iterator[tuple[dict[str, Any], str]]:
    """Settings and words of the variants of a scenario; the scenario itself is the first."""
    yield {}, ""
    if scenario.friction_compensation is not None:
        return
    if scenario.excursion is not None:
        start, end = np.array(scenario.excursion.start), np.array(scenario.excursion.end)
        displacement = end - start
        along = np.eye(3)[scenario.axis_index]
        mirrored = start + 2.0 * (displacement @ along) * along - displacement
        if not np.allclose(mirrored, end):
            yield (
                {
                    "name": f"{scenario.name}_mirrored",
                    "excursion.end": _rounded(mirrored),
                    "excursion.twist": -scenario.excursion.twist,
                },
                ", mirrored",
            )
        return
    side = _off_centre(scenario)
    if side is not None:
        position, distance = side
        yield (
            {"name": f"{scenario.name}_beside", "object_position": position},
            f", {1e3 * distance:.0f} mm beside the centre",
        )


def _side(scenario: Scenario) -> Array | None:
    """Horizontal unit vector along the pad of a single arm that hits an object, ``(3,)``; None: there is no such."""
    if len(scenario.robots) > 1 or scenario.excursion is not None or scenario.friction_compensation is not None:
        return None
    name, robot = next(iter(scenario.robots.items()))
    if robot.impact.joint_position is not None:
        return None
    normal = scenario.impact_placement(name, next(iter(scenario.objects))).rotation[:, 2]
    return None if abs(normal[2]) > MAX_VERTICAL_NORMAL else np.cross([0.0, 0.0, 1.0], normal)


def _oblique(cases: Mapping[str, Case], friction: float) -> Iterator[tuple[str, str, dict[str, Case]]]:
    """Oblique cases: the fastest of every pose from left and right, outside the friction cone."""
    angle = min(float(np.arctan(SLIP_FRICTION_RATIO * friction)), MAX_APPROACH_ANGLE_RAD)
    poses: dict[str, tuple[str, Case]] = {}
    for name, case in cases.items():
        if (pose := _pose(case)) not in poses or _speed(case) > _speed(poses[pose][1]):
            poses[pose] = name, case
    for where, turned in (("left", -angle), ("right", angle)):  # as seen along the approach
        words = f" from the {where}, {np.degrees(angle):.0f} degrees off the normal"
        yield where, words, {f"{name}_{where}": _rotated(case, turned) for name, case in poses.values()}


def _rotated(case: Case, angle: float) -> Case:
    """The case with all velocities rotated about the vertical [rad]."""
    turn = np.array([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])
    robots = {}
    for name, robot in case.robots.items():
        velocity = np.trunc(1e5 * turn @ np.array(robot.ante_velocity)) / 1e5  # never faster by rounding
        robots[name] = robot.model_copy(update={"ante_velocity": tuple(_rounded(velocity))})
    return case.model_copy(update={"label": f"{case.label}, at an angle", "robots": robots})


def _off_centre(scenario: Scenario) -> tuple[list[float], float] | None:
    """Object position for an off-centre hit, and its offset [m]; None if it cannot be set."""
    side = _side(scenario)
    if side is None or scenario.object_position is not None:
        return None
    placement = scenario.impact_placement(next(iter(scenario.robots)), next(iter(scenario.objects)))
    normal = placement.rotation[:, 2]
    sizes = [np.array(item.size) for item in scenario.objects.values()]
    distance = OFF_CENTRE_RATIO * min(float(np.abs(side) @ size) for size in sizes)
    depth = float(np.mean([np.abs(normal) @ size for size in sizes])) / 2.0
    centre = placement.translation + depth * normal + distance * side
    return _rounded(centre[:2]), distance


def _cases(scenario: Scenario, fastest: float) -> dict[str, Case]:
    """Cases of a scenario, and its poses at other speeds: slower than all, speeds of other cases, the limit."""
    cases = dict(scenario.cases)
    if scenario.friction_compensation is not None:  # identified for these cases alone
        return _not_faster(cases, fastest)
    speeds = sorted({round(_speed(case), 4) for case in scenario.cases.values()})
    speeds_of_poses = [SLOW_CASE_RATIO * speeds[0], *speeds]
    if fastest > speeds[-1]:
        speeds_of_poses.append(fastest)
    poses: dict[str, tuple[str, Case, set[float]]] = {}
    for name, case in scenario.cases.items():
        pose = poses.setdefault(_pose(case), (name, case, set()))
        pose[2].add(round(_speed(case), 4))
    for name, case, present in poses.values():
        for speed in speeds_of_poses:
            if round(speed, 4) not in present:
                scaled = _at_speed(case, speed / _speed(case))
                if _in_time(scenario, scaled):
                    cases[f"{name}_{1e3 * speed:.0f}mm_s"] = scaled.model_copy(
                        update={"label": f"{case.label} at {speed:.2g} m/s"}
                    )
    return _not_faster(cases, fastest)


def _not_faster(cases: Mapping[str, Case], fastest: float) -> dict[str, Case]:
    """The cases within a limit of the approach speed [m/s]."""
    return {name: case for name, case in cases.items() if _speed(case) <= fastest * (1.0 + 1e-9)}


def _in_time(scenario: Scenario, case: Case) -> bool:
    """Whether an excursion ends within the trial."""
    ends = [scenario.excursion_end(robot) for robot in case.robots.values()] if scenario.excursion is not None else []
    return all(end <= scenario.timing.duration for end in ends)


def _speed(case: Case) -> float:
    """Largest approach speed of the arms [m/s]."""
    return max(float(np.linalg.norm(robot.ante_velocity)) for robot in case.robots.values())


def _pose(case: Case) -> str:
    """Key that cases share if they differ only in speed."""
    speed = _speed(case) or 1.0
    return repr(
        [
            (
                name,
                _rounded(np.array(robot.ante_velocity) / speed),
                robot.posture_joints,
                robot.joint_1_velocity and round(robot.joint_1_velocity / speed, 6),
            )
            for name, robot in sorted(case.robots.items())
        ]
    )


def _at_speed(case: Case, factor: float) -> Case:
    """The case with all velocities times a factor."""

    def scaled(robot: CaseRobot) -> CaseRobot:
        turning = robot.joint_1_velocity
        return robot.model_copy(
            update={
                "ante_velocity": tuple(_rounded(factor * np.array(robot.ante_velocity))),
                "joint_1_velocity": None if turning is None else factor * turning,
            }
        )

    return case.model_copy(update={"robots": {name: scaled(robot) for name, robot in case.robots.items()}})


def _rounded(values: np.ndarray) -> list[float]:
    """Values rounded to five decimals, so that files stay readable."""
    return [round(float(value), 5) + 0.0 for value in values]
