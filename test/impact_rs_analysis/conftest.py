# SPDX-License-Identifier: Apache-2.0
"""Where the tests of imports find the recording of a real robot."""

from __future__ import annotations

from pathlib import Path

import pytest
from measured_data import measured_data


@pytest.fixture(scope="session")
def real_bag() -> Path:
    """A Franka Panda in free motion (UNISA Automatic Control Group, inverse-dynamics-solver, BSD-3-Clause)."""
    return measured_data("unisa_panda", "panda_exciting_trajectory.db3")
