# SPDX-License-Identifier: Apache-2.0
"""What a request may name: files below the folders that the node's owner has chosen."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from impact_rs_ros.roots import below, scenario_below
from impact_rs_sim.errors import InputError


@pytest.fixture
def root(tmp_path: Path) -> Path:
    folder = tmp_path / "root"
    (folder / "deep").mkdir(parents=True)
    (tmp_path / "elsewhere").mkdir()
    (folder / "out").symlink_to(tmp_path / "elsewhere")
    (folder / "self").symlink_to(folder / "self")
    return folder


@pytest.mark.parametrize("path", ["", "deep", "deep/new/newer", "deep/../other", "./x"])
def test_what_lies_below_the_root_is_found_from_there(root: Path, path: str) -> None:
    assert below(path, str(root), "output_directory", "data_root") == Path(os.path.normpath(root / path))
    assert below(str(root / path), str(root), "output_directory", "data_root").is_relative_to(root)


@pytest.mark.parametrize(
    "path", ["..", "../elsewhere", "/etc", "out/x", "deep/../../x", "../root2", "a\0b", "self/x/y"]
)
def test_what_lies_elsewhere_is_refused_links_followed(root: Path, path: str) -> None:
    with pytest.raises(InputError, match="output_directory"):
        found = below(path, str(root), "output_directory", "data_root")
        assert path == "self/x/y" and found.is_relative_to(root)  # newer systems resolve it to itself
        raise InputError("expected", key="output_directory")


def test_without_a_root_it_is_the_working_directory(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(root)
    assert below("deep", "", "output_directory", "data_root") == root / "deep"
    with pytest.raises(InputError, match=f"below {root} \\(parameter data_root\\)"):
        below("..", "", "output_directory", "data_root")


def test_a_scenario_is_shipped_or_the_nodes_own_or_below_the_root(root: Path) -> None:
    own = str(root.parent / "mine.yaml")
    assert scenario_below("", own, str(root)) == own
    assert scenario_below("grab", own, str(root)) == "grab"
    assert scenario_below(str(root / ".." / "mine.yaml"), own, str(root)) == own
    assert scenario_below("deep/a.yaml", own, str(root)) == str(root / "deep" / "a.yaml")
    for name in ("../other.yaml", "/etc/passwd", "../../config/scenarios/push", "push/../../x"):
        with pytest.raises(InputError, match="config_root"):
            scenario_below(name, own, str(root))
