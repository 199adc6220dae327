# SPDX-License-Identifier: Apache-2.0
"""The board of investigations hides what the plant knows."""

from __future__ import annotations

from benchmarks import discovery, investigate
from impact_rs_sim import unmodelled


def test_its_laws_are_laws_of_the_plant() -> None:
    assert set(investigate.LAWS) <= set(unmodelled.LAWS)


def test_it_knows_which_discoveries_of_its_laws_are_right() -> None:
    assert set(investigate.LAWS) <= set(discovery.RIGHT)
