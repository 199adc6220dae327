# SPDX-License-Identifier: Apache-2.0
"""Logs in JSON: the same numbers in every form, and a description is no log."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from joint_recordings import write_csv
from slender_arm import FLAT, mapping_of, slender_arm

from impact_rs_sim.errors import InputError
from impact_rs_trials.recordings.readers.json_table import read_json_table
from impact_rs_trials.recordings.readers.run_finder import find_runs
from impact_rs_trials.recordings.readers.table_columns import read_columns
from impact_rs_trials.recordings.recording import ARM, read_recordings
from impact_rs_trials.recordings.remarks import merged

TIME = 0.01 * np.arange(300)
ANGLES = np.column_stack((0.4 * np.sin(2.0 * TIME), 0.3 * np.cos(TIME)))
ROWS = [{"t": t, "q": q, "n": k} for k, (t, q) in enumerate(zip(TIME.tolist(), ANGLES.tolist(), strict=True))]
FORMS: dict[str, Callable[[], Any]] = {
    "records": lambda: ROWS,
    "records below values": lambda: {"kp": 8.0, "motor": {"name": "x"}, "entries": ROWS},
    "columns": lambda: {"t": TIME.tolist(), "q": ANGLES.tolist(), "n": list(range(300)), "kp": 8.0},
    "columns below": lambda: {"meta": {"limits": [1.0, 2.0, 3.0]}, "data": {k: [r[k] for r in ROWS] for k in "tqn"}},
}


@pytest.mark.parametrize("form", FORMS)
def test_every_form_gives_the_same_columns(tmp_path: Path, form: str) -> None:
    """Kills numbers that become text, a list of limits that becomes a column, and values that are lost silently."""
    path = tmp_path / "log.json"
    path.write_text(json.dumps(FORMS[form]()))
    cells, remarks = read_json_table(path)
    assert list(cells) == ["t", "q", "n"]
    np.testing.assert_array_equal(cells["t"], TIME)
    assert np.asarray(cells["n"]).dtype.kind == "i"
    np.testing.assert_array_equal([np.array(cell.split(), dtype=float) for cell in cells["q"]], ANGLES)
    outside = {"records": [], "records below values": ["kp", "motor.name"], "columns": ["kp"]}
    listed = ", ".join(outside.get(form, ["meta.limits"]))
    assert remarks == ((f"log.json: not part of its table, and not read: {listed}",) if listed else ())


def test_one_record_a_line_and_objects_inside_of_records(tmp_path: Path) -> None:
    path = tmp_path / "log.jsonl"
    rows = [{"t": t, "state": {"q": 2.0 * t, "mode": "run"}} for t in TIME[:5].tolist()]
    rows[3]["state"] = {"q": None}  # a sample that is missing
    path.write_text("\n".join(map(json.dumps, rows)) + "\n")
    cells, _ = read_json_table(path)
    assert list(cells) == ["t", "state.q", "state.mode"]
    assert cells["state.q"] == ["0.0", "0.02", "0.04", "", "0.08"]
    assert cells["state.mode"][3] == ""


@pytest.mark.parametrize("ending", ["json", "parquet"])
def test_a_null_among_the_numbers_of_a_cell_is_no_number(tmp_path: Path, ending: str) -> None:
    """Kills: the text None in the cell, by which the whole file is refused."""
    path, q = tmp_path / f"log.{ending}", [[0.1, None], [0.2, 0.3], [0.3, 0.4]]
    if ending == "json":
        path.write_text(json.dumps([{"t": 0.1 * number, "q": one} for number, one in enumerate(q)]))
    else:
        pyarrow = pytest.importorskip("pyarrow")
        pytest.importorskip("pyarrow.parquet").write_table(pyarrow.table({"t": [0.0, 0.1, 0.2], "q": q}), path)
    assert list(read_columns(path).cells["q"]) == ["0.1 nan", "0.2 0.3", "0.3 0.4"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"name": "push", "limits": {"joint1": [0.0, 1.0]}}', "no table in it, expected a list of records"),
        ("[1, 2, 3]", "no table in it"),
        ("5", "no table in it"),
        ('{"a": [{"t": 1}, {"t": 2}, {"t": 3}], "b": [{"t": 1}, {"t": 2}, {"t": 3}]}', "several tables in it"),
        ('{"t": [0.0, 1.0', "not a readable JSON file"),
        ("", "not a readable JSON file"),
        ("[" * 100_000, "not a readable JSON file"),
        ('{"t": 1}\n{"t": ', "not a readable JSON file"),
    ],
)
def test_what_is_no_table_is_refused_with_what_was_expected(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "log.json"
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        read_json_table(path)


def test_tables_are_listed_where_there_are_several(tmp_path: Path) -> None:
    path = tmp_path / "log.json"
    path.write_text(json.dumps({"left": ROWS, "right": ROWS}))
    with pytest.raises(InputError, match=r"tables: left\., right\."):
        read_json_table(path)


@given(
    st.recursive(
        st.none() | st.booleans() | st.floats() | st.text(),
        lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    )
)
def test_any_document_is_read_or_refused(tmp_path_factory: pytest.TempPathFactory, document: Any) -> None:
    path = tmp_path_factory.mktemp("any") / "log.json"
    path.write_text(json.dumps(document))
    try:
        cells, _ = read_json_table(path)
    except InputError:
        return
    assert len({len(column) for column in cells.values()}) == 1


def test_a_folder_of_logs_is_read_as_the_same_numbers_in_csv(tmp_path: Path) -> None:
    """Kills a folder that ``import`` describes and ``compare`` does not find, and a remark once a file."""
    velocity = np.gradient(ANGLES, TIME, axis=0)
    columns = {"time": TIME, "position": ANGLES, "velocity": velocity, "effort": velocity}
    mapping = mapping_of(tmp_path, slender_arm(("revolute", "revolute"), FLAT))
    (tmp_path / "csv").mkdir()
    (tmp_path / "json").mkdir()
    write_csv(tmp_path / "csv" / "log_1.csv", columns)
    for number in (1, 2):
        table = {name: own.tolist() for name, own in columns.items()}
        (tmp_path / "json" / f"log_{number}.json").write_text(json.dumps({"kp": 8.0} | table))
    names = {"position": "position", "velocity": "velocity", "torque": "effort"}
    signals = {name: mapping.signals[name].model_copy(update={"column": names[name]}) for name in names}
    joint = {name: own.model_copy(update={"column": f"{names[name]}_{{joint}}"}) for name, own in signals.items()}
    of_json = mapping.model_copy(update={"signals": signals})
    found = find_runs(tmp_path / "json", of_json)
    assert [path.name for path in found] == ["log_1.json", "log_2.json"]
    runs = [run for path in found for run in read_recordings(path, of_json)]
    (plain,) = read_recordings(tmp_path / "csv" / "log_1.csv", mapping.model_copy(update={"signals": joint}))
    np.testing.assert_array_equal(runs[0].signals.arms[ARM].position, plain.signals.arms[ARM].position)
    said = merged((run.path.name, remark) for run in runs for remark in run.remarks)
    assert "log_1.json, log_2.json: not part of its table, and not read: kp" in said
