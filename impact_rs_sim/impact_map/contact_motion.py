# SPDX-License-Identifier: Apache-2.0
"""How contact points move with the bodies that touch.

A contact point is a corner of the incident face, clipped to the reference face: the point x where the plane of the
incident face meets two planes more, sides of either box (:mod:`impact_rs_sim.impact_map.contacts`). A plane k of a body
with the motion w(y) = dp + dphi x (y - p) keeps x in it if n_k . dx = n_k . w(x), so

    (n_1, n_2, n_3)^T dx = (n_k . w_k(x))_k

and the normal n, of the reference face, turns with its body. The point of the other body is x moved along n by the gap.

Where two edges cross, along a of the partner and b of the object, x is the point of the object's edge and y that of the
partner's, with x - y = g n and n along a x b. Either edge turns with its body, and its point slides along it:

    dn = (1 - n n^T) (dphi_P x a x b + a x dphi_O x b) / |a x b|
    w_O(x) + b dt - w_P(y) - a ds = n dg + g dn
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from impact_rs_sim.impact_map.contacts import Box, ContactPoint, Meeting
from impact_rs_sim.impact_map.laws import point_maps
from impact_rs_sim.robot import Array

_ON_PLANE = 1e-9  # m; clipping leaves points in the planes that clip them up to rounding
_PARALLEL = 1e-6  # determinant of three unit normals below which two planes are one


@dataclass(frozen=True)
class PointMotion:
    """Derivatives of one contact point with respect to motions (dp, dphi) of object and partner, in axes of A.

    Attributes:
        on_object: Of the point on the object, ``(3, 12)``, the object's motion first.
        on_partner: Of the point on the partner, ``(3, 12)``.
        normal: Rotation vector by which the normal turns, ``(3, 12)``.
        smooth: Whether exactly three planes meet; elsewhere a motion takes the point from one triple to another.
    """

    on_object: Array
    on_partner: Array
    normal: Array
    smooth: bool


def point_motion(meeting: Meeting, contact: ContactPoint) -> PointMotion:
    """How a contact point of a meeting moves; motions are about the centres of the two boxes."""
    if meeting.edges is not None:
        return _crossing_motion(meeting, contact, meeting.edges)
    object_, partner = meeting.object, meeting.box
    incident, reference = (partner, object_) if meeting.on_object else (object_, partner)
    x = contact.partner_position if meeting.on_object else contact.position
    outward = -meeting.normal if meeting.on_object else meeting.normal
    of_object, of_partner = np.zeros((3, 12)), np.zeros((3, 12))
    of_object[:, :6] = point_maps((x - object_.centre)[None])[0]
    of_partner[:, 6:] = point_maps((x - partner.centre)[None])[0]
    of_incident, of_reference = (of_partner, of_object) if meeting.on_object else (of_object, of_partner)
    planes = [(_face_normal(incident, -outward), of_incident)]
    sides = [(normal, of_incident) for normal in _sides_at(incident, x, planes[0][0])]
    sides += [(normal, of_reference) for normal in _sides_at(reference, x, outward)]
    smooth = len(sides) == 2
    for first in range(len(sides)):
        for second in range(first + 1, len(sides)):
            trio = [*planes, sides[first], sides[second]]
            normals = np.array([normal for normal, _ in trio])
            if abs(np.linalg.det(normals)) > _PARALLEL:
                moved = np.linalg.solve(normals, np.array([normal @ motion for normal, motion in trio]))
                return _both_sides(meeting, contact, moved, smooth)
    return _both_sides(meeting, contact, of_incident, False)


def _crossing_motion(meeting: Meeting, contact: ContactPoint, edges: tuple[int, int]) -> PointMotion:
    """How the point of two edges that cross moves."""
    a, b = meeting.box.rotation[:, edges[0]], meeting.object.rotation[:, edges[1]]
    n, gap = meeting.normal, contact.gap
    of_object, of_partner, along, across = (np.zeros((3, 12)) for _ in range(4))
    of_object[:, :6] = point_maps((contact.position - meeting.object.centre)[None])[0]
    of_partner[:, 6:] = point_maps((contact.partner_position - meeting.box.centre)[None])[0]
    along[:, 3:6], across[:, 9:] = -_cross(b), -_cross(a)  # db and da
    normal = np.cross(a, b)
    moved = (_cross(a) @ along - _cross(b) @ across) * np.sign(normal @ n) / np.linalg.norm(normal)
    moved -= np.outer(n, n @ moved)  # dn
    sliding = np.linalg.solve(np.column_stack((b, -a, -n)), of_partner - of_object + gap * moved)
    turned = _cross(n) @ moved
    return PointMotion(of_object + np.outer(b, sliding[0]), of_partner + np.outer(a, sliding[1]), turned, True)


def _both_sides(meeting: Meeting, contact: ContactPoint, moved: Array, smooth: bool) -> PointMotion:
    """The point on object and partner, where ``moved`` ``(3, 12)`` is the one that was clipped."""
    turned = np.zeros((3, 12))
    turned[:, slice(3, 6) if meeting.on_object else slice(9, 12)] = np.eye(3)
    normal, gap = contact.normal, contact.gap
    turning = -_cross(normal) @ turned  # dn = dphi x n
    if meeting.on_object:
        surface = np.zeros((3, 12))
        surface[:, :6] = point_maps((contact.position - meeting.object.centre)[None])[0]
        opening = normal @ (surface - moved)
        return PointMotion(moved + np.outer(normal, opening) + gap * turning, moved, turned, smooth)
    surface = np.zeros((3, 12))
    surface[:, 6:] = point_maps((contact.partner_position - meeting.box.centre)[None])[0]
    opening = normal @ (moved - surface)
    return PointMotion(moved, moved - np.outer(normal, opening) - gap * turning, turned, smooth)


def _face_normal(box: Box, direction: Array) -> Array:
    """Unit normal of the face that looks most along ``direction``."""
    local = box.rotation.T @ direction
    axis = int(np.argmax(np.abs(local)))
    return np.asarray(np.sign(local[axis]) * box.rotation[:, axis])


def _sides_at(box: Box, point: Array, face: Array) -> Sequence[Array]:
    """Normals of the sides of ``face`` in which a point lies."""
    local = box.rotation.T @ (point - box.centre)
    front = int(np.argmax(np.abs(box.rotation.T @ face)))
    return [
        np.sign(local[axis]) * box.rotation[:, axis]
        for axis in range(3)
        if axis != front and abs(abs(local[axis]) - box.half[axis]) < _ON_PLANE
    ]


def _cross(vector: Array) -> Array:
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
