# SPDX-License-Identifier: Apache-2.0
"""Reference generation: quintic via points, extended past the nominal impact (paper sec. Reference generation).

Ante- and post-impact references coincide in position at T_nom (paper eq. pos_refs_imp), their velocities there differ
by the impact map, and each is extended beyond T_nom, so that a reference for the contact state exists even if the
impact comes early or late.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.polynomial import polynomial

from impact_rs_sim.robots.robot import Array
from impact_rs_sim.scenarios.trial_settings import Timing


@dataclass(frozen=True)
class ViaPoint:
    """A point of a quintic path (paper eq. ante_constr_refgen2).

    Attributes:
        time: When [s].
        position: ``(d,)`` [m or rad].
        velocity: ``(d,)`` [m/s or rad/s].
        acceleration: ``(d,)`` [m/s^2 or rad/s^2].
    """

    time: float
    position: Array
    velocity: Array
    acceleration: Array


@dataclass(frozen=True)
class SampledPath:
    """A path at every control tick, ``(ticks + 1, d)`` each [m, m/s, m/s^2] or [rad, rad/s, rad/s^2]."""

    position: Array
    velocity: Array
    acceleration: Array


def sample_path(points: list[ViaPoint], times: Array) -> SampledPath:
    """Quintic polynomials between via points, at rest relative to the end points outside of them.

    Before the first and after the last via point the path continues at constant velocity.

    Args:
        points: At least two via points in order of time.
        times: Where to sample, ``(k,)`` [s].
    """
    knots = np.array([point.time for point in points])
    inside = np.clip(times, knots[0], knots[-1])
    piece = np.minimum(np.searchsorted(knots, inside, side="right"), len(points) - 1)
    position, velocity, acceleration = (np.empty((len(times), points[0].position.size)) for _ in range(3))
    for index, (before, after) in enumerate(pairwise(points), start=1):
        rows = piece == index
        duration = after.time - before.time
        normalised_time = (inside[rows] - before.time) / duration
        coefficients = _quintic(before, after)
        for order, sampled in enumerate((position, velocity, acceleration)):
            derivative = polynomial.polyder(coefficients, order)
            sampled[rows] = polynomial.polyval(normalised_time, derivative).T / duration**order
    outside = (times - inside)[:, None]
    return SampledPath(position + velocity * outside, velocity, np.where(outside == 0.0, acceleration, 0.0))


def _quintic(before: ViaPoint, after: ViaPoint) -> Array:
    """Coefficients of the quintic from one via point to the next, constant term first, ``(6, d)``.

    In the normalised time s in [0, 1]. Position, velocity and acceleration match both via points.
    """
    duration = after.time - before.time
    displacement = after.position - before.position
    start, end = before.velocity * duration, after.velocity * duration
    bend, last = before.acceleration * duration**2, after.acceleration * duration**2
    return np.stack(
        [
            before.position,
            start,
            bend / 2.0,
            10.0 * displacement - 6.0 * start - 4.0 * end - 1.5 * bend + 0.5 * last,
            -15.0 * displacement + 8.0 * start + 7.0 * end + 1.5 * bend - last,
            6.0 * displacement - 3.0 * start - 3.0 * end - 0.5 * bend + 0.5 * last,
        ]
    )


def ante_impact_path(timing: Timing, position: Array, velocity: Array, times: Array) -> SampledPath:
    """From rest to ``position`` with ``velocity`` at T_nom; keeps that velocity for a while, then stops.

    The displacement from rest is half of velocity times duration: the quintic is then a smooth step in velocity. The
    path stops at the end, so that an arm without contact does not run away.

    Args:
        timing: Times of the scenario.
        position: At T_nom, ``(d,)`` [m or rad].
        velocity: At T_nom, just before impact, ``(d,)`` [m/s or rad/s].
        times: Where to sample, ``(k,)`` [s].
    """
    rest, nominal = np.zeros_like(velocity), timing.nominal_impact
    past = position + velocity * timing.overrun
    return sample_path(
        [
            ViaPoint(nominal - timing.approach, position - velocity * timing.approach / 2.0, rest, rest),
            ViaPoint(nominal, position, velocity, rest),
            ViaPoint(nominal + timing.overrun, past, velocity, rest),
            ViaPoint(nominal + timing.overrun + timing.stop, past + velocity * timing.stop / 2.0, rest, rest),
        ],
        times,
    )


def post_impact_path(timing: Timing, position: Array, velocity: Array, times: Array) -> SampledPath:
    """Through ``position`` with ``velocity`` at T_nom and on to rest; at constant velocity before T_nom.

    Args:
        timing: Times of the scenario.
        position: At T_nom, ``(d,)`` [m or rad].
        velocity: At T_nom, just after impact, ``(d,)`` [m/s or rad/s].
        times: Where to sample, ``(k,)`` [s].
    """
    return _to_rest(timing.nominal_impact, timing.push, position, velocity, times)


def carry_path(
    timing: Timing, position: Array, velocity: Array, common: Array, axis: Array, normal: Array, times: Array
) -> SampledPath:
    """Post-impact path of a pad: continues along ``axis`` with the object; the velocity across decays soon.

    At T_nom the reference has the whole predicted velocity, as the impact map demands. It is the sum of three parts:

    * The mean velocity of all pads along the axis comes to rest after ``timing.push``.
    * The mean velocity along the object's face and across the axis, sliding, does not belong to the task, and pad
      friction loads object and support while it lasts. It ends after ``timing.slide``.
    * The rest, the difference of this pad from the mean and the velocity into the object or off it, also ends after
      ``timing.slide`` and leaves no displacement: pads that hold one rigid object cannot follow one. Contact forces
      outside the desired wrench would oppose it and bias the feedback.

    Args:
        timing: Times of the scenario.
        position: At T_nom, ``(3,)`` [m].
        velocity: At T_nom, just after impact, ``(3,)`` [m/s].
        common: Mean of that velocity over all pads, ``(3,)`` [m/s].
        axis: Direction in which the object is pushed or lifted, unit vector, ``(3,)``.
        normal: Normal of the pad, unit vector, ``(3,)``.
        times: Where to sample, ``(k,)`` [s].
    """
    along = axis * (axis @ common)
    slide = common - along - normal * (normal @ (common - along))
    start, origin = timing.nominal_impact, np.zeros(3)
    parts = (
        post_impact_path(timing, position, along, times),
        _to_rest(start, timing.slide, origin, slide, times),
        _to_rest(start, timing.slide, origin, velocity - along - slide, times, origin),
    )
    return SampledPath(
        sum((part.position for part in parts), origin),
        sum((part.velocity for part in parts), origin),
        sum((part.acceleration for part in parts), origin),
    )


def run_up_path(timing: Timing, post: SampledPath, times: Array) -> SampledPath:
    """Post-impact path with a run-up from rest instead of an impact.

    The run-up takes as long as the approach. It reaches the velocity of the post-impact path at t1, so that the
    tracking error has settled at T_nom and no velocity jumps.

    Args:
        timing: Times of the scenario.
        post: Post-impact path at ``times``.
        times: Where it is sampled, ``(k,)`` [s].
    """
    nominal = timing.nominal_impact
    settled = min(timing.window_before, timing.approach / 2.0)
    speeding = timing.approach - settled
    start = int(np.searchsorted(times, nominal - 1e-9))
    position, velocity = post.position[start], post.velocity[start]
    rest, reached = np.zeros_like(velocity), position - velocity * settled
    run_up = sample_path(
        [
            ViaPoint(nominal - timing.approach, reached - velocity * speeding / 2.0, rest, rest),
            ViaPoint(nominal - settled, reached, velocity, rest),
            ViaPoint(nominal, position, velocity, rest),
        ],
        times[:start],
    )
    return SampledPath(
        np.vstack((run_up.position, post.position[start:])),
        np.vstack((run_up.velocity, post.velocity[start:])),
        np.vstack((run_up.acceleration, post.acceleration[start:])),
    )


def excursion_path(begin: float, leg: float, rest: float, start: Array, end: Array, times: Array) -> SampledPath:
    """From rest at ``start`` to rest at ``end`` and back again.

    Args:
        begin: When the motion begins [s].
        leg: Duration of one leg [s].
        rest: Rest at ``end`` [s].
        start: ``(d,)`` [m or rad].
        end: ``(d,)`` [m or rad].
        times: Where to sample, ``(k,)`` [s].
    """
    zero = np.zeros_like(start)
    knots = [(begin, start), (begin + leg, end), (begin + leg + rest, end), (begin + 2.0 * leg + rest, start)]
    if rest == 0.0:
        del knots[2]
    return sample_path([ViaPoint(time, position, zero, zero) for time, position in knots], times)


def _to_rest(
    start: float, duration: float, position: Array, velocity: Array, times: Array, end: Array | None = None
) -> SampledPath:
    """From ``position`` with ``velocity`` to rest at ``end``; None: where a smooth step in velocity ends."""
    rest = np.zeros_like(velocity)
    end = position + velocity * duration / 2.0 if end is None else end
    return sample_path([ViaPoint(start, position, velocity, rest), ViaPoint(start + duration, end, rest, rest)], times)
