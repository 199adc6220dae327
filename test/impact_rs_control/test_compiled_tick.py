# SPDX-License-Identifier: Apache-2.0
"""The compiled arithmetic of a control tick is what NumPy makes of the same equations, to rounding."""

from __future__ import annotations

import copy
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from trials import plan_of

from impact_rs_control.closed_loop import make_plant, run_closed_loop
from impact_rs_control.controller import IDLE_WEIGHT, Mode
from impact_rs_control.detection import BASELINE_TIME
from impact_rs_control.plan import TrialPlan
from impact_rs_sim import _kernel
from impact_rs_sim.robot_model import RigidTerms


class Reference:
    """The controller of one arm in NumPy, away from limits; modes are given."""

    def __init__(self, plan: TrialPlan, name: str) -> None:
        self.scenario, self.plan = plan.scene.scenario, plan.arms[name]
        self.model = plan.scene.physics.robot_model(name)
        self.motor_inertia = np.diag(plan.scene.physics.arms[name].motor_inertia_reduced)
        self.integral: np.ndarray | None = None
        self.residual, self.baseline = np.zeros(self.model.joint_count), 0.0

    def wrench(self, q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
        period, settings = self.scenario.timing.control_period, self.scenario.control.detection
        terms = self.model.terms(q, dq)
        coriolis = pin.computeCoriolisMatrix(self.model.pinocchio, self.model.data, q, dq)
        momentum = terms.mass_matrix @ dq
        self.integral = momentum.copy() if self.integral is None else self.integral
        self.integral += period * (torque + coriolis.T @ dq - (terms.bias - coriolis @ dq) + self.residual)
        self.residual = settings.observer_gain * (momentum - self.integral)
        response = terms.jacobian @ np.linalg.inv(terms.mass_matrix)
        found = np.linalg.solve(response @ terms.jacobian.T, response @ self.residual)
        force = -float(self.plan.approach_direction @ found[:3]) - self.baseline
        if force < settings.threshold:
            self.baseline += period / BASELINE_TIME * force
        return found

    def torque(self, tick: int, mode: Mode, gamma: float, q: np.ndarray, dq: np.ndarray) -> np.ndarray:
        plan, gains = self.plan, self.scenario.control.gains
        terms, held, after = self.model.terms(q, dq), list(self.plan.posture), mode is not Mode.ANTE
        position = plan.post_position if after else plan.ante_position
        posture = plan.post_posture if after else plan.ante_posture
        k_theta = gains.orientation_post if after else gains.orientation
        gain = np.repeat((gains.position, k_theta, gains.posture), (3, 3, len(held)))
        tilt = terms.rotation @ pin.log3(terms.rotation.T @ plan.orientation[tick])
        error = np.concatenate((position.position[tick] - terms.position, tilt, posture.position[tick] - q[held]))
        turning = [plan.pad_normal * part[tick, 0] for part in (plan.rotation.velocity, plan.rotation.acceleration)]
        wanted = np.concatenate((position.velocity[tick], turning[0], posture.velocity[tick]))
        moving = np.concatenate((terms.jacobian @ dq, dq[held]))
        feedback = 2.0 * np.sqrt(gain) * gamma * (wanted - moving) + gain * error
        ahead = np.concatenate((position.acceleration[tick], turning[1], posture.acceleration[tick]))
        friction = (plan.post_friction if after else plan.ante_friction)[tick]
        inertia = terms.mass_matrix + self.motor_inertia
        rows = np.vstack((terms.jacobian, np.eye(self.model.joint_count)[held]))
        targets = ahead + feedback + friction - np.concatenate((terms.drift, np.zeros(len(held))))
        if after:
            targets += rows @ np.linalg.solve(inertia, terms.jacobian.T @ plan.wrench[tick])
        weights = np.repeat((gains.position_weight, gains.orientation_weight, gains.posture_weight), (3, 3, len(held)))
        if len(rows) < self.model.joint_count:
            rows = np.vstack((rows, np.eye(self.model.joint_count)))
            targets = np.concatenate((targets, -2.0 * np.sqrt(gains.posture) * dq))
            weights = np.concatenate((weights, np.full(self.model.joint_count, IDLE_WEIGHT)))
        hessian = rows.T * weights @ rows + 1e-9 * np.eye(self.model.joint_count)
        return inertia @ np.linalg.solve(hessian, rows.T * weights @ targets) + terms.bias


@pytest.mark.parametrize(("name", "object_name", "case"), [("push", "cat_food", "case_2"), ("grab", "juice", "case_1")])
def test_torque_and_wrench_are_those_of_numpy_through_all_modes(name: str, object_name: str, case: str) -> None:
    plan = plan_of(name, object_name, case)
    references = {arm: Reference(plan, arm) for arm in plan.arms}
    plant, modes = make_plant(plan, 4), set()
    for tick in run_closed_loop(plan, plant):
        for arm, measured in tick.measurement.arms.items():
            command, reference = tick.commands[arm], references[arm]
            q, dq = measured.position, measured.velocity
            np.testing.assert_allclose(
                command.wrench, reference.wrench(q, dq, measured.torque), rtol=0.0, atol=1e-9
            )  # N, N m
            expected = reference.torque(tick.number, command.mode, command.gamma, q, dq)
            np.testing.assert_allclose(command.torque, expected, rtol=0.0, atol=1e-11)  # N m
            modes.add(command.mode)
    plant.close()
    assert modes == set(Mode)


@pytest.mark.parametrize("angle", [1e-9, 0.3, 1.9, 2.2, 2.8, 3.14, 3.5, 4.2])
def test_an_orientation_error_is_the_shortest_turn_whatever_its_size(angle: float) -> None:
    """Beyond 120 degrees the compiled tick takes another branch, and beyond 180 the turn the other way round."""
    rng, nothing = np.random.default_rng(round(1e3 * angle)), np.zeros(6)
    for _ in range(20):
        axis = rng.standard_normal(3)
        axes = pin.exp3(rng.standard_normal(3))
        wanted = axes @ pin.exp3(angle * axis / np.linalg.norm(axis))
        phase = (np.zeros((1, 3)), np.zeros((1, 6)), np.zeros((1, 6)), np.ones(6))
        law = _kernel.TaskLaw(np.ones(6), (), phase, phase, wanted[None], np.zeros((1, 6)), idle_rate=0.0, idle=False)
        terms = RigidTerms(np.eye(6), nothing, np.eye(6), nothing, np.zeros(3), axes, nothing)
        tilt = law.decide(0, False, 0.0, nothing, nothing, terms)[0][3:]
        np.testing.assert_allclose(tilt, axes @ pin.log3(axes.T @ wanted), atol=1e-9)


def arrays(told: Any) -> list[np.ndarray]:
    """Every array in a message, however deep."""
    if isinstance(told, np.ndarray):
        return [told]
    if isinstance(told, dict):
        return [found for value in told.values() for found in arrays(value)]
    if is_dataclass(told):
        return [found for field in fields(told) for found in arrays(getattr(told, field.name))]
    return []


def test_what_a_tick_told_stays_as_it_was_when_the_trial_goes_on() -> None:
    plan = plan_of("push", "cat_food", "case_2")
    plant, kept, as_it_was = make_plant(plan, 0), [], []
    for tick in run_closed_loop(plan, plant):
        told = (tick.measurement, tick.commands, plant.truth())
        kept.append([found for part in told for found in arrays(part)])
        as_it_was.append(copy.deepcopy(kept[-1]))
        if tick.number == 950:
            break
    plant.close()
    assert len(kept[0]) > 15
    for now, then in zip(kept, as_it_was, strict=True):
        for one, other in zip(now, then, strict=True):
            np.testing.assert_array_equal(one, other)
