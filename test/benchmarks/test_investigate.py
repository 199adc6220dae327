# SPDX-License-Identifier: Apache-2.0
"""The board of investigations hides what the plant knows."""

from __future__ import annotations

from benchmarks import investigate
from impact_rs_sim import unmodelled


def test_its_laws_are_laws_of_the_plant() -> None:
    assert set(investigate.LAWS) <= set(unmodelled.LAWS)
