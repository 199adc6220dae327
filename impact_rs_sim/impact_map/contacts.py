# SPDX-License-Identifier: Apache-2.0
"""Contact points between pads, objects and support.

Bodies are convex; :mod:`impact_rs_sim.shapes` has the rules of all shapes, and two boxes their own routine. Of
the six face directions of two boxes, and the common normals of edges that cross, the one that separates the two boxes
best is the contact normal. The nearest face of the other box is clipped to the face of the normal, and its corners
within ``GAP_TOLERANCE`` of it touch: face, edge and corner contacts come out as polygon, segment and point. Two edges
touch in one point, where they cross; where their common normal is within 6 degrees of that of a face, that point is a
corner of the clipped face. Bullet's box-box detector follows the same rules, so that both engines see the same
contacts, and so does the twin. If faces are aligned, the face that still separates after a tilt gives the normal: a
tilt by dphi reduces the separation along the normal of a face by dphi times the extent of the other box along that
face, so the normal of the larger of two touching faces stays the same on either side.

Clipping is implemented here (``src/boxes.cpp``), because general collision libraries start contact patches from a
penetration direction that an iterative search finds. At faces that touch without overlap it is ill-defined.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from impact_rs_sim import _kernel
from impact_rs_sim.physics import Physics
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.scene import BodyState
from impact_rs_sim.shapes import BOX, ConvexShape

SUPPORT = "support"  # name of the support among the object's partners
OBJECT = "object"  # name of the object that is hit first, among the bodies
ALIGNED = 1e-9  # m; smaller differences of separations are rounding of parallel faces
GAP_TOLERANCE = 1e-3  # m; points closer than this take part in the impact
SUPPORT_THICKNESS = 0.1  # m, of the box that stands for the support; only its upper face is ever touched


@dataclass(frozen=True)
class ConvexBody:
    """A convex body in A.

    Attributes:
        centre: Middle of its bounding box in A, ``(3,)`` [m].
        rotation: Axes in A, ``(3, 3)``.
        half: Half extents along them, ``(3,)`` [m].
        shape: Its shape.
    """

    centre: Array
    rotation: Array
    half: Array
    shape: ConvexShape = BOX

    @property
    def parts(self) -> tuple[Array, Array, Array, _kernel.Shape | None]:
        """Centre, axes, half extents and shape, in the form of the compiled geometry."""
        return self.centre, self.rotation, self.half, self.shape.kernel


@dataclass(frozen=True)
class ContactPoint:
    """A point where the object touches a partner.

    Attributes:
        partner: Name of the pad (of an arm or a hand), ``support``, or an object before ``body``.
        position: Point on the object in A, ``(3,)`` [m].
        normal: Unit normal from the partner into the object, in A, ``(3,)``.
        gap: Distance from the partner's surface along the normal, negative in penetration [m].
        friction: Coulomb coefficient of the pair [-].
        body: The object: ``object``, or name of a neighbour.
    """

    partner: str
    position: Array
    normal: Array
    gap: float
    friction: float
    body: str = OBJECT

    @property
    def partner_position(self) -> Array:
        """Point on the partner in A, ``(3,)`` [m]."""
        return self.position - self.gap * self.normal


@dataclass(frozen=True)
class ContactPair:
    """An object and a partner that it may touch.

    Attributes:
        partner: Name of the pad (of an arm or a hand), ``support``, or an object before ``body``.
        box: The partner.
        object: The object.
        separation: Distance along the direction that separates them best, negative: overlap [m].
        normal: Unit normal of the contact from the partner into the object, in A, ``(3,)``.
        on_object: Whether the normal is that of a face of the object, not of the partner.
        edges: Axes of partner and object along which two crossing edges run, if these give the normal; None: a face
            gives it.
        body: The object: ``object``, or name of a neighbour.
    """

    partner: str
    box: ConvexBody
    object: ConvexBody
    separation: float
    normal: Array
    on_object: bool
    edges: tuple[int, int] | None = None
    body: str = OBJECT


def contact_pairs(
    physics: Physics,
    state: BodyState,
    placements: Mapping[str, pin.SE3],
    neighbours: Sequence[BodyState] = (),
) -> list[ContactPair]:
    """Contact pairs of the object, and of its neighbours if their states are given.

    Args:
        physics: Shapes of all bodies.
        state: State of the object.
        placements: Pose of frame E in A by pad, :func:`impact_rs_sim.scene.pad_placements`.
        neighbours: States of its neighbours.
    """
    partners = {}
    pads = physics.pads
    for name, placement in placements.items():
        end_effector = pads[name].end_effector
        pad = placement * end_effector.pad_placement
        half = np.array(end_effector.pad_size) / 2.0
        partners[name] = ConvexBody(pad.translation, pad.rotation, half, end_effector.shape)
    support = support_box(physics)
    if support is not None:
        partners[SUPPORT] = support
    bodies = {OBJECT: (physics.object, state)}
    for neighbour, neighbour_state in zip(physics.neighbours, neighbours, strict=False):
        bodies[neighbour.name] = (neighbour.body, neighbour_state)
    pairs = []
    for name, (physical, body_state) in bodies.items():
        body = ConvexBody(body_state.position, body_state.rotation, physical.size / 2.0, physical.shape)
        pairs += [
            ContactPair(partner, partner_body, body, *_kernel.meet(partner_body.parts, body.parts, ALIGNED), name)
            for partner, partner_body in partners.items()
        ]
        partners[name] = body
    return pairs


def support_box(physics: Physics) -> ConvexBody | None:
    """The support; None: the scene has no support."""
    if physics.support_height is None:
        return None
    half = np.array([physics.support_size[0], physics.support_size[1], SUPPORT_THICKNESS]) / 2.0
    return ConvexBody(np.array([0.0, 0.0, physics.support_height - half[2]]), np.eye(3), half)


def find_contacts(
    physics: Physics, pairs: Sequence[ContactPair], tolerance: float = GAP_TOLERANCE
) -> list[ContactPoint]:
    """Contact points of the objects.

    Args:
        physics: Friction coefficients.
        pairs: Contact pairs of the objects.
        tolerance: Largest gap of a touching point [m].
    """
    contacts: list[ContactPoint] = []
    for pair in pairs:
        if pair.separation > tolerance:
            continue
        friction = physics.friction_of(pair.partner)
        positions, gaps = _kernel.touching(
            pair.box.parts, pair.object.parts, pair.normal, pair.on_object, pair.edges, tolerance
        )
        contacts += [
            ContactPoint(pair.partner, position, pair.normal, gap, friction, pair.body)
            for position, gap in zip(positions, gaps.tolist(), strict=True)
        ]
    return contacts


def contact_frame(normal: Array) -> Array:
    """Rows: two tangents and the normal, ``(3, 3)`` (Duff et al. 2017, without branches and singularities)."""
    x, y, z = normal
    sign = 1.0 if z >= 0.0 else -1.0
    a = -1.0 / (sign + z)
    b = x * y * a
    return np.array([[1.0 + sign * x * x * a, sign * b, -sign * x], [b, sign + y * y * a, -y], [x, y, z]])
