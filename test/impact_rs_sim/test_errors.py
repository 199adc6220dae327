# SPDX-License-Identifier: Apache-2.0
"""Mistakes of a user say where they are and what to change."""

from impact_rs_sim.errors import InputError, UnreachablePose


def test_a_mistake_keeps_its_kind_key_and_value_when_its_file_gets_known() -> None:
    found = UnreachablePose("expected a pose within reach [m]", key="cases.case_1", value=3.0).in_file("push.yaml")
    assert type(found) is UnreachablePose
    assert str(found) == "push.yaml: cases.case_1 = 3.0: expected a pose within reach [m]"
    assert (found.key, found.value) == ("cases.case_1", 3.0)


def test_where_no_file_is_known_none_is_named() -> None:
    assert str(InputError("expected a number > 0 [-]", key="trials")) == "trials: expected a number > 0 [-]"
