# SPDX-License-Identifier: Apache-2.0
"""Predictions of the impact map for a set of trials, with the paper's three motor-inertia models."""

from __future__ import annotations

import functools
import logging

import numpy as np

from impact_rs_sim.errors import InputError
from impact_rs_sim.impact_map import ImpactMapError, ImpactProblem, predict_impact
from impact_rs_sim.impact_map.uncertainty import predict as uncertain
from impact_rs_sim.physics import MOTOR_INERTIA_MODELS
from impact_rs_sim.scenarios.scenario import Scenario
from impact_rs_sim.scene import Scene
from impact_rs_trials.spec import recorded_scenario

logger = logging.getLogger(__name__)

CACHED_INTERVALS = 64  # the study has 18 sets
INTERVAL_DRAWS = 100  # enough for the digits shown in a figure


@functools.lru_cache(maxsize=CACHED_INTERVALS)
def prediction_interval(scenario_json: str, object_name: str, case_name: str) -> tuple[float, float] | None:
    """95 % interval of the nominal prediction along the measured axis, first contact, mean over the arms [m/s].

    It follows from the uncertainties of the scenario (:mod:`impact_rs_sim.impact_map.uncertainty`).

    Args:
        scenario_json: The scenario, as in a bag.
        object_name: Name of the object.
        case_name: Name of the case.

    Returns:
        Low and high; None if the map gives no interval.
    """
    scenario = recorded_scenario(scenario_json, "")
    scene = Scene.resolve(scenario, object_name, case_name)
    try:
        predicted = uncertain(
            ImpactProblem.at_nominal_impact(scene), scenario.uncertainty, scene.models, draws=INTERVAL_DRAWS
        )
    except (InputError, ImpactMapError) as error:
        logger.info("no interval of the prediction for %s %s: %s", object_name, case_name, error)
        return None
    return predicted.interval_of({f"{arm}.velocity.{scenario.axis}": 1.0 / len(scene.arms) for arm in scene.arms})


def predict(scenario: Scenario, object_name: str, case_name: str, contact: str = "first") -> dict[str, float]:
    """Mean over the arms of :func:`predict_arms`, by motor-inertia model [m/s]."""
    by_arm = predict_arms(scenario, object_name, case_name, contact)
    return {model: float(np.mean(list(velocities.values()))) for model, velocities in by_arm.items()}


def predict_arms(
    scenario: Scenario, object_name: str, case_name: str, contact: str = "first"
) -> dict[str, dict[str, float]]:
    """Post-impact end-effector velocity along the measured axis by motor-inertia model and arm [m/s].

    Args:
        scenario: The scenario.
        object_name: Name of the object.
        case_name: Name of the case.
        contact: ``first``: just after the first simultaneous impact; ``settled``: when the contact that lasts has
            closed.

    Raises:
        InputError: The scenario has no such object or case, or its pose cannot be reached.
        ImpactMapError: The engine finds no answer.
    """
    scene = Scene.resolve(scenario, object_name, case_name)
    velocities = {}
    for model in MOTOR_INERTIA_MODELS:
        result = predict_impact(ImpactProblem.at_nominal_impact(scene, model), contact)
        velocities[model] = {arm: float(twist[scenario.axis_index]) for arm, twist in result.end_effector_twist.items()}
    return velocities
