# SPDX-License-Identifier: Apache-2.0
"""A Franka FR3 with seven joints on the left and a UR5e with six on the right, in one scene."""

from pathlib import Path

import yaml

from impact_rs_sim.effects import library
from impact_rs_sim.effects.each_arm import of_each
from impact_rs_sim.paths import config_directory
from impact_rs_sim.physics import Physics
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.scenarios.scenario_files import load_scenario

FILE = str(Path(__file__).with_suffix(".yaml"))
MIXED = load_scenario(FILE)
JOINTS = {"left": 7, "right": 6}
ROBOTS = {"left": "franka_fr3", "right": "ur5e"}


def with_own(physics: Physics, effect: str, values: Array) -> Physics:
    """The physics with an effect of every arm by itself; values of the left arm first."""
    return of_each(library()[effect], JOINTS).apply_vector(physics, values)


def write_experiment(folder: Path, trial: Path, mapping: object = None) -> Path:
    """An experiment file for the bag of a trial, with a mapping of each arm or with the one that is given."""
    (folder / "runs.csv").write_text(f"bag,object,kind\n{trial},parcel,hit\n")
    shipped = yaml.safe_load((config_directory() / "mappings" / "impact_rs.yaml").read_text())
    for arm, count in JOINTS.items():
        joints = [f"*joint{number + 1}" for number in range(count)]
        (folder / f"{arm}.yaml").write_text(yaml.safe_dump({**shipped, "robot": ROBOTS[arm], "joints": joints}))
    path = folder / "experiment.yaml"
    path.write_text(yaml.safe_dump({"scenario": FILE, "mapping": mapping or {arm: f"{arm}.yaml" for arm in JOINTS}}))
    return path
