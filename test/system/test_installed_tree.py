# SPDX-License-Identifier: Apache-2.0
"""Where ``ros2 run``, ``ros2 launch`` and ``pip uninstall`` look for the package, installed by pip or by colcon."""

import importlib.metadata
import os
import sys
from pathlib import Path

import impact_rs
import pytest
from ament_index_python.packages import get_package_prefix, get_package_share_directory
from ament_index_python.resources import get_resource
from catkin_pkg.package import parse_package

PREFIX = Path(impact_rs.__file__).parents[4]  # above lib/python3.x/site-packages/impact_rs
of_pip = pytest.mark.skipif(Path(sys.prefix) != PREFIX, reason="colcon has a folder of its own for the package")
NODES = ("cell", "controller", "experiment", "impact_map", "plant", "recorder", "watchdog")


@pytest.fixture(autouse=True)
def ament_prefix_path(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(PREFIX))


def test_ament_finds_the_package() -> None:
    assert get_package_prefix("impact_rs") == str(PREFIX)
    share = Path(get_package_share_directory("impact_rs"))
    assert parse_package(share / "package.xml").name == "impact_rs"


@pytest.mark.parametrize("node", NODES)
def test_ros2_run_finds_the_executable(node: str) -> None:
    executable = Path(get_package_prefix("impact_rs")) / "lib" / "impact_rs" / node
    assert os.access(executable, os.X_OK)
    assert f"impact_rs_ros.{node}_node" in executable.read_text()


def test_ros2_launch_finds_launch_files_and_parameters() -> None:
    share = Path(get_package_share_directory("impact_rs"))
    assert (share / "launch" / "impact_rs.launch.py").is_file()
    assert (share / "config" / "nodes.yaml").is_file()
    assert any((share / "config").rglob("*.yaml"))


def test_viewers_find_their_layouts() -> None:
    viewers = Path(get_package_share_directory("impact_rs")) / "config" / "viewers"
    assert {path.suffix for path in viewers.iterdir()} == {".rviz", ".json", ".xml"}


@of_pip
def test_python_alone_gets_no_interfaces_for_cpp() -> None:
    libraries = {path.stem.removeprefix("libimpact_rs__") for path in (PREFIX / "lib").glob("libimpact_rs__*.so")}
    assert "rosidl_typesupport_fastrtps_c" in libraries
    assert not {name for name in libraries if name.endswith("_cpp")}


def test_ros2_interface_finds_every_interface() -> None:
    content, _ = get_resource("rosidl_interfaces", "impact_rs")
    listed = [line for line in content.splitlines() if line.endswith((".msg", ".srv", ".action"))]
    share = Path(get_package_share_directory("impact_rs"))
    assert "msg/ControllerState.msg" in listed
    for interface in listed:
        assert (share / interface).is_file(), interface


@of_pip
def test_uninstalling_leaves_nothing_behind() -> None:
    """Every file of ours below the environment is recorded, so an uninstallation removes it."""
    distribution = importlib.metadata.distribution("impact-rs")
    recorded = {Path(os.path.normpath(distribution.locate_file(f))) for f in distribution.files or []}
    prefix = Path(sys.prefix)
    present = {
        path
        for folder in ("lib/impact_rs", "share/impact_rs")
        for path in (prefix / folder).rglob("*")
        if path.is_file()
    }
    present |= set((prefix / "lib").glob("libimpact_rs__*"))
    present |= set((prefix / "share/ament_index/resource_index").glob("*/impact_rs"))
    assert present
    assert present <= recorded
    assert not list(prefix.glob("lib/python3*/site-packages/impact_rs*.egg-info"))
