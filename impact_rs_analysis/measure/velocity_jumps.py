# SPDX-License-Identifier: Apache-2.0
"""Velocity jump of laboratory runs: measured post-impact velocity with its interval, and three predictions.

Without reference spreading there is no zero crossing of the net feedback. Instead, the velocity of the end effector 20
to 40 ms after the impact is compared with the impact map from the ante-impact state of every run. By then the
controller has accelerated the arm; the prediction includes this acceleration by the recorded torque,

    (M + B + J_p^T m J_p) ddq = tau_d - h - J_p^T mu m g v / |v|      (paper eq. eom; the object goes with the pad)

J_p has the horizontal rows of J, and v is the pad's horizontal velocity: a pad inside the friction cone moves the
object sideways as well, and slides vertically on its face. The equation is integrated from the impact on (explicit
Euler). Errors are (prediction - measurement) / measurement of every run; the interval is from repeats (Student's t).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from impact_rs_analysis.evidence.replays.ante_impact import ante_impact_state, problem_of
from impact_rs_analysis.evidence.replays.features import JUMP_BEFORE_S, JUMP_WINDOWS_S, SETTLED_WINDOW
from impact_rs_analysis.evidence.replays.measured_runs import MeasuredRun, Runs
from impact_rs_analysis.measure.far import Jump, far_jumps
from impact_rs_sim.effects.formula import MIN_SLIDING_SPEED_M_S
from impact_rs_sim.errors import InputError
from impact_rs_sim.impact_map import ImpactMapError, predict_impact
from impact_rs_sim.physics import MOTOR_INERTIA_MODELS
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.robots.robot_model import GRAVITY_M_S2
from impact_rs_sim.rotations import AXES
from impact_rs_sim.scene import pad_twists


@dataclass(frozen=True)
class MeasuredJump:
    """Post-impact velocity of one condition along the direction of the hit.

    Attributes:
        condition: Condition.
        runs: Number of its runs.
        before: Mean speed before the impact [m/s].
        after: Mean speed 20 to 40 ms after the impact, along the direction before it [m/s].
        interval: 95 % interval of ``after`` [m/s]; None for a single run.
        predicted: Mean predicted speed in the same window, by motor inertia [m/s].
        errors: Mean of (predicted - measured) / measured, by motor inertia [%].
    """

    condition: str
    runs: int
    before: float
    after: float
    interval: tuple[float, float] | None
    predicted: dict[str, float]
    errors: dict[str, float]


@dataclass(frozen=True)
class LaboratoryJumps:
    """Jumps of all conditions.

    Attributes:
        jumps: By condition.
        errors: Mean absolute error of every motor inertia over the conditions [%].
        remarks: Missing results, with the reason.
        contact: Contact of the predictions, ``first`` or ``settled``.
    """

    jumps: tuple[MeasuredJump, ...]
    errors: dict[str, float]
    remarks: tuple[str, ...]
    contact: str = "first"

    @property
    def compared(self) -> list[Jump]:
        """Prediction with B_theta and measurement of every condition."""
        return [Jump(jump.condition, jump.before, jump.predicted["reduced"], jump.after) for jump in self.jumps]

    @property
    def nearest(self) -> str:
        """Motor inertia with the smallest mean absolute error."""
        return min(self.errors, key=lambda name: self.errors[name])

    def to_json(self) -> dict[str, Any]:
        """Content of ``analyze --json``."""
        return {
            "conditions": [
                {
                    "condition": jump.condition,
                    "runs": jump.runs,
                    "speed_before": jump.before,
                    "speed_after": jump.after,
                    "ci95": None if jump.interval is None else list(jump.interval),
                    "predicted": jump.predicted,
                    "error_percent": jump.errors,
                }
                for jump in self.jumps
            ],
            "far": [vars(jump) | {"mismatch": jump.mismatch} for jump in far_jumps(self.compared)],
            "contact": self.contact,
            "mean_absolute_error_percent": self.errors,
            "nearest": self.nearest,
            "remarks": list(self.remarks),
        }


def jumps_of(runs: Runs, contact: str = "first") -> LaboratoryJumps:
    """Measured and predicted jumps of every condition with an impact.

    Args:
        runs: The runs.
        contact: ``first``: predictions just after the first simultaneous impact; ``settled``: when the contact that
            lasts is closed.

    Raises:
        InputError: No run has an impact, no impact map can be computed, or there are several arms.
    """
    if any(len(run.setup.physics.arms) > 1 for run in runs.runs):
        raise InputError(
            "the jump is analysed for a single arm only; use compare or diagnose for several arms",
            file=runs.directory,
        )
    jumps, remarks = [], list(runs.remarks)
    for condition, group in runs.conditions.items():
        if not group[0].hit:
            continue
        try:
            jumps.append(_jump_of(condition, group, contact))
        except (ImpactMapError, InputError) as error:
            remarks.append(f"impact map of {condition}: {error}")
    if not jumps:
        reason = f": {remarks[-1]}" if remarks else ": no run has an impact"
        raise InputError(f"no jump to analyse{reason}", file=runs.directory)
    errors = {name: float(np.mean([abs(jump.errors[name]) for jump in jumps])) for name in MOTOR_INERTIA_MODELS}
    return LaboratoryJumps(tuple(jumps), errors, tuple(remarks), contact)


def _jump_of(condition: str, group: Sequence[MeasuredRun], contact: str) -> MeasuredJump:
    hits = [(run, _ante_velocities(run)) for run in group]
    before, after = np.array([_speeds(run, ante) for run, ante in hits]).T
    predicted = {
        name: np.array([_predicted(run, ante, name, contact) for run, ante in hits]) for name in MOTOR_INERTIA_MODELS
    }
    interval = None
    if len(group) > 1:
        half = float(scipy.special.stdtrit(len(group) - 1, 0.975) * after.std(ddof=1) / math.sqrt(len(group)))
        interval = (float(after.mean()) - half, float(after.mean()) + half)
    return MeasuredJump(
        condition=condition,
        runs=len(group),
        before=float(before.mean()),
        after=float(after.mean()),
        interval=interval,
        predicted={name: float(values.mean()) for name, values in predicted.items()},
        errors={name: float(np.mean((values - after) / after)) * 100.0 for name, values in predicted.items()},
    )


def _speeds(run: MeasuredRun, ante: dict[str, Array]) -> tuple[float, float]:
    """Speed before and after the impact along the direction before it, mean over the arms [m/s]."""
    pairs = []
    values = {
        (feature.signal, feature.index, feature.bin): value
        for feature, value in zip(run.features, run.measured, strict=True)
        if feature.phase == "impact"
    }
    for name, direction in _directions(ante).items():
        # The feature is the change from the mean over the last milliseconds before the impact.
        change = np.array([values["end-effector velocity", axis, SETTLED_WINDOW] for axis in AXES])
        baseline = _baseline(run, name)
        pairs.append((float(ante[name] @ direction), float((baseline + change) @ direction)))
    before, after = np.mean(pairs, axis=0)
    return float(before), float(after)


def _ante_velocities(run: MeasuredRun) -> dict[str, Array]:
    """Velocity of every end effector at the beginning of the impact, ``(3,)`` [m/s]."""
    physics = run.setup.physics
    twists = pad_twists(physics, physics.robot_models(), ante_impact_state(run))
    return {name: twist[:3] for name, twist in twists.items()}


def _directions(ante: dict[str, Array]) -> dict[str, Array]:
    return {name: velocity / np.linalg.norm(velocity) for name, velocity in ante.items()}


def _baseline(run: MeasuredRun, name: str) -> Array:
    """Mean end-effector velocity over the reference window before the impact, ``(3,)`` [m/s]."""
    window, model = run.windowed[-1], run.setup.physics.robot_model(name)
    onset, arm = run.impacts[name], window.arms[name]
    rows = (window.time >= onset + JUMP_BEFORE_S[0]) & (window.time <= onset + JUMP_BEFORE_S[1])
    twists = [model.jacobian(q)[:3] @ dq for q, dq in zip(arm.position[rows], arm.velocity[rows], strict=True)]
    return np.asarray(np.mean(twists, axis=0))


def _predicted(run: MeasuredRun, ante: dict[str, Array], motor_inertia: str, contact: str) -> float:
    """Speed 20 to 40 ms after the impact along the direction before it, mean over the arms [m/s]."""
    result = predict_impact(problem_of(run, run.setup.physics, motor_inertia), contact)
    return float(
        np.mean(
            [
                result.end_effector_twist[name][:3] @ direction
                + _velocity_change_after(run, name, direction, motor_inertia)
                for name, direction in _directions(ante).items()
            ]
        )
    )


def _velocity_change_after(run: MeasuredRun, name: str, direction: Array, motor_inertia: str) -> float:
    """Change of the speed along ``direction`` by the recorded torque until 20 to 40 ms after the impact [m/s].

    The object moves with the pad in the plane of the support, with its full mass for every arm; a fixed one holds it.
    Without recorded commands the joint torque is used.
    """
    setup = run.setup
    if setup.physics.object.fixed:
        return 0.0
    arm_physics, window, signals = setup.physics.arms[name], setup.windows[-1], run.windowed[-1]
    model, arm, body = setup.physics.robot_model(name), signals.arms[name], setup.physics.object
    torque = window.commanded(name) if setup.drive == "command" else arm.torque
    motor_inertias = arm_physics.motor_inertia(motor_inertia)
    drag = 0.0 if setup.physics.support_height is None else setup.physics.support_friction * body.mass * GRAVITY_M_S2
    start, (first, last) = run.impacts[name], JUMP_WINDOWS_S[SETTLED_WINDOW]
    speed, sum_of_speeds, ticks = 0.0, 0.0, 0
    for row in range(1, window.time.size):
        elapsed = float(window.time[row] - start)
        if elapsed > last:
            break
        step = min(elapsed, float(window.time[row] - window.time[row - 1]))
        if step <= 0.0:
            continue
        q, dq = arm.position[row - 1], arm.velocity[row - 1]
        terms = model.terms(q, dq)
        horizontal_jacobian = terms.jacobian[:2]
        inertia_matrix = (
            terms.mass_matrix + np.diag(motor_inertias) + body.mass * horizontal_jacobian.T @ horizontal_jacobian
        )
        velocity = horizontal_jacobian @ dq
        friction_torque = (
            horizontal_jacobian.T @ velocity * drag / max(float(np.linalg.norm(velocity)), MIN_SLIDING_SPEED_M_S)
        )
        acceleration = np.linalg.solve(inertia_matrix, torque[row - 1] - terms.bias - friction_torque)
        speed += step * float(direction @ terms.jacobian[:3] @ acceleration)
        if elapsed >= first:
            sum_of_speeds, ticks = sum_of_speeds + speed, ticks + 1
    return sum_of_speeds / max(ticks, 1)
