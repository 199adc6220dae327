# SPDX-License-Identifier: Apache-2.0
"""What has a name is whole."""

from __future__ import annotations

import errno
from pathlib import Path

import pytest

from impact_rs_sim.errors import InputError
from impact_rs_sim.files import whole, whole_folder, write_whole


def test_a_file_is_replaced_at_once_and_nothing_is_left_beside_it(tmp_path: Path) -> None:
    path = tmp_path / "new" / "file.txt"
    write_whole(path, "one")
    with whole(path) as aside:
        aside.write_text("two")
        assert path.read_text() == "one"
    assert path.read_text() == "two"
    assert [entry.name for entry in path.parent.iterdir()] == ["file.txt"]


@pytest.mark.parametrize("error", [OSError(errno.ENOSPC, "No space left on device"), ZeroDivisionError()])
def test_what_fails_half_way_leaves_what_was_there(tmp_path: Path, error: Exception) -> None:
    write_whole(tmp_path / "file.txt", "one")
    expected = InputError if isinstance(error, OSError) else ZeroDivisionError
    with pytest.raises(expected) as caught, whole(tmp_path / "file.txt") as aside:
        aside.write_text("tw")
        raise error
    if isinstance(error, OSError):
        assert str(caught.value) == f"{tmp_path / 'file.txt'}: cannot be written: No space left on device"
    with pytest.raises(expected), whole_folder(tmp_path) as folder:
        (folder / "file.txt").write_text("two")
        (folder / "other.txt").write_text("two")
        raise error
    assert [entry.name for entry in tmp_path.iterdir()] == ["file.txt"]
    assert (tmp_path / "file.txt").read_text() == "one"


def test_files_of_a_folder_come_together_and_others_stay(tmp_path: Path) -> None:
    write_whole(tmp_path / "kept.txt", "kept")
    write_whole(tmp_path / "old.txt", "old")
    with whole_folder(tmp_path) as folder:
        (folder / "old.txt").write_text("new")
        assert (tmp_path / "old.txt").read_text() == "old"
    assert {entry.name: entry.read_text() for entry in tmp_path.iterdir()} == {"kept.txt": "kept", "old.txt": "new"}
