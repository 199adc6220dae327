# SPDX-License-Identifier: Apache-2.0
"""A short trial, for tests that look at its end alone."""

from __future__ import annotations

import pytest

from impact_rs_sim.scenarios.scenario_files import load_scenario


@pytest.fixture(scope="session")
def short(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Path of a push of less than half the length."""
    scenario = load_scenario("push")
    timing = {"nominal_impact": 0.45, "approach": 0.4, "overrun": 0.1, "stop": 0.15, "push": 0.25, "slide": 0.1}
    changed = scenario.timing.model_copy(update=timing | {"window_after": 0.25, "duration": 0.8})  # s
    path = tmp_path_factory.mktemp("scenarios") / "short.yaml"
    path.write_text(scenario.model_copy(update={"timing": changed}).model_dump_json(), encoding="utf-8")
    return str(path)
