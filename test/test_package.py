# SPDX-License-Identifier: Apache-2.0
"""What is installed: one version, executables that lead somewhere, documented fields, launch files of drivers."""

import ast
import contextlib
import os
import re
import runpy
import subprocess
import sys
import tomllib
from collections.abc import Iterable
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import pytest
import yaml
from catkin_pkg.package import parse_package
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet

from impact_rs_ros.middleware import CHOICES, PROFILE, set_middleware
from impact_rs_ros.node_parameters import values_of
from impact_rs_ros.node_processes import NODES
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_trials.cell.driver_profiles import PROFILES, profile_of
from impact_rs_trials.cell.robot_states import joint_names

ROOT = Path(__file__).resolve().parent.parent
INTERFACES = sorted(
    path for kind in ("msg", "srv", "action") for path in (ROOT / "impact_msgs_py" / kind).glob(f"*.{kind}")
)
SCRIPTS = sorted((ROOT / "scripts").iterdir())
PACKAGES = (
    "impact_msgs_py",
    "impact_rs_analysis",
    "impact_rs_cli",
    "impact_rs_commands",
    "impact_rs_control",
    "impact_rs_ros",
    "impact_rs_sim",
    "impact_rs_trials",
    "impact_rs_workbench",
)
PHYSICAL = ("float64", "uint8", "uint32", "uint64", "bool", "geometry_msgs/", "sensor_msgs/", "shape_msgs/")


def pyproject() -> dict:
    return tomllib.loads((ROOT / "pyproject.toml").read_text())


def test_package_xml_is_valid_for_ament() -> None:
    package = parse_package(ROOT / "package.xml")
    package.validate()
    assert package.package_format == 3
    assert package.get_build_type() == "ament_cmake"
    assert [g.name for g in package.member_of_groups] == ["rosidl_interface_packages"]
    assert all("@" in maintainer.email for maintainer in package.maintainers)
    assert [author.email for author in package.authors] == [
        author["email"] for author in pyproject()["project"]["authors"]
    ]
    assert package.licenses == [pyproject()["project"]["license"]]


def test_one_version_everywhere() -> None:
    version = pyproject()["project"]["version"]
    assert parse_package(ROOT / "package.xml").version == version
    newest = re.search(r"^(\d+\.\d+\.\d+) \(.+\)\n-+$", (ROOT / "CHANGELOG.rst").read_text(), re.M)
    assert newest is not None
    assert newest[1] == version


def test_one_list_of_python_packages_everywhere() -> None:
    configured = pyproject()["tool"]
    assert sorted(configured["scikit-build"]["wheel"]["packages"]) == list(PACKAGES)
    assert sorted(configured["mypy"]["packages"]) == list(PACKAGES)
    for package in PACKAGES:
        assert package in (ROOT / "CMakeLists.txt").read_text()
        assert ast.get_docstring(ast.parse((ROOT / package / "__init__.py").read_text()))


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.name)
def test_a_script_leads_to_main_and_does_nothing_where_a_worker_imports_it(
    script: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The processes of a campaign import the program that started them under another name."""
    assert os.access(script, os.X_OK)
    assert script.read_text().startswith("#!/usr/bin/env python3\n")
    (module,) = re.findall(r"^ *from (\S+) import main$", script.read_text(), re.MULTILINE)
    monkeypatch.setattr("signal.signal", lambda *_: None)
    started: list[str] = []
    monkeypatch.setattr(f"{module}.main", lambda: started.append(module))
    runpy.run_path(str(script), run_name="__mp_main__")
    assert not started
    with contextlib.suppress(SystemExit):
        runpy.run_path(str(script), run_name="__main__")
    assert started == [module]


def test_every_script_and_interface_is_built() -> None:
    cmake = (ROOT / "CMakeLists.txt").read_text()
    for script in SCRIPTS:
        assert f"scripts/{script.name}" in cmake
    for interface in INTERFACES:
        assert f'"{interface.parent.name}/{interface.name}"' in cmake


def test_what_colcon_tests_needs_no_package_that_is_not_installed() -> None:
    """It runs in the build folder. Kills: an import of the benchmarks or tools of a clone."""
    (parts,) = re.findall(r"foreach\(part\n(.*?)\)", (ROOT / "CMakeLists.txt").read_text(), re.DOTALL)
    files = [path for part in parts.split() for path in ([ROOT / "test" / part] if part.endswith(".py")
                                                         else (ROOT / "test" / part).glob("**/*.py"))]  # fmt: skip
    assert len(files) > 50
    for path in files:
        assert not re.search(r"^\s*(from|import) (benchmarks|tools)\b", path.read_text(), re.MULTILINE), path


def test_an_interface_says_what_it_is_and_comments_every_field_with_its_unit() -> None:
    for interface in INTERFACES:
        lines = interface.read_text().splitlines()
        assert lines[0].startswith("# ")
        for line in lines:
            declaration, _, comment = line.partition("#")
            if declaration.strip() in ("", "---"):
                continue
            assert comment.strip(), f"{line!r} has no comment"
            if declaration.startswith(PHYSICAL):
                assert re.search(r"\[.+\]|unit quaternion", comment), f"{line!r} has no unit"


@pytest.fixture
def launch_file(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """What the launch file defines, on stand-ins for ``launch``, which is not on the package index."""

    class Configuration(SimpleNamespace):
        def perform(self, context: dict[str, str]) -> str:
            return context[self.name]

    def action(kind: str) -> Any:
        return lambda *inputs, **keys: SimpleNamespace(kind=kind, inputs=inputs, **keys)

    actions = ("DeclareLaunchArgument", "EmitEvent", "IncludeLaunchDescription", "LogInfo", "OpaqueFunction")
    actions += ("RegisterEventHandler",)
    substitutions = {"LaunchConfiguration": lambda name: Configuration(name=name), "PathJoinSubstitution": "/".join}
    substitutions["Command"] = list
    stand_ins: dict[str, dict[str, Any]] = {
        "launch": {"LaunchContext": dict, "LaunchDescription": list, "LaunchDescriptionEntity": object},
        "launch.actions": {name: action(name) for name in actions},
        "launch.conditions": {"IfCondition": lambda value: value},
        "launch.event_handlers": {"OnProcessExit": SimpleNamespace},
        "launch.events": {"matches_action": lambda action: action},
        "launch.events.process": {"ProcessExited": SimpleNamespace, "ShutdownProcess": SimpleNamespace},
        "launch.launch_description_sources": {"PythonLaunchDescriptionSource": list},
        "launch.substitutions": substitutions,
        "launch_ros": {},
        "launch_ros.actions": {"Node": action("Node")},
        "launch_ros.parameter_descriptions": {"ParameterValue": lambda value, value_type: value},
        "launch_ros.substitutions": {"FindPackageShare": str},
    }
    for name, content in stand_ins.items():
        module = ModuleType(name)
        vars(module).update(content)
        monkeypatch.setitem(sys.modules, name, module)
    return runpy.run_path(str(ROOT / "launch" / "impact_rs.launch.py"))


DRIVERS = {  # launch file, and beginning of the names of its files: profile of the driver, arm that it is for
    "fr3": ("franka_ros2", "franka_fr3"),
    "ur5e": ("ur_robot_driver", "ur5e"),
    "iiwa7": ("lbr_fri_ros2_stack", "kuka_iiwa7"),
    "ros2_control": ("ros2_control", None),
}
DRIVER_FILES = ROOT / "config" / "drivers"


def urdf_joints(robot: str | None) -> list[str]:
    """Names that the URDF gives the joints, from the facts that were imported from it; None: of the template."""
    if robot is None:
        return [f"arm_joint{number}" for number in range(1, 8)]
    return re.findall(r"- \{xyz:.*# (\S+)$", (ROOT / "config" / "robots" / f"{robot}.yaml").read_text(), re.MULTILINE)


def controllers_of(name: str) -> dict[str, Any]:
    """Parameters of the controller manager and its controllers by node."""
    content = yaml.safe_load((DRIVER_FILES / f"{name}_controllers.yaml").read_text())
    content = content.get("/**", content)
    return {node.removeprefix("/**/"): section["ros__parameters"] for node, section in content.items()}


@pytest.mark.parametrize("name", DRIVERS)
def test_a_launch_file_of_a_robot_starts_the_cell_on_the_topics_of_its_driver(
    launch_file: dict[str, Any], name: str
) -> None:
    """Its modules stand in as for the other launch file; the file of controllers has every one that it starts."""
    del launch_file
    file = runpy.run_path(str(ROOT / "launch" / f"{name}.launch.py"))
    entities = file["generate_launch_description"]()
    included = {one.inputs[0][0]: one for one in entities if one.kind == "IncludeLaunchDescription"}
    cell = included.pop("impact_rs/launch/cell.launch.py")
    given, profile = dict(cell.launch_arguments), PROFILES[DRIVERS[name][0]]
    defaults = {
        one.inputs[0]: getattr(one, "default_value", None) for one in entities if one.kind.startswith("Declare")
    }
    if profile.blocking:  # the cell cannot run with the driver as it is released
        assert cell.condition.name == "cell" and defaults["cell"] == "false"
    states = file["STATES"] if name == "ur5e" else given["states"]  # there an argument
    assert (states, given["commands"]) == (profile.states, profile.commands.replace("/ARM", ""))
    parameters = given["parameters"]
    if name != "ros2_control":  # there an argument
        assert (ROOT / parameters.removeprefix("impact_rs/")).is_file()
        assert len(included) == 1  # the driver
    spawned = [node.arguments[0] for node in entities if node.kind == "Node" and node.executable == "spawner"]
    if spawned:
        assert set(spawned) <= set(controllers_of(name)["controller_manager"])
        inactive = [node.arguments[0] for node in entities if "--inactive" in getattr(node, "arguments", ())]
        assert inactive == ["effort_controller"]


def test_cell_and_watchdog_are_launched_with_one_file_and_the_same_topics(launch_file: dict[str, Any]) -> None:
    del launch_file
    entities = runpy.run_path(str(ROOT / "launch" / "cell.launch.py"))["generate_launch_description"]()
    watchdog, cell = (one for one in entities if one.kind == "Node")
    assert (watchdog.executable, watchdog.name, cell.executable, cell.name) == ("watchdog", "watchdog", "cell", "cell")
    assert watchdog.remappings == cell.remappings and watchdog.parameters == cell.parameters
    assert [source for source, _ in cell.remappings] == ["joint_states", "arm/effort_controller/commands"]


@pytest.mark.parametrize("name", DRIVERS)
def test_parameters_of_a_robots_cell_are_those_of_its_driver_and_its_urdf(name: str) -> None:
    driver, robot = DRIVERS[name]
    profile, joints = PROFILES[driver], urdf_joints(robot)
    file = DRIVER_FILES / f"{name}_cell.yaml"
    cell, watchdog = values_of(file, "cell"), values_of(file, "watchdog")
    scenario = load_scenario(cell["scenario"])
    period = scenario.timing.control_period
    assert cell["watchdog"]
    for values in (cell, watchdog):
        assert joint_names(values["joints"], {"arm": len(joints)})["arm"] == joints
        assert values["robot_adds_gravity"] == profile.adds_gravity
        assert values["torque_rate_limit"] <= profile.torque_rate
        assert values["state_timeout"] >= 5 * period
    shared = set(cell) & set(watchdog)
    assert {key: cell[key] for key in shared} == {key: watchdog[key] for key in shared}
    assert watchdog["command_timeout"] > cell["answer_timeout"] + cell["state_timeout"]
    if robot is not None:
        assert profile_of(scenario) is profile and period == profile.period
        assert scenario.robots["arm"].facts == robot


@pytest.mark.parametrize("name", ["fr3", "iiwa7", "ros2_control"])  # ur_robot_driver has its own
def test_controllers_of_a_robot_run_at_the_rate_of_its_cell_and_command_its_joints(name: str) -> None:
    controllers = controllers_of(name)
    manager = controllers["controller_manager"]
    scenario = load_scenario(values_of(DRIVER_FILES / f"{name}_cell.yaml", "cell")["scenario"])
    assert manager["update_rate"] * scenario.timing.control_period == 1.0
    assert manager["effort_controller"]["type"] == "effort_controllers/JointGroupEffortController"
    assert set(controllers) - {"controller_manager"} <= set(manager)
    for controller in ("effort_controller", "joint_trajectory_controller"):
        assert controllers[controller]["joints"] == urdf_joints(DRIVERS[name][1])
    trajectory = controllers["joint_trajectory_controller"]
    if trajectory["command_interfaces"] == ["effort"]:
        assert list(trajectory["gains"]) == trajectory["joints"]


def test_fri_is_set_up_alike_in_both_command_modes_and_smooths_no_hit_away() -> None:
    position, torque = (
        yaml.safe_load((DRIVER_FILES / f"iiwa7_{mode}.yaml").read_text())["hardware"] for mode in ("position", "torque")
    )
    assert position.pop("client_command_mode") == "position" and torque.pop("client_command_mode") == "torque"
    assert position == torque
    assert torque["measured_torque_tau"] < 0.2 * load_scenario("push_iiwa7").timing.control_period


PARAMETERS = str(ROOT / "config" / "nodes.yaml")
CHOSEN = {"without": "", "params_file": PARAMETERS, "use_sim_time": "false", "rviz": "false"}
CHOSEN |= {"scenario": "grab", "namespace": "cell_a"}


def launched(launch_file: dict[str, Any], **chosen: str) -> list[Any]:
    """The nodes that the launch file starts."""
    return [entity for entity in launch_file["wanted_nodes"](CHOSEN | chosen) if entity.kind == "Node"]


def test_the_launch_file_leaves_out_what_others_provide(launch_file: dict[str, Any]) -> None:
    def started(without: str) -> list[str]:
        return [node.executable for node in launched(launch_file, without=without)]

    assert started("") == list(NODES)
    assert started("plant recorder") == ["impact_map", "controller", "experiment"]
    with pytest.raises(RuntimeError, match="no node 'wall'; expected one or more of plant, impact_map"):
        started("plant wall")
    with pytest.raises(RuntimeError, match=r"params_file: there is no file '/nope\.yaml'"):
        launched(launch_file, params_file="/nope.yaml")


def test_where_robot_state_publisher_is_installed_it_publishes_the_links_and_the_plant_does_not(
    launch_file: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert [node.parameters[-1].get("link_transforms") for node in launched(launch_file)][0] is True
    monkeypatch.setattr(
        "ament_index_python.packages.get_packages_with_prefixes", lambda: {"robot_state_publisher": "/"}
    )
    file = runpy.run_path(str(ROOT / "launch" / "impact_rs.launch.py"))
    left, right, plant, *others = launched(file, use_sim_time="true")
    assert (left.executable, plant.parameters[-1]["link_transforms"]) == ("robot_state_publisher", False)
    assert not any("link_transforms" in node.parameters[-1] for node in others)
    assert (left.namespace, right.namespace) == ("/cell_a/left", "/cell_a/right")  # of the joint states
    (given,) = left.parameters
    assert (given["frame_prefix"], given["use_sim_time"]) == ("cell_a/", True)
    assert "left_joint7" in given["robot_description"] and "right" not in given["robot_description"]
    assert ("/clock", "/cell_a/clock") in left.remappings


def test_the_launch_file_restarts_nodes_unless_parameters_were_refused(
    launch_file: dict[str, Any],
) -> None:
    for node in launched(launch_file):
        assert node.respawn.name == "respawn"
        assert 0 < node.respawn_max_retries < 100
    handlers = [one.inputs[0] for one in launch_file["wanted_nodes"](CHOSEN) if one.kind == "RegisterEventHandler"]
    assert [handler.target_action.executable for handler in handlers] == list(NODES)
    for handler in handlers:
        for code in (0, 1, -9):
            died = SimpleNamespace(returncode=code, process_name="plant-1", action=handler.target_action)
            assert handler.on_exit(died, {}) is None
        died.returncode = 2
        said, stopped = handler.on_exit(died, {})
        assert "plant-1: its parameters were refused" in said.msg
        assert stopped.event.process_matcher is handler.target_action


def test_the_plant_has_its_own_time_and_all_others_that_of_the_clock(launch_file: dict[str, Any]) -> None:
    nodes = {node.executable: node for node in launched(launch_file, use_sim_time="true", rviz="true")}
    on_clock = {name for name, node in nodes.items() if node.parameters[-1]["use_sim_time"]}
    assert on_clock == {*NODES, "rviz2"} - {"plant"}
    assert all(("/clock", "clock") in node.remappings for node in nodes.values())
    layout = (ROOT / "config" / "viewers" / "impact_rs.rviz").read_text()
    viewed = {topic for topic, _ in nodes["rviz2"].remappings} - {"/clock"}
    assert viewed == set(re.findall(r"^ +Value: (/\S+)$", layout, re.MULTILINE))
    assert nodes["rviz2"].arguments == ["-d", "impact_rs/config/viewers/impact_rs.rviz"]


def test_the_launch_file_has_the_arguments_that_one_expects(launch_file: dict[str, Any]) -> None:
    arguments = [one.inputs[0] for one in launch_file["generate_launch_description"]() if one.inputs]
    expected = ["scenario", "namespace", "without", "params_file", "use_sim_time", "log_level", "respawn", "rviz"]
    assert arguments == expected


@pytest.mark.parametrize("rmw", [{}, {"RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp"}], ids=["fast", "cyclone"])
@pytest.mark.parametrize("chosen", [{}, *({name: "x"} for name in CHOICES)], ids=["", *CHOICES])
def test_run_sets_the_middleware_as_the_nodes_do(rmw: dict[str, str], chosen: dict[str, str]) -> None:
    environment = rmw | chosen
    set_middleware(environment)
    block = re.search(
        r"^profile=$.*?profile\"$", (ROOT / "run").read_text().partition("# Nodes find each other")[2], re.M | re.S
    )
    assert block is not None
    script = f"set -eu\nroot={ROOT}\n{block[0]}\nenv -0"
    done = subprocess.run(["/bin/sh", "-c", script], env=rmw | chosen, capture_output=True, text=True, check=True)
    found = dict(line.split("=", 1) for line in done.stdout.split("\0") if line)
    found = {name: value for name, value in found.items() if name in (*CHOICES, *rmw)}
    if PROFILE in environment and PROFILE not in chosen:
        assert Path(environment.pop(PROFILE)).read_text() == Path(found.pop(PROFILE)).read_text()
    assert found == environment


def requirements(name: str) -> dict[str, Requirement]:
    """Requirements of a file for pip, by name."""
    lines = (ROOT / name).read_text().splitlines()
    return named(line for line in lines if line and not line.startswith("#"))


def named(lines: Iterable[str]) -> dict[str, Requirement]:
    """Requirements by name, in small letters."""
    return {one.name.lower(): one for one in map(Requirement, lines)}


KEYS = yaml.safe_load((ROOT / "test" / "shared" / "rosdep_keys.yaml").read_text())
OF_UBUNTU = {  # Python packages that rosdep installs in a version that is new enough: its key, version on Ubuntu 24.04
    "pin": ("pinocchio", "4.1.0"),
    "pyyaml": ("python3-yaml", "6.0.1"),
    "jinja2": ("python3-jinja2", "3.1.2"),
    "rich": ("python3-rich", "13.7.1"),
}
TOO_OLD = {  # what it installs too old, which pip therefore installs again
    "numpy": "python3-numpy",  # new enough; pip must not make it newer
    "matplotlib": "python3-matplotlib",
    "pybind11": "pybind11-dev",
    "pydantic": "python3-pydantic",
    "ruamel.yaml": "python3-ruamel.yaml",
    "scipy": "python3-scipy",
    "uvicorn": "python3-uvicorn",
}


def test_every_dependency_of_the_package_is_a_key_of_rosdep_in_use() -> None:
    """Kills: a key that rosdep does not know (``python3-pinocchio``), with which ``rosdep install`` ends."""
    package = parse_package(ROOT / "package.xml")
    kinds = (package.buildtool_depends, package.build_depends, package.exec_depends, package.test_depends)
    used = {depend.name for kind in kinds for depend in kind}
    assert used == set(KEYS)
    assert all(entry["ubuntu"]["noble"] for entry in KEYS.values())
    assert all(url.url.startswith("https://") for url in package.urls) and package.urls


def test_rosdep_and_one_command_of_pip_install_every_python_package_new_enough() -> None:
    """Kills: a dependency that a workspace with ROS 2 from apt has from nowhere, or too old."""
    package, project = parse_package(ROOT / "package.xml"), pyproject()["project"]
    keys = {depend.name for depend in (*package.exec_depends, *package.build_depends)}
    needed = named(line for line in project["dependencies"] if not line.startswith("ros-"))
    by_pip = requirements("requirements.txt")
    assert needed.keys() | {"pybind11"} == by_pip.keys() | OF_UBUNTU.keys()
    assert not by_pip.keys() & OF_UBUNTU.keys()
    for name, (key, version) in OF_UBUNTU.items():
        assert key in keys and version in needed[name].specifier, name
    assert set(TOO_OLD.values()) <= keys
    assert TOO_OLD.keys() <= by_pip.keys()
    assert by_pip.pop("numpy").specifier == needed["numpy"].specifier & SpecifierSet("<2")
    assert {name: one.specifier for name, one in by_pip.items() if name != "pybind11"} == {
        name: needed[name].specifier for name in by_pip if name != "pybind11"
    }


def test_requirements_of_the_tests_are_those_of_pip() -> None:
    extras = pyproject()["project"]["optional-dependencies"]
    tests = [*extras["export"], *(line for line in extras["test"] if not line.startswith("impact-rs"))]
    assert requirements("requirements-test.txt") == named(tests)


def test_xml_is_well_formed() -> None:
    for folder in ("config", "launch"):
        for path in (ROOT / folder).rglob("*.xml"):
            ElementTree.parse(path)
