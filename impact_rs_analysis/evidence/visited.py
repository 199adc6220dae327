# SPDX-License-Identifier: Apache-2.0
"""Measured ranges of the symbols of formulas, and extrapolation of a model's laws beyond their domain."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence

import numpy as np

from impact_rs_analysis.evidence.replays.replay import WINDOW_AFTER_IMPACT_S
from impact_rs_analysis.evidence.source import Source
from impact_rs_analysis.evidence.sources.recording_source import RecordingSource
from impact_rs_sim.effects.formula import CONTACT_SYMBOLS, JOINT_SYMBOL, SYMBOLS, Formula
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_sim.rotations import AXES
from impact_rs_trials.runs import ArmSignals, Run, Signals

Range = tuple[float, float]
Symbols = dict[str, Array]  # values of symbols, (k,) each

SAMPLES_PER_RUN = 100  # at which forward kinematics are computed
RANGE_MARGIN_SHARE = 0.02  # of a range; a smaller excess is not reported
RANGE_PERCENTILES = (0.5, 99.5)  # ends of a range


def measured_ranges(
    source: Source, quantities: Iterable[str] = (), after: float = WINDOW_AFTER_IMPACT_S
) -> dict[str, Range]:
    """Range of the symbols over all runs, up to the end of the replay; without symbols that were not measured.

    Args:
        source: Measurements.
        quantities: Formulas of symbols, whose ranges are added; formulas with memory have no range.
        after: End of the evaluated time, after the first impact of a run [s].
    """
    values_of: dict[str, list[Array]] = {}
    formulas = [_formula(text) for text in quantities if text not in SYMBOLS]
    at_impacts: tuple[Symbols, list[Symbols]] = (source.contact_speeds, [{}])
    for shared, arms in (at_impacts, *(_signals(run, after) for run in _runs(source))):
        for symbols in (shared, *arms):
            for name, values in symbols.items():
                values_of.setdefault(name, []).append(values)
        for formula, signals in itertools.product(formulas, [{**shared, **symbols} for symbols in arms]):
            sizes = {signals[name].size for name in formula.names if name in signals}
            if formula.names <= signals.keys() and len(sizes) == 1 and not formula.remembers:
                values_of.setdefault(formula.text, []).append(np.asarray(formula(signals)))
    ends = {name: np.percentile(np.concatenate(arrays), RANGE_PERCENTILES) for name, arrays in values_of.items()}
    return {name: (float(low), float(high)) for name, (low, high) in ends.items()}


def _formula(text: str) -> Formula:
    return Formula(text, {*SYMBOLS, *CONTACT_SYMBOLS, *(match[0] for match in JOINT_SYMBOL.finditer(text))})


def extrapolations(source: Source) -> tuple[str, ...]:
    """Warnings on measurements outside the domain of a formula of the model."""
    model_effects = {effect.name for effect in source.model.effects}
    formulas = [spec for spec in source.model.formulas if spec.name in model_effects and spec.valid]
    ranges = measured_ranges(source) if formulas else {}
    warnings = []
    for spec in formulas:
        for symbol, (low, high) in spec.valid.items():
            least, most = ranges.get(symbol, (low, high))
            margin = RANGE_MARGIN_SHARE * (high - low)
            if least < low - margin or most > high + margin:
                warnings.append(
                    f"{spec.name} was seen for {symbol} from {low:.3g} to {high:.3g}, and these measurements reach "
                    f"from {least:.3g} to {most:.3g} (SI units): beyond, a law is extrapolated and a curve says nothing"
                )
    return tuple(warnings)


def _runs(source: Source) -> Sequence[Run]:
    if source.runs is not None:
        return source.runs.runs
    return source.recordings if isinstance(source, RecordingSource) else ()


def _signals(run: Run, after: float) -> tuple[Symbols, list[Symbols]]:
    """Symbols along a run, of time, object and every arm."""
    impacts = getattr(run, "impacts", {})
    end = min(impacts.values()) + after if impacts else np.inf
    count = np.count_nonzero(run.signals.time <= end)
    rows = slice(0, count, max(1, count // SAMPLES_PER_RUN))
    shared = {"t": run.signals.time[rows]}
    if impacts:
        shared |= _object_signals(run.signals, min(impacts.values()), after)
    return shared, [_arm_signals(arm.at(rows), run.physics.robot_model(name)) for name, arm in run.signals.arms.items()]


def _arm_signals(arm: ArmSignals, model: RobotModel) -> Symbols:
    """Symbols of an arm."""
    symbols = {
        f"{symbol}{joint}": column
        for symbol, values in (("q", arm.position), ("dq", arm.velocity), ("tau", arm.torque))
        for joint, column in enumerate(values.T if values.size else (), start=1)
    }
    pairs = list(zip(arm.position, arm.velocity, strict=True))
    positions = np.array([model.placement(q).translation for q, _ in pairs])
    speeds = np.array([model.jacobian(q)[:3] @ dq for q, dq in pairs])
    symbols.update(zip(AXES, positions.T, strict=True))
    symbols.update(zip((f"v{axis}" for axis in AXES), speeds.T, strict=True))
    return {**symbols, "speed": np.linalg.norm(speeds, axis=1)}


def _object_signals(signals: Signals, impact: float, after: float) -> Symbols:
    """Symbols of the object and its contact; empty without tracking."""
    tracked = signals.object_time <= impact + after
    if np.count_nonzero(tracked) < 3:
        return {}
    position = signals.object_position[tracked]
    velocity = np.gradient(position, signals.object_time[tracked], axis=0)
    speed = np.linalg.norm(velocity, axis=1)
    return {
        **{f"object_{axis}": column for axis, column in zip(AXES, position.T, strict=True)},
        **{f"object_v{axis}": column for axis, column in zip(AXES, velocity.T, strict=True)},
        "object_speed": speed,
        "support_slip": speed,
        "since_contact": np.array([0.0, min(after, float(signals.time[-1]) - impact)]),
    }
