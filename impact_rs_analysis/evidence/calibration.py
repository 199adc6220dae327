# SPDX-License-Identifier: Apache-2.0
"""Calibration of a laboratory: faults of its readings, in a file in the folder of its measurements.

A calibration has the schema of a model file, and holds effects of the measurement alone. It stays with the data. A
model holds the physics, so that another laboratory can use it. Measurements are predicted with both: readings =
g(motion of the model; calibration). In a difference of recordings their common faults cancel.

Intervals of a calibration are 95 % intervals of normal distributions. The error of a parameter is common to all
measurements (a systematic error; JCGM 100:2008, 5.2), so the residuals of all clusters are correlated: they change by
J_k s_k for one standard deviation s_k of parameter k, with the sensitivity J_k. These changes are rows of
:attr:`Cluster.calibrations`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from impact_rs_analysis.evidence.cluster import Added, Cluster
from impact_rs_analysis.evidence.source import Source
from impact_rs_sim.errors import InputError
from impact_rs_sim.files import is_file, write_whole
from impact_rs_sim.model import Model, check_model, load_model, model_text
from impact_rs_sim.numbers import NORMAL_95
from impact_rs_sim.robots.robot import Array

CALIBRATION = "calibration.yaml"
NO_FAULTS = Model(name="calibration")


@dataclass(frozen=True)
class LaboratoryCalibration:
    """A calibration of a laboratory.

    Attributes:
        faults: Effects of the measurement.
        file: Its file, which need not exist; None: no file.
    """

    faults: Model = NO_FAULTS
    file: Path | None = None

    def __bool__(self) -> bool:
        return bool(self.faults.effects)

    @property
    def text(self) -> str:
        """Its file, with the names of its effects."""
        return f"{self.file} ({', '.join(item.name for item in self.faults.effects)})"

    def of(self, model: Model) -> Model:
        """The model with the faults of the readings.

        Raises:
            InputError: Model and calibration have the same effect, or do not fit together.
        """
        if not self:
            return model
        for number, item in enumerate(self.faults.effects):
            if item.name in {effect.name for effect in model.effects}:
                raise InputError(
                    f"model {model.name!r} has {item.name} as well, so it would be applied twice; remove it from one "
                    "of the two files",
                    file=self.file,
                    key=f"effects.{number}.name",
                )
        arms = model.arms or self.faults.arms
        if self.faults.arms and self.faults.arms != arms:
            raise InputError(f"other arms than model {model.name!r} has", file=self.file, key="arms")
        formulas = (*model.formulas, *(spec for spec in self.faults.formulas if spec.name not in model.known_effects))
        whole = {"effects": (*model.effects, *self.faults.effects), "formulas": formulas, "arms": arms}
        return check_model(model.model_copy(update=whole), self.file or CALIBRATION)

    def removed_from(self, model: Model) -> Model:
        """The physics of a model that was extended by :meth:`of`."""
        faults = {item.name for item in self.faults.effects}
        return model.model_copy(update={"effects": tuple(item for item in model.effects if item.name not in faults)})

    def steps(self) -> Sequence[LaboratoryCalibration]:
        """The calibration with its first effect, its first two, ... and all."""
        effects = self.faults.effects
        return [
            replace(self, faults=self.faults.model_copy(update={"effects": effects[:count]}))
            for count in range(1, len(effects) + 1)
        ]


NO_CALIBRATION = LaboratoryCalibration()


def file_beside(data: Path) -> Path:
    """Default file of the calibration of measurements, in their folder.

    Args:
        data: Folder of the measurements, or one of its files.
    """
    return (data.parent if data.is_file() else data) / CALIBRATION


def calibration_of(data: Path, given: str | Path | None = None) -> LaboratoryCalibration:
    """The calibration of measurements; empty where there is no file.

    Args:
        data: Folder of the measurements, or one of its files.
        given: File to read in place of the default one; ``nominal`` has no effects.

    Raises:
        InputError: The file given is missing; it is no model file; it has an effect of the physics.
    """
    if given is None:
        return calibration_in(file_beside(data))
    return LaboratoryCalibration(check_faults(load_model(given), given), Path(given))


def calibration_in(file: Path) -> LaboratoryCalibration:
    """The calibration in a file; empty where there is none yet.

    Raises:
        InputError: It is no model file, or has an effect of the physics.
    """
    return LaboratoryCalibration(check_faults(load_model(file), file) if is_file(file) else NO_FAULTS, file)


def write_calibration(calibration: LaboratoryCalibration) -> None:
    """Write the file of a calibration; an earlier one is replaced at once.

    Raises:
        InputError: It cannot be written.
    """
    assert calibration.file is not None
    write_whole(calibration.file, model_text(calibration.faults))


def check_faults(model: Model, file: str | Path) -> Model:
    """Check that a calibration has effects of the measurement alone.

    Raises:
        InputError: It has an effect of the physics.
    """
    for number, item in enumerate(model.effects):
        if not model.effect_of(item).of_measurement:
            raise InputError(
                f"{item.name} is an effect of the physics, and a calibration has effects of the measurement alone: "
                "move it to the model file (--model)",
                file=file,
                key=f"effects.{number}.name",
            )
    return model


def with_intervals(source: Source, clusters: Sequence[Cluster]) -> tuple[Cluster, ...]:
    """Clusters with the systematic errors of the faults of readings in the model, by their intervals.

    Args:
        source: Predicts them.
        clusters: Its clusters, in order.
    """
    deviations = _deviations(source)
    if not deviations or not clusters:
        return tuple(clusters)
    moved = [
        source.differences(range(len(clusters)), (), added, "intervals of the calibration") for added in deviations
    ]
    before = max((0 if item.calibrations is None else len(item.calibrations) for item in clusters), default=0)
    extended = []
    for number, item in enumerate(clusters):
        systematic = np.zeros((before, item.sigma.size)) if item.calibrations is None else item.calibrations
        rows = [_moved(change[number], item.sigma) for change in moved]
        extended.append(replace(item, calibrations=np.vstack([systematic, *rows])))
    return tuple(extended)


def _moved(change: Array | None, sigma: Array) -> Array:
    """Change of scaled residuals by a change of features; 0 if these cannot be predicted."""
    return np.zeros((1, sigma.size)) if change is None else (-change / sigma)[None, :]


def _deviations(source: Source) -> list[Added]:
    """One standard deviation of every parameter with an interval, as an effect added to the model.

    Parameters of faults of the readings, and of the required effect (:attr:`Source.required`).
    """
    deviations: list[Added] = []
    declared = source.declared_model.effects
    for item in source.model.effects:
        effect = source.model.effect_of(item)
        if not effect.of_measurement and item in declared:
            continue
        scalars = effect.scalars(source.joints)
        for number, scalar in enumerate(scalars):
            value = item.parameters.get(scalar.name)
            if value is None or value.ci95 is None or value.ci95[0] == value.ci95[1]:
                continue
            vector = [s.nominal for s in scalars]
            vector[number] += (value.ci95[1] - value.ci95[0]) / (2.0 * NORMAL_95)
            deviations.append(((item.name, tuple(vector)),))
    return deviations
