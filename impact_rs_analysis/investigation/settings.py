# SPDX-License-Identifier: Apache-2.0
"""Settings of an investigation (``investigation.yaml``)."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import yaml
from pydantic import Field

from impact_rs_sim.errors import InputError
from impact_rs_sim.files import write_whole
from impact_rs_sim.schema import Schema, load
from impact_rs_trials.envelope import CellEnvelope

SETTINGS_FILE = "investigation.yaml"


class BlindChoice(Schema):
    """Hidden effects of the plant, as drawn by ``blind make``."""

    seed: int = Field(ge=0, description="seed that draws effect and size")
    kind: Literal["single", "pair", "null", "outside"] = Field("single", description="what is hidden")
    effect: str | None = Field(None, description="effect that is hidden; null: drawn")
    magnitude: float | None = Field(None, description="size of the effect in parameter scales [-]; null: drawn")


class Settings(Schema):
    """Settings of an investigation (``investigation.yaml``)."""

    scenarios: tuple[str, ...] = Field(min_length=1, description="names or paths of scenarios")
    model: str = Field("nominal", description="the first model: nominal, or a file")
    model_digest: str = Field(description="digest of the physics of the first model")
    via: Literal["inprocess", "nodes", "cell"] = Field("inprocess", description="where trials run")
    seed: int = Field(0, ge=0, description="seed of scatter and noise")
    effects: tuple[str, ...] = Field((), description="effects to consider; none: the library")
    blind: BlindChoice | None = Field(None, description="what the plant hides; null: nothing on purpose")
    envelope: CellEnvelope | None = Field(None, description="which trials may run; null: all that can be planned")

    @property
    def where(self) -> str:
        """Where trials run, in words."""
        return {"inprocess": "in this program", "nodes": "through the ROS 2 nodes", "cell": "on a real cell"}[self.via]


def begin(directory: Path, settings: Settings) -> Settings:
    """The settings of a folder; written if the folder has none.

    Raises:
        InputError: It holds another investigation.
    """
    path = directory / SETTINGS_FILE
    if path.exists():
        existing = load(Settings, path)
        if existing != settings:
            changed = [name for name in Settings.model_fields if getattr(existing, name) != getattr(settings, name)]
            raise InputError(
                f"this folder holds another investigation (it differs in {', '.join(changed)}); give the same options "
                "(only --budget may grow), or choose another folder",
                file=path,
            )
        return existing
    write_whole(path, yaml.safe_dump(settings.model_dump(mode="json"), sort_keys=False))
    return settings


def read_settings(directory: Path) -> Settings:
    """The settings.

    Raises:
        InputError: There is no investigation in the folder.
    """
    path = directory / SETTINGS_FILE
    if not path.exists():
        raise InputError(f"no investigation here: there is no {SETTINGS_FILE}", file=directory)
    return load(Settings, path)
