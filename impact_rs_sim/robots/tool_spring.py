# SPDX-License-Identifier: Apache-2.0
"""Spring and damper between flange and pad: a force sensor, a flexure or a slender tool."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from impact_rs_sim.robots.robot import Array

ROUNDING = 1e-9  # of eigenvalues of a compliance matrix that is scaled to a diagonal of ones [-]


@dataclass(frozen=True, eq=False)
class ToolSpring:
    """Spring and damper between flange and pad, whose pad has no mass: the tool's mass stays on the flange.

    With the wrench w (force, moment) of the contacts about the origin of E, in axes of E, the pad is displaced by the
    small twist B z, where

        z + lag dz/dt = B^T w,        C = B B^T

    so that at rest it is displaced by C w, with the compliance matrix C (Loncaric 1987); the spring's energy is
    z^T z / 2, and the damper is in proportion to the stiffness (Rayleigh 1877).

    Attributes:
        motions: B^T, ``(d, 6)`` with d = rank C [m/J^0.5, rad/J^0.5].
        lag: Damping over stiffness [s].
    """

    motions: Array
    lag: float

    @staticmethod
    def of(compliance: Array, lag: float) -> ToolSpring | None:
        """The spring with C about the origin of E; None where C is zero.

        Args:
            compliance: C, ``(6, 6)`` [m/N, rad/(N m), and 1/N off the diagonal blocks].
            lag: Damping over stiffness [s].
        """
        values, vectors = _principal(compliance)
        yields = values > ROUNDING
        motions = (np.sqrt(values[yields]) * vectors[:, yields]).T
        return ToolSpring(motions, lag) if len(motions) else None

    @property
    def compliance(self) -> Array:
        """C, twist (linear, angular) of the pad per wrench (force, moment), ``(6, 6)``."""
        return np.asarray(self.motions.T @ self.motions)


def is_a_spring(compliance: Array) -> bool:
    """Whether a compliance matrix ``(6, 6)`` is symmetric and positive semidefinite, so that it stores energy only."""
    size = np.sqrt(np.abs(np.outer(np.diag(compliance), np.diag(compliance))))
    if np.any(np.abs(compliance - compliance.T) > ROUNDING * size) or np.any(np.diag(compliance) < 0.0):
        return False
    return not np.any(compliance[size == 0.0]) and bool(_principal(compliance)[0][0] >= -ROUNDING)


def about(compliance: Array, centre: Array) -> Array:
    """C about the origin from C about ``centre`` ``(3,)`` [m], ``(6, 6)``."""
    moved = np.eye(6)
    moved[:3, 3:] = pin.skew(centre)  # v_origin = v_centre + centre x omega
    return np.asarray(moved @ compliance @ moved.T)


def _principal(compliance: Array) -> tuple[Array, Array]:
    """Eigenvalues of C with its diagonal scaled to ones, and their vectors in the units of C."""
    scale = np.sqrt(np.diag(compliance))
    scale[scale == 0.0] = 1.0
    values, vectors = np.linalg.eigh(compliance / np.outer(scale, scale))
    return values, scale[:, None] * vectors
