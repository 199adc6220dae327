# SPDX-License-Identifier: Apache-2.0
"""Predict the velocity of a pad just after it hits a box, for three motor inertias.

./run python examples/predict.py
"""

from impact_rs_sim import ImpactProblem, compute_impact_map, load_scenario
from impact_rs_trials import TrialSpec


def main() -> dict[str, float]:
    """Velocity along y by motor inertia: none, B_theta of the torque loop, B_rho of the rotors [m/s]."""
    scene = TrialSpec.of(load_scenario("push"), "cat_food", "case_2").scene
    after = {}
    for motor_inertia in ("zero", "reduced", "rotor"):
        result = compute_impact_map(ImpactProblem.at_nominal_impact(scene, motor_inertia))
        after[motor_inertia] = float(result.end_effector_twist["arm"][1])
        impulse = sum(contact.impulse[1] for contact in result.contacts)
        print(f"motor inertia {motor_inertia}: {after[motor_inertia]:+.4f} m/s, impulse on the box {impulse:+.3f} N s")
    return after


if __name__ == "__main__":
    main()
