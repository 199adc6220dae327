# SPDX-License-Identifier: Apache-2.0
"""Hits in MuJoCo are those of the twin that speed limits are made of, and the benchmark counts what it says."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("mujoco")

from benchmarks.accuracy.limits import Outcome, hit, summary  # noqa: E402
from impact_rs_analysis.limits.drawn_hits import JUMP_SHARES, Hits, drawn, touching
from impact_rs_analysis.limits.hit_bounds import Thresholds
from impact_rs_sim.proportion import reach_of
from impact_rs_sim.scenario import load_scenario
from impact_rs_sim.scene import Scene


@pytest.mark.parametrize("name", ["push_fr3", "push_ur5e"])
def test_two_simulators_agree_on_what_a_hit_does_to_the_arm(name: str) -> None:
    """Largest velocity, torque, external torque and force within 10 %, jumps within 3 times their discrepancy."""
    scene = Scene.resolve(load_scenario(name), "juice", "1")
    hits = Hits(scene, Thresholds())
    twin, mujoco = hits.values(1.0)[0], hit(scene, *drawn(touching(scene), scene.models, {}, scene.physics.arms))
    kinds = np.array(hits.bounds.kinds)
    for kind in ("speed", "torque", "reflex", "force"):
        largest = int(np.argmax(np.where(kinds == kind, twin, 0.0)))
        assert mujoco[largest] == pytest.approx(twin[largest], rel=0.1), kind
    jumps, (arm,) = kinds == "jump", scene.physics.arms.values()
    off = JUMP_SHARES[hits.kind] * hits.speed / reach_of(arm.facts)
    np.testing.assert_allclose(mujoco[jumps], twin[jumps], atol=3.0 * off)


def test_missed_limits_and_needless_refusals_are_counted_apart() -> None:
    hits = [
        Outcome(0, 0.1, 0.2, 0.25, 0.5, "reflex"),  # allowed, and well
        Outcome(0, 0.1, 0.2, 0.25, 1.2, "reflex"),  # allowed, and beyond
        Outcome(0, 0.3, 0.2, 0.25, 0.9, "reflex"),  # refused, needlessly
        Outcome(0, 0.4, 0.2, 0.25, 1.9, "reflex"),  # refused, rightly
    ]
    assert [one.missed for one in hits] == [False, True, False, False]
    assert [one.needless for one in hits] == [False, False, True, False]
    assert summary("all", hits) == ("all", "4", "2", "2", "1", "1.20", "1 (25.0 %)", "50.0 %")
