# SPDX-License-Identifier: Apache-2.0
"""Parameters of the nodes: each is declared here and nowhere else.

``ros2 param describe``, ``config/nodes.yaml`` and ``docs/parameters.md`` all follow from this list; the last is printed
by ``python -m impact_rs_ros.parameters``.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from impact_rs_sim.errors import InputError
from impact_rs_sim.impact_map import CONTACTS, DEFAULT_ENGINE, ENGINES, FORMER_NAMES
from impact_rs_sim.scenario import load_scenario

Value = bool | float | str
FULL_TURN = 6.283185  # rad


@dataclass(frozen=True)
class NodeParameter:
    """One parameter of a node.

    Attributes:
        name: Name.
        default: Default value; decides the type.
        unit: Unit, ``-`` where it has none.
        description: What it does, in a sentence.
        range: Least and greatest value; floats only.
        choices: Values there are; empty: any.
        former: Values of older versions, which are accepted as well.
    """

    name: str
    default: Value
    unit: str
    description: str
    range: tuple[float, float] | None = None
    choices: tuple[str, ...] = ()
    former: tuple[str, ...] = ()

    @property
    def expected(self) -> str:
        """Which values there are, in words; empty: any, or those of the range."""
        return f"one of {', '.join(self.choices)}" if self.choices else ""

    def descriptor(self) -> ParameterDescriptor:
        """What ``ros2 param describe`` tells."""
        limits = [] if self.range is None else [FloatingPointRange(from_value=self.range[0], to_value=self.range[1])]
        return ParameterDescriptor(
            description=f"{self.description} [{self.unit}]",
            additional_constraints="; ".join(filter(None, (f"unit: {self.unit}", self.expected))),
            floating_point_range=limits,
        )


COMMON = (
    NodeParameter("scenario", "push", "-", "Scenario, by name or path, where a request names none"),
    NodeParameter(
        "config_root",
        "",
        "-",
        "Requests may name scenarios of this folder by path, beside those that are shipped; empty: working directory",
    ),
    NodeParameter("diagnostics_period", 1.0, "s", "Wall-clock time between two messages on /diagnostics", (0.1, 60.0)),
)

DATA_ROOT = NodeParameter(
    "data_root", "", "-", "Requests may have bags written below this folder alone; empty: working directory"
)

ROBOT = (
    NodeParameter(
        "joints",
        "{arm}_joint{number}",
        "-",
        "What the robot calls its joints: {arm} is the name of the arm in the scenario, {number} counts from 1",
    ),
    NodeParameter(
        "robot_adds_gravity",
        True,
        "-",
        "The robot compensates gravity itself (franka_ros2) and is sent torques without it",
    ),
    NodeParameter(
        "state_timeout",
        0.01,
        "s",
        "A state of the robot that is older, or does not come for so long, ends the trial",
        (0.001, 10.0),
    ),
    NodeParameter(
        "torque_rate_limit",
        1000.0,
        "N m/s or N/s",
        "What the robot is sent changes no faster; a torque that would is told to it over several periods",
        (1.0, 1e6),
    ),
)

PARAMETERS: dict[str, tuple[NodeParameter, ...]] = {
    "plant": (
        *COMMON,
        NodeParameter(
            "realtime",
            False,
            "-",
            "Pace the ticks by the wall clock; a torque that is late counts as missed tick, the last one is held, and"
            " the late one acts from the next tick on. Otherwise the plant waits for the torque of every tick",
        ),
        # Torques that are a tick late in 5 % of the ticks move the net feedback of a push by up to 1.2 mm/s, in runs of
        # ten ticks by 4 mm/s; in 50 % by 3.9 and 14 mm/s.
        NodeParameter(
            "missed_ticks_limit",
            0.05,
            "-",
            "Share of the ticks that may be missed in real time; a trial with more is ABORTED",
            (0.0, 1.0),
        ),
        NodeParameter(
            "repeat_after",
            0.25,
            "s",
            "Without an answer for so long, the measured state of the tick is sent again",
            (0.01, 10.0),
        ),
        NodeParameter("answer_timeout", 1.5, "s", "Without an answer for so long, the trial is aborted", (0.1, 600.0)),
    ),
    "impact_map": (
        *COMMON,
        NodeParameter(
            "engine",
            DEFAULT_ENGINE,
            "-",
            "Engine where a request names none",
            choices=tuple(ENGINES),
            former=tuple(FORMER_NAMES),
        ),
        NodeParameter("contact", "first", "-", "Contact where a request names none", choices=tuple(CONTACTS)),
    ),
    "controller": COMMON,
    "cell": (
        *COMMON,
        *ROBOT,
        NodeParameter("watchdog", False, "-", "No trial is armed, and none goes on, without the node watchdog"),
        NodeParameter(
            "mocap", False, "-", "Pass poses of the object on from motion capture; without them no trial is armed then"
        ),
        NodeParameter(
            "mocap_frame", "world", "-", "What motion capture calls its frame (frame_id); poses in another are refused"
        ),
        *(
            NodeParameter(
                f"mocap_{axis}", 0.0, "m", f"Where the origin of that frame is in world, along {axis}", (-100.0, 100.0)
            )
            for axis in "xyz"
        ),
        *(
            NodeParameter(
                f"mocap_{name}",
                0.0,
                "rad",
                f"How that frame is turned in world, about fixed {axis}; roll, then pitch, then yaw (REP-103)",
                (-FULL_TURN, FULL_TURN),
            )
            for name, axis in (("roll", "x"), ("pitch", "y"), ("yaw", "z"))
        ),
        NodeParameter(
            "answer_timeout",
            0.01,
            "s",
            "A torque of the controller that takes longer ends the trial",
            (0.001, 10.0),
        ),
        NodeParameter(
            "late_torque_share",
            0.2,
            "-",
            "A larger share of the last 100 ticks whose torque came after the next state, or never, ends the trial",
            (0.0, 1.0),
        ),
        NodeParameter(
            "arm_jitter_limit",
            0.002,
            "s",
            "No trial is armed where the time between two states of the robot differs more from that of their stamps",
            (1e-6, 10.0),
        ),
        NodeParameter(
            "start_tolerance",
            0.01,
            "rad or m",
            "No trial is armed, and none begins, with a joint farther from where it starts",
            (1e-4, 0.2),
        ),
    ),
    "watchdog": (
        *COMMON,
        *ROBOT,
        NodeParameter(
            "command_timeout", 0.05, "s", "Arms that move without a command for so long are braked", (0.01, 10.0)
        ),
    ),
    "recorder": (
        *COMMON,
        DATA_ROOT,
        NodeParameter("drain_period", 0.01, "s", "How often what was received is written to the bag", (0.001, 0.1)),
        NodeParameter(
            "completion_timeout",
            2.0,
            "s",
            "How long the recorder waits at the end of a trial for messages that were published",
            (0.1, 60.0),
        ),
    ),
    "experiment": (
        *COMMON,
        DATA_ROOT,
        NodeParameter(
            "service_timeout", 10.0, "s", "How long plant, controller and recorder may take to get ready", (0.5, 600.0)
        ),
        NodeParameter(
            "progress_timeout", 2.5, "s", "Without a sign of life for so long, a running trial is aborted", (0.5, 600.0)
        ),
        NodeParameter(
            "finish_timeout",
            3.5,
            "s",
            "How long the recorder may take to close a bag: its completion_timeout, and the time to write",
            (0.5, 600.0),
        ),
        NodeParameter(
            "hide_model",
            True,
            "-",
            "Keep the effects that a trial hides in the plant out of /trial_info and the bag's metadata; they are only"
            " recorded on /truth/model",
        ),
        NodeParameter("feedback_period", 0.05, "s", "Wall-clock time between two action feedbacks", (0.01, 10.0)),
    ),
}


def declare(node: Node, kind: str) -> None:
    """Declare the parameters of a node, which refuses values that it cannot work with.

    Args:
        node: The node.
        kind: Which of the five it is; its name may have been remapped.

    Raises:
        InputError: It was started with such a value.
    """
    for parameter in PARAMETERS[kind]:
        node.declare_parameter(parameter.name, parameter.default, parameter.descriptor())

    def check(changed: list[Parameter]) -> SetParametersResult:
        wrong = [complaint for one in changed if (complaint := complaint_about(kind, one.name, one.value))]
        return SetParametersResult(successful=not wrong, reason="; ".join(wrong))

    for name in (*(parameter.name for parameter in PARAMETERS[kind]), "use_sim_time"):
        if complaint := complaint_about(kind, name, value(node, name)):
            raise InputError(complaint)
    node.add_on_set_parameters_callback(check)


def complaint_about(kind: str, name: str, wanted: Any) -> str:
    """Why a node cannot take a value for a parameter; empty: it can.

    Args:
        kind: Which of the five nodes.
        name: The parameter.
        wanted: Its value.
    """
    if name == "use_sim_time":
        return "use_sim_time: the plant is what /clock comes from" if kind == "plant" and wanted else ""
    known = next((parameter for parameter in PARAMETERS[kind] if parameter.name == name), None)
    if known is None:
        return ""
    if name == "joints" and "{number}" not in wanted:
        return f"joints {wanted!r}: expected {{number}} in it"
    if known.choices and wanted not in (*known.choices, *known.former):
        return f"{name} {wanted!r}: expected {' or '.join(known.choices)}"
    if name in ("config_root", "data_root") and not Path(wanted or ".").is_dir():
        return f"{name} {wanted!r}: expected a folder that exists"
    if name == "scenario":
        try:
            load_scenario(wanted)
        except InputError as error:
            return f"scenario: {error}"
    return ""


def value(node: Node, name: str) -> Any:
    """Present value of a parameter."""
    return node.get_parameter(name).value


def text(node: Node, kind: str) -> str:
    """Present values of all parameters of a node with their units, for its log."""
    values = ((parameter, value(node, parameter.name)) for parameter in PARAMETERS[kind])
    return ", ".join(f"{p.name} {v}" + ("" if p.unit == "-" else f" {p.unit}") for p, v in values if v != "")


def markdown() -> str:
    """``docs/parameters.md``."""
    lines = [
        "# Node parameters",
        "",
        "Made from `impact_rs_ros/parameters.py` by `python -m impact_rs_ros.parameters > docs/parameters.md`.",
        "`config/nodes.yaml` is an example of all of them, `config/cell.yaml` of the cell (a node called `plant`);",
        "a running node describes its own with `ros2 param describe /plant realtime`.",
    ]
    for kind, parameters in PARAMETERS.items():
        lines += ["", f"## {kind}", "", "| Name | Type | Default | Range | Unit | Meaning |", "|---" * 6 + "|"]
        for p in parameters:
            default = str(p.default).lower() if isinstance(p.default, bool) else str(p.default)
            limits = ", ".join(p.choices) if p.range is None else f"{p.range[0]:g} to {p.range[1]:g}"
            lines.append(
                f"| `{p.name}` | {type(p.default).__name__} | `{default}` | {limits} | {p.unit} | {p.description}. |"
            )
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    print(markdown(), end="")
