# SPDX-License-Identifier: Apache-2.0
"""Bullet obeys its settings: gravity, friction of either pair, the pad as a spring, bodies off their centre.

Wherever the pad is meant to stand still, torques hold the arm and it is put back into its state before every step.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from trials import scene_of

from impact_rs_sim.errors import NotABody
from impact_rs_sim.physics import ObjectPhysics, Physics
from impact_rs_sim.plant.bullet_world import BulletWorld
from impact_rs_sim.rotations import yaw_of_quaternions
from impact_rs_sim.scene import ArmState, BodyState

SCENE = scene_of("push", "cat_food", "case_2")
ARM = SCENE.physics.arms["arm"]
POSE = SCENE.arms["arm"].position
THING = SCENE.physics.object
NORMAL = np.array([0.0, -1.0, 0.0])  # out of the pad, into the object
STEP = 1e-4  # s
GRAVITY = 9.81  # m/s^2
HELD = ArmState(POSE, np.zeros_like(POSE))


@contextmanager
def world(physics: Physics, gravity: bool = True, compliant: bool = True, step: float = STEP) -> Iterator[BulletWorld]:
    made = BulletWorld.load(
        physics, time_step=step, gravity=gravity, compliant_pads=compliant, iterations=100, residual_threshold=1e-14
    )
    try:
        yield made
    finally:
        made.close()


def free(**changes: object) -> Physics:
    """The scene without support."""
    return replace(SCENE.physics, support_height=None, **changes)


def away(twist: np.ndarray, rotation: np.ndarray | None = None) -> BodyState:
    """The object far from everything."""
    return BodyState(np.array([0.0, 2.0, 3.0]), np.eye(3) if rotation is None else rotation, twist)


def test_an_arm_accelerates_as_the_rigid_model_says() -> None:
    model = SCENE.models["arm"]
    torque = np.array([3.0, -8.0, 2.0, 6.0, -0.5, 0.4, 0.2])
    with world(free(), step=1e-5) as made:
        made.set_arm("arm", HELD)
        made.set_object(away(np.zeros(6)))
        for _ in range(100):
            made.apply_torque("arm", torque)
            made.step()
        velocity = made.arm_state("arm").velocity
    expected = np.linalg.solve(model.mass_matrix(POSE), torque - model.gravity_torque(POSE)) * 1e-3
    np.testing.assert_allclose(velocity, expected, rtol=2e-2, atol=1e-4)


def holding(physics: Physics, force: float) -> np.ndarray:
    """Torque that holds the arm against gravity and a force on its pad [N m]."""
    model = physics.robot_model("arm")
    return model.gravity_torque(POSE) + force * model.jacobian(POSE)[:3].T @ NORMAL


def pressed(physics: Physics, push: float, along: float = 0.0, time: float = 0.1) -> tuple[np.ndarray, ...]:
    """An object that rests against the pad under an acceleration [m/s^2]: displacement, velocity, force on the pad."""
    physics = replace(physics, gravity=-push * NORMAL + np.array([along, 0.0, 0.0]))
    held = holding(physics, THING.mass * push)
    states, forces = [], []
    with world(physics) as made:
        made.set_object(SCENE.object)
        for _ in range(round(time / STEP)):
            made.set_arm("arm", HELD)
            made.apply_torque("arm", held)
            made.step()
            states.append(made.object_state())
            forces.append(made.pad_force("arm"))
    positions = np.array([state.position for state in states]) - SCENE.object.position
    return positions, np.array([state.twist for state in states]), np.array(forces)


def padded(stiffness: float, damping: float, friction: float = 0.0) -> Physics:
    arm = replace(ARM, pad_stiffness=stiffness, pad_damping=damping)
    return free(arms={"arm": arm}, pad_friction=friction)


@pytest.mark.parametrize("stiffness", [0.5e5, 2.0e5, 8.0e5])
def test_the_pad_yields_by_the_force_over_its_stiffness(stiffness: float) -> None:
    """Static penetration m a / k under a known acceleration, and the force on the pad is m a into it."""
    push = 200.0  # m/s^2
    positions, _, forces = pressed(padded(stiffness, 400.0), push)
    depth = -positions[-100:] @ NORMAL
    assert np.mean(depth) == pytest.approx(THING.mass * push / stiffness, rel=0.03)
    np.testing.assert_allclose(forces[-1], -THING.mass * push * NORMAL, rtol=1e-2, atol=0.5)


@pytest.mark.parametrize(("name", "value"), [("pad_shear_compliance", 1.5e-5), ("pad_creep", 1e-4)])
def test_friction_of_a_pad_that_yields_is_part_of_the_force_on_it(name: str, value: float) -> None:
    push, along = 200.0, 40.0
    physics = padded(2.0e5, 400.0, 0.5)
    physics = replace(physics, arms={"arm": replace(physics.arms["arm"], **{name: value})})
    _, _, forces = pressed(physics, push, along)
    expected = THING.mass * (np.array([along, 0.0, 0.0]) - push * NORMAL)
    np.testing.assert_allclose(forces[-1], expected, rtol=0.02, atol=0.02 * THING.mass * along)


@pytest.mark.parametrize("ratio", [0.1, 0.6])
def test_an_object_on_the_pad_swings_like_a_mass_on_a_damped_spring(ratio: float) -> None:
    """A load that comes on at once: overshoot exp(-pi z / sqrt(1 - z^2)) after half a period pi / w_d."""
    stiffness, push = 2.0e5, 200.0
    damping = 2.0 * ratio * np.sqrt(stiffness * THING.mass)
    positions, _, _ = pressed(padded(stiffness, damping), push, time=0.02)
    depth = -positions @ NORMAL
    root = np.sqrt(1.0 - ratio**2)
    static = THING.mass * push / stiffness
    assert depth.max() / static == pytest.approx(1.0 + np.exp(-np.pi * ratio / root), rel=0.04)
    frequency = np.sqrt(stiffness / THING.mass) * root
    assert STEP * (np.argmax(depth) + 1) == pytest.approx(np.pi / frequency, rel=0.08)


@pytest.mark.parametrize("friction", [0.1, 0.25])
def test_the_pad_holds_up_to_its_friction_and_slips_with_what_is_beyond(friction: float) -> None:
    """Coulomb: at rest while a_t < mu a_n, else sliding with a_t - mu a_n."""
    push, time = 200.0, 0.02
    physics = padded(2.0e5, 400.0, friction)
    _, stuck, _ = pressed(physics, push, 0.5 * friction * push, time)
    _, slid, forces = pressed(physics, push, 3.0 * friction * push, time)
    assert abs(stuck[-1, 0]) < 0.05 * 0.5 * friction * push * time
    expected = (3.0 * friction * push - friction * push) * time
    assert slid[-1, 0] == pytest.approx(expected, rel=0.1)
    assert forces[-1, 0] == pytest.approx(friction * THING.mass * push, rel=0.1)


@pytest.mark.parametrize("direction", [0.0, 20.0, 45.0, 70.0, 135.0, 250.0])
def test_friction_of_a_box_opposes_sliding_in_every_direction(direction: float) -> None:
    along = np.array([np.cos(np.radians(direction)), np.sin(np.radians(direction)), 0.0])
    place = np.array([-0.7, -0.7, SCENE.object.position[2]])  # where the arm is not
    start = BodyState(place, np.eye(3), np.append(0.6 * along, np.zeros(3)))
    with world(SCENE.physics, step=2.5e-4) as made:
        made.set_object(start)
        for _ in range(300):
            made.step()
        state = made.object_state()
    lost = (start.twist - state.twist)[:3]
    assert lost @ along == pytest.approx(SCENE.physics.support_friction * GRAVITY * 0.075, rel=2e-3)
    assert np.linalg.norm(lost - lost @ along * along) < 0.003 * np.linalg.norm(lost)  # 0.2 degrees


def test_a_support_that_gets_another_friction_brakes_a_sliding_box_by_it() -> None:
    """Half of it from halfway on: two slopes of the velocity, mu g each."""
    place = np.array([-0.7, -0.7, SCENE.object.position[2]])
    start = BodyState(place, np.eye(3), np.array([0.5, 0.4, 0.0, 0.0, 0.0, 0.0]))
    with world(SCENE.physics, step=2.5e-4) as made:
        made.set_object(start)
        speeds = [np.linalg.norm(start.twist)]
        for share in (1.0, 0.5):
            made.set_support_friction(share * SCENE.physics.support_friction)
            for _ in range(200):
                made.step()
            speeds.append(np.linalg.norm(made.object_state().twist))
    whole = SCENE.physics.support_friction * GRAVITY * 0.05
    np.testing.assert_allclose(-np.diff(speeds), [whole, 0.5 * whole], rtol=7e-3)  # one step of 200 is late


def offset(com: tuple[float, float, float]) -> Physics:
    return free(object=ObjectPhysics(THING.mass, THING.size, THING.inertia, np.array(com)))


def test_the_state_of_an_object_off_its_centre_reads_back_as_it_was_set() -> None:
    rotation = pin.rpy.rpyToMatrix(0.3, -0.4, 0.7)
    state = away(np.array([0.1, -0.2, 0.3, 1.0, 2.0, -0.5]), rotation)
    with world(offset((0.02, -0.01, 0.03))) as made:
        made.set_object(state)
        found = made.object_state()
    np.testing.assert_allclose(found.position, state.position, atol=1e-9)
    np.testing.assert_allclose(found.rotation, rotation, atol=1e-9)
    np.testing.assert_allclose(found.twist, state.twist, atol=1e-9)


@pytest.mark.parametrize("com", [(0.0, 0.0, 0.0), (0.02, -0.01, 0.03)])
def test_a_tracker_sees_a_tumbling_object_without_jumps(com) -> None:
    poses, positions, rotations = [], [], []
    with world(offset(com), gravity=False) as made:
        made.set_object(away(np.array([0.1, -0.2, 0.3, 0.2, -0.1, 30.0]), pin.rpy.rpyToMatrix(0.3, -0.4, 2.9)))
        for _ in range(3000):
            poses.append(made.object_pose())
            positions.append(made.object_state().position)
            rotations.append(made.object_state().rotation)
            made.step()
        tracked = made.tracked(np.array(poses))
        centre, yaw = tracked[:, :3], yaw_of_quaternions(tracked[:, 3:])
    np.testing.assert_allclose(centre, positions, atol=1e-12)
    np.testing.assert_allclose(np.cos(yaw), [r[0, 0] / np.hypot(r[0, 0], r[1, 0]) for r in rotations], atol=1e-12)
    assert yaw[0] == pytest.approx(2.9)
    assert yaw[-1] > 9.0  # one and a half turns, counted on
    assert np.abs(np.diff(yaw)).max() < 0.01


@pytest.mark.parametrize("side", [0.03, -0.03])
def test_a_push_beside_the_centre_of_mass_tilts_the_object_on_the_pad(side: float) -> None:
    """Left behind by c, it leans by m a c / (K w^2 / 4) on springs in the corners of a pad of width 2 w."""
    push, stiffness = 100.0, 2.0e5
    _, twists, _ = pressed(replace(offset((side, 0.0, 0.0)), arms=padded(stiffness, 400.0).arms), push, time=0.3)
    yaw = STEP * np.cumsum(twists[:, 5])
    half = ARM.end_effector.pad_size[0] / 2.0
    assert np.mean(yaw[-500:]) == pytest.approx(THING.mass * push * side / (stiffness * half**2), rel=0.06)


def test_a_rigid_pad_does_not_yield() -> None:
    physics = free(gravity=-200.0 * NORMAL)
    held = holding(physics, THING.mass * 200.0)
    with world(physics, compliant=False) as made:
        made.set_object(SCENE.object)
        for _ in range(500):
            made.set_arm("arm", HELD)
            made.apply_torque("arm", held)
            made.step()
        depth = -(made.object_state().position - SCENE.object.position) @ NORMAL
    assert abs(depth) < 1e-5 < THING.mass * 200.0 / ARM.pad_stiffness


def test_nothing_damps_a_free_motion() -> None:
    twist = np.array([0.5, -0.2, 0.1, 0.0, 0.0, 3.0])
    with world(free(), gravity=False) as made:
        made.set_object(away(twist))
        made.set_arm("arm", ArmState(POSE, np.zeros_like(POSE)))
        for _ in range(1000):
            made.step()
        np.testing.assert_allclose(made.object_state().twist, twist, atol=1e-6)


def test_an_end_effector_that_is_no_body_is_refused() -> None:
    for effector in (
        replace(ARM.end_effector, mass=-0.1),
        replace(ARM.end_effector, inertia=np.diag([1e-3, 1e-3, 3e-3])),
        replace(ARM.end_effector, inertia=np.diag([1e-3, -1e-3, 1e-3])),
    ):
        with (
            pytest.raises(NotABody, match="no rigid body"),
            world(free(arms={"arm": replace(ARM, end_effector=effector)})),
        ):
            pass
