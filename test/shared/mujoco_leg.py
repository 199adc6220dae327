# SPDX-License-Identifier: Apache-2.0
"""A leg of three joints in MuJoCo, whose links may differ from the description that an analysis gets.

Hip abduction about x, thigh and calf about y, sizes of a small quadruped; torques by the inverse dynamics of MuJoCo.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
from joint_recordings import Columns, write_npz
from slender_arm import mapping_of

from impact_rs_analysis.evidence.sources.recording_source import RecordingSource
from impact_rs_sim.model import Model
from impact_rs_sim.robots.robot import Link, RobotFacts
from impact_rs_trials.recordings.recording import read_recordings

KNEE, FOOT = 0.213, np.array([0.213, 0.0, 0.0])  # m
TORQUE_NOISE, RATE, SECONDS = 0.03, 100.0, 16.0  # N m, Hz, s
FACTS = RobotFacts.model_validate(
    {
        "source": "by hand",
        "joints": [
            {"xyz": (0, 0, 0), "rpy": (0, np.pi / 2.0, 0)},
            {"xyz": (0, 0.0955, 0), "rpy": (-np.pi / 2.0, 0, 0)},
            {"xyz": (KNEE, 0, 0), "rpy": (0, 0, 0)},
        ],
        "flange": {"xyz": FOOT.tolist(), "rpy": (0, 0, 0)},
        "limits": {
            "position_min_rad": [-3.0] * 3,
            "position_max_rad": [3.0] * 3,
            "velocity_rad_s": [30.0] * 3,
            "torque_Nm": [40.0] * 3,
        },
        "links": [
            {"mass": 0.68, "com": (0, 0, -0.005), "inertia": (9e-4, 0, 0, 8.8e-4, 0, 4.8e-4)},
            {"mass": 1.15, "com": (0.027, 0.003, -0.022), "inertia": (1e-3, 0, 0, 5.9e-3, 0, 5.8e-3)},
            {"mass": 0.24, "com": (0.117, 0.006, 0), "inertia": (4e-5, 0, 0, 1.5e-3, 0, 1.5e-3)},
        ],
    }
)


def wrong_links(share: float, shift: float, seed: int, which: Sequence[int] = (0, 2)) -> list[Link]:
    """Links whose mass and inertia are off by about a share [-] and whose centres by about a distance [m]."""
    noise, links = np.random.default_rng(seed), list(FACTS.links)
    for number in which:
        link = links[number]
        mass, inertia = 1.0 + share * noise.choice([-1.0, 1.0], 2) * noise.uniform(0.6, 1.4, 2)
        links[number] = link.model_copy(
            update={
                "mass": mass * link.mass,
                "inertia": tuple(inertia * np.array(link.inertia)),
                "com": tuple(np.array(link.com) + shift * noise.normal(size=3)),
            }
        )
    return links


def leg_log(links: Sequence[Link], load: float = 0.0, seed: int = 0) -> Columns:
    """Time, position, velocity and torque of the leg with a point mass [kg] at its foot."""
    text, ends = "", ""
    for number, (joint, link) in enumerate(zip(FACTS.joints, links, strict=True)):
        turn = pin.Quaternion(pin.rpy.rpyToMatrix(*joint.rpy))
        xx, xy, xz, yy, yz, zz = link.inertia
        moments = _numbers((xx, yy, zz, xy, xz, yz))
        text += (
            f'<body pos="{_numbers(joint.xyz)}" quat="{turn.w} {turn.x} {turn.y} {turn.z}">'
            f'<joint name="j{number}" axis="0 0 1"/>'
            f'<inertial pos="{_numbers(link.com)}" mass="{link.mass}" fullinertia="{moments}"/>'
        )
        ends += "</body>"
    if load:
        point = f'<inertial pos="0 0 0" mass="{load}" diaginertia="1e-9 1e-9 1e-9"/>'
        text += f'<body pos="{_numbers(FOOT)}">{point}</body>'
    world = f'<mujoco><compiler angle="radian"/><worldbody>{text}{ends}</worldbody></mujoco>'
    model = mujoco.MjModel.from_xml_string(world)
    data, time, joints = mujoco.MjData(model), np.arange(0.0, SECONDS, 1.0 / RATE), np.arange(3)
    rates = 2.0 * np.pi * np.array([0.31 + 0.07 * joints, 0.83 - 0.09 * joints, 1.7 + 0.3 * joints])  # rad/s
    sizes, t = np.array([0.35, 0.18, 0.08])[:, None], time[:, None, None]

    def derivative(order: int) -> np.ndarray:
        return np.asarray(np.sum(sizes * rates**order * np.sin(rates * t + joints + order * np.pi / 2.0), axis=1))

    position, velocity, torques = np.array([0.0, 0.8, -1.5]) + derivative(0), derivative(1), []
    for data.qpos[:], data.qvel[:], data.qacc[:] in zip(position, velocity, derivative(2), strict=True):
        mujoco.mj_inverse(model, data)
        torques.append(data.qfrc_inverse.copy())
    noise = np.random.default_rng(seed).normal(0.0, TORQUE_NOISE, position.shape)
    return {"time": time, "position": position, "velocity": velocity, "effort": np.array(torques) + noise}


def leg_source(folder: Path, log: Columns) -> RecordingSource:
    """A log as evidence against the description of the leg."""
    mapping = mapping_of(folder, FACTS)
    return RecordingSource.of(
        read_recordings(write_npz(folder / "run.npz", log), mapping), mapping, Model(name="nominal")
    )


def _numbers(values: Sequence[float] | np.ndarray) -> str:
    return " ".join(map(str, values))
