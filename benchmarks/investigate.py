# SPDX-License-Identifier: Apache-2.0
"""Scoreboard of blind investigations: ``./run python -m benchmarks.investigate -o DIR``.

Effects of the library alone and in pairs, laws outside it, and nulls. ``--plant mujoco`` hides effects and nulls in the
MuJoCo cell of ``benchmarks.foreign``, in a folder of its own. It resumes where it stopped, within an
investigation as well; ``--only single`` runs those whose name starts so.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.board import Entry, Row, arguments, hidden_in, plant_argument, recorder, run_board, share
from benchmarks.discovery import RIGHT
from impact_rs_analysis.diagnosis.document import DiagnosisDocument
from impact_rs_analysis.diagnosis.scoring import truth_of
from impact_rs_analysis.investigation import (
    BlindChoice,
    Investigation,
    Round,
    Settings,
    begin,
    judged,
    read_rounds,
)
from impact_rs_cli.bench import PlantBench
from impact_rs_cli.commands.investigate import secret_of
from impact_rs_cli.terminal import Terminal
from impact_rs_sim.model import Model, load_model
from impact_rs_trials.blind import specs
from impact_rs_trials.experiment_plan import ExperimentPlan, read_plan, write_plan
from impact_rs_trials.workers import Map

MAGNITUDE = 4.0  # parameter scales, of an effect that should be seen; as the pairs of the board of diagnoses
LAW_MAGNITUDE = 4.0
LAWS = ("object_quadratic_drag", "motor4_ripple", "end_effector_cable", "motor4_stop")
VISIBLE = 2.0  # times the noise, of the error of the first model
FIXED = sum(repeats for _, repeats in specs("small"))  # trials of the fixed campaign


def matrix(singles: int, pairs: int, laws: int, nulls: int) -> list[Entry]:
    """Every investigation, kinds in turn, so that a board that is stopped early has some of each."""
    kinds = (
        [Entry("single", None, MAGNITUDE, 100 + seed) for seed in range(singles)],
        [Entry("null", None, None, 300 + seed) for seed in range(nulls)],
        [Entry("pair", None, MAGNITUDE, 200 + seed) for seed in range(pairs)],
        [Entry("outside", LAWS[seed % len(LAWS)], LAW_MAGNITUDE, 400 + seed) for seed in range(laws)],
    )
    longest = max(map(len, kinds))
    return [kind[index] for index in range(longest) for kind in kinds if index < len(kind)]


def foreign_matrix(singles: int, nulls: int) -> list[Entry]:
    """Investigations on the MuJoCo cell: effects drawn without repetition of those that it can hide, and nulls."""
    names = np.random.default_rng(600).permutation(hidden_in("mujoco"))[:singles]
    found = [Entry("single", str(name), MAGNITUDE, 600 + seed) for seed, name in enumerate(names)]
    return found + [Entry("null", None, None, 700 + seed) for seed in range(nulls)]


class SharedFirstPlan(PlantBench):
    """Our plant; the first plan, which is the same for all, is made once and read by the others."""

    def design(
        self,
        model: Model,
        done: Sequence[Round],
        document: DiagnosisDocument | None,
        budget: int,
        seed: int,
        show: Sequence[str] = (),
    ) -> ExperimentPlan:
        """The next trials."""
        if done:
            return super().design(model, done, document, budget, seed, show)
        path = self.runs.parent.parent / f"first_plan_{budget}.yaml"
        if not path.exists():
            write_plan(super().design(model, done, document, budget, 0), path)
        return read_plan(path).model_copy(update={"seed": seed})


def run(entry: Entry, directory: Path, map_tasks: Map, budget: int, plant: str) -> Row:
    """Investigate one plant, and hold the end against the truth."""
    blind = BlindChoice(seed=entry.seed, kind=entry.kind, effect=entry.effect, magnitude=entry.magnitude)
    settings = Settings(
        scenarios=("push", "excite"), model_digest=load_model("nominal").digest, seed=entry.seed, blind=blind
    )
    secret = secret_of(settings)
    directory.mkdir(parents=True, exist_ok=True)
    secret.check(directory)
    begin(directory, settings)
    secret.keep(directory)
    started, spent = time.perf_counter(), time.process_time()
    bench = SharedFirstPlan(directory, settings, map_tasks, Terminal(as_json=True), secret, recorder(plant))
    ending = Investigation(directory, settings, budget, bench).run()
    kind, hidden = truth_of(directory)
    right, wrong = judged(ending, kind, hidden, RIGHT[hidden[0]] if kind == "outside" else None)
    first = read_rounds(directory, settings)[0].diagnosis
    assert first is not None
    return {
        "name": entry.name,
        "kind": kind,
        "truth": list(hidden),
        "verdict": f"{ending.verdict} {'+'.join(ending.effects or ending.candidates)}".strip(),
        "certain": ending.certain,
        "correct": right,
        "wrong": wrong,
        "not_excluded": list(ending.not_excluded),
        "trials": ending.trials,
        "rounds": ending.rounds,
        "before": first.held_out_error_before,
        "noise": first.noise_floor,
        "seconds": time.perf_counter() - started,
        "processor": time.process_time() - spent,
    }


def scoreboard(rows: list[Row]) -> str:
    """The table."""
    asked = [row for row in rows if row["kind"] != "null"]
    nulls = [row for row in rows if row["kind"] == "null"]
    in_part = [row["certain"] and not row["correct"] and not row["wrong"] for row in asked]
    seen = [row for row in asked if row["before"] > VISIBLE * row["noise"]]
    lines = [
        f"something hidden, end right                 {share([row['correct'] for row in asked])}",
        f"... above twice the noise                   {share([row['correct'] for row in seen])}",
        f"... certain and right                       {share([row['correct'] and row['certain'] for row in asked])}",
        f"... certain, a part not excluded            {share(in_part)}",
        f"... certain and wrong                       {share([row['wrong'] for row in asked])}",
        f"nothing hidden, NOTHING-MISSING             {share([row['correct'] for row in nulls])}",
        f"nothing hidden, certain and wrong           {share([row['wrong'] for row in nulls])}",
    ]
    if asked:
        median = statistics.median(row["trials"] for row in asked)
        lines.append(
            f"trials, median                              {median:g} = {100.0 * median / FIXED:.0f} % of {FIXED}"
        )
    if rows:
        lines.append(
            f"time, median                                {statistics.median(row['seconds'] for row in rows):.0f} s, "
            f"of the processor {statistics.median(row['processor'] for row in rows):.0f} s"
        )
    for row in rows:
        if not row["correct"]:
            how = "wrong" if row["wrong"] else "in part" if row["certain"] else "missed"
            error = f"error before {row['before']:.3g}, noise {row['noise']:.3g}"
            lines.append(f"  {how}: {row['name']}: hidden {', '.join(row['truth']) or 'nothing'}; {row['verdict']}, ")
            lines[-1] += f"not excluded {', '.join(row['not_excluded']) or 'nothing'}, " if row["certain"] else ""
            lines[-1] += f"{row['trials']} trials ({error})"
    return "\n".join(lines)


def main() -> None:
    """Run what is missing, then print the scoreboard."""
    parser = arguments(__doc__)
    for name, count in (("singles", 10), ("pairs", 6), ("laws", 4), ("nulls", 10)):
        parser.add_argument(f"--{name}", type=int, default=count, help=f"number of {name}")
    parser.add_argument("--budget", type=int, default=30, help="trials of each at most")
    plant_argument(parser)
    options = parser.parse_args()
    entries = (
        matrix(options.singles, options.pairs, options.laws, options.nulls)
        if options.plant == "bullet"
        else foreign_matrix(options.singles, options.nulls)
    )
    rows = run_board(
        entries, options, lambda entry, folder, map_tasks: run(entry, folder, map_tasks, options.budget, options.plant)
    )
    print(scoreboard(rows))


if __name__ == "__main__":
    from benchmarks.investigate import main as run_main  # what workers get is then known by its module

    run_main()
