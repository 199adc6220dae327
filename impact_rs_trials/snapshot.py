# SPDX-License-Identifier: Apache-2.0
"""State of a running graph, for the page that shows it live."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from impact_rs_sim.physics import Physics
from impact_rs_sim.robots.robot import Array

Situation = Literal["absent", "idle", "running", "over", "gone"]
"""``absent``: no nodes. ``idle``: nodes, and no joint states yet. ``running``: joint states arrive. ``over``: they have
stopped. ``gone``: they have stopped, and the nodes have ended."""


@dataclass(frozen=True)
class IdentifyMessages:
    """The newest messages of a node ``identify``, as JSON documents; empty: not yet.

    Attributes:
        prediction: Prediction of the next hit, with the parameters believed.
        changes: Changes of the cell, in the order of detection.
        diagnosis: Result of the last full diagnosis.
        refused: Last trial without a hit, with the reason.
    """

    prediction: str = ""
    changes: tuple[str, ...] = ()
    diagnosis: str = ""
    refused: str = ""


@dataclass(frozen=True)
class Snapshot:
    """The newest state of a graph.

    Attributes:
        situation: State of nodes and joint states.
        place: ROS domain and namespace, as text.
        number: Increases when the scene changes; the scene of an unchanged number is the same.
        title: Name of the trial; empty: unknown.
        physics: Nominal physics of the scene of the trial; None: unknown.
        description: URDF of the robot without a trial; empty: not published.
        complaint: Why the published trial cannot be shown; empty: it can.
        time: Trial time of the newest controller state [s]; None: unknown.
        positions: Joint positions by their names in the URDF [rad, m].
        velocities: Joint velocities by the same names [rad/s, m/s]; empty if not published.
        object: Position of the object's centre in A [m] and quaternion x y z w, ``(7,)``; None: unknown.
        neighbours: Poses of the object's neighbours by name, ``(7,)``; None: unknown.
        forces: By arm, true force of the arm on the object, axes of A, ``(3,)`` [N]; empty if not published.
        followed: Documents of the node ``identify`` of the graph.
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
    velocities: dict[str, float] = field(default_factory=dict)
    object: Array | None = None
    neighbours: dict[str, Array | None] = field(default_factory=dict)
    forces: dict[str, Array] = field(default_factory=dict)
    followed: IdentifyMessages = IdentifyMessages()
