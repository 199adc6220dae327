# SPDX-License-Identifier: Apache-2.0
"""What ``./run`` says while it installs, with a stand-in for uv."""

from __future__ import annotations

import os
import pty
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture
def clone(tmp_path: Path) -> Path:
    """A folder with ``run``, an environment that was made there, and a uv that writes down what it is asked."""
    shutil.copy(ROOT / "run", tmp_path / "run")
    binaries = tmp_path / ".venv" / "bin"
    binaries.mkdir(parents=True)
    for name in ("pyproject.toml", "uv.lock"):
        (tmp_path / name).touch()
    (tmp_path / ".venv" / ".impact_rs_root").write_text(f"{tmp_path.resolve()}\n")
    uv = 'echo "$@" > "$(dirname "$0")/asked"\n[ -z "$REFUSED" ] || { echo "error: no route to $REFUSED"; exit 7; }\n'
    for name, text in (("python", "exit 0\n"), ("impact-rs", "exit 0\n"), ("uv", uv)):
        (binaries / name).write_text(f"#!/bin/sh\n{text}")
        (binaries / name).chmod(0o755)
    return tmp_path


def asked(clone: Path) -> list[str]:
    return (clone / ".venv" / "bin" / "asked").read_text().split()


def sync(clone: Path, command: str = "sync", **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [clone / "run", command],
        capture_output=True,
        text=True,
        timeout=60,
        env=os.environ | {"REFUSED": ""} | environment,
    )


def test_without_a_terminal_size_and_true_time_are_said_in_few_lines(clone: Path) -> None:
    done = sync(clone)
    lines = done.stderr.splitlines()
    assert (done.returncode, done.stdout, len(lines)) == (0, "", 3)
    assert "GB on disk" in lines[0] and "minutes" in lines[1]
    assert lines[2].startswith("run: installed in ") and lines[2].endswith(" s")
    assert "--quiet" in asked(clone)


def test_on_a_terminal_uv_shows_its_progress(clone: Path) -> None:
    ours, theirs = pty.openpty()
    subprocess.run([clone / "run", "sync"], stderr=theirs, check=True, timeout=60, env=os.environ | {"REFUSED": ""})
    os.close(theirs)
    os.close(ours)
    assert "sync" in asked(clone) and "--quiet" not in asked(clone)


def test_an_outage_is_reported_by_uv_and_the_next_call_tries_again(clone: Path) -> None:
    done = sync(clone, REFUSED="pypi.org")
    assert done.returncode == 7
    assert done.stderr.splitlines()[-1] == "error: no route to pypi.org"
    assert "installed in" not in done.stderr
    assert sync(clone).returncode == 0


def test_what_tests_need_is_installed_when_they_are_called(clone: Path) -> None:
    assert sync(clone, "demo").returncode == 0
    assert "--extra export" in " ".join(asked(clone))
    added = sync(clone, "test")
    assert "--extra test" in " ".join(asked(clone)) and "adding what tests and developers use" in added.stderr
    for command in ("demo", "test", "python"):
        assert "installing" not in sync(clone, command).stderr
    os.utime(clone / "uv.lock", (4e9, 4e9))
    assert "installed in" in sync(clone, "demo").stderr
    assert "--extra test" in " ".join(asked(clone))  # an environment for tests stays one
