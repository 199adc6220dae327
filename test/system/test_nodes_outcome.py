# SPDX-License-Identifier: Apache-2.0
"""A trial that goes wrong through the nodes ends early, is recorded, and has the outcome of one process."""

from __future__ import annotations

from pathlib import Path

import pytest

from impact_rs_ros.graph import Graph, run_trial
from impact_rs_sim.paths import config_directory
from impact_rs_trials.bags.reader import TrialBag
from impact_rs_trials.campaign import make_manifest, run_one


def test_a_plant_that_blows_up_has_its_reason_through_the_nodes_too(
    graph: Graph, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shipped = (config_directory() / "scenarios" / "push.yaml").read_text(encoding="utf-8")
    light = tmp_path / "light.yaml"
    light.write_text(shipped.replace("facts: franka_fer", "facts: franka_fr3"), encoding="utf-8")
    manifest = make_manifest(str(light), ["cat_food"], ["2"], [1.0], trials=1)
    key = manifest.keys[0]
    told = run_one(tmp_path / "inprocess", manifest.trial(key))
    answers = []
    monkeypatch.setattr(
        graph, "call_trial", lambda goal, call=graph.call_trial: answers.append(call(goal)) or answers[-1]
    )
    report = run_trial(graph, tmp_path / "nodes", manifest, key)
    assert [(answer.success, answer.outcome) for answer in answers] == [(False, "DIVERGED")]  # and it is not run again
    assert (report.outcome, report.message) == (told.outcome, told.message)
    assert (report.outcome, report.message[:13]) == ("DIVERGED", "arm joint7 at")
    bag = TrialBag.open(tmp_path / "nodes" / key.name)
    assert (bag.outcome, bag.reason) == (report.outcome, report.message)
    assert bag.counts == TrialBag.open(tmp_path / "inprocess" / key.name).counts | {
        topic: count for topic, count in bag.counts.items() if topic == "/diagnostics" or topic == "/truth/model"
    }
