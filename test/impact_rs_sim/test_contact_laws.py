# SPDX-License-Identifier: Apache-2.0
"""Laws of a single contact point, against closed forms of a ball and against balances of any body."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
import scipy
from ball_impacts import HOLLOW, MASS, RADIUS, SOLID, Racket, bounced, thrown
from impact_table_cases import cube, tossed

from impact_rs_sim.effects import library
from impact_rs_sim.effects.contact import hunt_crossley_restitution
from impact_rs_sim.impact_map.measured import MeasuredImpact, MeasuredImpacts, points_on_plane, solve_measured
from impact_rs_sim.impact_map.problem import ImpactMapError
from impact_rs_sim.impact_map.solve import ExactEngine
from impact_rs_sim.physics import ObjectPhysics, Physics
from impact_rs_sim.scene import BodyState
from impact_rs_sim.shapes import SPHERE
from impact_rs_sim.twist_readings import TwistReadings

UP = np.array([0.0, 0.0, 1.0])
BELOW = np.array([0.0, 0.0, -RADIUS])


def ball(share: float = HOLLOW, friction: float = 0.2, restitution: float = 0.5) -> Physics:
    """A ball over a plane."""
    inertia = np.full(3, share * MASS * RADIUS**2)
    item = ObjectPhysics(MASS, np.full(3, 2.0 * RADIUS), inertia, np.zeros(3), SPHERE)
    return Physics({}, item, None, (np.inf, np.inf), friction, 0.0, restitution)


def with_effects(physics: Physics, **effects: tuple[float, ...]) -> Physics:
    for name, values in effects.items():
        physics = library()[name].apply_vector(physics, np.array(values))
    return physics


def impact_of(twist: np.ndarray) -> MeasuredImpact:
    """A ball that touches below its centre."""
    return MeasuredImpact({}, BodyState(np.zeros(3), np.eye(3), twist), points_on_plane([BELOW], UP))


def after(physics: Physics, twist: np.ndarray) -> np.ndarray:
    return solve_measured(physics, impact_of(twist))[0]


def energy(twist: np.ndarray, share: float = HOLLOW) -> float:
    """Kinetic energy of a ball [J]."""
    return 0.5 * MASS * float(twist[:3] @ twist[:3] + share * RADIUS**2 * twist[3:] @ twist[3:])


@pytest.mark.parametrize("share", [HOLLOW, SOLID])
@pytest.mark.parametrize(
    ("racket", "effects"),
    [
        (Racket(), {}),
        (Racket(friction=3.0), {"support_friction": (2.8,)}),
        (Racket(lambda v: max(0.0, 0.5 - 0.03 * v)), {"restitution_fall": (0.03,)}),
        (Racket(lambda v: max(0.0, 0.5 - 0.2 * v)), {"restitution_fall": (0.2,)}),  # the fast ones do not bounce
        (
            Racket(friction=0.6, tangential=lambda s: 0.7),
            {"support_friction": (0.4,), "tangential_restitution": (0.7, 0.0)},
        ),
        (
            Racket(friction=0.6, tangential=lambda s: max(0.0, 0.8 - 0.05 * s)),
            {"support_friction": (0.4,), "tangential_restitution": (0.8, 0.05)},
        ),
        (Racket(drilling=0.001), {"drilling_friction": (0.001, 0.0)}),
        (Racket(drilling=0.02, spin=0.3), {"drilling_friction": (0.02, 0.3)}),
    ],
)  # fmt: skip
def test_a_ball_leaves_as_its_closed_form_says(
    racket: Racket, effects: dict[str, tuple[float, ...]], share: float
) -> None:
    physics, rng = with_effects(ball(share), **effects), np.random.default_rng(0)
    for _ in range(30):
        twist = thrown(rng)
        np.testing.assert_allclose(after(physics, twist), bounced(twist, racket, share), atol=1e-9)


@pytest.mark.parametrize("exponent", [1.0, 1.5])
@pytest.mark.parametrize("loss", [0.005, 0.2, 1.0, 6.0])
def test_a_dissipative_contact_rebounds_as_its_force_integrated_over_time(loss: float, exponent: float) -> None:
    """f = k x^n (1 + d dx/dt) with m = k = 1, d = ``loss`` at speed 1; kills a wrong branch of Lambert's function."""

    def motion(time: float, state: np.ndarray) -> list[float]:
        del time
        depth, speed = max(state[0], 0.0), state[1]
        return [speed, -(depth**exponent) * (1.0 + loss * speed)]

    def parted(time: float, state: np.ndarray) -> float:
        return float(state[0]) if time > 1e-3 else 1.0

    parted.terminal = True  # type: ignore[attr-defined]
    path = scipy.integrate.solve_ivp(motion, (0.0, 100.0), [0.0, 1.0], events=parted, rtol=1e-10, atol=1e-12)
    assert hunt_crossley_restitution(np.array([loss]))[0] == pytest.approx(-path.y[1, -1], abs=1e-5)


def test_the_restitution_of_a_dissipative_contact_is_continuous_and_falls_from_one() -> None:
    """Kills a wrong term of the series: it meets the closed form at its end."""
    below, above = hunt_crossley_restitution(np.array([0.01 - 1e-9, 0.01 + 1e-9]))
    assert below == pytest.approx(above, abs=1e-7)
    found = hunt_crossley_restitution(np.array([0.0, 0.005, 0.1, 10.0, 1e4]))
    assert found[0] == 1.0
    assert np.all(np.diff(found) < 0.0)
    assert found[-1] * 1e4 == pytest.approx(1.0)  # no rebound is faster than 1 / d


def test_parting_from_an_adhesive_contact_takes_the_same_energy_at_every_speed() -> None:
    """m (v^2 - v_s^2) e_0^2 = m u^2 with e_0 = 0.5; below v_s nothing bounces."""
    physics = with_effects(ball(), restitution_threshold=(1.2, 2.0))
    for fall in (0.5, 1.1, 1.5, 4.0):
        rebound = after(physics, np.array([0.0, 0.0, -fall, 0.0, 0.0, 0.0]))[2]
        assert rebound == pytest.approx(0.5 * np.sqrt(max(fall**2 - 1.2**2, 0.0)), abs=1e-9)


def test_without_friction_a_moment_of_b_times_the_impulse_resists_rolling() -> None:
    """I (omega_t^+ - omega_t^-) = -b L_n against omega_t, or less where that stops it."""
    inertia, arm, fall = HOLLOW * MASS * RADIUS**2, 0.002, 4.0
    physics = with_effects(ball(friction=0.0), rolling_resistance=(arm,))
    pressing = MASS * 1.5 * fall
    for turning in (np.array([200.0, -100.0, 50.0]), np.array([20.0, 5.0, -80.0])):
        found = after(physics, np.array([1.0, 0.0, -fall, *turning]))
        slower = max(0.0, 1.0 - arm * pressing / inertia / float(np.hypot(*turning[:2])))
        np.testing.assert_allclose(found, [1.0, 0.0, 0.5 * fall, *(slower * turning[:2]), turning[2]], atol=1e-9)


def test_a_superball_reverses_its_slip_and_keeps_its_energy() -> None:
    """Garwin 1969: e = beta = 1 and a face that holds."""
    physics = with_effects(ball(SOLID, 50.0, 1.0), tangential_restitution=(1.0, 0.0))
    rng = np.random.default_rng(1)
    for _ in range(20):
        twist = thrown(rng)
        found = after(physics, twist)
        for before, then in zip(slip_of(twist), slip_of(found), strict=True):
            assert then == pytest.approx(-before, abs=1e-9)
        assert energy(found, SOLID) == pytest.approx(energy(twist, SOLID), rel=1e-9)


def slip_of(twist: np.ndarray) -> np.ndarray:
    return (twist[:3] + np.cross(twist[3:], BELOW))[:2]


def test_angular_momentum_about_the_contact_point_stays_where_no_moment_acts_there() -> None:
    physics = with_effects(ball(), tangential_restitution=(0.6, 0.01), restitution_fall=(0.02,))
    rng = np.random.default_rng(2)
    for _ in range(20):
        twist = thrown(rng)
        jump = after(physics, twist) - twist
        moment = MASS * np.cross(-BELOW, jump[:3]) + HOLLOW * MASS * RADIUS**2 * jump[3:]
        np.testing.assert_allclose(moment, 0.0, atol=1e-12)


def test_no_law_adds_energy_to_a_ball() -> None:
    rng = np.random.default_rng(3)
    for _ in range(60):
        physics = with_effects(
            ball(friction=rng.uniform(0.0, 1.0), restitution=rng.uniform()),
            tangential_restitution=(rng.uniform(), 0.02),
            drilling_friction=(rng.uniform(0.0, 0.02), rng.uniform()),
            rolling_resistance=(rng.uniform(0.0, 0.01),),
        )
        twist = thrown(rng)
        assert energy(after(physics, twist)) <= energy(twist) * (1.0 + 1e-9)


def test_laws_that_are_off_leave_the_impact_map_as_it_was() -> None:
    impact, physics = tossed(np.random.default_rng(4)), cube(0.3, 0.2)
    nothing = with_effects(physics, tangential_restitution=(0.0, 0.1), drilling_friction=(0.0, 0.5))
    assert nothing.contact_laws == ()
    little = with_effects(physics, tangential_restitution=(1e-9, 0.0), drilling_friction=(1e-12, 0.0))
    plain, _ = solve_measured(physics, impact)
    np.testing.assert_allclose(solve_measured(little, impact)[0], plain, atol=1e-6)


def test_a_cube_on_its_face_stops_spinning_by_the_moment_that_it_presses_with() -> None:
    """Four corners without friction that share the load: |M_n| = a sum L_n, I domega = M_n."""
    arm, fall, spin = 0.01, 1.0, 40.0
    physics = with_effects(cube(0.0), drilling_friction=(arm, 0.0))
    corners = [np.array([x, y, -0.05]) for x in (0.05, -0.05) for y in (0.05, -0.05)]
    body = BodyState(np.zeros(3), np.eye(3), np.array([0.0, 0.0, -fall, 0.0, 0.0, spin]))
    found, _ = solve_measured(physics, MeasuredImpact({}, body, points_on_plane(corners, UP)))
    mass, moment = physics.object.mass, physics.object.inertia[2]
    np.testing.assert_allclose(found, [0.0, 0.0, 0.0, 0.0, 0.0, spin - arm * mass * fall / moment], atol=1e-7)


def test_a_spin_that_is_measured_in_turned_axes_leaves_in_the_same_axes() -> None:
    """u^+ of a ball whose spin is seen from other axes is its true u^+, seen from there."""
    twist, turn = thrown(np.random.default_rng(2)), np.array([0.1, -0.2, 0.05])
    axes = np.asarray(pin.exp3(turn))
    seen = np.concatenate((twist[:3], axes @ twist[3:]))
    true = after(ball(), twist)
    found = after(with_effects(ball(), spin_axes=tuple(turn)), seen)
    np.testing.assert_allclose(found, np.concatenate((true[:3], axes @ true[3:])), atol=1e-9)


def test_a_marker_of_a_turning_cube_moves_as_a_point_of_it() -> None:
    """Position of the marker a little later, by the rotation itself; kills a lever with the wrong sign or axes."""
    rng = np.random.default_rng(4)
    readings = TwistReadings((0.3, 1.2, -0.4), -1.0, (0.1, 0.0, 2.0), (0.01, -0.02, 0.03))
    rotation, true, step = np.asarray(pin.exp3(rng.standard_normal(3))), rng.standard_normal(6), 1e-6
    after = pin.exp3(step * true[3:]) @ rotation
    velocity = true[:3] + (after - rotation) @ readings.point / step
    seen = readings.twist(true, rotation)
    np.testing.assert_allclose(seen[:3], pin.exp3(np.array(readings.axes)) @ velocity, atol=1e-6)
    assert np.linalg.norm(seen[3:]) == pytest.approx(np.linalg.norm(true[3:]))
    np.testing.assert_allclose(readings.twist_of(seen, rotation), true, atol=1e-12)


def test_impacts_together_are_those_one_by_one() -> None:
    rng = np.random.default_rng(5)
    impacts = [tossed(rng) for _ in range(12)]
    physics = [with_effects(cube(0.3, 0.2), drilling_friction=(0.004, 0.0), tangential_restitution=(0.3, 0.1))] * 6
    physics += [cube(0.5, 0.1)] * 6
    together, _ = MeasuredImpacts(impacts, physics).solve(physics)
    for impact, own, found in zip(impacts, physics, together, strict=True):
        np.testing.assert_allclose(solve_measured(own, impact, may_gain_energy=True)[0], found, atol=1e-12)


def test_an_answer_beyond_the_tolerance_of_the_laws_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    """A residual above the tolerance is the one reason to refuse; kills a comparison the wrong way round."""
    physics = with_effects(ball(), drilling_friction=(0.01, 0.0))
    twist = np.array([1.0, 0.0, -2.0, 30.0, 10.0, 50.0])
    after(physics, twist)
    monkeypatch.setattr(ExactEngine, "tolerance", -1.0)
    with pytest.raises(ImpactMapError):
        after(physics, twist)


def test_a_pad_and_its_support_have_the_same_laws() -> None:
    """Both are partners of the object; each keeps its own friction."""
    physics = replace(ball(), pad_friction=0.7)
    impacts = MeasuredImpacts([impact_of(np.array([1.0, 0.0, -2.0, 0.0, 0.0, 0.0]))], [physics])
    contact = impacts.contacts([with_effects(physics, restitution_fall=(0.1,))])
    assert (contact.closing[0], contact.slip[0]) == pytest.approx((2.0, 1.0))
    assert (contact.friction[0], contact.restitution[0]) == pytest.approx((0.2, 0.3))
