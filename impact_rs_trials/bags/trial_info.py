# SPDX-License-Identifier: Apache-2.0
"""Identity of a trial: scenario, case, seed and reference."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, fields
from typing import Any, Literal

from impact_rs_control.plan import TrialPlan
from impact_rs_sim.errors import InputError
from impact_rs_sim.plant.mechanics import Simulator
from impact_rs_sim.seeds import seed_of
from impact_rs_sim.version import git_revision, package_version
from impact_rs_trials.spec import TrialSpec

Outcome = Literal["ABORTED", "DIVERGED", "LIMIT", "INFEASIBLE", "NO-IMPACT", "EARLY", "TIPPED", "DROPPED", "OK"]
OUTCOMES: dict[str, str] = {  # the gravest first: it is the outcome if several apply
    "ABORTED": "the trial did not end",
    "DIVERGED": "a joint ran away",
    "LIMIT": "a joint exceeded its limits",
    "INFEASIBLE": "no torque within the limits met all constraints of the controller",
    "NO-IMPACT": "nothing was hit",
    "EARLY": "an impact was detected before the pad could touch the object",
    "TIPPED": "the object tipped over",
    "DROPPED": "the object was dropped",
    "OK": "it went as planned",
}

# Values of `via`, by simulator, of trials that are simulated in one process and repeat exactly.
VIA: dict[Simulator, str] = {"bullet": "inprocess", "twin": "twin"}
FORMER_NAMES = {"scenario_json": "scenario_yaml"}  # of fields, up to version 0.1.0; the layout is the same


@dataclass(frozen=True)
class TrialKey:
    """Key of a trial in its campaign.

    Attributes:
        object: Name of the object.
        case: Full name of the case.
        scale: Post-impact reference velocity over predicted velocity [-].
        repeat: Number of the repeat, from 0.
    """

    object: str
    case: str
    scale: float
    repeat: int

    @property
    def name(self) -> str:
        """Folder name of the trial's bag; scales have as many decimals as they need to differ, and at least three."""
        scale = f"{self.scale:.3f}"
        if float(scale) != self.scale:
            scale = repr(float(self.scale))
        return f"{self.object}__{self.case}__s{scale}__r{self.repeat}"

    def seed(self, campaign_seed: int) -> int:
        """Seed of the trial: depends on campaign seed and key alone, not on the order of trials."""
        return seed_of(campaign_seed, self.name)


@dataclass(frozen=True)
class TrialInfo:
    """Content of ``impact_rs/TrialInfo``, field by field (see the message for units)."""

    scenario: str
    object: str
    case_name: str
    velocity_scale: float
    seed: int
    repeat: int
    motor_inertia: str
    robots: tuple[str, ...]
    axis: str
    nominal_impact_time: float
    window_start: float
    window_end: float
    duration: float
    ante_velocity: float
    predicted_post_velocity: float
    reference_post_velocity: float
    scenario_json: str
    model_yaml: str
    git_revision: str
    package_version: str
    via: str

    @staticmethod
    def of(plan: TrialPlan, key: TrialKey, seed: int, via: str, model_yaml: str = "") -> TrialInfo:
        """Identity of a planned trial."""
        scenario = plan.scene.scenario
        start, end = scenario.timing.window
        return TrialInfo(
            scenario=scenario.name,
            object=key.object,
            case_name=key.case,
            velocity_scale=key.scale,
            seed=seed,
            repeat=key.repeat,
            motor_inertia=plan.motor_inertia,
            robots=tuple(scenario.robots),
            axis=scenario.axis,
            nominal_impact_time=scenario.timing.nominal_impact,
            window_start=start,
            window_end=end,
            duration=scenario.timing.duration,
            ante_velocity=plan.ante_velocity,
            predicted_post_velocity=plan.predicted_post_velocity,
            reference_post_velocity=plan.reference_post_velocity,
            scenario_json=scenario.model_dump_json(),
            model_yaml=model_yaml,
            git_revision=git_revision(),
            package_version=package_version(),
            via=via,
        )

    @property
    def simulator(self) -> Simulator:
        """Simulator of the plant, if it was one of ours."""
        return "twin" if self.via == VIA["twin"] else "bullet"

    @property
    def key(self) -> TrialKey:
        """Key of the trial in its campaign."""
        return TrialKey(self.object, self.case_name, self.velocity_scale, self.repeat)

    @property
    def spec(self) -> TrialSpec:
        """Common properties of its repeats; references and physics follow from it."""
        return TrialSpec(self.scenario_json, self.object, self.case_name, self.velocity_scale, self.motor_inertia)

    @property
    def neighbours(self) -> tuple[str, ...]:
        """Names of the neighbours of the object; empty where the scenario is missing or cannot be read."""
        with suppress(InputError):
            return tuple(self.spec.scenario.neighbours) if self.scenario_json else ()
        return ()

    @staticmethod
    def from_message(message: Any) -> TrialInfo:
        """From ``impact_rs/TrialInfo`` of any message family and version.

        Raises:
            AttributeError: The message lacks a field.
        """
        values = {field.name: _field(message, field.name) for field in fields(TrialInfo)}
        values["robots"] = tuple(values["robots"])
        return TrialInfo(**values)

    def values(self) -> dict[str, Any]:
        """Field values for ``impact_rs/TrialInfo``."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        values["robots"] = list(self.robots)
        return values


def _field(message: Any, name: str) -> Any:
    former = FORMER_NAMES.get(name, name)
    return getattr(message, former if hasattr(message, former) else name)
