# SPDX-License-Identifier: Apache-2.0
"""Predict the velocity jump of a push for three motor inertias.

Shows a trial specification, the scene that follows from it, and the impact map. Prints one line for each motor-inertia
model: velocity of the end effector just after the impact, impulse on the box, and how well the laws are met.

    ./run python examples/predict.py
"""

from impact_rs_sim import ImpactProblem, compute_impact_map, load_scenario
from impact_rs_trials import TrialSpec


def main(object_name: str = "cat_food", case: str = "case_2") -> dict[str, float]:
    """Print the predictions; returns the velocities along the measured axis by motor-inertia model [m/s]."""
    spec = TrialSpec.of(load_scenario("push"), object_name, case)
    scene, axis = spec.scene, spec.scenario.axis_index
    before = scene.models["arm"].jacobian(scene.arms["arm"].position) @ scene.arms["arm"].velocity
    print(f"{object_name}, {case}: {before[axis]:+.3f} m/s along {spec.scenario.axis} just before the impact")
    velocities = {}
    for motor_inertia in ("zero", "reduced", "rotor"):
        result = compute_impact_map(ImpactProblem.at_nominal_impact(scene, motor_inertia))
        velocities[motor_inertia] = float(result.end_effector_twist["arm"][axis])
        impulse = sum(contact.impulse[axis] for contact in result.contacts)
        print(
            f"motor inertia {motor_inertia:>7}: {velocities[motor_inertia]:+.4f} m/s after it, "
            f"impulse {impulse:+.3f} N s on the box, residual {result.residual.largest:.0e} m/s"
        )
    return velocities


if __name__ == "__main__":
    main()
