# SPDX-License-Identifier: Apache-2.0
"""A plan of trials (``plan.yaml``): which conditions to measure, how often, and what that decides."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml
from pydantic import Field

from impact_rs_sim.files import write_whole
from impact_rs_sim.schema import Schema, load


class PlannedCondition(Schema):
    """Trials of one condition."""

    object: str = Field(description="name of the object")
    case: str = Field(description="full name of the case")
    scale: float = Field(1.0, description="post-impact reference velocity over predicted velocity [-]")
    trials: int = Field(ge=1, description="repeats")
    what: str = Field("", description="the motion in words")
    buys: str = Field("", description="what the trials decide")


class PlannedCampaign(Schema):
    """Conditions of one scenario."""

    folder: str = Field(description="folder of its bags")
    scenario: str = Field(description="name or path of the scenario")
    settings: dict[str, Any] = Field({}, description="values that the scenario has instead of its own, by dotted key")
    conditions: tuple[PlannedCondition, ...] = Field(description="what is measured")


class ExperimentPlan(Schema):
    """``plan.yaml``."""

    format: int = Field(1, description="version of this format")
    model: str = Field(description="name of the model that predicts")
    model_digest: str = Field(description="digest of its physics")
    decision: str = Field("effects", description="what is to be decided")
    method: str = Field("fixed", description="how the trials were chosen")
    budget: int = Field(description="trials that were allowed")
    seed: int = Field(0, description="seed of scatter and noise")
    summary: str = Field("", description="the plan in words")
    campaigns: tuple[PlannedCampaign, ...] = Field(description="what is measured, by scenario")

    @property
    def trials(self) -> int:
        """Number of trials."""
        return sum(one.trials for campaign in self.campaigns for one in campaign.conditions)


def write_plan(plan: ExperimentPlan, path: Path) -> None:
    """Write a plan; an earlier one is replaced."""
    write_whole(path, yaml.safe_dump(plan.model_dump(mode="json"), sort_keys=False, width=100))


def read_plan(path: Path) -> ExperimentPlan:
    """Read a plan."""
    return load(ExperimentPlan, path)
