# SPDX-License-Identifier: Apache-2.0
"""What boards of blind campaigns have in common: entries of the matrix, the loop that resumes, shares in percent."""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from impact_rs_analysis.diagnosis.diagnose import diagnose
from impact_rs_analysis.diagnosis.document import DiagnosisDocument, read_document, write_document
from impact_rs_analysis.evidence.command_clock import read_laboratory_runs
from impact_rs_analysis.evidence.measured_runs import Runs
from impact_rs_analysis.evidence.replay_cache import ReplayCache
from impact_rs_analysis.evidence.replays import ReplaySource
from impact_rs_sim.effects import of_trials
from impact_rs_sim.model import load_model
from impact_rs_trials.blind import BlindTask, run_task
from impact_rs_trials.recordings.experiment import load_experiment
from impact_rs_trials.workers import Map, Workforce, workers

Row = dict[str, Any]
SCORE = "score.json"


@dataclass(frozen=True)
class Entry:
    """One campaign of a matrix.

    Attributes:
        kind: ``single``, ``pair``, ``null`` or ``outside``.
        effect: What is hidden; None: drawn.
        magnitude: How much of it, in parameter scales; None: drawn.
        seed: All that is drawn depends on it.
    """

    kind: str
    effect: str | None
    magnitude: float | None
    seed: int

    @property
    def name(self) -> str:
        """Folder name."""
        parts = [self.kind, self.effect or "any", "m" + ("any" if self.magnitude is None else f"{self.magnitude:g}")]
        return "__".join([*parts, f"seed{self.seed}"])


def arguments(text: str | None) -> argparse.ArgumentParser:
    """Arguments of every board."""
    parser = argparse.ArgumentParser(description=text, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder of the campaigns")
    parser.add_argument("--jobs", type=int, default=2, help="worker processes")
    parser.add_argument("--only", default="", help="run entries whose name starts with this (':' for '__')")
    parser.add_argument("--seconds", type=float, default=math.inf, help="start no further campaign after this time [s]")
    return parser


def plant_argument(parser: argparse.ArgumentParser) -> None:
    """The argument that names what hides an effect."""
    parser.add_argument("--plant", choices=("bullet", "mujoco"), default="bullet", help="what hides the effect")


def recorder(plant: str) -> Callable[[BlindTask], str]:
    """Records a trial on our plant (``bullet``), or on the cell of ``benchmarks.foreign`` (``mujoco``)."""
    if plant == "bullet":
        return run_task
    from benchmarks.foreign.campaign import record_task  # MuJoCo is a peer, not installed everywhere

    return record_task


def hidden_in(plant: str) -> tuple[str, ...]:
    """Effects of the library that a plant can hide."""
    if plant == "bullet":
        return tuple(of_trials())
    from benchmarks.foreign.cell import UNKNOWN_HERE

    return tuple(name for name in of_trials() if name not in UNKNOWN_HERE)


def run_board(
    matrix: Sequence[Entry], options: argparse.Namespace, run: Callable[[Entry, Path, Map], Row]
) -> list[Row]:
    """Scores of all campaigns that exist or are run in time; a score that exists is kept.

    Args:
        matrix: Every campaign, what says most first.
        options: Of :func:`arguments`.
        run: Makes, diagnoses and scores an entry in its folder.
    """
    wanted = [entry for entry in matrix if entry.name.startswith(options.only.replace(":", "__"))]
    rows, began = [], time.monotonic()
    with workers(Workforce(options.jobs)) as map_tasks:
        for number, entry in enumerate(wanted, start=1):
            folder = options.output / entry.name
            if (folder / SCORE).exists():
                row = dict(json.loads((folder / SCORE).read_text()))
            elif time.monotonic() - began > options.seconds:
                continue
            else:
                row = run(entry, folder, map_tasks)
                (folder / SCORE).write_text(json.dumps(row, default=list) + "\n")
            rows.append(row)
            judged = "right" if row["correct"] else "not right"
            print(f"[{number}/{len(wanted)}] {entry.name}: {judged}, {row['verdict']}", flush=True)
    print(f"\n{len(rows)} of {len(wanted)} campaigns")
    return rows


def diagnosed(document: Path, read: Callable[[], Runs], map_tasks: Map) -> DiagnosisDocument:
    """Diagnosis of what ``read`` returns by the nominal model; one that exists is kept."""
    if not document.exists():
        source = ReplaySource.of(read(), load_model("nominal"), ReplayCache(map_tasks))
        write_document(diagnose(source, source.model), document)
    return read_document(document)


def diagnosed_laboratory(folder: Path, document: Path, map_tasks: Map) -> DiagnosisDocument:
    """Diagnosis of a folder of runs with an ``experiment.yaml``; one that exists is kept."""
    experiment = folder / "experiment.yaml"
    return diagnosed(document, lambda: read_laboratory_runs(folder, load_experiment(experiment), map_tasks), map_tasks)


def share(values: Sequence[bool]) -> str:
    """How many of them are true, in percent."""
    return f"{100.0 * sum(values) / len(values):5.1f} % of {len(values)}" if values else "-"
