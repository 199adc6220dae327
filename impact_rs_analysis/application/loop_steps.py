# SPDX-License-Identifier: Apache-2.0
"""The steps of the loop on measurements: compare, diagnose, report, add."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

from impact_rs_analysis.application.measurements import Measurements
from impact_rs_analysis.diagnosis.add import add_effects, add_faults, calibration_file, faults_among
from impact_rs_analysis.diagnosis.compare import ComparisonDocument, compare
from impact_rs_analysis.diagnosis.diagnose import added_of, diagnose
from impact_rs_analysis.diagnosis.document import CalibrationIdentity, DiagnosisDocument, read_document
from impact_rs_analysis.diagnosis.history import VersionError, history
from impact_rs_analysis.diagnosis.laws.formulas import try_out
from impact_rs_analysis.diagnosis.search.bounds import NO_BOUNDS, Bounds
from impact_rs_analysis.diagnosis.search.budget import UNLIMITED, Budget
from impact_rs_analysis.diagnosis.search.effect_selection import ProgressCallback
from impact_rs_analysis.evidence.calibration import (
    NO_CALIBRATION,
    LaboratoryCalibration,
    calibration_in,
    write_calibration,
)
from impact_rs_analysis.report.comparison import write_comparison
from impact_rs_analysis.report.diagnosis import write_diagnosis
from impact_rs_sim.effects.formula import FormulaEffect, load_formulas
from impact_rs_sim.errors import InputError, did_you_mean
from impact_rs_sim.model import Model, ModelEffect, load_model, save_model

CALIBRATED_REMARK = (
    "the calibrated faults {names} were taken as exact and were not diagnosed; --calibration nominal diagnoses them "
    "from the data alone"
)
NO_OPTIONS: Mapping[str, Any] = MappingProxyType({})
NO_LINKS: Mapping[str, str] = MappingProxyType({})


def compare_measurements(measurements: Measurements, model: Model) -> ComparisonDocument:
    """A model against measurements, with the faults of the readings."""
    with measurements.progress():
        return compare(measurements.against(model), model, measurements.calibration)


def report_comparison(
    document: ComparisonDocument,
    measurements: Measurements,
    model_file: Path,
    model: Model,
    directory: Path,
    links: Mapping[str, str] = NO_LINKS,
) -> Path:
    """Write the report of a comparison, and return its page.

    Args:
        document: The comparison.
        measurements: The measurements.
        model_file: File of the model.
        model: The model.
        directory: Folder of the report.
        links: Titles of further pages of the same measurements, by their relative paths.
    """
    with measurements.progress():
        versions = errors_of_versions(measurements, model_file, model)
        tracks = measurements.tracks(model)
    return write_comparison(document, tracks, versions, directory, links)


def errors_of_versions(measurements: Measurements, model_file: Path, model: Model) -> list[VersionError] | None:
    """Errors of a model and its parents; None without a parent and a calibration."""
    if model.parent is None and not measurements.calibration:
        return None
    return history(model_file, measurements.uncalibrated, measurements.calibration)


def with_formulas(model: Model, path: Path | None) -> Model:
    """The model with the formulas of a file.

    Raises:
        InputError: The file is no formula file, a name is taken, or a formula gives no finite value.
    """
    if path is None:
        return model
    formulas = load_formulas(path)
    check_formulas(formulas.values(), model.known_effects, path)
    return model.model_copy(update={"formulas": (*model.formulas, *(effect.spec for effect in formulas.values()))})


def check_formulas(effects: Iterable[FormulaEffect], present: Iterable[str], file: Path | str) -> None:
    """Check the effects of a formula file.

    Args:
        effects: The effects.
        present: Names that exist already.
        file: File, for messages.

    Raises:
        InputError: A name is taken, or a formula gives no finite value.
    """
    effects, names = list(effects), set(present)
    for effect in effects:
        if effect.name in names:
            raise InputError(f"there is already an effect called {effect.name!r}; give yours another name", file=file)
    try_out(effects, file)


def check_effects(model: Model, names: Sequence[str] | None) -> None:
    """Check the names of effects that are to be considered.

    Raises:
        InputError: An unknown effect, or an effect of the model.
    """
    library = model.known_effects
    present = {item.name for item in model.effects}
    for name in names or []:
        if name not in library:
            raise InputError(
                f"no effect {name!r}{did_you_mean(name, library)}; known effects: {', '.join(sorted(library))}"
            )
        if name in present:
            raise InputError(f"model {model.name!r} has effect {name!r} already; diagnose looks for missing effects")


def check_uncalibrated(calibration: LaboratoryCalibration, names: Sequence[str] | None) -> None:
    """Check that no effect to consider is calibrated.

    Raises:
        InputError: The calibration has one of the effects.
    """
    for index, effect in enumerate(calibration.faults.effects):
        if effect.name in (names or ()):
            raise InputError(
                f"{effect.name} is calibrated and therefore not diagnosed; --calibration nominal diagnoses without "
                "this file",
                file=calibration.file,
                key=f"effects.{index}.name",
            )


def diagnose_measurements(
    measurements: Measurements,
    model: Model,
    extended: Model | None = None,
    only: Sequence[str] | None = None,
    rank: ProgressCallback = lambda *_: None,
    bounds: Bounds = NO_BOUNDS,
    options: Mapping[str, Any] = NO_OPTIONS,
    budget: Budget = UNLIMITED,
) -> DiagnosisDocument:
    """Effects that are missing in a model.

    Args:
        measurements: The measurements.
        model: The model of its file.
        extended: The model with further formulas (:func:`with_formulas`); None: no further formulas.
        only: Names of the effects to consider; None: all.
        rank: Called with effects and their held-out error during the search.
        bounds: Ranges of parameters from the user.
        options: Options of the command, for the document.
        budget: Processor time of the diagnosis.

    Raises:
        InputError: An effect of the calibration is to be considered, or there are too few conditions.
    """
    check_uncalibrated(measurements.calibration, only)
    extended = model if extended is None else extended
    with measurements.progress():
        document = diagnose(measurements.against(extended), model, only, rank, bounds, budget=budget)
    calibration = CalibrationIdentity.of(measurements.calibration)
    remarks = () if calibration is None else (CALIBRATED_REMARK.format(names=", ".join(calibration.effects)),)
    return document.model_copy(
        update={
            "formulas": tuple(spec for spec in extended.formulas if spec not in model.formulas),
            "options": dict(options),
            "calibration": calibration,
            "remarks": (*remarks, *document.remarks),
        }
    )


def report_diagnosis(
    document: DiagnosisDocument, measurements: Measurements, model_file: Path, model: Model, directory: Path
) -> Path:
    """Write the report of a diagnosis, and return its page.

    Args:
        document: The diagnosis.
        measurements: The measurements.
        model_file: File of the diagnosed model.
        model: The diagnosed model with all formulas that were considered.
        directory: Folder of the report.
    """
    with measurements.progress():
        source = measurements.against(model)
        versions = errors_of_versions(measurements, model_file, model)
        tracks = measurements.tracks(model, added_of(document, source))
    return write_diagnosis(document, compare(source, model, measurements.calibration), tracks, versions, directory)


@dataclass(frozen=True)
class Addition:
    """Diagnosed effects in files: effects of the physics in a new model, faults of the readings in a calibration.

    Attributes:
        model: The model that was diagnosed.
        child: The new model; None: no effect of the physics was added.
        calibration: The calibration; None: no fault was added.
        physics: Added effects of the child.
        faults: Added effects of the calibration.
        document: The diagnosis.
    """

    model: Model
    child: Model | None
    calibration: LaboratoryCalibration | None
    physics: tuple[ModelEffect, ...]
    faults: tuple[ModelEffect, ...]
    document: DiagnosisDocument

    def write(self, output: Path | None) -> None:
        """Write both files or neither.

        Args:
            output: File of the new model.

        Raises:
            InputError: A file cannot be written.
        """
        if self.child is not None:
            assert output is not None
            save_model(self.child, output)
        if self.calibration is not None:
            try:
                write_calibration(self.calibration)
            except InputError:
                if self.child is not None and output is not None:
                    output.unlink()
                raise


def addition_of(
    effects: Sequence[str],
    model_file: Path,
    source: Path,
    output: Path | None,
    calibration: Path | None = None,
    force: bool = False,
) -> Addition:
    """Diagnosed effects added to a model and a calibration; nothing is written yet.

    Args:
        effects: Names of the effects.
        model_file: The diagnosed model.
        source: The diagnosis, or a discovery.
        output: File of the new model, which has effects of the physics.
        calibration: File of the calibration; None: the calibration of the diagnosed measurements.
        force: Whether to add effects that were not confirmed.

    Raises:
        InputError: A file cannot be read, an effect cannot be added, or an effect of the physics has no output.
    """
    model, document = load_model(model_file), read_document(source)
    faults = faults_among(effects, model, document)
    physics = [name for name in effects if name not in faults]
    child, calibration_with_faults = None, None
    if physics and output is None:
        raise InputError(f"{', '.join(physics)} of the physics goes into a new model file; name it with -o FILE.yaml")
    if physics and output is not None:
        child = add_effects(model, model_file, document, source, physics, output, force)
    if faults:
        file = calibration_file(document, source) if calibration is None else calibration
        calibration_with_faults = add_faults(calibration_in(file), document, source, faults, force)
    return Addition(
        model,
        child,
        calibration_with_faults,
        tuple(item for item in (child or model).effects if item.name in physics),
        tuple(item for item in (calibration_with_faults or NO_CALIBRATION).faults.effects if item.name in faults),
        document,
    )
