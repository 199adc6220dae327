# SPDX-License-Identifier: Apache-2.0
"""Hidden laws outside the library, looked for by ``impact-rs discover``.

Laws (:data:`impact_rs_sim.plant.unmodelled.LAWS`) at two sizes in the plant, which the compiled twin has to explain;
campaigns that hide nothing, and effects of the library, on which nothing may be proposed. ``--on laboratory`` hides a
quadratic drag, a ripple and a cable in the MuJoCo cell under another controller (:mod:`benchmarks.foreign.laws`).
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

from benchmarks.harness import Row, Work, share
from benchmarks.hidden import Entry, entries, laboratory_runs, plant_option, reseeded
from benchmarks.results import Table
from impact_rs_analysis.diagnosis.laws.discover import discover
from impact_rs_analysis.diagnosis.laws.discovery_document import DiscoveryDocument, write_discovery
from impact_rs_analysis.diagnosis.laws.grammar import load_grammar
from impact_rs_analysis.evidence.replays.measured_runs import Runs, read_runs
from impact_rs_analysis.evidence.replays.replay_cache import ReplayCache
from impact_rs_analysis.evidence.sources.run_source import ReplaySource
from impact_rs_sim.model import Model, load_model
from impact_rs_sim.plant.unmodelled import LAWS
from impact_rs_trials.blind import RUNS, make
from impact_rs_trials.workers import Map

SIZES = (4.0, 10.0)
CLEAR = 3.0  # times repeatability
LIBRARY = ("joint_coulomb_friction", "object_mass", "external_spring", "torque_gain", "support_friction", "pad_tilt")

FIRST = (
    "object_quadratic_drag", "motor4_ripple", "end_effector_cable", "motor4_cubic", "motor1_quadratic",
    "object_growing_force", "motor2_load_friction", "motor4_warm_up", "motor6_one_way",
)  # fmt: skip

FOREIGN_RIGHT = {
    "quadratic_drag": ("object_drag_square", "support_slip_square"),
    "ripple": ("motor4_position_ripple",),
    "cable": ("end_effector_y_y_below", "end_effector_y_y_above", "end_effector_x_x_above", "end_effector_cable_above"),
}

# Laws that are right: that which was hidden, and those that are equal to it.
RIGHT: dict[str, tuple[str, ...]] = {
    "object_quadratic_drag": ("object_drag_square", "support_slip_square"),
    "object_cubic_drag": ("object_drag_cube", "support_slip_cube"),
    "object_linear_drag": ("object_drag_linear",),
    "object_spring_from_place": ("object_y_y_below",),
    "object_growing_force": ("object_y_since_contact_linear", "support_since_contact_linear"),
    "motor4_ripple": ("motor4_position_ripple",),
    "motor2_ripple": ("motor2_position_ripple",),
    "motor1_quadratic": ("motor1_velocity_square",),
    "motor4_cubic": ("motor4_velocity_cube",),
    "motor2_load_friction": ("motor2_load_on_friction_linear", "joint_load_dependent_friction"),  # of the library
    "motor4_warm_up": ("motor4_warm_up_linear",),
    "motor2_gravity_like": ("motor2_position_ripple", "motor2_position_linear"),
    "motor6_one_way": ("motor6_velocity_one_way_up",),
    "motor4_stop": ("motor4_position_above",),
    "end_effector_quadratic_drag": ("end_effector_drag_square",),
    "end_effector_cable": ("end_effector_y_y_below",),
    "link3_cubic_spring": ("link3_position_cube", "link3_position_above", "link3_position_below"),
}


def add_options(parser: argparse.ArgumentParser) -> None:
    """What is hidden, and where."""
    plant_option(parser, "plant", "laboratory")
    parser.add_argument("--nulls", type=int, default=10, help="campaigns with nothing hidden")


def cases(options: argparse.Namespace) -> list[Entry]:
    """The laws that say most first."""
    nulls: list[tuple[str, str | None, float | None]] = [("null", None, None)] * options.nulls
    if options.on == "laboratory":
        from benchmarks.foreign.laws import LAWS as OF_THE_CELL

        laws = entries([("outside", name, SIZES[0]) for name in OF_THE_CELL], 5000)
        return reseeded(laws + entries(nulls, 5100), options)
    hidden: list[tuple[str, str | None, float | None]] = [("outside", name, SIZES[0]) for name in LAWS]
    hidden += [("single", name, 3.0) for name in LIBRARY] + [("outside", name, SIZES[1]) for name in LAWS] + nulls
    campaigns = sorted(entries(hidden), key=lambda entry: not (entry.effect in FIRST and entry.magnitude == SIZES[0]))
    return reseeded(campaigns, options)


def discovered(read: Callable[[], Runs], map_tasks: Map) -> DiscoveryDocument:
    """Discovery in runs by the nominal model."""
    runs, store, sources = read(), ReplayCache(map_tasks), dict[str, ReplaySource]()

    def source_of(model: Model) -> ReplaySource:
        key = " ".join(spec.name for spec in model.formulas)
        if key not in sources:
            sources[key] = ReplaySource.of(runs, model, store)
        return sources[key]

    return discover(source_of, load_model("nominal"), load_grammar())


def run(entry: Entry, work: Work) -> Row:
    """Record, search and judge one campaign."""
    runs, map_tasks = work.folder / RUNS, work.map_tasks
    if work.options.on == "laboratory":
        from benchmarks.foreign import laboratory

        laboratory.make(entry, work.folder, map_tasks)
        return judged(entry, work.folder, partial(laboratory_runs, runs, map_tasks), map_tasks)
    outsides = tuple(LAWS) if entry.kind == "outside" else ()
    recording_options = (map_tasks, entry.kind, entry.effect, "small", entry.magnitude)
    for _ in make(work.folder, entry.seed, *recording_options, outsides=outsides):
        pass
    return judged(entry, work.folder, partial(read_runs, runs, map_tasks), map_tasks)


def judged(entry: Entry, directory: Path, read: Callable[[], Runs], map_tasks: Map) -> Row:
    """Search and score one campaign."""
    started, spent = time.perf_counter(), time.process_time()
    document = discovered(read, map_tasks)
    elapsed, spent = time.perf_counter() - started, time.process_time() - spent
    write_discovery(document, directory / "discovery.json")
    right = {**RIGHT, **FOREIGN_RIGHT}.get(entry.effect or "", ())
    diagnosis = document.diagnosis
    laws = [law.name for law in document.laws]
    laws += [name for name in (() if diagnosis is None else diagnosis.named) if name in right and name not in laws]
    removed = before = 0.0
    if diagnosis is not None:
        before = diagnosis.held_out_error_before
        removed = (before**2 - diagnosis.held_out_error_after**2) / max(before**2 - diagnosis.noise_floor**2, 1e-9)
    hit = bool(set(laws) & set(right))
    return {
        "kind": entry.kind,
        "effect": entry.effect,
        "said": f"{document.verdict} {', '.join(laws)}".strip(),
        "correct": hit if entry.kind == "outside" else not laws,
        "exact": hit and len(laws) == 1,
        "first": bool(laws) and laws[0] in right,
        "found": bool(laws),
        "before": before,
        "removed": removed,
        "parameters": {law.name: law.model_dump(mode="json")["parameters"] for law in document.laws},
        "seconds": elapsed,
        "processor": spent,
    }


def table(rows: list[Row], options: argparse.Namespace) -> Table:
    """Shares of right discoveries."""
    rows_by_kind = {kind: [row for row in rows if row["kind"] == kind] for kind in ("outside", "null", "single")}
    clear = [row for row in rows_by_kind["outside"] if row["before"] > CLEAR]
    above = f"hidden laws above {CLEAR:g} × repeatability"
    removed = [row["removed"] for row in clear if row["correct"]]
    seconds = [row["processor"] for row in rows]
    lines = [
        ("hidden laws, all: the right one first or tied", share(row["correct"] for row in rows_by_kind["outside"])),
        ("hidden laws, all: the right one alone", share(row["exact"] for row in rows_by_kind["outside"])),
        (f"{above}: the right one first or tied", share(row["correct"] for row in clear)),
        (f"{above}: the right one first", share(row["first"] for row in clear)),
        (f"{above}: the right one alone", share(row["exact"] for row in clear)),
        (f"{above}: something proposed", share(row["found"] for row in clear)),
        ("nothing hidden: nothing proposed", share(not row["found"] for row in rows_by_kind["null"])),
        ("effects of the library: nothing proposed", share(not row["found"] for row in rows_by_kind["single"])),
        ("excess held-out error removed, median", f"{100.0 * statistics.median(removed):.0f} %" if removed else "–"),
        ("processor time, median", f"{statistics.median(seconds):.0f} s" if seconds else "–"),
    ]
    return Table(("", "our plant" if options.on == "plant" else "another laboratory"), tuple(lines))
