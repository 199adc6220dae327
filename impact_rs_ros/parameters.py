"""Parameters of the nodes: each is declared here and nowhere else.

``ros2 param describe``, ``config/nodes.yaml`` and ``docs/parameters.md`` all follow from this list; the last is printed
by ``python -m impact_rs_ros.parameters``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor
from rclpy.node import Node

Value = bool | float | str


@dataclass(frozen=True)
class NodeParameter:
    """One parameter of a node.

    Attributes:
        name: Name.
        default: Default value; decides the type.
        unit: Unit, ``-`` where it has none.
        description: What it does, in a sentence.
        range: Least and greatest value; floats only.
    """

    name: str
    default: Value
    unit: str
    description: str
    range: tuple[float, float] | None = None

    def descriptor(self) -> ParameterDescriptor:
        """What ``ros2 param describe`` tells."""
        limits = [] if self.range is None else [FloatingPointRange(from_value=self.range[0], to_value=self.range[1])]
        return ParameterDescriptor(
            description=f"{self.description} [{self.unit}]",
            additional_constraints=f"unit: {self.unit}",
            floating_point_range=limits,
        )


COMMON = (
    NodeParameter("scenario", "push", "-", "Scenario, by name or path, where a request names none"),
    NodeParameter("diagnostics_period", 1.0, "s", "Wall-clock time between two messages on /diagnostics", (0.1, 60.0)),
)

PARAMETERS: dict[str, tuple[NodeParameter, ...]] = {
    "plant": (
        *COMMON,
        NodeParameter(
            "realtime",
            False,
            "-",
            "Pace the ticks by the wall clock; a torque that is late counts as missed tick and the last one is held."
            " Otherwise the plant waits for the torque of every tick",
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
        NodeParameter("engine", "bullet", "-", "Engine where a request names none: bullet or pinocchio"),
        NodeParameter("contact", "first", "-", "Contact where a request names none: first or settled"),
    ),
    "controller": COMMON,
    "recorder": (
        *COMMON,
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
        NodeParameter(
            "service_timeout", 10.0, "s", "How long plant, controller and recorder may take to get ready", (0.5, 600.0)
        ),
        NodeParameter(
            "progress_timeout", 4.0, "s", "Without a sign of life for so long, a running trial is aborted", (0.5, 600.0)
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
    """Declare the parameters of a node.

    Args:
        node: The node.
        kind: Which of the five it is; its name may have been remapped.
    """
    for parameter in PARAMETERS[kind]:
        node.declare_parameter(parameter.name, parameter.default, parameter.descriptor())


def value(node: Node, name: str) -> Any:
    """Present value of a parameter."""
    return node.get_parameter(name).value


def text(node: Node, kind: str) -> str:
    """Present values of all parameters of a node with their units, for its log."""
    values = ((parameter, value(node, parameter.name)) for parameter in PARAMETERS[kind])
    return ", ".join(f"{p.name} {v}" + ("" if p.unit == "-" else f" {p.unit}") for p, v in values)


def markdown() -> str:
    """``docs/parameters.md``."""
    lines = [
        "# Node parameters",
        "",
        "Made from `impact_rs_ros/parameters.py` by `python -m impact_rs_ros.parameters > docs/parameters.md`.",
        "`config/nodes.yaml` is an example of all of them; a running node describes its own with",
        "`ros2 param describe /plant realtime`.",
    ]
    for kind, parameters in PARAMETERS.items():
        lines += ["", f"## {kind}", "", "| Name | Type | Default | Range | Unit | Meaning |", "|---" * 6 + "|"]
        for p in parameters:
            default = str(p.default).lower() if isinstance(p.default, bool) else str(p.default)
            limits = "" if p.range is None else f"{p.range[0]:g} to {p.range[1]:g}"
            lines.append(
                f"| `{p.name}` | {type(p.default).__name__} | `{default}` | {limits} | {p.unit} | {p.description}. |"
            )
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    print(markdown(), end="")
