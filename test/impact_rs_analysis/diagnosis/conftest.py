# SPDX-License-Identifier: Apache-2.0
"""Lets the tests of this folder import the world they share, and draws fewer null statistics than a diagnosis does."""

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from impact_rs_analysis.diagnosis import drift
from impact_rs_analysis.diagnosis.search import null_distribution

sys.path.insert(0, str(Path(__file__).parent))
FEW, FEW_SIGNS = 999, 9999


@pytest.fixture(autouse=True, scope="module")
def few_draws(request: pytest.FixtureRequest) -> Iterator[None]:
    """999 draws in place of 4,999, and of signs 9,999 in place of 49,999: p values are as right, only coarser.

    Laws are many, and what is one of many has to be rare: their tests draw as many as a discovery does.
    """
    with pytest.MonkeyPatch.context() as patched:
        if "discover" not in request.module.__name__:
            patched.setattr(null_distribution, "NULL_DRAWS", FEW)
            patched.setattr(null_distribution, "MANY_SIGN_DRAWS", FEW_SIGNS)
            patched.setattr(drift, "NULL_DRAWS", FEW)
        null_distribution._rotations.cache_clear()
        null_distribution._signs.cache_clear()
        yield
    null_distribution._rotations.cache_clear()
    null_distribution._signs.cache_clear()
