# SPDX-License-Identifier: Apache-2.0
"""Directions and zeros of joints in another convention than the model's, found by the torque that the motion takes.

A recording of another convention has, joint by joint,

    q = s q_r + z,    dq = s dq_r,    tau = s tau_r,    s = +-1,    z in {0, +-pi/2, pi},

and velocities that are the derivatives of its positions, so that only torques show it. s and z minimise

    sum_j log mean_k (s_j tau_r,jk - tau_j(q_k, dq_k, ddq_k) - c_j tanh(dq_jk / v_0))^2 + changes,    c_j >= 0,

with rigid-body dynamics and Coulomb friction, which cannot drive a joint; light joints weigh as much as heavy ones.
Every step changes the one or two joints that lower it most. Some conventions describe the same arm: two axes that
intersect may turn the joint between them round by half turns.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations, product

import numpy as np
from numpy.typing import NDArray

from impact_rs_sim.robots.robot import Array
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_trials.recordings.file_units import factors_of
from impact_rs_trials.recordings.mapping import Mapping, SignalName
from impact_rs_trials.recordings.relations import AveragedMotion, dry_friction, evenly, fit
from impact_rs_trials.recordings.remarks import Remark, joined, remark

MAX_SAMPLES = 40  # of a recording, each with rigid-body dynamics for some thousand choices
RIGHT_ANGLES = (0.0, 0.5 * np.pi, -0.5 * np.pi, np.pi)  # rad
MIN_LOG_RATIO = 1.0  # of the mean squares of all joints, by which every changed direction or zero must lower them
MAX_MISFIT_RATIO = 0.1  # over the misfit of factors of the torques, and over the squares of the torques
MIRRORED: tuple[SignalName, ...] = ("position", "velocity", "torque", "q_desired", "dq_desired")
SHIFTED: tuple[SignalName, ...] = ("position", "q_desired")


def convention_warning(model: RobotModel, motion: AveragedMotion, torque: Array, mapping: Mapping) -> Remark | None:
    """Warning about directions and zeros that explain the torques; None: factors of the torques explain as much.

    Args:
        model: Nominal arm.
        motion: Recorded motion.
        torque: Torques averaged as the motion, ``(k, n)`` [N m].
        mapping: Knows the robot, and has the remedy.
    """
    rows, measured = evenly(motion.time.size, MAX_SAMPLES), np.ptp(torque, axis=0) > 0.0
    q, dq, ddq, tau = (signal[rows] for signal in (motion.position, motion.velocity, motion.acceleration, torque))

    def squares(choice: Array) -> Array:
        direction, zero = choice
        residual = direction * tau - _rigid(model, direction * q + zero, direction * dq, direction * ddq)
        return _without_friction(residual, dry_friction(direction * dq))[measured]

    def score(choice: Array) -> float:
        changes = np.count_nonzero(choice[0] < 0.0) + np.count_nonzero(choice[1])
        return float(np.sum(np.log(np.maximum(squares(choice), 1e-12))) + MIN_LOG_RATIO * changes)

    prismatic = np.array([joint.type == "prismatic" for joint in mapping.facts.joints])
    choice = np.array([np.ones(prismatic.size), np.zeros(prismatic.size)])
    if np.sum(squares(choice)) < MAX_MISFIT_RATIO * np.sum(np.mean(np.square(tau), axis=0)):
        return None
    while score(neighbour := min(_neighbours(choice, prismatic), key=score)) < score(choice):
        choice = neighbour
    misfit = float(np.sum(squares(choice)))
    factors = float(np.sum(_squares_with_factors(_rigid(model, q, dq, ddq), dry_friction(dq), tau)[measured]))
    if misfit > MAX_MISFIT_RATIO * factors:
        return None
    changed = ["directions"] * bool(np.any(choice[0] < 0.0)) + ["zeros"] * bool(np.any(choice[1]))
    return remark(
        "torques belong to joints with other {} (residual {:.2g} N m rms, {:.2g} N m with factors of the torques). "
        "Remedy in the mapping: {}",
        " and ".join(changed), np.sqrt(misfit), np.sqrt(factors), joined(", ", _remedies(choice, mapping)),
    )  # fmt: skip


def _rigid(model: RobotModel, q: Array, dq: Array, ddq: Array) -> Array:
    """Rigid-body torque of a motion, ``(k, n)`` [N m]."""
    return np.array([model.inverse_dynamics(*sample) for sample in zip(q, dq, ddq, strict=True)])


def _without_friction(residual: Array, friction: Array) -> Array:
    """Mean squares of residuals ``(k, n)`` minus a fitted friction that brakes, ``(n,)``."""
    power, product = np.mean(np.square(friction), axis=0), np.mean(residual * friction, axis=0)
    explained = np.square(np.maximum(product, 0.0)) / np.maximum(power, 1e-300)
    return np.asarray(np.mean(np.square(residual), axis=0) - explained)


def _squares_with_factors(rigid: Array, friction: Array, torque: Array) -> Array:
    """Mean squared residuals of the torque minus a (rigid + c friction), c >= 0, by joint, ``(n,)``."""
    with_friction, without_friction = fit(rigid, torque, (friction,)), fit(rigid, torque)
    product = np.sum((torque - with_friction.factor * rigid) * friction, axis=0)
    misfit = np.where(product * with_friction.factor > 0.0, with_friction.misfit, without_friction.misfit)
    return np.asarray(misfit / torque.shape[0])


def _neighbours(choice: Array, prismatic: NDArray[np.bool_]) -> Iterator[Array]:
    """Choices that differ in one or two joints; prismatic joints have no zeros at right angles."""
    for count in (1, 2):
        for joints in combinations(range(prismatic.size), count):
            options = [
                [
                    (direction, zero)
                    for direction in (1.0, -1.0)
                    for zero in ((0.0,) if prismatic[joint] else RIGHT_ANGLES)
                ]
                for joint in joints
            ]
            for values in product(*options):
                neighbour = choice.copy()
                neighbour[:, list(joints)] = np.transpose(values)
                if np.all(np.any(neighbour != choice, axis=0)[list(joints)]):
                    yield neighbour


def _remedies(choice: Array, mapping: Mapping) -> list[str]:
    """Keys of the mapping and their values."""
    direction, zero = choice
    values: dict[str, Array] = {}
    for name in MIRRORED:
        if name not in mapping.signals:
            continue
        source = mapping.signals[name]
        if np.any(direction < 0.0):
            values[f"signals.{name}.factor"] = direction * np.asarray(source.factor)
        if name in SHIFTED and (np.any(zero) or np.any(np.asarray(source.offset) * (direction < 0.0))):
            offset = direction * mapping.offset(name) + zero
            values[f"signals.{name}.offset"] = offset / factors_of("position", source.unit)
    return [
        remark("{}: [{}]", key, joined(", ", [remark("{!r:.5g}", number) for number in numbers.tolist()]))
        for key, numbers in values.items()
    ]
