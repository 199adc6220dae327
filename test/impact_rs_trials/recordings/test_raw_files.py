# SPDX-License-Identifier: Apache-2.0
"""Files as laboratories leave them: every form of the same joint positions gives the same numbers."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from builders import mapping_of, read_positions
from refusals import refusal
from signal_files import TIME, VALUES

from impact_rs_trials.recordings.experiment import Experiment, read_runs
from impact_rs_trials.recordings.mapping import Mapping
from impact_rs_trials.recordings.readers.csv_rows import decimal_sign
from impact_rs_trials.recordings.readers.inner_runs import run_column_of, run_groups_of
from impact_rs_trials.recordings.readers.run_finder import find_runs
from impact_rs_trials.recordings.readers.sources import read_series

ROWS = [" ".join(f"{value!r}" for value in row) for row in VALUES.tolist()]
NAMES = [f"position_{joint}" for joint in range(1, 8)]
NUMBERED = [f"c{column}" for column in range(2, 9)]


JOINTS_OF_NINE = [2, 3, 4, 5, 6, 7, 8]  # between two other numbers
BY_NAME = {"column": "position_{joint}"}


def in_line(header: int) -> Mapping:
    return mapping_of({}, {"header": header}, **BY_NAME)


def text(path: Path, above: str, separator: str = ",", names: list[str] | None = NAMES, between: str = "") -> Path:
    """A text table with lines above and between the names and the numbers."""
    table = np.column_stack((TIME, VALUES)).tolist()
    lines = [separator.join(["time", *names])] if names else []
    lines += [between] if between else []
    path.write_text(
        "\n".join([*([above] if above else []), *lines, *(separator.join(map(repr, row)) for row in table)])
    )
    return path


def vectors(path: Path, opened: str = "", closed: str = "") -> Path:
    """Cells that hold all joints."""
    rows = [f'{time!r},"{opened}{row}{closed}"' for time, row in zip(TIME.tolist(), ROWS, strict=True)]
    path.write_text("\n".join(["time,JointPosition", *rows]))
    return path


def stamps(path: Path, cells: list[str]) -> Path:
    rows = [f"{cell},{','.join(row.split())}" for cell, row in zip(cells, ROWS, strict=True)]
    path.write_text("\n".join([f"time,{','.join(NAMES)}", *rows]))
    return path


def npy(path: Path) -> Path:
    np.save(path, np.column_stack((TIME, VALUES)))
    return path


def pairs(path: Path) -> Path:
    """Seconds and nanoseconds, without separators of their own."""
    whole = np.rint(1e9 * TIME).astype(np.int64)
    cells = [f"{one // 10**9},{one % 10**9}" for one in whole.tolist()]
    text = stamps(path, cells).read_text()
    path.write_text(text.replace("time,", "sec,nanosec,", 1))
    return path


def decimal_commas(path: Path) -> Path:
    """A spreadsheet of a country that writes 0,5."""
    text(path, "", ";")
    path.write_text(path.read_text().replace(".", ","))
    return path


def structured(path: Path) -> Path:
    rows = np.zeros(24, dtype=[("time", "f8"), *((name, "f8") for name in NAMES)])
    for name, column in zip(["time", *NAMES], np.column_stack((TIME, VALUES)).T, strict=True):
        rows[name] = column
    np.save(path, rows)
    return path


def mat(path: Path, **arrays: object) -> Path:
    scipy.io.savemat(path, arrays or {"time": TIME, "position": VALUES})
    return path


def newest_mat(path: Path) -> Path:
    """MATLAB 7.3: HDF5 behind 512 bytes of its own, with all arrays turned."""
    with pytest.importorskip("h5py").File(path, "w", userblock_size=512) as file:
        file.create_dataset("time", data=TIME[None, :])
        file.create_dataset("data/q", data=VALUES.T)
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124))
    return path


FORMS: dict[str, tuple[Callable[[Path], Path], str, Mapping]] = {
    "names in line 3": (lambda p: text(p, 'Robot,"iiwa\n1,2,3'), ".csv", in_line(3)),
    "units below the names": (
        lambda p: text(p, "", between="s" + 7 * ",rad"), ".csv", mapping_of({}, {"first": 3}, **BY_NAME),
    ),
    "no names": (
        lambda p: text(p, "", names=None), ".csv", mapping_of({"column": "c1"}, {"header": 0}, columns=NUMBERED),
    ),
    "blanks and lines above": (
        lambda p: text(p, "log of 3 May", "   ", names=None), ".txt",
        mapping_of({"column": "c1"}, {"header": 0, "first": 2}, columns=NUMBERED),
    ),
    "a name behind #": (lambda p: text(p, "# made up\n# here", " "), ".dat", in_line(3)),
    "tabs": (lambda p: text(p, "", "\t"), ".tsv", mapping_of(**BY_NAME)),
    "vectors": (vectors, ".csv", mapping_of(column="JointPosition")),
    "vectors in brackets": (lambda p: vectors(p, "[", " ]"), ".csv", mapping_of(column="JointPosition")),
    "milliseconds": (
        lambda p: stamps(p, [str(round(1e3 * time)) for time in TIME]), ".csv", mapping_of({"unit": "ms"}, **BY_NAME),
    ),
    "seconds and nanoseconds": (pairs, ".csv", mapping_of({"column": ["sec", "nanosec"]}, **BY_NAME)),
    "decimal commas": (decimal_commas, ".csv", mapping_of({}, {"decimal": ","}, **BY_NAME)),
    "vectors with a gripper": (
        lambda p: vectors(p, "0.5 ", " 0.04"), ".csv", mapping_of(column="JointPosition", entries=JOINTS_OF_NINE),
    ),
    "no stamps": (lambda p: text(p, ""), ".csv", mapping_of({"rate": 100.0}, **BY_NAME)),
    "npy": (npy, ".npy", mapping_of({"column": "c1"}, columns=NUMBERED)),
    "npy with names": (structured, ".npy", mapping_of(**BY_NAME)),
    "mat": (mat, ".mat", mapping_of(array="position")),
    "mat, joints x samples": (lambda p: mat(p, time=TIME, position=VALUES.T), ".mat", mapping_of(array="position")),
    "mat, nine numbers a sample": (
        lambda p: mat(p, time=TIME, position=np.insert(VALUES, [0, 7], 0.5, axis=1).T), ".mat",
        mapping_of(array="position", entries=JOINTS_OF_NINE),
    ),
    "mat, seconds and nanoseconds": (
        lambda p: mat(p, s=np.zeros(24), ns=1e9 * TIME, position=VALUES), ".mat",
        mapping_of({"array": ["s", "ns"]}, array="position"),
    ),
    "mat, a structure": (
        lambda p: mat(p, log={"t": TIME, "q": VALUES}), ".mat", mapping_of({"array": "log/t"}, array="log/q"),
    ),
    "mat 7.3": (newest_mat, ".mat", mapping_of(array="data/q")),
}  # fmt: skip


@pytest.mark.parametrize("form", FORMS)
def test_every_form_holds_the_same_numbers(tmp_path: Path, form: str) -> None:
    write, suffix, mapping = FORMS[form]
    found = read_positions(write(tmp_path / f"run{suffix}"), mapping)
    np.testing.assert_allclose(found.values, VALUES, rtol=0.0, atol=0.0)
    np.testing.assert_allclose(found.time, TIME, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize(
    ("first", "seconds"),
    [
        ("2001-09-09 01:46:40.{}", 0.0),
        ("2001-09-09T03:46:40.{}+02:00", 0.0),
        ("2001/09/08 20:16:40,{} -0530", 0.0),
        ("2001-09-09 01:46:41.{}Z", 1.0),
    ],
)
def test_dates_are_instants(tmp_path: Path, first: str, seconds: float) -> None:
    """The first second of the second billion since 1970; nanoseconds stay."""
    cells = [f'"{first.format(f"{10 * row:03d}000001")}"' for row in range(24)]
    found = read_positions(stamps(tmp_path / "a.csv", cells), mapping_of({"unit": "date"}, **BY_NAME))
    np.testing.assert_allclose(found.time - 1e9 - seconds, TIME, atol=2e-7)


@pytest.mark.parametrize("cell", ["09.09.2001 01:46:40", "2001-02-30 01:00:00", "2001-09-09", "1000000000", ""])
def test_a_cell_that_is_no_date_is_refused_with_its_line(tmp_path: Path, cell: str) -> None:
    cells = [f"2001-09-09 01:46:40.{10 * row:03d}" for row in range(24)]
    cells[4] = cell
    said = refusal(read_positions, stamps(tmp_path / "a.csv", cells), mapping_of({"unit": "date"}, **BY_NAME))
    assert "line 6" in said
    assert "date" in said


def test_numbers_are_no_dates(tmp_path: Path) -> None:
    table = mapping_of({"column": "c1", "unit": "date"}, columns=NUMBERED)
    array = mapping_of({"unit": "date"}, array="position")
    for file, mapping in ((npy(tmp_path / "a.npy"), table), (mat(tmp_path / "a.mat"), array)):
        said = refusal(read_positions, file, mapping)
        assert str(file) in said and "time.unit" in said and "s, ms, us or ns" in said


@pytest.mark.parametrize(
    ("form", "mapping", "said"),
    [
        (vectors, mapping_of(column="JointVelocity"), "position.column of the mapping: no column 'JointVelocity'"),
        (vectors, mapping_of(column="Joint{joint}"), "signals.position.column of the mapping: no column 'Joint1'"),
        (vectors, mapping_of({"column": "t"}, column="JointPosition"), "time.column of the mapping: no column 't'"),
        (lambda p: text(p, ""), mapping_of(column="position_1"), "line 2: not a table of numbers: 1 numbers in a cell"),
        (
            lambda p: vectors(p, "1 "), mapping_of(column="JointPosition"),
            "line 2: not a table of numbers: 8 numbers in a cell, expected 7",
        ),
        (lambda p: vectors(p, "1 "), mapping_of(column="JointPosition"), "entries in the mapping says which"),
        (
            vectors, mapping_of(column="JointPosition", entries=JOINTS_OF_NINE),
            "line 2: not a table of numbers: 7 numbers in a cell, expected 8, as many in all rows",
        ),
        (
            lambda p: text(p, ""), mapping_of({"column": ["position_1", "time"]}, **BY_NAME),
            "columns 'position_1' and 'time' (time): sample 1 has",
        ),
        (decimal_commas, mapping_of(**BY_NAME), "table.decimal: ',' in the mapping reads decimal commas"),
        (lambda p: text(p, "a,b"), mapping_of(**BY_NAME), "table.header in the mapping says in which"),
        (lambda p: text(p, ""), mapping_of({}, {"header": 40}, column="x"), "table.header = 40: expected the names"),
    ],
)  # fmt: skip
def test_a_table_that_does_not_fit_its_mapping_is_refused_with_key_and_line(
    tmp_path: Path, form: Callable[[Path], Path], mapping: Mapping, said: str
) -> None:
    path = form(tmp_path / "a.csv")
    error = refusal(read_positions, path, mapping)
    assert said in error
    assert str(path) in error


def test_cells_that_lost_a_number_are_refused_where_entries_are_taken(tmp_path: Path) -> None:
    """Nine numbers in all rows but one, which has eight: the others of that row may be shifted."""
    file = vectors(tmp_path / "a.csv", "0.5 ", " 0.04")
    lines = file.read_text().splitlines()
    lines[5] = lines[5].replace("0.5 ", "", 1)
    file.write_text("\n".join(lines))
    said = refusal(read_positions, file, mapping_of(column="JointPosition", entries=JOINTS_OF_NINE))
    assert "line 6" in said and "8 numbers in a cell, expected 9, as many in all rows" in said


@pytest.mark.parametrize(
    ("line", "sign"),
    [("0,5;1", ","), ("0,5\t-1,25e3", ","), ("0.5;1", "."), ("0,5", "."), ("1,2,3;4,5,6", "."), ("1,5;4,5,6", ".")],
)
def test_a_decimal_comma_stands_alone_in_its_cell(line: str, sign: str) -> None:
    assert decimal_sign(["a;b", line]) == sign


def test_repeated_stamps_are_refused_or_the_first_is_kept_and_said(tmp_path: Path) -> None:
    time = np.where(np.arange(24) % 8 == 7, np.roll(TIME, 1), TIME)
    file = stamps(tmp_path / "a.csv", [repr(float(one)) for one in time])
    assert read_positions(file, mapping_of(**BY_NAME)).time.size == 24  # a reader of runs refuses them
    found = read_positions(file, mapping_of({"repeated": "keep_first"}, **BY_NAME))
    np.testing.assert_array_equal(found.values, VALUES[np.arange(24) % 8 != 7])
    (remark,) = found.remarks
    assert "3 of 24 samples have the stamp of the one before; the first is kept" in remark


# ---- one folder, a file per signal and run --------------------------------------------------------------------------


@pytest.fixture
def spread(tmp_path: Path) -> Path:
    for run in (10, 9, 2):
        vectors(tmp_path / f"IIWA_7_hit_{run}.csv")
        (tmp_path / f"object_parcel_hit_{run}.csv").write_text("RosTime\n")
    (tmp_path / "notes_hit.csv").write_text("none")
    return tmp_path


def spread_mapping() -> Mapping:
    mapping = mapping_of(column="JointPosition", file="IIWA_7_hit_{run}.csv")
    pose = {"unit": "m", "column": "pose", "file": "object_{object}_hit_{run}.csv"}
    return Mapping.model_validate(
        mapping.model_dump() | {"signals": mapping.model_dump()["signals"] | {"object_pose": pose}}
    )


def test_runs_are_found_by_the_names_of_their_files(spread: Path) -> None:
    assert [path.name for path in find_runs(spread, spread_mapping())] == ["2", "9", "10"]
    found = read_positions(spread / "9", spread_mapping())
    np.testing.assert_array_equal(found.values, VALUES)


def test_hidden_files_are_no_files_of_runs(spread: Path) -> None:
    """Kills: `folder.iterdir()` and `folder.rglob(...)` unfiltered, which find copies of editors as further runs."""
    for name in (".IIWA_7_hit_3.csv", ".ipynb_checkpoints/IIWA_7_hit_4.csv", "b/joints.csv", ".b/joints.csv"):
        (spread / name).parent.mkdir(exist_ok=True)
        (spread / name).write_text("RosTime\n")
    assert [path.name for path in find_runs(spread, spread_mapping())] == ["2", "9", "10"]
    prefixed = mapping_of(column="JointPosition", file="{run}.csv")
    assert all(not path.name.startswith(".") for path in find_runs(spread, prefixed))
    assert find_runs(spread, mapping_of(column="JointPosition", file="joints.csv")) == [spread / "b"]


def test_a_table_of_runs_names_runs_that_are_spread_over_files(spread: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (spread / "runs.csv").write_text("bag,object,kind\n9,none,free motion\n10,none,free motion\n")
    experiment = Experiment(scenario="push")
    monkeypatch.setattr(Experiment, "load_mappings", lambda *_: {"arm": spread_mapping()})
    assert [run.name for run in read_runs(spread, experiment, experiment.load_scenario())] == ["9", "10"]
    (spread / "runs.csv").write_text("bag,object,kind\n19,none,free motion\n")
    said = refusal(read_runs, spread, experiment, experiment.load_scenario())
    assert "line 2, bag = '19': no such run among the files IIWA_7_hit_{run}.csv" in said


def test_a_log_that_ends_in_the_middle_of_its_last_line_is_read_without_it(tmp_path: Path) -> None:
    whole = text(tmp_path / "whole.csv", "")
    cut = tmp_path / "cut.csv"
    cut.write_text(whole.read_text().rpartition(",")[0])
    series = read_positions(cut, mapping_of({}, **BY_NAME))
    np.testing.assert_array_equal(series.values, VALUES[:-1])
    (remark,) = series.remarks
    assert remark == f"cut.csv: line {len(VALUES) + 1}, the last, is cut off (7 of 8 numbers): left out"
    cut.write_text(cut.read_text() + "\n")  # a line that ends is torn like any other
    (remark,) = read_positions(cut, mapping_of({}, **BY_NAME)).remarks
    assert f"1 of {len(VALUES)} lines are torn" in remark and "7 numbers, expected 8 as in line 1" in remark


@pytest.mark.parametrize(("kind", "said"), [("char", 1), ("logical", 1), ("double", 0)])
def test_texts_and_truth_values_of_matlab_are_no_numbers(tmp_path: Path, kind: str, said: int) -> None:
    """MATLAB 7.3 stores them as integers, and of an empty array its size."""
    path = newest_mat(tmp_path / "run.mat")
    with pytest.importorskip("h5py").File(path, "r+") as file:
        file["data/q"].attrs["MATLAB_class"] = np.bytes_(kind)
        file["time"].attrs["MATLAB_empty"] = np.uint8(0)
    mapping = mapping_of({}, {}, array="data/q")
    if said:
        assert "no array 'data/q'" in refusal(lambda: read_series(path, mapping, ["position"], ["position"]))
    else:
        np.testing.assert_array_equal(read_series(path, mapping, ["position"], ["position"])["position"].values, VALUES)
    with pytest.importorskip("h5py").File(path, "r+") as file:
        file["time"].attrs["MATLAB_empty"] = np.uint8(1)
        file["data/q"].attrs["MATLAB_class"] = np.bytes_("double")
    assert "no array 'time'" in refusal(lambda: read_series(path, mapping, ["position"], ["position"]))


# ---- runs inside of one file are read one by one --------------------------------------------------------------------


def csv_of_episodes(path: Path) -> Path:
    """Three episodes, each with stamps from 0 on; the second is four times as large as the first."""
    lines = ["t,episode_index," + ",".join(f"q{joint}" for joint in range(1, 8))]
    for episode in range(3):
        for time, row in zip(TIME.tolist(), ((1 + 3 * episode) * VALUES).tolist(), strict=True):
            lines.append(",".join([repr(time), str(episode), *map(repr, row)]))
    path.write_text("\n".join(lines) + "\n")
    return path


def parquet_of_episodes(path: Path) -> Path:
    pyarrow = pytest.importorskip("pyarrow")
    columns = np.vstack([(1 + 3 * episode) * VALUES for episode in range(3)])
    table = {"t": np.tile(TIME, 3), "episode_index": np.repeat(np.arange(3), 24)}
    table |= {f"q{joint + 1}": columns[:, joint] for joint in range(7)}
    pytest.importorskip("pyarrow.parquet").write_table(pyarrow.table(table), path, row_group_size=30)
    return path


EPISODES = mapping_of({"column": "t"}, further={"run_column": "episode_index"}, column="q{joint}")


@pytest.mark.parametrize(("write", "suffix"), [(csv_of_episodes, ".csv"), (parquet_of_episodes, ".parquet")])
def test_episodes_of_a_table_are_runs(tmp_path: Path, write: object, suffix: str) -> None:
    assert callable(write)
    file = write(tmp_path / f"log{suffix}")
    assert find_runs(file, EPISODES) == [file / "0", file / "1", file / "2"]
    for episode in range(3):
        found = read_positions(file / str(episode), EPISODES)
        np.testing.assert_array_equal(found.values, (1 + 3 * episode) * VALUES)
        np.testing.assert_array_equal(found.time, TIME)
    assert "no row is of run '7'; found: 0, 1, 2" in refusal(read_positions, file / "7", EPISODES)
    other = EPISODES.model_copy(update={"run_column": "episode"})
    assert "run_column of the mapping: no column 'episode'; did you mean" in refusal(find_runs, file, other)


def test_a_mistake_in_an_episode_names_the_line_of_the_file(tmp_path: Path) -> None:
    file = csv_of_episodes(tmp_path / "log.csv")
    lines = file.read_text().splitlines()
    lines[30] = lines[30].rsplit(",", 1)[0] + ",none"
    file.write_text("\n".join(lines) + "\n")
    assert "line 31" in refusal(read_positions, file / "1", EPISODES)
    np.testing.assert_array_equal(read_positions(file / "2", EPISODES).values, 7.0 * VALUES)


def test_a_run_without_a_name_is_refused(tmp_path: Path) -> None:
    file = csv_of_episodes(tmp_path / "log.csv")
    for name in ("", "a/b"):
        file.write_text(file.read_text().replace(",2,", f",{name},", 1))
        assert "expected the name of a run in every row" in refusal(find_runs, file, EPISODES)


def test_groups_of_arrays_are_runs(tmp_path: Path) -> None:
    file = tmp_path / "recordings.h5"
    with pytest.importorskip("h5py").File(file, "w") as content:
        for run in (2, 10):
            content[f"Rec_{run}/robot/q"] = run * VALUES
            content[f"Rec_{run}/robot/t"] = TIME + run
        content["notes/t"] = TIME
    mapping = mapping_of({"array": "{run}/robot/t"}, array="{run}/robot/q")
    assert find_runs(file, mapping) == [file / "Rec_2", file / "Rec_10"]
    for run in (2, 10):
        found = read_positions(file / f"Rec_{run}", mapping)
        np.testing.assert_array_equal(found.values, run * VALUES)
        np.testing.assert_array_equal(found.time, TIME + run)
    said = refusal(read_positions, file / "Rec_3", mapping)
    assert "no array 'Rec_3/robot/q' (position); did you mean" in said and "Rec_10/robot/q" in said


def test_a_group_that_is_called_as_its_file_is_one_run(tmp_path: Path) -> None:
    file = tmp_path / "Rec_2.npz"
    np.savez(file, **{"Rec_2/q": VALUES, "t": TIME})
    mapping = mapping_of({"array": "t"}, array="{run}/q")
    assert find_runs(file, mapping) == [file]
    np.testing.assert_array_equal(read_positions(file, mapping).values, VALUES)


@pytest.mark.parametrize(
    ("arrays", "before", "names", "recorded"),
    [
        (["Rec_1/q", "Rec_1/t", "Rec_2/q"], "", ("Rec_1", "Rec_2"), True),
        (["data/001/q", "data/002/q", "data/t"], "data/", ("001", "002"), True),
        (["arm_1/q", "arm_2/q"], "", ("arm_1", "arm_2"), False),
    ],
)
def test_groups_that_hold_the_same_arrays_are_found(
    arrays: list[str], before: str, names: tuple[str, ...], recorded: bool
) -> None:
    found = run_groups_of(arrays)
    assert found is not None
    assert (found.before, found.names, found.recorded) == (before, names, recorded)


def test_one_run_is_not_cut_into_several() -> None:
    """Signals in groups, groups without a common array, a counter of samples, one episode, episodes that alternate."""
    assert run_groups_of(["q", "dq", "state/q", "state/dq", "command/q"]) is None
    assert run_groups_of(["Rec_1/q", "Rec_2/pose"]) is None
    assert run_column_of({"t": TIME, "index": np.arange(24), "episode_index": np.zeros(24, int)}) is None
    assert run_column_of({"episode_index": np.arange(24) // 8}) is None  # too short for runs
    assert run_column_of({"episode_index": np.arange(100) % 2}) is None
    assert run_column_of({"episode_index": np.arange(120) // 40 % 2}) is None  # 0 comes again
    assert run_column_of({"episode_index": np.arange(100) // 50}) == "episode_index"
