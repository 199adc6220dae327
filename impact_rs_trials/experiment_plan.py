# SPDX-License-Identifier: Apache-2.0
"""Plan of an experiment (``plan.yaml``): its trials, their numbers of repeats, and their purpose.

``impact-rs design`` writes it, ``impact-rs campaign --plan`` runs it. A plan has one part for every scenario, or for
every variant of one: ``settings`` are the values that a variant has instead of the file's, for example further cases.
Every part is a campaign of its own in a folder of its own.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import yaml
from pydantic import Field, model_validator

from impact_rs_sim.errors import InputError
from impact_rs_sim.files import write_whole
from impact_rs_sim.plant.mechanics import Simulator
from impact_rs_sim.scenarios.scenario import Scenario
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_sim.schema import Name, Schema, load, validate
from impact_rs_trials.campaign import Manifest, PlannedTrials
from impact_rs_trials.spec import TrialSpec

Method = Literal["design", "random", "fixed"]
Aim = Literal["rivals", "effects", "parameters"]

SCENARIO_FILE = "scenario.yaml"
MAX_SHOWN_PAIRS = 8  # of explanations, the least certain first


class PlannedPair(Schema):
    """Two explanations that a plan distinguishes."""

    first: str = Field(description="one explanation")
    second: str = Field(description="the other one")
    before: float = Field(ge=0.0, le=1.0, description="probability that a diagnosis distinguishes them, before it [-]")
    after: float = Field(ge=0.0, le=1.0, description="the same after it [-]")


class PlannedCampaign(Schema):
    """Trials of a plan in one scenario."""

    folder: Name = Field(description="folder below the folder of the plan's trials")
    scenario: str = Field(description="name or path of the scenario file")
    settings: dict[str, Any] = Field({}, description="values that the scenario has instead of its own, by dotted key")
    conditions: tuple[PlannedTrials, ...] = Field(min_length=1, description="conditions with numbers of repeats")

    @property
    def resolved(self) -> Scenario:
        """The scenario with the settings.

        Raises:
            InputError: There is no such scenario, or a setting does not fit.
        """
        return load_scenario(self.scenario).with_settings(self.settings)


class ExperimentPlan(Schema):
    """``plan.yaml``."""

    format: Literal[1] = Field(1, description="version of this format")
    model: str = Field(description="name of the model that predicted the trials")
    model_digest: str = Field(description="digest of its physics")
    aim: Aim = Field(
        description="rivals: ties of a diagnosis; effects: which effect is missing; parameters: their size"
    )
    method: Method = Field(description="design: the most informative trials; random, fixed: for comparison")
    budget: int = Field(ge=1, description="largest number of trials")
    seed: int = Field(0, ge=0, description="seed of the trials")
    freedom: int = Field(0, ge=0, description="degrees of freedom of the scatter after the plan; 0: not stated")
    summary: str = Field("", description="gain of the plan, in words")
    pairs: tuple[PlannedPair, ...] = Field((), description="explanations to distinguish, least certain first")
    campaigns: tuple[PlannedCampaign, ...] = Field(min_length=1, description="the trials, by scenario")

    @model_validator(mode="after")
    def _every_campaign_has_a_folder(self) -> ExperimentPlan:
        folders = [campaign.folder for campaign in self.campaigns]
        if repeated := [name for name in folders if folders.count(name) > 1]:
            raise ValueError(f"two campaigns have the folder {repeated[0]}, expected another for each")
        return self

    @property
    def trials(self) -> int:
        """Number of planned trials."""
        return sum(condition.trials for campaign in self.campaigns for condition in campaign.conditions)


def read_plan(path: Path) -> ExperimentPlan:
    """Read a plan, and check that its trials can be planned.

    Raises:
        InputError: Not a plan, or a scenario, object or case does not exist.
    """
    plan = load(ExperimentPlan, path)
    for number, campaign in enumerate(plan.campaigns):
        try:
            scenario = campaign.resolved
            for condition in campaign.conditions:
                _ = TrialSpec.of(scenario, condition.object, condition.case, condition.scale).scene
        except InputError as error:
            raise InputError(f"campaigns.{number}: {error}", file=path) from None
    return plan


def write_plan(plan: ExperimentPlan, path: Path) -> None:
    """Write a plan, completely or not at all.

    Raises:
        InputError: The file cannot be written.
    """
    write_whole(path, yaml.safe_dump(plan.model_dump(mode="json"), sort_keys=False, allow_unicode=True, width=120))


def manifests_of(
    plan: ExperimentPlan, plant: Simulator = "bullet", file_of: Callable[[PlannedCampaign], Path] | None = None
) -> dict[str, Manifest]:
    """The campaigns of a plan, by folder.

    Args:
        plan: The plan.
        plant: Simulator of the plant.
        file_of: Path for a scenario with the settings of a campaign, because nodes read files;
            None: the manifest keeps the settings.

    Raises:
        InputError: A scenario cannot be read, or its file cannot be written.
    """
    manifests = {}
    for campaign in plan.campaigns:
        scenario, settings = campaign.scenario, campaign.settings
        if settings and file_of is not None:
            path = file_of(campaign)
            write_scenario(campaign.resolved, path)
            scenario, settings = str(path.resolve()), {}
        content = {
            "scenario": scenario,
            "objects": tuple(dict.fromkeys(condition.object for condition in campaign.conditions)),
            "cases": tuple(dict.fromkeys(condition.case for condition in campaign.conditions)),
            "velocity_scales": tuple(dict.fromkeys(condition.scale for condition in campaign.conditions)),
            "trials": max(condition.trials for condition in campaign.conditions),
            "seed": plan.seed,
            "settings": settings,
            "plant": plant,
            "order": "random",
            "planned": campaign.conditions,
        }
        manifests[campaign.folder] = validate(Manifest, content, f"campaign {campaign.folder!r} of the plan")
    return manifests


def write_scenario(scenario: Scenario, path: Path) -> None:
    """Write a scenario as a file that every program reads.

    Raises:
        InputError: The file cannot be written.
    """
    write_whole(path, yaml.safe_dump(scenario.model_dump(mode="json", exclude_none=True), sort_keys=False))
