# SPDX-License-Identifier: Apache-2.0
"""Forward dynamics against other integrators and laws of conservation.

The pendulum's equation of motion is written down by hand, and solved by SciPy to ten digits.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import scipy
from slender_arm import mapping_of, slender_arm, with_effects

from impact_rs_sim.forward_dynamics import ForwardDynamics
from impact_rs_sim.physics import Load, LoadState, Physics
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_trials.recordings.recording import ARM

INERTIA, WEIGHT = 0.03 + 2.0 * 0.2**2, 2.0 * 9.81 * 0.2  # kg m^2, N m: a link of 2 kg, 0.2 m from the axis
START = np.array([[0.3], [-0.9], [1.2]]), np.array([[0.0], [1.0], [-2.0]])  # rad, rad/s
SECONDS = 1.0
Friction = Callable[[np.ndarray], np.ndarray]


def arm(folder: Path, joints: int, effects: dict[str, dict[str, float]] | None = None) -> Physics:
    mapping = mapping_of(folder, slender_arm(("revolute",) * joints), torque_measured_at="motor")
    return with_effects(mapping, effects or {})


def torque(time: np.ndarray) -> np.ndarray:
    return 3.0 * np.sin(4.0 * time) + 1.0


def rolled(physics: Physics, step: float) -> np.ndarray:
    """Positions after SECONDS, with torques as means over the steps."""
    edges = step * np.arange(round(SECONDS / step) + 1)
    impulse = -0.75 * np.cos(4.0 * edges) + edges
    driving = np.tile((np.diff(impulse) / step)[:, None, None], (1, len(START[0]), 1))
    q, _ = ForwardDynamics(physics, ARM).motion(np.zeros(len(START[0])), *START, driving, step)
    return q[-1, :, 0]


def pendulum(friction: Friction) -> np.ndarray:
    """Positions after SECONDS by SciPy: (I + B) ddq = tau - m g c cos q - friction, with B = 0."""

    def motion(t: float, state: np.ndarray) -> list[float]:
        q, dq = state
        return [dq, (torque(t) - WEIGHT * np.cos(q) - friction(dq)) / INERTIA]

    starts = zip(*(start[:, 0] for start in START), strict=True)
    solved = [scipy.integrate.solve_ivp(motion, (0.0, SECONDS), one, "LSODA", rtol=1e-10, atol=1e-12) for one in starts]
    return np.array([way.y[0, -1] for way in solved])


@pytest.mark.parametrize(
    ("effects", "friction"),
    [
        ({}, lambda dq: 0.0 * dq),
        ({"joint_viscous_friction": {"viscous_joint1": 0.4}}, lambda dq: 0.4 * dq),
    ],
)
def test_the_error_falls_with_the_square_of_the_step(
    effects: dict[str, dict[str, float]], friction: Friction, tmp_path: Path
) -> None:
    """Kills every wrong sign of torque, gravity and friction, and a stage of the step with another weight."""
    physics, exact = arm(tmp_path, 1, effects), pendulum(friction)
    errors = np.array([np.abs(rolled(physics, step) - exact).max() for step in (0.02, 0.01, 0.005)])
    assert errors[-1] < 2e-3  # rad, of motions of 1 rad
    np.testing.assert_allclose(np.log2(errors[:-1] / errors[1:]), 2.0, atol=0.25)


def test_dry_friction_is_followed_through_reversals_without_tiny_steps(tmp_path: Path) -> None:
    """The slope of friction at rest is 1,800 /s of the pendulum: an explicit step of 5 ms is unstable beyond 400 /s.

    Kills a step that leaves out the slope.
    """
    physics = arm(tmp_path, 1, {"joint_coulomb_friction": {"coulomb_joint1": 1.0}})
    exact = pendulum(lambda dq: 1.0 * np.tanh(dq / 0.005))
    errors = [np.abs(rolled(physics, step) - exact).max() for step in (0.005, 0.00125)]
    assert errors[0] < 0.01 and errors[1] < 0.3 * errors[0], errors


def test_a_joint_that_sticks_stays_where_it_is(tmp_path: Path) -> None:
    """Kills a friction that shakes the joint: 6 N m hold the weight, at steps a hundred times its time constant."""
    physics = arm(tmp_path, 1, {"joint_coulomb_friction": {"coulomb_joint1": 6.0}})
    start = np.array([[0.3]]), np.array([[0.5]])
    q, dq = ForwardDynamics(physics, ARM).motion(np.zeros(1), *start, np.zeros((200, 1, 1)), 0.01)
    assert np.abs(dq[-100:]).max() < 0.01  # rad/s, of the order of the smoothing
    assert np.ptp(q[-100:]) < 0.01


def test_energy_is_kept_and_time_runs_backwards_without_friction(tmp_path: Path) -> None:
    """Three joints swing freely for a second; kills an inertia or a Coriolis torque of another state."""
    physics = arm(tmp_path, 3)
    dynamics = ForwardDynamics(physics, ARM)
    model, data = dynamics.model.pinocchio, dynamics.model.data
    start = np.array([[0.4, -0.8, 0.5]]), np.array([[1.0, -1.5, 2.0]])

    def swing(states: tuple[np.ndarray, np.ndarray], step: float) -> tuple[np.ndarray, np.ndarray]:
        return dynamics.motion(np.zeros(1), *states, np.zeros((round(SECONDS / step), 1, 3)), step)

    def energy(q: np.ndarray, dq: np.ndarray) -> float:
        return float(pin.computeKineticEnergy(model, data, q, dq) + pin.computePotentialEnergy(model, data, q))

    lost, returned = [], []
    for step in (0.002, 0.001):
        q, dq = swing(start, step)
        lost.append(np.ptp([energy(*state) for state in zip(q[:, 0], dq[:, 0], strict=True)]))
        returned.append(np.abs(swing((q[-1], -dq[-1]), step)[0][-1] - start[0]).max())
    assert lost[0] < 0.02 and lost[1] < 0.3 * lost[0]  # J, of some 10 J that go to and fro
    assert returned[0] < 0.02 and returned[1] < 0.3 * returned[0]  # rad


def test_a_constant_torque_error_grows_with_the_square_of_the_time(tmp_path: Path) -> None:
    """dq = (M + B)^-1 dtau t^2 / 2 while the arm has hardly moved; kills a motor inertia that is left out."""
    physics = arm(tmp_path, 3, {"added_motor_inertia": {f"inertia_joint{joint}": 0.2 for joint in (1, 2, 3)}})
    dynamics = ForwardDynamics(physics, ARM)
    q = np.array([[0.4, -0.8, 0.5]])
    error, step, steps = np.array([0.05, -0.02, 0.01]), 0.005, 10
    held = np.tile(dynamics.model.gravity_torque(q[0]), (steps, 1, 1))
    ways = [dynamics.motion(np.zeros(1), q, 0.0 * q, driving, step)[0] for driving in (held, held + error)]
    inertia = RobotModel(physics.arms[ARM].facts, physics.arms[ARM].end_effector).mass_matrix(q[0]) + 0.2 * np.eye(3)
    expected = np.linalg.solve(inertia, error) * (steps * step) ** 2 / 2.0
    np.testing.assert_allclose((ways[1] - ways[0])[-1, 0], expected, rtol=0.02)


def test_loads_of_formulas_act_as_friction_does(tmp_path: Path) -> None:
    """A user's law that is Coulomb friction; kills a load that is left out, or whose slope is."""
    physics = arm(tmp_path, 1, {"joint_coulomb_friction": {"coulomb_joint1": 1.0}})
    lawful = replace(physics.arms[ARM], friction=arm(tmp_path, 1).arms[ARM].friction, loads=(DryFriction(),))
    other = replace(physics, arms={ARM: lawful})
    np.testing.assert_allclose(rolled(other, 0.005), rolled(physics, 0.005), atol=1e-9)


class DryFriction(Load):
    """Coulomb friction of 1 N m."""

    def motor_torque(self, state: LoadState) -> np.ndarray:
        return -np.tanh(state.joint_velocity / 0.005)
