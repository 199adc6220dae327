# SPDX-License-Identifier: Apache-2.0
"""A folder of trials, whatever state it is in."""

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from impact_rs_analysis.evidence.replays.measured_runs import read_runs
from impact_rs_analysis.measure.analyze import Analysis, ExperimentSet, analyze_campaign
from impact_rs_analysis.measure.export import export
from impact_rs_analysis.measure.published import paper_row, published
from impact_rs_analysis.measure.table import result_table
from impact_rs_analysis.report import write_report
from impact_rs_analysis.report.figures import figures_of
from impact_rs_analysis.report.plots import curves_plot
from impact_rs_cli.main import main
from impact_rs_sim.errors import InputError
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_trials.bags.reader import TrialBag
from impact_rs_trials.bags.topics import TRIAL_INFO, TRUTH
from impact_rs_trials.recordings.recording import is_foreign

NAME = "cat_food__case_2__s{:.3f}__r0"
ODD = "cat_food__case_2__s9.000__r0"
MODELS = {"reduced", "rotor", "zero"}


def test_the_document_has_its_schema(push_analysis: Analysis) -> None:
    document = json.loads(json.dumps(push_analysis.to_json(), allow_nan=False))
    assert {"sets", "skipped", "missing", "no_impact"} <= set(document)
    (entry,) = document["sets"]
    assert (entry["scenario"], entry["object"], entry["case"], entry["axis"]) == ("push", "cat_food", "case_2", "y")
    assert entry["trials"] == 3
    low, high = entry["ci95_m_s"]
    assert 0.0 < low < entry["estimate_m_s"] < high
    assert entry["r_squared"] > 0.99
    for contact in ("", "_settled"):
        assert set(entry[f"predictions{contact}"]) == MODELS
        for model, prediction in entry[f"predictions{contact}"].items():
            error = 100.0 * (prediction["v_m_s"] / entry["estimate_m_s"] - 1.0)
            assert prediction["error_percent"] == pytest.approx(error, abs=1e-9)
            assert document[f"average_error_percent{contact}"][model] == pytest.approx(error)
            assert document[f"absolute_error_percent{contact}"][model] == pytest.approx(abs(error))
        assert sum(document[f"nearest_sets{contact}"].values()) == 1


def test_a_plant_without_hidden_effect_agrees_with_the_nominal_prediction(push_analysis: Analysis) -> None:
    (entry,) = push_analysis.sets
    errors = {model: prediction.error for model, prediction in entry.predictions.items()}
    assert abs(errors["reduced"]) < 3.0  # %
    assert errors["zero"] < errors["reduced"] < errors["rotor"]


def test_the_truth_is_never_read(
    push_campaign: Path, push_analysis: Analysis, tmp_path: Path, rewrite_bag: Callable
) -> None:
    stripped = tmp_path / push_campaign.name
    stripped.mkdir()
    shutil.copy(push_campaign / "manifest.yaml", stripped)
    for path in push_campaign.glob("cat_food__*"):
        rewrite_bag(path, stripped / path.name, lambda topic: not topic.startswith(TRUTH))
        assert not any(topic.startswith(TRUTH) for topic in TrialBag.open(stripped / path.name).counts)
    found, whole = analyze_campaign(stripped).to_json(), push_analysis.to_json()
    assert (len(found.pop("unsealed")), whole.pop("unsealed")) == (3, [])  # they were written again
    assert found == whole


# ---- trials and bags that went wrong --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "kept"),
    [({"assumed": []}, 3), ({"stiffness": [10000.0] * 7}, 2)],
    ids=["marked otherwise", "another drive"],
)
def test_trials_stay_together_when_an_assumption_is_marked_later(
    campaign: Path, tmp_path: Path, rewrite_bag: Callable, change: dict[str, list[float]], kept: int
) -> None:
    """How well a number is known is no part of the motion; another number is."""
    name = NAME.format(1.2)
    shutil.move(campaign / name, tmp_path / "original")

    def other(topic: str, message: Any) -> None:
        if topic == TRIAL_INFO:
            data = json.loads(message.scenario_json)
            data["robots"]["arm"]["drive"] |= change
            message.scenario_json = json.dumps(data)

    rewrite_bag(tmp_path / "original", campaign / name, lambda topic: True, other)
    analysis = analyze_campaign(campaign)
    assert len(analysis.skipped) == 3 - kept


def test_a_trial_without_impact_never_enters_the_fit(campaign: Path, tmp_path: Path, rewrite_bag: Callable) -> None:
    name = NAME.format(1.2)
    shutil.move(campaign / name, tmp_path / "original")
    rewrite_bag(tmp_path / "original", campaign / name, lambda topic: "impact_event" not in topic)
    analysis = analyze_campaign(campaign)
    assert analysis.no_impact == (name,)
    assert not analysis.sets
    assert "2 trials with impact" in analysis.incomplete[0].reason
    assert analysis.average_error("first") == dict.fromkeys(MODELS)


def test_a_trial_that_diverged_is_left_out_with_the_reason(campaign: Path, with_outcome: Callable) -> None:
    name, reason = NAME.format(1.2), "arm joint7 at 12 rad/s against 2.61 rad/s at 0.035 s"
    with_outcome(campaign / name, f"DIVERGED\n    outcome_reason: {reason}")
    analysis = analyze_campaign(campaign)
    assert [(bag.name, bag.reason) for bag in analysis.skipped] == [(name, f"DIVERGED: {reason}")]
    assert "2 trials with impact" in analysis.incomplete[0].reason


def test_broken_and_foreign_bags_are_named_and_skipped(
    campaign: Path, push_analysis: Analysis, rewrite_bag: Callable
) -> None:
    whole = campaign / NAME.format(1.0)
    (campaign / "empty").mkdir()
    (campaign / "notes").mkdir()
    (campaign / "notes" / "readme.txt").write_text("no bag")
    rewrite_bag(whole, campaign / "foreign", lambda topic: topic == "/tf")
    shutil.copytree(whole, campaign / "truncated")
    file = next((campaign / "truncated").glob("*.mcap"))
    file.write_bytes(file.read_bytes()[:100_000])
    shutil.copytree(whole, campaign / "cut_off")
    (campaign / "cut_off" / "metadata.yaml").unlink()
    (campaign / "loose.mcap").write_bytes(b"")
    analysis = analyze_campaign(campaign)
    assert {bag.name for bag in analysis.skipped} == {"empty", "foreign", "truncated", "cut_off", "loose.mcap"}
    assert analysis.to_json()["sets"] == push_analysis.to_json()["sets"]


def test_missing_trials_of_the_manifest_are_listed(campaign: Path) -> None:
    shutil.rmtree(campaign / NAME.format(0.8))
    analysis = analyze_campaign(campaign)
    assert analysis.missing == (NAME.format(0.8),)
    assert not is_foreign(campaign)  # but a campaign of ours
    assert analysis.incomplete[0].object == "cat_food"


def test_a_broken_manifest_stops_nothing(campaign: Path) -> None:
    (campaign / "manifest.yaml").write_text("scenario: [")
    analysis = analyze_campaign(campaign)
    assert len(analysis.sets) == 1
    assert [entry.name for entry in analysis.skipped] == ["manifest.yaml"]


def test_a_folder_without_trials_is_a_mistake(tmp_path: Path) -> None:
    (tmp_path / "full" / "empty").mkdir(parents=True)
    (tmp_path / "bare").mkdir()
    for name, complaint in (("bare", "holds no trials"), ("nowhere", "no such folder"), ("full", "none of its 1 bags")):
        with pytest.raises(InputError, match=complaint):
            analyze_campaign(tmp_path / name)


@pytest.fixture
def unsealed(campaign: Path, rewrite_bag: Callable) -> Path:
    """One more bag, which carries no checksums that would catch what is done to it."""
    rewrite_bag(campaign / NAME.format(1.0), campaign / ODD, lambda topic: True)
    return campaign / ODD


@pytest.mark.parametrize("count", ["null", "many", "[1]", "-1", "99999"])
def test_a_bag_whose_message_count_is_no_count_stops_nothing(campaign: Path, unsealed: Path, count: str) -> None:
    path = unsealed / "metadata.yaml"
    path.write_text(re.sub(r"message_count: \d+", f"message_count: {count}", path.read_text()))
    found = analyze_campaign(campaign)
    assert len(found.sets) == 1
    left_out = [bag.name for bag in found.skipped]
    assert left_out == [ODD] or (count == "-1" and not left_out)  # a count below what is there may be ignored


def test_any_exception_of_one_bag_is_reported_in_a_line(campaign: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    opened = TrialBag.open.__func__

    def broken(cls: type, path: Path) -> TrialBag:
        if path.name.endswith("s0.800__r0"):
            raise ZeroDivisionError("by\nnothing")
        return opened(cls, path)

    monkeypatch.setattr(TrialBag, "open", classmethod(broken))
    reason = "damaged (ZeroDivisionError: by nothing)"
    assert [bag.reason for bag in analyze_campaign(campaign).skipped] == [reason]
    assert [why for _, why in read_runs(campaign, map).skipped] == [reason]
    for name in ("all.parquet", "all.h5"):
        found = export(campaign, campaign.parent / name, map, lambda done, total: None)
        assert (found.trials, [bag.reason for bag in found.skipped]) == (2, [reason])


def test_bags_without_checksums_are_named_as_such(
    campaign: Path, unsealed: Path, push_analysis: Analysis, capfd: pytest.CaptureFixture
) -> None:
    assert analyze_campaign(campaign).unsealed == (ODD,)
    assert "1 bag carries no checksums" in read_runs(campaign, map).remarks[0]
    assert main(["analyze", str(campaign)]) == 0
    assert "note: 1 bag carries no checksums" in capfd.readouterr().out
    shutil.rmtree(unsealed)
    assert (push_analysis.unsealed, read_runs(campaign, map).remarks) == ((), ())


# ---- beside the paper -----------------------------------------------------------------------------------------------


def test_the_paper_stands_beside_what_it_names(push_analysis: Analysis) -> None:
    row, average, absolute = result_table(push_analysis)
    assert row.paper_estimate == 0.534
    assert row.paper_errors == {"reduced": 1.82, "rotor": 5.76, "zero": -1.56}
    assert average.errors == row.errors
    assert absolute.errors == {model: abs(error) for model, error in row.errors.items()}


@pytest.mark.parametrize(
    ("scenario", "average", "absolute"),
    [("push", (1.96, 5.84, -1.89), (3.12, 5.84, 2.62)), ("grab", (1.27, 4.95, -2.57), (3.97, 6.19, 5.88))],
)
def test_the_papers_rows_give_the_papers_averages(scenario: str, average: tuple, absolute: tuple) -> None:
    cases = [(item, f"case_{case}") for item in ("parcel", "cat_food", "juice") for case in (1, 2, 3)]
    columns = list(zip(*(paper_row(scenario, *case).errors.values() for case in cases), strict=True))
    assert {len(column) for column in columns} == {9}
    assert [sum(column) / 9 for column in columns] == pytest.approx(average, abs=0.02)
    assert [sum(map(abs, column)) / 9 for column in columns] == pytest.approx(absolute, abs=0.02)


def test_what_was_published_of_another_robot_object_or_speed_is_not_shown() -> None:
    scenario = load_scenario("push")
    row = paper_row("push", "cat_food", "case_2")
    assert row is not None and published(scenario, "cat_food", "case_2") == row
    for changed in (
        {"robots.arm.facts": "franka_fr3"},
        {"objects.cat_food.mass": 1.4},
        {"objects.cat_food.size": [0.24, 0.16, 0.2]},
        {"cases.case_2.robots.arm.ante_velocity": [0.0, -0.8, 0.0]},
    ):
        assert published(scenario.with_settings(changed), "cat_food", "case_2") is None, changed
    kept = scenario.with_settings({"control.interim_duration": 0.2, "objects.cat_food.label": "Tin"})
    assert published(kept, "cat_food", "case_2") == row
    assert published(scenario, "cat_food", "case_9") is paper_row("push", "cat_food", "case_9") is None


# ---- report ---------------------------------------------------------------------------------------------------------


def test_the_report_is_one_file_that_needs_no_network(push_analysis: Analysis, tmp_path: Path) -> None:
    written = write_report(push_analysis, tmp_path / "report")
    pictures = [f"push__cat_food__case_2__{kind}.png" for kind in ("signals", "fit")]
    assert [path.name for path in written] == ["report.html", "analysis.json", *pictures]
    assert json.loads(written[1].read_text()) == push_analysis.to_json()
    text = written[0].read_text(encoding="utf-8")
    assert "Plotly" in text and not re.search(r"<(script|link|img)[^>]+(src|href)=", text)
    found = [json.loads(data) for data in re.findall(r'<script type="application/json" id=.*?>(.*?)</script>', text)]
    figures = [data for data in found if "layout" in data]
    assert len(figures) == 2
    assert all("[m/s" in figure["layout"]["yaxis"]["title"]["text"] for figure in figures)
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in written[2:])


def test_a_report_without_joint_states_shows_nothing_in_3d(
    push_campaign: Path, tmp_path: Path, rewrite_bag: Callable, caplog: pytest.LogCaptureFixture
) -> None:
    for bag in (path for path in push_campaign.iterdir() if path.is_dir()):
        rewrite_bag(bag, tmp_path / bag.name, lambda topic: topic != "/arm/joint_states")
    text = write_report(analyze_campaign(tmp_path), tmp_path / "report")[0].read_text(encoding="utf-8")
    assert 'id="replay"' not in text and "three.js" not in text
    assert "is not shown in 3D: /arm/joint_states has no joint positions" in caplog.text


@pytest.mark.parametrize(("tolerance", "fits"), [(50.0, True), (1e-6, False)])
def test_a_report_says_where_no_prediction_fits_and_repeats_nothing(
    push_analysis: Analysis, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, tolerance: float, fits: bool
) -> None:
    """A push is settled at once, and all its rows are published: neither may widen the table of results."""
    monkeypatch.setattr(ExperimentSet, "tolerance", property(lambda _: tolerance))
    text = write_report(push_analysis, tmp_path / "report")[0].read_text(encoding="utf-8")
    first, published = re.findall(r"<thead>.*?</thead>", text, re.DOTALL)[:2]
    assert "errors, first contact" in first and "settled" not in first
    assert first.count("<th>") + first.count("<td>") == 5 + 2 and "published" in published
    assert (text.count('<td class="best">'), text.count('<td class="nearest">')) == ((3, 0) if fits else (0, 3))
    assert ("<small>none fits</small>" in text) == ("none fits" in text) == (not fits)


def test_html_and_png_are_drawn_from_the_same_numbers(push_analysis: Analysis) -> None:
    for figure in figures_of(push_analysis.sets[0]):
        curves = [curve for panel in figure.panels for curve in panel.curves]
        assert [trace.name or "" for trace in curves_plot(figure).data] == [curve.label for curve in curves]
