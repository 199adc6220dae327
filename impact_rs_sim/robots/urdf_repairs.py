# SPDX-License-Identifier: Apache-2.0
"""User corrections of a URDF: missing limits, moments of inertia about joints, locked joints.

A URDF states moments of inertia about the centre of mass. Some files have them about the joint instead, too large by
the Steiner term (parallel-axis theorem),

    I_joint = I_centre + m (r^2 1 - r r^T),        r from the joint to the centre of mass.

A link is suspected if every moment about the axes perpendicular to r is at least m r^2, the lower bound of moments
about the joint. Long links of real arms are slender (a rod, a tube): their moments across are about m r^2 / 3 about
the centre and 4/3 m r^2 about the joint. Short links may be as wide as they are long, and are not judged. If all three
moments are one number, it may be the moment about the joint axis: then it is at least m d^2, with d the distance of the
centre of mass from that axis.
"""

from __future__ import annotations

import fnmatch
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from impact_rs_sim.decimals import decimal
from impact_rs_sim.errors import InputError, did_you_mean
from impact_rs_sim.robots.robot import Array

QUANTITIES = ("position", "velocity", "effort")
LIMIT_PATTERN = re.compile(r"(?P<joint>.+)\.(?P<quantity>position|velocity|effort)=(?P<value>.+)")
MIN_STEINER_RATIO = 1.0  # moment across r over m r^2 of moments that are taken to be about the joint [-]
# Distance of the centre of mass from the joint axis over the length of the arm, of a link that is judged [-]
MIN_LONG_LINK_RATIO = 0.12
ALL_JOINTS = "*"

Limits = Mapping[tuple[str, str], tuple[float, ...]]


def given_limits(texts: Sequence[str], joints: Sequence[str], file: Path) -> Limits:
    """Limits from command-line options, by joint and quantity.

    Args:
        texts: ``elbow.effort=10``, ``*.position=-3:3``; ``*`` stands for all joints.
        joints: Names of the joints of the chain.
        file: The URDF, for messages.

    Raises:
        InputError: A text has another form, or there is no such joint.
    """
    limits: dict[tuple[str, str], tuple[float, ...]] = {}
    for text in texts:
        match = LIMIT_PATTERN.fullmatch(text)
        try:
            numbers = tuple(decimal(part) for part in match["value"].split(":")) if match else ()
        except ValueError:
            numbers = ()
        if (
            match is None
            or len(numbers) != (2 if match["quantity"] == "position" else 1)
            or not np.isfinite(numbers).all()
        ):
            expected = "expected JOINT.position=LOW:HIGH, JOINT.velocity=MOST or JOINT.effort=MOST; * is every joint"
            raise InputError(expected, key="--limits", value=text)
        if match["joint"] not in (ALL_JOINTS, *joints):
            near = did_you_mean(match["joint"], joints)
            raise InputError(
                f"no joint {match['joint']!r}{near}; it has: {', '.join(joints)}", file=file, key="--limits"
            )
        for joint in joints if match["joint"] == ALL_JOINTS else (match["joint"],):
            if match["joint"] != ALL_JOINTS or (joint, match["quantity"]) not in limits:
                limits[joint, match["quantity"]] = numbers
    return limits


def locked_joints(texts: Sequence[str], joints: Sequence[str], file: Path) -> dict[str, float]:
    """Positions of locked joints by joint [rad or m].

    Args:
        texts: ``head_1=0.2``, ``head_*=0``; ``*`` matches any text. For a joint, its full name takes precedence over
            patterns, and later texts over earlier ones.
        joints: Names of the joints that move.
        file: The URDF, for messages.

    Raises:
        InputError: A text has another form, or no joint matches it.
    """
    positions: dict[str, float] = {}
    for text in sorted(texts, key=lambda text: text.rpartition("=")[0] in joints):
        name, _, value = text.rpartition("=")
        try:
            position = decimal(value)
        except ValueError:
            position = math.nan
        if not name or not math.isfinite(position):
            raise InputError("expected JOINT=PLACE, a number in rad or m; * matches any text", key="--lock", value=text)
        matching = [name] if name in joints else fnmatch.filter(joints, name)
        if not matching:
            near = did_you_mean(name, joints)
            raise InputError(f"no joint {name!r} moves{near}; it has: {', '.join(joints)}", file=file, key="--lock")
        positions |= dict.fromkeys(matching, position)
    return positions


def suspected_steiner_ratio(mass: float, centre: Array, inertia: Array, axis: Array, length: float) -> float | None:
    """Ratio of moment to Steiner term (m r^2 or m d^2) of an inertia that seems to be about the joint; else None.

    Args:
        mass: Mass of the link [kg].
        centre: Centre of mass, from the joint, ``(3,)`` [m].
        inertia: As the URDF has it, ``(3, 3)`` [kg m^2].
        axis: Axis of the joint, ``(3,)``.
        length: Length of the arm along its joints [m].
    """
    distance = float(np.linalg.norm(np.cross(axis, centre)))
    if distance < max(MIN_LONG_LINK_RATIO * length, 1e-9) or mass <= 0.0:
        return None
    across = np.linalg.svd(centre[None])[2][1:]  # two directions perpendicular to r
    ratio = max(
        float(np.linalg.eigvalsh(across @ inertia @ across.T)[0]) / (mass * float(centre @ centre)),
        float(np.linalg.eigvalsh(inertia)[0]) / (mass * distance**2),
    )
    return ratio if ratio >= MIN_STEINER_RATIO else None


def about_centre(mass: float, centre: Array, inertia: Array, axis: Array) -> Array | None:
    """Inertia about the centre of mass from that about the joint, ``(3, 3)``; None: the result is no body.

    By the parallel-axis theorem; if its result is physically inconsistent (three equal moments in the file), the
    Steiner term about the joint axis is subtracted from every moment.

    Args:
        mass: Mass of the link [kg].
        centre: Centre of mass, from the joint, ``(3,)`` [m].
        inertia: About the joint, ``(3, 3)`` [kg m^2].
        axis: Axis of the joint, ``(3,)``.
    """
    square = float(centre @ centre)
    moved = inertia - mass * (square * np.eye(3) - np.outer(centre, centre))
    if _is_of_a_body(moved):
        return np.asarray(moved)
    moved = inertia - mass * float(np.sum(np.square(np.cross(axis, centre)))) * np.eye(3)
    return np.asarray(moved) if _is_of_a_body(moved) else None


def _is_of_a_body(inertia: Array) -> bool:
    moments = np.linalg.eigvalsh(inertia)
    return bool(moments[0] > 0.0 and moments[2] <= (moments[0] + moments[1]) * (1.0 + 1e-6))
