# SPDX-License-Identifier: Apache-2.0
"""Effects outside the library do what they say: a dead zone, friction that grows, mass that comes along late."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from trials import plan_of

from impact_rs_control.closed_loop import make_plant
from impact_rs_control.plan import TrialPlan
from impact_rs_sim.drive import Drive
from impact_rs_sim.plant import Plant, PlantExtension
from impact_rs_sim.scene import ArmState
from impact_rs_sim.unmodelled import LAWS, OUTSIDE, Backlash, DriftingFriction, TorqueRipple


@pytest.fixture(scope="module")
def plan() -> TrialPlan:
    return plan_of("push", "juice", "case_1")


class Posed:
    """Stands for a plant at one moment."""

    def __init__(self, plan: TrialPlan, velocity: float, time: float = 0.0) -> None:
        self.physics = plan.scene.physics
        self.time = time
        self._state = ArmState(plan.arms["arm"].initial, np.full(7, velocity))

    def link_state(self, arm: str) -> ArmState:
        return self._state


def test_a_transmission_with_play_carries_what_is_beyond_it(plan: TrialPlan) -> None:
    arm = plan.scene.physics.arms["arm"]
    play = 3e-4
    for stretch, passed in ((0.5 * play, 0.0), (-0.9 * play, 0.0), (4.0 * play, 3.0 * play), (-2.0 * play, -play)):
        drive = Drive(replace(arm, damping=np.zeros(7)), 2.5e-4)
        drive.position = np.full(7, stretch)
        drive.sense(np.zeros(7), np.zeros(7))
        Backlash(1.0, 0).after_sense(Posed(plan, 0.0), "arm", drive)
        np.testing.assert_allclose(drive.elastic_torque, arm.stiffness * passed, atol=1e-9)
        np.testing.assert_allclose(drive.transmission_torque, arm.stiffness * passed, atol=1e-9)


def test_drifting_friction_opposes_motion_and_grows_with_time_and_repeat(plan: TrialPlan) -> None:
    def torque(velocity: float, time: float, repeat: int, magnitude: float = 1.0) -> float:
        found = DriftingFriction(magnitude, repeat).joint_torque(Posed(plan, velocity, time), "arm")
        assert np.ptp(found) == 0.0
        return float(found[0])

    assert torque(1.0, 0.0, 0) == pytest.approx(-0.3 * 0.2)
    assert torque(-1.0, 0.0, 0) == pytest.approx(0.3 * 0.2)
    assert torque(1.0, 1.5, 0) - torque(1.0, 0.5, 0) == pytest.approx(-0.3)
    assert torque(1.0, 0.0, 2) - torque(1.0, 0.0, 0) == pytest.approx(-0.3)
    assert torque(1.0, 0.0, 0, 2.0) == pytest.approx(2.0 * torque(1.0, 0.0, 0))
    assert torque(0.0, 1.0, 1) == 0.0


def test_torque_ripple_repeats_sixty_times_a_turn_and_does_no_work(plan: TrialPlan) -> None:
    def torque(ahead: float) -> float:
        posed = Posed(plan, 0.3)
        posed._state = ArmState(np.full(7, ahead), np.zeros(7))
        return float(TorqueRipple(2.0, 0).joint_torque(posed, "arm")[0])

    period = 2.0 * np.pi / 60.0
    assert torque(0.7 + period) == pytest.approx(torque(0.7))
    found = [torque(ahead) for ahead in np.linspace(0.0, period, 200, endpoint=False)]
    assert max(found) == pytest.approx(0.2, rel=1e-3)
    assert np.mean(found) == pytest.approx(0.0, abs=1e-12)


def test_a_lubricated_support_brakes_more_the_faster_the_object_slides(plan: TrialPlan) -> None:
    """dv/dt = -mu g (1 + s v) from v0: (1 + s v) falls as exp(-s mu g t), in closed form."""
    slope, duration = 0.5 * 4.0, 0.1
    extension = OUTSIDE["lubricated_support"](4.0, 0)
    plant = make_plant(plan, 0, extension=extension)
    state = plant.world.object_state()
    plant.world.set_object(
        replace(state, position=state.position - [0.7, 0.5, 0.0], twist=np.array([0.8, 0.6, 0.0, 0.0, 0.0, 0.0]))
    )
    hold = plan.scene.models["arm"].gravity_torque(plan.arms["arm"].initial)
    for _ in range(round(duration / 0.001)):
        plant.step({"arm": hold})
    left = float(np.linalg.norm(plant.world.object_state().twist[:2]))
    braking = slope * plant.physics.support_friction * 9.81 * duration
    assert left == pytest.approx(((1.0 + slope) * np.exp(-braking) - 1.0) / slope, rel=0.02)
    plant.close()


def settled(plan: TrialPlan, extension: PlantExtension | None) -> Plant:
    """A plant that has held its pose for a tenth of a second."""
    plant = make_plant(plan, 0, extension=extension)
    hold = plan.scene.models["arm"].gravity_torque(plan.arms["arm"].initial)
    for _ in range(100):
        plant.step({"arm": hold})
    return plant


def test_loose_contents_are_a_part_of_the_mass_and_rest_on_the_object(plan: TrialPlan) -> None:
    extension = OUTSIDE["loose_contents"](1.0, 0)
    plant = settled(plan, extension)
    client = plant.world.client
    bodies = range(client.getNumBodies())
    movable = {body: client.getDynamicsInfo(body, -1)[0] for body in bodies if body not in plant.world.arms.values()}
    inside = {body: mass for body, mass in movable.items() if mass > 0.0}
    assert sum(inside.values()) == pytest.approx(plan.scene.physics.object.mass)
    assert inside[plant.world.object] == pytest.approx(0.8 * plan.scene.physics.object.mass)
    (slab,) = set(inside) - {plant.world.object}
    top = plant.world.object_state().position[2] + plan.scene.physics.object.size[2] / 2.0
    assert client.getBasePositionAndOrientation(slab)[0][2] == pytest.approx(top + 0.01, abs=5e-4)
    plant.close()


def test_a_flexible_base_is_still_where_nothing_pushes_it(plan: TrialPlan) -> None:
    plant = settled(plan, None)
    plain = plant.truth().arms["arm"].position
    plant.close()
    plant = settled(plan, OUTSIDE["flexible_base"](1.0, 0))
    np.testing.assert_allclose(plant.truth().arms["arm"].position, plain, atol=1e-4)
    plant.close()


@pytest.mark.parametrize("name", OUTSIDE)
def test_a_larger_outside_effect_changes_a_trial_more(plan: TrialPlan, name: str) -> None:
    """Seen where the arm is after it was driven into the object by the same torques."""
    short = plan.scene.scenario.timing.model_copy(update={"duration": 0.5, "nominal_impact": 0.3, "approach": 0.3,
                                                          "window_after": 0.1})  # fmt: skip
    scenario = plan.scene.scenario.model_copy(update={"timing": short})
    arm = plan.scene.arms["arm"]
    model = plan.scene.models["arm"]
    driven = replace(
        plan,
        scene=replace(plan.scene, scenario=scenario),
        arms={"arm": replace(plan.arms["arm"], initial=arm.position)},
    )
    push = model.gravity_torque(arm.position) + model.jacobian(arm.position)[:3].T @ np.array([0.0, -25.0, 0.0])
    ends = []
    for extension in (None, OUTSIDE[name](1.0, 1), OUTSIDE[name](4.0, 1)):
        plant = make_plant(driven, 0, extension=extension)
        for _ in range(250):
            plant.step({"arm": push})
        ends.append(np.append(plant.truth().arms["arm"].position, plant.world.object_state().position))
        plant.close()
    small, large = (np.linalg.norm(end - ends[0]) for end in ends[1:])
    assert 1e-6 < small < large


@pytest.mark.parametrize(("scenario", "name", "case"), [("excite", "none", "slow"), ("push", "juice", "case_1")])
def test_a_spring_pulls_the_object_that_is_hit_and_none_out_of_reach(scenario: str, name: str, case: str) -> None:
    plan = plan_of(scenario, name, case)
    plant = make_plant(plan, 0, extension=LAWS["object_spring_from_place"](4000.0, 0))
    position = plant.world.object_state().position - [0.0, 0.3, 0.0]
    plant.world.set_object(replace(plant.world.object_state(), position=position))
    hold = plan.scene.models["arm"].gravity_torque(plan.arms["arm"].initial)
    for _ in range(20):
        plant.step({"arm": hold})
    moved = plant.world.object_state().position - position
    plant.close()
    assert moved[1] > 1e-3 if scenario == "push" else np.linalg.norm(moved) < 1e-4
