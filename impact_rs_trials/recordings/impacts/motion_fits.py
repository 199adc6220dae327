# SPDX-License-Identifier: Apache-2.0
"""Motion of a tracked body before or after an impact, fitted by its law of motion.

    free flight   p(t) = p_0 + v t + g t^2 / 2
                  dR/dt = [w] R,  I dw/dt = -w x I w                                (Euler)
    sliding       p(t) = p_0 + d s(t),  s = v t - c t^2 / 2 until it rests,         c = mu g for a flat support

Positions are linear in their parameters and fitted by least squares, orientations by Gauss-Newton steps. Standard
errors follow from the scatter of the samples about the fit, for white noise; filtered tracking has larger errors.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from impact_rs_sim.robots.robot import Array

GAUSS_NEWTON_STEPS = 3  # of an orientation
EULER_STEP_S = 2e-3  # of Euler's equations
EQUAL_MOMENTS = 1e-9  # relative difference below which a body turns steadily
MAX_REST_SIGMA = 2.0  # standard deviations of the velocity of a body at rest


@dataclass(frozen=True)
class FittedMotion:
    """Position and twist of a body over time.

    Attributes:
        reference: Reference time of the parameters [s].
        position: p_0, ``(3,)`` [m].
        velocity: v, ``(3,)`` [m/s].
        acceleration: g, or the deceleration of sliding, ``(3,)`` [m/s^2].
        rotation: R_0, ``(3, 3)``.
        turning: w in axes of the world, ``(3,)`` [rad/s].
        moments: Principal moments, ``(3,)``; equal if a steady rotation is assumed.
        scatter: Root mean square residual of positions [m] and angles [rad].
        noise: Standard deviation of a component of the velocity [m/s] and of the angular velocity [rad/s], at the end
            of the samples that is nearer to the impact.
    """

    reference: float
    position: Array
    velocity: Array
    acceleration: Array
    rotation: Array
    turning: Array
    moments: Array
    scatter: tuple[float, float]
    noise: tuple[float, float]

    def at(self, time: float) -> tuple[Array, Array, Array]:
        """Position ``(3,)`` [m], rotation ``(3, 3)`` and twist ``(6,)`` [m/s, rad/s] at a time [s]."""
        t = time - self.reference
        position = self.position + self.velocity * t + 0.5 * self.acceleration * t**2
        rotation, turning = turned(self.rotation, self.turning, self.moments, t)
        return position, rotation, np.concatenate((self.velocity + self.acceleration * t, turning))


def turned(rotation: Array, turning: Array, moments: Array, duration: float) -> tuple[Array, Array]:
    """Rotation ``(3, 3)`` and angular velocity ``(3,)`` [rad/s] of a free body after a time, which may be negative.

    Args:
        rotation: From its principal axes to the world, ``(3, 3)``.
        turning: In axes of the world, ``(3,)`` [rad/s].
        moments: Principal moments, ``(3,)``.
        duration: The time [s].
    """
    if np.ptp(moments) <= EQUAL_MOMENTS * float(np.max(moments)):
        return np.asarray(pin.exp3(turning * duration) @ rotation), turning
    own, steps = rotation.T @ turning, max(1, int(np.ceil(abs(duration) / EULER_STEP_S)))
    h = duration / steps
    for _ in range(steps):  # midpoint rule
        middle = own + 0.5 * h * np.cross(moments * own, own) / moments
        rotation = rotation @ pin.exp3(h * middle)
        own = own + h * np.cross(moments * middle, middle) / moments
    return np.asarray(rotation), np.asarray(rotation @ own)


def fly(time: Array, positions: Array, rotations: Array, gravity: Array, moments: Array, at: float) -> FittedMotion:
    """Free flight.

    Args:
        time: Stamps, ``(k,)`` [s], at least three.
        positions: Of the centre of mass, ``(k, 3)`` [m].
        rotations: From the body's principal axes to the world, ``(k, 3, 3)``.
        gravity: ``(3,)`` [m/s^2].
        moments: Principal moments, ``(3,)`` [kg m^2].
        at: Time of the impact, for the noise [s].
    """
    return _fit(time, positions, rotations, gravity, moments, at, curved=False)


def move(time: Array, positions: Array, rotations: Array, at: float) -> FittedMotion:
    """Motion on a support with unknown friction: velocity and acceleration are fitted, the rotation is steady.

    Args:
        time: Stamps, ``(k,)`` [s], at least four.
        positions: ``(k, 3)`` [m].
        rotations: ``(k, 3, 3)``.
        at: Time of the impact, for the noise [s].
    """
    return _fit(time, positions, rotations, np.zeros(3), np.ones(3), at, curved=True)


def rest(positions: Array, rotations: Array, at: float) -> FittedMotion:
    """A body at rest; its scatter is the tracker's noise.

    Args:
        positions: ``(k, 3)`` [m].
        rotations: ``(k, 3, 3)``.
        at: Time of the impact [s].
    """
    place = np.mean(positions, axis=0)
    middle = rotations[len(rotations) // 2]
    turns = np.array([pin.log3(rotation @ middle.T) for rotation in rotations])
    mean = np.mean(turns, axis=0)
    scatter = (_rms(positions - place), _rms(turns - mean))
    zero = np.zeros(3)
    return FittedMotion(at, place, zero, zero, pin.exp3(mean) @ middle, zero, np.ones(3), scatter, (0.0, 0.0))


def contact_noise(motion: FittedMotion, samples: int, extent: float, turns: bool) -> tuple[float, float]:
    """Standard deviations of the position [m] and of the normal [rad] of a contact at the end of a motion.

    A straight line through k samples is known at its end to 2 / sqrt(k) of their scatter.

    Args:
        motion: Before the impact.
        samples: k.
        extent: Extent of the body with the contact on its faces [m].
        turns: Whether the normal belongs to a face of the body.
    """
    place, turn = (2.0 * scatter / float(np.sqrt(samples)) for scatter in motion.scatter)
    return float(np.hypot(place, 0.5 * extent * turn)), turn if turns else 0.0


def _fit(
    time: Array, positions: Array, rotations: Array, gravity: Array, moments: Array, at: float, curved: bool
) -> FittedMotion:
    middle = len(time) // 2
    t = time - time[middle]
    basis = np.column_stack((np.ones_like(t), t, 0.5 * t**2) if curved else (np.ones_like(t), t))
    falling = positions - 0.5 * np.outer(t**2, gravity)
    line, place_left = _least_squares(basis, falling)
    steady = np.column_stack((np.ones_like(t), t))
    start, turning = rotations[middle], np.zeros(3)
    for _ in range(GAUSS_NEWTON_STEPS):
        expected = [turned(start, turning, moments, moment)[0] for moment in t]
        off = np.array([pin.log3(seen @ one.T) for seen, one in zip(rotations, expected, strict=True)])
        (shift, faster), turn_left = _least_squares(steady, off)
        start, turning = pin.exp3(shift) @ start, turning + faster
    end = at - time[middle]
    gradient = np.array([0.0, 1.0, end] if curved else [0.0, 1.0])
    noise = (
        place_left * float(np.sqrt(gradient @ np.linalg.inv(basis.T @ basis) @ gradient)),
        turn_left * float(np.sqrt(np.linalg.inv(steady.T @ steady)[1, 1])),
    )
    acceleration = line[2] if curved else gravity
    scatter = (place_left, turn_left)
    return FittedMotion(float(time[middle]), line[0], line[1], acceleration, start, turning, moments, scatter, noise)


def _least_squares(basis: Array, values: Array) -> tuple[Array, float]:
    """Coefficients of columns ``(k, c)``, and the scatter about them."""
    fit = np.asarray(np.linalg.lstsq(basis, values, rcond=None)[0], dtype=float)
    freedom = values.shape[1] * (len(values) - basis.shape[1])
    with np.errstate(over="ignore"):  # a number may be of any size, and the scatter is infinite then
        return fit, float(np.sqrt(np.sum(np.square(values - basis @ fit)) / max(freedom, 1)))


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
