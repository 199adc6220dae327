# SPDX-License-Identifier: Apache-2.0
"""Faults of the readings named by a diagnosis, in words, and experiments that calibrate them.

Example: "joint 2 reads 0.51 degrees too much [0.50, 0.52] (encoder_offset)". The clause of the effect
(:attr:`Effect.reading`) with the size of the fault in laboratory units; terminal, report and workbench use one text.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from impact_rs_analysis.diagnosis.document import (
    CalibrationExperiment,
    DiagnosisDocument,
    EffectDocument,
    EstimateDocument,
)
from impact_rs_analysis.diagnosis.verdict import CONFIRMED, IMPOSSIBLE, NONE, TOO_FEW
from impact_rs_sim.effects import Effect
from impact_rs_sim.numbers import estimate_text

SHOWN_AS = {  # unit: factor and displayed unit; a number without unit is shown in percent
    "rad": (180.0 / math.pi, "degrees"),
    "rad/s": (180.0 / math.pi, "degrees/s"),
    "s": (1e3, "ms"),
    "m": (1e3, "mm"),
    "-": (100.0, "%"),
}
DIRECTIONS = {"more": ("too much", "too little"), "late": ("late", "early")}  # above nominal, and below


def with_readings(documents: Sequence[EffectDocument], effects_by_name: Mapping[str, Effect]) -> list[EffectDocument]:
    """Documents of effects, completed with the clauses on faults of readings.

    Args:
        documents: Documents of all effects.
        effects_by_name: Effects by name.
    """
    completed = []
    for document in documents:
        effect = effects_by_name.get(document.name)
        if effect is not None and effect.of_measurement:
            fields = {"of_measurement": True, "reading": effect.reading, "calibration": effect.calibration}
            document = document.model_copy(update=fields)
        completed.append(document)
    return completed


def measurement_of(document: DiagnosisDocument) -> str:
    """Sentence on the named faults of readings; empty: no fault is named."""
    if not document.faults or document.verdict in (NONE, TOO_FEW, IMPOSSIBLE):
        return ""
    effects = [effect for effect in document.effects if effect.name in document.faults]
    clauses = [f"{'; '.join(clauses_of(effect))} ({effect.name})" for effect in effects]
    return f"The measurement: {'; '.join(clauses)}."


def clauses_of(effect: EffectDocument) -> list[str]:
    """Clauses on the fault of a reading: confirmed joints, or else joints whose interval excludes nominal.

    Args:
        effect: An effect of the measurement, with its estimates.
    """
    plain = effect.name.replace("_", " ")
    if not effect.parameters:
        return [plain]
    confirmed = {name: value for name, value in effect.parameters.items() if value.verdict == CONFIRMED}
    shown = confirmed or {name: value for name, value in effect.parameters.items() if value.excludes_nominal}
    if not shown:
        name, value = max(effect.parameters.items(), key=lambda item: abs(_fault(item[1])) / (item[1].scale or 1.0))
        shown = {name: value}
    by_place: dict[tuple[str | None, str | None], dict[str, EstimateDocument]] = {}
    for name, value in shown.items():
        by_place.setdefault((value.arm, value.joint), {})[name] = value
    several = len(effect.parameters) > len({(value.arm, value.joint) for value in effect.parameters.values()})
    return [_clause(effect.reading, plain, values, several) for values in by_place.values()]


def experiments_of(document: DiagnosisDocument) -> tuple[CalibrationExperiment, ...]:
    """Experiments that determine the named, tied or suspected faults of readings."""
    tied = [name for group in document.confusable for name in group]
    names = dict.fromkeys([*document.named, *tied, *document.suspected, *document.within_discrepancy])
    effects = [effect for name in names if (effect := document.effect(name)) is not None]
    return tuple(
        CalibrationExperiment(effect=effect.name, experiment=effect.calibration)
        for effect in effects
        if effect.calibration
    )


def calibration_text(experiment: CalibrationExperiment) -> str:
    """An experiment for a fault of a reading, in one line."""
    return f"to calibrate {experiment.effect}: {experiment.experiment}"


def _fault(value: EstimateDocument) -> float:
    """Size of the fault: estimate minus the value at which the reading is right."""
    return value.estimate - (value.nominal or 0.0)


def _clause(reading: str, plain: str, values: Mapping[str, EstimateDocument], several: bool) -> str:
    """The clause on one joint or arm, with the sizes of its parameters."""
    first = next(iter(values.values()))
    joint = "" if first.joint is None else first.joint.replace("joint", "joint ")
    if first.arm:
        joint = f"{joint} of {first.arm}" if joint else first.arm
    if several:
        size = ", ".join(f"{_called(name, value)} {' '.join(_size(value))}" for name, value in values.items())
        return (reading or f"{{joint}} {plain}: {{size}}").format(joint=joint, size=size, more="", late="").strip()
    absolute = any(f"{{{key}}}" in reading for key in DIRECTIONS)
    size, interval = _size(first, absolute)
    directions = {key: words[_fault(first) < 0.0] for key, words in DIRECTIONS.items()}
    template = reading or f"{{joint}} {first.meaning or plain}: {{size}}"
    return f"{template.format(joint=joint, size=size, **directions)} {interval}".strip()


def _called(name: str, value: EstimateDocument) -> str:
    """Name of a parameter without its joint and arm."""
    return name.removesuffix(f"_{value.joint}").removesuffix(f"_{value.arm}").replace("_", " ")


def _size(value: EstimateDocument, absolute: bool = False) -> tuple[str, str]:
    """Size of a fault with its unit, and its interval in the same unit; empty: without interval."""
    factor, unit = SHOWN_AS.get(value.unit, (1.0, value.unit))
    fault, nominal = _fault(value), value.nominal or 0.0
    if absolute and fault < 0.0:
        factor = -factor
    low, high = sorted(factor * (end - nominal) for end in value.interval)
    number, *ends = estimate_text(factor * fault, (low, high) if value.ci95 is not None else None)
    return f"{number} {unit}", f"[{', '.join(ends)}]" if ends else ""
