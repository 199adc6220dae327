# SPDX-License-Identifier: Apache-2.0
"""Mangled raw files: every one is read as it was, or refused in one line, or its change is seen in a remark.

A change that leaves a valid file with other numbers cannot be seen by any reader; such changes of digits are not made
here. What is made: lines cut, lost, doubled, swapped or joined, separators and marks in wrong places, bytes that are no
text, truncated binaries.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from impact_rs_sim.errors import InputError
from impact_rs_trials.recordings.candidates import candidates_of
from impact_rs_trials.recordings.importing import Wishes, draft_import
from impact_rs_trials.recordings.mapping import Mapping, load_mapping
from impact_rs_trials.recordings.sources import read_series
from impact_rs_trials.recordings.table_layout import find_layout

TIME = 0.01 * np.arange(40)  # s
VALUES = np.round(np.outer(np.sin(1.0 + TIME), np.arange(1.0, 8.0)), 6)  # rad
FILES = settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


def mapping_of(time: dict[str, object], table: dict[str, object], **position: object) -> Mapping:
    shipped = load_mapping("joint_state")
    signals = {name: one.model_dump() for name, one in shipped.signals.items()}
    signals["position"] = {"unit": "rad", **position}
    return Mapping.model_validate(shipped.model_dump() | {"time": time, "table": table, "signals": signals})


def vector_text() -> str:
    rows = [f"{time:.2f},{' '.join(map(repr, row))}" for time, row in zip(TIME, VALUES.tolist(), strict=True)]
    return "\n".join(["made by x,1", "RosTime,Joint", *rows]) + "\n"


def plain_text() -> str:
    rows = [f"{time:.2f} {' '.join(map(repr, row))}" for time, row in zip(TIME, VALUES.tolist(), strict=True)]
    return "\n".join(rows) + "\n"


def gripper_text() -> str:
    """Nine numbers in a cell, of which the joints are the second to the eighth."""
    above, names, *rows = vector_text().splitlines()
    return "\n".join([above, names, *(f"{row.replace(',', ',0.5 ')} 0.04" for row in rows)]) + "\n"


def comma_text() -> str:
    """A decimal comma, semicolons, and stamps in seconds and nanoseconds."""
    stamps = [f"17;{round(1e9 * time)}" for time in TIME]
    rows = [f"{stamp};{';'.join(map(repr, row))}" for stamp, row in zip(stamps, VALUES.tolist(), strict=True)]
    names = "sec;nsec;" + ";".join(f"q{joint}" for joint in range(1, 8))
    return "\n".join([names, *rows]).replace(".", ",") + "\n"


def dated_text() -> str:
    rows = [
        f"2026-11-25 12:00:00.{round(100 * time):02d},{','.join(map(repr, row))}"
        for time, row in zip(TIME, VALUES.tolist(), strict=True)
    ]
    return "\n".join(["t," + ",".join(f"q{joint}" for joint in range(1, 8)), *rows]) + "\n"


NUMBERED = [f"c{column}" for column in range(2, 9)]
TEXTS: dict[str, tuple[Callable[[], str], Mapping]] = {
    "vectors": (vector_text, mapping_of({"column": "RosTime"}, {"header": 2}, column="Joint")),
    "no names": (plain_text, mapping_of({"column": "c1"}, {"header": 0}, columns=NUMBERED)),
    "a gripper": (
        gripper_text,
        mapping_of({"column": "RosTime"}, {"header": 2}, column="Joint", entries=range(2, 9)),
    ),
    "decimal commas": (comma_text, mapping_of({"column": ["sec", "nsec"]}, {"decimal": ","}, column="q{joint}")),
    "dates": (dated_text, mapping_of({"column": "t", "unit": "date"}, {}, column="q{joint}")),
}


ACCIDENTS = ("cut", "mark", "byte", "separator", "join", "half", "blank", "word", "tail")


def mangled(text: str, draw: st.DrawFn) -> bytes:
    """One or two accidents that befall text files."""
    lines = text.split("\n")
    accidents = draw(st.lists(st.sampled_from(ACCIDENTS), min_size=1, max_size=2, unique=True))
    for kind in ["join"] if "join" in accidents else accidents:  # half of two joined lines may be one line less a digit
        row = draw(st.integers(0, max(len(lines) - 2, 0)))
        if kind == "cut":
            lines = [*lines[:row], lines[row][: draw(st.integers(0, len(lines[row])))]]
        elif kind == "mark":
            place = draw(st.integers(0, len(lines[row])))
            lines[row] = lines[row][:place] + '"' + lines[row][place:]
        elif kind == "byte":
            return "\n".join(lines[:row]).encode() + b"\xff\xfe\x00" + "\n".join(lines[row:]).encode()
        elif kind == "separator":
            lines[row] = lines[row].replace(",", draw(st.sampled_from([";", "\t", ",,", " , "])), 1)
        elif kind == "join" and row + 1 < len(lines):
            lines[row : row + 2] = [lines[row] + lines[row + 1]]
        elif kind == "half":
            lines[row] = lines[row][: len(lines[row]) // 2]
        elif kind == "blank":
            lines.insert(row, draw(st.sampled_from(["", "   ", "# a note", "\r"])))
        elif kind == "word":
            lines.insert(row, draw(st.text(max_size=30)).replace("\n", " "))
        elif kind == "tail":
            lines[row] += draw(st.sampled_from([",", " ", "\r", ",x", " 1"]))
    return "\n".join(lines).encode("utf-8", "surrogatepass")


def numbers_in(found: np.ndarray) -> set[tuple[float, ...]]:
    seen = np.isfinite(found).all(axis=1)  # a lost cell is nan, which the checks of a run refuse
    return {tuple(row) for row in np.round(found[seen], 9).tolist()}


TRUE_ROWS = numbers_in(VALUES)


@pytest.mark.parametrize("form", TEXTS)
def test_no_number_of_a_mangled_text_changes_in_silence(tmp_path: Path, form: str) -> None:
    """Rows that are read were in the file, but for the last one of a file that was cut within a number."""
    write, mapping = TEXTS[form]
    path, text = tmp_path / "run.csv", write()

    @FILES
    @given(st.data())
    def attack(data: st.DataObject) -> None:
        path.write_bytes(mangled(text, data.draw))
        try:
            found = read_series(path, mapping, ["position"], ["position"])["position"]
        except InputError as error:
            assert "\n" not in str(error)
            assert str(path) in str(error)
            return
        assert numbers_in(found.values) - TRUE_ROWS <= numbers_in(found.values[-1:])

    attack()


@pytest.mark.parametrize("form", TEXTS)
def test_import_of_a_mangled_text_answers_or_refuses_in_one_line(tmp_path: Path, form: str) -> None:
    path, text = tmp_path / "run.csv", TEXTS[form][0]()

    @settings(FILES, max_examples=120)
    @given(st.data())
    def attack(data: st.DataObject) -> None:
        path.write_bytes(mangled(text, data.draw))
        for look in (find_layout, candidates_of, lambda one: draft_import([one], tmp_path, Wishes("kuka_iiwa7"))):
            try:
                look(path)
            except InputError as error:
                assert "\n" not in str(error)

    attack()


def mat_file(path: Path) -> None:
    scipy.io.savemat(path, {"time": TIME, "position": VALUES})


def npy_file(path: Path) -> None:
    np.save(path, np.column_stack((TIME, VALUES)))


@pytest.mark.parametrize(
    ("suffix", "write", "mapping"),
    [
        (".mat", mat_file, mapping_of({}, {}, array="position")),
        (".npy", npy_file, mapping_of({"column": "c1"}, {}, columns=NUMBERED)),
    ],
)
def test_a_damaged_head_or_a_lost_end_of_a_binary_is_no_traceback(
    tmp_path: Path, suffix: str, write: Callable[[Path], None], mapping: Mapping
) -> None:
    """Neither format has checksums, so that damage among the numbers themselves cannot be seen; a MAT file says so."""
    path = tmp_path / f"run{suffix}"
    write(path)
    whole = path.read_bytes()

    @settings(FILES, max_examples=200)
    @example(61, b"\t", 0, False)  # an array without rows
    @given(st.integers(0, 200), st.binary(min_size=1, max_size=8), st.integers(0, 300), st.booleans())
    def attack(place: int, bytes_there: bytes, lost: int, cut: bool) -> None:
        damaged = whole[: len(whole) - lost] if cut else whole[:place] + bytes_there + whole[place + len(bytes_there) :]
        path.write_bytes(damaged)
        try:
            found = read_series(path, mapping, ["position"], ["position"])["position"]
        except InputError as error:
            assert "\n" not in str(error)
            return
        if cut:
            assert numbers_in(found.values) <= TRUE_ROWS

    attack()
