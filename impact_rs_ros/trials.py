"""From a ``TrialInfo`` message to what a node needs for the trial."""

from __future__ import annotations

import functools

import yaml
from pydantic import ValidationError

from impact_rs_control.plan import TrialPlan, plan_trial
from impact_rs_sim.errors import InputError
from impact_rs_sim.model import Model, check_model
from impact_rs_sim.scenario import Scenario
from impact_rs_sim.scene import Scene
from impact_rs_sim.schema import parse_yaml, validate
from impact_rs_trials.bags.trial_info import TrialInfo


def plan_of(info: TrialInfo) -> TrialPlan:
    """The plan of a trial; it follows from the trial's identity alone, so every node makes its own.

    Raises:
        InputError: The identity is not one of a trial that can be run.
    """
    return _plan(info.scenario_json, info.object, info.case_name, info.velocity_scale, info.motor_inertia)


def model_of(text: str, source: str) -> Model:
    """A model from the text of a model file.

    Raises:
        InputError: It is none; the error names ``source``.
    """
    return check_model(validate(Model, parse_yaml(text, source), source), source)


def model_text(model: Model) -> str:
    """Text of a model file, as :func:`model_of` reads it."""
    return yaml.safe_dump(model.model_dump(mode="json", exclude_none=True), sort_keys=False, width=100)


@functools.lru_cache(maxsize=4)
def _plan(scenario: str, object_name: str, case: str, scale: float, motor_inertia: str) -> TrialPlan:
    return plan_trial(_scene(scenario, object_name, case), scale, motor_inertia)


@functools.lru_cache(maxsize=4)
def _scene(scenario: str, object_name: str, case: str) -> Scene:
    try:
        parsed = Scenario.model_validate_json(scenario)
    except ValidationError as error:
        raise InputError(f"TrialInfo.scenario_json is no scenario: {error}") from None
    return Scene.resolve(parsed, object_name, case)
