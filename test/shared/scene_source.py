# SPDX-License-Identifier: Apache-2.0
"""A source without measurements: a model in one scene."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from impact_rs_sim.model import Model
from impact_rs_sim.physics import Physics


def of_scene(model: Model, world: Physics) -> Any:
    """As much of a source as a decision takes."""
    return SimpleNamespace(
        model=model, known_effects=model.known_effects, joints=world.joints, worlds=[world], physics=world
    )
