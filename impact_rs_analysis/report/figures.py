# SPDX-License-Identifier: Apache-2.0
"""Description of the figures, from which both HTML and PNG are drawn.

Texts are Unicode with HTML's ``<sub>``, which the PNG side translates.
"""

from __future__ import annotations

import re
from collections import defaultdict
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from impact_rs_analysis.measure.analyze import ExperimentSet
from impact_rs_analysis.measure.net_feedback import TrialFeedback
from impact_rs_sim.numbers import estimate_text, speed_text
from impact_rs_sim.physics import MOTOR_INERTIA_MODELS
from impact_rs_sim.robots.robot import Array

# Okabe and Ito's palette: distinct in all common kinds of colour vision, and in grey by lightness.
BLUE, SKY, BLACK, ORANGE, RED, GREEN, PURPLE = (
    "#0072B2",
    "#56B4E9",
    "#000000",
    "#E69F00",
    "#D55E00",
    "#009E73",
    "#CC79A7",
)
SERIES_COLOURS = (BLUE, ORANGE, GREEN, RED, PURPLE, SKY, BLACK)  # of curves side by side, in this order
SCALE_COLOURS = (BLUE, SKY, BLACK, ORANGE, RED)
MODEL_STYLE = {
    "reduced": ("Prediction, B<sub>θ</sub> (nominal)", BLUE, "square"),
    "rotor": ("Prediction, B<sub>ρ</sub>", RED, "triangle-up"),
    "zero": ("Prediction, B = 0", GREEN, "diamond"),
}
TIME = "time [s]"  # label of an x axis
SHOWN_BEFORE, SHOWN_AFTER = 0.1, 0.1  # s, shown around the window from t1 to t2

Line = Literal["solid", "dashed", "none"]
Marker = Literal["", "circle", "square", "diamond", "triangle-up"]


@dataclass(frozen=True)
class Curve:
    """One line or point cloud.

    Attributes:
        label: Legend text; empty: not in the legend.
        x, y: Points, ``(k,)``.
        colour: Hex colour.
        line: Line style.
        marker: Symbol of the points.
        error: Half widths of horizontal error bars, low and high, in units of x.
    """

    label: str
    x: Array
    y: Array
    colour: str
    line: Line = "solid"
    marker: Marker = ""
    error: tuple[float, float] | None = None


@dataclass(frozen=True)
class Note:
    """A vertical line with a label above the panel's top."""

    x: float
    label: str


@dataclass(frozen=True)
class Panel:
    """One pair of axes; the panels of a figure share their x axis.

    Attributes:
        y_label: Quantity and unit.
        curves: The curves.
        y_range: Limits of the y axis; None: from the data.
    """

    y_label: str
    curves: tuple[Curve, ...]
    y_range: tuple[float, float] | None = None


@dataclass(frozen=True)
class Figure:
    """One figure.

    Attributes:
        name: File name without ending.
        title: One line above it.
        caption: Explanation in two or three sentences.
        x_label: Quantity and unit.
        panels: From top to bottom.
        notes: Vertical lines through all panels.
        x_range: Limits of the x axis; None: from the data.
    """

    name: str
    title: str
    caption: str
    x_label: str
    panels: tuple[Panel, ...]
    notes: tuple[Note, ...] = field(default=())
    x_range: tuple[float, float] | None = None

    @property
    def over_time(self) -> bool:
        """Whether its x axis is the time of a trial."""
        return self.x_label == TIME


def figures_of(entry: ExperimentSet, contact: str = "first", band: tuple[float, float] | None = None) -> list[Figure]:
    """The paper's two figures for one set.

    Args:
        entry: The set.
        contact: Predictions that are shown: for the ``first`` or the ``settled`` contact.
        band: Systematic band about the estimate, low then high [%].
    """
    return [signals_figure(entry), fit_figure(entry, contact, band)]


def _stem(entry: ExperimentSet) -> str:
    """Stem of the file names of its figures, safe for any name in a bag."""
    return re.sub(r"[^A-Za-z0-9_-]", "_", f"{entry.scenario}__{entry.object}__{entry.case}")


def _colours(count: int) -> list[str]:
    """Colours from slow to fast, picked from five, or interpolated for larger counts."""
    if count == 1:
        return [BLACK]
    if count <= len(SCALE_COLOURS):
        indices = np.round(np.linspace(0, len(SCALE_COLOURS) - 1, count)).astype(int)
        return [SCALE_COLOURS[index] for index in indices]
    anchors = np.array([[int(colour[i : i + 2], 16) for i in (1, 3, 5)] for colour in SCALE_COLOURS])
    positions = np.linspace(0, len(anchors) - 1, count)
    channels = [np.interp(positions, np.arange(len(anchors)), anchors[:, i]) for i in range(3)]
    return ["#" + "".join(f"{round(value):02x}" for value in colour) for colour in zip(*channels, strict=True)]


def signals_figure(entry: ExperimentSet) -> Figure:
    """Velocity, feedback and its integral over time (paper fig. Single_trial_results_push).

    Signals are averaged over the repeats of a scale; dashed: velocity reference, ante-impact up to T_nom and
    post-impact from there.
    """
    axis = entry.axis
    groups: dict[float, list[TrialFeedback]] = defaultdict(list)
    for trial in entry.trials:
        groups[round(trial.info.velocity_scale, 6)].append(trial)
    info = entry.trials[0].info
    start, end, impact = info.window_start, info.window_end, info.nominal_impact_time
    all_times = entry.trials[0].time
    time = all_times[(all_times >= start - SHOWN_BEFORE - 1e-9) & (all_times <= end + SHOWN_AFTER + 1e-9)]
    curves: tuple[list[Curve], list[Curve], list[Curve]] = ([], [], [])
    scales = sorted(groups)
    for scale, colour in zip(scales, _colours(len(scales)), strict=True):
        trials = groups[scale]

        def average(name: str, trials: list[TrialFeedback] = trials) -> Array:
            return np.mean([np.interp(time, trial.time, getattr(trial, name)) for trial in trials], axis=0)

        label = f"{scale:g} v<sub>pred</sub>"
        reference = np.where(time < impact, average("ante_reference"), average("post_reference"))
        curves[0].append(Curve(label, time, average("velocity"), colour))
        curves[0].append(Curve("", time, reference, colour, line="dashed"))
        curves[1].append(Curve("", time, average("feedback"), colour))
        curves[2].append(Curve("", time, average("integral"), colour))
    curves[0].append(Curve("dashed: reference", np.array([]), np.array([]), "#555555", line="dashed"))
    counts = {len(trials) for trials in groups.values()}
    repeats = f"{counts.pop()}" if len(counts) == 1 else f"{min(counts)} to {max(counts)}"
    return Figure(
        name=f"{_stem(entry)}__signals",
        title=f"{entry.label} – velocity and feedback along {axis}",
        caption=(
            "Measured end-effector velocity, feedback acceleration and its integral since t<sub>1</sub>, averaged "
            f"over {repeats} trial{'' if repeats == '1' else 's'} per post-impact reference. The reference that fits "
            "the natural velocity jump needs no net feedback: its integral ends at zero at t<sub>2</sub>."
        ),
        x_label=TIME,
        panels=(
            Panel(f"v<sub>{axis}</sub> [m/s]", tuple(curves[0])),
            Panel(f"a<sub>fb,{axis}</sub> [m/s²]", tuple(curves[1])),
            Panel(f"∫ a<sub>fb,{axis}</sub> dt [m/s]", tuple(curves[2])),
        ),
        notes=(Note(start, "t<sub>1</sub>"), Note(impact, "T<sub>nom</sub>"), Note(end, "t<sub>2</sub>")),
        x_range=(float(time[0]), float(time[-1])),
    )


def fit_figure(entry: ExperimentSet, contact: str = "first", band: tuple[float, float] | None = None) -> Figure:
    """Net feedback over post-impact reference velocity (paper fig. Fit_results_push), see :func:`figures_of`."""
    axis, fit = entry.axis, entry.fit
    x = np.array([trial.info.reference_post_velocity for trial in entry.trials])
    y = np.array([trial.net for trial in entry.trials])
    predictions = entry.of_contact(contact)
    predicted = [predictions[model].velocity for model in MOTOR_INERTIA_MODELS]
    low, high = min(*x, *predicted, fit.estimate), max(*x, *predicted, fit.estimate)
    margin = 0.06 * (high - low)
    ends = np.array([low - margin, high + margin])
    curves = [
        Curve("Trials", x, y, PURPLE, line="none", marker="circle"),
        Curve(f"Linear fit, R² = {fit.r_squared:.4f}", ends, fit.at(ends), "#777777"),
    ]
    for model in MOTOR_INERTIA_MODELS:
        name, colour, marker = MODEL_STYLE[model]
        velocity, mismatch = predictions[model].velocity, predictions[model].error
        label = f"{name}: {entry.sign * velocity:.3f} m/s ({mismatch:+.2f} %)".replace("-", "−")
        curve = Curve(label, np.array([velocity]), np.zeros(1), colour, line="none", marker=marker)  # type: ignore[arg-type]
        curves.append(curve)
    # Intervals are drawn below the zero line and away from the fitted line, where no markers cover them.
    depth = -0.08 * (np.max(y) - np.min(y)) * np.ones(2)
    if contact == "first" and entry.prediction_interval is not None:
        low, high = sorted(entry.sign * bound for bound in entry.prediction_interval)
        label = "B<sub>θ</sub>, 95 %: {} to {} m/s".format(*estimate_text(low, (low, high), least=3)[1:])
        curves.append(Curve(label.replace("-", "−"), np.array(entry.prediction_interval), depth, BLUE))
    if band is not None:
        label = f"Systematic band: {band[0]:+.1f} % to {band[1]:+.1f} %".replace("-", "−")
        curves.append(Curve(label, fit.estimate * (1.0 + np.array(band) / 100.0), 1.5 * depth, BLACK))
    curves.append(_estimate_curve(entry))
    return Figure(
        name=f"{_stem(entry)}__fit",
        title=f"{entry.label} – net feedback over post-impact reference",
        caption=(
            "Net feedback of every trial with impact. The line's zero crossing is the experimental estimate of the "
            "post-impact velocity; its 95 % interval follows from the scatter of the trials (Fieller). The closer a "
            f"prediction lies to it, the better its motor-inertia model. Predictions are for the {contact} contact"
            + (
                "; the prediction with B<sub>θ</sub> has the 95 % interval of the scenario's uncertainties."
                if contact == "first" and entry.prediction_interval is not None
                else "."
            )
        ),
        x_label=f"post-impact reference velocity v<sub>{axis}</sub> [m/s]",
        panels=(Panel(f"a<sub>fb,net,{axis}</sub> [m/s]", tuple(curves)),),
        x_range=(float(ends[0]), float(ends[1])),
    )


def _estimate_curve(entry: ExperimentSet) -> Curve:
    """The experimental estimate on the zero line, with its interval."""
    fit, error, estimate = entry.fit, None, f"{entry.estimate:.3f} m/s, no 95 % interval"
    if fit.interval is not None:
        error = (fit.estimate - fit.interval[0], fit.interval[1] - fit.estimate)
        estimate = " ± ".join(speed_text(entry.estimate, max(error))) + " m/s (95 %)"
    label = f"Experimental estimate: {estimate}"
    return Curve(label, np.array([fit.estimate]), np.zeros(1), BLACK, line="none", marker="circle", error=error)
