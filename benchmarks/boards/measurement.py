# SPDX-License-Identifier: Apache-2.0
"""Faults of readings: does a diagnosis distinguish an encoder that is off from a payload, and find the physics beneath?

Campaigns with a known truth are recorded by a laboratory with its own topics and clocks. Then ONE READING is made
wrong in all of their bags, after the recording: an encoder's zero, a torque sensor's gain, a filter, a clock, the frame
of the motion capture (:mod:`benchmarks.faults` has the table). Physics and control stay as they were. The folder of
bags is diagnosed as every other one.

    ./run python -m benchmarks measurement -o DIR                                  all of them
    ./run python -m benchmarks measurement -o DIR --only encoder_offset --base nothing --on bench
    ./run python -m benchmarks measurement -o DIR --sample 60                      a part of them, of all kinds
    ./run python -m benchmarks measurement -o DIR --fault none quantised --base nothing --seeds 10         nulls
    cat DIR/*/row.json                                                             a JSON line for each campaign
    rm DIR/*/row.json                              then, scores the diagnoses that are there against another table

Bases: ``nothing`` hidden, or an effect of the library three times as large as a noticeable one.
Where: ``laboratory``, the MuJoCo cell under a controller of its own; ``plant``, our plant and controller, of whose bags
only what a laboratory has is left; ``bench``, the ready campaigns of ``$IMPACT_RS_TEST_DATA/lab``.

A fault is found where its effect is named, or cannot be told from a named one. A name is in vain where it is one of
physics and neither hidden nor tied with what is. Intervals are those of the effect that has the fault; parameters are
compared as differences from nominal. ``--campaigns`` keeps the campaigns without a fault, which all faults share; a
further seed is another recording of each of them, and another joint, sign and direction of every fault.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import statistics
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.boards.stripped import EXPERIMENT, strip_campaign
from benchmarks.faults import FAULTS, Fault, Truths, rewrite_campaign, seconds_of
from benchmarks.harness import Row, Work, share
from benchmarks.hidden import Entry, diagnosed, laboratory_runs
from benchmarks.results import Table
from impact_rs_analysis.diagnosis.document import DiagnosisDocument, EstimateDocument, read_document
from impact_rs_analysis.diagnosis.verdict import NOTHING
from impact_rs_sim.effects import library
from impact_rs_sim.errors import InputError
from impact_rs_sim.files import write_whole
from impact_rs_trials.blind import RUNS, TRUTH, make
from impact_rs_trials.workers import Map, processor_time

NOTHING_HIDDEN = "nothing"
BASES = (NOTHING_HIDDEN, "end_effector_payload", "object_mass", "joint_coulomb_friction", "support_friction")
MAGNITUDE, FIRST_SEED = 3.0, 5400  # parameter scales; of the bases
PLANTS = ("laboratory", "plant", "bench")
BENCHES = {  # folder, and what is hidden, of the ready campaigns
    NOTHING_HIDDEN: ("bench_0", {}),
    "object_mass": ("bench_1", {"scale": 1.15}),
    "joint_coulomb_friction": (
        "bench_2",
        {f"coulomb_joint{n}": value for n, value in enumerate((0.35, 0.30, 0.25, 0.30, 0.20, 0.15, 0.15), start=1)},
    ),
}


@dataclass(frozen=True)
class FaultCase:
    """One campaign with one fault.

    Attributes:
        fault: What is wrong with a reading.
        size: In the unit of the fault.
        base: What is hidden beneath.
        plant: Where it was recorded.
        seed: Joint, sign and direction of the fault depend on it.
    """

    fault: Fault
    size: float
    base: str
    plant: str
    seed: int

    @property
    def name(self) -> str:
        """Folder name."""
        return f"{self.fault.name}__{self.size:g}__{self.base}__{self.plant}__seed{self.seed}"


def add_options(parser: argparse.ArgumentParser) -> None:
    """Which campaigns, and which faults of them."""
    for option, choices, defaults, words in (
        ("--on", PLANTS, PLANTS[:2], "where it was recorded"),
        ("--base", BASES, BASES, "what is hidden beneath"),
        ("--fault", tuple(FAULTS), tuple(FAULTS), "what is wrong with a reading"),
    ):
        words = f"{words}: {', '.join(choices)}"
        parser.add_argument(option, nargs="+", choices=choices, default=list(defaults), metavar="NAME", help=words)
    parser.add_argument("--sample", type=int, metavar="N", help="only so many of these campaigns, drawn at random")
    parser.add_argument("--clear", action="store_true", help="only the larger size of every fault")
    parser.add_argument("--seeds", type=int, default=1, help="recordings of every base, each with faults of its own")
    parser.add_argument(
        "--first-seed", type=int, default=0, metavar="N", help="added to all seeds: other campaigns of the same kinds"
    )
    parser.add_argument("--campaigns", type=Path, metavar="DIR", help="folder of the campaigns without a fault")
    parser.add_argument("--keep-bags", action="store_true", help="leave the rewritten bags where they were diagnosed")


def cases(options: argparse.Namespace) -> list[FaultCase]:
    """Clear faults first, those on nothing hidden before the others."""
    fault_cases = [
        FaultCase(fault, fault.sizes[index], base, plant, options.first_seed + seed)
        for seed in range(options.seeds)
        for index in ((-1,) if options.clear else (-1, -2))
        for base in BASES
        if base in options.base
        for plant in options.on
        if plant != "bench" or base in BENCHES
        for fault in (FAULTS[name] for name in options.fault)
        if len(fault.sizes) >= -index
    ]
    drawn = np.random.default_rng(options.first_seed).permutation(len(fault_cases))[: options.sample]
    return [fault_cases[number] for number in sorted(drawn)]


def run(case: FaultCase, work: Work) -> Row:
    """Rewrite and diagnose one campaign, and hold the document against fault and physics."""
    campaigns = (work.options.campaigns or work.folder.parent / "campaigns").absolute()
    runs, hidden = base_of(case, campaigns, work.map_tasks)
    bags = work.folder.absolute() / RUNS
    drawn_fault = case.fault.drawn(case.size, case.seed, seconds_of(runs))
    document, seconds_file = work.folder / "diagnosis.json", work.folder / "seconds.json"
    row = {
        "fault": case.fault.name, "size": case.size, "unit": case.fault.unit, "joint": drawn_fault.joint + 1,
        "sign": drawn_fault.sign, "angle": drawn_fault.angle, "base": case.base, "plant": case.plant,
    }  # fmt: skip
    try:
        if not document.exists():
            rewrite_campaign(runs, bags, case.fault, drawn_fault)
            began = processor_time()
            diagnosed(document, lambda: laboratory_runs(bags, work.map_tasks), work.map_tasks)
            write_whole(seconds_file, f"{processor_time() - began}\n")
        row |= scored(read_document(document), case.fault.truths(drawn_fault), hidden)
        row["seconds"] = json.loads(seconds_file.read_text(encoding="utf-8"))
    except InputError as error:
        row |= refused(str(error), case.fault.truths(drawn_fault), hidden)
    if not work.options.keep_bags:
        shutil.rmtree(bags, ignore_errors=True)
    return row


def base_of(case: FaultCase, campaigns: Path, map_tasks: Map) -> tuple[Path, Truths]:
    """Bags of a campaign without a fault, recorded where they are missing, and the physics that it hides.

    Raises:
        InputError: There are no ready campaigns.
    """
    if case.plant == "bench":
        return _bench(case.base, campaigns / f"{case.base}__bench")
    folder = campaigns / f"{case.base}__{case.plant}__seed{case.seed}"
    null = case.base == NOTHING_HIDDEN
    seed = FIRST_SEED + 10 * case.seed + BASES.index(case.base)
    entry = Entry("null" if null else "single", None if null else case.base, None if null else MAGNITUDE, seed)
    runs = folder / RUNS
    if case.plant == "laboratory":
        from benchmarks.foreign import laboratory  # MuJoCo is a peer, not installed everywhere

        laboratory.make(entry, folder, map_tasks)
    else:
        for _ in make(folder, seed, map_tasks, entry.kind, entry.effect, "small", entry.magnitude):
            pass
        runs = folder / "stripped"
        strip_campaign(folder, runs)
    truth = json.loads((folder / TRUTH).read_text(encoding="utf-8"))["effects"]
    return runs, differences(
        {effect["name"]: {k: v["value"] for k, v in effect["parameters"].items()} for effect in truth}
    )


def _bench(base: str, folder: Path) -> tuple[Path, Truths]:
    """A copy of a ready campaign, with the description that it lacks."""
    data = os.environ.get("IMPACT_RS_TEST_DATA", "")
    name, values = BENCHES[base]
    source = Path(data) / "lab" / name
    if not data or not source.is_dir():
        raise InputError(f"no ready campaign {name}; IMPACT_RS_TEST_DATA names the folder of measured data")
    if not (folder / "experiment.yaml").exists():
        shutil.copytree(source, folder, dirs_exist_ok=True, copy_function=shutil.copyfile)
        (folder / "experiment.yaml").write_text(EXPERIMENT, encoding="utf-8")
    return folder, differences({base: values} if values else {})


def differences(effects: Mapping[str, Mapping[str, float]]) -> Truths:
    """Parameters of effects of the library as differences from nominal."""
    nominal = {
        name: {parameter.name: parameter.nominal for parameter in library()[name].scalars(7)} for name in effects
    }
    return {
        name: {key: value - nominal[name][key] for key, value in values.items()} for name, values in effects.items()
    }


def scored(document: DiagnosisDocument, faults: Truths, hidden: Truths) -> Row:
    """A diagnosis against what is wrong with the readings, and what the physics hides.

    Args:
        document: Diagnosis.
        faults: Effects that describe the fault, its own effect first; empty: no reading is wrong.
        hidden: Effects of physics.
    """
    groups = [set(group) for group in document.confusable]

    def tied_with(name: str) -> set[str]:
        return {name}.union(*(group for group in groups if name in group))

    def is_named(name: str) -> bool:
        return any(name in tied_with(other) for other in document.named)

    named, effects = set(document.named), library()
    sensing = {name for name in named if name in effects and effects[name].acts_on == "sensing"}
    true = set(faults) | set(hidden)
    in_vain = [name for name in document.named if not tied_with(name) & true]
    found_fault = next((name for name in faults if is_named(name)), None)
    return {
        "verdict": str(document.verdict),
        "named": list(document.named),
        "fault_found": any(map(is_named, faults)) if faults else None,
        "fault_by_own_name": bool(set(faults) & named) if faults else None,
        "fault_covered": _covered(document, found_fault, faults.get(found_fault or "", {})),
        "physics_right": all(map(is_named, hidden)) if hidden else None,
        "physics_covered": [_covered(document, name, values) for name, values in hidden.items()],
        "physics_in_vain": [name for name in in_vain if name not in sensing],
        "readings_in_vain": [name for name in in_vain if name in sensing],
        "exact": named - set(faults) == set(hidden) and len(named & set(faults)) == bool(faults),
        "nothing_missing": document.verdict == NOTHING,
        "before": document.held_out_error_before,
        "after": document.held_out_error_after,
        "noise": document.noise_floor,
        "estimates": {
            effect.name: {
                key: [value.estimate, *value.interval, value.unit] for key, value in effect.parameters.items()
            }
            for effect in document.effects
            if effect.name in named | true
        },
        "truth": {name: dict(values) for name, values in {**faults, **hidden}.items()},
        "remarks": list(document.remarks),
        "said": f"{document.verdict}, {document.held_out_error_before:.3g} -> {document.held_out_error_after:.3g}",
    }  # fmt: skip


def refused(reason: str, faults: Truths, hidden: Truths) -> Row:
    """A campaign that was not diagnosed."""
    return {
        "verdict": "REFUSED",
        "named": [],
        "physics_in_vain": [],
        "readings_in_vain": [],
        "exact": False,
        "seconds": None,
        "fault_found": False if faults else None,
        "fault_by_own_name": False if faults else None,
        "fault_covered": None,
        "physics_right": False if hidden else None,
        "physics_covered": [],
        "nothing_missing": False,
        "said": f"REFUSED: {reason}",
    }


def _covered(document: DiagnosisDocument, name: str | None, values: Mapping[str, float]) -> list[int] | None:
    """True parameters in their intervals, and how many there are; None: the effect or its numbers are not known."""
    effect = None if name is None else document.effect(name)
    if effect is None or not values:
        return None
    estimates = {key: estimate for key, estimate in effect.parameters.items() if key in values}
    return [sum(_holds(estimate, values[key]) for key, estimate in estimates.items()), len(values)]


def _holds(estimate: EstimateDocument, difference: float) -> bool:
    """Whether the interval of an estimate contains nominal + ``difference``."""
    low, high = estimate.interval
    return low <= (estimate.nominal or 0.0) + difference <= high


def table(rows: list[Row], options: argparse.Namespace) -> Table:
    """A row for each fault, then all of them."""
    del options
    lines = [(_words(group[0]["fault"]), *_cells(group)) for group in _by(rows, "fault").values()]
    with_fault = [row for row in rows if row["fault_found"] is not None]
    lines += [
        (f"all faults, {words}", *_cells(group))
        for words, group in (
            ("nothing hidden", [row for row in with_fault if row["base"] == NOTHING_HIDDEN]),
            ("physics beneath", [row for row in with_fault if row["base"] != NOTHING_HIDDEN]),
        )
        if group
    ]
    return Table(HEAD, tuple(lines))


HEAD = (
    "Wrong reading", "Campaigns", "Fault named, or in the tie", "Interval holds the truth", "Physics beneath right",
    "A name of physics in vain", "Exactly right", "Processor time, median [s]",
)  # fmt: skip


def _words(name: str) -> str:
    sizes = " and ".join(f"{size:g}" for size in FAULTS[name].sizes)
    return name.replace("_", " ") + (f", {sizes} {FAULTS[name].unit}" if FAULTS[name].unit else "")


def _by(rows: list[Row], key: str) -> dict[str, list[Row]]:
    """Rows by a value, in the order of the table of faults."""
    return {value: group for value in FAULTS if (group := [row for row in rows if row[key] == value])}


def _cells(rows: list[Row]) -> tuple[str, ...]:
    inside = [row["fault_covered"] for row in rows if row["fault_covered"]]
    seconds = [row["seconds"] for row in rows if row["seconds"] is not None]
    return (
        str(len(rows)),
        share(row["fault_found"] for row in rows),
        _share_of(inside),
        share(row["physics_right"] for row in rows),
        share(row["physics_in_vain"] for row in rows),
        share(row["exact"] for row in rows),
        f"{statistics.median(seconds):.0f}" if seconds else "–",
    )


def _share_of(counts: Collection[Any]) -> str:
    return f"{sum(count[0] for count in counts)} of {sum(count[1] for count in counts)}" if counts else "–"
