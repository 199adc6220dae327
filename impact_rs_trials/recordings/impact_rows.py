# SPDX-License-Identifier: Apache-2.0
"""Impacts that were found in runs, and the table that compare and diagnose read."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from impact_rs_sim.impact_map.contacts import GAP_TOLERANCE
from impact_rs_sim.robot import Array

POSE = ("x [m]", "y [m]", "z [m]", "qx [-]", "qy [-]", "qz [-]", "qw [-]")
DIGITS = 9
BY_WAY = "sliding distance"  # law after the impact, where the velocity follows from the way to rest


@dataclass(frozen=True)
class NoRow:
    """An impact or a run that gives no row.

    Attributes:
        name: Which.
        reason: Why.
    """

    name: str
    reason: str


@dataclass(frozen=True)
class ArmInImpact:
    """One arm in an impact.

    Attributes:
        position: q, ``(n,)`` [rad].
        before: dq just before, ``(n,)`` [rad/s].
        after: dq just after, ``(n,)`` [rad/s].
        noise: Standard deviation of the change of dq, rms over the joints [rad/s].
        units: Units of position and velocity by joint.
    """

    position: Array
    before: Array
    after: Array
    noise: float
    units: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Impact:
    """One impact, with the state on both sides.

    Attributes:
        run: Where it was found.
        condition: Condition of the run; empty: none was said.
        session: Session of the run; empty: none was said. Where it is the whole condition, its impacts are no repeats.
        object_name: Object of the scenario; empty: a free body.
        time: Since the start of the run [s].
        position: Of the geometric centre, ``(3,)`` [m].
        rotation: From its axes to those of the world, ``(3, 3)``.
        before: Twist just before, ``(6,)`` [m/s, rad/s].
        after: Twist just after, ``(6,)`` [m/s, rad/s].
        noise: Standard deviation of a change of velocity [m/s] and of angular velocity [rad/s].
        tolerance: By how much the pose is known at its corners [m].
        contact_noise: Standard deviations of the place of the contact [m] and of its normal [rad], by the pose.
        model: Law that was fitted after the impact.
        arms: Arms by name; empty: a free body.
        outcomes: What was measured later: friction of the support [-], distance [m].
        turn_tracked: Whether angular velocities after were measured; if not, none is known. That of a free body before
            is assumed then.
    """

    run: str
    condition: str
    object_name: str
    time: float
    position: Array
    rotation: Array
    before: Array
    after: Array
    noise: tuple[float, float]
    tolerance: float
    model: str
    arms: Mapping[str, ArmInImpact] = field(default_factory=dict)
    outcomes: Mapping[str, float] = field(default_factory=dict)
    turn_tracked: bool = True
    session: str = ""
    contact_noise: tuple[float, float] = (0.0, 0.0)

    @property
    def noise_of_way(self) -> float:
        """Standard deviation of a slide distance D, with v^2 = 2 mu g D and the noise of v [m]."""
        way = self.outcomes["slide_distance [m]"]
        return self.noise[0] * 2.0 * way / max(float(np.linalg.norm(self.after[:3])), 1e-9)


def table_text(impacts: Sequence[Impact], constants: Mapping[str, float]) -> str:
    """The table of impacts as CSV.

    Where all velocities after follow from the way that the object slid, that way is the outcome and they are left out,
    so that the friction of the support stays a parameter.

    Args:
        impacts: At least one, all of the same arms.
        constants: Further columns with one value, for example ``mass [kg]``.
    """
    several = len(impacts[0].arms) > 1
    outcomes = list(dict.fromkeys(name for impact in impacts for name in impact.outcomes))
    header = ["run", "session", "condition", "impact_time [s]"]
    header += ["object"] if impacts[0].object_name else []
    header += POSE
    header += [f"v{axis}_before [m/s]" for axis in "xyz"] + [f"w{axis}_before [rad/s]" for axis in "xyz"]
    header += [f"v{axis}_after [m/s]" for axis in "xyz"]
    turned = all(impact.turn_tracked for impact in impacts)
    by_way = all(impact.model == BY_WAY for impact in impacts)
    header = header[:-3] if by_way else header
    header += [f"w{axis}_after [rad/s]" for axis in "xyz"] if turned else []
    for name, arm in impacts[0].arms.items():
        label = f"{name}." if several else ""
        header += [f"{label}q{joint} [{unit}]" for joint, (unit, _) in enumerate(arm.units, start=1)]
        for tail in ("before", "after"):
            header += [f"{label}dq{joint}_{tail} [{unit}]" for joint, (_, unit) in enumerate(arm.units, start=1)]
    header += ["distance_noise [m]" if by_way else "v_noise [m/s]", *(["w_noise [rad/s]"] if turned else [])]
    header += ["dq_noise [rad/s]"] if impacts[0].arms else []
    header += ["p_noise [m]", "n_noise [rad]", "contact_tolerance [m]", *constants, "law after", *outcomes]
    if not any(impact.session for impact in impacts):
        header.remove("session")
    if not any(impact.condition not in ("", impact.session) for impact in impacts):
        header.remove("condition")
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    for impact in impacts:
        after = impact.after if turned else impact.after[:0] if by_way else impact.after[:3]
        numbers = [*impact.position, *pin.Quaternion(impact.rotation).coeffs(), *impact.before, *after]
        for arm in impact.arms.values():
            numbers += [*arm.position, *arm.before, *arm.after]
        numbers += impact.noise if turned else [impact.noise_of_way] if by_way else impact.noise[:1]
        if impact.arms:
            numbers.append(float(np.sqrt(np.mean([arm.noise**2 for arm in impact.arms.values()]))))
        numbers += [*impact.contact_noise, max(impact.tolerance, GAP_TOLERANCE), *constants.values()]
        first = [impact.run, *(getattr(impact, name) for name in ("session", "condition") if name in header)]
        first.append(_short(impact.time))
        first += [impact.object_name] if impact.object_name else []
        last = [_short(impact.outcomes[name]) if name in impact.outcomes else "" for name in outcomes]
        writer.writerow([*first, *map(_short, numbers), impact.model, *last])
    return text.getvalue()


def _short(number: float) -> str:
    return f"{number:.{DIGITS}g}"
