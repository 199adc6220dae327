# SPDX-License-Identifier: Apache-2.0
"""Tangential compliance and creep of a pad (Maxwell element), which Bullet's rigid stiction lacks.

The face of the pad is sheared against the flange by s and twisted about the contact normal by phi. Between face and
flange sits a Maxwell element with a damper across its spring; between face and object Coulomb friction. At every
contact point i, with its share w_i = N_i / N of the normal load and its place r_i from the load's centre,

    F_i  = -w_i (d_i + tau dd_i/dt) / C,    d_i = s + phi n x r_i       on the object, while |F_i| <= mu N_i
    dd_i/dt = v_i + c F_i / w_i                                         v_i: object against flange, along the face

so that all points together give F = -s / C at rest and v = -c F as steady creep. A point beyond its cone slips, and s
is the shear that its friction can balance (return mapping, as in elastoplasticity: Simo and Hughes 1998, ch. 1). With
these shares of the load all points reach their cones together when the face is sheared without a twist. C is the
compliance [m/N], c the creep [m/(s N)], and tau the time constant of the damper; a mass of ``REDUCED_MASS_KG`` on
spring and damper has the damping ratio ``DAMPING_RATIO``.

Bullet has one regularisation of friction (``frictionERP``, ``frictionCFM``) for all contacts of a world, including the
support's. So this friction is integrated here, with the normal forces of the previous step, and Bullet's friction on
the pad is zero. The spring is explicit. With the mobility W of the contact, the step is stable for C >= theta dt W,
theta = tau + dt, whatever other forces act; a stiffer spring gets this smallest C.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from impact_rs_sim.robots.robot import Array

REDUCED_MASS_KG = 1.0  # of arm and object against each other; sets the damper below
DAMPING_RATIO = 0.5  # of that mass on the spring
MIN_TWIST_LEVER_M = 1e-6  # contact points closer to each other resist no twist


@dataclass(frozen=True)
class PadContacts:
    """Contact points of a pad after a step.

    Attributes:
        points: Where they are in A, ``(m, 3)`` [m].
        loads: Normal forces, ``(m,)`` [N]; their sum is positive.
        normal: Unit normal in A, ``(3,)``.
    """

    points: Array
    loads: Array
    normal: Array


@dataclass(frozen=True)
class ContactBody:
    """A body at a contact.

    Attributes:
        position: Reference point in A, ``(3,)`` [m].
        twist: Velocity of that point and angular velocity, in A, ``(6,)`` [m/s, rad/s].
        mobility: Change of the twist per impulse and angular impulse at that point, ``(6, 6)``.
    """

    position: Array
    twist: Array
    mobility: Array


class PadShear:
    """Shear of one pad.

    Args:
        compliance: C [m/N].
        creep: c [m/(s N)].
        friction: mu [-].
        period: Step [s].
        pads: Number of pads that may push on the same object, which must be stable together.
    """

    def __init__(self, compliance: float, creep: float, friction: float, period: float, pads: int = 1) -> None:
        self._compliance, self._creep, self._friction = compliance, creep, friction
        self._period, self._pads = period, pads
        self._time_constant = 2.0 * DAMPING_RATIO * float(np.sqrt(compliance * REDUCED_MASS_KG))
        self.release()

    def release(self) -> None:
        """Release: reset the deformation to zero."""
        self.force = np.zeros(3)  # on the object in the step to come, axes of A [N]
        self._shift = np.zeros(3)  # s at the pad's origin, axes of E [m]
        self._twist = 0.0  # phi [rad]
        self._pull = np.zeros(3)  # F of the last step, axes of E [N]
        self._torque = 0.0  # about the normal, of the last step [N m]

    def step(self, contacts: PadContacts, object_: ContactBody, pad: ContactBody, rotation: Array) -> Array:
        """Forces on the object over the next step, axes of A, ``(m, 3)`` [N].

        Args:
            contacts: Contact points.
            object_: The object.
            pad: The pad, at the origin of E.
            rotation: Axes of E in A, ``(3, 3)``.
        """
        normal, period, lag = contacts.normal, self._period, self._time_constant
        share = contacts.loads / contacts.loads.sum()
        centre = share @ contacts.points
        across = _skew(normal)
        turn_levers = (contacts.points - centre) @ across.T  # n x r_i
        radius = float(np.sqrt(share @ np.sum(np.square(turn_levers), axis=1)))
        turns = radius > MIN_TWIST_LEVER_M
        along = _AXES - normal[:, None] * normal
        of_object, of_pad = (_rows(along, normal, radius, centre - side.position) for side in (object_, pad))
        # Three shears in axes of A and the twist as a length (phi times the radius of gyration of the load).
        velocity = of_object @ object_.twist - of_pad @ pad.twist
        mobility = of_object @ object_.mobility @ of_object.T + of_pad @ pad.mobility @ of_pad.T
        lever = across @ (centre - pad.position)
        deflection = _shear_and_twist(along @ (rotation @ self._shift + self._twist * lever), radius * self._twist)
        last = _shear_and_twist(along @ (rotation @ self._pull), self._torque / radius if turns else 0.0)

        theta = lag + period
        compliance = max(self._compliance, self._pads * theta * period * float(np.linalg.eigvalsh(mobility)[-1]))
        stuck = deflection + period * (velocity + self._creep * last)
        sticking_force = -(stuck + theta * velocity) / (compliance + theta * self._creep)
        twisting = sticking_force[3] / radius if turns else 0.0
        forces = share[:, None] * (sticking_force[:3] + twisting * turn_levers)
        size, limit = np.sqrt(np.einsum("mi,mi->m", forces, forces)), self._friction * contacts.loads
        slips = size > limit
        if np.any(slips):
            forces *= np.where(slips, limit / np.maximum(size, 1e-300), 1.0)[:, None]
        self.force, self._torque = forces.sum(axis=0), float(np.sum(turn_levers * forces))
        if np.any(slips):
            friction_now = _shear_and_twist(self.force, self._torque / radius if turns else 0.0)
            stuck = (lag * deflection - period * compliance * friction_now) / theta
        self._twist = float(stuck[3]) / radius if turns else 0.0
        self._shift = rotation.T @ (stuck[:3] - self._twist * lever)
        self._pull = rotation.T @ self.force
        return forces


_AXES = np.eye(3)


def _skew(a: Array) -> Array:
    """Matrix of the product ``a x``; :func:`numpy.cross` takes ten times as long for a single vector."""
    x, y, z = a.tolist()
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def _shear_and_twist(along: Array, twist: float) -> Array:
    """Shears in axes of A, and the twist as a length, ``(4,)``."""
    vector = np.empty(4)
    vector[:3], vector[3] = along, twist
    return vector


def _rows(along: Array, normal: Array, radius: float, lever: Array) -> Array:
    """Jacobian from the twist of a body to shear and twist rates at ``lever`` from its reference point, ``(4, 6)``."""
    rows = np.zeros((4, 6))
    rows[:3, :3] = along
    rows[:3, 3:] = -along @ _skew(lever)
    rows[3, 3:] = radius * normal
    return rows
