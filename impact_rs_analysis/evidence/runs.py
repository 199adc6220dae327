# SPDX-License-Identifier: Apache-2.0
"""RUNS: a folder of bags, read into measured runs."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from impact_rs_analysis.evidence.cluster import Feature
from impact_rs_analysis.evidence.measured import MeasuredRun
from impact_rs_analysis.evidence.run import run_of_trial
from impact_rs_sim.errors import InputError
from impact_rs_trials.bags.checksums import says_so, unsealed_words
from impact_rs_trials.bags.reader import BagError, TrialBag, reason_of
from impact_rs_trials.store import Folder
from impact_rs_trials.workers import Map

LARGEST_LOSS = 0.5  # largest share of windows of free motion that all runs drop for gaps in some


@dataclass(frozen=True)
class Runs:
    """The usable runs of a folder.

    Attributes:
        directory: The folder.
        runs: Measured runs; repeats of a condition have the same features.
        skipped: Path and reason of every bag that cannot be used.
        remarks: Remarks on how they were read.
        clock: See :class:`~impact_rs_analysis.evidence.cluster.Source` [s].
        late: By condition, its first run with commands that act one standard deviation of their clock later; empty if
            the clock is known.
    """

    directory: Path
    runs: tuple[MeasuredRun, ...]
    skipped: tuple[tuple[str, str], ...]
    remarks: tuple[str, ...] = ()
    clock: float = 0.0
    late: Mapping[str, MeasuredRun] = field(default_factory=dict)

    @property
    def digest(self) -> str:
        """Digest of the runs, independent of their location."""
        if all(run.spec is not None for run in self.runs):
            return runs_digest(self.directory)
        rows = sorted(f"{run.condition} {run.setup.digest}" for run in self.runs)
        return hashlib.sha256("\n".join(rows).encode()).hexdigest()[:16]

    @property
    def conditions(self) -> dict[str, list[MeasuredRun]]:
        """Repeats by condition, in order of appearance."""
        found: dict[str, list[MeasuredRun]] = {}
        for run in self.runs:
            found.setdefault(run.condition, []).append(run)
        return found

    @staticmethod
    def of(directory: Path, results: Iterable[MeasuredRun | tuple[str, str]]) -> Runs:
        """Runs from the results of reading.

        Raises:
            InputError: No run can be used.
        """
        listed = list(results)
        runs = [result for result in listed if isinstance(result, MeasuredRun)]
        skipped = tuple(result for result in listed if not isinstance(result, MeasuredRun))
        if not runs:
            reason = f"; {len(skipped)} bag(s) cannot be used, the first because: {skipped[0][1]}" if skipped else ""
            raise InputError(f"no usable trials here{reason}", file=directory)
        common: dict[str, set] = {}
        free: dict[str, int] = {}  # a shorter repeat has fewer windows, even without gaps
        for run in runs:
            common.setdefault(run.condition, set(run.features)).intersection_update(run.features)
            free[run.condition] = min(run.free, free.get(run.condition, run.free))
        shared = [replace(run.only(common[run.condition]), free=free[run.condition]) for run in runs]
        return Runs(directory, _alike(shared), skipped)


def _alike(runs: list[MeasuredRun]) -> tuple[MeasuredRun, ...]:
    """The runs without windows that a gap drops in any run of their family, so that conditions share a pure error.

    If that would drop too many windows, the runs stay unchanged.
    """
    left: dict[tuple[object, ...], set[Feature]] = {}
    for run in runs:
        left.setdefault(run.family, set(run.features)).intersection_update(run.features)
    alike = [run.only(left[run.family]) for run in runs]
    torn = {run.family for run in alike if len(run.lost) > LARGEST_LOSS * run.free}
    return tuple(old if old.family in torn else new for old, new in zip(runs, alike, strict=True))


def find_bags(directory: Path) -> list[Path]:
    """Folders below ``directory`` that look like bags; hidden ones are half-written."""
    return sorted(directory / name for name in Folder(directory).stamps())


def read_trial(path: Path) -> MeasuredRun | tuple[str, str]:
    """One trial, or its path and the reason why it cannot be used."""
    try:
        bag = TrialBag.open(path)
        if bag.outcome not in ("OK", "DROPPED", "EARLY"):
            return str(path), f"{bag.outcome}: {bag.reason}"
        return MeasuredRun.of(run_of_trial(bag))
    except Exception as error:  # a damaged bag must not stop the others
        return str(path), reason_of(error)


def read_runs(directory: Path, map_tasks: Map) -> Runs:
    """Read every trial below a folder.

    Raises:
        InputError: The folder does not exist or holds no usable trial.
    """
    bags = find_bags(directory)
    found = Runs.of(directory, map_tasks(read_trial, bags))
    skipped = {path for path, _ in found.skipped}
    remark = unsealed_words(sum(not says_so(bag) for bag in bags if str(bag) not in skipped))
    return replace(found, remarks=(remark,)) if remark else found


def runs_digest(directory: Path) -> str:
    """Digest of the trials in a folder: names, scenarios and seeds, independent of its location."""
    rows = []
    for path in find_bags(directory):
        try:
            info = TrialBag.open(path).info
        except BagError:  # not a usable trial
            continue
        scenario = hashlib.sha256(info.scenario_json.encode()).hexdigest()
        rows.append(f"{path.name} {scenario} {info.seed}")
    return hashlib.sha256("\n".join(sorted(rows)).encode()).hexdigest()[:16]
