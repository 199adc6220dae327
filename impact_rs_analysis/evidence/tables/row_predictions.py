# SPDX-License-Identifier: Apache-2.0
"""Predictions of the rows of a table of impacts by the impact map, for a model with effects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from impact_rs_analysis.evidence.cluster import Added
from impact_rs_analysis.evidence.tables.table_entries import TableEntries
from impact_rs_sim.effects import Effect
from impact_rs_sim.effects.depending import Depending
from impact_rs_sim.errors import NotABody
from impact_rs_sim.impact_map.measured import MeasuredImpacts, restitution_of
from impact_rs_sim.physics import Physics
from impact_rs_sim.recent import Recent
from impact_rs_sim.robots.robot import Array

MAX_ALTERED = 1024  # cached physics with effects
MAX_PREDICTIONS_BYTES = 48_000_000  # cached predictions of the whole table


@dataclass(frozen=True)
class RowPredictions:
    """Predictions of all rows for a model with effects; the last ones are cached.

    Attributes:
        entries: The entries of the rows.
        worlds: Distinct physics of the rows under the model, with the circumstances that effects depend on.
        world_of: Index of the physics of each row.
        effects: Known effects by name.
        solved: Cached predictions of all rows, by the inputs of the map.
        altered: Cached physics with effects, by index of the physics and effects.
    """

    entries: TableEntries
    worlds: tuple[Physics, ...]
    world_of: tuple[int, ...]
    effects: Mapping[str, Effect]
    solved: Recent[Array]
    altered: Recent[Physics | None] = field(default_factory=lambda: Recent(MAX_ALTERED))

    @classmethod
    def of(cls, entries: TableEntries, effects: Mapping[str, Effect]) -> RowPredictions:
        """Predictions for the model of some entries."""
        return cls(entries, entries.worlds, entries.world_of, effects, Recent(cache_size(entries)))

    def __getstate__(self) -> dict[str, Any]:
        """State for another process, without cached predictions."""
        return {**vars(self), "solved": Recent(cache_size(self.entries)), "altered": Recent(MAX_ALTERED)}

    def physics_of_rows(self, worlds: Sequence[Physics]) -> list[Physics]:
        """The physics of every row."""
        return [worlds[world] for world in self.world_of]

    def all_rows(self, added: Added) -> Array | None:
        """Entries of all rows, ``(rows, n)``, nan where there is no solution; None: no positive inertia.

        All rows are solved in one batch, even if only some are requested.

        Args:
            added: Effects on top of the model.
        """
        worlds = list(self.worlds)
        try:
            for name, values in added:
                worlds = [self.effects[name].apply_vector(physics, np.array(values)) for physics in worlds]
        except NotABody:
            return None
        key = b"".join(_inputs_of_the_map(physics) for physics in worlds)
        entries = self.entries
        return self.solved.of(key, lambda: entries.predicted(entries.impacts, self.physics_of_rows(worlds)))

    def one_row(self, row: int, added: Sequence[Added]) -> list[Array | None]:
        """Entries of one row with each of some sets of effects, solved together, ``(n,)``.

        Args:
            row: Position of the row.
            added: Sets of effects.

        Returns:
            None where the effects give a body without positive inertia.
        """
        changed = [self._world_with(self.world_of[row], effects) for effects in added]
        worlds = {number: physics for number, physics in enumerate(changed) if physics is not None}
        if not worlds:
            return [None] * len(changed)
        physics_of = list(worlds.values())
        impacts = MeasuredImpacts([self.entries.table.rows[row].impact] * len(physics_of), physics_of)
        entries = self.entries.predicted(impacts, physics_of, [row] * len(physics_of))
        by_number = dict(zip(worlds, entries, strict=True))
        return [by_number.get(number) for number in range(len(changed))]

    def with_dependences(
        self, effects: Sequence[Depending], circumstances: Mapping[str, Sequence[float | str]]
    ) -> RowPredictions:
        """These predictions with effects that depend on covariates.

        Args:
            effects: The effects.
            circumstances: Covariates that they depend on, by row.
        """
        index_of: dict[tuple[int, tuple[float | str, ...]], int] = {}
        worlds, world_of = [], []
        for row, world in enumerate(self.world_of):
            values = tuple(of_rows[row] for of_rows in circumstances.values())
            if (world, values) not in index_of:
                index_of[world, values] = len(index_of)
                before = self.worlds[world]
                extended = {**before.circumstances, **dict(zip(circumstances, values, strict=True))}
                worlds.append(replace(before, circumstances=extended))
            world_of.append(index_of[world, values])
        return replace(
            self,
            worlds=tuple(worlds),
            world_of=tuple(world_of),
            effects={**self.effects, **{effect.name: effect for effect in effects}},
            altered=Recent(MAX_ALTERED),
        )

    def _world_with(self, world: int, added: Added) -> Physics | None:
        """One of the physics with effects; None: no positive inertia."""

        def changed() -> Physics | None:
            physics = self.worlds[world]
            try:
                for name, values in added:
                    physics = self.effects[name].apply_vector(physics, np.array(values))
            except NotABody:
                return None
            return physics

        return self.altered.of((world, added), changed)


def cache_size(entries: TableEntries, share: int = 1) -> int:
    """Number of cached predictions of the whole table, in one of ``share`` equal parts of the memory."""
    return max(1, MAX_PREDICTIONS_BYTES // share // entries.energy_weights.nbytes)


def _inputs_of_the_map(physics: Physics) -> bytes:
    """All inputs of an impact map except the state, as a cache key."""
    body = physics.object
    contact = (physics.support_friction, physics.pad_friction, restitution_of(physics), physics.rolling_arm)
    parts = [np.array(contact), np.array(physics.twist_readings.numbers), body.com_offset]
    if physics.arms:
        parts += [np.array([body.mass]), body.inertia]
    else:
        # Against a fixed body the mass cancels, up to rounding.
        parts += [np.array([float(f"{moment:.12g}") for moment in body.inertia / body.mass])]
    for arm in physics.arms.values():
        tool = arm.end_effector
        parts += [np.array([tool.mass, *tool.mount_numbers]), tool.com, tool.inertia.ravel()]
        parts += [arm.motor_inertia_reduced, arm.base.homogeneous.ravel()]
    numbers = b"".join(np.ascontiguousarray(part, dtype=float).tobytes() for part in parts)
    return numbers + repr(physics.contact_laws).encode()
