# SPDX-License-Identifier: Apache-2.0
"""Scoreboard of the diagnosis on the MuJoCo cell: ``./run python -m benchmarks.foreign.board -o DIR``.

The matrix: every effect of the library at two magnitudes, nulls, and three effects outside the library, in campaigns of
:mod:`benchmarks.foreign.campaign`. Each is diagnosed and scored by the command line, as a user would. It resumes where
it stopped: campaigns, diagnoses and scores that exist are kept. ``--only NAME`` runs those whose name starts so, for
example ``single:object_mass``; ``--table`` prints what there is and runs nothing.
"""

from __future__ import annotations

import json
import shutil
import statistics
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from benchmarks.board import Entry, Row, arguments, run_board, share
from benchmarks.foreign.campaign import OUTSIDE, make_campaign
from benchmarks.foreign.cell import UNKNOWN_HERE
from impact_rs_sim.effects import of_trials
from impact_rs_trials.blind import RUNS, TRUTH
from impact_rs_trials.workers import Map

MAGNITUDES = (3.0, 8.0)  # parameter scales: clear, gross
OUTSIDE_MAGNITUDES = (2.0, 6.0)
NULLS = 5
FIRST_SEED = 1000  # campaigns of benchmarks.blind have other seeds


def matrix(seeds: int) -> list[Entry]:
    """Every campaign of the board, each with a seed of its own; what comes first says most, should time run out."""
    singles = [("single", name, size) for size in MAGNITUDES for name in of_trials() if name not in UNKNOWN_HERE]
    outsides = [("outside", name, size) for size in OUTSIDE_MAGNITUDES for name in OUTSIDE]
    nulls: list[tuple[str, str | None, float | None]] = [("null", None, None)] * NULLS
    wanted: list[tuple[str, str | None, float | None]] = [*nulls, *singles, *outsides]
    return [Entry(*entry, FIRST_SEED + seed) for seed, entry in enumerate(wanted * seeds)]


def impact_rs(*arguments: str | Path) -> str:
    """Standard output of the command line.

    Raises:
        RuntimeError: It failed; says what it said.
    """
    program = shutil.which("impact-rs") or str(Path(sys.executable).with_name("impact-rs"))
    done = subprocess.run([program, *map(str, arguments)], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise RuntimeError(f"impact-rs {' '.join(map(str, arguments))}: {done.stderr.strip()}")
    return done.stdout


def run(entry: Entry, directory: Path, size: str, jobs: int, map_tasks: Map) -> Row:
    """Make, diagnose and score one campaign; what exists is kept."""
    make_campaign(directory, entry.seed, map_tasks, entry.kind, entry.effect, size, entry.magnitude)
    document, clock = directory / "diagnosis.json", directory / "seconds.json"
    if not document.exists():
        started = time.perf_counter()
        impact_rs("diagnose", directory / RUNS, "-o", document, "--jobs", str(jobs))
        clock.write_text(json.dumps(time.perf_counter() - started) + "\n")
    scored = json.loads(impact_rs("blind", "score", directory, "--diagnosis", document, "--json"))
    diagnosis, truth = json.loads(document.read_text()), json.loads((directory / TRUTH).read_text())
    return scored | {
        "name": entry.name,
        "magnitude": entry.magnitude,
        "verdict": diagnosis["verdict"],
        "seconds": json.loads(clock.read_text()) if clock.exists() else None,
        "intervals": intervals(diagnosis, truth),
    }


def intervals(diagnosis: dict[str, Any], truth: dict[str, Any]) -> dict[str, bool | None]:
    """Whether the 95 % interval of every true parameter covers it, named or not; None where there is no interval."""
    found = {effect["name"]: effect["parameters"] for effect in diagnosis["effects"]}
    covers: dict[str, bool | None] = {}
    for hidden in truth["effects"]:
        for name, true in hidden["parameters"].items():
            interval = (found.get(hidden["name"], {}).get(name) or {}).get("ci95")
            inside = None if interval is None else interval[0] <= true["value"] <= interval[1]
            covers[f"{hidden['name']}.{name}"] = inside
    return covers


def scoreboard(rows: list[Row]) -> str:
    """The table."""
    of = {kind: [row for row in rows if row["kind"] == kind] for kind in ("single", "null", "outside")}
    known = {row["name"]: [v for v in row["intervals"].values() if v is not None] for row in of["single"]}
    silent = sum(value is None for row in of["single"] for value in row["intervals"].values())
    every = [value for values in known.values() for value in values]
    by_campaign = [statistics.mean(values) for values in known.values() if values]
    lines = []
    for size in MAGNITUDES:
        some = [row for row in of["single"] if row["magnitude"] == size]
        lines += [
            f"single, {size:g} scales: right or confusable          {share([row['correct'] for row in some])}",
            f"single, {size:g} scales: by its own name              {share([row['by_own_name'] for row in some])}",
        ]
    headline = [row["verdict"] == "+".join(row["truth"]) for row in of["single"]]
    lines += [
        f"single: headline is the effect and nothing else {share(headline)}",
        f"null: NOTHING-MISSING                          {share([row['correct'] for row in of['null']])}",
        f"outside: NONE-EXPLAINS or honestly marked      {share([row['correct'] for row in of['outside']])}",
        f"95 % intervals that cover, all true parameters {share(every)}; {silent} without an interval",
        "95 % intervals that cover, mean of campaigns   "
        + (f"{100.0 * statistics.mean(by_campaign):5.1f} % of {len(by_campaign)}" if by_campaign else "-"),
        f"something named that is not there              {share([bool(row['also_named']) for row in rows])}",
    ]
    seconds = [row["seconds"] for row in rows if row["seconds"] is not None]
    if seconds:
        lines.append(f"time of a diagnosis, median                    {statistics.median(seconds):5.0f} s")
    for row in rows:
        missed = [name for name, inside in row["intervals"].items() if inside is False]
        if not row["correct"] or row["also_named"]:
            lines.append(f"  {row['name']}: headline {row['verdict']}, named {', '.join(row['named']) or 'nothing'}")
        if missed:
            lines.append(f"  {row['name']}: interval misses {', '.join(missed)}")
    return "\n".join(lines)


def main() -> None:
    """Run what is missing, then print the scoreboard."""
    parser = arguments(__doc__)
    parser.add_argument("--seeds", type=int, default=1, help="how often the matrix is run")
    parser.add_argument("--size", default="small", choices=("small", "full"), help="size of each campaign")
    parser.add_argument("--table", action="store_true", help="run nothing, print the board of what is there")
    options = parser.parse_args()
    options.seconds = -1.0 if options.table else options.seconds
    rows = run_board(
        matrix(options.seeds),
        options,
        lambda entry, folder, map_tasks: run(entry, folder, options.size, options.jobs, map_tasks),
    )
    print(scoreboard(rows))


if __name__ == "__main__":
    main()
