# SPDX-License-Identifier: Apache-2.0
"""What a caller relies on who fills in no more than he must: constants, and defaults that mean the scenario's."""

from __future__ import annotations

import pytest

from impact_msgs_py import ComputeImpactMap, FinishTrial, RunTrial
from impact_rs_trials.bags.trial_info import OUTCOMES


@pytest.mark.parametrize("kind", [FinishTrial.Response, RunTrial.Result])
def test_every_outcome_has_a_constant(kind: type) -> None:
    values = {name: getattr(kind, f"OUTCOME_{name.replace('-', '_')}") for name in OUTCOMES}
    assert values == {name: name for name in OUTCOMES}


def test_a_restitution_that_is_not_given_is_the_scenarios_and_not_zero() -> None:
    assert ComputeImpactMap.Request().restitution < 0.0


def test_a_velocity_scale_that_is_not_given_is_that_of_the_prediction_and_not_zero() -> None:
    assert RunTrial.Goal().velocity_scale == 1.0
