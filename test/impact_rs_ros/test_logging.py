"""A node says what it does: with which parameters it is ready, which trial it has, and how that ended."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from impact_rs.action import RunTrial

from impact_rs_ros.graph import NODES, Graph

GOAL = {"scenario": "push", "object_name": "cat_food", "case_name": "1", "velocity_scale": 1.0, "repeat": 3}


def test_nodes_tell_their_parameters_and_the_way_of_a_trial(
    domain_ids: Callable[[], int], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    with Graph("push", domain_ids(), quiet=False) as graph:
        result = graph.call_trial(RunTrial.Goal(**GOAL, seed=7, output_directory=str(tmp_path)))
        refused = graph.call_trial(
            RunTrial.Goal(**(GOAL | {"object_name": "dog_food"}), output_directory=str(tmp_path))
        )
    assert (result.outcome, refused.outcome) == ("OK", "ABORTED")
    told = "".join(capfd.readouterr())
    name = "cat_food__case_1__s1.000__r3"
    for node in NODES:
        assert f"[{node}]: ready: scenario push, diagnostics_period 1.0 s" in told
    assert "[plant]: ready: scenario push, diagnostics_period 1.0 s, realtime False, repeat_after 0.25 s" in told
    for node in ("plant", "controller"):
        assert f"[{node}]: configured push/{name}, seed 7" in told
        assert f"[{node}]: finished push/{name}: OK" in told
    assert f"[recorder]: recorded {tmp_path / name}: OK" in told
    assert f"[experiment]: ended {name}: OK after" in told
    assert "[ERROR]" in told
    assert "no object 'dog_food'" in told
