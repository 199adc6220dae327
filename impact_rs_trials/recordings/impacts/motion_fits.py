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
        angular_velocity: w in axes of the world, ``(3,)`` [rad/s].
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
    angular_velocity: Array
    moments: Array
    scatter: tuple[float, float]
    noise: tuple[float, float]

    def at(self, time: float) -> tuple[Array, Array, Array]:
        """Position ``(3,)`` [m], rotation ``(3, 3)`` and twist ``(6,)`` [m/s, rad/s] at a time [s]."""
        t = time - self.reference
        position = self.position + self.velocity * t + 0.5 * self.acceleration * t**2
        rotation, angular_velocity = free_rotation(self.rotation, self.angular_velocity, self.moments, t)
        return position, rotation, np.concatenate((self.velocity + self.acceleration * t, angular_velocity))


def free_rotation(rotation: Array, angular_velocity: Array, moments: Array, duration: float) -> tuple[Array, Array]:
    """Rotation ``(3, 3)`` and angular velocity ``(3,)`` [rad/s] of a free body after some time (Euler's equations).

    Args:
        rotation: Rotation from the principal axes to the world, ``(3, 3)``.
        angular_velocity: Angular velocity in axes of the world, ``(3,)`` [rad/s].
        moments: Principal moments, ``(3,)``.
        duration: Time, may be negative [s].
    """
    if np.ptp(moments) <= EQUAL_MOMENTS * float(np.max(moments)):
        return np.asarray(pin.exp3(angular_velocity * duration) @ rotation), angular_velocity
    body_velocity, steps = rotation.T @ angular_velocity, max(1, int(np.ceil(abs(duration) / EULER_STEP_S)))
    h = duration / steps
    for _ in range(steps):  # midpoint rule
        middle = body_velocity + 0.5 * h * np.cross(moments * body_velocity, body_velocity) / moments
        rotation = rotation @ pin.exp3(h * middle)
        body_velocity = body_velocity + h * np.cross(moments * middle, middle) / moments
    return np.asarray(rotation), np.asarray(rotation @ body_velocity)


def fly(time: Array, positions: Array, rotations: Array, gravity: Array, moments: Array, at: float) -> FittedMotion:
    """Free flight.

    Args:
        time: Stamps, ``(k,)`` [s], at least three.
        positions: Positions of the centre of mass, ``(k, 3)`` [m].
        rotations: Rotations from the body's principal axes to the world, ``(k, 3, 3)``.
        gravity: Gravity vector, ``(3,)`` [m/s^2].
        moments: Principal moments, ``(3,)`` [kg m^2].
        at: Time of the impact, at which the noise of the velocity is computed [s].
    """
    return _fit(time, positions, rotations, gravity, moments, at, curved=False)


def move(time: Array, positions: Array, rotations: Array, at: float) -> FittedMotion:
    """Motion on a support with unknown friction: velocity and acceleration are fitted, the rotation is steady.

    Args:
        time: Stamps, ``(k,)`` [s], at least four.
        positions: ``(k, 3)`` [m].
        rotations: ``(k, 3, 3)``.
        at: Time of the impact, at which the noise of the velocity is computed [s].
    """
    return _fit(time, positions, rotations, np.zeros(3), np.ones(3), at, curved=True)


def rest(positions: Array, rotations: Array, at: float) -> FittedMotion:
    """A body at rest; its scatter is the tracker's noise.

    Args:
        positions: ``(k, 3)`` [m].
        rotations: ``(k, 3, 3)``.
        at: Time of the impact [s].
    """
    mean_position = np.mean(positions, axis=0)
    middle = rotations[len(rotations) // 2]
    angles = np.array([pin.log3(rotation @ middle.T) for rotation in rotations])
    mean_angle = np.mean(angles, axis=0)
    scatter = (_rms(positions - mean_position), _rms(angles - mean_angle))
    zero = np.zeros(3)
    return FittedMotion(
        at, mean_position, zero, zero, pin.exp3(mean_angle) @ middle, zero, np.ones(3), scatter, (0.0, 0.0)
    )


def contact_noise(motion: FittedMotion, samples: int, extent: float, turns: bool) -> tuple[float, float]:
    """Standard deviations of the position [m] and of the normal [rad] of a contact at the end of a motion.

    A straight line fitted to k samples has the standard deviation 2 / sqrt(k) of their scatter at its end.

    Args:
        motion: Before the impact.
        samples: k.
        extent: Extent of the body with the contact on its faces [m].
        turns: Whether the normal belongs to a face of the body.
    """
    position_noise, angle_noise = (2.0 * scatter / float(np.sqrt(samples)) for scatter in motion.scatter)
    return float(np.hypot(position_noise, 0.5 * extent * angle_noise)), angle_noise if turns else 0.0


def _fit(
    time: Array, positions: Array, rotations: Array, gravity: Array, moments: Array, at: float, curved: bool
) -> FittedMotion:
    """Least squares fit of positions, with an acceleration if ``curved``, and Gauss-Newton fit of rotations."""
    middle = len(time) // 2
    t = time - time[middle]
    basis = np.column_stack((np.ones_like(t), t, 0.5 * t**2) if curved else (np.ones_like(t), t))
    falling = positions - 0.5 * np.outer(t**2, gravity)
    coefficients, position_scatter = _least_squares(basis, falling)
    line_basis = np.column_stack((np.ones_like(t), t))
    start, angular_velocity = rotations[middle], np.zeros(3)
    for _ in range(GAUSS_NEWTON_STEPS):
        predictions = [free_rotation(start, angular_velocity, moments, moment)[0] for moment in t]
        angles = np.array(
            [pin.log3(measured @ predicted.T) for measured, predicted in zip(rotations, predictions, strict=True)]
        )
        (shift, velocity_change), angle_scatter = _least_squares(line_basis, angles)
        start, angular_velocity = pin.exp3(shift) @ start, angular_velocity + velocity_change
    end = at - time[middle]
    gradient = np.array([0.0, 1.0, end] if curved else [0.0, 1.0])
    noise = (
        position_scatter * float(np.sqrt(gradient @ np.linalg.inv(basis.T @ basis) @ gradient)),
        angle_scatter * float(np.sqrt(np.linalg.inv(line_basis.T @ line_basis)[1, 1])),
    )
    acceleration = coefficients[2] if curved else gravity
    scatter = (position_scatter, angle_scatter)
    return FittedMotion(
        float(time[middle]),
        coefficients[0],
        coefficients[1],
        acceleration,
        start,
        angular_velocity,
        moments,
        scatter,
        noise,
    )


def _least_squares(basis: Array, values: Array) -> tuple[Array, float]:
    """Coefficients of basis columns ``(k, c)``, and the residual standard deviation."""
    fit = np.asarray(np.linalg.lstsq(basis, values, rcond=None)[0], dtype=float)
    degrees_of_freedom = values.shape[1] * (len(values) - basis.shape[1])
    with np.errstate(over="ignore"):  # large numbers overflow to an infinite scatter
        return fit, float(np.sqrt(np.sum(np.square(values - basis @ fit)) / max(degrees_of_freedom, 1)))


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
