# SPDX-License-Identifier: Apache-2.0
"""Where two boxes touch, plainly in NumPy: what the compiled search is held against."""

from __future__ import annotations

import itertools

import numpy as np

from impact_rs_sim.impact_map.contacts import ALIGNED, ContactPair, ConvexBody

CROSSED = 0.995  # cosine; edges whose common normal is nearer to that of a face are corners of faces that touch
PARALLEL = 1e-2  # sine of the angle of two edges, below which they do not cross


def meet(partner: ConvexBody, thing: ConvexBody) -> tuple[float, np.ndarray, bool, tuple[int, int] | None]:
    """How two boxes stand to each other.

    Returns:
        Separation along the direction that separates them best, of a face or of two edges that cross (negative:
        overlap) [m]; unit normal from ``partner`` into ``thing``, ``(3,)``; whether it belongs to a face of ``thing``;
        the axes of the edges that own it, None: a face does.
    """
    separation, normal, on_object = separating_face(partner, thing)
    best, edges, along = separation, None, normal
    for pair in itertools.product(range(3), range(3)):
        across = np.cross(partner.rotation[:, pair[0]], thing.rotation[:, pair[1]])
        if np.linalg.norm(across) < PARALLEL:
            continue
        direction = across / np.linalg.norm(across)
        direction *= np.copysign(1.0, direction @ (thing.centre - partner.centre))
        found = crossing(partner, thing, pair, direction)
        if found is not None and found[1] > best:
            best, edges, along = found[1], pair, direction
    if edges is None or along @ normal >= CROSSED:
        return best, normal, on_object, None
    return best, along, False, edges


def crossing(
    partner: ConvexBody, thing: ConvexBody, pair: tuple[int, int], normal: np.ndarray
) -> tuple[np.ndarray, float] | None:
    """Point on the foremost edge of ``thing`` where it passes that of ``partner``, and its gap; None: beyond an end."""
    ends = []
    for box, axis, direction in ((partner, pair[0], normal), (thing, pair[1], -normal)):
        corners = np.array(list(itertools.product((-1.0, 1.0), repeat=3))) * box.half
        first = corners[np.argmax(corners @ (box.rotation.T @ direction))]
        low, high = (np.where(np.arange(3) == axis, side * box.half, first) for side in (-1.0, 1.0))
        ends.append((box.centre + box.rotation @ low, box.rotation @ (high - low)))
    (start, along), (own, mine) = ends
    shares = np.linalg.lstsq(np.column_stack((along, -mine)), own - start, rcond=None)[0]
    if np.any(shares < 0.0) or np.any(shares > 1.0):
        return None
    point = own + shares[1] * mine
    return point, float(normal @ (point - start - shares[0] * along))


def separating_face(partner: ConvexBody, thing: ConvexBody) -> tuple[float, np.ndarray, bool]:
    """The face direction that separates two boxes best; of aligned faces the one that does so after a tilt as well.

    A tilt by dphi costs the direction of a face the extent of the other box along that face, times dphi: of two faces
    that lie on each other, that of the larger box keeps the normal on either side.

    Returns:
        Separation along it (negative: overlap) [m]; unit normal from ``partner`` into ``thing``, ``(3,)``; whether the
        face belongs to ``thing``.
    """
    axes = np.concatenate((partner.rotation.T, thing.rotation.T))
    distance = axes @ (thing.centre - partner.centre)
    reach = np.abs(axes @ partner.rotation) @ partner.half + np.abs(axes @ thing.rotation) @ thing.half
    separation = np.abs(distance) - reach
    as_good = np.flatnonzero(separation >= separation.max() - ALIGNED)
    best = int(min(as_good, key=lambda index: _extent(partner if index >= 3 else thing, axes[index])))
    sign = 1.0 if distance[best] >= 0.0 else -1.0
    return float(separation[best]), sign * axes[best], best >= 3


def _extent(box: ConvexBody, axis: np.ndarray) -> float:
    """Half the diagonal of a box's face across an axis [m]."""
    along = int(np.argmax(np.abs(box.rotation.T @ axis)))
    return float(np.linalg.norm(np.delete(box.half, along)))


def touching(pair: ContactPair, tolerance: float) -> list[tuple[np.ndarray, float]]:
    """Points on the object with their gaps."""
    if pair.edges is not None:
        found = crossing(pair.box, pair.object, pair.edges, pair.normal)
        return [found] if found is not None and found[1] <= tolerance else []
    # The reference face owns the normal; the incident face of the other box is clipped to it.
    on_object = pair.on_object
    reference, incident = (pair.object, pair.box) if on_object else (pair.box, pair.object)
    outward = -pair.normal if on_object else pair.normal
    axis = int(np.argmax(np.abs(reference.rotation.T @ outward)))
    facing = np.copysign(1.0, reference.rotation[:, axis] @ outward)
    polygon = (_face(incident, -outward) - reference.centre) @ reference.rotation
    for side in (index for index in range(3) if index != axis):
        for sign in (1.0, -1.0):
            polygon = _clip(polygon, side, sign, reference.half[side])
    points = []
    for point in polygon:
        height = facing * point[axis] - reference.half[axis]
        if height > tolerance:
            continue
        position = reference.centre + reference.rotation @ point
        if on_object:
            position = position - height * outward
        points.append((position, float(height)))
    return points


def _face(box: ConvexBody, direction: np.ndarray) -> np.ndarray:
    """Corners of the face that looks most along ``direction``, in order around it, ``(4, 3)`` [m]."""
    local = box.rotation.T @ direction
    axis = int(np.argmax(np.abs(local)))
    u, v = (index for index in range(3) if index != axis)
    corners = np.zeros((4, 3))
    corners[:, axis] = np.copysign(box.half[axis], local[axis])
    corners[:, u] = box.half[u] * np.array([1.0, -1.0, -1.0, 1.0])
    corners[:, v] = box.half[v] * np.array([1.0, 1.0, -1.0, -1.0])
    return box.centre + corners @ box.rotation.T


def _clip(polygon: np.ndarray, axis: int, sign: float, limit: float) -> np.ndarray:
    """The part of a polygon ``(m, 3)`` with ``sign * coordinate <= limit``."""
    inside = sign * polygon[:, axis] - limit if len(polygon) else np.zeros(0)
    kept: list[np.ndarray] = []
    for index, here in enumerate(inside):
        previous = inside[index - 1]
        if (here <= 0.0) != (previous <= 0.0):
            share = previous / (previous - here)
            kept.append(polygon[index - 1] + share * (polygon[index] - polygon[index - 1]))
        if here <= 0.0:
            kept.append(polygon[index])
    return np.array(kept).reshape(-1, 3)
