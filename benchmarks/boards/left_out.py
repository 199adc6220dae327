# SPDX-License-Identifier: Apache-2.0
"""One simulator left out: nulls of a plant whose simulator the discrepancy has never seen.

The shipped discrepancy is measured on variants of Bullet, of MuJoCo and of the twin, and the boards record their nulls
on Bullet (``--on plant``) and on MuJoCo (``--on cell``), so that its nulls are those it was made from. Here it is made
anew from the table of its patterns, with the same definition, without the variants of the plant's own simulator: to
this discrepancy the plant is what a real robot is to the shipped one. Every null is diagnosed with both.
"""

from __future__ import annotations

import argparse
import csv
import time
from functools import cache

import numpy as np

from benchmarks.boards.blind import COLUMN, FIRST_SEED
from benchmarks.harness import Row, Work, quantiles, share
from benchmarks.hidden import Entry, entries, judged, plant_option, recorder, reseeded
from benchmarks.results import Table
from impact_rs_analysis.diagnosis.diagnose import diagnose
from impact_rs_analysis.diagnosis.document import write_document
from impact_rs_analysis.diagnosis.verdict import NOTHING
from impact_rs_analysis.evidence.discrepancy import PATTERNS_FILE, Discrepancy, Patterns, measured_discrepancy
from impact_rs_analysis.evidence.replays.measured_runs import read_runs
from impact_rs_analysis.evidence.replays.replay_cache import ReplayCache
from impact_rs_analysis.evidence.sources.run_source import ReplaySource
from impact_rs_sim.model import load_model
from impact_rs_sim.paths import config_directory
from impact_rs_sim.robots.robot import Array
from impact_rs_trials.blind import RUNS, make

SIMULATOR = {"plant": "bullet", "cell": "mujoco"}  # how the names of its variants begin
LEFT_OUT = 100  # added to the first seed of the blind board, whose nulls were used to choose the thresholds
LEVELS = (0.01, 0.05)


@cache
def variants_of() -> dict[str, tuple[list[str], list[tuple[str, Array]]]]:
    """By kind of trial: names of the features, and variant minus replay of every variant and condition, in units."""
    by_kind: dict[str, tuple[list[str], list[tuple[str, Array]]]] = {}
    header: list[str] = []
    with (config_directory() / PATTERNS_FILE).open(encoding="utf-8", newline="") as file:
        for kind, variant, _, *cells in csv.reader(file):
            if kind == "kind":
                header = cells
            else:
                by_kind.setdefault(kind, (header, []))[1].append((variant, np.array(cells, dtype=float)))
    return by_kind


def without(simulator: str) -> Discrepancy:
    """The shipped discrepancy, made without the variants of a simulator.

    Of every signal: the largest rms over conditions and bins among the variants that are left, and that variant's rms
    over conditions, bin by bin (``tools/discrepancy.py``).

    Args:
        simulator: How the names of its variants begin; none begins so: the shipped discrepancy comes out.
    """
    shipped, entries_, patterns = measured_discrepancy(), [], []
    for kind, (names, rows) in variants_of().items():
        remaining = [(variant, values) for variant, values in rows if not variant.startswith(simulator)]
        columns_by_signal: dict[tuple[str, str, str], list[int]] = {}
        for column, name in enumerate(names):
            phase, signal, index, _ = name.split("|")
            columns_by_signal.setdefault((phase, signal, index), []).append(column)
        for entry in (entry_ for entry_ in shipped.entries if entry_.kind == kind):
            columns = columns_by_signal[entry.phase, entry.signal, entry.index]
            by_variant = {
                name: np.array([values[columns] for variant, values in remaining if variant == name])
                for name in dict.fromkeys(variant for variant, _ in remaining)
            }
            sizes = {name: float(np.sqrt(np.mean(np.square(table)))) for name, table in by_variant.items()}
            largest = max(sizes, key=lambda name: sizes[name])
            bins = tuple(np.sqrt(np.mean(np.square(by_variant[largest]), axis=0)).tolist())
            entries_.append(
                entry.model_copy(
                    update={"value": sizes[largest], "largest": largest, "by_bin": bins, "by_variant": sizes}
                )
            )
        (shipped_patterns,) = (table for table in shipped.patterns if table.kind == kind)
        patterns.append(
            Patterns(
                kind=shipped_patterns.kind,
                features=shipped_patterns.features,
                rows=tuple(tuple(v.tolist()) for _, v in remaining),
            )
        )
    variants = {name: words for name, words in shipped.variants.items() if not name.startswith(simulator)}
    return shipped.model_copy(update={"variants": variants, "entries": tuple(entries_), "patterns": tuple(patterns)})


def add_options(parser: argparse.ArgumentParser) -> None:
    """How many nulls, and where."""
    plant_option(parser, "cell", "plant")
    parser.add_argument("--nulls", type=int, default=10, help="campaigns with nothing hidden")
    parser.add_argument("--size", default="small", choices=("small", "full"), help="size of each campaign")


def cases(options: argparse.Namespace) -> list[Entry]:
    """Nulls."""
    nulls = entries([("null", None, None)] * options.nulls, FIRST_SEED[options.on] + LEFT_OUT)
    return reseeded(nulls, options)


def run(entry: Entry, work: Work) -> Row:
    """Record a null, and diagnose it with both discrepancies."""
    folder, options = work.folder, work.options
    for _ in make(folder, entry.seed, work.map_tasks, entry.kind, size=options.size, work=recorder(options.on)):
        pass
    runs, model, cache_ = read_runs(folder / RUNS, work.map_tasks), load_model("nominal"), ReplayCache(work.map_tasks)
    documents = {}
    for name, discrepancy in (("shipped", None), ("left_out", without(SIMULATOR[options.on]))):
        began = time.process_time()
        source = ReplaySource.of(runs, model, cache_, discrepancy)
        document = diagnose(source, model)
        write_document(document, folder / f"{name}.json")
        p_values = [effect.p_value for effect in document.effects if effect.p_value is not None]
        documents[name] = judged(folder, document) | {
            "lack_of_fit": document.lack_of_fit.before,
            "least_p": min(p_values, default=1.0),
            "seconds": time.process_time() - began,
        }
    return documents | {"said": f"{documents['shipped']['verdict']} | {documents['left_out']['verdict']}"}


def table(rows: list[Row], options: argparse.Namespace) -> Table:
    """Both discrepancies beside each other."""
    sides = [[row[name] for row in rows] for name in ("shipped", "left_out")]
    lines = [
        (f"nothing hidden: `{NOTHING}`", *(share(document["correct"] for document in side) for side in sides)),
        ("nothing hidden: an effect named", *(share(bool(document["named"]) for document in side) for side in sides)),
    ]
    for level in LEVELS:
        for key, words in (("lack_of_fit", "lack of fit"), ("least_p", "smallest adjusted p of all effects")):
            shares = (share(document[key] is not None and document[key] < level for document in side) for side in sides)
            lines.append((f"{words} below {level:.0%}", *shares))
    if rows:
        lines.append(
            ("error, times repeatability", *(quantiles([document["before"] for document in side]) for side in sides))
        )
    where = COLUMN[options.on]
    return Table(("", f"{where}: shipped", f"made without {SIMULATOR[options.on]}"), tuple(lines))
