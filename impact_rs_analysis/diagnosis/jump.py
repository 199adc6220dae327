"""First level of the comparison: the velocity jump of the impact map against the measured one.

Where trials of a set follow several post-impact velocities, the experimental estimate of the net feedback is taken
(:mod:`impact_rs_analysis.measure.fit`); else the change of velocity from just before the impact to 20 ... 40 ms after
it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from impact_rs_analysis.evidence.cluster import Cluster
from impact_rs_analysis.evidence.runs import Condition, MeasuredTrial, Runs
from impact_rs_analysis.measure.fit import FitError, fit_zero_crossing
from impact_rs_analysis.measure.net_feedback import net_feedback
from impact_rs_sim.impact_map import ImpactMapError, ImpactProblem, compute_impact_map
from impact_rs_sim.model import Model
from impact_rs_trials.bags.reader import BagError, TrialBag

ENGINE = "pinocchio"
SETTLED = 3  # time window of the end effector's velocity after the impact: 20 ... 40 ms
AXES = ("x", "y", "z")
JOINTS = "joint velocity jump"


@dataclass(frozen=True)
class JumpEntry:
    """One predicted and measured number.

    Attributes:
        scenario: Scenario.
        object: Object.
        case: Case.
        signal: What it is.
        index: Joint, axis or both.
        measured: Mean over the repeats, in ``unit``.
        predicted: By the impact map with the model's physics, in ``unit``.
        unit: Unit.
        noise: What repetition explains of a single trial, in ``unit``.
    """

    scenario: str
    object: str
    case: str
    signal: str
    index: str
    measured: float
    predicted: float
    unit: str
    noise: float

    @property
    def error(self) -> float:
        """Measured minus predicted, in ``unit``."""
        return self.measured - self.predicted

    @property
    def times_noise(self) -> float:
        """Size of the error over what repetition explains [-]."""
        return abs(self.error) / self.noise


def jump_entries(runs: Runs, measured: Sequence[Cluster], model: Model) -> tuple[list[JumpEntry], list[str]]:
    """Predicted against measured jumps of every object and case, and what could not be said.

    Args:
        runs: All usable trials.
        measured: Their features themselves by condition, with the scale that their own scatter gives.
        model: What we believe.
    """
    sets: dict[tuple[str, str, str], list[tuple[Condition, Cluster]]] = {}
    for condition, item in zip(runs.conditions, measured, strict=True):
        if item.contact:
            sets.setdefault(item.place, []).append((condition, item))
    entries: list[JumpEntry] = []
    remarks: list[str] = []
    for key, items in sets.items():
        condition, item = min(items, key=lambda entry: abs(entry[0].scale - 1.0))
        try:
            predicted = _predict(condition, model)
        except ImpactMapError as error:
            remarks.append(f"impact map of {item.name}: {error}")
            continue
        for feature, value, sigma in zip(item.features, item.mean, item.sigma, strict=True):
            known = predicted.get((feature.signal, feature.index, feature.bin))
            if feature.phase != "impact" or known is None:
                continue
            name, expected = known
            entries.append(
                JumpEntry(*key, name, feature.index, float(value * sigma), expected, feature.unit, float(sigma))
            )
        if len({entry.scale for entry, _ in items}) > 1:
            conditions = {entry for entry, _ in items}
            estimate = _estimate([trial for trial in runs.trials if trial.condition in conditions])
            if estimate is not None:
                value, noise = estimate
                axis = condition.plan.scene.scenario.axis
                after = predicted[("post-impact velocity", axis, 0)][1]
                entries.append(JumpEntry(*key, "post-impact velocity (net feedback)", axis, value, after, "m/s", noise))
    return entries, remarks


def _predict(condition: Condition, model: Model) -> dict[tuple[str, str, int], tuple[str, float]]:
    """Name and value of each predicted number, by signal, index and time window of the measured feature."""
    plan = condition.plan
    scene = replace(plan.scene, physics=model.apply(plan.scene.physics))
    problem = ImpactProblem.at_nominal_impact(scene, condition.spec.motor_inertia)
    result = compute_impact_map(problem, ENGINE)
    numbers: dict[tuple[str, str, int], tuple[str, float]] = {}
    along: list[float] = []
    for arm, state in scene.arms.items():
        label = f"{arm}." if len(scene.arms) > 1 else ""
        before = scene.models[arm].jacobian(state.position) @ state.velocity
        after = result.end_effector_twist[arm]
        along.append(float(after[scene.scenario.axis_index]))
        for number, axis in enumerate(AXES):
            change = float(after[number] - before[number])
            numbers["end-effector velocity", f"{label}{axis}", SETTLED] = ("end-effector velocity jump", change)
        for number, value in enumerate(result.joint_velocity[arm] - state.velocity):
            numbers[JOINTS, f"{label}joint{number + 1}", 0] = (JOINTS, float(value))
    for number, axis in enumerate(AXES[:2]):
        numbers["object velocity", axis, 0] = ("object velocity", float(result.object_twist[number]))
    numbers["post-impact velocity", scene.scenario.axis, 0] = ("post-impact velocity", float(np.mean(along)))
    return numbers


def _estimate(trials: Sequence[MeasuredTrial]) -> tuple[float, float] | None:
    """Zero crossing of the net feedback and a quarter of its 95 % interval [m/s]; None where there is none."""
    velocities, nets = [], []
    for trial in trials:
        try:
            feedback = net_feedback(TrialBag.open(trial.path))
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
