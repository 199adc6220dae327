# SPDX-License-Identifier: Apache-2.0
"""A day on which the object changes: 36 trials with the object of the scenario, then 14 with one a quarter heavier.

Pushes of two objects and a free motion in random order, for `impact-rs follow`. Takes a minute.

    ./run python examples/changing_day.py day
    ./run impact-rs follow day --learn 14
"""

import sys
from pathlib import Path

import numpy as np

from impact_rs_sim.model import Model, ModelEffect, ParameterValue
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_trials.bags.record import record_trial
from impact_rs_trials.bags.trial_info import TrialInfo, TrialKey
from impact_rs_trials.spec import TrialSpec

KINDS = (("push", "parcel", "case_1"), ("push", "juice", "case_2"), ("excite", "none", "slow"))
QUIET, CHANGED = 36, 14  # trials before and after the change
HEAVIER = ModelEffect(name="object_mass", parameters={"scale": ParameterValue(estimate=1.25, unit="-")})


def main(folder: Path, quiet: int = QUIET, changed: int = CHANGED) -> None:
    """Record the trials of a day in a folder for each scenario."""
    specs = [TrialSpec.of(load_scenario(scenario), name, case) for scenario, name, case in KINDS]
    kinds = np.random.default_rng(0).integers(len(KINDS), size=quiet + changed)
    for number, kind in enumerate(kinds):
        spec = specs[kind]
        effects = (HEAVIER,) if number >= quiet else ()
        physics = Model(name="truth", effects=effects).apply(spec.plan.scene.physics)
        key = TrialKey(spec.object, spec.case, 1.0, number)
        path = folder / spec.scenario.name / key.name
        outcome = record_trial(spec.plan, TrialInfo.of(spec.plan, key, key.seed(0), "inprocess"), path, physics)
        print(f"{spec.scenario.name}/{key.name}: {outcome[0].outcome}")


if __name__ == "__main__":
    main(Path(*sys.argv[1:2] or ["day"]))
