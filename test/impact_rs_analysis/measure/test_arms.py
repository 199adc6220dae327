# SPDX-License-Identifier: Apache-2.0
"""Arms of different kinds are described one by one: what they are, and what is measured and predicted of each."""

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import documents
import numpy as np
import pytest
from mixed_grab import FILE, MIXED

from impact_rs_analysis.evidence.levels import SignalLevel
from impact_rs_analysis.measure.analyze import Analysis, analyze_campaign
from impact_rs_analysis.measure.arms import arm_titles, arms_of, assumptions, robot_name
from impact_rs_analysis.measure.predictions import predict, predict_arms
from impact_rs_analysis.report.analysis import arm_rows, write_analysis_report
from impact_rs_analysis.report.comparison import joint_tables
from impact_rs_sim.physics import Physics
from impact_rs_sim.robots.robot import load_facts
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_trials.campaign import make_manifest, run_campaign


@pytest.fixture(scope="module")
def analysis(made_once: Callable[[str, Callable[[Path], None]], Path]) -> Analysis:
    def run(folder: Path) -> None:
        manifest = make_manifest(FILE, ["cat_food"], ["case_1"], [0.8, 1.0, 1.2], trials=1)
        assert [report.outcome for report in run_campaign(folder / "mixed", manifest)] == ["OK"] * 3

    return analyze_campaign(made_once("mixed_campaign", run) / "mixed")


def test_arms_are_described_with_robot_joints_limits_and_motor_inertias() -> None:
    left, right = arms_of(Physics.nominal(MIXED, item) for item in ("parcel", "juice"))
    assert [left.title, right.title] == ["left: franka_fr3, 7 joints", "right: ur5e, 6 joints"]
    assert left.torque_limits_Nm == load_facts("franka_fr3").limits.torque_Nm
    assert left.torque_loop and left.motor_inertia_reduced_kg_m2[0] < left.motor_inertia_rotor_kg_m2[0]
    assert not right.torque_loop and right.motor_inertia_reduced_kg_m2 == right.motor_inertia_rotor_kg_m2


def test_a_name_of_two_robots_has_both_titles() -> None:
    """Kills: titles by name alone, where the last scenario's robot stood above the rows of both."""
    arms = arms_of(Physics.nominal(load_scenario(name), "parcel") for name in ("push", "push_ur5e"))
    titles = "arm: franka_fer, 7 joints, arm: ur5e, 6 joints"
    assert arm_titles(arms, "arm") == arm_titles(arms) == titles
    assert arm_titles(arms[1:], "arm") == "arm: ur5e, 6 joints"
    row = SignalLevel(
        phase="free",
        signal="torque",
        index="joint1",
        arm="arm",
        error=1.0,
        noise_floor=0.1,
        unit="N m",
        times_noise=10.0,
    )
    document = documents.comparison().model_copy(update={"arms": arms, "joints": (row,)})
    assert [table.title for table in joint_tables(document)] == [titles]
    sets = [SimpleNamespace(label=label, arms=[SimpleNamespace(name="arm")]) for label in ("push", "push_ur5e")]
    rows = arm_rows(cast(Analysis, SimpleNamespace(arms=arms, sets=sets)))
    assert {title: [label for label, _ in of_title] for title, of_title in rows.items()} == {
        titles: ["push", "push_ur5e"]
    }


def test_a_robot_that_is_not_shipped_goes_by_where_its_facts_come_from() -> None:
    facts = load_facts("ur5e")
    assert robot_name(facts) == "ur5e"
    assert robot_name(facts.model_copy(update={"source": "my own"})) == "my own"


def test_a_prediction_is_the_mean_of_those_of_its_arms() -> None:
    by_arm = predict_arms(MIXED, "cat_food", "case_1")
    for model, velocity in predict(MIXED, "cat_food", "case_1").items():
        assert velocity == pytest.approx((by_arm[model]["left"] + by_arm[model]["right"]) / 2.0)
    # The UR5e has one motor inertia. Another one of the FR3 moves both: they hold the same box.
    change = {arm: abs(by_arm["zero"][arm] - by_arm["rotor"][arm]) for arm in ("left", "right")}
    assert change["left"] > 5e-4 and change["right"] > 1e-3  # m/s


def test_every_arm_has_an_estimate_of_its_own(analysis: Analysis) -> None:
    (entry,) = analysis.sets
    assert [arm.name for arm in entry.arms] == ["left", "right"]
    references = [trial.info.reference_post_velocity for trial in entry.trials]
    for arm in entry.arms:
        # The line through an arm's own feedback; its zero crossing is the estimate.
        slope, intercept = np.polyfit(references, [trial.nets[arm.name] for trial in entry.trials], 1)
        assert arm.fit.estimate == pytest.approx(-intercept / slope)
        assert abs(arm.predictions["reduced"].error) < 18.0  # %, of three trials; B moves the UR5e by a third
    document = analysis.to_json()
    assert [arm["robot"] for arm in document["arms"]] == ["franka_fr3", "ur5e"]
    assert [arm["arm"] for arm in document["sets"][0]["arms"]] == ["left", "right"]


def test_the_report_goes_arm_by_arm(analysis: Analysis, tmp_path: Path) -> None:
    page = write_analysis_report(analysis, tmp_path)[0].read_text()
    part = page[page.index("<h2>Arm by arm</h2>") : page.index("<h2>Figures</h2>")]
    left, right = part.index("<h3>left: franka_fr3, 7 joints</h3>"), part.index("<h3>right: ur5e, 6 joints</h3>")
    first, second = analysis.sets[0].arms
    assert left < part.index(f"{first.speed:.3f}") < right < part.index(f"{second.speed:.3f}", right)
    assert "joint 7" in part and "the links carry B" in part


def test_what_is_assumed_of_an_arm_stands_in_documents_and_report(analysis: Analysis, tmp_path: Path) -> None:
    sentence = "assumed, neither measured nor published: of right moments of inertia of the links, those of cylinders"
    assert [arm["assumed"] for arm in analysis.to_json()["arms"] if "assumed" in arm] == [
        ["moments of inertia of the links, those of cylinders"]
    ]
    assert assumptions(analysis.arms) == [sentence]
    assert sentence[1:] in write_analysis_report(analysis, tmp_path)[0].read_text()


def test_arms_with_the_same_assumptions_share_a_sentence() -> None:
    (sentence,) = assumptions(arms_of([Physics.nominal(load_scenario("grab_fr3"), "juice")]))
    numbers = "drive.motor_inertia_reduced, drive.stiffness, drive.damping"
    assert sentence == f"assumed, neither measured nor published: of left and right {numbers}"


def test_one_arm_needs_no_table_of_its_own(push_analysis: Analysis) -> None:
    titles = [arm.title for arm in push_analysis.arms]
    assert (push_analysis.sets[0].arms, titles) == ((), ["arm: franka_fer, 7 joints"])
