# SPDX-License-Identifier: Apache-2.0
"""The twin moves as the plant does in a push and in a grab; refined, the two come closer."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from impact_rs_sim.bullet_mechanics import BulletMechanics
from impact_rs_sim.drive import DriveStart
from impact_rs_sim.robot import Array
from impact_rs_sim.scenario import load_scenario
from impact_rs_sim.scene import ArmState, Scene
from impact_rs_sim.twin import Result, TwinJob, simulate

PERIOD, TICKS, SUBSTEPS = 0.00025, 80, 4
BEFORE = 0.01  # s, from the start to the contact


@dataclass(frozen=True)
class Hit:
    """The start of a hit at the nominal impact configuration, held by the torque of gravity."""

    scene: Scene
    arms: dict[str, ArmState]
    drives: dict[str, DriveStart]
    torque: dict[str, Array]

    @staticmethod
    def of(name: str) -> Hit:
        scenario = load_scenario(name)
        scene = Scene.resolve(scenario, next(iter(scenario.objects)), next(iter(scenario.cases)))
        arms, drives, torque = {}, {}, {}
        for arm, state in scene.arms.items():
            q = state.position - BEFORE * state.velocity
            load = scene.physics.robot_model(arm).gravity_torque(q)
            arms[arm] = ArmState(q, state.velocity)
            drives[arm], torque[arm] = DriveStart(load, np.zeros_like(q)), load
        return Hit(scene, arms, drives, torque)

    def by_twin(self, factor: int = 1) -> Result:
        periods = TICKS * SUBSTEPS * factor
        job = TwinJob(
            self.scene.physics,
            self.arms,
            self.drives,
            {name: torque[None] for name, torque in self.torque.items()},
            dict.fromkeys(self.arms, np.zeros(periods, dtype=np.int32)),
            np.arange(TICKS + 1) * (PERIOD * SUBSTEPS),
            PERIOD / factor,
            object=self.scene.object,
        )
        (result,) = simulate([job])
        assert not result.failed and not result.failure
        return result

    def by_plant(self, factor: int = 1) -> tuple[dict[str, Array], Array]:
        """Joint velocities and twist of the object at the end."""
        mechanics = BulletMechanics.load(self.scene.physics, PERIOD / factor)
        try:
            mechanics.start(self.arms, self.drives, self.scene.object)
            for _ in range(TICKS):
                mechanics.step(self.torque, SUBSTEPS * factor, 0.0)
            speeds = {name: link.velocity for name, link in mechanics.links.items()}
            return speeds, mechanics.world.object_state().twist
        finally:
            mechanics.close()


@pytest.mark.parametrize(("scenario", "speed", "turning"), [("push", 1e-4, 1e-3), ("grab", 3e-4, 2e-3)])
def test_a_hit_goes_on_as_in_the_plant(scenario: str, speed: float, turning: float) -> None:
    """At 64 kHz, 70 ms after the first contact."""
    hit = Hit.of(scenario)
    result, (speeds, twist) = hit.by_twin(16), hit.by_plant(16)
    assert np.linalg.norm(twist[:3]) > 0.2
    np.testing.assert_allclose(result.twists[-1, :3], twist[:3], atol=speed)
    for name, arm in result.arms.items():
        np.testing.assert_allclose(arm.velocity[-1], speeds[name], atol=turning)


def test_at_4_khz_the_twin_is_nearer_to_the_fine_plant_than_the_plant_is() -> None:
    """The plant's implicit spring damps by h k; the twin's does not."""
    hit = Hit.of("push")
    fine, coarse, twin = hit.by_plant(8)[1], hit.by_plant()[1], hit.by_twin().twists[-1]
    assert np.abs(twin - fine)[:3].max() < 0.5 * np.abs(coarse - fine)[:3].max()
