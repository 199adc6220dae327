# SPDX-License-Identifier: Apache-2.0
"""The child of a model, with diagnosed effects; and a calibration with diagnosed faults of the readings."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from impact_rs_analysis.diagnosis.document import DiagnosisDocument, EffectDocument
from impact_rs_analysis.diagnosis.verdict import NO_IMPROVEMENT, TOO_FEW, UNIDENTIFIABLE
from impact_rs_analysis.evidence.calibration import CALIBRATION, LaboratoryCalibration, check_faults, file_beside
from impact_rs_sim.effects.formula import FormulaSpec
from impact_rs_sim.errors import InputError, did_you_mean
from impact_rs_sim.files import is_file
from impact_rs_sim.model import Model, ModelEffect, ParameterValue, check_model
from impact_rs_sim.numbers import rounded_interval
from impact_rs_sim.paths import config_directory


def add_effects(
    model: Model,
    model_file: Path,
    document: DiagnosisDocument,
    source: Path,
    names: Sequence[str],
    output: Path,
    force: bool,
) -> Model:
    """The child model with diagnosed effects, not yet written; estimates are those of all effects of the diagnosis.

    Args:
        model: Parent.
        model_file: Its file.
        document: Diagnosis of the parent.
        source: File of the diagnosis.
        names: Effects to add.
        output: File of the child, to name the parent relative to it.
        force: Add them even if the diagnosis found no improvement, or that their parameters depend on a covariate.

    Raises:
        InputError: The diagnosis is of another model, does not contain an effect, or advises against it.
    """
    if document.model.digest != model.digest:
        raise InputError(
            f"this is a diagnosis of model {document.model.name!r} (digest {document.model.digest}), not of "
            f"{model.name!r} (digest {model.digest}) in {model_file}; diagnose that one, or name the model of this one",
            file=source,
        )
    child, note = _extended(model, document, source, names, force, output.stem, _parent_name(model_file, output))
    return check_model(child.model_copy(update={"note": note, "parent_digest": model.digest}), source)


def faults_among(names: Sequence[str], model: Model, document: DiagnosisDocument) -> list[str]:
    """Faults of readings among some effects, which belong to the laboratory and not to the model.

    Args:
        names: Effects.
        model: The diagnosed model.
        document: Its diagnosis.
    """
    effects = model.model_copy(update={"formulas": (*model.formulas, *document.formulas)}).known_effects
    return [name for name in names if name in effects and effects[name].of_measurement]


def calibration_file(document: DiagnosisDocument, source: Path) -> Path:
    """The calibration file of the diagnosed measurements: the file of the diagnosis, or the default in their folder.

    Args:
        document: A diagnosis.
        source: Its file.

    Raises:
        InputError: The diagnosis does not name the folder of the measurements, or the folder is gone.
    """
    file, data = document.options.get("calibration"), document.options.get("impacts", document.options.get("runs"))
    if file is not None and is_file(file):
        return Path(file)
    if data is None or not Path(data).exists():
        where = "does not say where its measurements are" if data is None else f"has measurements of {data}, now gone"
        raise InputError(
            f"this diagnosis {where}, and a fault of their readings is written beside them; name the file, for example "
            f"--calibration FOLDER/{CALIBRATION}",
            file=source,
        )
    return file_beside(Path(data))


def add_faults(
    calibration: LaboratoryCalibration, document: DiagnosisDocument, source: Path, names: Sequence[str], force: bool
) -> LaboratoryCalibration:
    """The calibration with diagnosed faults of the readings, not yet written.

    Args:
        calibration: The calibration of the diagnosis.
        document: Diagnosis.
        source: File of the diagnosis.
        names: Effects of the measurement to add.
        force: As for :func:`add_effects`.

    Raises:
        InputError: The calibration has changed since the diagnosis, or the diagnosis does not contain an effect or
            advises against it.
    """
    faults, diagnosed = calibration.faults, document.calibration
    if (faults.digest if calibration else None) != (None if diagnosed is None else diagnosed.digest):
        raise InputError(
            f"this calibration is not the one of the diagnosis {source}: its faults would be included twice; "
            "diagnose the measurements again",
            file=calibration.file,
        )
    child, note = _extended(faults, document, source, names, force, faults.name, "")
    note = "; ".join(filter(None, [faults.note, note]))
    child = child.model_copy(update={"note": note, "parent": None, "parent_digest": None})
    return replace(calibration, faults=check_faults(check_model(child, source), source))


def _extended(
    model: Model,
    document: DiagnosisDocument,
    source: Path,
    names: Sequence[str],
    force: bool,
    name: str,
    parent: str,
) -> tuple[Model, str]:
    """A model with diagnosed effects, and a note on their verdicts."""
    child, notes = model.model_copy(update={"arms": document.arms or model.arms}), []
    for effect in dict.fromkeys(names):
        item, formulas, note = _diagnosed(child, document, source, effect, force)
        child = child.with_effect(item, name, parent, formulas)
        notes.append(note)
    return child, "; ".join(notes)


def _diagnosed(
    model: Model, document: DiagnosisDocument, source: Path, name: str, force: bool
) -> tuple[ModelEffect, tuple[FormulaSpec, ...], str]:
    """An effect with its parameters, its formula if it has one, and a note on its verdict."""
    diagnosed = document.effect(name)
    if diagnosed is None:
        names = [effect.name for effect in document.effects]
        raise InputError(
            f"no effect {name!r} in this diagnosis{did_you_mean(name, names)}; it considered: {', '.join(names)}",
            file=source,
        )
    if diagnosed.verdict in (UNIDENTIFIABLE, TOO_FEW):
        raise InputError(
            f"{name} is {diagnosed.verdict}: these {document.source} do not determine its parameters, so there is "
            f"nothing to add ({diagnosed.reason})",
            file=source,
        )
    without = diagnosed.held_out_error_before if name in document.named else diagnosed.held_out_error_without
    before, after = without or 0.0, diagnosed.held_out_error_after or 0.0
    if diagnosed.verdict == NO_IMPROVEMENT and not force:
        raise InputError(
            f"{name} is NO-IMPROVEMENT: it predicts unseen conditions no better "
            f"({before:.3g} -> {after:.3g} {document.error_unit}); "
            "--force adds it all the same",
            file=source,
        )
    depends = " and ".join(document.dependent.get(name, ()))
    if depends and not force:
        raise InputError(
            f"{name} depends on {depends}, and a model has one value for all: diagnose some of the rows alone, take "
            f"the values from 'dependences' of this file, or --force adds the mean over {depends}",
            file=source,
        )
    formulas = tuple(_with_room(spec, diagnosed) for spec in document.formulas if spec.name == name)
    effect = model.model_copy(update={"formulas": (*model.formulas, *formulas)}).known_effects.get(name)
    joints = len({value.joint for value in diagnosed.parameters.values()} - {None})
    scalars = [] if effect is None else effect.scalars(joints)
    nominal = {scalar.name: ParameterValue(estimate=scalar.nominal, unit=scalar.unit) for scalar in scalars}
    estimated = {
        key: ParameterValue(estimate=value.estimate, unit=value.unit, ci95=rounded_interval(value.ci95))
        for key, value in diagnosed.parameters.items()
    }
    fall = f"held-out error {before:.3g} -> {after:.3g} {document.error_unit}"
    why = diagnosed.reason if name in document.required else fall
    note = (
        f"{name}: {diagnosed.verdict}; {why} in {document.runs.trials} {document.source}"
        f"{f'; depends on {depends}, the mean was taken' if depends else ''}"
    )
    return ModelEffect(name=name, parameters={**nominal, **estimated}), formulas, note


def _with_room(spec: FormulaSpec, diagnosed: EffectDocument) -> FormulaSpec:
    """The formula with ranges widened to estimates beyond them, up to twice their distance from nominal."""
    parameters = {}
    for name, parameter in spec.parameters.items():
        estimate = diagnosed.parameters[name].estimate
        far = 2.0 * estimate - parameter.nominal
        lower, upper = (
            (far if estimate < parameter.lower else parameter.lower),
            (far if estimate > parameter.upper else parameter.upper),
        )
        parameters[name] = parameter.model_copy(update={"lower": lower, "upper": upper})
    return spec.model_copy(update={"parameters": parameters})


def _parent_name(model_file: Path, output: Path) -> str:
    """The parent's file relative to the child's folder; of a shipped model its file name."""
    shipped = config_directory() / "models" / (model_file.name if model_file.suffix else f"{model_file.name}.yaml")
    if not model_file.exists() or (shipped.exists() and shipped.samefile(model_file)):
        return shipped.name
    return os.path.relpath(model_file.resolve(), output.parent.resolve())
