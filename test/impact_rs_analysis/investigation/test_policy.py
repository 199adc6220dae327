# SPDX-License-Identifier: Apache-2.0
"""The rules of an investigation: their order, and the manual that lists them."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from documents import diagnosis

from impact_rs_analysis.diagnosis.document import DiagnosisDocument
from impact_rs_analysis.diagnosis.verdict import NOTHING, TOO_FEW, DiagnosisVerdict
from impact_rs_analysis.investigation.policy import POLICY, rule_for
from impact_rs_analysis.investigation.round_state import RoundState
from impact_rs_analysis.investigation.rounds import Round

MANUAL = Path(__file__).resolve().parents[3] / "docs" / "investigation.md"


def found(verdict: str | DiagnosisVerdict, **more: Any) -> DiagnosisDocument:
    """A diagnosis that suspects nothing."""
    return diagnosis().model_copy(update={"verdict": DiagnosisVerdict.parse(verdict), "suspected": (), **more})


def state(
    verdict: str | DiagnosisVerdict = "support_friction", suspected: tuple[str, ...] = (), **more: Any
) -> RoundState:
    """A round whose diagnosis confirms an effect of the first model, unless more is said."""
    document = found(verdict, suspected=suspected)
    plain = RoundState(
        round=Round(1, Path("unused"), "nominal", diagnosis=document),
        diagnosis=document,
        budget=60,
        remaining=54,
        models=0,
        added=frozenset(),
        laws_added=(),
        validated=False,
        holds=False,
        holds_twice=False,
        to_show=(),
        unexplained=False,
        laws=(),
        vain_discoveries=0,
        extension=(),
        reestimated=False,
        unconfirmed=(),
    )
    return replace(plain, **more)


LATER: dict[str, Any] = {"extension": ("object_mass",), "reestimated": True, "unconfirmed": ("support_friction",)}


@pytest.mark.parametrize(
    ("name", "situation"),
    [
        (
            "A look before the end",
            state(NOTHING, validated=True, holds=True, holds_twice=True, to_show=("object_mass",)),
        ),
        ("A look before the end", state(NOTHING, holds=True, holds_twice=True, to_show=("object_mass",))),
        ("A model that holds", state(NOTHING, validated=True, holds=True, holds_twice=True)),
        ("Too few repeats", state(TOO_FEW, to_show=("object_mass",), unexplained=True, **LATER)),
        ("Nothing missing, twice", state(NOTHING, holds=True, holds_twice=True, unexplained=True, **LATER)),
        ("Nothing missing, once", state(NOTHING, holds=True, to_show=("object_mass",), unexplained=True, **LATER)),
        ("A suspicion", state(NOTHING, ("object_mass",), unexplained=True, **LATER)),
        ("An error beyond noise", state(NOTHING, unexplained=True, **LATER)),
        ("An unexplained residual", state(unexplained=True, **LATER)),
        ("A small effect beside a large one", state(**LATER)),
        ("Estimates that were off", state(reestimated=True, unconfirmed=("support_friction",))),
        ("A tie", state(unconfirmed=("support_friction",))),
        ("Confirmed effects", state()),
    ],
)
def test_the_first_rule_that_applies_decides(name: str, situation: RoundState) -> None:
    """Each situation meets its rule and all later ones that can be met with it: any other order changes a row."""
    assert rule_for(situation).name == name


def test_the_manual_lists_the_rules_in_their_order() -> None:
    """A rule that is added, dropped or moved without its line in the manual is noticed."""
    section = MANUAL.read_text(encoding="utf-8").partition("## How it decides")[2].partition("\n## ")[0]
    listed = re.findall(r"^(\d+)\. \*\*([^*]+)\*\*", section, re.MULTILINE)
    assert listed == [(str(number), rule.name) for number, rule in enumerate(POLICY, start=1)]
