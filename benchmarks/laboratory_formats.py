# SPDX-License-Identifier: Apache-2.0
"""One laboratory campaign as bags, as CSV and as Parquet: the diagnosis must not depend on the kind of file.

    ./run python benchmarks/laboratory_formats.py FOLDER_OF_BAGS -o DIR [--formats bags csv parquet] [--jobs 2]

The bags are those of the mapping ``joint_state_effort_controller`` with a ``runs.csv``. Each format has a folder in DIR
with tables, mapping, experiment file and, once it was made, the diagnosis, which is kept:

    csv       a table per run: one column of time, a row for every stamp of any signal, cells without a sample empty,
              columns in no order; s, rad, m
    parquet   a folder per run with a table per stream at its own rate; ns, mrad, mm, quaternions with w first
"""

from __future__ import annotations

import argparse
import csv
import shutil
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow
import pyarrow.parquet
import yaml
from rich.console import Console
from rich.table import Table

from impact_rs_analysis.diagnosis.diagnose import diagnose
from impact_rs_analysis.diagnosis.document import DiagnosisDocument, read_document, write_document
from impact_rs_analysis.evidence.laboratory import read_laboratory_runs
from impact_rs_analysis.evidence.replays import ReplaySource
from impact_rs_analysis.evidence.store import ReplayStore
from impact_rs_sim.model import load_model
from impact_rs_sim.paths import config_directory
from impact_rs_trials.recordings.experiment import load_experiment
from impact_rs_trials.recordings.mapping import SignalName, load_mapping
from impact_rs_trials.recordings.series import Series
from impact_rs_trials.recordings.sources import read_series
from impact_rs_trials.workers import Map, Workforce, workers

MAPPING = "joint_state_effort_controller"
JOINT_STATES: tuple[SignalName, ...] = ("position", "velocity", "torque")
PREFIX = {"position": "position", "velocity": "velocity", "torque": "effort", "command": "command"}
POSE = ("object_x", "object_y", "object_z", "object_qx", "object_qy", "object_qz", "object_qw")
DIGITS = 10  # significant digits of a number in a CSV file
TO_MILLI = {"rad": "mrad", "rad/s": "mrad/s", "N m": "mN m", "m": "mm"}

console = Console(width=150)


def columns_of(name: SignalName, series: Series) -> dict[str, np.ndarray]:
    """Columns of one signal by the names that the shipped mapping has for them, SI."""
    names = POSE if name == "object_pose" else [f"{PREFIX[name]}_{j + 1}" for j in range(series.values.shape[1])]
    return dict(zip(names, series.values.T, strict=True))


def shipped() -> dict[str, Any]:
    """Content of the shipped mapping."""
    return dict(yaml.safe_load((config_directory() / "mappings" / f"{MAPPING}.yaml").read_text(encoding="utf-8")))


def csv_mapping() -> dict[str, Any]:
    """The shipped one already names columns, with one column of time."""
    return shipped()


def write_csv(path: Path, series: dict[SignalName, Series]) -> None:
    """One table with a row for every stamp, its columns in no order."""
    stamps = np.unique(np.concatenate([one.time for one in series.values()]))
    columns = {}
    for name, one in series.items():
        rows = np.searchsorted(stamps, one.time)
        for label, values in columns_of(name, one).items():
            cells = np.full(stamps.size, "", dtype=object)
            cells[rows] = [f"{value:.{DIGITS}g}" for value in values]
            columns[label] = cells
    columns["time"] = np.array([f"{stamp:.7f}" for stamp in stamps], dtype=object)
    order = np.random.default_rng(0).permutation(sorted(columns))
    with path.with_suffix(".csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(order)
        writer.writerows(zip(*(columns[label] for label in order), strict=True))


def parquet_mapping() -> dict[str, Any]:
    """A file per stream, thousandths of the units, stamps in ns."""
    content = shipped()
    content["time"] = {"column": "stamp", "unit": "ns"}
    for name, source in content["signals"].items():
        source["file"] = "joints.parquet" if name in JOINT_STATES else f"{name}.parquet"
        source["unit"] = TO_MILLI[source["unit"]]
    pose = content["signals"]["object_pose"]
    pose["columns"], pose["quaternion_order"] = [*POSE[:3], POSE[6], *POSE[3:6]], "wxyz"
    return content


def write_parquet(path: Path, series: dict[SignalName, Series]) -> None:
    """A folder with a table per stream."""
    path.mkdir()
    files: dict[str, dict[str, np.ndarray]] = {}
    for name, one in series.items():
        table = files.setdefault("joints" if name in JOINT_STATES else name, {})
        table["stamp"] = np.rint(1e9 * one.time).astype(np.int64)
        for label, values in columns_of(name, one).items():
            table[label] = values if label.startswith("object_q") else 1e3 * values
    for stem, table in files.items():
        order = np.random.default_rng(0).permutation(sorted(table))
        pyarrow.parquet.write_table(pyarrow.table({label: table[label] for label in order}), path / f"{stem}.parquet")


FORMATS: dict[str, tuple[Callable[[], dict[str, Any]], Callable[[Path, dict[SignalName, Series]], None]]] = {
    "csv": (csv_mapping, write_csv),
    "parquet": (parquet_mapping, write_parquet),
}


def prepare(bags: Path, folder: Path, kind: str) -> None:
    """The campaign in one format, with its experiment file; what exists is kept."""
    if (folder / "experiment.yaml").exists():
        return
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    experiment = {"scenario": "push", "mapping": MAPPING, "runs": str((bags / "runs.csv").absolute())}
    if kind != "bags":
        content, write = FORMATS[kind]
        mapping = load_mapping(MAPPING)
        with (bags / "runs.csv").open(encoding="utf-8") as file:
            names = [row["bag"] for row in csv.DictReader(file)]
        for name in names:
            wanted = tuple(mapping.signals)
            write(folder / name, read_series(bags / name, mapping, wanted, JOINT_STATES))
        (folder / "mapping.yaml").write_text(yaml.safe_dump(content()), encoding="utf-8")
        experiment["mapping"] = "mapping.yaml"
    (folder / "experiment.yaml").write_text(yaml.safe_dump(experiment, sort_keys=False), encoding="utf-8")


def diagnosed(recordings: Path, folder: Path, map_tasks: Map) -> tuple[DiagnosisDocument, float]:
    """The diagnosis of one format, and how long it took [s], 0 where it was there."""
    document, began = folder / "diagnosis.json", time.perf_counter()
    if not document.exists():
        runs = read_laboratory_runs(recordings, load_experiment(folder / "experiment.yaml"), map_tasks)
        source = ReplaySource.of(runs, load_model("nominal"), ReplayStore(map_tasks))
        write_document(diagnose(source, source.model), document)
        return read_document(document), time.perf_counter() - began
    return read_document(document), 0.0


def rows_of(document: DiagnosisDocument) -> dict[str, str]:
    """What is compared: verdict, errors, and every estimate of what was named with its interval."""
    rows = {
        "verdict": document.verdict,
        "named": ", ".join(document.named) or "-",
        "error": f"{document.held_out_error_before:.6g} -> {document.held_out_error_after:.6g}",
    }
    for effect in document.effects:
        for name, value in effect.parameters.items() if effect.name in document.named else ():
            low, high = value.interval
            rows[f"{effect.name}.{name}"] = f"{value.estimate:.6g} [{low:.6g}, {high:.6g}] {value.unit}"
    return rows


def furthest(first: DiagnosisDocument, second: DiagnosisDocument) -> float:
    """Largest difference of an estimate of two diagnoses, in half widths of its interval [-]."""
    apart = [0.0]
    for effect in first.effects:
        if (other := second.effect(effect.name)) is None:
            continue
        for name, value in effect.parameters.items():
            low, high = value.interval
            if np.isfinite(high - low) and high > low:
                apart.append(2.0 * abs(value.estimate - other.parameters[name].estimate) / (high - low))
    return max(apart)


def main() -> None:
    """Convert, diagnose and print the formats side by side."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bags", type=Path, help="folder of bags with runs.csv")
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder of what is made")
    parser.add_argument("--formats", nargs="+", choices=("bags", *FORMATS), default=["bags", *FORMATS])
    parser.add_argument("--jobs", type=int, default=2, help="worker processes")
    arguments = parser.parse_args()
    found: dict[str, DiagnosisDocument] = {}
    with workers(Workforce(arguments.jobs)) as map_tasks:
        for kind in arguments.formats:
            folder = arguments.output / kind
            prepare(arguments.bags, folder, kind)
            recordings = (arguments.bags if kind == "bags" else folder).absolute()
            found[kind], seconds = diagnosed(recordings, folder, map_tasks)
            console.print(f"{kind}: {found[kind].verdict}" + (f", {seconds:.0f} s" if seconds else ""))
    rows = {kind: rows_of(document) for kind, document in found.items()}
    table = Table("", *found)
    for label in dict.fromkeys(label for own in rows.values() for label in own):
        table.add_row(label, *(own.get(label, "-") for own in rows.values()))
    first = next(iter(found.values()))
    table.add_row(
        "estimates apart, in half intervals", *(f"{furthest(first, document):.1e}" for document in found.values())
    )
    console.print(table)


if __name__ == "__main__":
    main()
