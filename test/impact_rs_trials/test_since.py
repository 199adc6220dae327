# SPDX-License-Identifier: Apache-2.0
"""``--since``: what was measured from a run, a row, or a time on."""

import pytest

from impact_rs_sim.errors import InputError
from impact_rs_trials.since import measured_since

NOON = 1_764_154_800.0  # 2025-11-26 11:00 UTC
RUNS = {"push/a": NOON, "push/c": NOON + 60.0, "push/b": NOON + 60.0, "push/d": NOON + 120.0}


@pytest.mark.parametrize(
    ("when", "found"),
    [
        ("push/a", "abcd"),
        ("push/b", "bcd"),  # c was measured at the same time
        ("2025-11-26T11:01:30+00:00", "d"),
        (str(NOON + 1.0), "bcd"),
    ],
)
def test_a_name_or_a_time_is_a_moment(when: str, found: str) -> None:
    assert measured_since(when, RUNS) == {f"push/{letter}" for letter in found}


def test_a_moment_without_measurements_is_named_with_what_there_is() -> None:
    with pytest.raises(InputError, match="did you mean 'push/a'"):
        measured_since("pushs/a", RUNS)
    with pytest.raises(InputError, match="nothing was measured since then; the last is 'push/d'"):
        measured_since("2030-01-01", RUNS)
    with pytest.raises(InputError, match="expected a name, for example 'row 2'$"):
        measured_since("2", {"row 1": 1.0, "row 2": 2.0}, timed=False)
