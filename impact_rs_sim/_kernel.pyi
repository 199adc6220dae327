# SPDX-License-Identifier: Apache-2.0
"""The compiled part of the impact map (``src/``): where boxes touch, the laws, and one question from end to end."""

from collections.abc import Sequence

from impact_rs_sim.robot import Array

ACCEPTED: float
"""|g F| that is an answer of Newton's method [m/s]."""

_Box = tuple[Array, Array, Array]
"""Centre in A [m], axes in A, half extents [m]."""

def separating_face(partner: _Box, thing: _Box, aligned: float) -> tuple[float, Array, bool]:
    """The face direction that separates two boxes best; of those within ``aligned`` [m] that of the larger face.

    Returns:
        Separation along it (negative: overlap) [m]; unit normal from ``partner`` into ``thing``, ``(3,)``; whether the
        face belongs to ``thing``.
    """

def touching(partner: _Box, thing: _Box, normal: Array, on_thing: bool, tolerance: float) -> tuple[Array, Array]:
    """Points on ``thing`` ``(k, 3)`` and their gaps ``(k,)`` [m], up to ``tolerance``; the rest as above."""

class Terms:
    """A problem at its m contact points; vectors are in axes of A.

    Args:
        delassus: J_c H^-1 J_c^T, ``(3 m, 3 m)`` [1/kg].
        approach: J_c u^-, ``(3 m,)`` [m/s].
        normals: Into the object, ``(m, 3)``.
        friction: Coulomb coefficients, ``(m,)`` [-].
        rebound: e J_n u^-, ``(m,)`` [m/s].
        inverse_mass: g, ``(m,)`` [1/kg].
        mobility: 1 / m of the object [1/kg].
    """

    def __init__(
        self,
        delassus: Array,
        approach: Array,
        normals: Array,
        friction: Array,
        rebound: Array,
        inverse_mass: Array,
        mobility: float,
    ) -> None: ...
    def linearise(
        self, impulses: Array, velocity: Array, least: Array | float
    ) -> tuple[Array, Array, Array, Array, tuple[str, ...], Array]:
        """The fields of :class:`impact_rs_sim.impact_map.newton.Linearisation`."""

    def settle(self, impulses: Array, least: Array | float, compliance: float) -> tuple[Array, bool]:
        """:func:`impact_rs_sim.impact_map.newton.settle`."""

    def harden(self, impulses: Array, least: Array | float, compliance: float) -> Array:
        """:func:`impact_rs_sim.impact_map.newton.harden`."""

    def solve(self, compliance: float) -> tuple[Array, bool, int]:
        """Impulses ``(m, 3)`` [N s] from nothing, whether they are an answer, and how many steps it took."""

    def judge(self, impulses: Array, after: Array, least: Array | float) -> tuple[float, float, float]:
        """Penetration, complementarity and friction of :class:`~impact_rs_sim.impact_map.problem.Residual` [m/s].

        Args:
            impulses: ``(m, 3)`` [N s].
            after: J_c u^+, ``(3 m,)`` [m/s].
            least: What every point presses at least [N s].
        """

def solve_impacts(
    count: int,
    arms: Sequence[Sequence[Array]],
    thing: Sequence[Array | float],
    contact: Sequence[Array | float],
    support: Array | None,
    rules: tuple[float, float, float, float],
    points: tuple[Sequence[int], Array, Array, Array] | None = None,
) -> tuple[Array, Array, Array, Array, Array, Array, Array, Array, Array, Array, Array, Array, Array]:
    """Solve ``count`` questions; what has no such first axis holds for all of them.

    Args:
        count: N.
        arms: By arm q, dq, B, least and largest q, largest speed, M (upper triangle), J of E in E[A], origin and axes
            of E in A, middle, axes and half extents of the pad in E.
        thing: Position, axes, twist, mass, half extents, principal moments, centre of mass of the object.
        contact: Friction of pads and of the support, restitution.
        support: Centre and half extents of the support in A, ``(6,)`` [m]; None: no support.
        rules: ``ALIGNED``, ``GAP_TOLERANCE``, ``PENETRATION_TOLERANCE`` [m] and ``COMPLIANCE`` [-].
        points: Partner, position, normal and gap of contact points that hold for all questions, as they are returned;
            None: those where the boxes touch.

    Returns:
        Status (0 solved, 1 a question that is not sound, 2 no answer) ``(N,)``; u^+ ``(N, nv)``; twists of E
        ``(N, 6 k)``; residuals ``(N, 4)``; kinetic energy before and its gain ``(N, 2)``; steps ``(N,)``; number of the
        first contact point ``(N + 1,)``; and of all points partner (arm; the number of arms: the support), state (0
        open, 1 stick, 2 slide), position on the object, normal, gap and impulse.

    Raises:
        ValueError: An array has the wrong size.
    """
