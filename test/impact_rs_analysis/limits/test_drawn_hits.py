# SPDX-License-Identifier: Apache-2.0
"""What a hit does to an arm, by the twin and by MuJoCo."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("mujoco")

from benchmarks.accuracy.limits import hit  # noqa: E402
from impact_rs_analysis.limits.drawn_hits import JUMP_SHARES, Hits, drawn, touching  # noqa: E402
from impact_rs_analysis.limits.hit_bounds import Thresholds  # noqa: E402
from impact_rs_sim.proportion import reach_of  # noqa: E402
from impact_rs_sim.scenarios.scenario_files import load_scenario  # noqa: E402
from impact_rs_sim.scene import Scene  # noqa: E402


@pytest.mark.parametrize("name", ["push_fr3", "push_ur5e"])
def test_two_simulators_agree_on_what_a_hit_does_to_the_arm(name: str) -> None:
    """Largest velocity, torque, external torque and force within 10 %, jumps within 3 times their discrepancy."""
    scene = Scene.resolve(load_scenario(name), "juice", "1")
    hits = Hits(scene, Thresholds())
    twin, mujoco_ = hits.values(1.0)[0], hit(scene, *drawn(touching(scene), scene.models, {}, scene.physics.arms))
    kinds = np.array(hits.bounds.kinds)
    for kind in ("speed", "torque", "reflex", "force"):
        largest = int(np.argmax(np.where(kinds == kind, twin, 0.0)))
        assert mujoco_[largest] == pytest.approx(twin[largest], rel=0.1), kind
    jumps, (arm,) = kinds == "jump", scene.physics.arms.values()
    off = JUMP_SHARES[hits.kind] * hits.speed / reach_of(arm.facts)
    np.testing.assert_allclose(mujoco_[jumps], twin[jumps], atol=3.0 * off)
