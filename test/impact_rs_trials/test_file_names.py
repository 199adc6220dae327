# SPDX-License-Identifier: Apache-2.0
"""Well-known files of a folder."""

from __future__ import annotations

from pathlib import Path

from impact_rs_trials.file_names import EXPERIMENT_FILES, experiment_file_in


def test_an_experiment_file_is_found_by_either_name_and_a_folder_of_that_name_is_none(tmp_path: Path) -> None:
    """Kills an ending that only one of workbench and Python knows, and a folder that is taken for a file."""
    first, second = (tmp_path / name for name in EXPERIMENT_FILES)
    assert experiment_file_in(tmp_path) is None
    second.write_text("")
    assert experiment_file_in(tmp_path) == second
    first.mkdir()
    assert experiment_file_in(tmp_path) == second
    first.rmdir()
    first.write_text("")
    assert experiment_file_in(tmp_path) == first
