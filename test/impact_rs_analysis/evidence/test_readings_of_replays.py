# SPDX-License-Identifier: Apache-2.0
"""A replay with the right sensor model explains a run of which a reading is wrong, and without it does not.

The readings are made wrong here by other means than the sensor models: loops over samples, and shifted stamps.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
import scipy.signal

from impact_rs_sim.effects import library
from impact_rs_sim.robots.robot import Array
from impact_rs_trials.runs import ArmSignals, Run

from .conftest import residuals, with_signals

Fault = Callable[[Run], Run]


def of_arm(change: Callable[[ArmSignals], ArmSignals]) -> Fault:
    return lambda run: with_signals(run, change)


def changed(values: Array, joint: int, scale: float = 1.0, offset: float = 0.0) -> Array:
    found = values.copy()
    found[:, joint] = scale * found[:, joint] + offset
    return found


def filtered(values: Array, lag: float) -> Array:
    """T dy/dt + y = u in steps of 1 ms, by the trapezoidal rule."""
    found = values.copy()
    for k in range(1, len(values)):
        found[k] = ((lag - 5e-4) * found[k - 1] + 5e-4 * (values[k] + values[k - 1])) / (lag + 5e-4)
    return found


def butterworth(values: Array, delay: float) -> Array:
    b, a = scipy.signal.butter(2, np.sqrt(2.0) / (2.0 * np.pi * delay), fs=1000.0)
    found, _ = scipy.signal.lfilter(b, a, values, axis=0, zi=np.outer(scipy.signal.lfilter_zi(b, a), values[0]))
    return np.asarray(found)


def late(values: Array, samples: int) -> Array:
    return np.concatenate((np.repeat(values[:1], samples, axis=0), values[:-samples]))


def turned(run: Run, yaw: float, x: float, y: float) -> Run:
    turn = pin.rpy.rpyToMatrix(0.0, 0.0, yaw)
    q = run.signals.object_quaternion
    poses = [pin.Quaternion(turn @ pin.Quaternion(row).matrix()).coeffs() for row in q]
    signs = np.sign(np.sum(np.array(poses) * np.vstack((poses[:1], poses[:-1])), axis=1)).cumprod()
    moved = run.signals.object_position @ turn.T + [x, y, 0.0]
    return replace(
        run, signals=replace(run.signals, object_position=moved, object_quaternion=np.array(poses) * signs[:, None])
    )


def at_a_point(run: Run, x: float, y: float) -> Run:
    axes = [pin.Quaternion(row).matrix() for row in run.signals.object_quaternion]
    moved = run.signals.object_position + np.array([axis @ [x, y, 0.0] for axis in axes])
    return replace(run, signals=replace(run.signals, object_position=moved))


def tracked_later(run: Run, delay: float) -> Run:
    return replace(run, signals=replace(run.signals, object_time=run.signals.object_time + delay))


def crosstalk(arm: ArmSignals) -> ArmSignals:
    torque = arm.torque.copy()
    torque[:, 2] += 0.04 * arm.torque[:, 1]
    torque[:, 1] -= 0.03 * arm.torque[:, 2]
    return replace(arm, torque=torque)


FAULTS: dict[str, tuple[Fault, dict[str, float]]] = {
    "encoder_offset": (
        of_arm(lambda arm: replace(arm, position=changed(arm.position, 3, offset=0.01))),
        {"offset_joint4": 0.01},
    ),
    "encoder_scale": (
        of_arm(
            lambda arm: replace(arm, position=changed(arm.position, 3, 1.01), velocity=changed(arm.velocity, 3, 1.01))
        ),
        {"scale_joint4": 1.01},
    ),
    "motor_encoder_offset": (
        of_arm(lambda arm: replace(arm, motor_position=changed(arm.motor_position, 1, offset=-0.003))),
        {"offset_joint2": -0.003},
    ),
    "torque_sensor_gain": (
        of_arm(lambda arm: replace(arm, torque=changed(arm.torque, 1, 0.95))),
        {"gain_joint2": 0.95},
    ),
    "torque_sensor_offset": (
        of_arm(lambda arm: replace(arm, torque=changed(arm.torque, 4, offset=0.4))),
        {"offset_joint5": 0.4},
    ),
    "torque_sensor_crosstalk": (of_arm(crosstalk), {"from_previous_joint3": 0.04, "from_next_joint2": -0.03}),
    "torque_sensor_lag": (of_arm(lambda arm: replace(arm, torque=filtered(arm.torque, 0.015))), {"lag": 0.015}),
    "torque_sensor_butterworth": (
        of_arm(lambda arm: replace(arm, torque=butterworth(arm.torque, 0.015))),
        {"lag": 0.015},
    ),
    "command_clock_offset": (
        lambda run: run.commands_later(dict.fromkeys(run.signals.arms, 0.004)),
        {"offset": -0.004},
    ),
    "velocity_lag": (of_arm(lambda arm: replace(arm, velocity=filtered(arm.velocity, 0.012))), {"lag": 0.012}),
    "velocity_butterworth": (
        of_arm(lambda arm: replace(arm, velocity=butterworth(arm.velocity, 0.012))),
        {"lag": 0.012},
    ),
    "velocity_delay": (of_arm(lambda arm: replace(arm, velocity=late(arm.velocity, 6))), {"delay": 0.006}),
    "velocity_gain": (
        of_arm(lambda arm: replace(arm, velocity=changed(arm.velocity, 1, 1.05))),
        {"gain_joint2": 1.05},
    ),
    "tracker_frame": (lambda run: turned(run, 0.02, 0.004, -0.012), {"x": 0.004, "y": -0.012, "yaw": 0.02}),
    "tracked_point": (lambda run: at_a_point(run, 0.01, -0.004), {"x": 0.01, "y": -0.004}),
    "tracker_delay": (lambda run: tracked_later(run, 0.012), {"delay": 0.012}),
}


@pytest.mark.parametrize("name", FAULTS)
def test_a_sensor_model_explains_a_wrong_reading(hit: Run, name: str) -> None:
    """Kills a wrong sign of any sensor model, and one that corrects the start or makes readings alone."""
    spoil, parameters = FAULTS[name]
    effect = library()[name]
    vector = effect.nominal(7)
    for index, scalar in enumerate(effect.scalars(7)):
        vector[index] = parameters.get(scalar.name, vector[index])
    assert set(parameters) <= {scalar.name for scalar in effect.scalars(7)}
    wrong = spoil(hit)
    right, without, with_it = (
        np.concatenate(list(residuals(run, physics).values()))
        for run, physics in ((hit, None), (wrong, None), (wrong, effect.apply_vector(hit.physics, vector)))
    )
    left = float(np.sum(np.square(with_it - right)))
    assert left < 0.02 * float(np.sum(np.square(without - right)))


def test_the_start_behind_a_filter_of_second_order_is_corrected_by_the_curvature_of_the_readings(free: Run) -> None:
    """Of a fast motion; kills a start to first order, which leaves 2.5e-4 of the squares."""
    effect = library()["velocity_butterworth"]
    wrong = with_signals(free, lambda arm: replace(arm, velocity=butterworth(arm.velocity, 0.012)))
    right, without, with_it = (
        np.concatenate(list(residuals(run, physics).values()))
        for run, physics in ((free, None), (wrong, None), (wrong, effect.apply_vector(free.physics, np.array([0.012]))))
    )
    assert float(np.sum(np.square(with_it - right))) < 1.5e-4 * float(np.sum(np.square(without - right)))
