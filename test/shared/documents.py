# SPDX-License-Identifier: Apache-2.0
"""Documents of comparisons and diagnoses: with everything that a page may show, and with as little as they may hold."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from impact_rs_analysis.diagnosis.compare import ComparisonDocument
from impact_rs_analysis.diagnosis.document import DiagnosisDocument, EffectDocument, EstimateDocument, ModelIdentity
from impact_rs_analysis.diagnosis.history import Version, VersionError
from impact_rs_analysis.diagnosis.verdict import DiagnosisVerdict
from impact_rs_analysis.evidence.rollouts import JointRollout, RolloutDocument, RolloutHorizon
from impact_rs_analysis.evidence.tracks import ComparedSignal, Track
from impact_rs_sim.effects.formula import FormulaSpec
from impact_rs_sim.model import load_model

FOLDER = Path(__file__).with_suffix("")
OLD_DIAGNOSIS = FOLDER / "diagnosis_0_1_0.json"  # as version 0.1.0 wrote it


def comparison(name: str = "trials") -> ComparisonDocument:
    """A comparison: of ``trials``, ``recordings``, two ``arms`` of different kinds, or ``minimal``."""
    return ComparisonDocument.model_validate(_content(f"comparison_{name}"))


def diagnosis(name: str = "trials") -> DiagnosisDocument:
    """A diagnosis: the same names, and one with verdicts on the ``joints`` of a single arm."""
    return DiagnosisDocument.model_validate(_content(f"diagnosis_{name}"))


def tied_laws() -> DiagnosisDocument:
    """A diagnosis of the nominal model, with two laws of a discovery that explain the trials equally well."""
    drag = FormulaSpec.model_validate(
        {
            "name": "object_drag",
            "sentence": "Drag.",
            "object_force": {"y": "-drag * object_vy"},
            "parameters": {"drag": {"unit": "N s/m", "nominal": 0.0, "lower": 0.0, "upper": 50.0, "scale": 1.0}},
        }
    )
    cube = drag.model_copy(update={"name": "object_drag_cube", "object_force": {"y": "-drag * object_vy**3"}})
    effects = tuple(
        EffectDocument(
            name=one.name,
            verdict=f"CONFUSABLE-WITH{{{other.name}}}",
            rivals=(other.name,),
            parameters={"drag": EstimateDocument(estimate=5.0, ci95=(4.0, 6.0), unit="N s/m", nominal=0.0)},
            held_out_error_before=9.0,
            held_out_error_after=1.0,
            p_value=0.001,
        )
        for one, other in ((drag, cube), (cube, drag))
    )
    model = load_model("nominal")
    update = {
        "verdict": DiagnosisVerdict.parse(drag.name),
        "named": (drag.name,),
        "suspected": (),
        "effects": effects,
        "confusable": ((drag.name, cube.name),),
        "formulas": (drag, cube),
        "arms": {},
        "model": ModelIdentity(name=model.name, digest=model.digest),
    }
    return diagnosis().model_copy(update=update)


def _content(name: str) -> dict[str, Any]:
    """A stored document; those of arms and joints hold what differs from that of trials."""
    kind, _, which = name.partition("_")
    content = json.loads((FOLDER / f"{name}.json").read_text(encoding="utf-8"))
    return (_content(f"{kind}_trials") if which in ("arms", "joints") else {}) | content


def tracks() -> tuple[Track, ...]:
    """A trial with an impact and one without; samples are missing in one."""
    time = np.linspace(0.0, 1.8, 1801)
    gap = np.where(time > 1.0, np.nan, np.sin(time))
    hit = ComparedSignal("end-effector velocity y", "m/s", np.cos(time), gap)
    free = ComparedSignal("torque of joint 1", "N m", np.cos(time), np.sin(time))
    return Track("juice, case_2", time, 0.9, curves=(hit,)), Track("slow", time, curves=(free,))


def rollouts(share: float = 1.0) -> RolloutDocument:
    """Rollouts of one joint over two horizons, with so many times their errors."""
    horizons = tuple(
        RolloutHorizon(
            horizon_s=horizon,
            joints=(
                JointRollout(joint="joint1", error=size, spread=(0.4 * size, 1.6 * size), unit="deg", as_torque=0.1),
            ),
            tool_mm=6.0 * size,
            tool_spread_mm=(2.4 * size, 9.6 * size),
            tool_deg=2.0 * size,
            tool_spread_deg=(0.8 * size, 3.2 * size),
        )
        for horizon, size in ((0.1, 0.1 * share), (0.5, 2.5 * share))
    )
    time = (0.02, 0.1, 0.3, 0.5)
    return RolloutDocument(
        starts=40,
        starts_apart=12,
        horizons=horizons,
        growth="power",
        exponent=2.0,
        rate_per_s=6.0,
        time_s=time,
        tool_mm=tuple(60.0 * share * moment**2 for moment in time),
    )


def versions() -> list[VersionError]:
    """Errors of a model and of its parent, which have one name."""
    nominal = load_model("nominal")
    return [
        VersionError(Version("nominal.yaml", nominal, ()), 61.8, 61.8, 1.0),
        VersionError(Version("model_2.yaml", nominal, ("object_mass",)), 1.4, 2.25, 1.0),
    ]
