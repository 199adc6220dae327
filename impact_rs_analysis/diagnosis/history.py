# SPDX-License-Identifier: Apache-2.0
"""Fitted and held-out error from model version to model version.

If measurements have a calibration, its faults of the readings follow the first model one by one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from impact_rs_analysis.diagnosis.search.candidate import Candidate, linearise
from impact_rs_analysis.diagnosis.search.fit import Evidence
from impact_rs_analysis.diagnosis.verdicts.residuals import residual_size
from impact_rs_analysis.evidence.calibration import NO_CALIBRATION, LaboratoryCalibration
from impact_rs_analysis.evidence.cluster import TIMES
from impact_rs_analysis.evidence.rollouts import RolloutDocument
from impact_rs_analysis.evidence.source import Source
from impact_rs_sim.errors import InputError
from impact_rs_sim.model import Model, load_model


@dataclass(frozen=True)
class Version:
    """One model of the history.

    Attributes:
        file: Its file.
        model: The model.
        effects_added: Effects added to its parent; empty for the first.
        applied: The model with the known faults of the readings; None: without calibration.
    """

    file: str
    model: Model
    effects_added: tuple[str, ...]
    applied: Model | None = None

    @property
    def calibrated(self) -> Model:
        """The model with the known faults of the readings, which predicts the measurements."""
        return self.model if self.applied is None else self.applied

    @property
    def effect_added(self) -> str | None:
        """Effects added, joined by ``+``; None: without added effects."""
        return "+".join(self.effects_added) or None


@dataclass(frozen=True)
class VersionError:
    """Errors of one model version, on the scale of the comparison.

    Attributes:
        version: Which model.
        error_fit: Error with the parameters of its file.
        error_held_out: Error in every condition with the added effect's parameters fitted to all other conditions;
            None where there are too few conditions.
        noise_floor: Both errors if only noise were left; None if nothing was repeated.
        unit: Unit of the errors, ``TIMES`` for multiples of repeatability.
        rollouts: Open-loop predictions with the parameters of its file; None: none was possible.
        runs_digest: Digest of the measurements; empty for recordings.
    """

    version: Version
    error_fit: float
    error_held_out: float | None
    noise_floor: float | None
    unit: str = TIMES
    rollouts: RolloutDocument | None = None
    runs_digest: str = ""

    def to_json(self) -> dict[str, Any]:
        """One entry of ``history --json``."""
        document: dict[str, Any] = {"runs_digest": self.runs_digest} if self.runs_digest else {}
        document |= {} if self.rollouts is None else {"rollouts": self.rollouts.model_dump(mode="json")}
        return {
            "model": self.version.model.name,
            "digest": self.version.model.digest,
            "file": self.version.file,
            "effect_added": self.version.effect_added,
            "error_fit": self.error_fit,
            "error_held_out": self.error_held_out,
            "noise_floor": self.noise_floor,
            **document,
        }


def versions(path: Path) -> list[Version]:
    """The models from the first to the one in ``path``.

    Raises:
        InputError: A parent is missing, was changed after the child was made, or is its own ancestor.
    """
    chain: list[tuple[Path, Model]] = []
    file: Path = path
    while True:
        if any(file.exists() and ancestor.exists() and ancestor.samefile(file) for ancestor, _ in chain):
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
        beside_child = file.parent / model.parent
        file = beside_child if beside_child.exists() else Path(model.parent)
    chain.reverse()
    result = []
    for number, (model_file, model) in enumerate(chain):
        before = set() if number == 0 else {item.model_dump_json() for item in chain[number - 1][1].effects}
        new = [item.name for item in model.effects if item.model_dump_json() not in before]
        result.append(Version(str(model_file), model, tuple(new) if number else ()))
    return result


def with_calibration(chain: Sequence[Version], calibration: LaboratoryCalibration) -> list[Version]:
    """The first model, then with the faults of the readings one by one, then its children with all faults.

    Args:
        chain: The models from the first to the last.
        calibration: Faults of the readings.

    Raises:
        InputError: The calibration contains an effect of a model, or does not fit it.
    """
    if not calibration:
        return list(chain)
    first = chain[0]
    steps = [
        Version(str(calibration.file), partial.faults, (partial.faults.effects[-1].name,), partial.of(first.model))
        for partial in calibration.steps()
    ]
    return [first, *steps, *(replace(version, applied=calibration.of(version.model)) for version in chain[1:])]


def history(
    path: Path, source_of: Callable[[Model], Source], calibration: LaboratoryCalibration = NO_CALIBRATION
) -> list[VersionError]:
    """Errors of every version of a model, from the first to the one in ``path``.

    Args:
        path: File of the last model.
        source_of: The measurements against a model as it is, without a calibration; called once for every version.
        calibration: Faults of the readings; their errors follow the error of the first model.

    Raises:
        InputError: See :func:`versions` and :func:`with_calibration`; or the replay with one of the models has no
            contact.
    """
    errors: list[VersionError] = []
    for version in with_calibration(versions(path), calibration):
        source = source_of(version.calibrated)
        error, noise = source.size(), source.noise_size()
        held_out: float | None = error
        if version.effects_added:
            held_out = _held_out(version, source, source_of)
        rollouts = source.rollouts()
        document = None if rollouts is None else rollouts.document()
        digest = errors[0].runs_digest if errors else source.identity.digest  # opens every bag
        errors.append(VersionError(version, error, held_out, noise, source.size_unit, document, digest))
    return errors


def _held_out(version: Version, source: Source, source_of: Callable[[Model], Source]) -> float | None:
    """Error of every condition with the added effects fitted to all others, about the estimate in the model file.

    Args:
        version: Version with added effects.
        source: The measurements against it; they set the scale of the error.
        source_of: See :func:`history`.
    """
    names, model = version.effects_added, version.calibrated
    bare = source_of(
        model.model_copy(update={"effects": tuple(item for item in model.effects if item.name not in names)})
    )
    # A replay without the effect may hit nothing; the source then lacks this condition.
    index_of = {item.name: number for number, item in enumerate(bare.clusters)}
    clusters = tuple(item for item in source.clusters if item.name in index_of)
    if len(clusters) < 2:
        return None
    numbers = tuple(index_of[item.name] for item in clusters)
    effects = tuple(bare.model.known_effects[name] for name in names)
    values = {item.name: item.parameters for item in model.effects}
    point = np.array(
        [
            (parameters.get(scalar.name) or parameters[scalar.shared_name]).estimate
            for effect in effects
            for parameters in [values[effect.name]]
            for scalar in effect.scalars(bare.joints)
        ]
    )
    bare_candidate = Candidate.of(effects, bare, point)
    candidate = linearise(
        replace(bare_candidate, origin=bare_candidate.effects_at(point)),
        clusters,
        numbers,
        bare,
        "leaving one condition out",
    )
    if candidate is None:
        return None
    residuals = Evidence(bare, numbers, clusters).problem(candidate).leave_one_out_residuals
    return residual_size(Evidence(source, numbers, clusters), residuals)
