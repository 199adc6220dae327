# SPDX-License-Identifier: Apache-2.0
"""Parameters of the nodes: each is declared here and nowhere else.

``ros2 param describe``, ``config/nodes.yaml`` and ``docs/parameters.md`` follow from this list; the last is printed by
``python -m impact_rs_ros.node_parameters``.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from impact_rs_sim.errors import InputError, did_you_mean
from impact_rs_sim.impact_map import CONTACTS, DEFAULT_ENGINE, ENGINES, FORMER_NAMES
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_sim.schema import load_mapping
from impact_rs_trials.cell.driver_profiles import DriverProfile

Value = bool | float | str
Effect = Literal["at once", "next trial", "node start"]
FULL_TURN_RAD = 6.283185


@dataclass(frozen=True)
class NodeParameter:
    """One parameter of a node.

    Attributes:
        name: Name.
        default: Default value; decides the type.
        description: Description in a sentence.
        unit: Unit, ``-`` if dimensionless.
        range: Least and greatest value; floats only.
        choices: Allowed values; empty: any.
        former: Also accepted values of older versions.
        effect: When a change acts; ``node start``: the parameter is read only.
    """

    name: str
    default: Value
    description: str
    unit: str = "-"
    range: tuple[float, float] | None = None
    choices: tuple[str, ...] = ()
    former: tuple[str, ...] = ()
    effect: Effect = "at once"

    @property
    def read_only(self) -> bool:
        """Whether a running node refuses another value: it reads the parameter only when it starts."""
        return self.effect == "node start"

    @property
    def expected(self) -> str:
        """Allowed values, as text; empty: any, or the range."""
        return f"one of {', '.join(self.choices)}" if self.choices else ""

    def descriptor(self) -> ParameterDescriptor:
        """Descriptor that ``ros2 param describe`` shows."""
        limits = [] if self.range is None else [FloatingPointRange(from_value=self.range[0], to_value=self.range[1])]
        constraints = (f"unit: {self.unit}", self.expected, f"a change acts: {self.effect}")
        return ParameterDescriptor(
            description=f"{self.description} [{self.unit}]",
            additional_constraints="; ".join(filter(None, constraints)),
            read_only=self.read_only,
            floating_point_range=limits,
        )


def with_effect(effect: Effect, *parameters: NodeParameter) -> tuple[NodeParameter, ...]:
    """Parameters whose changes act at this time."""
    return tuple(replace(parameter, effect=effect) for parameter in parameters)


SCENARIO, *OTHERS = COMMON = (
    NodeParameter("scenario", "push", "Scenario (name or path) of requests that name none"),
    NodeParameter(
        "config_root",
        "",
        "Folder of scenarios that requests may name by path; empty: working directory",
    ),
    NodeParameter("diagnostics_period", 1.0, "Wall-clock period of /diagnostics", "s", (0.1, 60.0)),
)

AUTOSTART = NodeParameter(
    "autostart",
    True,
    "true: the node configures and activates itself; false: it waits for these transitions",
    effect="node start",
)

DATA_ROOT = NodeParameter("data_root", "", "Folder below which requests may write bags; empty: working directory")

STATE_TIMEOUT = NodeParameter(
    "state_timeout",
    0.01,
    "Largest age of a robot state, and longest time without one; beyond it the trial is ABORTED",
    "s",
    (0.001, 10.0),
    effect="next trial",
)

# Cell and watchdog must agree on these for as long as they run.
ROBOT = with_effect(
    "node start",
    NodeParameter(
        "joints",
        "{arm}_joint{number}",
        "Joint names: {arm} is the arm's name in the scenario, {number} starts at 1; or all names, base to tip, with "
        "commas",
    ),
    NodeParameter(
        "robot_adds_gravity",
        True,
        "true: the robot compensates gravity itself (franka_ros2); commanded torques do not contain it",
    ),
    NodeParameter(
        "torque_rate_limit",
        1000.0,
        "Largest rate of change of the commanded torque; a larger step is spread over time",
        "N m/s or N/s",
        (1.0, 1e6),
    ),
)

PARAMETERS: dict[str, tuple[NodeParameter, ...]] = {
    "plant": (
        *COMMON,
        AUTOSTART,
        *with_effect(
            "next trial",
            NodeParameter(
                "realtime",
                False,
                "true: ticks follow the wall clock; at a missed tick the last torque is held, and the late one acts "
                "from the next tick on. false: the plant waits for every torque",
            ),
            # Torques one tick late change the net feedback of a push by up to 1.2 mm/s if late in 5 % of the ticks, one
            # at a time, and by 4 mm/s in runs of ten ticks; if late in 50 % of the ticks, by 3.9 mm/s and 14 mm/s.
            NodeParameter(
                "missed_ticks_limit",
                0.05,
                "Largest share of missed ticks in real time; beyond it the trial is ABORTED",
                range=(0.0, 1.0),
            ),
            NodeParameter(
                "repeat_after",
                0.25,
                "Time without an answer after which the state is published again",
                "s",
                (0.01, 10.0),
            ),
            NodeParameter(
                "answer_timeout", 1.5, "Time without an answer after which the trial is ABORTED", "s", (0.1, 600.0)
            ),
            NodeParameter(
                "link_transforms",
                True,
                "true: the plant publishes the links on /tf; false: robot_state_publisher does",
            ),
        ),
    ),
    "impact_map": (
        *COMMON,
        NodeParameter(
            "engine",
            DEFAULT_ENGINE,
            "Engine for requests that name none",
            choices=tuple(ENGINES),
            former=tuple(FORMER_NAMES),
        ),
        NodeParameter("contact", "first", "Contact for requests that name none", choices=tuple(CONTACTS)),
    ),
    "controller": (*COMMON, AUTOSTART),
    "cell": (
        *COMMON,
        AUTOSTART,
        *ROBOT,
        STATE_TIMEOUT,
        NodeParameter(
            "watchdog",
            False,
            "true: torques go through the watchdog; a trial is armed and continues only while it passes them on",
            effect="node start",
        ),
        NodeParameter(
            "watchdog_timeout",
            0.1,
            "Time without a torque from the watchdog after which the trial is ABORTED and the cell brakes the arms "
            "itself; twice its command_timeout",
            "s",
            (0.01, 10.0),
        ),
        NodeParameter(
            "mocap",
            False,
            "true: publish poses of the object from motion capture; without them no trial is armed",
            effect="node start",
        ),
        *with_effect(
            "next trial",
            NodeParameter(
                "mocap_frame",
                "world",
                "Motion-capture frame (frame_id); poses in another frame are refused",
            ),
            *(
                NodeParameter(
                    f"mocap_{axis}",
                    0.0,
                    f"Origin of mocap_frame in world, along {axis}",
                    "m",
                    (-100.0, 100.0),
                )
                for axis in "xyz"
            ),
            *(
                NodeParameter(
                    f"mocap_{name}",
                    0.0,
                    f"Rotation of mocap_frame in world about the fixed {axis} axis; order: roll, pitch, yaw (REP-103)",
                    "rad",
                    (-FULL_TURN_RAD, FULL_TURN_RAD),
                )
                for name, axis in (("roll", "x"), ("pitch", "y"), ("yaw", "z"))
            ),
            NodeParameter(
                "answer_timeout",
                0.01,
                "Longest time until the controller answers a state; beyond it the trial is ABORTED",
                "s",
                (0.001, 10.0),
            ),
            NodeParameter(
                "start_delay",
                1.0,
                "Time from the controller's first state to the start of the trial, within which it has to answer",
                "s",
                (0.05, 10.0),
            ),
            NodeParameter(
                "late_torque_share",
                0.2,
                "Largest share of the last 100 ticks without a torque before the next state; above it the trial is "
                "ABORTED",
                range=(0.0, 1.0),
            ),
            NodeParameter(
                "arm_jitter_limit",
                0.002,
                "Largest difference of the intervals of two states by arrival and by timestamp; above it no trial is "
                "armed",
                "s",
                (1e-6, 10.0),
            ),
            NodeParameter(
                "start_tolerance",
                0.01,
                "Largest distance of a joint from its initial position; above it no trial is armed or begins",
                "rad or m",
                (1e-4, 0.2),
            ),
        ),
    ),
    "watchdog": (
        *with_effect("node start", SCENARIO),
        *OTHERS,
        *ROBOT,
        *with_effect("node start", STATE_TIMEOUT),
        NodeParameter(
            "command_timeout",
            0.05,
            "Time without a command after which moving arms are braked",
            "s",
            (0.01, 10.0),
            effect="node start",
        ),
    ),
    "recorder": (
        *COMMON,
        AUTOSTART,
        DATA_ROOT,
        NodeParameter("drain_period", 0.01, "Period of writing to the bag", "s", (0.001, 0.1)),
        NodeParameter(
            "completion_timeout",
            2.0,
            "Longest wait for published messages at the end of a trial",
            "s",
            (0.1, 60.0),
        ),
    ),
    "identify": (
        *COMMON,
        *with_effect(
            "node start",
            NodeParameter("runs", "", "Folder of finished trials; empty: impacts names a table"),
            NodeParameter("impacts", "", "Table of impacts; empty: runs names a folder"),
            NodeParameter("impacts_scenario", "", "Scenario of the arms in that table; empty: free bodies"),
            NodeParameter("model", "nominal", "Name or path of the model"),
            NodeParameter("state", "", "State file from which a restarted node goes on; empty: none"),
            NodeParameter(
                "diagnose",
                True,
                "Whether a change starts a full diagnosis of the impacts since then",
            ),
            NodeParameter(
                "diagnoses", "", "Folder for these diagnoses; empty: the state file's, or the working directory"
            ),
        ),
        NodeParameter("poll_period", 0.5, "Time between two looks for finished trials", "s", (0.05, 60.0)),
    ),
    "experiment": (
        *COMMON,
        DATA_ROOT,
        NodeParameter(
            "service_timeout",
            10.0,
            "Longest time for nodes to prepare a trial",
            "s",
            (0.5, 600.0),
        ),
        NodeParameter(
            "progress_timeout",
            2.5,
            "Time without a newer controller state after which a trial is ABORTED",
            "s",
            (0.5, 600.0),
        ),
        NodeParameter(
            "finish_timeout",
            3.5,
            "Longest time to close a bag: completion_timeout plus the time to write",
            "s",
            (0.5, 600.0),
        ),
        NodeParameter(
            "hide_model",
            True,
            "true: hidden effects are recorded on /truth/model only",
        ),
        NodeParameter("feedback_period", 0.05, "Wall-clock period of action feedback", "s", (0.01, 10.0)),
    ),
}


def declare(node: Node, kind: str) -> None:
    """Declare the parameters of a node; invalid values, and changes that cannot act, are refused with the reason.

    Args:
        node: The node.
        kind: Its key in ``PARAMETERS``; its name may have been remapped.

    Raises:
        InputError: The node was started with an invalid value.
    """
    for parameter in PARAMETERS[kind]:
        node.declare_parameter(parameter.name, parameter.default, parameter.descriptor())

    def check(changed: list[Parameter]) -> SetParametersResult:
        complaints = [
            complaint
            for parameter_change in changed
            if (complaint := complaint_about(kind, parameter_change.name, parameter_change.value))
        ]
        if kind in ("cell", "watchdog") and any(
            parameter_change.name == "use_sim_time" and parameter_change.value != value(node, parameter_change.name)
            for parameter_change in changed
        ):
            complaints.append(f"use_sim_time: the {kind} chooses the robot's clock when it starts; start it again")
        return SetParametersResult(successful=not complaints, reason="; ".join(complaints))

    for name in (*(parameter.name for parameter in PARAMETERS[kind]), "use_sim_time"):
        if complaint := complaint_about(kind, name, value(node, name)):
            raise InputError(complaint)
    node.add_on_set_parameters_callback(check)


def complaint_about(kind: str, name: str, new_value: Any) -> str:
    """Why a value of a parameter is invalid; empty: it is valid.

    Args:
        kind: Node, a key of ``PARAMETERS``.
        name: Name of the parameter.
        new_value: Value of the parameter.
    """
    if name == "use_sim_time":
        return (
            "use_sim_time: expected false, because the plant publishes /clock" if kind == "plant" and new_value else ""
        )
    declared = next((parameter for parameter in PARAMETERS[kind] if parameter.name == name), None)
    if declared is None:
        return ""
    if name == "joints" and "{number}" not in new_value and "," not in new_value:
        return f"joints {new_value!r}: expected {{number}} in it, or all names with commas between them"
    if declared.choices and new_value not in (*declared.choices, *declared.former):
        return f"{name} {new_value!r}: expected {' or '.join(declared.choices)}"
    if name in ("config_root", "data_root") and not Path(new_value or ".").is_dir():
        return f"{name} {new_value!r}: expected a folder that exists"
    if name == "scenario":
        try:
            load_scenario(new_value)
        except InputError as error:
            return f"scenario: {error}"
    return ""


def defaults_of(kind: str) -> dict[str, Any]:
    """Default values of all parameters of a node, by name."""
    return {parameter.name: parameter.default for parameter in PARAMETERS[kind]}


def values_for(profile: DriverProfile, arms: Collection[str]) -> dict[str, dict[str, Any]]:
    """Parameters of cell and watchdog for a driver: defaults, with its names, gravity convention and torque rate.

    Args:
        profile: The driver.
        arms: Names of the arms.
    """
    robot_values = {
        "joints": profile.joints_of(arms),
        "robot_adds_gravity": profile.adds_gravity,
        "torque_rate_limit": profile.torque_rate,
    }
    return {
        "cell": defaults_of("cell") | robot_values | {"watchdog": True},
        "watchdog": defaults_of("watchdog") | robot_values,
    }


FORMER_SECTIONS = {"cell": "plant"}  # names of nodes up to version 0.2, by present name


def values_of(path: Path, kind: str) -> dict[str, Any]:
    """Values of all parameters that a node has when it is started with ``--params-file``.

    All sections that match the name of the node, ``/KIND``, apply in the order of the file, as in ROS. The node itself
    passes over a parameter that it does not know; here it is a mistake.

    Args:
        path: File in the format of ROS 2; sections of other nodes are theirs.
        kind: Node, a key of ``PARAMETERS``.

    Raises:
        InputError: The file cannot be read, has no section of the node, one of this node in a namespace, or one with an
            unknown name or a value that the node refuses.
    """
    declared = {parameter.name: parameter for parameter in PARAMETERS[kind]}
    values, content = defaults_of(kind), load_mapping(path)
    _refuse_former_section(path, kind, content)
    sections = [
        (section, section_values) for section, section_values in _sections(content) if _applies(section, kind, path)
    ]
    if not any(section_values for _, section_values in sections):
        raise InputError(f"no section of the {kind}, expected /**/{kind} with ros__parameters in it", file=path)
    for section, section_values in sections:
        for key, new_value in section_values.items():
            key_path = f"{section}.{key}"
            if key in declared:
                _check(declared[key], kind, new_value, path, key_path)
                values[key] = new_value
            elif _node_of(section) == kind and key != "use_sim_time":
                hint = did_you_mean(str(key), declared) or f"; known: {', '.join(declared)}"
                raise InputError(f"the {kind} has no such parameter{hint}", file=path, key=key_path)
    return values


def refuse_former_sections(arguments: Sequence[str], kind: str) -> None:
    """Refuse a node's former name, in a parameter file or on its command line.

    ROS passes over a section of another node, and takes the defaults: a cell would run without its watchdog.

    Args:
        arguments: Command line of the node.
        kind: Node, a key of ``PARAMETERS``.

    Raises:
        InputError: The former name is in use, or a file cannot be read.
    """
    if (former := FORMER_SECTIONS.get(kind)) is None:
        return
    if f"__node:={former}" in arguments:
        raise InputError(f"the {kind} is called {kind} and no longer {former}: do not rename it", key="__node")
    for option, file in pairwise(arguments):
        if option == "--params-file":
            _refuse_former_section(Path(file), kind, load_mapping(Path(file)))


def _refuse_former_section(path: Path, kind: str, content: Mapping[str, Any]) -> None:
    names, former = {_node_of(section) for section, _ in _sections(content)}, FORMER_SECTIONS.get(kind)
    if former in names and kind not in names:
        raise InputError(
            f"the {kind} is called {kind} and no longer {former}: rename the section", file=path, key=former
        )


def _sections(content: Mapping[Any, Any], namespace: str = "") -> Iterator[tuple[str, dict[str, Any]]]:
    """Names or patterns of nodes in a parameter file, and their values."""
    for name, subsections in content.items():
        section = f"{namespace}/{str(name).strip('/')}"
        if name == "ros__parameters" or not isinstance(subsections, dict):
            continue
        if isinstance(section_values := subsections.get("ros__parameters"), dict):
            yield section, section_values
        yield from _sections(subsections, section)


def _node_of(section: str) -> str:
    return section.rpartition("/")[2]


def _applies(section: str, kind: str, path: Path) -> bool:
    """Whether a section is of the node ``/KIND``; ``/*`` stands for one name and ``/**`` for any number of them."""
    pattern = re.escape(section).replace(r"/\*\*", r"(/\w+)*").replace(r"/\*", r"/\w+")
    matches = re.fullmatch(pattern, f"/{kind}") is not None
    if not matches and _node_of(section) == kind:
        raise InputError(
            f"of a {kind} in a namespace: expected /**/{kind}, which is the {kind} in every namespace",
            file=path,
            key=section,
        )
    return matches


def _check(parameter: NodeParameter, kind: str, new_value: Any, path: Path, key_path: str) -> None:
    """Refuse a value of the wrong type, out of range, or that the node refuses."""
    expected = {bool: "true or false", float: "a number with a point", str: "a text"}[type(parameter.default)]
    limits = parameter.range
    if type(new_value) is not type(parameter.default):
        raise InputError(
            f"expected {expected}: {parameter.description} [{parameter.unit}]", file=path, key=key_path, value=new_value
        )
    if limits is not None and not limits[0] <= float(new_value) <= limits[1]:
        raise InputError(
            f"expected {limits[0]:g} to {limits[1]:g} {parameter.unit}", file=path, key=key_path, value=new_value
        )
    if complaint := complaint_about(kind, parameter.name, new_value):
        raise InputError(complaint, file=path)


def value(node: Node, name: str) -> Any:
    """Present value of a parameter."""
    return node.get_parameter(name).value


def text(node: Node, kind: str) -> str:
    """Present values of all parameters of a node with their units, for its log."""
    values = ((parameter, value(node, parameter.name)) for parameter in PARAMETERS[kind])
    return ", ".join(f"{p.name} {v}" + ("" if p.unit == "-" else f" {p.unit}") for p, v in values if v != "")


def markdown() -> str:
    """Text of ``docs/parameters.md``: common parameters once, then the parameters of each node."""
    lines = [
        "# Node parameters",
        "",
        "*Look up.* `config/nodes.yaml` lists every default, `config/cell.yaml` the defaults of cell and watchdog.",
        "`ros2 param describe /plant realtime` describes a parameter of a running node. A change (`ros2 param set`)",
        "acts at once (on the next request) or from the next trial on; `read_only`: the node reads it when it starts.",
    ]
    first, *further_nodes = PARAMETERS.values()
    common = [
        parameter
        for parameter in first
        if all(parameter.name in {p.name for p in parameters} for parameters in further_nodes)
    ]
    owners = {
        (parameter.name, parameter.description): kind
        for kind, parameters in reversed(PARAMETERS.items())
        for parameter in parameters
    }
    specific = {
        kind: [parameter for parameter in parameters if parameter not in common]
        for kind, parameters in PARAMETERS.items()
    }
    for kind, parameters in {"every node": common, **specific}.items():
        if parameters:
            lines += ["", f"## {kind}", "", "| Name | Value | Default | A change acts | Meaning |", "|---" * 5 + "|"]
        for p in parameters:
            default = str(p.default).lower() if isinstance(p.default, bool) else str(p.default)
            limits = ", ".join(p.choices) if p.range is None else f"{p.range[0]:g} to {p.range[1]:g}"
            unit = "" if p.unit == "-" else f"[{p.unit}]"
            value = " ".join(filter(None, (limits or type(p.default).__name__, unit)))
            effect = "`read_only`" if p.read_only else p.effect
            default = f"`{default}`" if default else ""
            meaning = (
                p.description
                if owners[p.name, p.description] == kind or p in common
                else f"As of {owners[p.name, p.description]}"
            )
            lines.append(f"| `{p.name}` | {value} | {default} | {effect} | {meaning}. |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    print(markdown(), end="")
