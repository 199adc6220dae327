# SPDX-License-Identifier: Apache-2.0
"""Coverage of intervals from recordings: payload and friction, with an unmodelled friction in the data.

A Franka arm with 0.7 kg at its flange swings for 36 s, each joint at two frequencies; motions, friction and the scale
of each joint's torque (``--scale``, a standard deviation) are drawn anew. Coulomb friction, viscous friction and the
payload are fitted. What the fit does not have is

* nothing,
* a friction of 3 % of the load of the joint,
* a ripple of 0.4 N m,
* a friction that grows with the square of the speed, 1 N m s^2/rad^2.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np
from joint_recordings import swinging, write_npz

from benchmarks.harness import Case, Row, Work, draw_options, map_draws
from benchmarks.results import Table
from impact_rs_analysis.diagnosis.diagnose import effects_for
from impact_rs_analysis.diagnosis.search.effect_selection import Search
from impact_rs_analysis.diagnosis.search.fit import Evidence, replay_and_refit
from impact_rs_analysis.evidence.sources.recording_source import RecordingSource
from impact_rs_sim.model import Model
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_trials.recordings.mapping import load_mapping
from impact_rs_trials.recordings.recording import read_recordings

MAPPING = load_mapping("joint_state")
FITTED = ["joint_coulomb_friction", "joint_viscous_friction", "end_effector_payload"]
LEFT_OUT = ("nothing", "load", "ripple", "square")
MASS = 0.7  # kg
CENTRE = np.array([0.0, -0.3, 0.0, -2.0, 0.0, 1.8, 0.5])  # rad
NOISE = 0.05  # N m
JOINTS = 7


def draw_case(case: Case, options: argparse.Namespace, seed: int) -> list[bool]:
    """Whether the interval holds the truth, of friction, mass, centre and gyration, ``(2 n + 5,)``."""
    left_out, scale = case.name, options.scale
    rng = np.random.default_rng(seed)
    end = MAPPING.end_effector.model_copy(update={"mass": MASS}).build()
    frequencies = rng.uniform(0.08, 0.25, JOINTS), rng.uniform(0.25, 0.45, JOINTS)
    centre = CENTRE + rng.uniform(-0.3, 0.3, JOINTS)
    columns = swinging(RobotModel(MAPPING.facts, end), np.arange(0.0, 36.0, 0.02), centre, frequencies, (0.4, 0.12))
    position, velocity, torque = (columns[name] for name in ("position", "velocity", "effort"))
    coulomb, viscous = rng.uniform(0.2, 0.5, JOINTS), rng.uniform(0.2, 0.6, JOINTS)
    direction = np.tanh(velocity / 0.005)
    friction = coulomb * direction + viscous * velocity
    if left_out == "load":
        friction += 0.03 * np.abs(torque) * direction
    if left_out == "ripple":
        friction += 0.4 * np.sin(12.0 * position + rng.uniform(0.0, 2.0 * np.pi, JOINTS))
    if left_out == "square":
        friction += velocity * np.abs(velocity)
    measured = (torque + friction) * (1.0 + scale * rng.standard_normal(JOINTS))
    measured += rng.normal(0.0, NOISE, measured.shape)
    with tempfile.TemporaryDirectory() as folder:
        path = write_npz(Path(folder) / "recording.npz", columns | {"effort": measured})
        source = RecordingSource.of(read_recordings(path, MAPPING), MAPPING, Model(name="nominal"))
    fitted = Search(effects_for(source, FITTED), Evidence.of(source)).fitted(FITTED)
    assert fitted is not None
    fitted = replay_and_refit(fitted)
    truth = np.concatenate((coulomb, viscous, [MASS, 0.0, 0.0, 0.0, 0.0]))  # a point mass
    return list(np.abs(fitted.estimate - truth) <= fitted.half_widths * fitted.candidate.scale)


def add_options(parser: argparse.ArgumentParser) -> None:
    """How many draws, and of which scale."""
    draw_options(parser, 100)
    parser.add_argument("--scale", type=float, default=0.01, help="standard deviation of the torque's scale")


def cases(options: argparse.Namespace) -> list[Case]:
    """Frictions that the fit does not have."""
    del options
    return [Case(name) for name in LEFT_OUT]


def run(case: Case, work: Work) -> Row:
    """Shares of intervals that hold the truth [%]; friction where its truth is defined."""
    inside = 100.0 * np.array(map_draws(draw_case, case, work.options, work.map_tasks))
    friction = inside[:, : 2 * JOINTS].mean() if case.name in ("nothing", "ripple") else None
    return {"friction": friction, "mass": inside[:, 2 * JOINTS].mean(), "centre": inside[:, 2 * JOINTS + 1 : -1].mean()}


def table(rows: list[Row], options: argparse.Namespace) -> Table:
    """A row for each friction that is left out."""
    columns = ("Not in the fit", "friction [%]", "mass [%]", "centre of mass [%]", "recordings")
    cells = (
        [row["name"], *("–" if row[key] is None else f"{row[key]:.0f}" for key in ("friction", "mass", "centre"))]
        for row in rows
    )
    return Table(columns, tuple((*line, str(options.draws)) for line in cells))
