# SPDX-License-Identifier: Apache-2.0
"""Uncertain numbers of a scenario's robots and support: values by name, and the scenario with other values.

With several arms the name of an arm stands in front, ``left.tool_mass``.

=====================  ====  =======================================================================
name                   unit  what it is
=====================  ====  =======================================================================
``tool_mass``          kg    mass of the end effector; its moments grow with it
``tool_length``        m     distance from the flange to the pad's outer face; its centre of mass stays in frame E
``pad_x``, ``pad_y``   m     width and height of the pad
``jointN_x`` ...       m     offset of the origin of joint N along the axes of the link before; the facts have 0
``flange_x`` ...       m     offset of the flange along the axes of the last link; the facts have 0
``support_friction``   -     Coulomb coefficient of object and support
``size_x`` ...         m     extent of the object along its own axes, where the scenario has one object, a box
=====================  ====  =======================================================================
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from typing import Any

from impact_rs_sim.impact_map.measured import SUPPORT_FRICTION
from impact_rs_sim.rotations import AXES
from impact_rs_sim.scenarios.robot_spec import Robot
from impact_rs_sim.scenarios.scenario import Scenario

_TOOL_UNITS: dict[str, str] = {"tool_mass": "kg", "tool_length": "m", "pad_x": "m", "pad_y": "m"}
_OFFSET = re.compile(r"(?:joint(?P<joint>[0-9]+)|flange)_(?P<axis>[xyz])")


def nominal_values(scenario: Scenario) -> dict[str, tuple[float, str]]:
    """Nominal values of all uncertain numbers of a scenario, with units, by name."""
    nominal: dict[str, tuple[float, str]] = {SUPPORT_FRICTION: (scenario.support.friction, "-")}
    if len(scenario.objects) == 1:
        (body,) = scenario.objects.values()
        if body.form.is_box:
            nominal |= {f"size_{axis}": (float(extent), "m") for axis, extent in zip(AXES, body.size, strict=True)}
    for label, robot in _arms(scenario):
        tool = robot.end_effector
        values = {"tool_mass": tool.mass, "tool_length": tool.length, "pad_x": tool.pad.size[0]}
        values["pad_y"] = tool.pad.size[1]
        nominal |= {label + name: (float(value), _TOOL_UNITS[name]) for name, value in values.items()}
        frames = [f"joint{number}" for number in range(1, robot.robot_facts.joint_count + 1)]
        nominal |= {f"{label}{frame}_{axis}": (0.0, "m") for frame in (*frames, "flange") for axis in AXES}
    return nominal


def with_value(scenario: Scenario, name: str, value: float) -> Scenario:
    """The scenario with another value of an uncertain number.

    Args:
        scenario: The scenario.
        name: Name of the number, a key of :func:`nominal_values`.
        value: Value, in the unit of :func:`nominal_values`.
    """
    if name == SUPPORT_FRICTION:
        return scenario.model_copy(update={"support": scenario.support.model_copy(update={"friction": value})})
    if name in {f"size_{axis}" for axis in AXES}:
        ((label, box),) = scenario.objects.items()
        size = [value if name.endswith(axis) else extent for axis, extent in zip(AXES, box.size, strict=True)]
        return scenario.model_copy(update={"objects": {label: box.model_copy(update={"size": tuple(size)})}})
    robots = dict(scenario.robots)
    for (label, robot), arm in zip(_arms(scenario), scenario.robots, strict=True):
        if name.startswith(label) and (quantity := name.removeprefix(label)) and "." not in quantity:
            robots[arm] = _robot_with_value(robot, quantity, value)
    return scenario.model_copy(update={"robots": robots})


def _arms(scenario: Scenario) -> Iterator[tuple[str, Robot]]:
    """Arms, each with the prefix of its names."""
    for arm, robot in scenario.robots.items():
        yield (f"{arm}." if len(scenario.robots) > 1 else ""), robot


def _robot_with_value(robot: Robot, name: str, value: float) -> Robot:
    offset = _OFFSET.fullmatch(name)
    if offset is None:
        tool = robot.end_effector
        changes: dict[str, Callable[[], dict[str, Any]]] = {
            "tool_mass": lambda: {"mass": value, "inertia": tuple(m * value / tool.mass for m in tool.inertia)},
            "tool_length": lambda: {"length": value},
            "pad_x": lambda: {"pad": tool.pad.model_copy(update={"size": (value, *tool.pad.size[1:])})},
            "pad_y": lambda: {"pad": tool.pad.model_copy(update={"size": (tool.pad.size[0], value, tool.pad.size[2])})},
        }
        return robot.model_copy(update={"end_effector": tool.model_copy(update=changes[name]())})
    facts, axis = robot.robot_facts, AXES.index(offset["axis"])

    def shifted(origin: Any) -> Any:
        xyz = [length + (value if number == axis else 0.0) for number, length in enumerate(origin.xyz)]
        return origin.model_copy(update={"xyz": tuple(xyz)})

    if offset["joint"] is None:
        return robot.model_copy(update={"facts": facts.model_copy(update={"flange": shifted(facts.flange)})})
    joints = list(facts.joints)
    number = facts.coordinates.index(int(offset["joint"]) - 1)
    joints[number] = shifted(joints[number])
    return robot.model_copy(update={"facts": facts.model_copy(update={"joints": tuple(joints)})})
