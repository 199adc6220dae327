# SPDX-License-Identifier: Apache-2.0
"""Friction identification for a whole scenario, and its result files."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import yaml

from impact_rs_control.friction_identification import identify_arm, sample_period
from impact_rs_sim.errors import InputError
from impact_rs_sim.files import write_whole
from impact_rs_sim.model import Model
from impact_rs_sim.scenarios.friction_compensation import ArmFriction, FrictionCompensation
from impact_rs_sim.scenarios.scenario import Scenario
from impact_rs_sim.scenarios.scenario_files import load_scenario, scenario_path
from impact_rs_trials.edited_yaml import edited_text, read_edited, scalar, separate
from impact_rs_trials.spec import TrialSpec
from impact_rs_trials.workers import Map

KEY = "friction_compensation"


@dataclass(frozen=True)
class ArmTask:
    """Identification of one arm for one object and case; complete for any worker."""

    spec: TrialSpec
    arm: str
    runs: int
    seed: int
    effects: Model | None

    def run(self) -> ArmFriction:
        """Run it."""
        return identify_arm(self.spec.scene, self.arm, self.runs, self.seed, self.effects)


def identify(
    scenario: Scenario,
    objects: list[str] | None,
    cases: list[str] | None,
    runs: int,
    seed: int,
    effects: Model | None,
    map_tasks: Map,
    progress: Callable[[int, int], None],
) -> FrictionCompensation:
    """Identify the friction compensation of a scenario.

    Args:
        scenario: The scenario; its plant has the friction that ``drive.friction`` names.
        objects: Names of objects; None: all.
        cases: Names of cases; None: all.
        runs: Runs to average, for each set, arm and controller.
        seed: Seed of scatter and noise.
        effects: Effects of the plant in addition to the scenario; None: no effects.
        map_tasks: Maps over worker processes.
        progress: Progress callback, called with the number of finished arms and of all arms.

    Raises:
        InputError: Unknown object or case, a scenario without an impact, fewer than one run, a negative seed.
    """
    if seed < 0:
        raise InputError(f"seed = {seed}: expected a whole number >= 0")
    for name in objects or []:
        scenario.object(name)
    tasks = [
        ArmTask(TrialSpec.of(scenario, name, case), arm, runs, seed, effects)
        for name in dict.fromkeys(objects or scenario.objects)
        for case in dict.fromkeys(scenario.case_name(case) for case in cases or scenario.cases)
        for arm in scenario.robots
    ]
    sets: dict[str, dict[str, dict[str, ArmFriction]]] = {}
    progress(0, len(tasks))
    for number, (task, friction) in enumerate(zip(tasks, map_tasks(ArmTask.run, tasks), strict=True), start=1):
        sets.setdefault(task.spec.object, {}).setdefault(task.spec.case, {})[task.arm] = friction
        progress(number, len(tasks))
    return FrictionCompensation(
        scenario=scenario.name,
        scenario_digest=scenario.digest,
        runs=runs,
        seed=seed,
        period=sample_period(scenario),
        sets=sets,
    )


def prepare_output(scenario_name: str, path: Path) -> Path:
    """Make the folder for a compensation before the long identification, and check that its files can be written.

    The copy of the scenario is loaded once, without a compensation.

    Returns:
        Path for the copy of the scenario that uses the compensation.

    Raises:
        InputError: One of the two files exists already, the folder cannot be made, or there is no such scenario, or
            its copy cannot be loaded.
    """
    scenario = scenario_path(scenario_name)
    copy = path.with_name(f"{scenario.stem}_compensated.yaml")
    for file in (path, copy):
        if file.exists():
            raise InputError("this file exists already; choose another name", file=file)
    if copy == path:
        raise InputError("this is the name of the scenario's copy; choose another name", file=path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot be written: {error.strerror}", file=path) from None
    try:
        write_whole(copy, _copy_of(scenario, path.parent, None))
        load_scenario(str(copy))
    finally:
        copy.unlink(missing_ok=True)
    return copy


def _copy_of(scenario: Path, folder: Path, compensation: str | None) -> str:
    """Text of a scenario for a file in another folder, with the name of a compensation there, or without one.

    Paths of robot facts and of meshes lead to the same files.
    """
    content = read_edited(scenario)
    paths = [
        (entry, key, entry[key])
        for section, key in (("robots", "facts"), ("objects", "mesh"), ("neighbours", "mesh"))
        for entry in (content.get(section) or {}).values()
        if isinstance(entry.get(key), str) and (key == "mesh" or entry[key].endswith((".yaml", ".yml")))
    ]
    for entry, key, path in paths:
        entry[key] = scalar(os.path.relpath(scenario.parent.resolve() / path, folder.resolve()))
    new = KEY not in content
    if compensation is None:
        content.pop(KEY, None)
    else:
        content[KEY] = scalar(compensation)
        if new:
            separate(content, KEY)
    return edited_text(content)


def write_compensation(compensation: FrictionCompensation, scenario_name: str, path: Path) -> Path:
    """Write the compensation, and next to it a copy of the scenario that names it.

    Returns:
        Path of the copy, which loads.

    Raises:
        InputError: A file exists already or cannot be written.
    """
    copy = prepare_output(scenario_name, path)
    text = _copy_of(scenario_path(scenario_name), path.parent, path.name)
    try:
        content = compensation.model_dump(mode="json")
        write_whole(path, yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=120))
        write_whole(copy, text)
        load_scenario(str(copy))
    except InputError:
        path.unlink(missing_ok=True)
        copy.unlink(missing_ok=True)
        raise
    return copy
