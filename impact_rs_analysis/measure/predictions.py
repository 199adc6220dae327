"""What the impact map predicts for a set of trials, for the paper's three motor-inertia models."""

from __future__ import annotations

import numpy as np

from impact_rs_control.plan import REFERENCE_ENGINE
from impact_rs_sim.impact_map import ImpactProblem, predict_impact
from impact_rs_sim.physics import MOTOR_INERTIA_MODELS
from impact_rs_sim.scenario import Scenario
from impact_rs_sim.scene import Scene

MODEL_LABELS = {
    "reduced": "reduced motor inertia B_θ (nominal)",
    "rotor": "rotor motor inertia B_ρ",
    "zero": "no motor inertia, B = 0",
}


def predict(
    scenario: Scenario, object_name: str, case_name: str, contact: str = "first", engine: str = REFERENCE_ENGINE
) -> dict[str, float]:
    """Post-impact end-effector velocity along the measured axis by motor-inertia model [m/s], mean over the arms.

    Args:
        scenario: The scenario.
        object_name: Name of the object.
        case_name: Name of the case.
        contact: ``first``: just after the first simultaneous impact; ``settled``: when the contact that lasts has
            closed.
        engine: Engine of the first contact.

    Raises:
        InputError: The scenario has no such object or case, or its pose cannot be reached.
        ImpactMapError: The engine finds no answer.
    """
    scene = Scene.resolve(scenario, object_name, case_name)
    velocities = {}
    for model in MOTOR_INERTIA_MODELS:
        result = predict_impact(ImpactProblem.at_nominal_impact(scene, model), contact, engine)
        velocities[model] = float(np.mean([twist[scenario.axis_index] for twist in result.end_effector_twist.values()]))
    return velocities
