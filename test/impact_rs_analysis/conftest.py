# SPDX-License-Identifier: Apache-2.0
"""Where the tests of imports find the recording of a real robot."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

REAL_BAG = Path("unisa_panda") / "panda_exciting_trajectory.db3"


@pytest.fixture(scope="session")
def real_bag() -> Path:
    """A Franka Panda in free motion (UNISA Automatic Control Group, inverse-dynamics-solver, BSD-3-Clause).

    Looked for in ``$IMPACT_RS_TEST_DATA`` and in the folders ``data`` beside the repository; skipped where absent.
    """
    override = os.environ.get("IMPACT_RS_TEST_DATA")
    around = Path(__file__).resolve().parents[3]
    places = [Path(override)] if override else sorted(around.glob("*/data"))
    for place in places:
        if (place / REAL_BAG).is_file():
            return place / REAL_BAG
    pytest.skip(f"{REAL_BAG} is not here; set IMPACT_RS_TEST_DATA to the folder that holds it")
