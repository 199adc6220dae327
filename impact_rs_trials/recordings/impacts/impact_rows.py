# SPDX-License-Identifier: Apache-2.0
"""Impacts found in runs, and the impact table for compare and diagnose."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from impact_rs_sim.impact_map.contacts import GAP_TOLERANCE
from impact_rs_sim.robots.robot import Array, RobotFacts
from impact_rs_trials.recordings.checks.joint_jumps import JointJump
from impact_rs_trials.recordings.impacts import impact_columns as col
from impact_rs_trials.recordings.impacts.impact_columns import ColumnGroup, arm_label

TABLE_DIGITS = 9  # significant digits
BY_SLIDING_DISTANCE = "sliding distance"  # law after the impact: the velocity follows from the displacement to rest


@dataclass(frozen=True)
class NoRow:
    """An impact or a run without a row.

    Attributes:
        name: Name of the impact or run.
        reason: Reason, in words.
    """

    name: str
    reason: str


@dataclass(frozen=True)
class Impact:
    """One impact, with the states before and after.

    Attributes:
        run: Name of the run.
        condition: Condition of the run; empty: unknown.
        session: Session of the run; empty: unknown. A condition that is only a session has no repeats.
        object_name: Object of the scenario; empty: a free body.
        time: Since the start of the run [s].
        position: Position of the geometric centre, ``(3,)`` [m].
        rotation: Rotation from the axes of the body to the axes of the world, ``(3, 3)``.
        before: Twist just before, ``(6,)`` [m/s, rad/s].
        after: Twist just after, ``(6,)`` [m/s, rad/s].
        noise: Standard deviation of a change of velocity [m/s] and of angular velocity [rad/s].
        tolerance: Uncertainty of the pose at the corners [m].
        contact_noise: Standard deviations of the contact position [m] and its normal [rad], by the pose.
        model: Fitted law after the impact.
        arms: Jumps of the joint velocities by arm; empty: a free body.
        facts: Joints of every arm.
        outcomes: Later measurements by column: friction of the support [-], distance [m].
        turn_tracked: Whether angular velocities after were measured; if not, they are unknown, and a free body's
            angular velocity before is assumed.
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
    arms: Mapping[str, JointJump] = field(default_factory=dict)
    facts: Mapping[str, RobotFacts] = field(default_factory=dict)
    outcomes: Mapping[ColumnGroup, float] = field(default_factory=dict)
    turn_tracked: bool = True
    session: str = ""
    contact_noise: tuple[float, float] = (0.0, 0.0)

    @property
    def distance_noise(self) -> float:
        """Standard deviation of a slide distance D [m]: sigma_D = 2 D sigma_v / v, from v^2 = 2 mu g D.

        It contains the friction of the support, which scatters from hit to hit (``friction_noise``).
        """
        distance = self.outcomes[col.SLIDE_DISTANCE]
        return self.noise[0] * 2.0 * distance / max(float(np.linalg.norm(self.after[:3])), 1e-9)


def table_text(impacts: Sequence[Impact], constants: Mapping[str, float | str]) -> str:
    """The table of impacts as CSV.

    If all velocities after the impact follow from the slide distance, the table has that distance in place of them, so
    that the friction of the support stays a parameter.

    Args:
        impacts: At least one impact, all with the same arms.
        constants: Further columns with one value by header, for example ``mass [kg]``.
    """
    by_distance = all(impact.model == BY_SLIDING_DISTANCE for impact in impacts)
    omitted = {col.V_AFTER, col.V_NOISE} if by_distance else {col.DISTANCE_NOISE}
    omitted |= set() if all(impact.turn_tracked for impact in impacts) else {col.W_AFTER, col.W_NOISE}
    omitted |= set() if any(impact.session for impact in impacts) else {col.SESSION}
    omitted |= set() if any(impact.condition not in ("", impact.session) for impact in impacts) else {col.CONDITION}
    rows = [_cells(impact, omitted, constants) for impact in impacts]
    text = io.StringIO()
    writer = csv.DictWriter(text, list(dict.fromkeys(header for row in rows for header in row)), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def _cells(impact: Impact, omitted: set[ColumnGroup], constants: Mapping[str, float | str]) -> dict[str, str]:
    """Cells of one row by header, in the order of the table."""
    cells: dict[str, str] = {}

    def put(columns: ColumnGroup, *values: float | str) -> None:
        if columns not in omitted:
            cells.update(zip(columns.headers, map(_short, values), strict=True))

    put(col.RUN, impact.run)
    put(col.SESSION, impact.session)
    put(col.CONDITION, impact.condition)
    put(col.IMPACT_TIME, impact.time)
    if impact.object_name:
        put(col.OBJECT, impact.object_name)
    put(col.POSITION, *impact.position)
    put(col.ORIENTATION, *pin.Quaternion(impact.rotation).coeffs())
    put(col.V_BEFORE, *impact.before[:3])
    put(col.W_BEFORE, *impact.before[3:])
    put(col.V_AFTER, *impact.after[:3])
    put(col.W_AFTER, *impact.after[3:])
    for name, arm in impact.arms.items():
        label = arm_label(name, impact.arms)
        for joints, values in ((col.Q, arm.position), (col.DQ_BEFORE, arm.before), (col.DQ_AFTER, arm.after)):
            for column, value in zip(joints.of_arm(label, impact.facts[name]), values, strict=True):
                put(column, value)
    if col.SLIDE_DISTANCE in impact.outcomes:
        put(col.DISTANCE_NOISE, impact.distance_noise)
    put(col.V_NOISE, impact.noise[0])
    put(col.W_NOISE, impact.noise[1])
    if impact.arms:
        put(col.DQ_NOISE, float(np.sqrt(np.mean([np.mean(arm.noise**2) for arm in impact.arms.values()]))))
    for column, noise in zip(col.CONTACT_NOISE, impact.contact_noise, strict=True):
        put(column, noise)
    put(col.TOLERANCE, max(impact.tolerance, GAP_TOLERANCE))
    cells |= {header: _short(value) for header, value in constants.items()}
    put(col.LAW, impact.model)
    for column, value in impact.outcomes.items():
        put(column, value)
    return cells


def _short(value: float | str) -> str:
    """A cell: text as it is, a number with ``TABLE_DIGITS`` digits."""
    return value if isinstance(value, str) else f"{value:.{TABLE_DIGITS}g}"
