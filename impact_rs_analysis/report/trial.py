# SPDX-License-Identifier: Apache-2.0
"""Page of one trial: the run in 3D, and its joints and end effectors over time."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from impact_rs_analysis.evidence.animation import OBJECT, Animation, animation_of_bag
from impact_rs_analysis.report.animation import ReplayPart, shown_rows
from impact_rs_analysis.report.figures import (
    BLACK,
    BLUE,
    GREEN,
    ORANGE,
    PURPLE,
    RED,
    SKY,
    TIME,
    Curve,
    Figure,
    Note,
    Panel,
)
from impact_rs_analysis.report.page import Plot, render
from impact_rs_analysis.report.plots import curves_plot
from impact_rs_sim.files import write_whole
from impact_rs_sim.robot import Array, told_units
from impact_rs_trials.bags.reader import TrialBag
from impact_rs_trials.bags.trial_info import TrialInfo

STRIDES = (0.001, 0.004)  # s between samples of a figure at least, about the impact and elsewhere
COLOURS = (BLUE, ORANGE, GREEN, RED, PURPLE, SKY, BLACK)
HEIGHT = 360  # px, of a figure


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
    """What ``trial.html.j2`` shows.

    Attributes:
        title: Heading.
        info: Identity of the trial.
        outcome: How it ended.
        reason: What that means.
        impact: Begin of the impact as the controller detected it [s]; None: none was.
        jumps: Velocities before and after it.
        replay: The run in 3D.
        plots: Figures over time.
    """

    title: str
    info: TrialInfo
    outcome: str
    reason: str
    impact: float | None
    jumps: tuple[JumpRow, ...]
    replay: ReplayPart
    plots: tuple[Plot, ...]


def write_trial(bag: TrialBag, path: Path) -> Path:
    """Write the page of a recorded trial.

    Args:
        bag: The trial; nothing below ``/truth`` is read.
        path: The page; an earlier one is replaced.

    Raises:
        BagError: An arm's joint states are missing or damaged.
        InputError: The scenario in the bag cannot be read, or the page cannot be written.
    """
    animation = animation_of_bag(bag)
    replay = ReplayPart.of([animation])
    assert replay is not None
    page = TrialPage(
        title=f"Trial {bag.path.name}",
        info=bag.info,
        outcome=bag.outcome,
        reason=bag.reason,
        impact=animation.impact,
        jumps=tuple(
            JumpRow(
                "object" if jump.body == OBJECT else f"end effector of {jump.body}",
                _text(jump.before),
                _text(jump.after),
            )
            for jump in animation.measured.jumps
        ),
        replay=replay,
        plots=tuple(trial_plots(animation)),
    )
    write_whole(path, render("trial.html.j2", page, replay=True))
    return path


def trial_plots(animation: Animation) -> list[Plot]:
    """Velocity of the end effector, joint velocities and joint positions, arm by arm."""
    shown = shown_rows(animation, *STRIDES)
    found = []
    for number, (arm, own) in enumerate(animation.physics.arms.items()):
        of_arm = f" of {arm}" if len(animation.physics.arms) > 1 else ""
        moved, units = animation.measured, own.facts.units
        joints = [f"joint {joint + 1}" for joint in range(own.facts.joint_count)]
        position, velocity = (told_units(unit) for unit in ([u.position for u in units], [u.velocity for u in units]))
        for name, title, unit, labels, values in (
            ("velocity", f"Velocity of the end effector{of_arm}", "m/s", list("xyz"), moved.velocities.get(arm)),
            ("dq", f"Joint velocities{of_arm}", velocity, joints, moved.rates.get(arm)),
            ("q", f"Joint positions{of_arm}", position, joints, moved.joints[arm]),
        ):
            if values is not None:
                drawn = _over_time(animation, shown, values, labels, unit)
                found.append(Plot(f"{name}-{number}", drawn, title=title, zoom=True, run=0))
    return found


def _over_time(
    animation: Animation, shown: NDArray[np.int64], values: Array, labels: list[str], unit: str
) -> go.Figure:
    curves = tuple(
        Curve(label, animation.time[shown], values[shown, column], COLOURS[column % len(COLOURS)])
        for column, label in enumerate(labels)
    )
    notes = () if animation.impact is None else (Note(animation.impact, "impact"),)
    figure = Figure("", "", "", TIME, (Panel(f"[{unit}]", curves),), notes)
    return curves_plot(figure).update_layout(height=HEIGHT, margin={"t": 30})


def _text(vector: Array) -> str:
    return ", ".join(f"{value:+.3f}" for value in np.asarray(vector)).replace("-", "−")
