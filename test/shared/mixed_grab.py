# SPDX-License-Identifier: Apache-2.0
"""A Franka FR3 with seven joints on the left and a UR5e with six on the right, in one scene."""

from pathlib import Path

from impact_rs_sim.effects import library
from impact_rs_sim.effects.each_arm import of_each
from impact_rs_sim.physics import Physics
from impact_rs_sim.robot import Array
from impact_rs_sim.scenario import load_scenario

FILE = str(Path(__file__).with_suffix(".yaml"))
MIXED = load_scenario(FILE)
JOINTS = {"left": 7, "right": 6}


def with_own(physics: Physics, effect: str, values: Array) -> Physics:
    """The physics with an effect of every arm by itself; values of the left arm first."""
    return of_each(library()[effect], JOINTS).apply_vector(physics, values)
