# SPDX-License-Identifier: Apache-2.0
"""A blind investigation on the command line: what it hands to the loop, and the loop from beginning to end."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from impact_rs_analysis.application.plant_bench import PlantBench
from impact_rs_analysis.investigation.endings import Ending
from impact_rs_cli.main import main
from impact_rs_sim.model import load_model
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_trials.blind import Secret
from impact_rs_trials.experiment_plan import write_scenario

SEED, EFFECT = "0", "support_friction"
Document = Callable[..., dict[str, Any]]


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """Push and free motion with few conditions, so that little has to be rehearsed."""
    folder, push = tmp_path_factory.mktemp("scenarios"), load_scenario("push")
    few = {
        "objects": {name: push.objects[name] for name in ("parcel", "juice")},
        "cases": {"case_1": push.cases["case_1"]},
    }
    write_scenario(push.model_copy(update=few), folder / "push.yaml")
    excite = load_scenario("excite")
    write_scenario(excite.model_copy(update={"cases": {"fast": excite.cases["fast"]}}), folder / "excite.yaml")
    return [str(folder / "push.yaml"), str(folder / "excite.yaml")]


@pytest.fixture(scope="module")
def investigated(small: list[str], tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[str], list[str]]:
    """An investigation of a plant with more friction of the support; its command, and the files named truth it read."""
    directory = tmp_path_factory.mktemp("inquiry") / "inquiry"
    words = ["investigate", str(directory), "--blind", SEED, "--effect", EFFECT, "--effects", EFFECT, "object_mass"]
    words += ["--scenarios", *small, "--budget", "16", "--jobs", "1"]
    read: list[str] = []
    real = Path.read_text

    def spied(path: Path, *arguments: Any, **more: Any) -> str:
        read.append(path.name)
        return real(path, *arguments, **more)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Path, "read_text", spied)
        assert main(words) == 0
    return directory, words, read


@pytest.mark.slow
def test_the_loop_names_the_hidden_effect_with_fewer_trials_than_a_fixed_campaign(
    investigated: tuple[Path, list[str], list[str]], document: Document
) -> None:
    directory, _, read = investigated
    scored = document("blind", "score", directory)
    assert (scored["correct"], scored["surely_wrong"], scored["verdict"]) == (True, False, "EXPLAINED")
    assert scored["named"] == scored["truth"] == [EFFECT]
    assert scored["trials"] == len(list((directory / "runs").glob("*/*/*/metadata.yaml"))) < 18
    ending = json.loads((directory / "ending.json").read_text())
    (truth,) = json.loads((directory / "truth.json").read_text())["effects"]
    (item,) = load_model(directory / ending["model"]).effects
    friction = item.parameters["friction"]
    assert friction.estimate == pytest.approx(truth["parameters"]["friction"]["value"], rel=0.15)
    assert "truth.json" not in read  # it is written for blind score alone


@pytest.mark.slow
def test_the_same_command_after_the_end_measures_nothing_and_says_the_same(
    investigated: tuple[Path, list[str], list[str]], document: Document
) -> None:
    directory, words, _ = investigated
    before = {path: path.stat().st_mtime_ns for path in directory.rglob("*.mcap")}
    again = document(*words)
    assert (again["verdict"], again["effects"]) == ("EXPLAINED", [EFFECT])
    assert {path: path.stat().st_mtime_ns for path in directory.rglob("*.mcap")} == before


@pytest.mark.slow
def test_log_page_and_models_are_there(investigated: tuple[Path, list[str], list[str]]) -> None:
    directory, _, _ = investigated
    log = (directory / "log.md").read_text()
    assert all(
        word in log for word in ("## Round 1", "Design", "Prediction", "Comparison", "Diagnosis", "Decision", EFFECT)
    )
    page = (directory / "report" / "investigation.html").read_text()
    assert "Family tree of the models" in page and "model_2" in page


def test_the_command_hands_its_options_and_the_secret_of_its_seed_to_the_loop(
    document: Document, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Kills: a budget, a kind of bench or a secret that gets lost, a truth that the loop is given."""
    ending = Ending(verdict="NOTHING-MISSING", summary="", model="nominal", trials=6, rounds=1)
    loops: list[tuple[Any, ...]] = []

    class Loop:
        def __init__(self, *handed: Any) -> None:
            loops.append(handed)

        def run(self) -> Ending:
            return ending

    monkeypatch.setattr("impact_rs_cli.commands.investigate.Investigation", Loop)
    words = ("--blind", "3", "--effect", EFFECT, "--effects", EFFECT, "--scenarios", "push", "--budget", "9")
    found = document("investigate", tmp_path / "inquiry", *words, "--jobs", "1")
    ((directory, settings, budget, bench, *_),) = loops
    assert found == {**ending.model_dump(mode="json"), "directory": str(directory)}
    assert (directory, budget, settings.effects, settings.scenarios) == (tmp_path / "inquiry", 9, (EFFECT,), ("push",))
    hidden = Secret.drawn(3, "single", EFFECT).hidden
    assert type(bench) is PlantBench and bench.secret.hidden == hidden
    (truth,) = json.loads((directory / "truth.json").read_text())["effects"]
    assert truth["parameters"]["friction"]["value"] == hidden[0].values[0]
