# SPDX-License-Identifier: Apache-2.0
"""Packages of evidence with chosen estimates."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from impact_rs_analysis.diagnosis.document import DiagnosisDocument
from impact_rs_analysis.sharing.evidence_package import EvidencePackage, FileDigest
from impact_rs_sim.model import load_model

NORMAL = 1.959964
DIGEST = "0" * 64


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
                    "ci95": [value - NORMAL * error, value + NORMAL * error],
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
    **changes: Any,
) -> EvidencePackage:
    """A sealed package."""
    return EvidencePackage(
        laboratory=laboratory,
        robot=robot,
        object=object_name,
        versions={"impact_rs": "0"},
        model=load_model("nominal"),
        diagnosis=diagnosis_of(estimates, **changes),
        data=(FileDigest(path="a", size=0, sha256=DIGEST),),
    ).sealed()
