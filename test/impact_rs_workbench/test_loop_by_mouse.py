# SPDX-License-Identifier: Apache-2.0
"""Whole steps of the page with real jobs, by mouse; they make the pictures of the manual (IMPACT_RS_PICTURES).

What needs no real job is in test_page.py.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml
from browser import Visit, accessible, needs_browser, picture
from mixed_grab import FILE
from page_steps import command, go, predicted, start
from playwright.sync_api import Page, expect

from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_trials.bags import topics
from impact_rs_trials.experiment_plan import write_scenario

pytestmark = [needs_browser, pytest.mark.slow]
LONG = 300_000.0  # ms, for a job on a machine with other work


def run(page: Page, label: str, state: str | int = 0) -> None:
    """Start a real job, and wait for its end."""
    start(page, label, state, LONG)


def high(page: Page, height: int) -> None:
    page.set_viewport_size({"width": 1280, "height": height})
    page.evaluate("scrollTo({top: 0, behavior: 'instant'})")


def test_the_loop_by_mouse_names_the_effect_and_the_error_falls(
    visit: Visit, tmp_path: Path, hidden_campaign: Path
) -> None:
    shutil.copytree(hidden_campaign, tmp_path / "blind" / "runs")
    page = visit("compare")
    page.locator("#compare-output").fill("reports/first")
    run(page, "Compare")
    page.locator("#compare-result .plot .nsewdrag").last.click()
    expect(page.locator("#signal .scatterlayer .trace")).to_have_count(3)  # measured, model, residual
    page.set_viewport_size({"width": 1280, "height": 950})
    page.mouse.move(0, 0)
    page.locator("#compare-result .clickable").last.evaluate("node => node.scrollIntoView({behavior: 'instant'})")
    picture(page, "workbench_compare")
    replay = page.locator("#compare-result .replays")
    replay.get_by_label("scale of the difference between model and measurement").select_option("10")
    picture(replay, "replay")

    go(page, "diagnose")
    page.locator("#diagnose-effects").fill("support_friction")
    page.locator("#diagnose-report").fill("reports/diagnosis")
    expect(command(page)).to_contain_text("reports/diagnosis/diagnosis.json")
    run(page, "Diagnose")
    expect(page.locator("#ranking tr.main")).to_contain_text("CONFIRMED")
    page.locator("#ranking tr.main button").click()
    expect(page.locator("#add-effect input:checked")).to_have_value("support_friction")
    run(page, "Add the effects")
    expect(page.locator("#models .tree")).to_contain_text("support_friction")
    go(page, "history")
    page.select_option("#history-model", "models/model_2.yaml")
    page.locator("#history-output").fill("reports/history")
    run(page, "Show the history")
    expect(page.frame_locator("#history-result iframe").locator("td", has_text="model_2")).to_be_visible()
    history = json.loads((tmp_path / "reports" / "history" / "history.json").read_text())["history"]
    assert history[1]["error_fit"] < 0.5 * history[0]["error_fit"]

    go(page, "overlay")
    expect(page.locator("#overlay-plot .scatterlayer .trace")).to_have_count(3)
    page.select_option("#overlay-signal", "Velocity of the end effector, y")
    high(page, 1100)
    picture(page, "workbench_overlay")


def test_how_fast_the_arm_may_hit_is_asked_and_the_hit_rehearsed(visit: Visit, tmp_path: Path) -> None:
    page = visit("predict/limits")
    expect(command(page)).to_contain_text("limits push --objects parcel --cases case_1 -o ")
    page.locator("#part-limits summary").first.click()
    page.locator("#limits-draws").fill("20")
    expect(command(page)).to_contain_text("--draws 20")
    run(page, "Compute the limits")
    expect(page.frame_locator("#limits-result iframe").locator("h1")).to_have_text("How fast may push hit?")
    (limit,) = json.loads((tmp_path / "limits" / "push" / "limits.json").read_text())["limits"]
    expect(page.locator("[data-says='predict/limits']")).to_contain_text(f"limit {limit['limit_m_s']:.3g} m/s")
    assert page.locator("[data-entry='lab limits/push']").count() == 0  # its table is no recording
    page.locator("#part-limits summary").first.click()
    high(page, 1400)
    picture(page, "workbench_limits")
    page.locator(".lead:visible a").click()
    page.select_option("#rehearse-object", "juice")
    expect(command(page)).to_contain_text("rehearse push juice")
    run(page, "Rehearse")
    report = page.frame_locator("#rehearse-result iframe")
    expect(report.locator("td", has_text="arm torque rate")).to_be_visible()
    expect(report.locator(".answer")).to_contain_text("Rehearsal passed")
    expect(page.locator("[data-says='measure/rehearse']")).to_contain_text("push, juice, case_1: passed")
    high(page, 1200)
    picture(page, "workbench_rehearsal")


def test_trials_are_designed(visit: Visit, tmp_path: Path) -> None:
    push = load_scenario("push")
    one = {name: dict([next(iter(getattr(push, name).items()))]) for name in ("objects", "cases")}
    write_scenario(push.model_copy(update=one), tmp_path / "small.yaml")
    page = visit("measure/design")
    page.locator("#design-budget").fill("6")
    page.locator("#design-scenarios").fill("small.yaml")
    expect(command(page)).to_contain_text("small.yaml")
    run(page, "Plan the trials")
    planned = yaml.safe_load((tmp_path / "plans" / "plan_1.yaml").read_text())
    rows = page.locator("#planned tbody tr")
    expect(rows).to_have_count(sum(len(one["conditions"]) for one in planned["campaigns"]))
    assert sum(int(row.locator("td").first.inner_text()) for row in rows.all()) == 6
    expect(page.locator("#pairs tbody tr").first).to_contain_text(planned["pairs"][0]["first"])
    high(page, 1100)
    picture(page, "workbench_design")


def test_an_investigation_is_followed_stopped_and_can_go_on(visit: Visit, tmp_path: Path) -> None:
    page = visit("investigate/loop")
    page.locator("#investigate-blind").fill("7")
    page.locator("#investigate-budget").fill("8")
    page.locator("#part-loop summary").first.click()
    page.locator("#investigate-effects").fill("torque_gain support_friction")  # few, because each costs replays
    expect(command(page)).to_contain_text("--blind 7 --effects torque_gain support_friction")
    start(page, "Investigate", "running")
    expect(page.locator("#ending")).to_contain_text("goes on", timeout=LONG)
    expect(page.frame_locator("#investigate-result iframe").locator("h1")).to_be_visible()
    page.locator("#jobs-toggle").click()
    job = page.locator("#job-list > li").first
    job.get_by_role("button", name="Stop").click()
    expect(job).to_have_attribute("data-state", "130")
    expect(job.get_by_role("button", name="Continue")).to_be_visible()
    assert (tmp_path / "investigations" / "1" / "investigation.yaml").exists()


def test_bags_of_another_controller_are_described_compared_shown_and_searched_for_impacts(
    visit: Visit, tmp_path: Path, hidden_campaign: Path, rewrite_bag: Callable[..., None]
) -> None:
    kept = {topics.joint_states("arm"), topics.joint_command("arm"), topics.OBJECT_POSE}
    for number, trial in enumerate(sorted((hidden_campaign / "push").glob("parcel*")), start=1):  # nothing of ours
        rewrite_bag(trial, tmp_path / "lab" / f"parcel_{number}", kept.__contains__)
    page = visit("laboratory/import")
    page.get_by_label("lab", exact=True).check()
    page.select_option("#import-robot", "franka_fer")
    page.locator("#import-output").fill("found")
    run(page, "Look at the files")
    expect(page.locator("[data-printed=import] pre")).to_contain_text("2 runs")
    go(page, "laboratory", "laboratory")
    part = page.locator("#part-laboratory")
    expect(part.locator("[data-lab-signal] .plot .xy .scatterlayer")).to_have_count(5)  # four of the arm, one object
    page.locator("#lab-save").click()
    expect(page.locator("#lab-written")).to_contain_text("lab/experiment.yaml, lab/mapping.yaml, lab/runs.csv")
    part.get_by_role("button", name="Compare").click()
    expect(page.locator("#compare-experiment")).to_have_value("lab/experiment.yaml")
    run(page, "Compare")
    expect(page.locator("#compare-result .answer")).to_contain_text("in 2 trials")
    page.locator("[data-entry='lab lab']").click()
    page.get_by_role("button", name="Show the runs").click()
    page.locator("#recorded-trials [data-trial=parcel_2]").click()
    expect(page.locator("#recorded-shown h3").first).to_have_text("Run parcel_2")
    expect(page.locator("#recorded-replay .replay-time")).to_contain_text("the impact")
    go(page, "laboratory", "impacts")
    page.locator("#impacts-directory").select_option("lab")
    run(page, "Find the impacts")
    expect(page.locator("[data-printed=impacts] pre")).to_contain_text("2 impacts of 2 runs")


def test_two_arms_of_different_kinds_are_predicted_and_described(
    visit: Visit, tmp_path: Path, mixed_trial: Path, rewrite_bag: Callable[..., None]
) -> None:
    shutil.copy(FILE, tmp_path / "mixed_grab.yaml")
    rewrite_bag(mixed_trial, tmp_path / "two" / "run_1", lambda topic: not topic.startswith(("/trial", "/truth")))
    page = predicted(visit("predict"))
    expect(page.locator("#predict-arm")).to_be_hidden()  # of one arm
    for name, value in (("scenario", "mixed_grab.yaml"), ("object", "parcel"), ("arm", "right")):
        page.select_option(f"#predict-{name}", value)
    rows, plot = page.locator("#predict-table tr.main td"), page.locator("#predict-plot")
    expect(page.locator("#predict-table tr.main td:first-child")).to_have_text(["left, z", "right, z", "object, z"])
    expect(plot.locator(".scatterlayer .trace")).to_have_count(7)  # the map of the right arm
    place = plot.evaluate("node => node.layout.shapes.find((one) => one.type === 'circle').yanchor")
    assert f"{place:.3f}" == rows.nth(6).inner_text()

    page.locator("[data-entry='lab two']").click()
    page.select_option("#lab-scenario", "mixed_grab.yaml")
    expect(page.locator("[data-lab-signal] .plot .xy .scatterlayer")).to_have_count(9)
    effort = page.locator("[data-lab-arm=right] select[data-signal=torque]")
    effort.select_option("/left/joint_states: effort (7)")
    expect(page.locator("[data-lab-arm=right] .error")).to_contain_text("joint right_joint1 is missing")
    expect(page.locator("[data-lab-arm=left] .error")).to_have_count(0)
    effort.select_option("/right/joint_states: effort (6)")
    expect(page.locator("[data-lab-signal] .plot .xy .scatterlayer")).to_have_count(9)
    accessible(page)
    high(page, 800)
    picture(page, "workbench_laboratory")
    page.locator("#lab-save").click()
    expect(page.locator("#lab-written")).to_contain_text("two/mapping_left.yaml, two/mapping_right.yaml")
    page.set_viewport_size({"width": 360, "height": 800})
    expect(page.locator("html")).to_have_js_property("scrollWidth", 360)
