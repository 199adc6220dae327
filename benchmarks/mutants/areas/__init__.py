# SPDX-License-Identifier: Apache-2.0
"""Mutants by area, one module each."""

from mutant import Mutant

from areas import (
    cell,
    controller,
    detection,
    diagnosis,
    drive,
    effects,
    fit,
    impact_map,
    net_feedback,
    outcome,
    plant,
    recordings,
    references,
    replay,
    robots,
    workbench,
)

AREAS: dict[str, list[Mutant]] = {
    "detection": detection.MUTANTS,
    "controller": controller.MUTANTS,
    "references": references.MUTANTS,
    "drive": drive.MUTANTS,
    "plant": plant.MUTANTS,
    "effects": effects.MUTANTS,
    "impact_map": impact_map.MUTANTS,
    "outcome": outcome.MUTANTS,
    "net_feedback": net_feedback.MUTANTS,
    "fit": fit.MUTANTS,
    "diagnosis": diagnosis.MUTANTS,
    "replay": replay.MUTANTS,
    "robots": robots.MUTANTS,
    "workbench": workbench.MUTANTS,
    "recordings": recordings.MUTANTS,
    "cell": cell.MUTANTS,
}
