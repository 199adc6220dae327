# SPDX-License-Identifier: Apache-2.0
"""Damaged raw files against their readers: ``./run python -m benchmarks.attacks --count 500 --seed 1``.

Clean files of joints, of a bouncing ball, of impacts in a table and of a robot are made, one attack is made on each of
many copies, and ``import``, ``compare``, ``impacts`` and ``robot import`` run on them in this process:

    refused   exit code 2, and no file is left
    same      exit code 0, and the same numbers as from the clean file
    said      exit code 0, other numbers, and a note, an assumption or a count that the clean file does not have
    silent    exit code 0, other numbers, and not a word: a defect
    broken    an exception, a warning of a library, another exit code, or a file left by a refusal: a defect

Attacks that leave a valid file with other numbers, as a changed digit does, are not made: no reader can see them.
"""

from __future__ import annotations

import argparse
import contextlib
import gzip
import io
import os
import re
import shutil
import sys
import tempfile
import time
import traceback
import warnings
import zipfile
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pinocchio as pin
import pyarrow as pa
import pyarrow.parquet as pq
import scipy.io

from impact_rs_cli.main import main as command_line
from impact_rs_sim.errors import InputError
from impact_rs_sim.robot import load_facts
from impact_rs_sim.robot_model import RobotModel
from impact_rs_trials.recordings.mapping import MountedEndEffector, load_mapping
from impact_rs_trials.recordings.recording import read_recordings

ROBOT = "kuka_iiwa7"
JOINTS = range(1, 8)
NAMES = ("t", *(f"{name}_{joint}" for name in ("q", "dq", "tau") for joint in JOINTS))
GRAVITY = 9.81  # m/s^2
Rng = np.random.Generator
Table = list[list[str]]

URDF = """<robot name="arm">
<link name="base"/><link name="upper"><inertial><origin xyz="0 0 0.2"/><mass value="3"/>
<inertia ixx="0.05" iyy="0.05" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="lower"><inertial><origin xyz="0 0 0.15"/><mass value="2"/>
<inertia ixx="0.02" iyy="0.02" izz="0.005" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><origin xyz="0 0 0.1"/>
<axis xyz="0 1 0"/><limit lower="-2" upper="2" velocity="2" effort="80"/></joint>
<joint name="elbow" type="revolute"><parent link="upper"/><child link="lower"/><origin xyz="0 0 0.4"/>
<axis xyz="0 1 0"/><limit lower="-2" upper="2" velocity="2" effort="40"/></joint></robot>
"""
EXPERIMENT = """mapping: mapping.yaml
runs: runs.csv
body: {mass: 0.05, radius: 0.03, spin: [0, 0, 0]}
plane: {height: 0.0}
"""
BALL = """description: a ball
robot: none
time: {column: t}
signals:
  object_position: {columns: [x, y, z], unit: m}
"""
MAPPING = f"""description: joints
robot: {ROBOT}
joints: [{", ".join(f"joint{joint}" for joint in JOINTS)}]
time: {{column: t, array: t}}
signals:
"""


def joint_motion() -> dict[str, np.ndarray]:
    """An iiwa that swings for 8 s at 50 Hz, with friction and noise: t, q, dq, tau."""
    model = RobotModel(load_facts(ROBOT), MountedEndEffector().build(), pin.SE3.Identity())
    t = 0.02 * np.arange(400)
    speed, centre = 2.0 * np.pi * np.linspace(0.3, 0.6, 7), np.array([0.1, 0.6, 0.2, -1.2, 0.3, 0.9, 0.1])
    angle = speed * t[:, None] + np.arange(7.0)
    q, dq, ddq = centre + 0.35 * np.sin(angle), 0.35 * speed * np.cos(angle), -0.35 * speed**2 * np.sin(angle)
    tau = np.array([model.inverse_dynamics(*state) for state in zip(q, dq, ddq, strict=True)])
    rng = np.random.default_rng(0)
    tau += 0.3 * np.tanh(20.0 * dq) + 0.02 * rng.standard_normal(tau.shape)
    return {"t": t, "q": np.round(q, 6), "dq": np.round(dq, 6), "tau": np.round(tau, 5)}


def rows_of(columns: dict[str, np.ndarray]) -> Table:
    """The table of a motion, names first."""
    numbers = np.column_stack([columns[name] for name in ("t", "q", "dq", "tau")])
    return [list(NAMES), *([f"{value:.10g}" for value in row] for row in numbers.tolist())]


def bounce(run: int) -> Table:
    """A ball that falls onto a plane and leaves it, at 200 Hz."""
    t = 0.005 * np.arange(120)
    hit, fall = 0.3, 0.1 * run + 2.5
    z = 0.03 + np.where(
        t < hit,
        fall * (hit - t) - 0.5 * GRAVITY * (hit - t) ** 2,
        0.7 * fall * (t - hit) - 0.5 * GRAVITY * (t - hit) ** 2,
    )
    noise = 1e-4 * np.random.default_rng(run).standard_normal((t.size, 3))
    place = np.column_stack((0.4 * t, -0.2 * t, z)) + noise
    return [["t", "x", "y", "z"], *([f"{value:.7g}" for value in row] for row in np.column_stack((t, place)).tolist())]


def impacts_of_a_ball() -> Table:
    """Impacts of a ball on a plane, with friction 0.1 and restitution 0.6."""
    rng = np.random.default_rng(3)
    head = [f"v{axis}_before [m/s]" for axis in "xyz"] + [f"w{axis}_before [rad/s]" for axis in "xyz"]
    head += [*(f"v{axis}_after [m/s]" for axis in "xyz"), "mass [kg]", "radius [m]"]
    rows = []
    for _ in range(40):
        vx, vz = rng.uniform(1.0, 2.0), -rng.uniform(1.0, 3.0)
        after = np.array([vx + 0.16 * vz, 0.0, -0.6 * vz]) + 0.01 * rng.standard_normal(3)
        rows.append([f"{value:.6g}" for value in (vx, 0.0, vz, 0.0, 0.0, 0.0, *after, 0.05, 0.03)])
    return [head, *rows]


def text_of(rows: Table, separator: str = ",") -> bytes:
    """A table as text."""
    return ("\n".join(separator.join(row) for row in rows) + "\n").encode()


# ---- attacks on texts: of the rows, or of the bytes ------------------------------------------------------------------


def _cell(word: str) -> Callable[[Table, Rng], bytes]:
    def attack(rows: Table, rng: Rng) -> bytes:
        for _ in range(int(rng.integers(1, 4))):
            rows[int(rng.integers(1, len(rows)))][int(rng.integers(len(rows[0])))] = word
        return text_of(rows)

    return attack


def _column(word: str) -> Callable[[Table, Rng], bytes]:
    def attack(rows: Table, rng: Rng) -> bytes:
        column = int(rng.integers(len(rows[0])))
        for row in rows[1:]:
            row[column] = word
        return text_of(rows)

    return attack


def _cut(rows: Table, rng: Rng) -> bytes:
    content = text_of(rows)
    end = int(rng.integers(len(content)))
    line = content[:end].rpartition(b"\n")[2]
    # Within the last cell of a row a cut leaves another valid number.
    return content[: end - len(line)] if line.count(b",") == len(rows[0]) - 1 else content[:end]


def _lost_rows(rows: Table, rng: Rng) -> bytes:
    first = int(rng.integers(len(rows) // 20, len(rows) // 2))
    return text_of(rows[:first] + rows[first + len(rows) // 4 :])


def _doubled_rows(rows: Table, rng: Rng) -> bytes:
    first = int(rng.integers(1, len(rows) - 5))
    return text_of(rows[: first + 5] + rows[first:])


def _shuffled(rows: Table, rng: Rng) -> bytes:
    return text_of([rows[0], *(rows[1 + int(number)] for number in rng.permutation(len(rows) - 1))])


def _swapped_rows(rows: Table, rng: Rng) -> bytes:
    first = int(rng.integers(1, len(rows) - 3))
    rows[first], rows[first + 2] = rows[first + 2], rows[first]
    return text_of(rows)


def _swapped_columns(rows: Table, rng: Rng) -> bytes:
    # Of a ball x and z: to swap x and y would leave a valid file.
    one, other = (1, 3) if len(rows[0]) == 4 else rng.choice(len(rows[0]) // 3, 2, replace=False) + 1
    for row in rows[1:]:
        row[one], row[other] = row[other], row[one]
    return text_of(rows)


def _mixed_units(rows: Table, rng: Rng) -> bytes:
    heavy = [NAMES.index(f"tau_{joint}") for joint in (2, 4)]  # a torque without weight may have any scale
    joints = [*range(1, 15), *heavy] if rows[0] == list(NAMES) else range(1, len(rows[0]))
    column, first = int(rng.choice(joints)), int(rng.integers(len(rows) // 4, 3 * len(rows) // 4))
    for row in rows[first:]:
        row[column] = f"{float(row[column]) * 57.29578:.7g}"
    return text_of(rows)


def _huge_offset(rows: Table, rng: Rng) -> bytes:
    column = int(rng.integers(1, len(rows[0])))  # stamps may count from any moment
    for row in rows[1:]:
        row[column] = f"{float(row[column]) + 1e12:.17g}"
    return text_of(rows)


def _missing_column(rows: Table, rng: Rng) -> bytes:
    column = int(rng.integers(len(rows[0])))
    return text_of([row[:column] + row[column + 1 :] for row in rows])


def _same_names(rows: Table, rng: Rng) -> bytes:
    one, other = rng.choice(len(rows[0]), 2, replace=False)
    rows[0][one] = rows[0][other]
    return text_of(rows)


def _short_row(rows: Table, rng: Rng) -> bytes:
    row = rows[int(rng.integers(1, len(rows)))]
    del row[int(rng.integers(len(row))) :]
    return text_of(rows)


def _long_row(rows: Table, rng: Rng) -> bytes:
    row = rows[int(rng.integers(1, len(rows)))]
    row.insert(int(rng.integers(len(row))), "0.5")
    return text_of(rows)


def _names_again(rows: Table, rng: Rng) -> bytes:
    rows.insert(int(rng.integers(2, len(rows))), list(rows[0]))
    return text_of(rows)


def _remark_inside(rows: Table, rng: Rng) -> bytes:
    rows.insert(int(rng.integers(2, len(rows))), ["# restarted"])
    return text_of(rows)


def _comma_for_point(rows: Table, _: Rng) -> bytes:
    return text_of(rows, ";").replace(b".", b",")


def _commas_everywhere(rows: Table, _: Rng) -> bytes:
    return text_of(rows).replace(b".", b",")


def _quoted(rows: Table, _: Rng) -> bytes:
    return text_of([[f'"{cell}"' for cell in row] for row in rows])


def _open_quote(rows: Table, rng: Rng) -> bytes:
    row = rows[int(rng.integers(1, len(rows)))]
    row[1] = '"' + row[1]
    return text_of(rows)


def _thousands(rows: Table, rng: Rng) -> bytes:
    row = rows[int(rng.integers(1, len(rows)))]
    row[int(rng.integers(len(row)))] = '"1,234.5"'
    return text_of(rows)


def _flipped(rows: Table, rng: Rng) -> bytes:
    """Bytes that are no digits of numbers take the places of some."""
    content = bytearray(text_of(rows))
    for _ in range(int(rng.integers(1, 6))):
        content[int(rng.integers(len(content)))] = int(rng.choice([0, 7, 0x80, 0xFF, *b"x;\t\"'\\"]))
    return bytes(content)


TEXT: dict[str, Callable[[Table, Rng], bytes]] = {
    "empty": lambda rows, rng: b"",
    "blank": lambda rows, rng: b"\n \n\t\n",
    "names only": lambda rows, rng: text_of(rows[:1]),
    "one row": lambda rows, rng: text_of(rows[:2]),
    "no names": lambda rows, rng: text_of(rows[1:]),
    "cut": _cut,
    "nan": _cell("nan"),
    "inf": _cell("inf"),
    "-inf": _cell("-inf"),
    "huge": _cell("1e300"),
    "beyond float": _cell("1e999"),
    "word": _cell("abc"),
    "empty cell": _cell(""),
    "underscore": _cell("1_0"),
    "other digits": _cell("１２"),
    "hexadecimal": _cell("0x1p3"),
    "two signs": _cell("+-1"),
    "column of zeros": _column("0"),
    "column of nan": _column("nan"),
    "column of words": _column("n/a"),
    "lost rows": _lost_rows,
    "doubled rows": _doubled_rows,
    "shuffled": _shuffled,
    "swapped rows": _swapped_rows,
    "swapped columns": _swapped_columns,
    "reversed": lambda rows, rng: text_of([rows[0], *rows[:0:-1]]),
    "mixed units": _mixed_units,
    "huge offset": _huge_offset,
    "missing column": _missing_column,
    "same names": _same_names,
    "short row": _short_row,
    "long row": _long_row,
    "names again": _names_again,
    "remark inside": _remark_inside,
    "comma for point": _comma_for_point,
    "commas everywhere": _commas_everywhere,
    "quoted": _quoted,
    "open quote": _open_quote,
    "thousands": _thousands,
    "flipped": _flipped,
    "byte order mark": lambda rows, rng: b"\xef\xbb\xbf" + text_of(rows),
    "latin-1": lambda rows, rng: text_of([[f"{name} \xb0" for name in rows[0]], *rows[1:]]).decode().encode("latin-1"),
    "utf-16": lambda rows, rng: text_of(rows).decode().encode("utf-16"),
    "crlf": lambda rows, rng: text_of(rows).replace(b"\n", b"\r\n"),
    "cr": lambda rows, rng: text_of(rows).replace(b"\n", b"\r"),
    "tabs": lambda rows, rng: text_of(rows, "\t"),
    "markup": lambda rows, rng: text_of([[f"[red]{name}[/x]" for name in rows[0]], *rows[1:]]),
    "one long line": lambda rows, rng: text_of(rows).replace(b"\n", b","),
    "bytes": lambda rows, rng: rng.bytes(3000),
    "zeros": lambda rows, rng: bytes(3000),
    "gzip": lambda rows, rng: gzip.compress(text_of(rows)),
    "zip": lambda rows, rng: _zipped(text_of(rows)),
}  # fmt: skip


def _zipped(content: bytes) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("log.csv", content)
    return file.getvalue()


# ---- attacks on arrays ----------------------------------------------------------------------------------------------


def _first_half(arrays: dict[str, Any]) -> dict[str, Any]:
    return arrays | {"tau": arrays["tau"][:200]}


ARRAYS: dict[str, Callable[[dict[str, Any], Rng], dict[str, Any]]] = {
    "other lengths": lambda arrays, rng: _first_half(arrays),
    "three axes": lambda arrays, rng: arrays | {"q": arrays["q"][:, :, None]},
    "one axis": lambda arrays, rng: arrays | {"q": arrays["q"].ravel()},
    "objects": lambda arrays, rng: arrays | {"q": arrays["q"].astype(object)},
    "all objects": lambda arrays, rng: {name: value.astype(object) for name, value in arrays.items()},
    "texts": lambda arrays, rng: arrays | {"q": arrays["q"].astype(str)},
    "complex": lambda arrays, rng: arrays | {"q": arrays["q"] * 1j},
    "whole numbers": lambda arrays, rng: arrays | {"q": arrays["q"].astype(int)},
    "other bytes": lambda arrays, rng: {name: value.astype(">f8") for name, value in arrays.items()},
    "transposed": lambda arrays, rng: {name: np.asfortranarray(value.T) for name, value in arrays.items()},
    "nan": lambda arrays, rng: arrays | {"tau": np.where(rng.random((400, 7)) < 0.01, np.nan, arrays["tau"])},
    "inf": lambda arrays, rng: arrays | {"dq": np.where(rng.random((400, 7)) < 0.01, np.inf, arrays["dq"])},
    "huge": lambda arrays, rng: arrays | {"q": np.where(rng.random((400, 7)) < 0.01, 1e300, arrays["q"])},
    "no stamps": lambda arrays, rng: {name: arrays[name] for name in ("q", "dq", "tau")},
    "stamps of zero": lambda arrays, rng: arrays | {"t": np.zeros(400)},
    "stamps back": lambda arrays, rng: arrays | {"t": arrays["t"][::-1]},
    "nothing": lambda arrays, rng: {},
    "empty arrays": lambda arrays, rng: {name: value[:0] for name, value in arrays.items()},
    "records": lambda arrays, rng: arrays | {"q": np.zeros(400, dtype=[("a", float), ("b", float)])},
    "swapped columns": lambda arrays, rng: arrays | {"q": arrays["q"][:, [0, 3, 2, 1, 4, 5, 6]]},
}  # fmt: skip
BYTES: dict[str, Callable[[bytes, Rng], bytes]] = {
    "empty": lambda content, rng: b"",
    "cut": lambda content, rng: content[: int(rng.integers(len(content)))],
    "cut at the end": lambda content, rng: content[: -int(rng.integers(1, 60))],
    "bytes": lambda content, rng: rng.bytes(2000),
    "text": lambda content, rng: b"t,q_1,q_2\n0,1,2\n",
    "gzip": lambda content, rng: gzip.compress(content),
    "zip": lambda content, rng: _zipped(content),
    "head lost": lambda content, rng: content[16:],
}  # fmt: skip


def _saved(path: Path, arrays: dict[str, Any]) -> None:
    """Write arrays in the format that the suffix says; MATLAB files are of version 5."""
    if path.suffix == ".npz":
        np.savez(path, **arrays)
    elif path.suffix == ".npy":
        parts = [np.asarray(value).reshape(len(value), -1) for value in arrays.values()]
        np.save(path, np.hstack(parts) if len({len(part) for part in parts}) == 1 else parts[0])
    elif path.suffix == ".mat":
        scipy.io.savemat(path, arrays)
    elif path.suffix == ".parquet":
        columns = {}
        for name, value in arrays.items():
            for number, column in enumerate(np.asarray(value).reshape(len(value), -1).T, 1):
                columns[name if name == "t" else f"{name}_{number}"] = pa.array(column.tolist())
        pq.write_table(pa.table(columns), path)
    else:
        with h5py.File(path, "w") as file:
            for name, value in arrays.items():
                file.create_dataset(name, data=value)


# ---- one case -------------------------------------------------------------------------------------------------------


@dataclass
class Case:
    """One attack, and what came of it."""

    number: int
    command: str
    form: str
    attack: str
    verdict: str = ""
    why: str = ""

    @property
    def name(self) -> str:
        """In a line."""
        return f"{self.number}: {self.command}, {self.form}, {self.attack}"


@dataclass
class Answer:
    """What a command line said."""

    code: int
    words: str
    broken: str = ""
    numbers: Any = None

    @property
    def notes(self) -> Counter[str]:
        """Notes, reasons and assumptions, without their numbers, and how many samples and impacts there are."""
        said = [re.sub(r"\d[\d.e+-]*", "#", line) for line in re.split("[\n│]", self.words)]
        counted = re.findall(r"\d+ (?:samples|impacts?|recordings?|outliers?)(?: of \d+ runs)?", self.words)
        return Counter(counted) + Counter(line for line in said if re.search("note:|left out|ASSUMED", line))


def ask(*words: str | Path) -> Answer:
    """Run a command line in this process."""
    out, code, broken = io.StringIO(), -1, ""
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(out), warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        try:
            code = command_line([str(word) for word in words])
        except BaseException:
            broken = traceback.format_exc().strip().splitlines()[-1]
    said = out.getvalue()
    strange = [
        str(one.message) for one in seen if issubclass(one.category, RuntimeWarning | np.exceptions.ComplexWarning)
    ]
    broken = broken or ("Traceback in its output" if "Traceback" in said else "") or (strange[0] if strange else "")
    if not broken and code not in (0, 2):
        broken = f"exit code {code}: {said.strip().splitlines()[-1] if said.strip() else ''}"
    return Answer(code, said, broken)


@dataclass
class Scene:
    """Clean files and what is said of them."""

    folder: Path
    motion: dict[str, np.ndarray] = field(default_factory=joint_motion)
    clean: dict[tuple[str, str], Answer] = field(default_factory=dict)

    def write(self, case: Case, rng: Rng | None) -> Path:
        """The file of a case, damaged where a generator is given."""
        path = self.folder / f"case_{case.number}" / f"log{case.form}"
        path.parent.mkdir(parents=True)
        if case.command == "robot import":
            content = URDF.encode()
        elif case.form in (".csv", ".txt", ".tsv"):
            rows = {"impacts": bounce(1), "compare --impacts": impacts_of_a_ball()}.get(case.command) or rows_of(
                self.motion
            )
            separator = "\t" if case.form == ".tsv" else ","
            content = (
                text_of(rows, separator) if rng is None or case.attack not in TEXT else TEXT[case.attack](rows, rng)
            )
        else:
            arrays = dict(self.motion)
            if rng is not None and case.attack in ARRAYS:
                arrays = ARRAYS[case.attack](arrays, rng)
            try:
                _saved(path, arrays)
            except (
                TypeError,
                ValueError,
                KeyError,
                IndexError,
                OverflowError,
                pa.ArrowException,
            ):  # not every format holds all
                _saved(path, {name: value for name, value in self.motion.items() if name != "q"})
            content = path.read_bytes()
        if rng is not None and case.attack in BYTES:
            content = BYTES[case.attack](content, rng)
        path.write_bytes(content)
        if rng is not None:
            _as_something_else(path, case.attack)
        return path

    def run(self, case: Case, path: Path) -> Answer:
        """Run the command of a case on its file."""
        out = path.parent / {"impacts": "out.csv", "robot import": "out.yaml"}.get(case.command, "out")
        if case.command == "import":
            answer = ask("import", path, "--robot", ROBOT, "-o", out)
            if answer.code == 0:
                answer.numbers = _read(path, out / "mapping.yaml")
        elif case.command == "compare":
            mapping = path.parent / "mapping.yaml"
            where = 'array: "{}"' if case.form in ARRAY_FORMS[:3] else 'column: "{}_{{joint}}"'
            signals = [
                f"  {name}: {{{where.format(short)}, unit: {unit}}}"
                for name, short, unit in (
                    ("position", "q", "rad"),
                    ("velocity", "dq", "rad/s"),
                    ("torque", "tau", "N m"),
                )
            ]
            mapping.write_text(MAPPING + "\n".join(signals) + "\n", encoding="utf-8")
            answer = ask("compare", path, "--mapping", mapping)
            if answer.code == 0:
                answer.numbers = _read(path, mapping)
        elif case.command == "impacts":
            lab = path.parent
            for run in (2, 3):
                (lab / f"run_{run}.csv").write_bytes(text_of(bounce(run)))
            (lab / "mapping.yaml").write_text(BALL, encoding="utf-8")
            (lab / "experiment.yaml").write_text(EXPERIMENT, encoding="utf-8")
            (lab / "runs.csv").write_text(
                "bag,object,kind\n" + "".join(f"{name}.csv,body,hit\n" for name in ("log", "run_2", "run_3")),
                encoding="utf-8",
            )
            answer = ask("impacts", lab, "--experiment", lab / "experiment.yaml", "-o", out)
            answer.numbers = out.read_text(encoding="utf-8") if answer.code == 0 else None
        elif case.command == "compare --impacts":
            answer = ask("compare", "--impacts", path)
            answer.numbers = "\n".join(line for line in answer.words.splitlines() if "note:" not in line)
        else:
            answer = ask("robot", "import", path, "-o", out)
            answer.numbers = out.read_text(encoding="utf-8") if answer.code == 0 else None
        if answer.code == 2 and out.exists() and not answer.broken:
            answer.broken = "a refusal left a file"
        return answer

    def judge(self, case: Case, seed: int) -> Case:
        """Make one attack, and say what came of it."""
        rng = np.random.default_rng((seed, case.number))
        key = (case.command, case.form)
        if key not in self.clean:
            plain = Case(100_000 + len(self.clean), case.command, case.form, "none")
            self.clean[key] = self.run(plain, self.write(plain, None))
            if self.clean[key].code != 0 or self.clean[key].broken:
                raise RuntimeError(f"the clean file is refused ({plain.name}): {self.clean[key].words}")
        clean, path = self.clean[key], self.write(case, rng)
        answer = self.run(case, path)
        if answer.broken:
            case.verdict, case.why = "broken", answer.broken
        elif answer.code == 2:
            case.verdict, case.why = "refused", answer.words.strip().splitlines()[-1]
        elif _same(clean.numbers, answer.numbers):
            case.verdict = "same"
        else:
            further = answer.notes - clean.notes
            case.verdict, case.why = ("said", next(iter(further))) if further else ("silent", "")
        shutil.rmtree(path.parent, ignore_errors=True)
        return case


def _as_something_else(path: Path, attack: str) -> None:
    """A folder or a link in place of a file."""
    if attack == "folder":
        path.unlink()
        path.mkdir()
    elif attack in ("dead link", "link to itself"):
        path.unlink()
        path.symlink_to(path if attack == "link to itself" else path.with_name("nothing"))
    elif attack == "link":
        path.rename(path.with_name("real"))
        path.symlink_to("real")


def _read(path: Path, mapping: Path) -> Any:
    """Numbers of a file as a mapping reads them; None: it is refused."""
    try:
        runs = read_recordings(path, load_mapping(mapping))
    except InputError:
        return "refused"
    arms = [run.signals.arms["arm"] for run in runs]
    return [
        np.column_stack((run.signals.time, arm.position, arm.velocity, arm.torque))
        for run, arm in zip(runs, arms, strict=True)
    ]


def _same(clean: Any, other: Any) -> bool:
    """Whether numbers are those of the clean file."""
    if isinstance(clean, list) and isinstance(other, list):
        return len(clean) == len(other) and all(
            one.shape == two.shape and np.allclose(one, two, rtol=1e-9, atol=1e-9)
            for one, two in zip(clean, other, strict=True)
        )
    return isinstance(other, str) and other == clean or other == "refused"


PLACES = ("folder", "dead link", "link to itself", "link")
SHARES = (("import", 0.45), ("compare", 0.25), ("impacts", 0.12), ("compare --impacts", 0.12), ("robot import", 0.06))
ARRAY_FORMS = (".npz", ".h5", ".mat", ".parquet", ".npy")


def cases(count: int) -> list[Case]:
    """Attacks in turn, as many as are asked for."""
    found: list[Case] = []
    texts, arrays = [*TEXT, *PLACES], [*ARRAYS, *BYTES, *PLACES]
    for command, share in SHARES:
        for turn in range(round(share * count)):
            number = len(found)
            if command == "robot import":
                names = [*BYTES, *PLACES]
                found.append(Case(number, command, ".urdf", names[turn % len(names)]))
            elif command in ("import", "compare") and turn % 2:
                forms = ARRAY_FORMS if command == "import" else ARRAY_FORMS[:3]
                place = turn // 2
                found.append(
                    Case(number, command, forms[place % len(forms)], arrays[place // len(forms) % len(arrays)])
                )
            else:
                place = turn // 2 if command in ("import", "compare") else turn
                found.append(Case(number, command, ".csv", texts[place % len(texts)]))
    return found


def campaign(
    chosen: Sequence[Case], seed: int, folder: Path, every: Callable[[Case], None] = lambda case: None
) -> list[Case]:
    """Make attacks.

    Args:
        chosen: Which.
        seed: Of the generator.
        folder: For the files, empty.
        every: Called with each case after it is judged.
    """
    os.environ["COLUMNS"] = "2000"
    scene, found = Scene(folder), []
    for case in chosen:
        found.append(scene.judge(case, seed))
        every(found[-1])
    return found


def main() -> int:
    """Make the attacks and print the counts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=500)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", type=int, nargs="+", metavar="NUMBER", help="these attacks alone")
    parser.add_argument("--verbose", action="store_true", help="also what was said of every file")
    args = parser.parse_args()
    start = time.monotonic()

    def every(case: Case) -> None:
        if args.verbose or case.verdict in ("silent", "broken"):
            print(f"{case.verdict:8} {case.name}: {case.why[:300]}", file=sys.stderr, flush=True)

    with tempfile.TemporaryDirectory() as folder:
        chosen = [case for case in cases(args.count) if args.only is None or case.number in args.only]
        found = campaign(chosen, args.seed, Path(folder), every)
    verdicts = ("refused", "same", "said", "silent", "broken")
    print(f"| Command | Files | {' | '.join(verdicts)} |")
    print("|---" * (len(verdicts) + 2) + "|")
    for command, _ in (*SHARES, ("all", 0)):
        own = [case.verdict for case in found if command in (case.command, "all")]
        print(f"| {command} | {len(own)} | {' | '.join(str(own.count(verdict)) for verdict in verdicts)} |")
    print(f"{time.monotonic() - start:.0f} s, seed {args.seed}")
    return int(any(case.verdict in ("silent", "broken") for case in found))


if __name__ == "__main__":
    sys.exit(main())
