# SPDX-License-Identifier: Apache-2.0
"""What ``impact-rs up`` prints: commands that the nodes answer."""

from __future__ import annotations

import re
import signal
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import pytest
import yaml

from impact_rs_cli.commands.up import up
from impact_rs_ros.graph import Graph
from impact_rs_ros.roots import scenario_below
from impact_rs_sim.paths import config_directory


@pytest.mark.parametrize("name", ["push", "my_push"])
def test_the_printed_requests_are_for_the_scenario_of_the_nodes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    """Kills: the key ``name`` of the scenario, which the nodes take for a shipped one, or refuse."""
    scenario = tmp_path / "mine.yaml"
    text = (config_directory() / "scenarios" / "push.yaml").read_text()
    scenario.write_text(text.replace("name: push\n", f"name: {name}\n"))
    graph = SimpleNamespace(
        processes=[], foreign=[], replace_lost=list, spin=lambda _: signal.raise_signal(signal.SIGINT)
    )
    monkeypatch.setattr(Graph, "running", lambda *arguments, **options: nullcontext(graph))
    assert up(str(scenario)) == 0
    goal, request = (yaml.safe_load(line) for line in re.findall(r'^ +"({.*})"$', capsys.readouterr().out, re.M))
    for fields in (goal, request["problem"]):
        assert scenario_below(fields.get("scenario", ""), str(scenario), str(tmp_path)) == str(scenario)
        assert (fields["object_name"], fields["case_name"]) == ("parcel", "case_1")
