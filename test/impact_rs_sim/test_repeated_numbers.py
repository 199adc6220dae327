# SPDX-License-Identifier: Apache-2.0
"""One machine repeats a hit of the twin to the bit, a processor without fused multiply-add to nine digits."""

from __future__ import annotations

import os
import platform
import subprocess
import sys

import numpy as np
import pytest

HIT = """
import numpy as np
from impact_rs_sim.drive import DriveStart
from impact_rs_sim.impact_map import ImpactProblem
from impact_rs_sim.scenario import load_scenario
from impact_rs_sim.scene import Scene
from impact_rs_sim.twin import TwinJob, simulate

problem = ImpactProblem.at_nominal_impact(Scene.resolve(load_scenario("push"), "cat_food", "case_2"))
state, still, ticks = problem.arms["arm"], np.zeros(7), 400
job = TwinJob(
    problem.physics, problem.arms, {"arm": DriveStart(still, still)}, {"arm": still[None]},
    {"arm": np.zeros(ticks, dtype=np.int32)}, np.arange(ticks + 1) * 0.00025, 0.00025, object=problem.object,
)
(result,) = simulate([job])
assert result.contact_steps > 100
print(np.hstack((result.arms["arm"].velocity[-1], result.twists[-1])).tobytes().hex())
"""


def hit(**environment: str) -> bytes:
    """Velocities of joints and object after 0.1 s, from a process of its own."""
    run = [sys.executable, "-c", HIT]
    done = subprocess.run(run, env=os.environ | environment, capture_output=True, text=True, check=True)
    return bytes.fromhex(done.stdout.split()[-1])


@pytest.mark.skipif(platform.machine() != "x86_64" or platform.libc_ver()[0] != "glibc", reason="glibc chooses on x86")
def test_another_processor_has_the_numbers_of_this_one_to_nine_digits() -> None:
    here = hit()
    assert hit() == here
    plain = np.frombuffer(hit(GLIBC_TUNABLES="glibc.cpu.hwcaps=-FMA,-FMA4,-AVX2,-AVX2_Usable"))
    velocities = np.frombuffer(here)
    np.testing.assert_allclose(plain, velocities, rtol=0.0, atol=1e-9 * np.max(np.abs(velocities)))
