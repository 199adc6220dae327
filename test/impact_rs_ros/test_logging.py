# SPDX-License-Identifier: Apache-2.0
"""A node says what it does: with which parameters it is ready, which trial it has, and how that ended."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from impact_rs.action import RunTrial

from impact_rs_ros.graph import Graph, run_trial
from impact_rs_ros.node_processes import NODES
from impact_rs_trials.campaign import make_manifest


def test_nodes_tell_their_parameters_and_the_way_of_a_trial(
    domain_ids: Callable[[], int], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    manifest = make_manifest("push", ["cat_food"], ["1"], [1.0], trials=1, seed=7)
    (key,) = manifest.keys
    with Graph.running("push", domain_ids(), quiet=False, root=tmp_path) as graph:
        report = run_trial(graph, tmp_path, manifest, key)
        refused = graph.call_trial(RunTrial.Goal(scenario="push", object_name="dog_food", case_name="1"))
    assert (report.outcome, refused.outcome) == ("OK", "ABORTED")
    told = "".join(capfd.readouterr())
    for node in NODES:
        assert f"[{node}]: ready: scenario push, config_root {tmp_path}, diagnostics_period 1.0 s" in told
    assert "diagnostics_period 1.0 s, realtime False, repeat_after 0.25 s" in told
    for node in ("plant", "controller"):
        assert f"[{node}]: configured push/{key.name}, seed {key.seed(7)}" in told
        assert f"[{node}]: finished push/{key.name}: OK" in told
    assert f"[recorder]: recorded {tmp_path / key.name}: OK" in told
    assert f"[experiment]: ended {key.name}: OK after" in told
    (line,) = (line for line in told.splitlines() if "dog_food" in line)
    assert line.startswith("[ERROR]")
    assert line.endswith("did you mean 'cat_food'?")
