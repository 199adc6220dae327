# SPDX-License-Identifier: Apache-2.0
"""What ``./run`` installs and says, with a stand-in for uv."""

from __future__ import annotations

import os
import pty
import re
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


def test_without_a_terminal_size_and_true_time_are_said_in_few_lines(clone: Path) -> None:
    done = sync(clone)
    lines = done.stderr.splitlines()
    assert (done.returncode, done.stdout, len(lines)) == (0, "", 3)
    assert "GB on disk" in lines[0] and "minutes" in lines[1]
    assert re.fullmatch(r"run: installed in \d+ s, \d+ MB", lines[2])
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


def with_tool(clone: Path, name: str, text: str) -> None:
    path = clone / ".venv" / "bin" / name
    path.write_text(f"#!/bin/sh\n{text}\n")
    path.chmod(0o755)


def change_a_source(clone: Path) -> None:
    (clone / "uv.lock").write_text("changed")
    os.utime(clone / "uv.lock", (4e9, 4e9))


def test_changed_sources_are_built_without_a_network(clone: Path) -> None:
    sync(clone)
    change_a_source(clone)
    done = sync(clone, REFUSED="pypi.org")
    assert done.returncode == 0 and "installed in" in done.stderr


def test_what_changed_sources_need_besides_is_fetched(clone: Path) -> None:
    sync(clone)
    change_a_source(clone)
    done = sync(clone, REFUSED="wheel")  # that is not in uv's cache
    assert done.returncode == 0 and "network was disabled" not in done.stderr
    assert "--offline" not in asked(clone)


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
    for command in ("demo", "test", "python"):
        assert "installing" not in sync(clone, command).stderr
    change_a_source(clone)
    assert "installed in" in sync(clone, "demo").stderr
    assert "--extra test" in " ".join(asked(clone))  # an environment for tests stays one


def test_what_parquet_and_hdf5_need_is_added_once_and_stays(clone: Path) -> None:
    sync(clone, "demo")
    assert "adding what reads and writes Parquet and HDF5" in sync(clone, "sync export").stderr
    assert "--extra export" in " ".join(asked(clone))
    for command in ("demo", "sync export"):
        assert sync(clone, command).stderr == ""
    change_a_source(clone)
    sync(clone, "demo")
    assert "--extra export" in " ".join(asked(clone))
    sync(clone, "test")
    assert "--extra test" in " ".join(asked(clone))  # which has the others in it
    assert sync(clone, "sync exports").returncode == 2


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
        for name in ("libx.so", "libx.so.1", "libx.so.1.2"):
            self.linked(f"cmeel.prefix/lib/{name}", b"x")
        self.linked("cmeel.prefix/lib/liby.so", b"y, old")
        self.linked("cmeel.prefix/lib/liby.so.1", b"y, new")
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


def test_copies_of_a_library_become_links_and_others_of_the_same_name_stay(clone: Path, wheels: Wheels) -> None:
    sync(clone)
    folder = wheels.site / "cmeel.prefix" / "lib"
    for name in ("libx.so", "libx.so.1"):
        assert (folder / name).resolve() == (folder / "libx.so.1.2").resolve()
    assert not (folder / "libx.so.1.2").is_symlink()
    assert (folder / "liby.so").read_bytes() == b"y, old"


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


def test_libraries_of_the_ros_wheels_are_found_without_a_second_start_of_python(clone: Path) -> None:
    with_tool(clone, "impact-rs", 'echo "$LD_LIBRARY_PATH,$_ROS_WHEELS_BOOTSTRAP_COMPLETE"')
    ours = clone.resolve() / ".venv" / "lib"
    wheel = ours / "python3.11" / "site-packages" / "ros_rclpy.libs"
    sync(clone)
    wheel.mkdir(parents=True)
    for theirs in ("", "/opt/ros/jazzy/lib"):
        found = sync(clone, "impact-rs", LD_LIBRARY_PATH=theirs).stdout.strip()
        assert found == ":".join(filter(None, (str(ours), str(wheel), theirs))) + ",1"


def test_packages_of_cmeel_are_found_by_their_path_alone(clone: Path, wheels: Wheels) -> None:
    wheels.linked("cmeel.pth", b"import cmeel_pth")
    sync(clone)
    assert (wheels.site / "cmeel.pth").read_bytes() == b"import cmeel_pth"  # nothing is there
    (clone / ".venv" / ".impact_rs_installed").unlink()
    wheels.linked("cmeel.prefix/lib/python3.11/site-packages/coal/__init__.py", b"")
    sync(clone)
    (line,) = (wheels.site / "cmeel.pth").read_text().splitlines()
    assert (wheels.site / line / "coal" / "__init__.py").exists()
    assert (wheels.cache / "cmeel.pth").read_bytes() == b"import cmeel_pth"  # that of other projects
