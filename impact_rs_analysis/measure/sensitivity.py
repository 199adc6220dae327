# SPDX-License-Identifier: Apache-2.0
"""Systematic uncertainty of an estimate: its change with settings on which it should not depend.

Let x0 be the zero crossing of some trials of a campaign, and x0(k) the zero crossing with setting k at another value
(:mod:`impact_rs_trials.varied_settings`, same seeds; the window is varied in the analysis of the recorded trials):

    s_k = (x0(k) - x0) / x0,    band = [-sqrt(sum over k of min(s_k, 0)^2), +sqrt(sum over k of max(s_k, 0)^2)]

with the lowest and the highest s_k of every setting. Settings are independent choices, so their shifts are added in
squares.
The band is no confidence interval, but the possible difference between two laboratories with different settings, for
the same robot and object.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from impact_rs_analysis.measure.linear_fit import FitError, fit_zero_crossing
from impact_rs_analysis.measure.net_feedback import TrialFeedback, zero_order_hold_integral
from impact_rs_trials.varied_settings import SETTINGS

WINDOW_SETTING = "window"
WINDOW_FACTORS = (2.0 / 3.0, 4.0 / 3.0)  # of the time after the nominal impact; twice would be longer than a trial
LABELS = {setting.name: setting.label for setting in SETTINGS} | {WINDOW_SETTING: "end of the window after the impact"}

Set = tuple[str, str]  # scenario and object
Key = tuple[str, str, str, float, int]  # scenario, object, case, scale and seed: identifies the unvaried trial
Point = tuple[float, float]  # reference velocity and net feedback [m/s]


@dataclass(frozen=True)
class Shift:
    """Change of the estimate of one object with one value of one setting.

    Attributes:
        scenario: Name of the scenario.
        object: Name of the object.
        setting: Name of the setting.
        factor: Its value over the value of the campaign [-].
        percent: Change of the estimate [%].
    """

    scenario: str
    object: str
    setting: str
    factor: float
    percent: float


@dataclass(frozen=True)
class Sensitivity:
    """Shifts of the estimates of a campaign.

    Attributes:
        shifts: One per object, setting and value.
        missing: Settings that could not be evaluated, with the reason.
    """

    shifts: tuple[Shift, ...] = ()
    missing: tuple[tuple[str, str], ...] = ()

    def __add__(self, other: Sensitivity) -> Sensitivity:
        return Sensitivity(self.shifts + other.shifts, self.missing + other.missing)

    def of(self, scenario: str, object_name: str) -> dict[str, dict[float, float]]:
        """s_k of an object, by setting and factor [%]."""
        by_setting: dict[str, dict[float, float]] = {}
        for shift in self.shifts:
            if (shift.scenario, shift.object) == (scenario, object_name):
                by_setting.setdefault(shift.setting, {})[shift.factor] = shift.percent
        return by_setting

    def band(self, scenario: str, object_name: str) -> tuple[float, float] | None:
        """Band about the estimates of an object, low then high [%]; None if no setting was varied."""
        settings = self.of(scenario, object_name).values()
        if not settings:
            return None
        low, high = (
            float(np.sqrt(sum(max(sign * value for value in (0.0, *values.values())) ** 2 for values in settings)))
            for sign in (-1.0, 1.0)
        )
        return -low, high

    def to_json(self) -> list[dict[str, Any]]:
        """The list ``sensitivity`` of ``analyze --json``."""
        return [vars(shift) for shift in self.shifts]


def sensitivity_of(
    trials: Sequence[TrialFeedback], varied: Mapping[tuple[str, float], Sequence[TrialFeedback]]
) -> Sensitivity:
    """Sensitivity of the estimates of a campaign to settings.

    Args:
        trials: The campaign.
        varied: Trials with a setting at another value, by name of the setting and factor.
    """
    unvaried = {_key(trial): trial for trial in trials if trial.impact}
    paired: dict[Set, dict[Key, TrialFeedback]] = defaultdict(dict)
    comparisons: list[tuple[Set, str, float, list[Point], list[Point]]] = []
    missing = []
    for (setting, factor), varied_trials in varied.items():
        pairs: dict[Set, list[Key]] = defaultdict(list)
        by_key = {_key(trial): trial for trial in varied_trials if trial.impact}
        for key in unvaried:
            if key in by_key:
                pairs[key[:2]].append(key)
                paired[key[:2]][key] = unvaried[key]
        if not pairs:
            missing.append((setting_words(setting, factor), "no trial with impact to compare with"))
        for object_key, keys in pairs.items():
            before, after = ([_point(side[key]) for key in keys] for side in (unvaried, by_key))
            comparisons.append((object_key, setting, factor, before, after))
    for object_key, by_trial in paired.items():
        points = [_point(trial) for trial in by_trial.values()]
        for factor in WINDOW_FACTORS:
            shifted_window = [(_point(trial)[0], _net(trial, factor)) for trial in by_trial.values()]
            comparisons.append((object_key, WINDOW_SETTING, factor, points, shifted_window))
    shifts = []
    for (scenario, object_name), setting, factor, before, after in comparisons:
        try:
            percent = 100.0 * (_crossing(after) / _crossing(before) - 1.0)
            shifts.append(Shift(scenario, object_name, setting, factor, percent))
        except FitError as error:
            missing.append((f"{setting_words(setting, factor)}, {object_name}", str(error)))
    return Sensitivity(tuple(shifts), tuple(missing))


def setting_words(setting: str, factor: float) -> str:
    """A setting at another value, in words."""
    return f"{LABELS.get(setting, setting)} × {factor:.3g}"


def _key(trial: TrialFeedback) -> Key:
    info = trial.info
    return info.scenario, info.object, info.case_name, info.velocity_scale, info.seed


def _point(trial: TrialFeedback) -> Point:
    return trial.info.reference_post_velocity, trial.net


def _crossing(points: Sequence[Point]) -> float:
    return fit_zero_crossing(*np.array(points).T).estimate


def _net(trial: TrialFeedback, factor: float) -> float:
    """Net feedback in a window that ends earlier or later after the nominal impact [m/s]."""
    info = trial.info
    end = info.nominal_impact_time + factor * (info.window_end - info.nominal_impact_time)
    return zero_order_hold_integral(trial.time, trial.feedback, info.window_start, min(end, info.duration))[1]
