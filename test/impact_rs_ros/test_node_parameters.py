# SPDX-License-Identifier: Apache-2.0
"""Parameters are declared once; the example file, the documentation and ``ros2 param describe`` follow."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
import yaml
from node_trials import participant
from rcl_interfaces.msg import Parameter
from rcl_interfaces.srv import DescribeParameters, GetParameters, SetParameters
from rclpy.parameter import Parameter as RclParameter

from impact_rs_ros import node_parameters, process
from impact_rs_ros.cell_node import CellNode
from impact_rs_ros.controller_node import ControllerNode
from impact_rs_ros.graph import Graph
from impact_rs_ros.impact_map_node import ImpactMapNode
from impact_rs_ros.node_processes import NODES
from impact_rs_ros.plant_node import PlantNode
from impact_rs_ros.process import NodeProgram
from impact_rs_ros.recorder_node import RecorderNode
from impact_rs_ros.watchdog_node import WatchdogNode
from impact_rs_sim.errors import InputError

ROOT = Path(__file__).resolve().parents[2]
ALONE = "identify"  # started by itself, with the same file


def example() -> dict[str, dict[str, object]]:
    """Values of ``config/nodes.yaml`` by node."""
    sections = yaml.safe_load((ROOT / "config" / "nodes.yaml").read_text())
    common = sections.pop("/**")["ros__parameters"]
    own = {name.removeprefix("/**/"): section["ros__parameters"] for name, section in sections.items()}
    assert set(own) <= {*NODES, ALONE}
    writes = {"recorder", "experiment"}  # who has the one parameter that not all have in common
    shared = {
        name: {key: common[key] for key in common if key != "data_root" or name in writes} for name in (*NODES, ALONE)
    }
    real = yaml.safe_load((ROOT / "config" / "cell.yaml").read_text())
    cell, watchdog = (shared["plant"] | real[f"/**/{name}"]["ros__parameters"] for name in ("cell", "watchdog"))
    return {name: shared[name] | own.get(name, {}) for name in shared} | {"cell": cell, "watchdog": watchdog}


def test_the_example_files_hold_every_parameter_at_its_default() -> None:
    assert example() == {kind: {p.name: p.default for p in known} for kind, known in node_parameters.PARAMETERS.items()}


def test_the_documentation_is_up_to_date() -> None:
    written = (ROOT / "docs" / "parameters.md").read_text()
    assert written == node_parameters.markdown(), "run: python -m impact_rs_ros.node_parameters > docs/parameters.md"


@pytest.mark.parametrize("kind", NODES)
def test_a_node_loads_the_example_and_tells_unit_and_range(
    graph: Graph, kind: str, tmp_path_factory: pytest.TempPathFactory
) -> None:
    known = node_parameters.PARAMETERS[kind]
    names = [p.name for p in known]
    described = graph.call(DescribeParameters, f"{kind}/describe_parameters", DescribeParameters.Request(names=names))
    values = graph.call(GetParameters, f"{kind}/get_parameters", GetParameters.Request(names=names))
    for parameter, descriptor, message in zip(known, described.descriptors, values.values, strict=True):
        assert descriptor.description == f"{parameter.description} [{parameter.unit}]"
        assert descriptor.read_only == parameter.read_only
        assert descriptor.additional_constraints.endswith(f"a change acts: {parameter.effect}")
        limits = [(r.from_value, r.to_value) for r in descriptor.floating_point_range]
        assert limits == ([parameter.range] if parameter.range else [])
        found = RclParameter.from_parameter_msg(Parameter(name=parameter.name, value=message)).value
        given = dict.fromkeys(("config_root", "data_root"), str(tmp_path_factory.getbasetemp()))  # by the tests' graph
        assert found == (example()[kind] | given)[parameter.name]


@pytest.mark.parametrize(
    ("node", "name", "wanted", "told"),
    [
        ("plant", "answer_timeout", -1.0, "answer_timeout out of range"),
        ("impact_map", "engine", "foo", "expected exact or bullet"),
        ("impact_map", "contact", "last", "expected first or settled"),
        ("plant", "scenario", "nonsense", "no scenario 'nonsense'"),
        ("plant", "use_sim_time", True, "the plant publishes /clock"),
        ("recorder", "data_root", "/nowhere/at/all", "expected a folder that exists"),
    ],
)
def test_a_value_that_cannot_be_worked_with_is_refused_with_a_reason(
    graph: Graph, node: str, name: str, wanted: object, told: str
) -> None:
    message = RclParameter(name, value=wanted).to_parameter_msg()
    answer = graph.call(SetParameters, f"{node}/set_parameters", SetParameters.Request(parameters=[message]))
    assert not answer.results[0].successful
    assert told in answer.results[0].reason


CHANGES = [
    (CellNode, {"watchdog": True}, "read-only parameter: watchdog"),  # torques would go on past the watchdog
    (CellNode, {"torque_rate_limit": 500.0}, "read-only parameter: torque_rate_limit"),  # the watchdog keeps its own
    (CellNode, {"use_sim_time": True}, "the cell chooses the robot's clock when it starts; start it again"),
    (CellNode, {"start_tolerance": 0.02}, ""),
    (WatchdogNode, {"command_timeout": 0.1}, "read-only parameter: command_timeout"),
    (WatchdogNode, {"scenario": "grab"}, "read-only parameter: scenario"),
    (WatchdogNode, {"diagnostics_period": 2.0}, ""),
]


@pytest.mark.parametrize(("program", "change", "told"), CHANGES)
def test_a_change_that_cannot_act_is_refused_with_the_reason(
    program: type[NodeProgram], change: dict[str, object], told: str, domain_ids: Callable[[], int]
) -> None:
    """Kills: a change that is accepted and has no effect, or, worse, half of its effect."""
    with participant(domain_ids(), program.kind) as node:
        node_parameters.declare(node, program.kind)
        (result,) = node.set_parameters([RclParameter(name, value=wanted) for name, wanted in change.items()])
    assert result.successful == (not told)
    assert told in result.reason


@pytest.mark.parametrize("kind", node_parameters.PARAMETERS)
def test_every_parameter_that_is_read_at_the_start_alone_refuses_a_change_and_the_others_take_one(
    kind: str, domain_ids: Callable[[], int]
) -> None:
    """Kills: a parameter that says read_only and takes a value, or that says nothing and takes none."""
    with participant(domain_ids(), kind) as node:
        node_parameters.declare(node, kind)
        for known in node_parameters.PARAMETERS[kind]:
            (result,) = node.set_parameters([RclParameter(known.name, value=known.default)])
            reason = f"Trying to set a read-only parameter: {known.name}." if known.read_only else ""
            assert (result.successful, result.reason) == (not known.read_only, reason), known.name


def test_former_name_of_an_engine_is_accepted() -> None:
    assert not node_parameters.complaint_about("impact_map", "engine", "pinocchio")


@pytest.mark.parametrize(
    ("node", "argument"),
    [
        (ImpactMapNode, "engine:=foo"),
        (ImpactMapNode, "use_sim_time:=maybe"),
        (ControllerNode, "scenario:=nonsense"),
        (PlantNode, "use_sim_time:=true"),
        (PlantNode, "answer_timeout:=.nan"),
        (CellNode, "joints:=fr3_joint"),
        (RecorderNode, "data_root:=/nowhere/at/all"),
    ],
)
def test_a_node_does_not_start_with_such_a_value(
    node: type[NodeProgram], argument: str, refusal: Callable[[type[NodeProgram], list[str]], str]
) -> None:
    assert argument.partition(":=")[0] in refusal(node, ["--ros-args", "-p", argument])


def test_a_node_does_not_pass_over_words_that_ros_does_not_read(
    refusal: Callable[[type[NodeProgram], list[str]], str],
) -> None:
    """Kills: ``-p scenario:=grab`` without ``--ros-args``, with which the node ran its default."""
    assert "parameter refused: -p: expected --ros-args first" in refusal(PlantNode, ["-p", "scenario:=grab"])


@pytest.fixture
def refusal(
    domain_ids: Callable[[], int], monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> Callable[[type[NodeProgram], list[str]], str]:
    """What a node logs that is started with these words, and refuses them."""

    def refused(node: type[NodeProgram], words: list[str]) -> str:
        monkeypatch.setenv("ROS_DOMAIN_ID", str(domain_ids()))
        monkeypatch.setattr(process.signal, "signal", lambda *_: None)
        monkeypatch.setattr(process.os, "sched_setscheduler", lambda *_: None)
        monkeypatch.setattr(process.sys, "argv", [node.kind, *words])
        with pytest.raises(SystemExit) as ended:
            process.run(node)
        assert ended.value.code == 2
        output = capfd.readouterr().err
        assert "parameter refused: " in output
        return output

    return refused


@pytest.mark.parametrize(
    ("kind", "section", "values", "told"),
    [
        ("cell", "cell", {"torque_rate_limt": 9.0}, r"torque_rate_limt: the cell has no such .* 'torque_rate_limit'"),
        ("cell", "cell", {"torque_rate_limit": 9}, r"torque_rate_limit = 9: expected a number with a point"),
        ("cell", "cell", {"state_timeout": 20.0}, r"state_timeout = 20\.0: expected 0\.001 to 10 s"),
        ("cell", "cell", {"joints": "fr3_joint"}, r"joints 'fr3_joint': expected \{number\} in it"),
        ("watchdog", "cell", {"joints": "a{number}"}, r"no section of the watchdog, expected /\*\*/watchdog"),
    ],
)
def test_a_parameter_file_that_a_node_would_pass_over_is_refused_with_its_key(
    kind: str, section: str, values: dict[str, object], told: str, tmp_path: Path
) -> None:
    file = tmp_path / "cell.yaml"
    file.write_text(yaml.safe_dump({section: {"ros__parameters": values}}))
    with pytest.raises(InputError, match=rf"cell\.yaml: .*{told}"):
        node_parameters.values_of(file, kind)


def test_a_file_for_the_cell_under_its_former_name_is_refused_and_not_passed_over(tmp_path: Path) -> None:
    """Kills: a cell that starts with the defaults, without its watchdog, because ROS knows no node ``plant``."""
    old, new, common = (tmp_path / f"{name}.yaml" for name in ("old", "new", "common"))
    old.write_text("/**/plant: {ros__parameters: {watchdog: true}}")
    new.write_text("/**/plant: {ros__parameters: {}}\n/**/cell: {ros__parameters: {watchdog: true}}")
    common.write_text("/**: {ros__parameters: {scenario: push}}")
    told = r"old\.yaml: plant: the cell is called cell and no longer plant: rename the section"
    with pytest.raises(InputError, match=told):
        node_parameters.refuse_former_sections(["cell", "--ros-args", "--params-file", str(old)], "cell")
    with pytest.raises(InputError, match=told):
        node_parameters.values_of(old, "cell")
    with pytest.raises(InputError, match="__node: the cell is called cell and no longer plant: do not rename it"):
        node_parameters.refuse_former_sections(["cell", "--ros-args", "-r", "__node:=plant"], "cell")
    for file in (new, common):
        node_parameters.refuse_former_sections(["--ros-args", "--params-file", str(file)], "cell")
    node_parameters.refuse_former_sections(["--ros-args", "--params-file", str(old)], "plant")


def test_values_of_a_file_are_those_that_the_node_has(tmp_path: Path) -> None:
    """Kills an order by length: ROS applies the sections in the order of the file, and the last one wins."""
    file = tmp_path / "cell.yaml"
    sections = {
        1: {"ros__parameters": {}},
        "/**/cell": {"ros__parameters": {"state_timeout": 0.02, "joints": "a{number}", "use_sim_time": True}},
        "/**": {"ros__parameters": {"state_timeout": 0.03, "scenario": "grab", "of_another_node": 1}},
        "/lab/**": {"ros__parameters": {"state_timeout": 0.04}},
        "other": {"ros__parameters": {"scenario": "nonsense"}},
    }
    file.write_text(yaml.safe_dump(sections, sort_keys=False))
    wanted = {"state_timeout": 0.03, "joints": "a{number}", "scenario": "grab"}
    assert node_parameters.values_of(file, "cell") == node_parameters.defaults_of("cell") | wanted


@pytest.mark.parametrize("content", ["/lab/cell: {ros__parameters: {}}", "lab: {cell: {ros__parameters: {}}}"])
def test_a_section_of_a_cell_in_a_namespace_is_refused(content: str, tmp_path: Path) -> None:
    """Kills a rehearsal with the parameters of another cell, its gravity convention among them."""
    file = tmp_path / "cell.yaml"
    file.write_text(content + "\n/**: {ros__parameters: {state_timeout: 0.02}}")
    with pytest.raises(InputError, match=r"/lab/cell: of a cell in a namespace: expected /\*\*/cell"):
        node_parameters.values_of(file, "cell")
