# SPDX-License-Identifier: Apache-2.0
"""Data sets: the rows of the single file, no bag read twice, one table for every reader."""

import json
import os
import shutil
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import fsspec
import numpy as np
import pytest

from impact_rs_analysis.measure.analyze import Analysis
from impact_rs_analysis.measure.data_set import Extended, extend
from impact_rs_analysis.measure.export import export
from impact_rs_analysis.measure.linear_fit import fit_zero_crossing
from impact_rs_cli.main import main
from impact_rs_sim.errors import InputError
from impact_rs_trials.store import Folder, owned

parquet = pytest.importorskip("pyarrow.parquet")
dataset = pytest.importorskip("pyarrow.dataset")

NAMES = [f"cat_food__case_2__s{scale}__r0" for scale in ("0.800", "1.000", "1.200")]
PARTS = ["part-00000.parquet", "part-00001.parquet"]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "rows"


class Reader:
    """A map that keeps which bags were read, and how many were asked for at a time."""

    def __init__(self, stop_after: int | None = None) -> None:
        self.read: list[str] = []
        self.most = 0
        self.stop_after = stop_after

    def __call__(self, function: Callable[[Any], Any], items: Sequence[Any]) -> Iterator[Any]:
        self.most = max(self.most, len(items))
        for item in items:
            if len(self.read) == self.stop_after:
                raise KeyboardInterrupt
            self.read.append(item)
            yield function(item)


def quiet(done: int, total: int) -> None:
    """The progress of a test is not shown."""


def extended(place: Path | str, folder: Path, rows: int = 2) -> tuple[Extended, list[str]]:
    """Export, and the bags that were read for it."""
    reader = Reader()
    found = extend(place, folder, reader, quiet, rows)
    assert reader.most <= rows  # no more than a part is held
    return found, reader.read


def table_of(folder: Path) -> list[dict[str, Any]]:
    """Its rows as other tools read them, in order of their bags."""
    rows: list[dict[str, Any]] = dataset.dataset(folder).to_table().to_pylist()
    return sorted(rows, key=lambda row: str(row["bag"]))


def bags_of(folder: Path) -> list[str]:
    return [row["bag"] for row in table_of(folder)]


def parts(folder: Path) -> dict[str, bytes]:
    return {name: (folder / name).read_bytes() for name in sorted(os.listdir(folder))}


def test_a_data_set_says_the_same_as_the_single_file(campaign: Path, folder: Path, tmp_path: Path) -> None:
    found, read = extended(campaign, folder)
    assert (found.trials, found.read, found.skipped, read) == (3, 3, (), NAMES)
    export(campaign, tmp_path / "push.parquet", map, quiet)
    single = parquet.read_table(tmp_path / "push.parquet")
    rows = table_of(folder)
    assert [row["bag"] for row in rows] == NAMES
    assert all(row.pop("stamp") for row in rows)
    assert rows == single.to_pylist()
    assert dataset.dataset(folder).schema.names[:-1] == single.schema.names
    assert parquet.read_table(folder).num_rows == 3  # as pandas reads a folder
    assert {name: parquet.read_metadata(folder / name).num_rows for name in parts(folder)} == dict(
        zip(PARTS, (2, 1), strict=True)
    )


def test_what_is_there_is_not_read_again(campaign: Path, folder: Path) -> None:
    extended(campaign, folder)
    before = parts(folder)
    found, read = extended(campaign, folder)
    assert (found.trials, found.read, read) == (3, 0, [])
    assert parts(folder) == before


def test_trials_that_a_running_campaign_adds_are_read_alone(campaign: Path, folder: Path) -> None:
    (campaign / NAMES[2]).rename(campaign / ".partial")
    assert extended(campaign, folder)[0].trials == 2
    (campaign / ".partial").rename(campaign / NAMES[2])
    found, read = extended(campaign, folder)
    assert (found.trials, read) == (3, [NAMES[2]])
    assert bags_of(folder) == NAMES


def test_an_interrupted_export_goes_on_with_what_is_missing(campaign: Path, folder: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        extend(campaign, folder, Reader(stop_after=1), quiet)
    assert bags_of(folder) == NAMES[:1]
    assert extended(campaign, folder)[1] == NAMES[1:]
    assert bags_of(folder) == NAMES


def test_a_killed_export_leaves_nothing_half_written(campaign: Path, folder: Path) -> None:
    extended(campaign, folder)
    (folder / "part-00001.parquet").rename(folder / ".part-00001.parquet.99.partial")
    (folder / ".lock").write_text("process 99 on a machine that was switched off\n")
    assert bags_of(folder) == NAMES[:2]
    assert extended(campaign, folder)[1] == NAMES[2:]
    assert list(parts(folder)) == PARTS


def test_rows_of_bags_that_are_gone_stay(campaign: Path, folder: Path) -> None:
    extended(campaign, folder)
    for name in NAMES:
        shutil.rmtree(campaign / name)
    assert extended(campaign, folder)[0] == Extended(trials=3, read=0, skipped=())


@pytest.mark.parametrize("rows", [1, 2, 100])
def test_a_trial_that_was_run_again_has_one_row_and_its_new_outcome(
    campaign: Path, folder: Path, with_outcome: Callable, rows: int
) -> None:
    extended(campaign, folder, rows)
    with_outcome(campaign / NAMES[1], "DROPPED")
    found, read = extended(campaign, folder, rows)
    assert (found.trials, read) == (3, [NAMES[1]])
    outcomes = [(row["bag"], row["outcome"]) for row in table_of(folder)]
    assert outcomes == list(zip(NAMES, ("OK", "DROPPED", "OK"), strict=True))


def test_two_arms_beside_one_are_one_table_for_readers_of_the_first_file(
    campaign: Path, folder: Path, mixed_trial: Path
) -> None:
    extended(campaign, folder)
    shutil.copytree(mixed_trial, campaign / "deeper" / mixed_trial.name)
    found, read = extended(campaign, folder)
    assert (found.trials, read) == (4, [f"deeper/{mixed_trial.name}"])
    *pushes, grab = table_of(folder)
    arms = [name for name in grab if name.endswith("_impact_time_s")]
    assert len(arms) == 3
    assert all([row[arm] is not None for arm in arms] == [True, False, False] for row in pushes)
    assert [grab[arm] is not None for arm in arms] == [False, True, True]
    schemas = [parquet.read_schema(folder / name) for name in parts(folder)]
    assert all(schema.equals(schemas[0]) for schema in schemas)


def test_a_part_without_the_column_of_an_arm_gets_it_next_time(campaign: Path, folder: Path, mixed_trial: Path) -> None:
    """As where an export was killed while it gave the parts their columns."""
    shutil.copytree(mixed_trial, campaign / "zz_mixed")
    extended(campaign, folder)
    first = folder / "part-00000.parquet"
    table = parquet.read_table(first)
    parquet.write_table(table.drop_columns([name for name in table.column_names if "_impact_" in name][1:]), first)
    assert extended(campaign, folder)[1] == []
    assert len([name for name in dataset.dataset(folder).schema.names if "_impact_" in name]) == 3


def test_damaged_bags_are_named_each_time_and_have_no_row(campaign: Path, folder: Path) -> None:
    (campaign / NAMES[0] / f"{NAMES[0]}.mcap").write_bytes(b"")
    for _ in range(2):
        found, read = extended(campaign, folder)
        assert [bag.name for bag in found.skipped] == NAMES[:1]
        assert NAMES[0] in read
    assert bags_of(folder) == NAMES[1:]


def test_net_feedback_by_condition_is_that_of_analyze(campaign: Path, folder: Path, push_analysis: Analysis) -> None:
    extended(campaign, folder)
    (entry,) = push_analysis.sets
    keys = ["scenario", "object", "case"]
    table = dataset.dataset(folder).to_table(filter=dataset.field("impact"))
    (mean,) = table.group_by(keys).aggregate([("net_feedback_m_s", "mean")]).to_pylist()
    assert [mean[key] for key in keys] == [entry.scenario, entry.object, entry.case]
    assert mean["net_feedback_m_s_mean"] == pytest.approx(np.mean([trial.net for trial in entry.trials]), rel=1e-12)
    reference, net = (table[f"{name}_m_s"].to_numpy() for name in ("reference_post_velocity", "net_feedback"))
    slope, intercept = np.polyfit(reference, net, 1)
    assert -intercept / slope == pytest.approx(entry.fit.estimate, rel=1e-9)
    assert fit_zero_crossing(reference, net).interval == pytest.approx(entry.fit.interval, rel=1e-9)


def test_bags_at_a_url_are_copied_one_at_a_time_and_once(campaign: Path, folder: Path) -> None:
    files, url = fsspec.filesystem("memory"), "memory://data_set/push"
    files.put(f"{campaign}/", "/data_set/push/", recursive=True)
    try:
        assert extended(url, folder)[1] == NAMES
        assert extended(url, folder)[1] == []
        files.put(f"{campaign / NAMES[1]}/", f"/data_set/push/{NAMES[1]}/", recursive=True)
        assert extended(url, folder)[1] == [NAMES[1]]
        assert bags_of(folder) == NAMES
    finally:
        files.rm("/data_set", recursive=True)


def test_a_data_set_belongs_to_one_campaign_and_one_process(campaign: Path, folder: Path, tmp_path: Path) -> None:
    extended(campaign, folder)
    other = campaign.rename(tmp_path / "other")
    with pytest.raises(InputError, match=r"rows: holds the trials of .*/push; choose another folder for .*other"):
        extended(other, folder)
    other.rename(campaign)
    with owned(Folder(folder), "data set"), pytest.raises(InputError, match="works on this data set"):
        extended(campaign, folder)


@pytest.mark.parametrize(
    ("file", "content", "message"),
    [
        ("notes.txt", b"", "rows: is not a data set: it holds notes.txt; choose an empty or a new folder"),
        ("part-00000.parquet", b"PAR1", "part-00000.parquet: cannot be read"),
    ],
)
def test_a_folder_that_holds_something_else_is_refused_in_one_line(
    campaign: Path, folder: Path, capfd: pytest.CaptureFixture, file: str, content: bytes, message: str
) -> None:
    folder.mkdir()
    (folder / file).write_bytes(content)
    assert main(["export", str(campaign), "-o", str(folder), "--jobs", "1"]) == 2
    (line,) = capfd.readouterr().err.splitlines()
    assert message in line
    assert parts(folder) == {file: content}


def test_a_part_of_another_program_is_refused(campaign: Path, folder: Path, tmp_path: Path) -> None:
    export(campaign, tmp_path / "push.parquet", map, quiet)
    folder.mkdir()
    (tmp_path / "push.parquet").rename(folder / "part-00000.parquet")
    with pytest.raises(InputError, match="is not part of a data set of impact-rs"):
        extended(campaign, folder)
    with pytest.raises(InputError, match="this is a file; expected the name of a folder"):
        extended(campaign, campaign / "manifest.yaml")


def test_the_command_prints_what_is_there_and_what_it_read(
    campaign: Path, folder: Path, capfd: pytest.CaptureFixture
) -> None:
    command = ["export", str(campaign), "-o", str(folder), "--jobs", "1"]
    assert main(command) == 0
    assert capfd.readouterr().out == f"3 trials in {folder}, 3 of them read now\n"
    assert main([*command, "--json"]) == 0
    assert json.loads(capfd.readouterr().out) == {"folder": str(folder), "trials": 3, "read": 0, "skipped": []}


def test_nothing_to_read_leaves_no_folder(folder: Path, tmp_path: Path, capfd: pytest.CaptureFixture) -> None:
    (tmp_path / "empty").mkdir()
    assert main(["export", str(tmp_path / "empty"), "-o", str(folder)]) == 2
    assert "no readable trials here" in capfd.readouterr().err
    assert os.listdir(tmp_path) == ["empty"]
