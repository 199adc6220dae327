# SPDX-License-Identifier: Apache-2.0
"""Packages of evidence with chosen estimates."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import Any

from impact_rs_analysis.diagnosis.document import DiagnosisDocument
from impact_rs_analysis.sharing.evidence_package import EvidencePackage, FileDigest
from impact_rs_sim.model import load_model
from impact_rs_sim.numbers import NORMAL_95


def diagnosis_of(estimates: Mapping[str, tuple[float, float]], **changes: Any) -> DiagnosisDocument:
    """A diagnosis that confirms one effect ``law`` per parameter, with estimates and standard errors."""
    model = load_model("nominal")
    effects = [
        {
            "name": name,
            "verdict": "CONFIRMED",
            "parameters": {
                "size": {
                    "estimate": value,
                    "ci95": [value - NORMAL_95 * error, value + NORMAL_95 * error],
                    "unit": "N m",
                }
            },
            "held_out_error_before": 2.0,
            "held_out_error_after": 1.0,
            "p_value": 0.001,
        }
        for name, (value, error) in estimates.items()
    ]
    content = {
        "verdict": "+".join(estimates),
        "named": tuple(estimates),
        "effects": effects,
        "confusable": (),
        "model": {"name": model.name, "digest": model.digest},
        "runs": {"digest": "", "trials": 9, "conditions": ("a",)},
        "noise_floor": 1.0,
        "held_out_error_before": 2.0,
        "held_out_error_after": 1.0,
    }
    return DiagnosisDocument.model_validate(content | changes)


def package_of(
    laboratory: str,
    estimates: Mapping[str, tuple[float, float]],
    robot: str = "arm",
    object_name: str = "box",
    data: tuple[FileDigest, ...] = (),
    **changes: Any,
) -> EvidencePackage:
    """A sealed package; without ``data`` of measurements of its own."""
    return EvidencePackage(
        laboratory=laboratory,
        robot=robot,
        object=object_name,
        versions={"impact_rs": "0"},
        model=load_model("nominal"),
        diagnosis=diagnosis_of(estimates, **changes),
        data=data or (file_of(f"{laboratory} {robot} {object_name}"),),
    ).sealed()


def file_of(content: str, size: int = 1000) -> FileDigest:
    """A file of measurements; files of one content have one digest."""
    return FileDigest(path="runs/one.mcap", size=size, sha256=hashlib.sha256(content.encode()).hexdigest())
