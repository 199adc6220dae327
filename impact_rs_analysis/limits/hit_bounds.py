# SPDX-License-Identifier: Apache-2.0
"""Load limits of a robot at a hit: bounds from the robot facts as a vector with names.

========== ================================================= =========================================
kind       quantity                                          bound
========== ================================================= =========================================
jump       joint velocity, 5 to 15 ms after minus before     ``reflexes.velocity_jump_rad_s``
speed      largest joint velocity                            ``limits.velocity_rad_s``
torque     largest joint torque, gravity included            ``limits.torque_Nm``
reflex     largest external joint torque, filtered           ``reflexes.external_torque_Nm``
force      largest external force at E, filtered             ``reflexes.external_force_N``
========== ================================================= =========================================

The robot has no force sensor at its pad: it measures a hit with its joints. Reflexes compare a momentum observer (De
Luca et al. 2006) with thresholds,

    r = k_o (M dq - M dq_0 - int (tau_J - tau_J0 + r) dt)  [N m],

the external torque J^T f behind a low-pass filter of the rate k_o [1/s]. The external force is the least-squares force
at the origin of E, (J_v^T)^+ r [N].
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from impact_rs_sim.physics import Physics
from impact_rs_sim.robots.robot import Array, Reflexes, RobotFacts

KINDS = ("jump", "speed", "torque", "reflex", "force")
KIND_WORDS = {
    "jump": "joint velocity jump",
    "speed": "joint velocity",
    "torque": "joint torque",
    "reflex": "external joint torque",
    "force": "external force",
}


@dataclass(frozen=True)
class Thresholds:
    """User thresholds that replace the limits of the robot facts.

    Attributes:
        velocity_jump: Limit of every joint [rad/s]; None: as in the facts.
        external_torque: Limit of every joint [N m]; None: as in the facts.
        external_force: [N]; None: as in the facts.
    """

    velocity_jump: float | None = None
    external_torque: float | None = None
    external_force: float | None = None


NO_THRESHOLDS = Thresholds()


@dataclass(frozen=True)
class Bounds:
    """Bounds of all quantities of a scene.

    Attributes:
        names: ``arm joint 2 torque`` ..., in the order of :func:`impact_rs_analysis.limits.drawn_hits.quantities`.
        kinds: Kind of every quantity, one of ``KINDS``.
        units: Unit of every quantity.
        values: Upper bounds, ``(k,)``; inf: unknown.
    """

    names: tuple[str, ...]
    kinds: tuple[str, ...]
    units: tuple[str, ...]
    values: Array

    @property
    def unknown(self) -> tuple[str, ...]:
        """Kinds without a bound, which the speed limit ignores."""
        bounded = {kind for kind, value in zip(self.kinds, self.values, strict=True) if np.isfinite(value)}
        return tuple(kind for kind in KINDS if kind not in bounded)


def bounds_of(physics: Physics, thresholds: Thresholds = NO_THRESHOLDS) -> Bounds:
    """Bounds of the arms of a scene."""
    names: list[str] = []
    kinds: list[str] = []
    units: list[str] = []
    values: list[float] = []
    for arm, arm_physics in physics.arms.items():
        joints = arm_physics.facts.units
        of_kind = _values(arm_physics.facts, thresholds)
        unit_kind = {"jump": "velocity", "speed": "velocity", "torque": "effort", "reflex": "effort"}
        for kind in KINDS[:-1]:
            for number, joint_units in enumerate(joints, start=1):
                names.append(f"{arm} joint {number} {KIND_WORDS[kind]}")
                units.append(str(getattr(joint_units, unit_kind[kind])))
            kinds += [kind] * len(joints)
            values += of_kind[kind]
        names.append(f"{arm} {KIND_WORDS['force']}")
        kinds.append("force")
        units.append("N")
        values += of_kind["force"]
    return Bounds(tuple(names), tuple(kinds), tuple(units), np.array(values))


def _values(facts: RobotFacts, thresholds: Thresholds) -> Mapping[str, list[float]]:
    """Bounds of one arm by kind."""
    count = facts.joint_count
    reflexes = facts.reflexes or Reflexes()

    def by_joint(threshold: float | None, facts_bounds: tuple[float, ...] | None) -> list[float]:
        if threshold is not None:
            return [threshold] * count
        return [np.inf] * count if facts_bounds is None else list(facts_bounds)

    force = thresholds.external_force if thresholds.external_force is not None else reflexes.external_force_N
    return {
        "jump": by_joint(thresholds.velocity_jump, reflexes.velocity_jump_rad_s),
        "speed": list(facts.limits.velocity_rad_s),
        "torque": list(facts.limits.torque_Nm),
        "reflex": by_joint(thresholds.external_torque, reflexes.external_torque_Nm),
        "force": [np.inf if force is None else force],
    }
