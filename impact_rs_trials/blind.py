# SPDX-License-Identifier: Apache-2.0
"""Blind campaigns: a plant with a hidden effect, which is recorded in ``truth.json`` only.

``make`` draws an effect and its size from a seed, records a campaign with it (``DIR/runs``) and writes the truth to
``DIR/truth.json``. No diagnosis reads the truth.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np

from impact_rs_control.plan import TrialPlan
from impact_rs_sim.effects import library, of_trials
from impact_rs_sim.effects.base import Joints
from impact_rs_sim.errors import InputError
from impact_rs_sim.files import write_whole
from impact_rs_sim.model import Model, ModelEffect, ParameterValue
from impact_rs_sim.physics import Physics
from impact_rs_sim.plant.plant import check_hidden
from impact_rs_sim.plant.unmodelled import LAWS, OUTSIDE
from impact_rs_sim.robots.robot import JointType
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_trials.bags.record import record_trial
from impact_rs_trials.bags.trial_info import VIA, TrialInfo
from impact_rs_trials.bags.writer import partial_path
from impact_rs_trials.campaign import Trial
from impact_rs_trials.spec import TrialSpec
from impact_rs_trials.store import Folder, owned
from impact_rs_trials.workers import Map

KINDS = ("single", "pair", "null", "outside")
TRUTH = "truth.json"
RUNS = "runs"
SCENARIOS = ("push", "excite")


@dataclass(frozen=True)
class Hidden:
    """One hidden effect.

    Attributes:
        name: Effect.
        values: Its parameters, in the order of its scalars.
        magnitude: Size in parameter scales.
    """

    name: str
    values: tuple[float, ...]
    magnitude: float


@dataclass(frozen=True)
class Size:
    """Size of a campaign: objects and cases of the push, repeats of push and excursion."""

    objects: tuple[str, ...]
    cases: tuple[str, ...]
    repeats: int
    excite_repeats: int


SIZES = {
    "small": Size(("parcel", "juice"), ("case_1", "case_2"), 3, 3),
    "full": Size(("parcel", "cat_food", "juice"), ("case_1", "case_2", "case_3"), 4, 4),
}


def draw(
    name: str, magnitude: float, rng: np.random.Generator, joints: Joints, worlds: Sequence[Physics] = ()
) -> Hidden:
    """Parameter values of an effect, ``magnitude`` parameter scales away from nominal, in a random direction.

    The physics of ``worlds`` give the bounds (a centre of mass lies inside the box). If the nominal value is a bound
    (friction cannot be negative), the only possible direction is taken; values beyond a bound stop 10 % short of it.
    An effect whose shape is drawn from a range is always positive: a load drawn at a random position can be added
    there, but not removed. A parameter with a prior, which the data hardly determine, stays nominal.

    Raises:
        InputError: It acts on neighbours of the object, and no world has a neighbour.
    """
    effect = library()[name]
    if worlds and effect.acts_on == "neighbour" and not any(world.neighbours for world in worlds):
        raise InputError(
            f"effect {name!r} changes nothing where no object has neighbours; name a scenario with some, such as "
            "push_two_boxes, with --scenarios"
        )
    scalars = effect.scalars(joints)
    lowest, highest = (np.array([getattr(scalar, side) for scalar in scalars]) for side in ("lower", "upper"))
    if worlds:
        lowest, highest = effect.bounds_in(worlds)
    values = []
    for scalar, lower, upper in zip(scalars, lowest, highest, strict=True):
        if scalar.prior is not None:
            values.append(scalar.nominal)
            continue
        size = magnitude * scalar.scale * rng.uniform(0.7, 1.3)
        up = upper - scalar.nominal > 0.0 and (scalar.nominal <= lower or rng.random() < 0.5)
        room = 0.9 * (upper - scalar.nominal if up else scalar.nominal - lower)
        values.append(scalar.nominal + (1.0 if up else -1.0) * min(size, room))
    if any(scalar.hidden is not None for scalar in scalars):
        for index, scalar in enumerate(scalars):
            if scalar.hidden is not None:
                values[index] = rng.uniform(*scalar.hidden)
            elif lowest[index] < scalar.nominal < highest[index]:
                size = magnitude * scalar.scale * rng.uniform(0.7, 1.3)
                values[index] = scalar.nominal + min(size, 0.9 * (highest[index] - scalar.nominal))
    return Hidden(name, tuple(float(value) for value in values), magnitude)


def draw_truth(
    seed: int,
    kind: str,
    effect: str | None,
    magnitude: float | None,
    joints: Joints | None = None,
    worlds: Sequence[Physics] = (),
) -> list[Hidden]:
    """The hidden effects of a campaign; the default number of joints is the shipped arm's.

    Effects of the physics are drawn; effects of sensors, and those added later, are hidden if named.

    Raises:
        InputError: Unknown kind or effect, or not as many effects as the kind has.
    """
    if kind not in KINDS:
        raise InputError(f"no kind {kind!r}; known: {', '.join(KINDS)}")
    names = sorted(name for name, candidate in of_trials().items() if candidate.drawn and not candidate.of_measurement)
    rng = np.random.default_rng([seed, KINDS.index(kind)])
    count = {"single": 1, "pair": 2}.get(kind, 0)
    if effect is None or count == 0:
        chosen = list(rng.choice(names, size=count, replace=False))
    else:
        chosen = effect.split("+")
        effect_names = sorted(of_trials())
        if unknown := [name for name in chosen if name not in effect_names]:
            raise InputError(f"no effect {unknown[0]!r}; known effects: {', '.join(effect_names)}")
        if len(set(chosen)) != count or len(chosen) != count:
            expected = "one effect" if count == 1 else "two effects as FIRST+SECOND"
            raise InputError(f"got effect {effect!r}; expected {expected} for a {kind}")
    hidden = []
    joints = _joints(SCENARIOS) if joints is None else joints
    for name in chosen:
        size = magnitude if magnitude is not None else float(np.exp(rng.uniform(0.0, np.log(10.0))))
        hidden.append(draw(str(name), size, rng, joints, worlds))
    return hidden


def draw_outside(
    seed: int, name: str | None, magnitude: float | None, names: Collection[str] = OUTSIDE
) -> tuple[str, float]:
    """An effect that is not in the library, and its size (1: noticeable).

    Mechanisms of :data:`~impact_rs_sim.plant.unmodelled.OUTSIDE` are drawn; laws of that module are hidden if named.

    Raises:
        InputError: No outside effect has that name.
    """
    allowed = (*names, *LAWS) if names is OUTSIDE else names
    if name is not None and name not in allowed:
        raise InputError(f"no outside effect {name!r}; known: {', '.join(allowed)}")
    rng = np.random.default_rng([seed, KINDS.index("outside")])
    chosen = name or str(rng.choice(list(names)))
    return chosen, magnitude if magnitude is not None else float(np.exp(rng.uniform(0.0, np.log(4.0))))


@dataclass(frozen=True)
class Secret:
    """All hidden effects of a plant.

    Attributes:
        hidden: Effects of the library.
        outside: Effect outside the library; None: no such effect.
        strength: Size of the outside effect (1: noticeable).
        truth: Content of ``truth.json``.
    """

    hidden: tuple[Hidden, ...]
    outside: str | None
    strength: float
    truth: str

    @classmethod
    def drawn(
        cls,
        seed: int,
        kind: str = "single",
        effect: str | None = None,
        magnitude: float | None = None,
        size: str = "small",
        outsides: Collection[str] = OUTSIDE,
        scenarios: Sequence[str] = SCENARIOS,
    ) -> Self:
        """Draw the hidden effects of a seed; arguments and errors as for :func:`make`."""
        joints = _joints(scenarios)
        worlds = [spec.plan.scene.physics for spec, _ in specs(size, scenarios)]
        hidden = draw_truth(seed, kind, effect, magnitude, joints, worlds)
        for world in worlds:
            check_hidden(hide(world, hidden))
        outside, strength = (None, 0.0) if kind != "outside" else draw_outside(seed, effect, magnitude, outsides)
        truth = {
            "kind": kind,
            "seed": seed,
            "size": size,
            "outside": outside,
            "outside_magnitude": strength,
            "effects": [
                {"name": item.name, "magnitude": item.magnitude, "parameters": named_values(item, joints)}
                for item in hidden
            ],
        }
        if tuple(scenarios) != SCENARIOS:
            truth["scenarios"] = list(scenarios)
        return cls(tuple(hidden), outside, strength, json.dumps(truth, indent=2) + "\n")

    @property
    def model(self) -> Model | None:
        """The hidden effects of the library in the format of the plant node; None: not any."""
        effects = tuple(
            ModelEffect(
                name=item["name"],
                parameters={
                    name: ParameterValue(estimate=parameter["value"], unit=parameter["unit"])
                    for name, parameter in item["parameters"].items()
                },
            )
            for item in (json.loads(self.truth)["effects"] if self.truth else ())
        )
        return Model(name="hidden", effects=effects) if effects else None

    def check(self, directory: Path) -> None:
        """Check that a folder holds no other truth.

        Raises:
            InputError: It holds another truth.
        """
        path = directory / TRUTH
        if path.exists() and path.read_text(encoding="utf-8") != self.truth:
            raise InputError("this folder holds another blind campaign; choose another folder", file=directory)

    def write(self, directory: Path) -> None:
        """Write the truth and create a folder for the trials; no diagnosis reads the truth."""
        (directory / RUNS).mkdir(parents=True, exist_ok=True)
        write_whole(directory / TRUTH, self.truth)


def hide(physics: Physics, hidden: list[Hidden]) -> Physics:
    """Physics with the hidden effects."""
    for item in hidden:
        physics = library()[item.name].apply_vector(physics, np.array(item.values))
    return physics


@dataclass(frozen=True)
class BlindTask:
    """One trial of a blind campaign; everything a worker needs."""

    directory: str
    trial: Trial
    hidden: tuple[Hidden, ...]
    outside: str | None
    magnitude: float
    folder: str = ""  # of its bag, below the directory; empty: the name of its scenario


def _record(task: BlindTask, plan: TrialPlan, info: TrialInfo, path: Path, physics: Physics) -> str:
    """Record one trial on our plant."""
    extension = None if task.outside is None else {**OUTSIDE, **LAWS}[task.outside](task.magnitude, task.trial.repeat)
    return record_trial(plan, info, path, physics, extension)[0].outcome


Recorder = Callable[[BlindTask, TrialPlan, TrialInfo, Path, Physics], str]


def run_task(task: BlindTask, record: Recorder = _record) -> str:
    """Record one trial, unless a complete bag exists. Returns the outcome.

    Args:
        task: The trial.
        record: Records the trial on a robot cell with the given physics.

    Raises:
        InputError: This machine does not see the campaign's folder.
    """
    trial = task.trial
    path = Path(task.directory) / (task.folder or trial.spec.scenario.name) / trial.key.name
    if not Path(task.directory).is_dir():
        raise InputError("a worker does not find this folder; expected one that all workers share", file=task.directory)
    if path.exists():
        return "OK"
    shutil.rmtree(partial_path(path), ignore_errors=True)
    plan = trial.spec.plan
    info = TrialInfo.of(plan, trial.key, trial.seed, VIA["bullet"])
    return record(task, plan, info, path, hide(plan.scene.physics, list(task.hidden)))


def specs(size: str, scenarios: Sequence[str] = SCENARIOS) -> list[tuple[TrialSpec, int]]:
    """Conditions of a blind campaign, with the number of repeats of each.

    If a scenario has no object (case) of the size, all its objects (cases) are taken.

    Raises:
        InputError: Unknown size or scenario.
    """
    if size not in SIZES:
        raise InputError(f"no size {size!r}; known: {', '.join(SIZES)}")
    plan = SIZES[size]
    conditions: list[tuple[TrialSpec, int]] = []
    for scenario in map(load_scenario, scenarios):
        if scenario.excursion is None:
            objects = [name for name in plan.objects if name in scenario.objects] or list(scenario.objects)
            cases = [name for name in plan.cases if name in scenario.cases] or list(scenario.cases)
            conditions += [(TrialSpec.of(scenario, name, case), plan.repeats) for name in objects for case in cases]
        else:
            first = next(iter(scenario.objects))
            conditions += [(TrialSpec.of(scenario, first, case), plan.excite_repeats) for case in scenario.cases]
    return conditions


def tasks(
    directory: Path,
    seed: int,
    size: str,
    hidden: list[Hidden],
    outside: str | None,
    magnitude: float,
    scenarios: Sequence[str] = SCENARIOS,
) -> list[BlindTask]:
    """Every trial of a blind campaign; raises as :func:`specs`."""
    runs = str((directory / RUNS).absolute())  # a worker process may stand elsewhere
    trials = [Trial.of(spec, repeat, seed) for spec, repeats in specs(size, scenarios) for repeat in range(repeats)]
    return [BlindTask(runs, trial, tuple(hidden), outside, magnitude) for trial in trials]


def make(
    directory: Path,
    seed: int,
    map_tasks: Map,
    kind: str = "single",
    effect: str | None = None,
    size: str = "full",
    magnitude: float | None = None,
    work: Callable[[BlindTask], str] = run_task,
    outsides: Collection[str] = OUTSIDE,
    scenarios: Sequence[str] = SCENARIOS,
) -> Iterator[tuple[int, int]]:
    """Make a blind campaign; yields (done, total) as trials end.

    Args:
        directory: Folder of the campaign.
        seed: Seed of the draws.
        map_tasks: Map over workers.
        kind: One of ``KINDS``.
        effect: Effect to hide, two as ``first+second``; None: drawn.
        size: One of ``SIZES``.
        magnitude: Size in parameter scales; for an outside effect in multiples of a noticeable one; None: drawn.
        work: Records a trial; :func:`run_task` on another cell than our plant.
        outsides: Names of the effects outside the library that it knows.
        scenarios: Names or paths of the scenarios to record, with arms of one kind: hits, and motions there and back.

    Raises:
        InputError: Unknown kind, effect, size or scenario, an effect that no plant shows, arms with different numbers
            of joints, or a folder that holds another blind campaign.
    """
    secret = Secret.drawn(seed, kind, effect, magnitude, size, outsides, scenarios)
    todo = tasks(directory, seed, size, list(secret.hidden), secret.outside, secret.strength, scenarios)
    secret.check(directory)
    with owned(Folder(directory)):
        secret.write(directory)
        for done, _ in enumerate(map_tasks(work, todo), start=1):
            yield done, len(todo)


def _joints(scenarios: Sequence[str]) -> tuple[JointType, ...]:
    """Joint types of the arms of some scenarios, which have to agree.

    Raises:
        InputError: The arms differ, or there is no scenario.
    """
    robots = {name: load_scenario(name).robots.values() for name in scenarios}
    facts = {name: [robot.robot_facts for robot in arms] for name, arms in robots.items()}
    kinds = {robot_facts.joint_types for of_scenario in facts.values() for robot_facts in of_scenario}
    if len(kinds) != 1:
        counts = {
            name: sorted({robot_facts.joint_count for robot_facts in of_scenario})
            for name, of_scenario in facts.items()
        }
        listed = ", ".join(f"{name}: {', '.join(map(str, of_scenario))}" for name, of_scenario in counts.items())
        raise InputError(
            "a blind campaign needs arms with the same number of joints, of the same types (revolute, prismatic); got "
            f"{listed or 'none'}"
        )
    return kinds.pop()


def named_values(item: Hidden, joints: Joints) -> dict[str, Any]:
    """Parameters of a hidden effect with their units, in the format of the truth."""
    scalars = library()[item.name].scalars(joints)
    return {
        scalar.name: {"value": value, "unit": scalar.unit} for scalar, value in zip(scalars, item.values, strict=True)
    }
