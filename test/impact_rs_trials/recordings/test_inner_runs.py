# SPDX-License-Identifier: Apache-2.0
"""Runs inside of one file are read one by one: episodes of a table, groups of arrays."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from refusals import refusal
from signal_files import TIME, VALUES

from impact_rs_trials.recordings.inner_runs import run_column_of, run_groups_of
from impact_rs_trials.recordings.mapping import Mapping, load_mapping
from impact_rs_trials.recordings.series import Series
from impact_rs_trials.recordings.sources import read_series, runs_inside


def mapping_of(position: dict[str, object], **further: object) -> Mapping:
    """Positions alone are read."""
    content = load_mapping("joint_state").model_dump()
    content["signals"]["position"] = {"unit": "rad", **position}
    content["signals"]["torque"] = {"unit": "N m", **position}
    return Mapping.model_validate(content | further)


def read(path: Path, mapping: Mapping) -> Series:
    return read_series(path, mapping, ["position"], ["position"])["position"]


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


EPISODES = mapping_of({"column": "q{joint}"}, time={"column": "t"}, run_column="episode_index")


@pytest.mark.parametrize(("write", "suffix"), [(csv_of_episodes, ".csv"), (parquet_of_episodes, ".parquet")])
def test_episodes_of_a_table_are_runs(tmp_path: Path, write: object, suffix: str) -> None:
    assert callable(write)
    file = write(tmp_path / f"log{suffix}")
    assert runs_inside(file, EPISODES) == [file / "0", file / "1", file / "2"]
    for episode in range(3):
        found = read(file / str(episode), EPISODES)
        np.testing.assert_array_equal(found.values, (1 + 3 * episode) * VALUES)
        np.testing.assert_array_equal(found.time, TIME)
    assert "no row is of run '7'; found: 0, 1, 2" in refusal(read, file / "7", EPISODES)
    other = EPISODES.model_copy(update={"run_column": "episode"})
    assert "run_column of the mapping: no column 'episode'; did you mean" in refusal(runs_inside, file, other)


def test_a_mistake_in_an_episode_names_the_line_of_the_file(tmp_path: Path) -> None:
    file = csv_of_episodes(tmp_path / "log.csv")
    lines = file.read_text().splitlines()
    lines[30] = lines[30].rsplit(",", 1)[0] + ",none"
    file.write_text("\n".join(lines) + "\n")
    assert "line 31" in refusal(read, file / "1", EPISODES)
    np.testing.assert_array_equal(read(file / "2", EPISODES).values, 7.0 * VALUES)


def test_a_run_without_a_name_is_refused(tmp_path: Path) -> None:
    file = csv_of_episodes(tmp_path / "log.csv")
    for name in ("", "a/b"):
        file.write_text(file.read_text().replace(",2,", f",{name},", 1))
        assert "expected the name of a run in every row" in refusal(runs_inside, file, EPISODES)


def test_groups_of_arrays_are_runs(tmp_path: Path) -> None:
    file = tmp_path / "recordings.h5"
    with pytest.importorskip("h5py").File(file, "w") as content:
        for run in (2, 10):
            content[f"Rec_{run}/robot/q"] = run * VALUES
            content[f"Rec_{run}/robot/t"] = TIME + run
        content["notes/t"] = TIME
    mapping = mapping_of({"array": "{run}/robot/q"}, time={"array": "{run}/robot/t"})
    assert runs_inside(file, mapping) == [file / "Rec_2", file / "Rec_10"]
    for run in (2, 10):
        found = read(file / f"Rec_{run}", mapping)
        np.testing.assert_array_equal(found.values, run * VALUES)
        np.testing.assert_array_equal(found.time, TIME + run)
    said = refusal(read, file / "Rec_3", mapping)
    assert "no array 'Rec_3/robot/q' (position); did you mean" in said and "Rec_10/robot/q" in said


def test_a_group_that_is_called_as_its_file_is_one_run(tmp_path: Path) -> None:
    file = tmp_path / "Rec_2.npz"
    np.savez(file, **{"Rec_2/q": VALUES, "t": TIME})
    mapping = mapping_of({"array": "{run}/q"}, time={"array": "t"})
    assert runs_inside(file, mapping) == [file]
    np.testing.assert_array_equal(read(file, mapping).values, VALUES)


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


def test_what_is_one_run_is_not_cut() -> None:
    """Signals in groups, groups without a common array, a counter of samples, one episode, episodes that alternate."""
    assert run_groups_of(["q", "dq", "state/q", "state/dq", "command/q"]) is None
    assert run_groups_of(["Rec_1/q", "Rec_2/pose"]) is None
    assert run_column_of({"t": TIME, "index": np.arange(24), "episode_index": np.zeros(24, int)}) is None
    assert run_column_of({"episode_index": np.arange(24) // 8}) is None  # too short for runs
    assert run_column_of({"episode_index": np.arange(100) % 2}) is None
    assert run_column_of({"episode_index": np.arange(120) // 40 % 2}) is None  # 0 comes again
    assert run_column_of({"episode_index": np.arange(100) // 50}) == "episode_index"
