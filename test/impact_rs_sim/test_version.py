# SPDX-License-Identifier: Apache-2.0
"""Which version this is, for bags and reports."""

import shutil
import subprocess
from importlib.metadata import version
from pathlib import Path

import pytest

import impact_rs_sim
from impact_rs_sim import version as version_module
from impact_rs_sim.version import described_by_git, git_revision, package_version, recorded_revision


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
