# SPDX-License-Identifier: Apache-2.0
"""Page of one run, native or of a laboratory: 3D view, and joints and end effectors over time."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from impact_rs_analysis.evidence.tracks import OBJECT, Track, track_of_bag, track_of_recording
from impact_rs_analysis.report.animation import ReplayPart, shown_rows
from impact_rs_analysis.report.figures import (
    SERIES_COLOURS,
    TIME,
    Curve,
    Figure,
    Note,
    Panel,
)
from impact_rs_analysis.report.page import Plot, number_text, render
from impact_rs_analysis.report.plots import curves_plot
from impact_rs_sim.files import write_whole
from impact_rs_sim.robots.robot import Array, joined_units
from impact_rs_trials.bags.reader import TrialBag
from impact_rs_trials.runs import NONE, Run

MIN_CURVE_PERIODS_S = (0.001, 0.004)  # of a figure, near the impact and elsewhere
FIGURE_HEIGHT_PX = 360  # px, of a figure


@dataclass(frozen=True)
class JumpRow:
    """Velocity of one body before and after the impact.

    Attributes:
        label: The body.
        before: As text, x, y, z [m/s].
        after: As text, x, y, z [m/s].
    """

    label: str
    before: str
    after: str


@dataclass(frozen=True)
class TrialPage:
    """Content of ``trial.html.j2``.

    Attributes:
        title: Heading.
        facts: Facts about the run, as pairs of a term and a text.
        notes: Remarks of the reader.
        jumps: Velocities before and after the impact.
        replay: The run in 3D.
        plots: Figures over time.
    """

    title: str
    facts: tuple[tuple[str, str], ...]
    notes: tuple[str, ...]
    jumps: tuple[JumpRow, ...]
    replay: ReplayPart
    plots: tuple[Plot, ...]


def write_trial(bag: TrialBag, path: Path) -> Path:
    """Write the page of a recorded trial.

    Args:
        bag: The trial; ``/truth`` is not read.
        path: The page; an earlier one is replaced.

    Raises:
        BagError: As :func:`trial_page`.
        InputError: As :func:`trial_page`, or the page cannot be written.
    """
    return _write(trial_page(bag), path)


def trial_page(bag: TrialBag) -> TrialPage:
    """Content of the page of a recorded trial; ``/truth`` is not read.

    Raises:
        BagError: An arm's joint states are missing or damaged.
        InputError: The scenario in the bag cannot be read.
    """
    track, info = track_of_bag(bag), bag.info
    facts = (
        (
            "Scenario",
            f"{info.scenario}, {info.object}, {info.case_name}; post-impact reference "
            f"{number_text(info.velocity_scale)} times the prediction",
        ),
        ("Run by", "the twin in place of the plant" if info.simulator == "twin" else info.via),
        ("Outcome", f"{bag.outcome}: {bag.reason}"),
        ("Impact", "none was detected" if track.impact is None else f"detected at {track.impact:.3f} s"),
    )
    return _page(f"Trial {bag.path.name}", facts, (), track)


def write_run(run: Run, path: Path, replayed: Track | None = None, model: str = "") -> Path:
    """Write the page of a run of another controller.

    Args:
        run: The run.
        path: The page; an earlier one is replaced.
        replayed: As for :func:`run_page`.
        model: As for :func:`run_page`.

    Raises:
        InputError: The page cannot be written.
    """
    return _write(run_page(run, replayed, model), path)


def run_page(run: Run, replayed: Track | None = None, model: str = "") -> TrialPage:
    """Content of the page of a run of another controller.

    Args:
        run: The run.
        replayed: The run with its replay by a model; None: the whole run without a model.
        model: Name of the model of the replay.
    """
    track = track_of_recording(run) if replayed is None else replace(replayed, label=run.name)
    scenario, object_name, condition = run.condition_key
    motion = f"{object_name} is hit" if run.hit else "free motion"
    signals = run.signals
    recorded = [f"joints at {1.0 / run.period:.0f} Hz for {number_text(float(signals.time[-1]))} s"]
    if run.hit:
        sample_count = signals.object_time.size
        tracked = 1.0 / float(np.median(np.diff(signals.object_time))) if sample_count > 1 else 0.0
        recorded.append(f"object tracked at {tracked:.0f} Hz" if sample_count > 1 else "the object was not tracked")
    facts = [("Run", f"{motion}{f', {condition}' if condition else ''}; scenario {scenario}")]
    facts.append(("Recorded", ", ".join(recorded)))
    if run.hit:
        impact_time = track.impact
        impact_text = (
            "none was found" if impact_time is None else f"found at {impact_time:.3f} s after the first sample"
        )
        facts.append(("Impact", impact_text))
    if replayed is not None:
        facts.append(
            (
                "Model",
                f"{model}, from the measured state at the beginning of every window; the rest is left out",
            )
        )
    return _page(f"Run {run.name}", tuple(facts), run.remarks, track)


def _write(page: TrialPage, path: Path) -> Path:
    write_whole(path, render("trial.html.j2", page, replay=True))
    return path


def _page(title: str, facts: tuple[tuple[str, str], ...], notes: tuple[str, ...], track: Track) -> TrialPage:
    replay = ReplayPart.of([track])
    assert replay is not None and track.measured is not None
    return TrialPage(
        title=title,
        facts=facts,
        notes=notes,
        jumps=tuple(
            JumpRow(
                "object" if jump.body == OBJECT else f"end effector of {jump.body}",
                _text(jump.before),
                _text(jump.after),
            )
            for jump in track.measured.jumps
        ),
        replay=replay,
        plots=tuple(trial_plots(track)),
    )


def trial_plots(track: Track) -> list[Plot]:
    """Velocity of the end effector, joint velocities and joint positions, arm by arm."""
    assert track.physics is not None and track.measured is not None
    shown = shown_rows(track, *MIN_CURVE_PERIODS_S)
    plots = []
    for number, (arm, physics_of_arm) in enumerate(track.physics.arms.items()):
        of_arm = f" of {arm}" if len(track.physics.arms) > 1 else ""
        signals, units = track.measured.arms[arm], physics_of_arm.facts.units
        joints = [f"joint {joint + 1}" for joint in range(physics_of_arm.facts.joint_count)]
        position, velocity = (
            joined_units(unit)
            for unit in (
                [joint_units.position for joint_units in units],
                [joint_units.velocity for joint_units in units],
            )
        )
        for name, title, unit, labels, values in (
            (
                "velocity",
                f"Velocity of the end effector{of_arm}",
                "m/s",
                list("xyz"),
                signals.twist[:, :3] if signals.twist.size else NONE,
            ),
            ("dq", f"Joint velocities{of_arm}", velocity, joints, signals.velocity),
            ("q", f"Joint positions{of_arm}", position, joints, signals.position),
        ):
            if values.size:
                drawn = _over_time(track, shown, values, labels, unit)
                plots.append(Plot(f"{name}-{number}", drawn, title=title, zoom=True, run=0))
    return plots


def _over_time(track: Track, shown: NDArray[np.int64], values: Array, labels: list[str], unit: str) -> go.Figure:
    breaks = np.searchsorted(shown, track.starts[1:])  # a line breaks where a stretch ends
    time = np.insert(track.time[shown], breaks, np.nan)
    drawn = np.insert(values[shown].astype(float), breaks, np.nan, axis=0)
    curves = tuple(
        Curve(label, time, drawn[:, column], SERIES_COLOURS[column % len(SERIES_COLOURS)])
        for column, label in enumerate(labels)
    )
    notes = () if track.impact is None else (Note(track.impact, "impact"),)
    figure = Figure("", "", "", TIME, (Panel(f"[{unit}]", curves),), notes)
    return curves_plot(figure).update_layout(height=FIGURE_HEIGHT_PX, margin={"t": 30})


def _text(vector: Array) -> str:
    return ", ".join(f"{value:+.3f}" for value in np.asarray(vector)).replace("-", "−")
