# SPDX-License-Identifier: Apache-2.0
"""Distances that a hit object slid, of a real robot, followed in time order.

``--tables`` have the columns of ``data/airhockey_processed/raw`` of github.com/epfl-lasa/air_hockey, one row a hit:
``HitNumber`` (their order in time), ``RecSession``, ``IiwaNumber`` (the robot), ``HittingFlux`` phi [m/s] and
``DistanceTraveled`` D [m].

phi is the velocity that robot and object would share. Seen from it the object is a body that comes at -phi and leaves
at sqrt(2 mu g D) - phi, with mu assumed, so restitution stands for all that changes D. Compared is the error of D of
the model after the first hits, which is then frozen, and of the one that is followed.
"""

from __future__ import annotations

import argparse
import copy
import csv
import sys
from pathlib import Path

import numpy as np

from benchmarks.harness import Case, Row, Work
from benchmarks.results import Table
from impact_rs_analysis.following.follow import LEARNING_HITS, Follower
from impact_rs_analysis.following.hits import TableHitSource
from impact_rs_sim.model import load_model
from impact_rs_sim.robots.robot import Array
from impact_rs_trials.recordings.impacts.impact_table import read_impact_table

MU, GRAVITY = 0.2, 9.81  # any mu for which no hit gains energy; m/s^2
LEAST = 0.02  # m, of a hit that moved the object
HEADER = [
    "time [s]", "condition", "radius [m]", "mass [kg]", "restitution [-]",
    *(f"{name}_before [m/s]" for name in ("vx", "vy", "vz")),
    *(f"{name}_before [rad/s]" for name in ("wx", "wy", "wz")),
    *(f"{name}_after [m/s]" for name in ("vx", "vy", "vz")),
]  # fmt: skip


def hits_of(path: Path, robot: str, session: str) -> tuple[Array, Array, int]:
    """Flux and distance of hits of one robot in time order, and how many were left out because they moved nothing."""
    csv.field_size_limit(sys.maxsize)
    with path.open(newline="", encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["IiwaNumber"] == robot and session in row["RecSession"]]
    if not rows:
        sys.exit(f"{path}: no hit of robot {robot}" + (f" in a session {session}" if session else ""))
    rows.sort(key=lambda row: (row["RecSession"], int(row["HitNumber"])))
    hits = np.array([(float(row["HittingFlux"]), float(row["DistanceTraveled"])) for row in rows])
    moving = hits[hits[:, 1] > LEAST]
    return moving[:, 0], moving[:, 1], len(hits) - len(moving)


def write_table(path: Path, flux: Array, distance: Array) -> Array:
    """The hits as a table of impacts of a free body; its velocities after the hits, ``(n,)`` [m/s]."""
    after = np.sqrt(2.0 * MU * GRAVITY * distance) - flux
    assumed = float(np.median((after / flux)[:LEARNING_HITS]))
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(HEADER)
        for number, (before, velocity) in enumerate(zip(flux, after, strict=True)):
            writer.writerow(
                [number, "box", 0.05, 0.4, round(assumed, 3), 0.0, 0.0, -before, 0.0, 0.0, 0.0, 0.0, 0.0, velocity]
            )
    return np.asarray(after)


def errors_of(path: Path, flux: Array, after: Array, distance: Array) -> tuple[Array, Array, list[str]]:
    """Errors of the distance of the followed and of the frozen model [m], and the changes that were announced."""
    model = load_model("nominal")
    hit_source = TableHitSource(lambda: read_impact_table(path, None), model)
    follower, frozen = Follower(hit_source, model), None
    errors: list[tuple[float, float]] = []
    changes = []
    for hit, phi, velocity, true in zip(list(hit_source.arrived()), flux, after, distance, strict=True):
        if follower.watching:
            frozen = copy.deepcopy(follower.watch.likeliest) if frozen is None else frozen
            index = int(np.argmin(np.abs(hit.measured - velocity)))
            predictions = [
                follower.watch.hit_model.predicted(explanation, hit)
                for explanation in (follower.watch.likeliest, frozen)
            ]
            speeds = [phi + float(prediction[0][index]) for prediction in predictions if prediction is not None]
            errors.append((speeds[0] ** 2 / (2.0 * MU * GRAVITY) - true, speeds[1] ** 2 / (2.0 * MU * GRAVITY) - true))
        for document in follower.take([hit]):
            if document.change is not None:
                changes.append(document.change.words)
    followed, frozen_errors = np.array(errors).T
    return followed, frozen_errors, changes


def add_options(parser: argparse.ArgumentParser) -> None:
    """Which hits."""
    parser.add_argument("--tables", type=Path, nargs="+", required=True, help="tables with one row a hit")
    parser.add_argument("--robot", default="7", help="IiwaNumber of the hits")
    parser.add_argument("--session", default="", help="part of the name of the sessions to take (default: all)")


def cases(options: argparse.Namespace) -> list[Case]:
    """The hits of one robot in each table."""
    return [Case(f"iiwa {options.robot}, {path.stem}", path) for path in options.tables]


def run(case: Case, work: Work) -> Row:
    """Follow the hits of one table."""
    flux, distance, left_out = hits_of(case.inputs, work.options.robot, work.options.session)
    path = work.folder / "hits.csv"
    followed, frozen, changes = errors_of(path, flux, write_table(path, flux, distance), distance)
    row: Row = {"hits": len(flux), "left_out": left_out, "changes": changes}
    for name, errors in (("followed", followed), ("frozen", frozen)):
        row[name] = 1e3 * float(np.sqrt(np.mean(np.square(errors))))
        row[f"{name}_median"] = 1e3 * float(np.median(np.abs(errors)))
    return row


def table(rows: list[Row], options: argparse.Namespace) -> Table:
    """A row for each table."""
    del options
    columns = ("Hits of", "Hits", "rms error of D, followed", f"frozen after {LEARNING_HITS}", "change")
    lines = [
        (
            row["name"],
            str(row["hits"]),
            f"{row['followed']:.0f} mm",
            f"{row['frozen']:.0f} mm",
            f"{100.0 * (row['followed'] / row['frozen'] - 1.0):+.0f} %",
        )
        for row in rows
    ]
    return Table(columns, tuple(lines))
