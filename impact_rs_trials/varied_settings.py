# SPDX-License-Identifier: Apache-2.0
"""Sensitivity of an estimate to settings that it should not depend on: campaigns with one setting varied.

The zero crossing of the net feedback (paper sec. Experimental results) measures robot and object. Its dependence on the
clamping force or the length of the interim mode is a systematic error that all trials share, and that a confidence
interval from their scatter does not cover. One setting at a time is halved and doubled. A varied trial has the same
seed as the trial that it is compared with, so that noise and scatter cancel.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_trials.campaign import Manifest
from impact_rs_trials.file_names import SENSITIVITY
from impact_rs_trials.store import Folder, Store


@dataclass(frozen=True)
class Setting:
    """A setting of the experiment, with its keys in a scenario.

    Attributes:
        name: Name, as in names of folders.
        label: Description.
        keys: Dotted keys that are varied together; ``*`` stands for every arm.
        factors: Factors of its variants.
    """

    name: str
    label: str
    keys: tuple[str, ...]
    factors: tuple[float, float] = (0.5, 2.0)

    def varied(self, scenario: dict[str, Any], factor: float) -> dict[str, float]:
        """Values of the setting times a factor, by dotted key; empty if the scenario does not use the setting."""
        values: dict[str, float] = {}
        for key in self.keys:
            for arm in scenario["robots"] if "*" in key else ("",):
                full_key, value = key.replace("*", arm), scenario
                for part in full_key.split("."):
                    value = value[part]
                if value:
                    values[full_key] = factor * float(value)  # type: ignore[arg-type]
        return values


SETTINGS = (
    # Twice the clamping force of grab (120 N) takes joint 6 of a Franka to its limit of 12 N m: feedback saturates.
    Setting("clamp_force", "clamping force", ("control.clamp_force",), (0.5, 1.5)),
    Setting("interim_duration", "length of the interim mode", ("control.interim_duration",)),
    Setting(
        "orientation_gain", "gain of the orientation", ("control.gains.orientation", "control.gains.orientation_post")
    ),
    Setting("pad_stiffness", "stiffness of the pads", ("robots.*.end_effector.pad.stiffness",)),
)


def sensitivity_manifests(manifest: Manifest) -> dict[tuple[str, float], Manifest]:
    """Campaigns with one setting varied, by setting and factor: first case, three scales, one repeat, same seeds.

    Raises:
        InputError: There is no such scenario.
    """
    scenario = load_scenario(manifest.scenario).with_settings(manifest.settings).model_dump(mode="json")
    scales = sorted(manifest.velocity_scales)
    part = {
        "cases": manifest.cases[:1],
        "velocity_scales": tuple(dict.fromkeys((scales[0], scales[len(scales) // 2], scales[-1]))),
        "trials": 1,
    }
    return {
        (setting.name, factor): manifest.model_copy(update={**part, "settings": {**manifest.settings, **values}})
        for setting in SETTINGS
        for factor in setting.factors
        if (values := setting.varied(scenario, factor))
    }


def folder_name(setting: str, factor: float) -> str:
    """Folder of a varied campaign inside the campaign with which it is compared."""
    return f"{SENSITIVITY}/{setting}_x{factor:g}"


def varied_folders(directory: Path) -> dict[tuple[str, float], str]:
    """Paths of the varied campaigns in the folder of a campaign, by setting and factor."""
    folders = {}
    for path in sorted((directory / SENSITIVITY).glob("*_x*")):
        setting, _, factor = path.name.rpartition("_x")
        with suppress(ValueError):
            folders[setting, float(factor)] = f"{SENSITIVITY}/{path.name}"
    return folders


def with_sensitivity(campaign: Folder, manifest: Manifest) -> dict[Store, Manifest]:
    """A campaign, and the campaigns inside its folder with one setting varied.

    Raises:
        InputError: There is no such scenario.
    """
    campaigns: dict[Store, Manifest] = {campaign: manifest}
    for key, varied in sensitivity_manifests(manifest).items():
        campaigns[Folder(campaign.path / folder_name(*key))] = varied
    return campaigns
