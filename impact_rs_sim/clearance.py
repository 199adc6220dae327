# SPDX-License-Identifier: Apache-2.0
"""Clearance between two arms, checked before a trial starts.

Every link is a capsule from its joint to the next one; Coal, the collision library below Pinocchio, finds distances. A
coarse hull, on the safe side where a real link is slimmer.
"""

from __future__ import annotations

from itertools import combinations

import coal
import numpy as np

from impact_rs_sim.errors import Infeasible
from impact_rs_sim.robot import Array
from impact_rs_sim.robot_model import RobotModel

RADIUS = 0.06  # m, of a link of the arm
SHORTEST = 1e-6  # m; joints that share an origin have no link between them

Capsule = tuple[str, coal.Capsule, coal.Transform3s]


def capsules(model: RobotModel, q: Array) -> list[Capsule]:
    """Hull of an arm: name, shape and placement of every link that has a length.

    Args:
        model: The arm.
        q: Joint positions, ``(n,)`` [rad].
    """
    places = model.link_placements(q)
    names = ["base", *(f"link{index + 1}" for index in range(model.joint_count))]
    pad = model.placement(q)
    origins = [places[name].translation for name in names] + [pad.translation - RADIUS * pad.rotation[:, 2]]
    hull = []
    for name, start, end in zip(names, origins, origins[1:], strict=False):
        length = float(np.linalg.norm(end - start))
        if length < SHORTEST:
            continue
        along = (end - start) / length
        across = np.linalg.svd(along[None])[2][1:]
        rotation = np.column_stack((across[0], np.cross(along, across[0]), along))
        hull.append((name, coal.Capsule(RADIUS, length), coal.Transform3s(rotation, 0.5 * (start + end))))
    return hull


def check_clearance(models: dict[str, RobotModel], positions: dict[str, Array], when: str) -> None:
    """Check that no two arms touch.

    Args:
        models: Arms by name.
        positions: Joint positions by arm, ``(n,)`` [rad].
        when: What moment this is, for the message.

    Raises:
        Infeasible: Two arms touch; names their links and by how much they overlap.
    """
    hulls = {name: capsules(model, positions[name]) for name, model in models.items()}
    for first, second in combinations(hulls, 2):
        for name, shape, place in hulls[first]:
            for other, other_shape, other_place in hulls[second]:
                gap = coal.distance(
                    shape, place, other_shape, other_place, coal.DistanceRequest(), coal.DistanceResult()
                )
                if gap < 0.0:
                    raise Infeasible(
                        f"arms {first!r} and {second!r} collide {when}: {name} and {other} overlap by {-gap:.3f} m; "
                        "move their bases apart or choose other impact poses"
                    )
