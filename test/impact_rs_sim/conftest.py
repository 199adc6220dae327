# SPDX-License-Identifier: Apache-2.0
"""What the tests of this folder share: cases that they import, and the push of a can."""

import sys
from pathlib import Path

import pytest
from trials import nominal_physics, scene_of

from impact_rs_sim.physics import Physics
from impact_rs_sim.scene import Scene

sys.path.insert(0, str(Path(__file__).parent))


@pytest.fixture(scope="session")
def physics() -> Physics:
    return nominal_physics()


@pytest.fixture(scope="session")
def scene() -> Scene:
    return scene_of("push", "cat_food", "2")
