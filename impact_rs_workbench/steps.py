# SPDX-License-Identifier: Apache-2.0
"""Forms of the page as commands.

One schema per step; each knows its arguments and what they write. Paths come from the page as they are seen from the
folder of the workbench, and go into the command as the terminal sees them from where the workbench was started.
"""

from __future__ import annotations

import os
import re
from abc import abstractmethod
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field

from impact_rs_sim.errors import InputError, did_you_mean
from impact_rs_sim.schema import Schema, validate
from impact_rs_trials.campaign import make_manifest
from impact_rs_workbench.jobs import Order
from impact_rs_workbench.workspace import Workspace


def _like(pattern: str, expected: str) -> AfterValidator:
    """A text of a form that cannot be read as an option."""

    def checked(value: str) -> str:
        if re.fullmatch(pattern, value) is None:
            raise ValueError(f"expected {expected}")
        return value

    return AfterValidator(checked)


Plain = Annotated[
    str, Field(max_length=200), _like(r"[A-Za-z0-9_][A-Za-z0-9_.-]*", "a name of letters, digits, _, - and .")
]
Address = Annotated[
    str,
    Field(max_length=200),
    _like(r"(tcp|tls|ucx|ws)://[A-Za-z0-9_.:\[\]-]+", "an address such as tcp://10.0.0.1:8786"),
]
PathName = Annotated[str, Field(min_length=1, max_length=1000)]


class Step(Schema):
    """What all forms have in common."""

    @abstractmethod
    def order(self, workspace: Workspace) -> Order:
        """The command.

        Raises:
            InputError: A path leads out of the folder, or to nothing.
        """


class CampaignStep(Step):
    """Many trials; where nothing is said, all that the scenario has."""

    step: Literal["campaign"]
    scenario: PathName = Field(description="scenario")
    output: PathName = Field(description="folder of the campaign")
    objects: tuple[Plain, ...] | None = Field(None, min_length=1, description="objects")
    cases: tuple[Plain, ...] | None = Field(None, min_length=1, description="cases")
    scales: tuple[float, ...] | None = Field(
        None, min_length=1, description="post-impact references over the prediction [-]"
    )
    trials: int | None = Field(None, le=1000, description="repeats")
    seed: int = Field(0, description="seed")
    via: Literal["inprocess", "nodes"] = Field("inprocess", description="in the program, or through the nodes")
    scheduler: Address | None = Field(None, description="address of a dask scheduler")

    def order(self, workspace: Workspace) -> Order:
        """See :meth:`Step.order`."""
        target = workspace.inside(self.output)
        words = ["campaign", scenario_argument(workspace, self.scenario), "-o", seen(target)]
        scenario = workspace.scenario_path(self.scenario)
        make_manifest(scenario, self.objects, self.cases, self.scales, self.trials, self.seed)  # as the command does
        words += _several("--objects", self.objects) + _several("--cases", self.cases)
        words += _several("--scales", [f"{scale:g}" for scale in self.scales or ()])
        words += [] if self.trials is None else ["--trials", str(self.trials)]
        words += [] if self.seed == 0 else ["--seed", str(self.seed)]
        words += [] if self.via == "inprocess" else ["--via", self.via]
        words += [] if self.scheduler is None else ["--scheduler", self.scheduler]
        return Order("measure", tuple(words), (target,))


class TrialStep(Step):
    """One trial."""

    step: Literal["trial"]
    scenario: PathName = Field(description="scenario")
    object: Plain = Field(description="object")
    case: Plain = Field(description="case")
    scale: float = Field(1.0, description="post-impact reference over prediction [-]")
    seed: int = Field(0, description="seed")
    output: PathName = Field(description="folder for the bag")

    def order(self, workspace: Workspace) -> Order:
        """See :meth:`Step.order`."""
        target = workspace.inside(self.output)
        words = ["trial", scenario_argument(workspace, self.scenario), self.object, self.case, "-o", seen(target)]
        scenario = workspace.scenario_path(self.scenario)
        make_manifest(scenario, [self.object], [self.case], [self.scale], 1, self.seed)  # as the command does
        words += [] if self.scale == 1.0 else ["--scale", f"{self.scale:g}"]
        words += [] if self.seed == 0 else ["--seed", str(self.seed)]
        return Order("measure", tuple(words), (target,))


class BlindStep(Step):
    """A campaign with a hidden effect, to practise."""

    step: Literal["blind"]
    seed: int = Field(ge=0, description="seed that draws effect and size")
    output: PathName = Field(description="folder")

    def order(self, workspace: Workspace) -> Order:
        """See :meth:`Step.order`."""
        target = workspace.inside(self.output)
        return Order("measure", ("blind", "make", str(self.seed), "-o", seen(target)), (target,))


class RunsStep(Step):
    """What commands on measurements have in common."""

    runs: PathName = Field(description="folder of trials, or of a laboratory's runs")
    model: PathName = Field("nominal", description="model")
    experiment: str = Field("", description="experiment file of a laboratory; empty: trials of ours")

    def _source(self, workspace: Workspace) -> list[str]:
        words = [seen(workspace.existing(self.runs))]
        return words + self._experiment(workspace)

    def _experiment(self, workspace: Workspace) -> list[str]:
        return ["--experiment", seen(workspace.existing(self.experiment))] if self.experiment else []

    def _model(self, workspace: Workspace) -> list[str]:
        return [] if self.model == "nominal" else ["--model", _model(workspace, self.model)]


class AnalyzeStep(RunsStep):
    """Experimental estimates of the velocity after the impact."""

    step: Literal["analyze"]

    def order(self, workspace: Workspace) -> Order:
        """See :meth:`Step.order`."""
        return Order("compare", ("analyze", *self._source(workspace)), (workspace.existing(self.runs) / "report",))


class CompareStep(RunsStep):
    """Where a model fails."""

    step: Literal["compare"]
    output: PathName = Field(description="folder of the report")

    def order(self, workspace: Workspace) -> Order:
        """See :meth:`Step.order`."""
        target = workspace.inside(self.output)
        words = ["compare", *self._source(workspace), *self._model(workspace), "-o", seen(target)]
        return Order("compare", tuple(words), (target,))


class DiagnoseStep(RunsStep):
    """What a model lacks."""

    step: Literal["diagnose"]
    output: PathName = Field(description="folder of diagnosis and report")
    effects: tuple[Plain, ...] = Field((), description="effects to consider; none: all")
    formulas: str = Field("", description="file of effects of one's own")

    def order(self, workspace: Workspace) -> Order:
        """See :meth:`Step.order`."""
        target = workspace.inside(self.output)
        words = ["diagnose", *self._source(workspace), *self._model(workspace)]
        words += ["-o", seen(target / "diagnosis.json"), "--report", seen(target)]
        words += ["--formulas", seen(workspace.existing(self.formulas))] if self.formulas else []
        return Order("diagnose", (*words, *_several("--effects", self.effects)), (target,))


class AddStep(Step):
    """A better model."""

    step: Literal["add"]
    effect: Plain = Field(description="effect")
    source: PathName = Field(description="diagnosis")
    model: PathName = Field("nominal", description="the diagnosed model")
    output: PathName = Field(description="new model file")
    force: bool = Field(False, description="add it although nothing is predicted better")

    def order(self, workspace: Workspace) -> Order:
        """See :meth:`Step.order`."""
        target = workspace.inside(self.output)
        words = ["add", self.effect]
        words += [] if self.model == "nominal" else ["--model", _model(workspace, self.model)]
        words += ["--from", seen(workspace.existing(self.source)), "-o", seen(target)]
        return Order("add", tuple(words + (["--force"] if self.force else [])), (target,))


class HistoryStep(RunsStep):
    """How the error fell."""

    step: Literal["history"]
    output: PathName = Field(description="folder of the page")

    def order(self, workspace: Workspace) -> Order:
        """See :meth:`Step.order`."""
        target = workspace.inside(self.output)
        words = ["history", _model(workspace, self.model), "--runs", *self._source(workspace), "-o", seen(target)]
        return Order("history", tuple(words), (target,))


STEPS: dict[str, type[Step]] = {
    "campaign": CampaignStep,
    "trial": TrialStep,
    "blind": BlindStep,
    "analyze": AnalyzeStep,
    "compare": CompareStep,
    "diagnose": DiagnoseStep,
    "add": AddStep,
    "history": HistoryStep,
}


def order_of(data: Any, workspace: Workspace) -> Order:
    """The command that a form asks for.

    Raises:
        InputError: A value is missing or cannot be; or a path leads out of the folder, or to nothing.
    """
    name = data.get("step") if isinstance(data, dict) else None
    if not isinstance(name, str) or name not in STEPS:
        near = did_you_mean(name, STEPS) if isinstance(name, str) else ""
        raise InputError(f"expected one of {', '.join(STEPS)}{near}", key="step", value=name)
    return validate(STEPS[name], data, None).order(workspace)


def seen(path: Path) -> str:
    """A path as the terminal sees it that started the workbench."""
    here = Path.cwd()
    name = os.path.relpath(path, here) if path.is_relative_to(here) else str(path)
    return f"./{name}" if name.startswith("-") else name  # no option


def scenario_argument(workspace: Workspace, name: str) -> str:
    """SCENARIO as the terminal sees it: the name of one that comes with impact_rs, or a file.

    Raises:
        InputError: The file is none of the folder, or the name would be taken for an option.
    """
    if name.endswith((".yaml", ".yml")):
        return seen(workspace.existing(name))
    if name.startswith("-"):
        raise InputError("expected the name of a scenario", key="scenario", value=name)
    return name


def _model(workspace: Workspace, name: str) -> str:
    return name if name == "nominal" else seen(workspace.existing(name))


def _several(option: str, values: Sequence[str] | None) -> list[str]:
    return [option, *values] if values else []
