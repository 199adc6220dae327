# SPDX-License-Identifier: Apache-2.0
"""What ``./run`` installs, again and offline, and what it leaves whole, with a stand-in for uv."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
KINDS = ("msg", "srv", "action")


@pytest.fixture
def clone(tmp_path: Path) -> Path:
    """A folder with ``run``, an environment that was made there, and a uv that writes down what it is asked."""
    shutil.copy(ROOT / "run", tmp_path / "run")
    binaries = tmp_path / ".venv" / "bin"
    binaries.mkdir(parents=True)
    for name in ("cmake", "src", "scripts", "launch", "config/viewers", *(f"impact_msgs_py/{kind}" for kind in KINDS)):
        (tmp_path / name).mkdir(parents=True)
    for name in ("pyproject.toml", "uv.lock", "CMakeLists.txt", "package.xml", "config/nodes.yaml"):
        (tmp_path / name).touch()
    (tmp_path / ".venv" / ".impact_rs_root").write_text(f"{tmp_path.resolve()}\n")
    uv = """echo "$@" > "$(dirname "$0")/asked"
case "$REFUSED $*" in
    "wheel "*--offline*) echo "hint: Packages were unavailable because the network was disabled."; exit 1 ;;
    " "* | "wheel "* | *"org "*--offline*) ;;
    *) echo "error: no route to $REFUSED"; exit 7 ;;
esac
"""
    for name, text in (("python", "exit 0\n"), ("impact-rs", "exit 0\n"), ("uv", uv)):
        (binaries / name).write_text(f"#!/bin/sh\n{text}")
        (binaries / name).chmod(0o755)
    return tmp_path


def asked(clone: Path) -> list[str]:
    return (clone / ".venv" / "bin" / "asked").read_text().split()


def sync(clone: Path, command: str = "sync", **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [clone / "run", *command.split()],
        capture_output=True,
        text=True,
        timeout=60,
        env=os.environ | {"REFUSED": ""} | environment,
    )


def test_an_outage_is_reported_by_uv_and_the_next_call_tries_again(clone: Path) -> None:
    done = sync(clone, REFUSED="pypi.org")
    assert done.returncode == 7
    assert done.stderr.splitlines()[-1] == "error: no route to pypi.org"
    assert "installed in" not in done.stderr
    assert sync(clone).returncode == 0


def with_tool(clone: Path, name: str, text: str) -> None:
    path = clone / ".venv" / "bin" / name
    path.write_text(f"#!/bin/sh\n{text}\n")
    path.chmod(0o755)


def change_a_source(clone: Path) -> None:
    (clone / "uv.lock").write_text("changed")
    os.utime(clone / "uv.lock", (4e9, 4e9))


@pytest.mark.parametrize("refused", ["pypi.org", "wheel"])
def test_changed_sources_need_no_network_and_what_they_need_besides_is_fetched(clone: Path, refused: str) -> None:
    """``wheel``: something that is not in uv's cache."""
    sync(clone)
    change_a_source(clone)
    done = sync(clone, REFUSED=refused)
    assert done.returncode == 0 and "installed in" in done.stderr and "network was disabled" not in done.stderr
    assert ("--offline" in asked(clone)) == (refused == "pypi.org")


def test_a_mistake_in_changed_sources_is_shown_and_built_once(clone: Path) -> None:
    sync(clone)
    change_a_source(clone)
    with_tool(clone, "uv", 'echo "$@" >> "$0.calls"; echo "error: expected ;"; exit 1')
    done = sync(clone)
    assert done.returncode == 1 and "error: expected ;" in done.stderr and "installed in" not in done.stderr
    assert len((clone / ".venv" / "bin" / "uv.calls").read_text().splitlines()) == 1
    assert "the sources have changed" in sync(clone).stderr


def test_what_tests_need_is_installed_when_they_are_called(clone: Path) -> None:
    assert sync(clone, "demo").returncode == 0
    assert "--extra" not in asked(clone)
    added = sync(clone, "test")
    assert "--extra test" in " ".join(asked(clone)) and "adding what tests and developers use" in added.stderr
    for command in ("demo", "test", "python", "sync export"):
        assert "installing" not in sync(clone, command).stderr
    change_a_source(clone)
    assert "installed in" in sync(clone, "demo").stderr
    assert "--extra test" in " ".join(asked(clone))  # an environment for tests stays one


def test_a_file_with_another_time_and_the_same_content_is_no_change(clone: Path) -> None:
    sync(clone)
    os.utime(clone / "uv.lock")
    assert sync(clone).stderr == ""
    assert (clone / ".venv" / ".impact_rs_installed").stat().st_mtime_ns >= (clone / "uv.lock").stat().st_mtime_ns
    (clone / "uv.lock").write_text("changed")
    assert "the sources have changed" in sync(clone).stderr


class Wheels:
    """Parts of wheels in the environment, each linked to a file in a cache as uv does it."""

    def __init__(self, clone: Path) -> None:
        self.site = clone / ".venv" / "lib" / "python3.11" / "site-packages"
        self.cache = clone / "cache"
        self.cache.mkdir()
        self.bullet = self.linked("pybullet.cpython-311.so", b"debug" * 8_000_000)
        self.linked("pybullet_data/plane.urdf", b"plane")
        self.linked("cmeel.prefix/include/boost/any.hpp", b"any")
        self.before = self.content_of_cache()

    def linked(self, name: str, content: bytes) -> Path:
        original, path = self.cache / name.replace("/", "__"), self.site / name
        original.write_bytes(content)
        path.parent.mkdir(parents=True, exist_ok=True)
        os.link(original, path)
        return path

    def content_of_cache(self) -> dict[str, bytes]:
        return {path.name: path.read_bytes() for path in self.cache.iterdir()}


STRIP = 'printf stripped > "$3"'  # strip --strip-unneeded -o TARGET SOURCE


@pytest.fixture
def wheels(clone: Path, monkeypatch: pytest.MonkeyPatch) -> Wheels:
    with_tool(clone, "strip", STRIP)
    monkeypatch.setenv("PATH", f"{clone / '.venv' / 'bin'}:{os.environ['PATH']}")
    return Wheels(clone)


def test_what_nothing_reads_leaves_the_environment_and_the_cache_as_it_was(clone: Path, wheels: Wheels) -> None:
    for _ in range(2):  # the second time nothing is left to do
        assert sync(clone).returncode == 0
        assert not (wheels.site / "pybullet_data").exists()
        assert not (wheels.site / "cmeel.prefix" / "include").exists()
        assert wheels.bullet.read_bytes() == b"stripped"
        assert wheels.content_of_cache() == wheels.before
        (clone / ".venv" / ".impact_rs_installed").unlink()
    assert sorted(path.name for path in wheels.site.iterdir()) == ["cmeel.prefix", wheels.bullet.name]


@pytest.mark.parametrize("fault", ["no strip", "strip fails", "what is left does not load"])
def test_pybullet_stays_whole_where_symbols_cannot_be_taken(clone: Path, wheels: Wheels, fault: str) -> None:
    if fault == "what is left does not load":
        with_tool(clone, "python", '[ "$1" != -c ] || [ $# -lt 3 ]')
    else:
        with_tool(clone, "strip", "exit 127" if fault == "no strip" else f"{STRIP}; exit 1")
    done = sync(clone)
    assert done.returncode == 0 and len(done.stderr.splitlines()) == 3
    assert wheels.bullet.read_bytes() == b"debug" * 8_000_000
    assert sorted(path.name for path in wheels.site.iterdir()) == ["cmeel.prefix", wheels.bullet.name]


def test_packages_of_the_users_workspace_are_found_behind_ours(clone: Path) -> None:
    with_tool(clone, "impact-rs", 'echo "$AMENT_PREFIX_PATH"')
    ours = str(clone.resolve() / ".venv")
    for theirs in ("", "/home/me/ws/install/arm:/opt/ros/jazzy"):
        found = sync(clone, "impact-rs", AMENT_PREFIX_PATH=theirs).stdout.strip()
        assert found == (f"{ours}:{theirs}" if theirs else ours)
