# SPDX-License-Identifier: Apache-2.0
"""Blind campaigns recorded on the MuJoCo cell.

As ``impact-rs blind make`` does on our plant: the same sizes, draws and ``truth.json``, so that ``impact-rs diagnose``
and ``blind score`` take them. The bags of the cell have no topics below ``/truth``. Three causes that no
effect of the library says are built into MuJoCo's description of the scene.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
from mujoco_cell import Modification, MujocoCell

from impact_rs_control.plan import TrialPlan
from impact_rs_sim.physics import Physics
from impact_rs_trials.bags.record import record_cell
from impact_rs_trials.bags.trial_info import TrialInfo
from impact_rs_trials.blind import BlindTask, run_task


def flexible_base(physics: Physics, magnitude: float) -> Modification:
    """The table of the arm gives way along y: 60 kg over the magnitude on springs, 4 Hz, 3 % of critical damping."""
    mass, rate, ratio = 60.0 / magnitude, 2.0 * np.pi * 4.0, 0.03

    def modify(spec: mujoco.MjSpec) -> None:
        for name in physics.arms:
            base = spec.body(f"{name}/base")
            base.mass = mass
            base.add_joint(
                name=f"{name}/base",
                type=mujoco.mjtJoint.mjJNT_SLIDE,
                axis=[0.0, 1.0, 0.0],
                stiffness=[mass * rate**2, 0.0, 0.0],
                damping=[2.0 * ratio * rate * mass, 0.0, 0.0],
            )

    return modify


def loose_contents(physics: Physics, magnitude: float) -> Modification:
    """A fifth of the object's mass times the magnitude, at most four fifths, swings in it at 3 Hz."""
    object_ = physics.object
    share, rate, ratio = min(0.2 * magnitude, 0.8), 2.0 * np.pi * 3.0, 0.1
    mass = share * object_.mass

    def modify(spec: mujoco.MjSpec) -> None:
        body = spec.body("object")
        body.mass = object_.mass - mass
        body.inertia = (1.0 - share) * object_.inertia
        contents = body.add_body(
            name="contents",
            mass=mass,
            ipos=object_.com_offset,
            inertia=share * object_.inertia,
            explicitinertial=True,
        )
        for name, axis in (("x", [1.0, 0.0, 0.0]), ("y", [0.0, 1.0, 0.0])):
            contents.add_joint(
                name=f"contents_{name}",
                type=mujoco.mjtJoint.mjJNT_SLIDE,
                axis=axis,
                stiffness=[mass * rate**2, 0.0, 0.0],
                damping=[2.0 * ratio * rate * mass, 0.0, 0.0],
            )

    return modify


def backlash(physics: Physics, magnitude: float) -> Modification:
    """Play in every transmission: no torque within 0.3 mrad times the magnitude to either side."""
    play = 3e-4 * magnitude  # rad

    def modify(spec: mujoco.MjSpec) -> None:
        for transmission in spec.tendons:
            transmission.springlength = [-play, play]

    return modify


OUTSIDE: dict[str, Callable[[Physics, float], Modification]] = {
    "flexible_base": flexible_base,
    "loose_contents": loose_contents,
    "backlash": backlash,
}


def record(task: BlindTask, plan: TrialPlan, info: TrialInfo, path: Path, physics: Physics) -> str:
    """Record one trial of a blind campaign on the cell. Returns the outcome."""
    scene = plan.scene
    cell = MujocoCell(
        scene.scenario,
        physics,
        {name: arm.initial for name, arm in plan.arms.items()},
        scene.object,
        info.seed,
        modify=None if task.outside is None else OUTSIDE[task.outside](physics, task.magnitude),
    )
    return record_cell(plan, info, path, cell)[0].outcome


record_task = functools.partial(run_task, record=record)
"""Records a trial of a blind campaign on the cell, in the place of :func:`impact_rs_trials.blind.run_task`."""
