# SPDX-License-Identifier: Apache-2.0
"""Blind investigations: effects of the library alone and in pairs, laws outside it, and nulls.

``--on cell`` hides effects and nulls in the MuJoCo cell. It resumes within an investigation as well.
"""

from __future__ import annotations

import argparse
import statistics
import time
from dataclasses import replace

import numpy as np

from benchmarks.boards.discovery import RIGHT
from benchmarks.harness import Row, Work
from benchmarks.hidden import VISIBLE, Entry, hidden_in, plant_option, recorder, reseeded
from benchmarks.results import Table
from impact_rs_analysis.application.plant_bench import PlantBench
from impact_rs_analysis.diagnosis.scoring import truth_of
from impact_rs_analysis.investigation.endings import judged
from impact_rs_analysis.investigation.loop import Investigation
from impact_rs_analysis.investigation.rounds import WantedTrials, read_rounds
from impact_rs_analysis.investigation.settings import BlindChoice, Settings, begin
from impact_rs_cli.commands.investigate import secret_of
from impact_rs_cli.terminal import Terminal
from impact_rs_sim.model import load_model
from impact_rs_trials.experiment_plan import ExperimentPlan, read_plan, write_plan

MAGNITUDE = 4.0  # parameter scales, of an effect that should be seen; as the pairs of the board of diagnoses
LAWS = ("object_quadratic_drag", "motor4_ripple", "end_effector_cable", "motor4_stop")
KINDS = {"null": "nothing", "single": "one effect", "pair": "two effects", "outside": "a law outside the library"}


def add_options(parser: argparse.ArgumentParser) -> None:
    """What is hidden, and where."""
    plant_option(parser, "plant", "cell")
    for name, count in (("singles", 10), ("pairs", 6), ("laws", 4), ("nulls", 10)):
        parser.add_argument(f"--{name}", type=int, default=count, help=f"number of {name}")
    parser.add_argument("--budget", type=int, default=30, help="trials of each at most")


def cases(options: argparse.Namespace) -> list[Entry]:
    """Kinds in turn, so that a board that is stopped early has some of each."""
    if options.on == "cell":
        names = np.random.default_rng(600).permutation(hidden_in("cell"))[: options.singles]
        singles = [Entry("single", str(name), MAGNITUDE, 600 + seed) for seed, name in enumerate(names)]
        nulls = [Entry("null", None, None, 700 + seed) for seed in range(options.nulls)]
        return reseeded(singles + nulls, options)
    kinds = (
        [Entry("single", None, MAGNITUDE, 100 + seed) for seed in range(options.singles)],
        [Entry("null", None, None, 300 + seed) for seed in range(options.nulls)],
        [Entry("pair", None, MAGNITUDE, 200 + seed) for seed in range(options.pairs)],
        [Entry("outside", LAWS[seed % len(LAWS)], MAGNITUDE, 400 + seed) for seed in range(options.laws)],
    )
    in_turn = [kind[index] for index in range(max(map(len, kinds))) for kind in kinds if index < len(kind)]
    return reseeded(in_turn, options)


class SharedFirstPlan(PlantBench):
    """Our plant; the first plan, which is the same for all, is made once and read by the others."""

    def design(self, wanted: WantedTrials) -> ExperimentPlan:
        """The next trials."""
        if wanted.done:
            return super().design(wanted)
        path = self.runs.parent.parent / f"first_plan_{wanted.budget}.yaml"
        if not path.exists():
            write_plan(super().design(replace(wanted, seed=0)), path)
        return read_plan(path).model_copy(update={"seed": wanted.seed})


def run(entry: Entry, work: Work) -> Row:
    """Investigate one plant, and hold the end against the truth."""
    directory = work.folder
    blind = BlindChoice(seed=entry.seed, kind=entry.kind, effect=entry.effect, magnitude=entry.magnitude)
    settings = Settings(
        scenarios=("push", "excite"), model_digest=load_model("nominal").digest, seed=entry.seed, blind=blind
    )
    secret = secret_of(settings)
    secret.check(directory)
    begin(directory, settings)
    secret.write(directory)
    spent = time.process_time()
    bench = SharedFirstPlan(
        directory, settings, work.map_tasks, Terminal(as_json=True), secret, recorder(work.options.on)
    )
    ending = Investigation(directory, settings, work.options.budget, bench).run()
    kind, hidden = truth_of(directory)
    right, wrong = judged(ending, kind, hidden, RIGHT[hidden[0]] if kind == "outside" else None)
    first = read_rounds(directory, settings)[0].diagnosis
    assert first is not None
    return {
        "kind": kind,
        "truth": list(hidden),
        "certain": ending.certain,
        "correct": right,
        "exact": right and ending.certain and (kind == "outside" or set(ending.effects) == set(hidden)),
        "wrong": wrong,
        "not_excluded": list(ending.not_excluded),
        "trials": ending.trials,
        "rounds": ending.rounds,
        "visible": first.held_out_error_before > VISIBLE * first.noise_floor,
        "processor": time.process_time() - spent,
        "said": f"{'right' if right else 'wrong' if wrong else 'missed'}, {ending.verdict} "
        f"{'+'.join(ending.effects or ending.candidates)}".strip(),
    }


def table(rows: list[Row], options: argparse.Namespace) -> Table:
    """A row for each kind."""
    columns = ("Hidden", "Investigations", "Ended right", "exactly that named", "Certain and wrong")
    columns += ("Trials, median", "Processor time, median [s]")
    where = "" if options.on == "plant" else ", in the MuJoCo cell"
    lines = []
    for kind, words in KINDS.items():
        if rows_of_kind := [row for row in rows if row["kind"] == kind]:
            counts = [str(sum(row[key] for row in rows_of_kind)) for key in ("correct", "exact", "wrong")]
            medians = [f"{statistics.median(row[key] for row in rows_of_kind):.0f}" for key in ("trials", "processor")]
            lines.append((words + where, str(len(rows_of_kind)), *counts, *medians))
    return Table(columns, tuple(lines))
