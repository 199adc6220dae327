# SPDX-License-Identifier: Apache-2.0
"""Rotations as quaternions."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from impact_rs_sim.rotations import quaternion_of

PAGE = 4096  # bytes


@given(st.lists(st.floats(-4.0, 4.0), min_size=3, max_size=3))
def test_a_quaternion_is_the_rotation_it_was_made_from(turn: list[float]) -> None:
    rotation = pin.exp3(np.array(turn))
    quaternion = quaternion_of(rotation)
    assert quaternion @ quaternion == pytest.approx(1.0, abs=1e-12)
    np.testing.assert_allclose(pin.Quaternion(quaternion).matrix(), rotation, atol=1e-12)


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="needs Linux")
def test_making_quaternions_keeps_no_memory() -> None:
    """A trial makes a thousand of them; what each kept would add up over a campaign."""
    rotation = pin.exp3(np.array([0.1, 0.2, 0.3]))

    def resident() -> int:
        return int(Path("/proc/self/statm").read_text().split()[1]) * PAGE

    for _ in range(1000):
        quaternion_of(rotation)
    before, calls = resident(), 50_000
    for _ in range(calls):
        quaternion_of(rotation)
    assert resident() - before < 10 * calls  # bytes
