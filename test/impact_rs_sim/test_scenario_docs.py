# SPDX-License-Identifier: Apache-2.0
"""The page about scenario files follows from the schema."""

import re
from pathlib import Path

import pytest

from impact_rs_sim.scenario import Gains, Scenario, Timing
from impact_rs_sim.scenario_docs import markdown

PAGE = Path(__file__).resolve().parents[2] / "docs" / "scenarios.md"


def test_the_page_is_up_to_date() -> None:
    assert PAGE.read_text(encoding="utf-8") == markdown(), (
        "run: python -m impact_rs_sim.scenario_docs > docs/scenarios.md"
    )


@pytest.mark.parametrize("schema", [Timing, Gains])
def test_every_number_has_a_unit(schema: type) -> None:
    for name, field in schema.model_fields.items():
        assert re.search(r"\[.+\]", field.description), f"{name} has no unit"


def test_every_key_of_the_scenario_stands_on_the_page() -> None:
    text = markdown()
    for name in Scenario.model_fields:
        assert f"`{name}" in text, name
