# SPDX-License-Identifier: Apache-2.0
"""Specification of a trial without repeat and seed; all trials are planned here.

    scenario_json -> Scenario        parsed and checked
    + object, case -> Scene          inverse kinematics of the impact pose
    + scale, motor_inertia -> TrialPlan    impact map and references

Each arrow is a pure function, whose results a process caches: repeats share their plan, velocity scales their scene.
The cache key is the content of the scenario and not its name, because the file, or a file that it names, may be edited.
Each raises :class:`InputError` if the text is no scenario, an object or case is missing, or a pose is out of reach.
"""

from __future__ import annotations

import functools
import json
from dataclasses import dataclass
from pathlib import Path

from impact_rs_control.plan import TrialPlan, plan_trial
from impact_rs_sim.errors import InputError
from impact_rs_sim.scenarios.scenario import Scenario
from impact_rs_sim.scene import Scene
from impact_rs_sim.schema import RECORDED, validate

MAX_CACHED_PLANS = 64  # in the memory of a process, about 0.7 MB for each arm; a campaign of the paper has 18 sets


@dataclass(frozen=True)
class TrialSpec:
    """Common properties of the repeats of a trial.

    Attributes:
        scenario_json: Full text of the scenario, JSON, with the friction compensation that its file names.
        object: Name of the object.
        case: Full name of the case.
        scale: Post-impact reference velocity over predicted velocity [-].
        motor_inertia: Motor-inertia model of the reference: ``reduced``, ``rotor`` or ``zero``.
    """

    scenario_json: str
    object: str
    case: str
    scale: float = 1.0
    motor_inertia: str = "reduced"

    @classmethod
    def of(
        cls, scenario: Scenario, object_name: str, case: str, scale: float = 1.0, motor_inertia: str = "reduced"
    ) -> TrialSpec:
        """The trial of a scenario; ``1`` is short for ``case_1``."""
        scenario.object(object_name)
        return cls(scenario.model_dump_json(), object_name, scenario.case_name(case), scale, motor_inertia)

    @property
    def scenario(self) -> Scenario:
        """The scenario."""
        return _scenario(self.scenario_json)

    @property
    def scene(self) -> Scene:
        """The scenario with object and case, at the nominal moment of impact; the same object every time."""
        return _scene(self.scenario_json, self.object, self.case)

    @property
    def plan(self) -> TrialPlan:
        """References and nominal physics; the same object every time."""
        return _plan(self)


def recorded_scenario(text: str, file: str | Path) -> Scenario:
    """The scenario recorded in a bag; ``file`` is for error messages."""
    try:
        return _scenario(text)
    except InputError as error:
        raise error.in_file(file) from None


@functools.lru_cache(maxsize=MAX_CACHED_PLANS)
def _scenario(text: str) -> Scenario:
    try:
        data = json.loads(text)
    except (RecursionError, ValueError) as error:
        raise InputError(f"the recorded scenario cannot be read: {error}") from None
    return validate(Scenario, data, "recorded scenario", RECORDED)


@functools.lru_cache(maxsize=MAX_CACHED_PLANS)
def _scene(scenario_json: str, object_name: str, case: str) -> Scene:
    return Scene.resolve(_scenario(scenario_json), object_name, case)


@functools.lru_cache(maxsize=MAX_CACHED_PLANS)
def _plan(spec: TrialSpec) -> TrialPlan:
    return plan_trial(spec.scene, spec.scale, spec.motor_inertia)
