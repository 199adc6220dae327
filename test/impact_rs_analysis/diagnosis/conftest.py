# SPDX-License-Identifier: Apache-2.0
"""Lets the tests of this folder import the world they share, and draws fewer null statistics than a diagnosis does."""

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from impact_rs_analysis.diagnosis import null_distribution

sys.path.insert(0, str(Path(__file__).parent))


@pytest.fixture
def few_draws(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """999 draws in place of 4999: p values are as right, only coarser."""
    monkeypatch.setattr(null_distribution, "DRAWS", 999)
    null_distribution._frames.cache_clear()
    yield
    null_distribution._frames.cache_clear()
