"""How the error fell from model version to model version, on what the fit has seen and on what it has not."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from impact_rs_analysis.diagnosis.candidates import NormalEquations, linearise
from impact_rs_analysis.diagnosis.compare import (
    Comparison,
    noise_floor_of,
    scaled_evidence,
    score_of,
)
from impact_rs_analysis.evidence.clusters import ConditionEvidence
from impact_rs_analysis.evidence.rollouts import Progress, RolloutStore, residuals
from impact_rs_analysis.evidence.runs import Runs
from impact_rs_sim.errors import InputError
from impact_rs_sim.model import JOINT_COUNT, Model, load_model
from impact_rs_trials.workers import Map


@dataclass(frozen=True)
class Version:
    """One model of the history.

    Attributes:
        file: Its file.
        model: The model.
        effect_added: What it has and its parent has not; None for the first.
    """

    file: str
    model: Model
    effect_added: str | None


@dataclass(frozen=True)
class VersionError:
    """Errors of one model, in multiples of what repetition explains [-].

    Attributes:
        version: Which model.
        error_fit: Error with the parameters of its file.
        error_held_out: Error in every condition with the added effect's parameters fitted to all other conditions;
            None where there are too few conditions.
        noise_floor: What both would be if only repetition were left; None if nothing was repeated.
    """

    version: Version
    error_fit: float
    error_held_out: float | None
    noise_floor: float | None

    def to_json(self) -> dict[str, Any]:
        """One entry of ``history --json``."""
        return {
            "model": self.version.model.name,
            "file": self.version.file,
            "effect_added": self.version.effect_added,
            "error_fit": self.error_fit,
            "error_held_out": self.error_held_out,
            "noise_floor": self.noise_floor,
        }


def versions(path: Path) -> list[Version]:
    """The models from the first to the one in ``path``.

    Raises:
        InputError: A parent is missing, was changed after the child was made, or is its own ancestor.
    """
    chain: list[tuple[Path, Model]] = []
    file: Path = path
    while True:
        if any(file.exists() and known.exists() and known.samefile(file) for known, _ in chain):
            raise InputError("this model is its own ancestor", file=file, key="parent")
        model = load_model(file)
        if chain:
            child_file, child = chain[-1]
            if child.parent_digest not in (None, model.digest):
                raise InputError(
                    f"the parent {file} was changed after this model was made from it (digest {model.digest}, "
                    f"expected {child.parent_digest})",
                    file=child_file,
                    key="parent_digest",
                )
        chain.append((file, model))
        if model.parent is None:
            break
        beside = file.parent / model.parent
        file = beside if beside.exists() else Path(model.parent)
    chain.reverse()
    result = []
    for number, (found, model) in enumerate(chain):
        before = set() if number == 0 else {item.model_dump_json() for item in chain[number - 1][1].effects}
        new = [item.name for item in model.effects if item.model_dump_json() not in before]
        result.append(Version(str(found), model, "+".join(new) if number and new else None))
    return result


def history(
    path: Path,
    runs: Runs,
    map_tasks: Map,
    progress: Progress | None = None,
    known: Sequence[Comparison] = (),
) -> list[VersionError]:
    """Errors of every version of a model, from the first to the one in ``path``.

    Args:
        path: File of the last model.
        runs: Measurements.
        map_tasks: Parallel map.
        progress: Called with (what, done, total).
        known: Comparisons of some of the versions with the same runs, so that they need not be made again.

    Raises:
        InputError: See :func:`versions`; or with one of the models nothing is hit.
    """
    found: list[VersionError] = []
    store = RolloutStore(map_tasks, progress)
    for version in versions(path):
        done = next((entry for entry in known if entry.digest == version.model.digest and entry.runs is runs), None)
        if done is not None:
            evidence = list(done.evidence)
        else:
            evidence, _ = scaled_evidence(runs, residuals(runs, version.model, store))
        error = score_of(evidence)
        held_out: float | None = error
        if version.effect_added is not None:
            held_out = _held_out(version, evidence, store)
        found.append(VersionError(version, error, held_out, noise_floor_of(evidence)))
    return found


def _held_out(version: Version, evidence: list[ConditionEvidence], store: RolloutStore) -> float | None:
    """Leave one condition out: the added effects fitted to all others, about the estimate in the model file."""
    if len(evidence) < 2 or version.effect_added is None:
        return None
    names = version.effect_added.split("+")
    model = version.model
    bare = model.model_copy(update={"effects": tuple(item for item in model.effects if item.name not in names)})
    effects = tuple(model.known_effects[name] for name in names)
    values = {item.name: item.parameters for item in model.effects}
    vectors = [tuple(values[effect.name][s.name].estimate for s in effect.scalars(JOINT_COUNT)) for effect in effects]
    added = tuple(zip(names, vectors, strict=True))
    point = np.concatenate(vectors)
    candidate = linearise(effects, bare, evidence, store, point, "leaving one condition out", added)
    if candidate is None:
        return None
    return math.sqrt(float(np.mean(NormalEquations(candidate, evidence).held_out())))
