# SPDX-License-Identifier: Apache-2.0
"""Balls on rackets of any laws, diagnosed from one table and predicted in another.

Synthetic: every racket is drawn by its seed (restitution, constant or falling with speed; friction; with and without
tangential restitution and drilling friction), and balls bounce by the closed forms of ``test/shared/ball_impacts.py``,
with the noise that fits to real impacts leave. A diagnosis of one table says which laws act; the model with them
predicts another table of the same racket. Errors are those of tt_rackets: mean length of the error of (v_x, v_z) and
mean error of omega_y, over those of the true laws.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
from ball_impacts import Racket, ball_table, bounced

from benchmarks.harness import Case, Row, Work, draw_options, quantiles, share
from benchmarks.results import Table
from impact_rs_analysis.diagnosis.diagnose import diagnose
from impact_rs_analysis.evidence.sources.table_source import ImpactTableSource
from impact_rs_sim.model import load_model
from impact_rs_trials.recordings.impacts.impact_table import ImpactTable, read_impact_table

NOMINAL = load_model(Path("nominal"))
ALIKE = 0.01  # frictions that differ by less make no difference beyond the noise
X, Z, Y_TURNING = 0, 2, 4  # columns of a twist


def drawn(seed: int, assumed: float) -> tuple[Racket, set[str]]:
    """A racket, and the effects that name its laws beside some ``assumed`` friction and no restitution."""
    rng = np.random.default_rng(seed)
    bounce, fall = rng.uniform(0.4, 0.95), rng.choice([0.0, rng.uniform(0.01, 0.03)])
    gripping = rng.random() < 0.5
    back, back_fall = rng.uniform(0.5, 0.9), rng.uniform(0.0, 0.03)
    friction = rng.uniform(0.5, 0.9) if gripping else rng.uniform(0.1, 0.5)
    drilling, spin = rng.choice([0.0, rng.uniform(0.0005, 0.01)]), rng.uniform(0.0, 0.3)
    racket = Racket(
        lambda speed: max(0.0, bounce - fall * speed),
        friction,
        lambda slip: max(0.0, back - back_fall * slip) if gripping else 0.0,
        drilling,
        spin,
    )
    truth = {"restitution"}
    truth |= {"support_friction"} if abs(friction - assumed) > ALIKE else set()
    truth |= {"restitution_fall"} if fall else set()
    truth |= {"tangential_restitution"} if gripping else set()
    truth |= {"drilling_friction"} if drilling else set()
    return racket, truth


def errors(table: ImpactTable, predicted: np.ndarray) -> tuple[float, float]:
    """Mean length of the error of (v_x, v_z) [m/s], mean error of omega_y [rad/s]."""
    residuals = np.array([row.after for row in table.rows]) - predicted
    return float(np.mean(np.hypot(residuals[:, X], residuals[:, Z]))), float(np.mean(np.abs(residuals[:, Y_TURNING])))


def add_options(parser: argparse.ArgumentParser) -> None:
    """How many rackets, and what is assumed of them."""
    draw_options(parser, 10)
    parser.add_argument("--rows", type=int, default=540)
    parser.add_argument("--friction", type=float, default=0.3, help="assumed [-]")
    parser.add_argument("--restitution", type=float, default=0.0, help="assumed [-]")


def cases(options: argparse.Namespace) -> list[Case]:
    """A racket for each seed."""
    return [Case(f"racket_{seed}", seed) for seed in range(options.first, options.first + options.draws)]


def run(case: Case, work: Work) -> Row:
    """Diagnose one racket."""
    options, seed = work.options, case.inputs
    assumed = {"friction": options.friction, "restitution": options.restitution}
    racket, truth = drawn(seed, options.friction)
    paths = [work.folder / f"{name}.csv" for name in ("train", "test")]
    for number, path in enumerate(paths):
        ball_table(path, racket, options.rows, seed=2 * seed + number, **assumed)
    began = time.process_time()
    document = diagnose(ImpactTableSource(read_impact_table(paths[0]), NOMINAL), NOMINAL)
    seconds, named = time.process_time() - began, set(document.named)
    effects = {name: document.effect(name).parameters for name in document.named}
    added = tuple((name, tuple(p.estimate for p in parameters.values())) for name, parameters in effects.items())
    unseen = read_impact_table(paths[1])
    source = ImpactTableSource(unseen, NOMINAL)
    # Features are in contact axes; the errors are wanted in x, y, z.
    in_contact_axes = source.predicted_with(added).reshape(-1, 2, 3)
    predicted = np.einsum("nij,nki->nkj", source.entries.axes, in_contact_axes).reshape(-1, 6)
    exact = np.array([bounced(row.impact.object.twist, racket) for row in unseen.rows])
    (v, w), (least_v, least_w) = errors(unseen, predicted), errors(unseen, exact)
    missed, false = sorted(truth - named), sorted(named - truth)
    return {
        "exact": named == truth,
        "missed": bool(missed),
        "false": bool(false),
        "speed": v / least_v,
        "spin": w / least_w,
        "processor": seconds,
        "said": f"{len(truth)} laws, missed {missed or 'none'}, false {false or 'none'}",
    }


def table(rows: list[Row], options: argparse.Namespace) -> Table:
    """Shares and errors."""
    lines = [
        ("all laws named, and no other", share(row["exact"] for row in rows)),
        ("a law missed", share(row["missed"] for row in rows)),
        ("a law named that does not act", share(row["false"] for row in rows)),
        ("error of velocity over that of the true laws", quantiles([row["speed"] for row in rows])),
        ("error of spin over that of the true laws", quantiles([row["spin"] for row in rows])),
        ("processor time of a diagnosis [s]", quantiles([row["processor"] for row in rows])),
    ]
    return Table(("Rackets", f"{len(rows)} tables of {options.rows} balls"), tuple(lines))
