# SPDX-License-Identifier: Apache-2.0
"""Least-squares pose of the motion-capture frame in A, from contact: at a hit the pad lies on a face of the object.

The object is at p with axes R_p in the motion-capture frame; that frame is at t and rotated by psi about z in A. The
centre of the pad is at c with normal m in A, n is the outward normal of the face that is hit, and h half the size of
the object along n. Every hit gives

    n . (c - t - R(psi) p) = h,    n = R(psi) R_p e        the pad lies on the face
    angle from -n to m     = 0                             pad and face are parallel (less accurate)

and the support, on which the object rests before the hit, gives

    t_z = height of the support + half the object's height - p_z.

Least squares for t_x, t_y and psi, by Gauss-Newton steps. If all hits have the same direction, t is undetermined across
it and keeps its given value there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from impact_rs_sim.errors import InputError
from impact_rs_sim.robots.robot import Array

DISTANCE_SIGMA_M = 0.001  # standard deviation of the distance between pad and face
ANGLE_SIGMA_RAD = 0.02  # standard deviation of the angle between them
MAX_STANDARD_ERROR_M = 0.005  # a direction with a larger one is undetermined
MIN_TOTAL_PUSH_M = 0.005  # of all objects together; less displacement does not determine the initial psi
MAX_GAUSS_NEWTON_STEPS = 20
FLAT_CONTACT_S = (0.02, 0.1)  # after the impact, in which the pad lies flat on the face and pushes it
CARRIED_S = 0.3  # after the impact, in which the object moves with the pad
CONVERGED_STEP = 1e-9  # m or rad


@dataclass(frozen=True)
class PadOnFace:
    """One impact, while pad and object touch.

    Attributes:
        run: Name of the run.
        pad: Middle of the pad in A, ``(k, 3)`` [m].
        pad_normal: Outward normal of the pad in A, ``(k, 3)``.
        position: Geometric centre of the object in the world of the motion capture, ``(k, 3)`` [m].
        rotation: Its axes there, ``(k, 3, 3)``.
        size: Of the object, ``(3,)`` [m].
        standing: Initial height of its centre over the support [m].
        standing_height: Initial height of its centre in the world of the motion capture [m].
        pad_displacement: Displacement of the pad after the impact, in A, ``(2,)`` [m].
        object_displacement: Displacement of the object meanwhile, in the world of the motion capture, ``(2,)`` [m].
    """

    run: str
    pad: Array
    pad_normal: Array
    position: Array
    rotation: Array
    size: Array
    standing: float
    standing_height: float
    pad_displacement: Array
    object_displacement: Array


@dataclass(frozen=True)
class ContactFrame:
    """The motion-capture frame in A.

    Attributes:
        position: Its origin, ``(3,)`` [m].
        yaw: Its rotation about z [rad].
        error: Standard error of x, y [m] and yaw [rad] from the scatter of the hits, ``(3,)``; 0 where not estimated.
        scatter: Distance between pad and face, rms over the hits [m].
        tilt: Angle between pad and face, rms over the hits [rad].
        hits: Number of hits.
        undetermined: Direction in A along which the position keeps its given value, ``(2,)``; None: all determined.
    """

    position: Array
    yaw: float
    error: Array
    scatter: float
    tilt: float
    hits: int
    undetermined: Array | None

    def __str__(self) -> str:
        x, y, z = self.position
        placed = (
            f"motion capture placed from contact in {self.hits} hits: position [{x:.4f}, {y:.4f}, {z:.4f}] m, yaw "
            f"{self.yaw:.4f} rad, +- {1e3 * self.error[0]:.1f} mm, {1e3 * self.error[1]:.1f} mm, {self.error[2]:.4f} "
            f"rad; pad and face are then {1e3 * self.scatter:.1f} mm and {np.rad2deg(self.tilt):.1f} degrees rms from "
            "touching"
        )
        if self.undetermined is None:
            return placed
        x, y = self.undetermined
        return (
            f"{placed}; along [{x:.2f}, {y:.2f}] the position stays as given: all hits are across that direction and "
            "do not determine it"
        )


def contact_frame(touches: Sequence[PadOnFace], given: Array, given_yaw: float) -> ContactFrame:
    """Least-squares placement of the world of the motion capture, in which pad and face touch at all hits.

    Args:
        touches: The hits; poses already rotated by roll and pitch, which hits do not determine.
        given: Position to keep along undetermined directions, ``(3,)`` [m].
        given_yaw: Initial yaw, used if no object moves [rad].

    Raises:
        InputError: There is no hit.
    """
    if not touches:
        raise InputError("motion_capture.estimate: no hit has both joint positions and a pose of the object")
    height = float(np.mean([touch.standing - touch.standing_height for touch in touches]))
    estimate = _first(touches, given_yaw)
    weights = np.tile([1.0 / DISTANCE_SIGMA_M, 1.0 / ANGLE_SIGMA_RAD], len(touches))
    for _ in range(MAX_GAUSS_NEWTON_STEPS):
        previous = estimate.copy()
        undetermined = _undetermined(weights[:, None] * _residuals(touches, estimate)[1])
        directions = np.eye(3)
        if undetermined is not None:
            directions = np.array([[-undetermined[1], undetermined[0], 0.0], [0.0, 0.0, 1.0]]).T
            estimate[:2] += undetermined * (undetermined @ (given[:2] - estimate[:2]))
        values, jacobian = _residuals(touches, estimate)
        design = weights[:, None] * jacobian @ directions
        estimate = estimate + directions @ np.linalg.lstsq(design, -weights * values, rcond=None)[0]
        if np.max(np.abs(estimate - previous)) < CONVERGED_STEP:
            break
    values, jacobian = _residuals(touches, estimate)
    # Two residuals per hit minus the estimated parameters. DISTANCE_SIGMA_M and ANGLE_SIGMA_RAD are a lower bound.
    degrees_of_freedom = max(1, values.size - directions.shape[1])
    reduced_chi_square = max(1.0, float(np.sum(np.square(weights * values))) / degrees_of_freedom)
    design = weights[:, None] * jacobian @ directions
    covariance = directions @ np.linalg.inv(design.T @ design) @ directions.T * reduced_chi_square
    return ContactFrame(
        position=np.array([estimate[0], estimate[1], height]),
        yaw=float(np.arctan2(np.sin(estimate[2]), np.cos(estimate[2]))),
        error=np.sqrt(np.diag(covariance)),
        scatter=float(np.sqrt(np.mean(np.square(values[0::2])))),
        tilt=float(np.sqrt(np.mean(np.square(values[1::2])))),
        hits=len(touches),
        undetermined=undetermined,
    )


def _undetermined(slopes: Array) -> Array | None:
    """Horizontal direction in which the hits do not determine the position, ``(2,)``; None: they determine it.

    Args:
        slopes: Derivatives of the weighted residuals by x, y and yaw, ``(2 h, 3)``; by x and y: normals of faces.
    """
    information, directions = np.linalg.eigh(slopes[:, :2].T @ slopes[:, :2])
    if information[0] * MAX_STANDARD_ERROR_M**2 > 1.0:
        return None
    direction = directions[:, 0]
    return np.asarray(direction * np.sign(direction[int(np.argmax(np.abs(direction)))]))


def _first(touches: Sequence[PadOnFace], given_yaw: float) -> Array:
    """Initial x, y [m] and yaw [rad]: objects move with the pads, and every pad is at the centre of its face."""
    yaw = given_yaw
    if sum(float(np.linalg.norm(touch.object_displacement)) for touch in touches) > MIN_TOTAL_PUSH_M:
        cosine = sum(float(touch.object_displacement @ touch.pad_displacement) for touch in touches)
        sine = sum(
            float(
                touch.object_displacement[0] * touch.pad_displacement[1]
                - touch.object_displacement[1] * touch.pad_displacement[0]
            )
            for touch in touches
        )
        yaw = float(np.arctan2(sine, cosine))
    rotation = pin.rpy.rpyToMatrix(0.0, 0.0, yaw)
    positions = []
    for touch in touches:
        normal, half = _face(touch, rotation)
        positions.append(np.mean(touch.pad - half * normal - touch.position @ rotation.T, axis=0))
    return np.append(np.mean(positions, axis=0)[:2], yaw)


def _residuals(touches: Sequence[PadOnFace], estimate: Array) -> tuple[Array, Array]:
    """Distance [m] and angle [rad] of every impact, ``(2 h,)``, and their derivatives by x, y and yaw, ``(2 h, 3)``."""
    rotation = pin.rpy.rpyToMatrix(0.0, 0.0, float(estimate[2]))
    values, jacobian = [], []
    for touch in touches:
        normal, half = _face(touch, rotation)
        offset = touch.pad[:, :2] - estimate[:2]
        projection = np.einsum("ki,ki->k", normal, touch.pad - (rotation @ touch.position.T).T)
        distance = projection - normal[:, :2] @ estimate[:2] - half
        facing = -touch.pad_normal
        angle = np.arctan2(
            facing[:, 0] * normal[:, 1] - facing[:, 1] * normal[:, 0],
            np.einsum("ki,ki->k", facing[:, :2], normal[:, :2]),
        )
        # n and R p both rotate with psi, so n . R p is constant; d/dpsi n . (c - t) = (z x n) . (c - t).
        derivative_by_yaw = normal[:, 0] * offset[:, 1] - normal[:, 1] * offset[:, 0]
        values += [float(distance.mean()), float(angle.mean())]
        jacobian += [np.append(-normal[:, :2].mean(axis=0), derivative_by_yaw.mean()), np.array([0.0, 0.0, 1.0])]
    return np.array(values), np.array(jacobian)


def _face(touch: PadOnFace, rotation: Array) -> tuple[Array, float]:
    """Outward normal of the face that the pad meets, in A, ``(k, 3)``, and half the extent along it [m]."""
    axes = rotation @ touch.rotation
    direction = -np.einsum("kij,ki->kj", axes, touch.pad_normal)[0]  # of the object's axes, to the pad
    axis = int(np.argmax(np.abs(direction)))
    return axes[:, :, axis] * np.sign(direction[axis]), float(touch.size[axis]) / 2.0
