# SPDX-License-Identifier: Apache-2.0
"""A recorded push for the tests of bags."""

from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def push_bag(push_campaign: Path) -> Path:
    """Copy it before you change it."""
    return push_campaign / "cat_food__case_2__s1.000__r0"
