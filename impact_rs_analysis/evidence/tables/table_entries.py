# SPDX-License-Identifier: Apache-2.0
"""Entries of a row of a table of impacts: velocities just after the impact, as measured and as the impact map predicts.

Entries are the velocities of the joints, of the body's centre, and its angular velocity; last the distance, if it was
measured in place of the velocity of the centre. Velocities of a free body are in contact axes, along the ``normal``,
along the ``sliding`` direction just before the impact, and ``across`` both; velocities of an object are in x, y, z.

A difference du_i is converted to the velocity at which the body of mass m has equal kinetic energy,
sqrt(H_ii / m) |du_i|, with H the inertia of body and joints, motors included.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pinocchio as pin

from impact_rs_analysis.evidence.cluster import Feature
from impact_rs_analysis.evidence.discrepancy import MAX_SQUARE_ANGLE_RAD
from impact_rs_analysis.evidence.replays.ante_impact import obliqueness_of
from impact_rs_analysis.evidence.tables.map_discrepancy import (
    ANGULAR_VELOCITY_AFTER,
    JOINT_VELOCITY_AFTER,
    VELOCITY_AFTER,
    HitKind,
    MapDiscrepancy,
    lengths_of,
)
from impact_rs_sim.errors import InputError
from impact_rs_sim.impact_map.contacts import SUPPORT, contact_frame
from impact_rs_sim.impact_map.laws import System
from impact_rs_sim.impact_map.measured import MeasuredImpact, MeasuredImpacts
from impact_rs_sim.physics import Physics
from impact_rs_sim.robots.robot import Array
from impact_rs_trials.recordings.impacts.impact_columns import AXES, arm_label
from impact_rs_trials.recordings.impacts.impact_table import ImpactTable

RELEVANT = 0.005  # of the closing speed; 5 mm/s at 1 m/s, the resolution of body velocities by motion capture
CONTACT_AXES = ("normal", "sliding", "across")
MIN_SLIDING_M_S = 1e-6  # slower contacts have no sliding direction: an arbitrary tangent is used
DISTANCE = "distance after"


@dataclass(frozen=True)
class TableEntries:
    """Entries of all rows of a table.

    Attributes:
        table: The table.
        worlds: Distinct physics of its rows under the model.
        world_of: Index of the physics of each row.
        map_discrepancy: Discrepancy of the rigid map.
    """

    table: ImpactTable
    worlds: tuple[Physics, ...]
    world_of: tuple[int, ...]
    map_discrepancy: MapDiscrepancy

    @property
    def physics_of_rows(self) -> list[Physics]:
        """Physics of every row under the model."""
        return [self.worlds[world] for world in self.world_of]

    @cached_property
    def axes(self) -> Array:
        """Axes of the entries in A, as rows, ``(rows, 3, 3)``."""
        return np.array([_axes_of(row.impact) for row in self.table.rows])

    @cached_property
    def impacts(self) -> MeasuredImpacts:
        """The impacts of all rows."""
        return MeasuredImpacts([row.impact for row in self.table.rows], self.physics_of_rows)

    @cached_property
    def signals(self) -> tuple[Feature, ...]:
        """Description of the ``n`` entries, common to all rows."""
        features = []
        for name in self.table.rows[0].impact.arms:
            label = arm_label(name, self.table.arms)
            for column, unit in self.table.rows[0].physics.arms[name].facts.velocity_columns:
                features.append(Feature("impact", JOINT_VELOCITY_AFTER, f"{label}{column}", 0, unit, 0.0, name))
        names = AXES if self.table.arms else CONTACT_AXES
        features += [Feature("impact", VELOCITY_AFTER, axis, 0, "m/s", 0.0) for axis in names]
        features += [Feature("impact", ANGULAR_VELOCITY_AFTER, axis, 0, "rad/s", 0.0) for axis in names]
        limits = RELEVANT * self.speed / lengths_of(features, self.worlds[0])
        signals = [replace(f, relevance_limit=float(limit)) for f, limit in zip(features, limits, strict=True)]
        if self.has_distances:
            lasting = float(np.sqrt(np.mean(np.square(self.distance_slopes))))
            signals.append(Feature("impact", DISTANCE, "horizontal", 0, "m", RELEVANT * self.speed * lasting))
        return tuple(signals)

    @property
    def has_distances(self) -> bool:
        """Whether distances were measured in place of velocities of the centre."""
        return not self.table.centre

    @cached_property
    def distance_slopes(self) -> Array:
        """Derivative of the distance of every row by the velocity of the centre, ``(rows,)`` [s].

        Raises:
            InputError: The impact map has no solution for some row.
        """
        worlds = self.physics_of_rows
        velocities, _ = self.impacts.solve(worlds)
        durations = []
        for row, velocity, world in zip(self.table.rows, velocities, worlds, strict=True):
            assert row.distance is not None
            if np.isnan(velocity).any():
                raise InputError("no velocities obey the contact laws", file=self.table.path, key=f"row {row.number}")
            durations.append(row.distance.distance_per_speed(velocity[-6:-3], world))
        return np.array(durations)

    @cached_property
    def measured(self) -> Array:
        """Measured entries of all rows, ``(rows, n)`` [rad/s, m/s, m]; nan: not measured."""
        entries = turned(np.array([row.after for row in self.table.rows]), self.axes)
        if not self.has_distances:
            return entries
        distances = [np.nan if row.distance is None else row.distance.measured for row in self.table.rows]
        return np.column_stack((entries, distances))

    @cached_property
    def noise(self) -> Array | None:
        """Standard deviations of all entries, of measurement and prediction, ``(rows, n)``; None: unknown."""
        if self.table.noise is None:
            return None
        noise = self.table.noise.copy()
        for xyz in (slice(-6, -3), slice(-3, None)):  # diag(T C T^T) with the variances C along the axes of A
            noise[:, xyz] = np.sqrt(np.einsum("nij,nj->ni", np.square(self.axes), np.square(noise[:, xyz])))
        if self.has_distances:
            distance_noise = [np.nan if row.distance is None else row.distance.noise or 0.0 for row in self.table.rows]
            noise = np.column_stack((noise, np.array(distance_noise, dtype=float)))
        return np.hypot(noise, self.noise_of_contacts)

    @cached_property
    def noise_of_contacts(self) -> Array:
        """Noise of all predicted entries from errors of contact position and normal, ``(rows, n)``."""
        worlds, squares = self.physics_of_rows, np.zeros_like(self.measured)
        stated = np.array([row.contact_noise for row in self.table.rows])
        if not stated.any():
            return squares
        nominal = self.predicted(self.impacts, worlds)
        for along in range(5):  # three axes for the position, two tangents for the normal
            impacts = [_moved(row.impact, along, *row.contact_noise) for row in self.table.rows]
            moved = self.predicted(MeasuredImpacts(impacts, worlds), worlds)
            squares += np.square(np.nan_to_num(moved - nominal))
        return np.sqrt(squares)

    def predicted(
        self, impacts: MeasuredImpacts, worlds: Sequence[Physics], rows: Sequence[int] | None = None
    ) -> Array:
        """Entries of rows as the map predicts them, ``(rows, n)`` [rad/s, m/s, m], nan where it has no solution.

        Args:
            impacts: Impacts of the rows.
            worlds: Physics of each.
            rows: Indices of the rows; None: all rows.
        """
        indices = range(len(self.table.rows)) if rows is None else rows
        velocity, _ = impacts.solve(worlds)
        entries = turned(velocity, self.axes[list(indices)])
        if not self.has_distances:
            return entries
        distances = []
        for index, row_velocity, world in zip(indices, velocity, worlds, strict=True):
            distance = self.table.rows[index].distance
            assert distance is not None
            distances.append(distance.predicted(row_velocity[-6:-3], world))
        return np.column_stack((entries, distances))

    @cached_property
    def speed(self) -> float:
        """Closing speed of the impacts, root mean square [m/s]."""
        return float(np.sqrt(np.mean(np.square(self.impacts.closing_speeds))))

    @cached_property
    def systems(self) -> tuple[System, ...]:
        """Inertia and kinematics of every row under the model."""
        models = [physics.robot_models() for physics in self.worlds]
        return tuple(
            row.impact.system(self.worlds[world], models[world])
            for row, world in zip(self.table.rows, self.world_of, strict=True)
        )

    @cached_property
    def energy_weights(self) -> Array:
        """sqrt(H_ii / m): velocity of the body with the energy of a unit of entry i, ``(rows, n)`` [m, -, 1/s]."""
        inertia = np.array([system.inertia for system in self.systems])
        half = np.swapaxes(_all_turned(inertia, self.axes), 1, 2)  # H T^T, then T H T^T, with T the axes
        diagonal = np.einsum("nii->ni", _all_turned(half, self.axes))
        masses = np.array([system.inertia[-6, -6] for system in self.systems])  # m, of a fixed object 1 kg
        worth = np.sqrt(diagonal / masses[:, None])
        return np.column_stack((worth, 1.0 / self.distance_slopes)) if self.has_distances else np.asarray(worth)

    @cached_property
    def kinds(self) -> list[HitKind]:
        """Kind of the hit of every row."""
        kinds: list[HitKind] = []
        for row, world in zip(self.table.rows, self.world_of, strict=True):
            impact, physics = row.impact, self.worlds[world]
            oblique = bool(impact.arms) and obliqueness_of(physics, impact.arms, impact.object) > MAX_SQUARE_ANGLE_RAD
            kinds.append("oblique" if oblique else "square")
        return kinds

    def discrepancy_of(self, row: int, world: Physics, speed: float) -> Array:
        """Discrepancy of the rigid map of all entries of a row, ``(n,)``.

        Args:
            row: Index of the row.
            world: Its physics.
            speed: Its closing speed [m/s].
        """
        velocities = self.signals[:-1] if self.has_distances else self.signals
        discrepancy = self.map_discrepancy.of(velocities, world, speed, self.kinds[row])
        return (
            np.append(discrepancy, discrepancy[-6] * self.distance_slopes[row]) if self.has_distances else discrepancy
        )

    @cached_property
    def discrepancy(self) -> Array:
        """Discrepancy of the rigid map of all entries, rms over the rows, ``(n,)``."""
        if not self.table.arms:
            return np.zeros(len(self.signals))
        rows = [
            self.discrepancy_of(row, self.worlds[world], float(speed))
            for row, (world, speed) in enumerate(zip(self.world_of, self.impacts.closing_speeds, strict=True))
        ]
        return np.asarray(np.sqrt(np.mean(np.square(rows), axis=0)))


def turned(velocity: Array, axes: Array) -> Array:
    """u ``(rows, nv)`` with velocity and angular velocity of the body expressed in the axes of every row."""
    return _all_turned(velocity[:, :, None], axes)[:, :, 0]


def _all_turned(columns: Array, axes: Array) -> Array:
    """As :func:`turned`, for several columns at once, ``(rows, nv, k)``."""
    result = columns.copy()
    for xyz in (slice(-6, -3), slice(-3, None)):
        result[:, xyz] = axes @ columns[:, xyz]
    return result


def _moved(impact: MeasuredImpact, along: int, offset: float, tilt: float) -> MeasuredImpact:
    """An impact hit elsewhere along an axis of its contact frames, or with normals that are tilted.

    Args:
        impact: The impact; where there are arms, points on the support stay.
        along: 0 to 2: points along two tangents and the normal; 3 and 4: normals about the tangents.
        offset: By how much [m].
        tilt: By how much [rad].
    """
    points = []
    for point in impact.points:
        frame = contact_frame(point.normal)
        if impact.arms and point.partner == SUPPORT:
            points.append(point)
        elif along < len(frame):
            points.append(replace(point, position=point.position + offset * frame[along]))
        else:
            points.append(replace(point, normal=np.asarray(pin.exp3(tilt * frame[along - 3]) @ point.normal)))
    return replace(impact, points=tuple(points))


def _axes_of(impact: MeasuredImpact) -> Array:
    """Axes of the features in A, as rows, ``(3, 3)``: contact axes of a free body, else the axes of A."""
    if impact.arms:
        return np.eye(3)
    normal = impact.points[0].normal
    velocity = np.mean([impact.object.point_velocity(point.position) for point in impact.points], axis=0)
    sliding = velocity - (velocity @ normal) * normal
    speed = float(np.linalg.norm(sliding))
    tangent = sliding / speed if speed > MIN_SLIDING_M_S else contact_frame(normal)[0]
    return np.array([normal, tangent, np.cross(normal, tangent)])
