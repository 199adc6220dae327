"""Identity of a trial: what was run, from which seed, with which reference."""

from __future__ import annotations

import functools
import subprocess
from dataclasses import dataclass, fields
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Literal

from impact_rs_control.plan import TrialPlan
from impact_rs_sim.seeds import seed_of
from impact_rs_trials.spec import TrialSpec

Outcome = Literal["OK", "NO-IMPACT", "DROPPED", "ABORTED"]


@dataclass(frozen=True)
class TrialKey:
    """Which trial of a campaign.

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
        """Folder name of the trial's bag."""
        return f"{self.object}__{self.case}__s{self.scale:.3f}__r{self.repeat}"

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
    scenario_yaml: str
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
            scenario_yaml=scenario.model_dump_json(),
            model_yaml=model_yaml,
            git_revision=git_revision(),
            package_version=package_version(),
            via=via,
        )

    @property
    def key(self) -> TrialKey:
        """Which trial of its campaign this is."""
        return TrialKey(self.object, self.case_name, self.velocity_scale, self.repeat)

    @property
    def spec(self) -> TrialSpec:
        """What its repeats have in common with it; references and physics follow from it."""
        return TrialSpec(self.scenario_yaml, self.object, self.case_name, self.velocity_scale, self.motor_inertia)

    @staticmethod
    def from_message(message: Any) -> TrialInfo:
        """From ``impact_rs/TrialInfo``, of whatever message family."""
        values = {field.name: getattr(message, field.name) for field in fields(TrialInfo)}
        values["robots"] = tuple(values["robots"])
        return TrialInfo(**values)

    def values(self) -> dict[str, Any]:
        """Field values for ``impact_rs/TrialInfo``."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        values["robots"] = list(self.robots)
        return values


@functools.cache
def git_revision() -> str:
    """Revision of the source tree this runs from, with ``+`` where it has uncommitted changes; empty if none."""
    try:
        described = subprocess.run(
            ["git", "describe", "--always", "--dirty=+", "--abbrev=12"],
            cwd=Path(__file__).parent,
            capture_output=True,
            text=True,
            timeout=5.0,
            check=True,
        )
    except (OSError, subprocess.SubprocessError):
        return ""
    return described.stdout.strip()


@functools.cache
def package_version() -> str:
    """Installed version of the package; empty when it runs from a bare source tree."""
    try:
        return version("impact-rs")
    except PackageNotFoundError:
        return ""
