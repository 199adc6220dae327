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
from impact_rs_sim.robots.robot import Array, JointUnits
from impact_rs_trials.recordings.impacts.impact_columns import (
    CONDITION,
    CONTACT_NOISE,
    DISTANCE_NOISE,
    DQ_AFTER,
    DQ_BEFORE,
    DQ_NOISE,
    IMPACT_TIME,
    LAW,
    OBJECT,
    ORIENTATION,
    POSITION,
    RUN,
    SESSION,
    SLIDE_DISTANCE,
    TOLERANCE,
    V_AFTER,
    V_BEFORE,
    V_NOISE,
    W_AFTER,
    W_BEFORE,
    W_NOISE,
    ColumnGroup,
    Q,
    arm_label,
)

TABLE_DIGITS = 9  # significant ones
BY_SLIDING_DISTANCE = "sliding distance"  # law after the impact: the velocity follows from the displacement to rest


@dataclass(frozen=True)
class NoRow:
    """An impact or a run without a row.

    Attributes:
        name: Name of the impact or run.
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
        units: Units of every joint.
    """

    position: Array
    before: Array
    after: Array
    noise: float
    units: tuple[JointUnits, ...]


@dataclass(frozen=True)
class Impact:
    """One impact, with the states before and after.

    Attributes:
        run: Its run.
        condition: Condition of the run; empty: unknown.
        session: Session of the run; empty: unknown. A condition that is only a session has no repeats.
        object_name: Object of the scenario; empty: a free body.
        time: Since the start of the run [s].
        position: Of the geometric centre, ``(3,)`` [m].
        rotation: From its axes to the axes of the world, ``(3, 3)``.
        before: Twist just before, ``(6,)`` [m/s, rad/s].
        after: Twist just after, ``(6,)`` [m/s, rad/s].
        noise: Standard deviation of a change of velocity [m/s] and of angular velocity [rad/s].
        tolerance: Uncertainty of the pose at the corners [m].
        contact_noise: Standard deviations of the contact position [m] and its normal [rad], by the pose.
        model: Fitted law after the impact.
        arms: Arms by name; empty: a free body.
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
    arms: Mapping[str, ArmInImpact] = field(default_factory=dict)
    outcomes: Mapping[ColumnGroup, float] = field(default_factory=dict)
    turn_tracked: bool = True
    session: str = ""
    contact_noise: tuple[float, float] = (0.0, 0.0)

    @property
    def distance_noise(self) -> float:
        """Standard deviation of a slide distance D, with v^2 = 2 mu g D and the noise of v [m]."""
        distance = self.outcomes[SLIDE_DISTANCE]
        return self.noise[0] * 2.0 * distance / max(float(np.linalg.norm(self.after[:3])), 1e-9)


def table_text(impacts: Sequence[Impact], constants: Mapping[str, float | str]) -> str:
    """The table of impacts as CSV.

    If all velocities after follow from the slide distance, that distance is the outcome and they are omitted, so
    that the friction of the support stays a parameter.

    Args:
        impacts: At least one, all of the same arms.
        constants: Further columns with one value by header, for example ``mass [kg]``.
    """
    form = _Form(
        turned=all(impact.turn_tracked for impact in impacts),
        by_distance=all(impact.model == BY_SLIDING_DISTANCE for impact in impacts),
        sessions=any(impact.session for impact in impacts),
        conditions=any(impact.condition not in ("", impact.session) for impact in impacts),
    )
    rows = [_cells(impact, form, constants) for impact in impacts]
    text = io.StringIO()
    writer = csv.DictWriter(text, list(dict.fromkeys(header for row in rows for header in row)), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


@dataclass(frozen=True)
class _Form:
    """Common properties of all rows of a table.

    Attributes:
        turned: Whether angular velocities after were measured.
        by_distance: Whether the slide distance replaces velocities after.
        sessions: Whether some run has a session.
        conditions: Whether conditions differ from sessions.
    """

    turned: bool
    by_distance: bool
    sessions: bool
    conditions: bool


def _cells(impact: Impact, form: _Form, constants: Mapping[str, float | str]) -> dict[str, str]:
    """Cells of one row by header, in the order of the table."""
    cells: dict[str, str] = {}

    def put(columns: ColumnGroup, *values: float | str) -> None:
        texts = (value if isinstance(value, str) else _short(value) for value in values)
        cells.update(zip(columns.headers, texts, strict=True))

    put(RUN, impact.run)
    if form.sessions:
        put(SESSION, impact.session)
    if form.conditions:
        put(CONDITION, impact.condition)
    put(IMPACT_TIME, impact.time)
    if impact.object_name:
        put(OBJECT, impact.object_name)
    put(POSITION, *impact.position)
    put(ORIENTATION, *pin.Quaternion(impact.rotation).coeffs())
    put(V_BEFORE, *impact.before[:3])
    put(W_BEFORE, *impact.before[3:])
    if not form.by_distance:
        put(V_AFTER, *impact.after[:3])
    if form.turned:
        put(W_AFTER, *impact.after[3:])
    for name, arm in impact.arms.items():
        label = arm_label(name, impact.arms)
        for joints, values in ((Q, arm.position), (DQ_BEFORE, arm.before), (DQ_AFTER, arm.after)):
            for column, value in zip(joints.of_arm(label, arm.units), values, strict=True):
                put(column, value)
    if form.by_distance:
        put(DISTANCE_NOISE, impact.distance_noise)
    else:
        put(V_NOISE, impact.noise[0])
    if form.turned:
        put(W_NOISE, impact.noise[1])
    if impact.arms:
        put(DQ_NOISE, float(np.sqrt(np.mean([arm.noise**2 for arm in impact.arms.values()]))))
    for column, noise in zip(CONTACT_NOISE, impact.contact_noise, strict=True):
        put(column, noise)
    put(TOLERANCE, max(impact.tolerance, GAP_TOLERANCE))
    cells |= {header: value if isinstance(value, str) else _short(value) for header, value in constants.items()}
    put(LAW, impact.model)
    for column, value in impact.outcomes.items():
        put(column, value)
    return cells


def _short(number: float) -> str:
    return f"{number:.{TABLE_DIGITS}g}"
