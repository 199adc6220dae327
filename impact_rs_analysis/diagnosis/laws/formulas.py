# SPDX-License-Identifier: Apache-2.0
"""User-defined effects, checked before the measurements are read."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from impact_rs_sim.effects.formula import FormulaEffect
from impact_rs_sim.errors import InputError
from impact_rs_sim.memory import Memory
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_sim.scene import Scene


def try_out(effects: Iterable[FormulaEffect], file: str | Path) -> None:
    """Evaluate formulas once, at nominal values and a step away.

    Args:
        effects: The effects.
        file: Their file, for error messages.

    Raises:
        InputError: One of them is not finite.
    """
    scenario = load_scenario("push")
    scene = Scene.resolve(scenario, next(iter(scenario.objects)), next(iter(scenario.cases)))
    name, arm = next(iter(scene.arms.items()))
    joints = arm.position.size
    for effect in effects:
        step = np.array([scalar.scale for scalar in effect.scalars(joints)])
        for vector in (effect.nominal(joints), effect.nominal(joints) + step):
            try:
                physics = effect.apply_vector(scene.physics, vector)
                physics.load_torques(name, scene.models[name], 0.0, arm.position, arm.velocity, memory=Memory())
            except InputError as error:
                raise InputError(error.message, file=file) from None
