# SPDX-License-Identifier: Apache-2.0
"""Laws outside the library that are hidden in the MuJoCo cell: a drag, a ripple, a cable; forces before every step."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np

ARM = "arm"
WAVE_NUMBER, LENGTH = 6.0, 0.5  # 1/rad; m
ANCHOR = np.array([0.4, 0.35, 0.3])  # m, where the cable is fixed

Law = Callable[[mujoco.MjModel, mujoco.MjData, float], None]


def quadratic_drag(model: mujoco.MjModel, data: mujoco.MjData, magnitude: float) -> None:
    """-2 N s^2/m^2 times the magnitude, |v| v, at the middle of the object."""
    first = model.joint("object").dofadr[0]
    velocity = data.qvel[first : first + 3]
    data.qfrc_applied[first : first + 3] = -2.0 * magnitude * np.linalg.norm(velocity) * velocity


def ripple(model: mujoco.MjModel, data: mujoco.MjData, magnitude: float) -> None:
    """0.1 N m times the magnitude, sin(6 q4), on motor 4, in terms of the desired torque."""
    q = data.qpos[model.joint(f"{ARM}/joint4").qposadr[0]]
    motor = model.joint(f"{ARM}/motor4").dofadr[0]
    # The torque law scales what acts on the motor by B_rho / B_theta.
    data.qfrc_applied[motor] += SHAPING * 0.1 * magnitude * np.sin(WAVE_NUMBER * q)


def cable(model: mujoco.MjModel, data: mujoco.MjData, magnitude: float) -> None:
    """7.5 N/m times the magnitude on frame E, towards an anchor, beyond the length of the cable."""
    site = model.site(f"{ARM}/E").id
    away = data.site_xpos[site] - ANCHOR
    distance = float(np.linalg.norm(away))
    jacobian = np.zeros((3, model.nv))
    mujoco.mj_jacSite(model, data, jacobian, None, site)
    force = -7.5 * magnitude * max(distance - LENGTH, 0.0) / distance * away
    data.qfrc_applied[:] += jacobian.T @ force


SHAPING = 3.0  # B_rho / B_theta of joint 4
LAWS: dict[str, Law] = {"quadratic_drag": quadratic_drag, "ripple": ripple, "cable": cable}
