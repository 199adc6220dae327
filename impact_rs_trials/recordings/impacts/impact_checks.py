# SPDX-License-Identifier: Apache-2.0
"""Checks of a table of impacts that need no contact law: what holds for every friction and restitution.

With H the inertia, u^- and u^+ the velocities before and after, and J_c u the velocities of the contact points,
impulses L act at these points alone (paper eq. EOM_link, integrated over the impact),

    H (u^+ - u^-) = J_c^T L

so that, whatever L is,

1. *momentum* outside the range of J_c^T does not change. For a free body with one contact point this is the angular
   momentum about that point; with two points, about the line through them. In the energy norm, H = C C^T,

       m v_1^2 = |(1 - A A^+) C^T (u^+ - u^-)|^2,        A = C^-1 J_c^T

2. *bodies do not enter each other*: v_2 = max(0, -n . J_c u^+) at every contact,
3. *energy* does not grow: sqrt(m) v_3 = max(0, |C^T u^+| - |C^T u^-|).

All three are speeds of the body with mass m. A column with a wrong sign or unit makes their rms large. To find the
column, common factors are tried; the warning names the factor that makes all three vanish, or several factors that the
data do not distinguish. Without such a factor only free bodies are reported: joints of real arms do not jump as the
joints of a rigid arm.

Angular velocities, or both velocities, of free bodies may be given in axes of another frame: with z and y exchanged, or
in a left-handed frame. All 24 rotations of a frame onto its own axes are tried, and their mirrors
(:func:`other_axes`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import permutations, product
from typing import Literal

import numpy as np
import scipy

from impact_rs_sim.robots.robot import Array
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_sim.rotations import AXES
from impact_rs_trials.recordings.impacts import impact_columns as col
from impact_rs_trials.recordings.impacts.impact_columns import ColumnGroup, JointColumnGroup, arm_label
from impact_rs_trials.recordings.impacts.impact_table import ImpactRow, ImpactTable
from impact_rs_trials.recordings.relations import evenly

UNIT_FACTORS = (-1.0, np.pi / 180.0, 180.0 / np.pi, 1e-3, 1e3)  # sign, deg for rad, mm for m, and their inverses
MAX_ROWS = 200  # of a table, evenly taken
MIN_ROWS = 5
MIN_VIOLATION_SHARE = 0.03  # of the whole change of velocity; below it noise and contact geometry dominate
MAX_REMAINING_SHARE = 0.25  # of the squared violation; a factor that leaves more is no explanation
MIN_CURED_ROWS_SHARE = 0.75  # of the rows that break a law; a factor has to improve as many
MAX_MISFIT_RATIO = 1.5  # to the rms with the best factor; the data do not distinguish factors within it
MAX_SHOWN_ROWS = 3  # in a message
MAX_ALIGNMENT_ERROR = 1e-6  # rad and -, rounding of rotations by right angles and of their axes
NEIGHBOUR_ROWS = 8  # on either side of a row at which the unit of a column may change
MIN_UNIT_RATIO = 20.0  # of median sizes after and before the change of a unit; deg for rad: 57, less the scatter
MAX_SIZE_RATIO = 3.0  # of velocities before the impacts, below which their unit stays
MIN_UNEXPLAINED_SHARE = 0.5  # of the whole change; a larger violation is reported although no factor explains it


@dataclass(frozen=True)
class Remedy:
    """A factor that would correct some columns.

    Attributes:
        columns: Names of the columns.
        factor: Factor of their numbers [-].
        before: Factor of every entry of u^-, ``(nv,)`` [-].
        after: Factor of every entry of u^+, ``(nv,)`` [-].
    """

    columns: tuple[str, ...]
    factor: float
    before: Array
    after: Array

    def covers(self, other: Remedy) -> bool:
        """Whether the signals of the other remedy are a subset of the signals of this one."""
        signals = [{name.rsplit("_", 1)[0] for name in remedy.columns} for remedy in (self, other)]
        return signals[1] <= signals[0]


@dataclass(frozen=True)
class OtherAxes:
    """Axes in which velocities may have been measured, ``measured = s R true``.

    Attributes:
        of: Angular velocities alone, or also velocities of the centre.
        rotation: R, ``(3, 3)`` [-].
        sign: s; -1: left-handed axes [-].
        residual: Remaining violation of the laws with these axes, root mean square over the rows [m/s].
    """

    of: Literal["spins", "twists"]
    rotation: Array
    sign: float
    residual: float

    @property
    def vector(self) -> Array:
        """Rotation vector of R, ``(3,)`` [rad]."""
        return np.asarray(scipy.spatial.transform.Rotation.from_matrix(self.rotation).as_rotvec())

    @property
    def in_words(self) -> str:
        """Which velocities are in which axes."""
        velocities = "angular velocities" if self.of == "spins" else "velocities and angular velocities"
        angle = float(np.linalg.norm(self.vector))
        if angle < MAX_ALIGNMENT_ERROR:
            return f"{velocities} are in left-handed axes"
        axis = self.vector / angle
        shares = [
            f"{'' if share > 0 else '-'}{name}"
            for name, share in zip(AXES, axis, strict=True)
            if abs(share) > MAX_ALIGNMENT_ERROR
        ]
        about = shares[0] if len(shares) == 1 else f"({', '.join(f'{share:.3g}' for share in axis)})"
        hand = " left-handed" if self.sign < 0.0 else ""
        return f"{velocities} are in{hand} axes turned by {np.degrees(angle):.0f} degrees about {about}"


@dataclass(frozen=True)
class _Laws:
    """Laws that an impact obeys under any contact law; see the module.

    Attributes:
        root: C^T over the root of the body's mass, ``(nv, nv)``.
        invariant: Projector 1 - A A^+ onto the momenta that no contact changes, ``(nv, nv)`` [-].
        normals: n . J_c, ``(m, nv)``.
    """

    root: Array
    invariant: Array
    normals: Array

    @classmethod
    def of(cls, row: ImpactRow, models: dict[str, RobotModel]) -> _Laws:
        system = row.impact.system(row.physics, models)
        jacobian = system.jacobian(row.impact.points)
        root = np.linalg.cholesky(system.inertia)
        contact_directions = np.linalg.solve(root, jacobian.T)
        invariant = np.eye(len(root)) - contact_directions @ np.linalg.pinv(contact_directions, rcond=1e-9)
        normals = np.array([point.normal for point in row.impact.points])
        return cls(
            root=root.T / np.sqrt(system.inertia[-6, -6]),  # m, of a fixed object 1 kg
            invariant=invariant,
            normals=np.einsum("mi,miv->mv", normals, jacobian.reshape(len(normals), 3, -1)),
        )

    def violations(self, before: Array, after: Array) -> Array:
        """v_1, v_2 and v_3 of the module, ``(3,)`` [m/s]."""
        momentum = np.linalg.norm(self.invariant @ self.root @ (after - before))
        penetration = max(0.0, -float(np.min(self.normals @ after)))
        energy_gain = max(0.0, float(np.linalg.norm(self.root @ after) - np.linalg.norm(self.root @ before)))
        return np.array([momentum, penetration, energy_gain])


def warnings_of(table: ImpactTable) -> list[str]:
    """Violated laws of the table that hold for every contact, each with the most likely mistake.

    Args:
        table: Impacts with velocities after them.
    """
    rows, laws = _rows_and_laws(table)
    if not rows:
        return []
    before = np.array(
        [[*(v for arm in row.impact.arms.values() for v in arm.velocity), *row.impact.object.twist] for row in rows]
    )
    after = np.array([row.after for row in rows])
    scale_warnings = _scale_warnings(table, rows, before, after)
    violations = _violations(laws, before, after)
    whole_change = _rms(
        [float(np.linalg.norm(law.root @ change)) for law, change in zip(laws, after - before, strict=True)]
    )
    speeds = np.linalg.norm(violations, axis=1)
    size = _rms(speeds)
    if size <= MIN_VIOLATION_SHARE * whole_change:
        return scale_warnings
    candidates = []
    for remedy in remedies(table):
        remaining = np.linalg.norm(_violations(laws, remedy.before * before, remedy.after * after), axis=1)
        wrong = speeds > MIN_VIOLATION_SHARE * whole_change
        if np.any(wrong) and float(np.mean(remaining[wrong] < speeds[wrong])) >= MIN_CURED_ROWS_SHARE:
            candidates.append((_rms(remaining), remedy))
    law = _in_words(np.sqrt(np.mean(np.square(violations), axis=0)), whole_change)
    best = min((residual for residual, _ in candidates), default=np.inf)
    axes = [
        other
        for other in other_axes(table)
        if MAX_MISFIT_RATIO * other.residual < best and other.residual**2 < MAX_REMAINING_SHARE * size**2
    ]
    if axes:
        where = ", or ".join(other.in_words for other in axes[:MAX_SHOWN_ROWS])
        return [f"{law}: wrong axes? {axes[0].residual:.2g} m/s are left where {where}", *scale_warnings]
    if best**2 < MAX_REMAINING_SHARE * size**2:
        simplest: list[Remedy] = []
        for residual, remedy in candidates:
            if residual <= MAX_MISFIT_RATIO * best and not any(remedy.covers(other) for other in simplest):
                simplest.append(remedy)
        words = [f"factor: {remedy.factor:.4g} for {', '.join(remedy.columns)}" for remedy in simplest[:MAX_SHOWN_ROWS]]
        return [f"{law}: wrong sign or unit? {best:.2g} m/s are left with {', or '.join(words)}", *scale_warnings]
    if size > MIN_UNEXPLAINED_SHARE * whole_change and not table.arms:
        return [
            f"{law}: no factor of one signal explains it; are contact points, axes and inertia right?",
            *scale_warnings,
        ]
    return scale_warnings


def other_axes(table: ImpactTable) -> list[OtherAxes]:
    """Right-angled axes in which velocities of free bodies may have been measured, the most likely first.

    The laws of the module decide; friction and restitution need not be known. Only axes in which all contacts close are
    candidates. Axes that the laws do not distinguish from the best ones are returned as well.

    Args:
        table: Impacts with velocities after them.

    Returns:
        Empty if the axes of the table do as well as any others, or no body turns.
    """
    rows, laws = ([], []) if table.arms or not (table.turning and table.centre) else _rows_and_laws(table)
    if not rows:
        return []
    twists = np.array([[row.impact.object.twist, row.after] for row in rows])  # (k, 2, 6)

    def residual_with(rotation: Array, of: str, sign: float) -> float:
        """Rms violation of the laws [m/s]; infinite if a contact does not close."""
        true = twists.copy()
        true[..., 3:] = sign * twists[..., 3:] @ rotation  # R^T applied to rows
        if of == "twists":
            true[..., :3] = twists[..., :3] @ rotation
        if any(not np.min(law.normals @ before) < 0.0 for law, (before, _) in zip(laws, true, strict=True)):
            return np.inf
        return _rms(np.linalg.norm(_violations(laws, true[:, 0], true[:, 1]), axis=1))

    residual_of_table = residual_with(np.eye(3), "spins", 1.0)
    kinds: tuple[tuple[Literal["spins", "twists"], float], ...] = (("spins", 1.0), ("spins", -1.0), ("twists", 1.0))
    candidates = [
        OtherAxes(of, rotation, sign, residual_with(rotation, of, sign))
        for of, sign in kinds
        for rotation in _right_angle_frames()
        if sign < 0.0 or not np.allclose(rotation, np.eye(3))
    ]
    best = min(other.residual for other in candidates)
    if not MAX_MISFIT_RATIO * best < residual_of_table:
        return []
    closest = sorted(
        (other for other in candidates if other.residual <= MAX_MISFIT_RATIO * best), key=lambda other: other.residual
    )
    # The spin of a ball about the normal of its plane does not change: its sign, and so the handedness, is unknown.
    return [other for other in closest if other.sign > 0.0] or closest


def _violations(laws: Sequence[_Laws], before: Array, after: Array) -> Array:
    """v_1, v_2 and v_3 of every row, ``(k, 3)`` [m/s], from velocities before and after, ``(k, nv)`` each."""
    return np.array([law.violations(*pair) for law, *pair in zip(laws, before, after, strict=True)])


def _right_angle_frames() -> list[Array]:
    """The 24 rotations of a right-handed frame onto its own axes."""
    frames = [
        np.array([sign * np.eye(3)[axis] for axis, sign in zip(order, signs, strict=True)])
        for order in permutations(range(3))
        for signs in product((1.0, -1.0), repeat=3)
    ]
    return [frame for frame in frames if np.linalg.det(frame) > 0.0]


def _rows_and_laws(table: ImpactTable) -> tuple[list[ImpactRow], list[_Laws]]:
    """At most ``MAX_ROWS`` evenly spaced rows and the laws of each; empty if the table has too few rows."""
    chosen = evenly(len(table.rows), MAX_ROWS).tolist()
    if len(chosen) < MIN_ROWS:
        return [], []
    rows = [table.rows[number] for number in chosen]
    models: dict[int, dict[str, RobotModel]] = {}
    for row in rows:
        if id(row.physics) not in models:
            models[id(row.physics)] = row.physics.robot_models()
    return rows, [_Laws.of(row, models[id(row.physics)]) for row in rows]


def _scale_warnings(table: ImpactTable, rows: Sequence[ImpactRow], before: Array, after: Array) -> list[str]:
    """Warning if velocities after the impacts change their scale from one row on, and velocities before do not.

    Args:
        table: Names of the columns.
        rows: Looked at rows.
        before: Velocities before, ``(k, nv)`` [rad/s, m/s].
        after: Velocities after, ``(k, nv)`` [rad/s, m/s].
    """
    if len(rows) < 2 * NEIGHBOUR_ROWS:
        return []
    before_jumps, after_jumps = _size_ratios(before), _size_ratios(after)
    steady = np.all((before_jumps < MAX_SIZE_RATIO) & (before_jumps > 1.0 / MAX_SIZE_RATIO), axis=1)
    sizes = np.where(steady[:, None], np.maximum(after_jumps, 1.0 / after_jumps), 1.0)
    window, column = np.unravel_index(int(np.argmax(sizes)), sizes.shape)
    if sizes[window, column] < MIN_UNIT_RATIO:
        return []
    row, name = (
        rows[int(window) + NEIGHBOUR_ROWS].number,
        _signals(table, col.DQ_AFTER, col.V_AFTER, col.W_AFTER)[int(column)],
    )
    return [
        f"{name} is {after_jumps[window, column]:.2g} times as large from row {row} on, while nothing changes "
        "before the impacts: another unit?"
    ]


def _size_ratios(columns: Array) -> Array:
    """Ratio of median sizes after and before a row, ``(k - 2 NEIGHBOUR_ROWS + 1, nv)`` [-]; 1 if one is 0."""
    windows = np.lib.stride_tricks.sliding_window_view(np.abs(columns), NEIGHBOUR_ROWS, axis=0)
    sizes = np.median(windows, axis=-1)
    earlier, later = sizes[:-NEIGHBOUR_ROWS], sizes[NEIGHBOUR_ROWS:]
    moving = (earlier > 0.0) & (later > 0.0)
    return np.where(moving, later / np.where(moving, earlier, 1.0), 1.0)


def _signals(table: ImpactTable, joints: JointColumnGroup, *of_body: ColumnGroup) -> list[str]:
    """Names of the columns of all velocities before or after."""
    arms = table.rows[0].physics.arms
    joint_names = [name for arm, physics in arms.items() for name in joints.names(arm_label(arm, arms), physics.facts)]
    return [*joint_names, *(name for columns in of_body for name in columns.names)]


def _rms(values: Array | list[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _in_words(violations: Array, whole_change: float) -> str:
    """The most violated law, with the size of the violation."""
    law = (
        "the momentum that no impulse at the contact points can change (with one of them, the angular momentum about "
        "it) changes",
        "after the impact the bodies move into each other",
        "the kinetic energy grows",
    )[int(np.argmax(violations))]
    size = float(violations.max())
    return f"{law} by {size:.2g} m/s rms, {100.0 * size / whole_change:.0f} % of the whole change of velocity"


def remedies(table: ImpactTable) -> Iterator[Remedy]:
    """Factors of single signals, the simplest first."""
    sides = {
        "before": _signals(table, col.DQ_BEFORE, col.V_BEFORE, col.W_BEFORE),
        "after": _signals(table, col.DQ_AFTER, col.V_AFTER, col.W_AFTER),
    }
    count = len(sides["before"])
    linear, angular = ([*range(first, first + 3)] for first in (count - 6, count - 3))
    groups = [[index] for index in range(count)]
    # If an axis is mirrored in lever and velocity, the other two angular velocities seem to be wrong.
    groups += [[index for index in angular if index != mirrored] for mirrored in angular]
    groups += [linear, angular]
    for indices in groups:
        for factor in UNIT_FACTORS if len(indices) == len(AXES) else (-1.0,):
            for chosen_sides in (("before", "after"), ("after",), ("before",)):
                scaled = {side: np.ones(count) for side in sides}
                for side in chosen_sides:
                    scaled[side][indices] = factor
                columns = tuple(sides[side][index] for index in indices for side in chosen_sides)
                yield Remedy(columns, factor, scaled["before"], scaled["after"])
