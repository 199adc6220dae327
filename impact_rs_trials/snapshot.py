# SPDX-License-Identifier: Apache-2.0
"""How a running graph stands, as far as it tells: what a page shows that somebody watches meanwhile."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from impact_rs_sim.physics import Physics
from impact_rs_sim.robot import Array

Situation = Literal["absent", "idle", "running", "over", "gone"]
"""Nobody is there; nodes are there and no arm has moved; it moves; it has moved; the nodes have ended since."""


@dataclass(frozen=True)
class Snapshot:
    """The newest of everything.

    Attributes:
        situation: What is going on.
        place: ROS domain and namespace, for people.
        number: Counts up whenever something else stands there; the scene of an unchanged number is the same.
        title: Which trial; empty: none was told.
        physics: What stands in the scene of the trial, nominal; None: no trial was told.
        description: URDF of the robot, where no trial was told; empty: nobody has described one.
        complaint: Why what was told of the scene cannot be used; empty: it can.
        time: Trial time of the positions [s]; None: there is none.
        positions: Joint positions by their names in the URDF [rad, m].
        object: Position of the object's centre in A [m] and quaternion x y z w, ``(7,)``; None: nobody has told.
        forces: By arm, true force of the arm on the object, axes of A, ``(3,)`` [N]; empty where nobody tells.
    """

    situation: Situation
    place: str
    number: int = 0
    title: str = ""
    physics: Physics | None = None
    description: str = ""
    complaint: str = ""
    time: float | None = None
    positions: dict[str, float] = field(default_factory=dict)
    object: Array | None = None
    forces: dict[str, Array] = field(default_factory=dict)
