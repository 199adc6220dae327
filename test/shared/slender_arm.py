# SPDX-License-Identifier: Apache-2.0
"""Arms of slender links of 0.4 m, and recordings of them with effects of the library in them."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from joint_recordings import Columns, swinging

from impact_rs_sim.effects import library
from impact_rs_sim.physics import Physics
from impact_rs_sim.robots.robot import Array, JointType, RobotFacts
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_trials.recordings.mapping import Mapping, load_mapping
from impact_rs_trials.recordings.recording import ARM, nominal_physics

LENGTH = 0.4  # m
UPRIGHT, FLAT = (np.pi / 2.0, 0.0, 0.0), (0.0, 0.0, 0.0)  # rpy of the first joint: it turns about -y, or about z
RATE, DURATION = 50.0, 36.0  # Hz, s


def slender_arm(kinds: Sequence[JointType], rpy: tuple[float, float, float] = UPRIGHT) -> RobotFacts:
    """An arm; a joint that slides does so along its own z, which lies level."""
    origins = [{"type": kind, "xyz": (LENGTH if joint else 0.0, 0, 0), "rpy": FLAT} for joint, kind in enumerate(kinds)]
    origins[0]["rpy"] = rpy
    if kinds[0] == "prismatic":
        origins[1] |= {"xyz": (0, 0, 0), "rpy": (np.pi / 2.0, 0.0, 0.0)}  # across the rail, so that it couples
    link = {"mass": 2.0, "com": (LENGTH / 2.0, 0, 0), "inertia": (0.002, 0, 0, 0.03, 0, 0.03)}
    count = len(kinds)
    return RobotFacts.model_validate(
        {
            "source": "by hand",
            "joints": origins,
            "flange": {"xyz": (LENGTH, 0, 0), "rpy": (0, np.pi / 2.0, 0)},
            "limits": {
                "position_min_rad": [-3.0] * count,
                "position_max_rad": [3.0] * count,
                "velocity_rad_s": [4.0] * count,
                "torque_Nm": [200.0] * count,
            },
            "links": [link] * count,
        }
    )


def lighter(facts: RobotFacts, share: float) -> RobotFacts:
    """The arm with links of so many times their mass."""
    links = [
        link.model_copy(update={"mass": share * link.mass, "inertia": tuple(share * one for one in link.inertia)})
        for link in facts.links
    ]
    return facts.model_copy(update={"links": tuple(links)})


def mapping_of(folder: Path, facts: RobotFacts, torque: dict[str, Any] | None = None, **further: Any) -> Mapping:
    """Mapping of arrays ``position``, ``velocity`` and ``effort`` of such an arm.

    Args:
        folder: Where robot and mapping are written.
        facts: The arm.
        torque: Keys of its torque besides the array; None: its SI unit.
        further: Keys of the mapping.
    """
    (folder / "robot.yaml").write_text(json.dumps(facts.model_dump(mode="json")), encoding="utf-8")
    names = {"position": "position", "velocity": "velocity", "torque": "effort"}
    signals: dict[str, dict[str, Any]] = {
        signal: {"array": name, "unit": [getattr(joint, name) for joint in facts.units]}
        for signal, name in names.items()
    }
    signals["torque"] |= torque or {}
    content = {
        "description": "by hand",
        "robot": "robot.yaml",
        "joints": [f"joint{joint + 1}" for joint in range(facts.joint_count)],
        "signals": signals,
        **further,
    }
    (folder / "mapping.yaml").write_text(json.dumps(content), encoding="utf-8")
    return load_mapping(folder / "mapping.yaml")


def with_effects(mapping: Mapping, effects: dict[str, dict[str, float]]) -> Physics:
    """Nominal physics of the mapped arm with effects; parameters that are not named stay nominal."""
    facts = mapping.facts
    model = RobotModel(facts, mapping.end_effector.build())
    physics = nominal_physics(mapping, np.zeros((1, facts.joint_count)), model)
    for name, values in effects.items():
        vector = {scalar.name: scalar.nominal for scalar in library()[name].scalars(facts.joint_types)}
        assert set(values) <= set(vector)
        physics = library()[name].apply_vector(physics, np.array(list({**vector, **values}.values())))
    return physics


def swung(
    mapping: Mapping,
    effects: dict[str, dict[str, float]],
    noise: float = 0.02,
    seed: int = 3,
    start: float = 0.0,
    seconds: float = DURATION,
) -> Columns:
    """The arm with effects swings every joint at its own frequencies; torques by inverse dynamics.

    Args:
        mapping: Of the arm.
        effects: Effects of the library with their parameters.
        noise: Standard deviation of the torque [N m].
        seed: Of the noise.
        start: Of the recording within the motion [s]; its stamps begin with 0.
        seconds: Its length [s].
    """
    physics = with_effects(mapping, effects)
    arm, joints = physics.arms[ARM], np.arange(mapping.facts.joint_count)
    time = start + np.arange(0.0, seconds, 1.0 / RATE)
    frequencies, model = (0.13 + 0.03 * joints, 0.37 - 0.02 * joints), physics.robot_model(ARM)
    columns, past = (
        swinging(model, moment, 0.0, frequencies, (0.6, 0.15)) for moment in (time, time - arm.readings.torque_delay)
    )
    torque: Array = past["effort"] - arm.friction.torque(past["velocity"], past["effort"]) - arm.torque_offset
    if mapping.torque_measured_at == "motor":
        torque = torque + arm.motor_inertia_reduced * np.gradient(past["velocity"], time, axis=0, edge_order=2)
    torque = torque / arm.torque_gain + np.random.default_rng(seed).normal(0.0, noise, torque.shape)
    return columns | {"time": time - start, "effort": torque}
