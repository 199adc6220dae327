# SPDX-License-Identifier: Apache-2.0
"""One attack after another: output of the command line for a damaged file, compared with the clean one."""

from __future__ import annotations

import contextlib
import io
import os
import re
import shutil
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from benchmarks.attacks import arrays, bags
from benchmarks.attacks.arrays import ARRAYS
from benchmarks.attacks.binary import BYTES, PLACES, as_something_else
from benchmarks.attacks.clean_files import (
    BALL,
    BALL_IN_BAGS,
    EXPERIMENT,
    MAPPING,
    ROBOT,
    URDF,
    Rng,
    bounce,
    impacts_of_a_ball,
    joint_motion,
    rows_of,
    text_of,
)
from benchmarks.attacks.mat_files import MAT, level_5
from benchmarks.attacks.texts import TEXT
from impact_rs_cli.main import main as command_line
from impact_rs_sim.errors import InputError
from impact_rs_trials.recordings.mapping import load_mapping
from impact_rs_trials.recordings.recording import read_recordings

NOT_HELD = (TypeError, ValueError, KeyError, IndexError, OverflowError, pa.ArrowException)  # not every format holds all
REFUSED = "refused"  # numbers of a file that the reader does not read as import describes it
MATLAB = " of MATLAB.mat"  # form of the files that MAT attacks; .mat alone is one of the formats of arrays


@dataclass
class Case:
    """One attack, and its verdict."""

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
    """Result of a command line."""

    code: int
    words: str
    broken: str = ""
    numbers: Any = None

    @property
    def notes(self) -> Counter[str]:
        """Notes, reasons and assumptions, without their numbers, and how many samples and impacts there are."""
        lines = [re.sub(r"\d[\d.e+-]*", "#", line) for line in re.split("[\n│]", self.words)]
        counts = re.findall(r"\d+ (?:samples|impacts?|recordings?|outliers?)(?: of \d+ runs)?", self.words)
        return Counter(counts) + Counter(line for line in lines if re.search("note:|left out|ASSUMED", line))


def ask(*words: str | Path) -> Answer:
    """Run a command line in this process."""
    out, code, broken = io.StringIO(), -1, ""
    with (
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(out),
        warnings.catch_warnings(record=True) as caught,
    ):
        warnings.simplefilter("always")
        try:
            code = command_line([str(word) for word in words])
        except BaseException:
            broken = traceback.format_exc().strip().splitlines()[-1]
    output = out.getvalue()
    numeric_warnings = [
        str(warning.message)
        for warning in caught
        if issubclass(warning.category, RuntimeWarning | np.exceptions.ComplexWarning)
    ]
    broken = (
        broken
        or ("Traceback in its output" if "Traceback" in output else "")
        or (numeric_warnings[0] if numeric_warnings else "")
    )
    if not broken and code not in (0, 2):
        broken = f"exit code {code}: {output.strip().splitlines()[-1] if output.strip() else ''}"
    return Answer(code, output, broken)


@dataclass
class Scene:
    """Clean files, and the answers to them."""

    folder: Path
    motion: dict[str, np.ndarray] = field(default_factory=joint_motion)
    clean: dict[tuple[str, str], Answer] = field(default_factory=dict)

    def write(self, case: Case, rng: Rng | None) -> Path:
        """The file of a case, damaged where a generator is given."""
        path = self.folder / f"case_{case.number}" / f"log{case.form}"
        path.parent.mkdir(parents=True)
        attack = case.attack if rng is not None else ""
        rng = rng or np.random.default_rng(0)
        if case.form in bags.FORMS:
            samples = bags.ball_poses(bounce(1)) if case.command == "impacts" else bags.joint_states(self.motion)
            return bags.write_bag(path.with_name("log"), samples, case.form, attack, rng)
        if case.command == "robot import":
            content = URDF.encode()
        elif case.form == ".csv":
            rows = {"impacts": bounce(1), "compare --impacts": impacts_of_a_ball()}.get(case.command)
            rows = rows or rows_of(self.motion)
            content = TEXT[attack](rows, rng) if attack in TEXT else text_of(rows)
        elif case.form == MATLAB:
            content = MAT[attack](dict(self.motion), rng) if attack in MAT else level_5(self.motion)
        else:
            content = self._in_arrays(path, attack, rng)
        if case.form != MATLAB and attack in BYTES:
            content = BYTES[attack](content, rng)
        path.write_bytes(content)
        as_something_else(path, attack)
        return path

    def _in_arrays(self, path: Path, attack: str, rng: Rng) -> bytes:
        try:
            arrays.saved(path, ARRAYS[attack](dict(self.motion), rng) if attack in ARRAYS else self.motion)
        except NOT_HELD:
            arrays.saved(path, {name: value for name, value in self.motion.items() if name != "q"})
        return path.read_bytes()

    def run(self, case: Case, path: Path) -> Answer:
        """Run the command of a case on its file."""
        lab = path.parent
        out = lab / {"impacts": "out.csv", "robot import": "out.yaml"}.get(case.command, "out")
        mapping = lab / "mapping.yaml"
        if case.command == "import":
            answer = ask("import", path, "--robot", ROBOT, "-o", out)
            if answer.code == 0:
                answer.numbers = _read(path, out / "mapping.yaml")
        elif case.command == "compare":
            mapping.write_text(MAPPING + _signals(case.form), encoding="utf-8")
            answer = ask("compare", path, "--mapping", mapping)
            if answer.code == 0:
                answer.numbers = _read(path, mapping)
        elif case.command == "impacts":
            names = [path.name, *(self._further_run(lab, run, case.form) for run in (2, 3))]
            mapping.write_text(BALL_IN_BAGS if case.form in bags.FORMS else BALL, encoding="utf-8")
            (lab / "experiment.yaml").write_text(EXPERIMENT, encoding="utf-8")
            listed = "".join(f"{name},body,hit\n" for name in names)
            (lab / "runs.csv").write_text(f"bag,object,kind\n{listed}", encoding="utf-8")
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

    @staticmethod
    def _further_run(lab: Path, run: int, form: str) -> str:
        """A run beside the attacked one; returns its name."""
        if form in bags.FORMS:
            bag_path = lab / f"run_{run}"
            return bags.write_bag(
                bag_path, bags.ball_poses(bounce(run)), bags.FORMS[0], "", np.random.default_rng(0)
            ).name
        (lab / f"run_{run}.csv").write_bytes(text_of(bounce(run)))
        return f"run_{run}.csv"

    def judge(self, case: Case, seed: int) -> Case:
        """Make one attack, and judge the answer."""
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
        elif answer.numbers == REFUSED:
            case.verdict = "said" if "the reader refuses" in answer.words else "silent"
        elif _same(clean.numbers, answer.numbers):
            case.verdict = "same"
        else:
            further = answer.notes - clean.notes
            case.verdict, case.why = ("said", next(iter(further))) if further else ("silent", "")
        shutil.rmtree(path.parent, ignore_errors=True)
        return case


def _read(path: Path, mapping: Path) -> Any:
    """Numbers of a file as a mapping reads them, from its first stamp on; :data:`REFUSED`: it does not."""
    try:
        runs = read_recordings(path, load_mapping(mapping))
    except InputError:
        return REFUSED
    arms = [run.signals.arms["arm"] for run in runs]
    return [  # the clock of a computer has no room for less than a microsecond
        np.column_stack(
            (np.round(run.begin + run.signals.time - run.signals.time[0], 6), arm.position, arm.velocity, arm.torque)
        )
        for run, arm in zip(runs, arms, strict=True)
    ]


def _same(clean: Any, other: Any) -> bool:
    """Whether numbers are those of the clean file."""
    if isinstance(clean, list) and isinstance(other, list):
        return len(clean) == len(other) and all(
            clean_array.shape == other_array.shape and np.allclose(clean_array, other_array, rtol=1e-9, atol=1e-9)
            for clean_array, other_array in zip(clean, other, strict=True)
        )
    return isinstance(other, str) and other == clean


def _signals(form: str) -> str:
    """Section of a mapping."""
    lines = []
    for name, short, field_name, unit in (
        ("position", "q", "position", "rad"),
        ("velocity", "dq", "velocity", "rad/s"),
        ("torque", "tau", "effort", "N m"),
    ):
        where = f'column: "{short}_{{joint}}"'
        if form in bags.FORMS:
            where = f'topic: "*/joint_states", type: {bags.JOINT_STATE}, field: {field_name}, names: name'
        elif form in (*arrays.FORMS[:3], MATLAB):
            where = f'array: "{short}"'
        lines.append(f"  {name}: {{{where}, unit: {unit}}}")
    return "\n".join(lines) + "\n"


_ARRAY_ATTACKS = (*ARRAYS, *BYTES, *PLACES)
GROUPS: tuple[tuple[str, tuple[str, ...], tuple[str, ...], float], ...] = (  # command, forms, attacks, share
    ("import", (".csv",), (*TEXT, *PLACES), 0.12),
    ("import", arrays.FORMS, _ARRAY_ATTACKS, 0.13),
    ("import", bags.FORMS, bags.ATTACKS, 0.17),
    ("import", (MATLAB,), tuple(MAT), 0.10),
    ("compare", (".csv",), (*TEXT, *PLACES), 0.06),
    ("compare", arrays.FORMS[:3], _ARRAY_ATTACKS, 0.07),
    ("compare", bags.FORMS, bags.ATTACKS, 0.08),
    ("compare", (MATLAB,), tuple(MAT), 0.05),
    ("impacts", (".csv",), (*TEXT, *PLACES), 0.06),
    ("impacts", bags.FORMS, bags.ON_POSES, 0.06),
    ("compare --impacts", (".csv",), (*TEXT, *PLACES), 0.07),
    ("robot import", (".urdf",), (*BYTES, *PLACES), 0.03),
)
COMMANDS = tuple(dict.fromkeys(command for command, *_ in GROUPS))


def cases(count: int) -> list[Case]:
    """Attacks in turn, as many as are asked for; commands that run fewer than there are begin at different ones."""
    attack_cases: list[Case] = []
    for group, (command, forms, attacks, share) in enumerate(GROUPS):
        wanted_count = round(share * count)
        start = 0 if wanted_count >= len(attacks) else 17 * group
        for number in range(wanted_count):
            index = start + number
            form, attack = forms[(number + number // len(attacks)) % len(forms)], attacks[index % len(attacks)]
            if attack in bags.ON_FOLDERS and form == bags.FORMS[2]:
                form = bags.FORMS[number % 2]
            attack_cases.append(Case(len(attack_cases), command, form, attack))
    return attack_cases


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
    scene, judged = Scene(folder), []
    for case in chosen:
        judged.append(scene.judge(case, seed))
        every(judged[-1])
    return judged
