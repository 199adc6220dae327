# SPDX-License-Identifier: Apache-2.0
"""Campaigns with a hidden effect: the effects, the plants that hide them, diagnosis and score."""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from benchmarks.harness import Row, share
from benchmarks.results import Table
from impact_rs_analysis.diagnosis.diagnose import diagnose
from impact_rs_analysis.diagnosis.document import DiagnosisDocument, read_document, write_document
from impact_rs_analysis.diagnosis.scoring import held_against_truth
from impact_rs_analysis.evidence.replays.command_clock import read_laboratory_runs
from impact_rs_analysis.evidence.replays.measured_runs import Runs
from impact_rs_analysis.evidence.replays.replay_cache import ReplayCache
from impact_rs_analysis.evidence.sources.run_source import ReplaySource
from impact_rs_sim.effects import of_trials
from impact_rs_sim.model import load_model
from impact_rs_trials.blind import BlindTask, run_task
from impact_rs_trials.recordings.experiment import load_experiment
from impact_rs_trials.workers import Map

VISIBLE = 2.0  # times the noise, above which an effect can be seen
BINS = ((0.0, 0.5), (0.5, 0.75), (0.75, 0.9), (0.9, 1.0))  # of probabilities that a diagnosis states


@dataclass(frozen=True)
class Entry:
    """One campaign.

    Attributes:
        kind: ``single``, ``pair``, ``null``, ``outside`` or ``tie``.
        effect: Name of the hidden effect; None: drawn.
        magnitude: Its size in parameter scales; None: drawn.
        seed: Seed of all draws.
    """

    kind: str
    effect: str | None
    magnitude: float | None
    seed: int

    @property
    def name(self) -> str:
        """Folder name."""
        size = "any" if self.magnitude is None else f"{self.magnitude:g}"
        return f"{self.kind}__{self.effect or 'any'}__m{size}__seed{self.seed}"


def entries(contents: Sequence[tuple[str, str | None, float | None]], first_seed: int = 0) -> list[Entry]:
    """Campaigns, each with a seed of its own."""
    return [Entry(*content, seed) for seed, content in enumerate(contents, start=first_seed)]


def plant_option(parser: argparse.ArgumentParser, *plants: str) -> None:
    """Options of the plant that hides an effect, and of its seeds."""
    parser.add_argument("--on", choices=plants, default=plants[0], help="what hides the effect, and records it")
    parser.add_argument(
        "--first-seed", type=int, default=0, metavar="N", help="added to all seeds: other campaigns of the same kinds"
    )


def reseeded(campaigns: Sequence[Entry], options: argparse.Namespace) -> list[Entry]:
    """Campaigns with the seeds that the options ask for."""
    return [replace(entry, seed=entry.seed + options.first_seed) for entry in campaigns]


def recorder(plant: str) -> Callable[[BlindTask], str]:
    """Records a trial on our plant (``plant``), or on the cell on MuJoCo (``cell``)."""
    if plant == "plant":
        return run_task
    from benchmarks.foreign.campaign import record_task  # MuJoCo is a peer, not installed everywhere

    return record_task


def hidden_in(plant: str) -> list[str]:
    """Effects of the physics that a plant can hide; the board ``measurement`` has those of sensors."""
    physical = [
        name for name, effect in of_trials().items() if effect.acts_on != "neighbour" and not effect.of_measurement
    ]  # pushes of one object have no neighbour
    if plant == "plant":
        return physical
    from mujoco_cell import UNKNOWN_HERE

    return [name for name in physical if name not in UNKNOWN_HERE]


def diagnosed(document: Path, read: Callable[[], Runs], map_tasks: Map) -> DiagnosisDocument:
    """Diagnosis of what ``read`` returns by the nominal model; one that exists is kept."""
    if not document.exists():
        source = ReplaySource.of(read(), load_model("nominal"), ReplayCache(map_tasks))
        write_document(diagnose(source), document)
    return read_document(document)


def laboratory_runs(folder: Path, map_tasks: Map) -> Runs:
    """Runs of a folder with an ``experiment.yaml``."""
    return read_laboratory_runs(folder, load_experiment(folder / "experiment.yaml"), map_tasks)


def judged(truth: Path, document: DiagnosisDocument) -> Row:
    """A diagnosis against the truth of a campaign.

    ``correct`` is lenient: a hidden effect may be in a tie, and further effects may be named. ``exact`` is strict: the
    named effects are exactly the hidden ones, and where no effect of the library is hidden, the verdict is right, too.
    """
    scored = held_against_truth(truth, document)
    before, after, noise = document.held_out_error_before, document.held_out_error_after, document.noise_floor
    hidden = set() if scored.kind == "outside" else set(scored.truth)
    return asdict(scored) | {
        "exact": scored.correct and set(document.named) == hidden,
        "probabilities": [(value, name in hidden) for name, value in stated_probabilities(document).items()],
        "verdict": str(document.verdict),
        "trials": document.runs.trials,
        "before": before,
        "noise": noise,
        "removed": (before**2 - after**2) / max(before**2 - noise**2, 1e-9),
        "said": f"{'right' if scored.correct else 'NOT RIGHT'}, {document.verdict}",
    }


def stated_probabilities(document: DiagnosisDocument) -> dict[str, float]:
    """Probability of each named effect, where the diagnosis states one."""
    probabilities = {effect.name: getattr(effect, "probability", None) for effect in document.effects}
    return {name: float(probabilities[name]) for name in document.named if probabilities.get(name) is not None}


def by_probability(stated: Sequence[tuple[float, bool]]) -> list[tuple[str, list[bool]]]:
    """Bins of probability in words, each with a truth value per named effect in it: whether it was hidden.

    Args:
        stated: Probability of every named effect, and whether it was hidden; empty: there are no bins.
    """
    return [
        (
            f"effects named with {100.0 * low:.0f} to {100.0 * high:.0f} %: hidden",
            [right for value, right in stated if low <= value < high or value == high == 1.0],
        )
        for low, high in (BINS if stated else ())
    ]


def timed_diagnosis(document: Path, truth: Path, read: Callable[[], Runs], map_tasks: Map) -> Row:
    """Diagnose and judge."""
    began = time.perf_counter()
    return judged(truth, diagnosed(document, read, map_tasks)) | {"seconds": time.perf_counter() - began}


def is_visible(row: Row) -> bool:
    """Whether the hidden effects exceed ``VISIBLE``."""
    if row.get("alone"):  # a pair: each effect, where the model has the other one
        return min(row["alone"].values()) > VISIBLE
    return bool(row["before"] > VISIBLE * row["noise"])


def table_of_diagnoses(rows: Sequence[Row], heading: str) -> Table:
    """How often diagnoses are right, one column."""
    rows_by_kind = {
        kind: [row for row in rows if row["kind"] == kind] for kind in ("single", "pair", "null", "outside")
    }
    visible, pairs = (
        [row for row in rows_by_kind["single"] if is_visible(row)],
        [row for row in rows_by_kind["pair"] if is_visible(row)],
    )
    lines = [
        ("campaigns that ended right", share(row["correct"] for row in rows)),
        ("campaigns that ended right: exactly what is hidden named", share(row["exact"] for row in rows)),
        ("single effects above twice the noise: named, or in a tie", share(row["correct"] for row in visible)),
        ("single effects above twice the noise: by their own name", share(row["by_own_name"] for row in visible)),
        ("single effects above twice the noise: exactly that named", share(row["exact"] for row in visible)),
    ]
    for size in sorted({row["magnitude"] for row in rows_by_kind["single"] if "magnitude" in row}):
        rows_of_size = [row for row in rows_by_kind["single"] if row["magnitude"] == size]
        lines += [
            (f"single effects at {size:g} × scale: named, or in a tie", share(row["correct"] for row in rows_of_size)),
            (f"single effects at {size:g} × scale: exactly that named", share(row["exact"] for row in rows_of_size)),
        ]
    lines += [
        ("single effects, all: named, or in a tie", share(row["correct"] for row in rows_by_kind["single"])),
        ("single effects, all: exactly that named", share(row["exact"] for row in rows_by_kind["single"])),
        ("pairs, both above twice the noise: both named", share(row["correct"] for row in pairs)),
        ("pairs, both above twice the noise: exactly both named", share(row["exact"] for row in pairs)),
        ("pairs, all: both named", share(row["correct"] for row in rows_by_kind["pair"])),
        ("pairs, all: exactly both named", share(row["exact"] for row in rows_by_kind["pair"])),
        ("nothing hidden: `NOTHING-MISSING`", share(row["correct"] for row in rows_by_kind["null"])),
        ("outside the library: not explained, or marked so", share(row["correct"] for row in rows_by_kind["outside"])),
        (
            "outside the library: not explained, and nothing named",
            share(row["exact"] for row in rows_by_kind["outside"]),
        ),
        ("true parameters in their 95 % intervals, above twice the noise", _covered(visible + pairs)),
        ("true parameters in their 95 % intervals, all", _covered(rows_by_kind["single"] + rows_by_kind["pair"])),
        (
            "campaigns with an effect named that is neither there nor confusable",
            share(row["also_named"] for row in rows if row["kind"] != "outside"),
        ),
        ("outside the library: with an effect named", share(row["also_named"] for row in rows_by_kind["outside"])),
    ]
    stated = [(value, right) for row in rows for value, right in row.get("probabilities", ())]
    lines += [(words, share(right)) for words, right in by_probability(stated)]
    if right := [row["removed"] for row in visible if row["by_own_name"]]:
        lines.append(("excess held-out error removed, median", f"{100.0 * statistics.median(right):.0f} %"))
    if seconds := [row["seconds"] for row in rows if "seconds" in row]:
        lines.append(("time of a diagnosis, median", f"{statistics.median(seconds):.0f} s"))
    return Table(("", heading), tuple(lines))


def _covered(rows: Sequence[Row]) -> str:
    inside, total = (sum(row["covered"][side] for row in rows) for side in (0, 1))
    return f"{inside} of {total}" if total else "–"
