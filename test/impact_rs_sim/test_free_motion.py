# SPDX-License-Identifier: Apache-2.0
"""Arms that touch nothing move as they do in Bullet, alone or several at a time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from impact_rs_sim.drive import Drive, DriveStart, LinkTorque
from impact_rs_sim.free_motion import FreeStretch, run_free
from impact_rs_sim.mechanics import Mechanics
from impact_rs_sim.model import load_model
from impact_rs_sim.physics import Physics
from impact_rs_sim.scene import ArmState, BodyState

PERIOD, SUBSTEPS, TICKS = 0.00025, 4, 50
FAR = BodyState(np.array([5.0, 5.0, 0.485]), np.eye(3), np.zeros(6))


def stretches(physics: Physics) -> list[FreeStretch]:
    """Two copies of the arm in other states, pulled by a torque that changes."""
    rng = np.random.default_rng(0)
    found = []
    for _ in range(2):
        q = np.array([-0.3, -0.3, 0.5, -2.3, -1.3, 1.4, -0.7]) + 0.1 * rng.standard_normal(7)
        load = physics.robot_model("arm").gravity_torque(q)
        start = DriveStart(load + rng.standard_normal(7), 20.0 * rng.standard_normal(7))
        torque = load + np.cumsum(0.3 * rng.standard_normal((SUBSTEPS * TICKS, 7)), axis=0)
        found.append(FreeStretch(ArmState(q, 0.3 * rng.standard_normal(7)), start, torque, 0.0))
    return found


@pytest.mark.parametrize("drive", [Drive, LinkTorque])
@pytest.mark.parametrize(
    ("effect", "vector"),
    [
        ("joint_coulomb_friction", (0.3,) * 7),
        ("motor_inertia_scale", (1.4,)),
        ("joint_stiffness", (0.7,)),
        ("end_effector_payload", (0.4, 0.02, 0.0, -0.05)),
        ("base_tilt", (0.03, -0.02)),
        ("external_spring", (4.0, -2.0, 3.0, 30.0)),
    ],
)
def test_it_is_what_bullet_does(physics: Physics, drive: type, effect: str, vector: tuple[float, ...]) -> None:
    believed = load_model("nominal").known_effects[effect].apply_vector(physics, np.array(vector))
    copies = stretches(believed)
    paths = run_free(believed, "arm", copies, PERIOD, SUBSTEPS, drive)
    mechanics = Mechanics.load(believed, PERIOD, drive)
    try:
        for copy, path in zip(copies, paths, strict=True):
            mechanics.start({"arm": copy.arm}, {"arm": copy.drive}, FAR, may_sleep=False)
            for tick in range(TICKS):
                rows = slice(SUBSTEPS * tick, SUBSTEPS * (tick + 1))
                mechanics.step({"arm": list(copy.torque[rows])}, SUBSTEPS * PERIOD * tick)
            link, motor = mechanics.links["arm"], mechanics.drives["arm"]
            np.testing.assert_allclose(path.position[-1], link.position, atol=1e-9)
            np.testing.assert_allclose(path.velocity[-1], link.velocity, atol=1e-7)
            np.testing.assert_allclose(path.torque[-1], motor.elastic_torque, atol=1e-6)
            np.testing.assert_allclose(path.motor_velocity[-1], motor.velocity, atol=1e-7)
    finally:
        mechanics.close()


def test_a_copy_does_not_know_of_the_others(physics: Physics) -> None:
    copies = stretches(physics)
    together = run_free(physics, "arm", copies, PERIOD, SUBSTEPS)
    alone = [run_free(physics, "arm", [copy], PERIOD, SUBSTEPS)[0] for copy in copies]
    for one, other in zip(together, alone, strict=True):
        np.testing.assert_allclose(one.velocity, other.velocity, atol=1e-12)


def test_without_torque_of_the_motors_energy_is_what_gravity_makes_of_it(physics: Physics) -> None:
    """A rigid drop: link torque zero, no gravity, no damping: kinetic energy stays."""
    weightless = replace(physics, gravity=np.zeros(3))
    start = stretches(weightless)[0]
    still = np.zeros(7)
    free = replace(start, torque=np.zeros_like(start.torque), drive=DriveStart(still, still))
    (path,) = run_free(weightless, "arm", [free], PERIOD, SUBSTEPS, LinkTorque)
    model = weightless.robot_model("arm")
    energies = [0.5 * dq @ model.mass_matrix(q) @ dq for q, dq in zip(path.position, path.velocity, strict=True)]
    assert energies[-1] == pytest.approx(energies[0], rel=2e-3)
