# SPDX-License-Identifier: Apache-2.0
"""Files that a reader takes without a word: joints of an iiwa, a bouncing ball, impacts in a table, a robot."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from impact_rs_sim.robots.robot import load_facts
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_trials.recordings.mapping import MountedEndEffector

ROBOT = "kuka_iiwa7"
JOINTS = range(1, 8)
NAMES = ("t", *(f"{name}_{joint}" for name in ("q", "dq", "tau") for joint in JOINTS))
GRAVITY = 9.81  # m/s^2
Rng = np.random.Generator
Table = list[list[str]]

URDF = """<robot name="arm">
<link name="base"/><link name="upper"><inertial><origin xyz="0 0 0.2"/><mass value="3"/>
<inertia ixx="0.05" iyy="0.05" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="lower"><inertial><origin xyz="0 0 0.15"/><mass value="2"/>
<inertia ixx="0.02" iyy="0.02" izz="0.005" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><origin xyz="0 0 0.1"/>
<axis xyz="0 1 0"/><limit lower="-2" upper="2" velocity="2" effort="80"/></joint>
<joint name="elbow" type="revolute"><parent link="upper"/><child link="lower"/><origin xyz="0 0 0.4"/>
<axis xyz="0 1 0"/><limit lower="-2" upper="2" velocity="2" effort="40"/></joint></robot>
"""
EXPERIMENT = """mapping: mapping.yaml
runs: runs.csv
body: {mass: 0.05, radius: 0.03, spin: [0, 0, 0]}
plane: {height: 0.0}
"""
BALL = """description: a ball
robot: none
time: {column: t}
signals:
  object_position: {columns: [x, y, z], unit: m}
"""
BALL_IN_BAGS = """description: a ball
robot: none
signals:
  object_pose: {topic: /tracker/ball, type: geometry_msgs/msg/PoseStamped, unit: m}
"""
MAPPING = f"""description: joints
robot: {ROBOT}
joints: [{", ".join(f"joint{joint}" for joint in JOINTS)}]
time: {{column: t, array: t, stamp: header}}
signals:
"""


def joint_motion() -> dict[str, np.ndarray]:
    """An iiwa that swings for 8 s at 50 Hz, with friction and noise: t, q, dq, tau."""
    model = RobotModel(load_facts(ROBOT), MountedEndEffector().build(), pin.SE3.Identity())
    t = 0.02 * np.arange(400)
    speed, centre = 2.0 * np.pi * np.linspace(0.3, 0.6, 7), np.array([0.1, 0.6, 0.2, -1.2, 0.3, 0.9, 0.1])
    angle = speed * t[:, None] + np.arange(7.0)
    q, dq, ddq = centre + 0.35 * np.sin(angle), 0.35 * speed * np.cos(angle), -0.35 * speed**2 * np.sin(angle)
    tau = np.array([model.inverse_dynamics(*state) for state in zip(q, dq, ddq, strict=True)])
    rng = np.random.default_rng(0)
    tau += 0.3 * np.tanh(20.0 * dq) + 0.02 * rng.standard_normal(tau.shape)
    return {"t": t, "q": np.round(q, 6), "dq": np.round(dq, 6), "tau": np.round(tau, 5)}


def rows_of(columns: dict[str, np.ndarray]) -> Table:
    """The table of a motion, names first."""
    numbers = np.column_stack([columns[name] for name in ("t", "q", "dq", "tau")])
    return [list(NAMES), *([f"{value:.10g}" for value in row] for row in numbers.tolist())]


def bounce(run: int) -> Table:
    """A ball that falls onto a plane and leaves it, at 200 Hz."""
    t = 0.005 * np.arange(120)
    hit, fall = 0.3, 0.1 * run + 2.5
    z = 0.03 + np.where(
        t < hit,
        fall * (hit - t) - 0.5 * GRAVITY * (hit - t) ** 2,
        0.7 * fall * (t - hit) - 0.5 * GRAVITY * (t - hit) ** 2,
    )
    noise = 1e-4 * np.random.default_rng(run).standard_normal((t.size, 3))
    position = np.column_stack((0.4 * t, -0.2 * t, z)) + noise
    return [
        ["t", "x", "y", "z"],
        *([f"{value:.7g}" for value in row] for row in np.column_stack((t, position)).tolist()),
    ]


def impacts_of_a_ball() -> Table:
    """Impacts of a ball on a plane, with friction 0.1 and restitution 0.6."""
    rng = np.random.default_rng(3)
    head = [f"v{axis}_before [m/s]" for axis in "xyz"] + [f"w{axis}_before [rad/s]" for axis in "xyz"]
    head += [*(f"v{axis}_after [m/s]" for axis in "xyz"), "mass [kg]", "radius [m]"]
    rows = []
    for _ in range(40):
        vx, vz = rng.uniform(1.0, 2.0), -rng.uniform(1.0, 3.0)
        after = np.array([vx + 0.16 * vz, 0.0, -0.6 * vz]) + 0.01 * rng.standard_normal(3)
        rows.append([f"{value:.6g}" for value in (vx, 0.0, vz, 0.0, 0.0, 0.0, *after, 0.05, 0.03)])
    return [head, *rows]


def text_of(rows: Table, separator: str = ",") -> bytes:
    """A table as text."""
    return ("\n".join(separator.join(row) for row in rows) + "\n").encode()
