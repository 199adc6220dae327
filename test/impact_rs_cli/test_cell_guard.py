# SPDX-License-Identifier: Apache-2.0
"""A cell under an investigation: what is asked, what is refused, and what a stop means. No robot is here."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import yaml
from trials import recorded

from impact_rs_analysis.application.plant_bench import PlantBench
from impact_rs_analysis.design.possible_trials import possible_trials
from impact_rs_analysis.investigation.rounds import PlannedTrial, WantedTrials, trials_of
from impact_rs_analysis.investigation.rule_design import rule_design
from impact_rs_analysis.investigation.settings import Settings
from impact_rs_cli import node_benches
from impact_rs_cli.cell_guard import CellGuard, SafetyStop
from impact_rs_cli.node_benches import CellBench, NodesBench
from impact_rs_cli.terminal import Terminal
from impact_rs_sim.errors import InputError
from impact_rs_sim.model import load_model
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_trials.blind import Secret
from impact_rs_trials.campaign import PlannedTrials, TrialReport
from impact_rs_trials.envelope import CellEnvelope
from impact_rs_trials.experiment_plan import ExperimentPlan, PlannedCampaign
from impact_rs_trials.spec import TrialSpec

ENVELOPE = CellEnvelope(scenarios=("push",), objects=("parcel", "juice"), speed=0.75, impulse=2.0)


def planned(*conditions: tuple[str, str, int]) -> list[PlannedTrial]:
    """Pushes: object, case, repeats."""
    listed = tuple(PlannedTrials(object=item, case=case, trials=count) for item, case, count in conditions)
    campaign = PlannedCampaign(folder="push", scenario="push", conditions=listed)
    plan = ExperimentPlan(
        model="nominal", model_digest="", aim="effects", method="fixed", budget=60, campaigns=(campaign,)
    )
    return trials_of(plan, "round_01")


class Operator:
    """Answers questions, and remembers them."""

    def __init__(self, *answers: bool, otherwise: bool = True) -> None:
        self.questions: list[str] = []
        self._answers, self._otherwise = list(answers), otherwise

    def __call__(self, question: str) -> bool:
        self.questions.append(question)
        return self._answers.pop(0) if self._answers else self._otherwise


class FakeCell:
    """The nodes with a cell: every trial has a given outcome, OK where none is given."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, outcomes: dict[str, str] | None = None) -> None:
        self.moved: list[str] = []
        self.repeated: list[bool] = []
        self.outcomes = outcomes or {}
        self.without: tuple[str, ...] = ()
        monkeypatch.setattr(node_benches, "run_trial", self._run)
        monkeypatch.setattr(node_benches.Graph, "running", self._running)

    @contextmanager
    def _running(self, scenario: str, without: tuple[str, ...] = (), **_: Any) -> Iterator[FakeCell]:
        self.without = without
        yield self

    def wait_until_ready(self) -> None:
        pass

    def _run(
        self, graph: Any, directory: Path, manifest: Any, key: Any, plant_model: Any, repeated: bool
    ) -> TrialReport:
        assert plant_model is None
        self.moved.append(key.name)
        self.repeated.append(repeated)
        outcome = self.outcomes.get(key.name, "OK")
        if outcome == "kill":
            raise KeyboardInterrupt
        return TrialReport(key, outcome)  # type: ignore[arg-type]


SETTINGS = Settings(scenarios=("push",), model_digest=load_model("nominal").digest, via="cell", envelope=ENVELOPE)


def bench(directory: Path, operator: Operator, brave: bool = False) -> CellBench:
    guard = CellGuard(directory, ENVELOPE, operator, brave)
    return CellBench(directory, SETTINGS, map, Terminal(as_json=True), guard)  # type: ignore[arg-type]


def test_every_new_kind_of_motion_is_asked_for_once_with_its_speed_and_impulse(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cell, operator = FakeCell(monkeypatch), Operator()
    bench(tmp_path, operator).measure(planned(("parcel", "case_1", 2), ("juice", "case_1", 1)))
    new = [question for question in operator.questions if question.startswith("New kind of motion")]
    assert [question.split(",")[0].split(": ")[1] for question in new] == ["push/parcel/case_1", "push/juice/case_1"]
    assert "up to 0.50 m/s, predicted impulse 0.28 N s" in new[0] or "up to 0.50 m/s" in new[0]
    assert len(cell.moved) == 3 and cell.without == ("plant",)
    again = Operator()
    bench(tmp_path, again).measure(planned(("parcel", "case_1", 1), ("juice", "case_2", 1)))
    assert [question for question in again.questions if "New kind" in question] == [
        question for question in again.questions if "push/juice/case_2" in question and "New kind" in question
    ]


def test_without_a_clear_yes_nothing_moves(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cell = FakeCell(monkeypatch)
    with pytest.raises(SafetyStop, match="was not approved; nothing was moved"):
        bench(tmp_path, Operator(False)).measure(planned(("parcel", "case_1", 1)))
    with pytest.raises(SafetyStop, match="was not started; nothing was moved"):
        bench(tmp_path, Operator(True, False)).measure(planned(("parcel", "case_1", 1)))
    assert cell.moved == []


def test_every_trial_waits_until_arm_and_object_are_in_their_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    FakeCell(monkeypatch)
    operator = Operator()
    trials = planned(("parcel", "case_1", 3))
    bench(tmp_path, operator).measure(trials)
    ready = [question for question in operator.questions if "in its place?" in question]
    assert len(ready) == 3
    start = trials[0].trial.spec.plan.arms["arm"].initial
    assert all(f"arm at [{start[0]:.4f}, " in question and "object parcel" in question for question in ready)


def test_yes_skips_both_questions_and_no_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cell, operator = FakeCell(monkeypatch), Operator(otherwise=False)
    bench(tmp_path, operator, brave=True).measure(planned(("parcel", "case_1", 1), ("parcel", "case_2", 1)))
    assert operator.questions == [] and len(cell.moved) == 2
    with pytest.raises(InputError, match="cat_food is not in the envelope"):
        bench(tmp_path, operator, brave=True).measure(planned(("cat_food", "case_1", 1)))
    assert len(cell.moved) == 2


def test_a_plan_with_one_trial_outside_the_envelope_moves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cell = FakeCell(monkeypatch)
    with pytest.raises(InputError, match="leaves the envelope"):
        bench(tmp_path, Operator()).measure(planned(("parcel", "case_1", 2), ("cat_food", "case_1", 1)))
    assert cell.moved == []


def test_a_trial_is_checked_again_just_before_it_runs(tmp_path: Path) -> None:
    (fast,) = planned(("parcel", "case_2", 1))
    narrow = CellGuard(tmp_path, ENVELOPE.model_copy(update={"speed": 0.6}), Operator())
    with pytest.raises(InputError, match="the envelope allows 0.6 m/s"):
        narrow.admit(fast)


def test_the_design_proposes_nothing_outside_the_envelope() -> None:
    """Slower than 0.6 m/s: no case 2; and no object that is not named."""
    settings = SETTINGS.model_copy(update={"envelope": ENVELOPE.model_copy(update={"speed": 0.6})})
    plan = rule_design(settings, WantedTrials(load_model("nominal"), [], None, 8, 0))
    proposed = {(one.object, one.case) for campaign in plan.campaigns for one in campaign.conditions}
    assert proposed and proposed <= {(item, case) for item in ("parcel", "juice") for case in ("case_1", "case_3")}
    nothing = SETTINGS.model_copy(update={"envelope": ENVELOPE.model_copy(update={"speed": 0.1})})
    with pytest.raises(InputError, match="no condition of these scenarios lies inside the envelope"):
        rule_design(nothing, WantedTrials(load_model("nominal"), [], None, 8, 0))


def test_a_design_within_the_documented_envelope_is_one(tmp_path: Path) -> None:
    """It chooses among the trials that the envelope allows, instead of a rule after one outside was chosen."""
    text = (Path(__file__).parents[2] / "docs" / "safety.md").read_text(encoding="utf-8")
    (block,) = (part for part in text.split("```") if part.lstrip().startswith("scenarios: [push]"))
    settings = Settings(
        scenarios=("push", "excite"),
        model_digest=load_model("nominal").digest,
        effects=("object_mass",),
        envelope=CellEnvelope.model_validate(yaml.safe_load(block)),
    )
    warned: list[str] = []
    terminal = Terminal(as_json=True)
    terminal.warn = warned.append  # type: ignore[method-assign]
    plan = PlantBench(tmp_path, settings, map, terminal).design(WantedTrials(load_model("nominal"), [], None, 8, 0))  # type: ignore[arg-type]
    assert (plan.method, plan.trials, warned) == ("design", 8, [])
    assert len(trials_of(plan, "")) == 8 and sum(len(one.conditions) for one in plan.campaigns) >= 3
    assert {one.object for campaign in plan.campaigns for one in campaign.conditions} <= {"parcel", "juice"}


def test_new_kinds_of_motion_begin_with_the_slowest(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cell = FakeCell(monkeypatch)
    bench(tmp_path, Operator()).measure(planned(("parcel", "case_2", 1), ("parcel", "case_1", 1)))
    assert [name.split("__")[1] for name in cell.moved] == ["case_1", "case_2"]


@pytest.mark.parametrize("outcome", ["ABORTED", "DIVERGED", "LIMIT", "INFEASIBLE", "NO-IMPACT", "EARLY", "TIPPED"])
def test_any_trial_that_does_not_go_as_planned_stops_and_is_not_repeated(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, outcome: str
) -> None:
    cell = FakeCell(monkeypatch, {"parcel__case_1__s1.000__r0": outcome})
    with pytest.raises(SafetyStop, match=f"stopped at .*: {outcome}"):
        bench(tmp_path, Operator()).measure(planned(("parcel", "case_1", 3)))
    assert cell.moved == ["parcel__case_1__s1.000__r0"] and cell.repeated == [False]


def test_after_a_stop_nothing_moves_until_it_is_answered_for_even_with_yes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cell = FakeCell(monkeypatch, {"parcel__case_1__s1.000__r0": "LIMIT"})
    with pytest.raises(SafetyStop):
        bench(tmp_path, Operator(), brave=True).measure(planned(("parcel", "case_1", 2)))
    refusing = Operator(otherwise=False)
    with pytest.raises(SafetyStop, match="LIMIT.*Nothing was moved"):
        bench(tmp_path, refusing, brave=True).measure(planned(("parcel", "case_1", 2)))
    assert len(cell.moved) == 1 and len(refusing.questions) == 1
    cell.outcomes = {}
    bench(tmp_path, Operator(), brave=True).measure(planned(("parcel", "case_1", 2)))
    assert len(cell.moved) == 3


def test_a_program_that_ends_in_a_trial_counts_as_a_stop(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cell = FakeCell(monkeypatch, {"parcel__case_1__s1.000__r0": "kill"})
    with pytest.raises(KeyboardInterrupt):
        bench(tmp_path, Operator()).measure(planned(("parcel", "case_1", 2)))
    assert "ended while this trial ran" in json.loads((tmp_path / "stopped.json").read_text())["reason"]
    with pytest.raises(SafetyStop, match="ended while this trial ran"):
        bench(tmp_path, Operator(False)).measure(planned(("parcel", "case_1", 2)))
    assert len(cell.moved) == 1


def test_a_damaged_note_of_a_stop_stops_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cell = FakeCell(monkeypatch)
    (tmp_path / "stopped.json").write_text("{")
    with pytest.raises(InputError, match="remove it when the cell is safe"):
        bench(tmp_path, Operator()).measure(planned(("parcel", "case_1", 1)))
    assert cell.moved == []


def test_no_terminal_is_no_answer(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    class Pipe:
        def isatty(self) -> bool:
            return False

        def readline(self) -> str:
            return "yes\n"

    monkeypatch.setattr("sys.stdin", Pipe())
    assert not Terminal(as_json=False).ask("May it run?")
    assert "no one to answer" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("answer", "agreed"),
    [("y\n", True), ("YES\n", True), ("\n", False), ("", False), ("no\n", False), ("yess\n", False)],
)
def test_only_a_clear_yes_is_one(monkeypatch: pytest.MonkeyPatch, answer: str, agreed: bool) -> None:
    class Screen:
        def isatty(self) -> bool:
            return True

        def readline(self) -> str:
            return answer

    monkeypatch.setattr("sys.stdin", Screen())
    assert Terminal(as_json=False).ask("May it run?") is agreed


def test_bags_of_a_cell_are_read_by_measured_signals_alone(tmp_path: Path, hidden_campaign: Path) -> None:
    """Rounds in folders, hits and free motion in one table; what a diagnosis needs of it is there."""
    trials = ("push/juice__case_1__s1.000__r0", "push/juice__case_1__s1.000__r1", "push/parcel__case_1__s1.000__r0")
    for number, trial in ((1, trials[0]), (2, trials[1]), (2, trials[2]), (2, "excite/none__fast__s1.000__r0")):
        shutil.copytree(hidden_campaign / trial, tmp_path / "runs" / f"round_0{number}" / trial)
    runs = bench(tmp_path, Operator()).measured_runs()
    assert len(runs.runs) == 4 and not runs.skipped
    assert sorted(map(len, runs.conditions.values())) == [1, 1, 2]
    planned_names = {trial.name for trial in possible_trials(["push", "excite"])}
    assert set(runs.conditions) < planned_names  # a design recognises what was measured
    assert {"/".join(run.condition_key) for run in runs.runs} == set(runs.conditions)
    assert all(run.spec is None for run in runs.runs)  # a laboratory's: nothing of controller and plan is known
    table = (tmp_path / "runs" / "runs.csv").read_text().splitlines()
    assert sum(",free motion," in row for row in table) == 1 and sum(",hit," in row for row in table) == 3


def test_hits_of_every_scenario_are_read_in_their_own_scene(tmp_path: Path, hidden_campaign: Path) -> None:
    """One has an object that the other does not know, and a heavier juice; the free motions belong to both."""
    for trial in ("push/juice__case_1__s1.000__r0", "excite/none__fast__s1.000__r0"):
        shutil.copytree(hidden_campaign / trial, tmp_path / "runs" / "round_01" / trial)
    push = load_scenario("push").with_settings({"name": "push_heavy", "objects.juice.mass": 2.5})
    short = {"nominal_impact": 0.4, "approach": 0.35, "window_after": 0.3, "duration": 0.8}  # s
    objects = {"carton": push.objects["parcel"], "juice": push.objects["juice"]}
    other = push.model_copy(update={"objects": objects, "timing": push.timing.model_copy(update=short)})
    for item in other.objects:
        plan = TrialSpec.of(other, item, "case_1").plan
        assert recorded(plan, tmp_path / "runs" / "round_02" / "push_heavy" / item).outcome == "OK"
    runs = bench(tmp_path, Operator()).measured_runs()
    assert len(runs.runs) == 4 and not runs.skipped
    masses = {
        (run.condition_key[0], run.condition_key[1]): run.setup.physics.object.mass for run in runs.runs if run.hit
    }
    assert (
        masses["push_heavy", "juice"] == 2.5 and masses["push", "juice"] == load_scenario("push").objects["juice"].mass
    )
    assert ("push_heavy", "carton") in masses


def test_free_motions_alone_are_read_in_their_own_scene(tmp_path: Path, hidden_campaign: Path) -> None:
    shutil.copytree(hidden_campaign / "excite", tmp_path / "runs" / "round_01" / "excite")
    runs = bench(tmp_path, Operator()).measured_runs()
    assert {run.condition_key[0] for run in runs.runs} == {"excite"} and not any(run.hit for run in runs.runs)


def test_a_cell_without_trials_and_an_unknown_mapping_are_refused_in_words(tmp_path: Path) -> None:
    (tmp_path / "runs").mkdir()
    with pytest.raises(InputError, match="no trial was recorded here"):
        bench(tmp_path, Operator()).measured_runs()
    guard = CellGuard(tmp_path, ENVELOPE, Operator())
    with pytest.raises(InputError, match="did you mean 'impact_rs'"):
        CellBench(tmp_path, SETTINGS, map, Terminal(as_json=True), guard, mapping="impact_r")  # type: ignore[arg-type]


def test_a_mapping_of_another_robot_is_refused_before_anything_moves(tmp_path: Path) -> None:
    """The default is that of a Franka FER. Kills: it is refused where bags are read, after the first trials."""
    other = SETTINGS.model_copy(update={"scenarios": ("push_fr3",)})
    guard = CellGuard(tmp_path, ENVELOPE, Operator())
    with pytest.raises(InputError, match="another robot than 'franka_fr3', arm 'arm' of scenario 'push_fr3'"):
        CellBench(tmp_path, other, map, Terminal(as_json=True), guard)  # type: ignore[arg-type]


class FakeNodes(FakeCell):
    """The nodes, which are given hidden effects and may be asked to repeat a trial."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, outcomes: dict[str, str] | None = None) -> None:
        super().__init__(monkeypatch, outcomes)
        self.scenarios: list[str] = []
        self.hidden: list[Any] = []

    def _run(
        self, graph: Any, directory: Path, manifest: Any, key: Any, plant_model: Any, repeated: bool
    ) -> TrialReport:
        self.scenarios.append(manifest.scenario)
        self.hidden.append(plant_model)
        return super()._run(graph, directory, manifest, key, None, repeated)


def test_the_plant_node_alone_is_given_what_is_hidden(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    nodes, secret = FakeNodes(monkeypatch), Secret.drawn(0, "single", "support_friction")
    via = NodesBench(tmp_path, SETTINGS, map, Terminal(as_json=True), secret.model)  # type: ignore[arg-type]
    via.measure(planned(("parcel", "case_1", 2)))
    assert [model.effects[0].name for model in nodes.hidden] == ["support_friction"] * 2
    friction = nodes.hidden[0].effects[0].parameters["friction"]
    assert friction.estimate == secret.hidden[0].values[0]
    assert nodes.repeated == [True, True] and nodes.without == ()


def test_a_variant_of_a_scenario_reaches_the_nodes_as_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    nodes = FakeNodes(monkeypatch)
    settings = {"name": "push_soft", "contact.friction": 0.4}
    one = PlannedTrials(object="parcel", case="case_1", trials=1)
    campaign = PlannedCampaign(folder="push_soft", scenario="push", settings=settings, conditions=(one,))
    plan = ExperimentPlan(
        model="nominal", model_digest="", aim="effects", method="design", budget=6, campaigns=(campaign,)
    )
    via = NodesBench(tmp_path, SETTINGS, map, Terminal(as_json=True))  # type: ignore[arg-type]
    via.measure(trials_of(plan, "round_01"))
    scenario = load_scenario(nodes.scenarios[0])
    assert (scenario.name, scenario.contact.friction) == ("push_soft", 0.4)


def test_an_aborted_trial_of_the_nodes_ends_the_command_and_not_the_investigation(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    nodes = FakeNodes(monkeypatch, {"parcel__case_1__s1.000__r1": "ABORTED"})
    via = NodesBench(tmp_path, SETTINGS, map, Terminal(as_json=True))  # type: ignore[arg-type]
    with pytest.raises(RuntimeError, match="was aborted: .*; the same command goes on"):
        via.measure(planned(("parcel", "case_1", 3)))
    assert len(nodes.moved) == 2 and not (tmp_path / "stopped.json").exists()
