# SPDX-License-Identifier: Apache-2.0
"""First level of the comparison: the velocity jump of the impact map against the measured one.

The map is evaluated at the nominal impact of a native trial; for a laboratory's run, at the measured ante-impact state,
with the object moved along the contact normal into contact. The measured jump is the net-feedback estimate
(:mod:`impact_rs_analysis.measure.linear_fit`) if trials of a set have several post-impact references; else the change
of velocity from just before the impact to 20 ... 40 ms after it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from impact_rs_analysis.evidence.cluster import Cluster
from impact_rs_analysis.evidence.discrepancy import Discrepancy
from impact_rs_analysis.evidence.levels import JumpLevel, Level, root_mean_square, rounded
from impact_rs_analysis.evidence.replays.ante_impact import problem_of
from impact_rs_analysis.evidence.replays.features import SETTLED_WINDOW
from impact_rs_analysis.evidence.replays.measured_runs import MeasuredRun, Runs
from impact_rs_analysis.evidence.sources.run_source import clusters_of
from impact_rs_analysis.measure.departure import departures, object_departures
from impact_rs_analysis.measure.linear_fit import FitError, fit_zero_crossing
from impact_rs_analysis.measure.net_feedback import net_feedback
from impact_rs_sim.errors import InputError
from impact_rs_sim.impact_map import ImpactMapError, ImpactProblem, compute_impact_map
from impact_rs_sim.model import Model
from impact_rs_sim.rotations import AXES
from impact_rs_trials.bags.reader import BagError, TrialBag

JOINT_VELOCITY_JUMP = "joint velocity jump"
ROUNDED_FIELDS = ("measured", "predicted", "error", "times_noise")
LEVEL_TEXT = (
    "velocity jump of the impact map against the jump measured 20 to 40 ms after the impact, or against the "
    "net-feedback estimate. Joint velocities are listed but not counted: by then the controller has begun to move the "
    "joints"
)


def jump_level(runs: Runs, model: Model, discrepancy: Discrepancy) -> tuple[dict[str, Level], list[str]]:
    """Level ``jump`` of a comparison, and remarks on missing jumps.

    Args:
        runs: All usable runs.
        model: The model.
        discrepancy: Model discrepancy that is allowed for.
    """
    # The map does not start from each run's own state, so repeatability is the scatter of the measured numbers.
    measured, _ = clusters_of(runs, [run.measured for run in runs.runs], discrepancy)
    entries, remarks = jump_entries(runs, measured, model)
    level = Level(
        what=LEVEL_TEXT,
        times_noise=rounded(
            root_mean_square([entry.times_noise for entry in entries if entry.signal != JOINT_VELOCITY_JUMP])
        ),
        entries=tuple(
            entry.model_copy(update={key: rounded(getattr(entry, key)) for key in ROUNDED_FIELDS}) for entry in entries
        ),
    )
    return {"jump": level}, remarks


def _entry(
    key: tuple[str, str, str], signal: str, index: str, values: tuple[float, float], unit: str, noise: float
) -> JumpLevel:
    """A measured and a predicted number, in ``unit``; ``noise`` is the repeatability of a single trial."""
    measured, predicted = values
    scenario, item, case = key
    error = measured - predicted
    return JumpLevel(
        scenario=scenario,
        object=item,
        case=case,
        signal=signal,
        index=index,
        measured=measured,
        predicted=predicted,
        error=error,
        unit=unit,
        times_noise=abs(error) / noise,
    )


def jump_entries(runs: Runs, measured: Sequence[Cluster], model: Model) -> tuple[list[JumpLevel], list[str]]:
    """Predicted against measured jumps of every object and case, not rounded, and remarks on missing ones.

    Args:
        runs: All usable runs.
        measured: Measured features by condition, scaled by their own scatter.
        model: The model.
    """
    sets: dict[tuple[str, str, str], list[tuple[list[MeasuredRun], Cluster]]] = {}
    for group, item in zip(runs.conditions.values(), measured, strict=True):
        if item.contact:
            sets.setdefault(item.condition_key, []).append((group, item))
    entries: list[JumpLevel] = []
    remarks: list[str] = []
    for key, items in sets.items():
        group, item = min(items, key=lambda entry: abs(_scale(entry[0][0]) - 1.0))
        try:
            predicted = _predict(group, model)
        except (ImpactMapError, InputError) as error:
            remarks.append(f"impact map of {item.name}: {error}")
            continue
        for feature, value, sigma in zip(item.features, item.mean, item.sigma, strict=True):
            prediction = predicted.get((feature.signal, feature.index, feature.bin))
            if feature.phase != "impact" or prediction is None:
                continue
            name, expected = prediction
            entries.append(
                _entry(key, name, feature.index, (float(value * sigma), expected), feature.unit, float(sigma))
            )
        spec = group[0].spec
        if spec is not None:
            remarks += _left_the_pad(key, [run for entry, _ in items for run in entry])
        if spec is not None and len({_scale(entry[0]) for entry, _ in items}) > 1:
            estimate = _estimate([run for entry, _ in items for run in entry])
            if estimate is not None:
                value, noise = estimate
                axis = spec.scene.scenario.axis
                after = predicted[("post-impact velocity", axis, 0)][1]
                entries.append(_entry(key, "post-impact velocity (net feedback)", axis, (value, after), "m/s", noise))
    return entries, remarks


def _left_the_pad(key: tuple[str, str, str], runs: Sequence[MeasuredRun]) -> list[str]:
    """Warnings if an object leaves the pad; the impact map assumes that it stays."""
    movements = []
    for run in runs:
        try:
            bag = TrialBag.open(run.path)
            movements.append(departures(bag, {arm: bag.controller(arm) for arm in run.physics.arms}))
        except BagError:
            continue
    return [f"{departed.object} {departed.case}: {departed.words}" for departed in object_departures({key: movements})]


def _scale(run: MeasuredRun) -> float:
    """Post-impact reference velocity over predicted velocity [-]; 1 where there is no reference."""
    return 1.0 if run.spec is None else run.spec.scale


def _predict(group: Sequence[MeasuredRun], model: Model) -> dict[tuple[str, str, int], tuple[str, float]]:
    """Name and mean of each predicted number, by signal, index and time window of the measured feature."""
    first = group[0]
    if first.spec is not None:
        scene = first.spec.scene
        physics = model.apply(scene.physics)
        problems = [ImpactProblem.at_nominal_impact(replace(scene, physics=physics), first.spec.motor_inertia)]
    else:
        physics = model.apply(first.setup.physics)
        problems = [problem_of(run, physics) for run in group]
    numbers = [_numbers(problem, first) for problem in problems]
    return {
        key: (name, float(np.mean([numbers_of_run[key][1] for numbers_of_run in numbers])))
        for key, (name, _) in numbers[0].items()
    }


def _numbers(problem: ImpactProblem, run: MeasuredRun) -> dict[tuple[str, str, int], tuple[str, float]]:
    result = compute_impact_map(problem)
    numbers: dict[tuple[str, str, int], tuple[str, float]] = {}
    along: list[float] = []
    for arm, state in problem.arms.items():
        label = f"{arm}." if len(problem.arms) > 1 else ""
        before = run.setup.physics.robot_model(arm).jacobian(state.position) @ state.velocity
        after = result.end_effector_twist[arm]
        along.append(float(after[run.axis]))
        for number, axis in enumerate(AXES):
            change = float(after[number] - before[number])
            numbers["end-effector velocity", f"{label}{axis}", SETTLED_WINDOW] = ("end-effector velocity jump", change)
        for number, value in enumerate(result.joint_velocity[arm] - state.velocity):
            numbers[JOINT_VELOCITY_JUMP, f"{label}joint{number + 1}", 0] = (JOINT_VELOCITY_JUMP, float(value))
    for number, axis in enumerate(AXES[:2]):
        numbers["object velocity", axis, 0] = ("object velocity", float(result.object_twist[number]))
    numbers["post-impact velocity", AXES[run.axis], 0] = ("post-impact velocity", float(np.mean(along)))
    return numbers


def _estimate(runs: Sequence[MeasuredRun]) -> tuple[float, float] | None:
    """Zero crossing of the net feedback and a quarter of its 95 % interval [m/s]; None where there is none."""
    velocities, nets = [], []
    for run in runs:
        try:
            feedback = net_feedback(TrialBag.open(run.path))
        except BagError:
            continue
        velocities.append(feedback.info.reference_post_velocity)
        nets.append(feedback.net)
    try:
        fitted = fit_zero_crossing(np.array(velocities), np.array(nets))
    except FitError:
        return None
    if fitted.interval is None:
        return None
    return fitted.estimate, max((fitted.interval[1] - fitted.interval[0]) / 4.0, 1e-6)
