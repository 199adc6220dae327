# SPDX-License-Identifier: Apache-2.0
"""An arm under position servos in MuJoCo, whose log holds no torque: another simulator than the one that explains it.

Two slender links (:mod:`slender_arm`) swing in a vertical plane; actuators give kp (q_desired - q) - kd dq.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from joint_recordings import Columns
from slender_arm import mapping_of, slender_arm

from impact_rs_trials.recordings.mapping import Mapping, load_mapping

KP, KD = (150.0, 100.0), (6.0, 4.0)  # N m/rad, N m s/rad
NOTHING = (0.0, 0.0)
TIMESTEP, RATE, WARM_UP = 0.00025, 200.0, 1.0  # s, Hz, s
POSITION_NOISE, VELOCITY_NOISE = 5e-4, 5e-3  # rad, rad/s
JOINT = (  # dry friction of MuJoCo creeps; as stiff as its step allows, by 0.2 mrad/s
    '<joint name="joint{n}" axis="0 0 1" armature="{armature}" damping="{viscous}" frictionloss="{coulomb}" '
    'solreffriction="0.002 1" solimpfriction="0.99 0.9999 0.001"/>'
    '<inertial pos="0.2 0 0" mass="2" diaginertia="0.002 0.03 0.03"/>'
)


@dataclass(frozen=True)
class Servos:
    """What drives the arm.

    Attributes:
        coulomb: Coulomb friction of the joints [N m].
        viscous: Viscous friction [N m s/rad].
        armature: Inertia of the motors at the joints [kg m^2].
        gain: Delivered over asked torque [-].
        delay: From the stamp of a command until it acts [s].
        offset: Reading less position of the encoders; servos see the readings [rad].
        gravity: Whether something else holds the links' weight, as a controller's gravity torque does.
        width: Velocity w at which dry friction ``F_c tanh(dq / w)`` has turned [rad/s]; 0: it sticks, as MuJoCo's does.
    """

    coulomb: Sequence[float] = NOTHING
    viscous: Sequence[float] = NOTHING
    armature: Sequence[float] = NOTHING
    gain: Sequence[float] = (1.0, 1.0)
    delay: float = 0.0
    offset: Sequence[float] = NOTHING
    gravity: bool = False
    width: Sequence[float] = NOTHING


def desired(time: np.ndarray | float) -> np.ndarray:
    """Sum of three sines in every joint, up to 1.5 Hz, ``(..., 2)`` [rad]."""
    t, joints = np.asarray(time)[..., None], np.arange(2)
    low, middle, high = (2.0 * np.pi * f for f in (0.13 + 0.05 * joints, 0.57 - 0.06 * joints, 1.3 + 0.2 * joints))
    swing = 0.6 * np.sin(low * t + joints) + 0.25 * np.sin(middle * t) + 0.08 * np.sin(high * t)
    return np.asarray(np.array([-1.2, 0.3]) + swing)


def servo_log(servos: Servos, seconds: float = 29.0, seed: int = 0) -> Columns:
    """Time, position, velocity, desired position and, for checks alone, the true torque of the motors."""
    size, width = np.array(servos.coulomb), np.array(servos.width)
    parts = [
        JOINT.format(
            n=joint + 1,
            armature=servos.armature[joint],
            viscous=servos.viscous[joint],
            coulomb=0.0 if width[joint] else size[joint],
        )
        for joint in range(2)
    ]
    turning = size * (width > 0.0), np.where(width > 0.0, width, 1.0)
    held = 'gravcomp="1"' if servos.gravity else ""
    drives = "".join(f'<motor joint="joint{joint}"/>' for joint in (1, 2))
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><compiler angle="radian"/><option timestep="{TIMESTEP}" integrator="implicitfast"/><worldbody>'
        f'<body euler="{np.pi / 2} 0 0" {held}>{parts[0]}<body pos="0.4 0 0" {held}>{parts[1]}</body></body>'
        "</worldbody>"
        f"<actuator>{drives}</actuator></mujoco>"
    )
    data, kp, kd = mujoco.MjData(model), np.array(KP), np.array(KD)
    offset, gain = np.array(servos.offset), np.array(servos.gain)
    data.qpos[:] = desired(0.0)
    times = np.arange(round((seconds + WARM_UP) / TIMESTEP)) * TIMESTEP
    wanted, every = desired(times - servos.delay), round(1.0 / RATE / TIMESTEP)
    rows = []
    for number, time in enumerate(times.tolist()):
        seen = data.qpos + offset
        torque = kp * (wanted[number] - seen) - kd * data.qvel
        data.ctrl[:] = gain * torque
        data.qfrc_applied[:] = -turning[0] * np.tanh(data.qvel / turning[1])
        if number % every == 0:
            rows.append(np.concatenate(([time], seen, data.qvel, desired(time), data.ctrl)))
        mujoco.mj_step(model, data)
    table = np.array(rows)[round(WARM_UP * RATE) :]
    noise = np.random.default_rng(seed)
    return {
        "time": table[:, 0] - table[0, 0],
        "position": table[:, 1:3] + noise.normal(0.0, POSITION_NOISE, (len(table), 2)),
        "velocity": table[:, 3:5] + noise.normal(0.0, VELOCITY_NOISE, (len(table), 2)),
        "q_desired": table[:, 5:7],
        "torque": table[:, 7:9],
    }


def servo_mapping(folder: Path, servo: dict[str, Any] | None = None, **further: Any) -> Mapping:
    """Mapping of arrays ``position``, ``velocity`` and ``q_desired`` of the arm.

    Args:
        folder: Where robot and mapping are written.
        servo: Section of the servos; None: their gains.
        further: Keys of the mapping.
    """
    mapping_of(folder, slender_arm(("revolute",) * 2))
    file = folder / "mapping.yaml"
    content = json.loads(file.read_text(encoding="utf-8"))
    del content["signals"]["torque"]
    content["signals"]["q_desired"] = {"array": "q_desired", "unit": "rad"}
    content |= {"torque_measured_at": "motor", "servo": servo or {"kp": KP, "kd": KD}, **further}
    file.write_text(json.dumps(content), encoding="utf-8")
    return load_mapping(file)
