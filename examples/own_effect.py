# SPDX-License-Identifier: Apache-2.0
"""Write an effect of your own as a formula, and see what it does to a push.

Shows a formula effect, the physics with it, and a trial in one process. Prints how far the box goes without the cable
and with it.

    ./run python examples/own_effect.py
"""

import numpy as np

from impact_rs_control.closed_loop import make_plant, run_closed_loop
from impact_rs_sim.effects.formula import FormulaEffect, FormulaSpec
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_trials.spec import TrialSpec

CABLE = {
    "name": "cable_drag",
    "sentence": "A cable drags behind the end effector.",
    "end_effector_force": {"y": "-drag * vy"},
    "parameters": {"drag": {"unit": "N s/m", "nominal": 0, "lower": 0, "upper": 50, "scale": 1}},
}


def main(drags: tuple[float, ...] = (0.0, 20.0)) -> list[float]:
    """Push with each drag [N s/m]; returns how far the box goes each time [m]."""
    plan = TrialSpec.of(load_scenario("push"), "cat_food", "case_2").plan
    effect, distances = FormulaEffect(FormulaSpec.model_validate(CABLE)), []
    for drag in drags:
        plant = make_plant(plan, 0, effect.apply_vector(plan.scene.physics, np.array([drag])))
        poses = [tick.measurement.object for tick in run_closed_loop(plan, plant)]
        positions = [pose.position for pose in poses if pose is not None]
        plant.close()
        distances.append(float(np.linalg.norm(positions[-1] - positions[0])))
        print(f"drag {drag:g} N s/m: the box goes {1e3 * distances[-1]:.1f} mm")
    return distances


if __name__ == "__main__":
    main()
