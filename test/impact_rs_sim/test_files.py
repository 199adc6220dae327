# SPDX-License-Identifier: Apache-2.0
"""Files: whole or not at all, found where they may lie; progress, errors and the version."""

from __future__ import annotations

import errno
import json
import shutil
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest

import impact_rs_sim
from impact_rs_sim import paths
from impact_rs_sim import version as version_module
from impact_rs_sim.errors import InputError, UnreachablePose
from impact_rs_sim.files import whole, whole_folder, write_whole
from impact_rs_sim.progress import VARIABLE, ProgressFile
from impact_rs_sim.version import described_by_git, git_revision, package_version, recorded_revision

# ---- what has a name is whole ---------------------------------------------------------------------------------------


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


# ---- where the configuration lies -----------------------------------------------------------------------------------


@pytest.fixture
def nowhere(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """A module, an environment and an ament prefix without configuration."""
    monkeypatch.delenv("IMPACT_RS_CONFIG", raising=False)
    monkeypatch.setattr(paths, "__file__", str(tmp_path / "source" / "impact_rs_sim" / "paths.py"))
    monkeypatch.setattr(sys, "prefix", str(tmp_path / "venv"))
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"{tmp_path / 'first'}:{tmp_path / 'second'}")
    return tmp_path


def make(folder: Path) -> Path:
    folder.mkdir(parents=True)
    return folder


def test_places_are_tried_in_order(nowhere: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    second = make(nowhere / "second/share/impact_rs/config")
    assert paths.config_directory() == second
    first = make(nowhere / "first/share/impact_rs/config")
    assert paths.config_directory() == first
    environment = make(nowhere / "venv/share/impact_rs/config")
    assert paths.config_directory() == environment
    source = make(nowhere / "source/config")
    assert paths.config_directory() == source
    override = make(nowhere / "mine")
    monkeypatch.setenv("IMPACT_RS_CONFIG", str(override))
    assert paths.config_directory() == override


def test_the_error_lists_every_place(nowhere: Path) -> None:
    with pytest.raises(FileNotFoundError) as error:
        paths.config_directory()
    for place in ("source/config", "venv/share", "first/share", "second/share"):
        assert str(nowhere / place) in str(error.value)


def test_a_wrong_override_is_an_error(nowhere: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    make(nowhere / "source/config")
    monkeypatch.setenv("IMPACT_RS_CONFIG", str(nowhere / "missing"))
    with pytest.raises(FileNotFoundError, match="missing"):
        paths.config_directory()


# ---- progress for programs ------------------------------------------------------------------------------------------


def test_a_stage_is_told_from_its_first_step_to_its_last(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "progress.json"
    monkeypatch.setenv(VARIABLE, str(path))
    progress = ProgressFile()
    progress.update("trials", 0, 3)
    first = json.loads(path.read_text())
    assert (first["what"], first["done"], first["total"], first["ranking"]) == ("trials", 0, 3, [])
    progress.rank("second", 2.0)
    progress.rank("first", 1.0)
    progress.update("trials", 3, 3)
    last = json.loads(path.read_text())
    assert (last["done"], last["since"]) == (3, first["since"])
    assert last["ranking"] == [["first", 1.0], ["second", 2.0]]
    assert last["first"] == 0
    progress.update("other trials", 2, 8)  # some were done by an earlier run
    progress.update("other trials", 8, 8)
    assert json.loads(path.read_text())["first"] == 2
    progress.update("more trials", 0, None)
    assert json.loads(path.read_text())["since"] >= last["at"]


def test_progress_is_optional_and_a_full_disk_stops_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(VARIABLE, raising=False)
    ProgressFile().update("trials", 0, 3)
    (tmp_path / "file").write_text("")
    monkeypatch.setenv(VARIABLE, str(tmp_path / "file" / "progress.json"))  # a place that cannot be written
    ProgressFile().update("trials", 0, 3)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


# ---- mistakes of a user ---------------------------------------------------------------------------------------------


def test_a_mistake_keeps_its_kind_key_and_value_when_its_file_gets_known() -> None:
    found = UnreachablePose("expected a pose within reach [m]", key="cases.case_1", value=3.0).in_file("push.yaml")
    assert type(found) is UnreachablePose
    assert str(found) == "push.yaml: cases.case_1 = 3.0: expected a pose within reach [m]"
    assert (found.key, found.value) == ("cases.case_1", 3.0)


def test_where_no_file_is_known_none_is_named() -> None:
    assert str(InputError("expected a number > 0 [-]", key="trials")) == "trials: expected a number > 0 [-]"


# ---- version --------------------------------------------------------------------------------------------------------


def test_the_version_is_that_of_the_package() -> None:
    assert package_version() == version("impact-rs")


def git(folder: Path, *words: str) -> str:
    identity = ["-c", "user.name=x", "-c", "user.email=x@localhost"]
    return subprocess.run(["git", *identity, "-C", str(folder), *words], capture_output=True, text=True).stdout.strip()


def test_a_revision_is_that_of_the_sources_or_what_the_build_noted() -> None:
    here = Path(impact_rs_sim.__file__).resolve().parent
    revision = git(here.parent, "rev-parse", "--short=12", "HEAD") if (here.parent / ".git").exists() else ""
    git_revision.cache_clear()  # the sources may have changed since other tests asked
    assert revision in git_revision()
    assert revision or git_revision() == recorded_revision(here)


def test_an_installation_has_the_revision_of_its_build(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A colcon workspace or a virtual environment may lie in a repository of its own."""
    git(tmp_path, "init", "-q")
    git(tmp_path, "commit", "-q", "--allow-empty", "-m", "strange")
    assert described_by_git(tmp_path)
    folder = tmp_path / "site-packages" / "impact_rs_sim"
    folder.mkdir(parents=True)
    monkeypatch.setattr(version_module, "__file__", str(folder / "version.py"))
    for noted in ("", "1055161abcde+"):
        if noted:
            (folder / "git_revision.txt").write_text(noted + "\n")
        git_revision.cache_clear()
        assert git_revision() == noted
    monkeypatch.undo()
    git_revision.cache_clear()


def test_the_build_revision_marks_uncommitted_changes(tmp_path: Path) -> None:
    sources, file = tmp_path / "sources", tmp_path / "git_revision.txt"
    script = Path(__file__).resolve().parents[2] / "cmake" / "git_revision.cmake"
    cmake = shutil.which("cmake")
    if cmake is None or not script.is_file():
        pytest.skip("no CMake here")

    def noted() -> str:
        subprocess.run([cmake, f"-DSOURCES={sources}", f"-DFILE={file}", "-P", str(script)], check=True)
        return recorded_revision(tmp_path)

    sources.mkdir()
    assert noted() == ""
    git(sources, "init", "-q")
    (sources / "file").write_text("1")
    git(sources, "add", "file")
    git(sources, "commit", "-q", "-m", "first")
    revision = git(sources, "rev-parse", "--short=12", "HEAD")
    assert noted() == revision
    (sources / "file").write_text("2")
    assert noted() == f"{revision}+"
