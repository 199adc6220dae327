# SPDX-License-Identifier: Apache-2.0
"""Scoreboard of the diagnosis on hidden effects: ``./run python -m benchmarks.blind -o DIR [--size small]``.

The matrix: every effect of the library at three magnitudes, pairs, nulls and effects outside the library, several seeds
each. It resumes where it stopped: campaigns, diagnoses and scores that exist are kept. ``--only NAME`` runs those whose
name starts so, for example ``single:object_mass``.
"""

from __future__ import annotations

import json
import statistics
import time
from dataclasses import asdict
from pathlib import Path

import numpy as np

from benchmarks.board import SCORE, Entry, Row, arguments, diagnosed, run_board, share
from impact_rs_analysis.diagnosis.scoring import score
from impact_rs_analysis.evidence.levels import score_of
from impact_rs_analysis.evidence.measured_runs import read_runs
from impact_rs_analysis.evidence.replay_cache import ReplayCache
from impact_rs_analysis.evidence.replays import ReplaySource
from impact_rs_sim.effects import of_trials
from impact_rs_sim.model import ModelEffect, ParameterValue, load_model
from impact_rs_sim.unmodelled import OUTSIDE
from impact_rs_trials.blind import RUNS, TRUTH, make
from impact_rs_trials.workers import Map

MAGNITUDES = (3.0, 8.0, 1.0)  # parameter scales: clear, gross, barely noticeable
VISIBLE = 2.0  # times the noise; what is below was hidden in vain
PLAIN = "plain"  # in the place of a name: two effects that show alone, at the clear magnitude, in this board
OUTSIDE_MAGNITUDES = (2.0, 6.0)


def matrix(seeds: int, pairs: int, nulls: int) -> list[Entry]:
    """Every campaign of the benchmark, each with a seed of its own; what comes first says most, should time run out."""
    singles = [("single", name, size) for size in MAGNITUDES for name in of_trials()]
    faint, strong = ([("outside", name, size) for name in OUTSIDE] for size in OUTSIDE_MAGNITUDES)
    once: list[tuple[str, str | None, float | None]] = [("null", None, None)] * nulls
    once += [("pair", PLAIN, 4.0)] * pairs
    wanted: list[tuple[str, str | None, float | None]] = [*singles, *faint, *once, *strong]
    wanted += [*singles, *faint, *strong] * (seeds - 1)
    entries = [Entry(*entry, seed) for seed, entry in enumerate(wanted)]
    clear = [entry for entry in entries if entry.kind != "single" or entry.magnitude == MAGNITUDES[0]]
    return clear + [entry for entry in entries if entry not in clear]


def run(entry: Entry, directory: Path, size: str, map_tasks: Map) -> Row:
    """Make, diagnose and score one campaign; what exists is kept."""
    effect = _plain_pair(directory.parent, entry.seed) if entry.effect == PLAIN else entry.effect
    for _ in make(directory, entry.seed, map_tasks, entry.kind, effect, size, entry.magnitude):
        pass
    document = directory / "diagnosis.json"
    started = time.perf_counter()
    read = diagnosed(document, lambda: read_runs(directory / RUNS, map_tasks), map_tasks)
    elapsed = time.perf_counter() - started
    scored = score(directory, read, document)
    excess = read.held_out_error_before**2 - read.noise_floor**2
    partners = _partners(directory, map_tasks) if entry.kind == "pair" else {}
    return asdict(scored) | {
        "name": entry.name,
        "seconds": elapsed,
        "verdict": read.verdict,
        "more": bool(scored.also_named),
        "before": read.held_out_error_before,
        "noise": read.noise_floor,
        "alone": partners,
        "removed": (read.held_out_error_before**2 - read.held_out_error_after**2) / max(excess, 1e-9),
    }


def _plain_pair(board: Path, seed: int) -> str:
    """Two effects of those that stood above twice the noise when they were hidden alone at the clear magnitude."""
    rows = [json.loads(path.read_text()) for path in sorted(board.glob(f"single__*__m{MAGNITUDES[0]:g}__*/{SCORE}"))]
    shown = sorted({row["truth"][0] for row in rows if row["before"] > VISIBLE * row["noise"]})
    return "+".join(np.random.default_rng(seed).choice(shown, size=2, replace=False))


def _partners(directory: Path, map_tasks: Map) -> dict[str, float]:
    """Of every effect of a pair: the error that is left where the model has the other one at its true size.

    In multiples of what repetition alone gives, as the error before a diagnosis of a single effect is.
    """
    truth = json.loads((directory / TRUTH).read_text())["effects"]
    runs, store = read_runs(directory / RUNS, map_tasks), ReplayCache(map_tasks)
    found = {}
    for own in truth:
        others = [
            ModelEffect(
                name=other["name"],
                parameters={
                    name: ParameterValue(estimate=number["value"], unit=number["unit"])
                    for name, number in other["parameters"].items()
                },
            )
            for other in truth
            if other is not own
        ]
        model = load_model("nominal").model_copy(update={"effects": tuple(others)})
        found[own["name"]] = score_of(ReplaySource.of(runs, model, store).clusters)
    return found


def share_of(rows: list[Row], key: str) -> str:
    """Mean of ``key`` over the rows that have it, in percent."""
    return share([bool(row[key]) for row in rows if row.get(key) is not None])


def coverage(rows: list[Row]) -> str:
    """Mean over the campaigns of the share of true parameters that lie in their intervals, named or not."""
    shares = [row["covered"][0] / row["covered"][1] for row in rows if row["covered"][1]]
    return f"{100.0 * statistics.mean(shares):5.1f} % of {len(shares)}" if shares else "-"


def scoreboard(rows: list[Row]) -> str:
    """The table."""
    of = {kind: [row for row in rows if row["kind"] == kind] for kind in ("single", "pair", "null", "outside")}
    seen = [row for row in of["single"] if row["before"] > VISIBLE * row["noise"]]
    plain = [row for row in of["outside"] if row["before"] > VISIBLE * row["noise"]]
    both = [row for row in of["pair"] if row.get("alone") and min(row["alone"].values()) > VISIBLE]
    lines = [
        f"single above twice the noise, right or confusable {share_of(seen, 'correct')}",
        f"single above twice the noise, by its own name {share_of(seen, 'by_own_name')}",
        f"single, all, right or confusable             {share_of(of['single'], 'correct')}",
        f"single, all, headline is the effect alone    {share_of(of['single'], 'headline')}",
        f"pairs, each above twice the noise, both named {share_of(both, 'correct')}",
        f"pairs, all, both named                       {share_of(of['pair'], 'correct')}",
        f"null, NOTHING-MISSING                        {share_of(of['null'], 'correct')}",
        f"outside, NONE-EXPLAINS or honestly marked    {share_of(of['outside'], 'correct')}",
        f"outside above twice the noise, the same      {share_of(plain, 'correct')}",
        f"95 % intervals that cover, by campaign       {coverage(of['single'] + of['pair'])}",
        f"something named that is not there            {share_of(rows, 'more')}",
    ]
    seconds = [row["seconds"] for row in rows if row.get("seconds", 0.0) > 1.0]
    if seconds:
        lines.append(f"time of a diagnosis, median                  {statistics.median(seconds):.0f} s")
    removed = [row["removed"] for row in seen if row["by_own_name"]]
    if removed:
        lines.append(f"excess held-out error removed, median        {100.0 * statistics.median(removed):.1f} %")
    wrong = [row for row in rows if not row["correct"]]
    lines += [
        f"  wrong: {row['name']}: truth {row['truth']}, named {row['named']}, {row.get('verdict')}" for row in wrong
    ]
    return "\n".join(lines)


def main() -> None:
    """Run what is missing, then print the scoreboard."""
    parser = arguments(__doc__)
    parser.add_argument("--seeds", type=int, default=2, help="seeds per effect and magnitude")
    parser.add_argument("--pairs", type=int, default=10, help="campaigns with two effects")
    parser.add_argument("--nulls", type=int, default=20, help="campaigns with nothing hidden")
    parser.add_argument("--size", default="small", choices=("small", "full"), help="size of each campaign")
    options = parser.parse_args()
    entries = matrix(options.seeds, options.pairs, options.nulls)
    rows = run_board(entries, options, lambda entry, folder, map_tasks: run(entry, folder, options.size, map_tasks))
    print(scoreboard(rows))


if __name__ == "__main__":
    main()
