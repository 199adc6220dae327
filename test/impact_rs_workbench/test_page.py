# SPDX-License-Identifier: Apache-2.0
"""The page as a person uses it, in a headless browser, on prepared results and with jobs that do as they are told.

Waits are for what shall be there, never for time. Numbers and commands are compared, and what carries them (``data-``
attributes, values of fields); sentences are the business of the page. Real jobs: test_loop_by_mouse.py.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import threading
import time
from pathlib import Path
from typing import Literal

import pytest
import reports
from browser import FRAMES, PICTURES, Held, Visit, accessible, needs_browser, picture
from known_recordings import BagFormat, Signals
from page_steps import DESK, TABS, command, go, predicted, start
from playwright.sync_api import Page, Request, Route, expect
from processes import PATIENCE, until
from stub_job import Stub

from impact_rs_analysis.diagnosis.document import EstimateDocument, write_document
from impact_rs_analysis.evidence.replays.measured_runs import runs_digest
from impact_rs_analysis.report.page import PALETTE
from impact_rs_sim.files import write_whole
from impact_rs_workbench import kept_choices

pytestmark = needs_browser
NUMBER = re.compile("[0-9] s")


# ---- every step -----------------------------------------------------------------------------------------------------


OFTEN = ("predict", "compare", "diagnose")  # steps of every user
CUT_OFF = """() => [...document.querySelectorAll('main label > select')].filter((node) => {
    const pen = document.createElement('canvas').getContext('2d'), text = node.selectedOptions[0]?.text ?? '';
    pen.font = getComputedStyle(node).font;
    const shown = node.parentElement.querySelector('small')?.textContent ?? '';
    return node.offsetWidth > 0 && pen.measureText(text).width + 30 > node.clientWidth && shown !== text;
}).map((node) => node.id)"""


@pytest.mark.parametrize("scheme", ["light", pytest.param("dark", marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    ("step", "tab"),
    [
        pytest.param(
            step, tab, marks=[pytest.mark.slow] if number or step not in OFTEN else []
        )  # fast: their first tabs
        for step, tabs in TABS.items()
        for number, tab in enumerate(tabs)
    ],
)
def test_a_tab_fits_every_screen_and_is_accessible(
    visit: Visit, full: Path, step: str, tab: str, scheme: Literal["light", "dark"]
) -> None:
    """No list cuts off what is chosen in it, and the jobs stay in sight on a phone."""
    page = visit(step, color_scheme=scheme)
    page.set_viewport_size(DESK)
    go(page, step, tab)
    expect(page.locator("main > section:visible h2").first).to_be_visible()
    page.locator("main details.more:visible").evaluate_all("all => { for (const one of all) one.open = true; }")
    accessible(page)
    for width in (360, 820, 1280):
        page.set_viewport_size({"width": width, "height": 800})
        expect(page.locator("html")).to_have_js_property("scrollWidth", width)
        page.wait_for_function(f"() => !({CUT_OFF})().length")
        expect(page.locator("#jobs-toggle")).to_be_in_viewport()


@pytest.mark.parametrize("step", [pytest.param(one, marks=[] if one in OFTEN else pytest.mark.slow) for one in TABS])
def test_the_first_two_lines_say_what_a_step_or_tab_is_and_what_comes_next(visit: Visit, step: str) -> None:
    """Each in its own words; what comes next is another place of the page, and the address leads back."""
    page, said = visit(step), []
    lines = page.locator("main > section:visible .lead p")
    for tab in TABS[step]:
        go(page, step, tab)
        expect(lines).to_have_count(2)
        said.append(lines.first.inner_text())
        here, following = page.url, (lines.locator("a").get_attribute("href") or "").lstrip("#").split("/")
        lines.locator("a").click()
        expect(page.locator(f"[data-step={following[0]}]")).to_have_attribute("aria-current", "step")
        for name in following[1:]:
            expect(page.locator(f"main [data-part={name}]")).to_be_visible()
        assert page.url != here
        page.go_back()
        expect(lines.first).to_have_text(said[-1])
    assert all(said) and len(set(said)) == len(said)


def test_tabs_and_the_manual_are_reached_by_keyboard(visit: Visit) -> None:
    page = visit("measure/campaign")
    page.locator("#tab-campaign").focus()
    for key, tab in (("ArrowRight", "trial"), ("End", "blind"), ("ArrowRight", "campaign"), ("ArrowLeft", "blind")):
        page.keyboard.press(key)
        expect(page.locator(f"#tab-{tab}")).to_be_focused()
        expect(page.locator(f"#part-{tab}")).to_be_visible()
    page.get_by_role("link", name="In the manual").focus()
    page.keyboard.press("Enter")
    expect(page.locator("#manual h1")).to_have_text("Bags")
    page.keyboard.press("Escape")
    expect(page.locator("#manual")).to_be_hidden()


# ---- predict --------------------------------------------------------------------------------------------------------


def value(page: Page, column: int) -> float:
    """A number of the arm's row: before the impact 1, after it 2 [m/s]."""
    return float(page.locator("#predict-table tr.main td").nth(column).inner_text().replace("−", "-"))


ARROWS = """() => {
    const length = ({head, headLength, root}) => root.visible ? head.position.y + head.scale.y * headLength / 2 : 0;
    return impact_rs.predict.impact.picture.arrows.map((one) => [length(one.before), length(one.after)]);
}"""


def test_a_slider_moved_by_keyboard_moves_numbers_arrows_and_command_which_a_click_measures(visit: Visit) -> None:
    """Arrows before and after the impact are as the velocities of the table; kills one of another scale or body."""
    page = predicted(visit("predict"))
    expect(page.locator("#predict-scene")).to_have_attribute("data-shown", '["push","cat_food"]')
    before, after = value(page, 1), value(page, 2)
    arm, item = page.evaluate(ARROWS)
    assert arm[1] / arm[0] == pytest.approx(after / before, rel=0.02) and item[0] == 0.0  # the object rests
    page.locator("[data-key='contact.restitution']").focus()
    for _ in range(40):
        page.keyboard.press("ArrowRight")
    expect(page.locator("#predict-plot")).to_have_attribute("data-shown", '{"contact.restitution":0.2}')
    expect(page.locator(".command code").first).to_contain_text("--set contact.restitution=0.2")
    expect(page.locator("#right h2")).to_have_text("restitution e")
    axes = "({layout}) => [layout.xaxis.title.text, layout.yaxis.title.text]"
    assert page.locator("#predict-plot").evaluate(axes) == ["restitution e [-]", "v<sub>y</sub> after the impact [m/s]"]
    assert abs(value(page, 2)) < abs(after)
    page.wait_for_function(
        f"([arm, item]) => {{ const now = ({ARROWS})(); return now[0][1] < arm[1] && now[1][1] > item[1]; }}",
        arg=[arm, item],
    )
    page.set_viewport_size({"width": 1280, "height": 1130})
    if PICTURES:  # the curves over the slider come after the numbers
        page.wait_for_function("() => document.querySelector('#predict-plot').data.length > 2")
    picture(page, "workbench")
    page.select_option("#predict-object", "juice")
    page.select_option("#predict-case", "case_3")
    page.get_by_role("button", name="Measure this").click()
    expect(page.locator("#part-campaign .command code")).to_contain_text(
        re.compile("campaign push -o .*push_juice --objects juice --cases case_3")
    )


def test_a_found_model_is_predicted_until_its_file_goes(visit: Visit, tmp_path: Path) -> None:
    """Beside the sliders, and by a click on it on the left; its name and its note are text and no markup."""
    name, file = "<img src=x>&amp;", tmp_path / "heavier.yaml"
    heavier = {"name": "object_mass", "parameters": {"scale": {"estimate": 1.6, "unit": "-"}}}
    file.write_text(json.dumps({"name": name, "parent": "nominal", "effects": [heavier], "note": "<b>bold</b>"}))
    page = predicted(visit("predict"))
    nominal, shown = value(page, 2), page.locator("section:visible .command code")
    page.locator("[data-entry='model heavier.yaml']").click()
    expect(page.locator("#right h2")).to_have_text(name)
    expect(page.locator("#right")).to_contain_text("<b>bold</b>")
    expect(page.locator("#predict-model")).to_have_value("heavier.yaml")
    expect(shown).to_contain_text("--model ")
    assert abs(value(page, 2)) < abs(nominal) - 0.01
    file.unlink()
    expect(page.locator("#predict-model")).to_have_value("nominal")
    expect(shown).not_to_contain_text("--model")
    assert value(page, 2) == nominal


def test_a_new_question_hides_numbers_and_command_of_the_last_one(visit: Visit) -> None:
    page = predicted(visit("predict"))
    table, shown = page.locator("#predict-table tbody tr"), page.locator("main > section:visible .command")
    held = Held(page, "**/api/predict")
    page.select_option("#predict-object", "juice")
    for stale in (table, shown, page.locator("#predict-plot .scatterlayer")):
        expect(stale).to_have_count(0)
    held.let_go()
    expect(shown).to_contain_text("juice")
    expect(table.first).to_be_visible()
    held = Held(page, "**/api/predict")
    page.locator("[data-key='contact.restitution']").focus()
    page.keyboard.press("ArrowRight")
    expect(page.locator("#predict-numbers")).to_be_hidden()  # of the slider as it was
    held.let_go()
    expect(page.locator("#predict-numbers")).to_be_visible()
    expect(shown).to_contain_text("contact.restitution")


OTHERS = ("api/sweep", "api/scene?*", "static/plotly.js")


@pytest.mark.parametrize("late", ["api/predict", *(pytest.param(one, marks=pytest.mark.slow) for one in OTHERS)])
def test_a_late_answer_of_an_earlier_question_paints_nothing(visit: Visit, late: str) -> None:
    """Whatever it is that comes when the page waits for another scenario already."""
    page = visit("compare")
    held = Held(page, f"**/{late}")
    page.locator("[data-step=predict]").click()
    held.wait_for(1)
    waiting = Held(page, "**/api/scenario?*")
    page.select_option("#predict-scenario", "grab")
    waiting.wait_for(1)
    held.let_go()
    for painted in ("#predict-table tbody tr", "#predict-plot .scatterlayer", "#predict-plot[data-shown]", ".command"):
        expect(page.locator(f"section:visible {painted}")).to_have_count(0)
    waiting.let_go()
    expect(page.locator("section:visible .command")).to_contain_text("map grab")
    expect(page.locator("#predict-table tr.main td:first-child")).to_have_text(["left, z", "right, z", "object, z"])
    expect(predicted(page).locator("#predict-scene")).to_have_attribute("data-shown", re.compile("grab"))


def test_a_slider_moves_while_the_questions_of_another_tab_come_first(visit: Visit) -> None:
    page, stopped = predicted(visit("predict")), list[Route]()

    def answer(route: Route) -> None:
        if route.request.post_data_json["moving"] or stopped:
            route.continue_()
        else:
            route.fulfill(json={"superseded": True})
            stopped.append(route)

    page.route("**/api/predict", answer)
    page.locator("[data-key='contact.restitution']").focus()
    page.keyboard.press("ArrowRight")
    while not stopped:
        page.evaluate("1")
    page.evaluate(FRAMES, 2)
    page.keyboard.press("ArrowRight")
    expect(page.locator("#predict-plot")).to_have_attribute("data-shown", '{"contact.restitution":0.01}')
    expect(page.locator("#predict-facts")).to_contain_text("200 draws")


# ---- forms ----------------------------------------------------------------------------------------------------------


def test_a_campaign_is_offered_counted_and_refused_on_the_page(visit: Visit) -> None:
    page = visit("measure/campaign")
    campaign, shown, button = page.locator("#part-campaign"), command(page), page.get_by_role("button")
    expect(shown).to_contain_text("--scales 0.8 0.9 1 1.1 1.2 --trials 2")
    expect(page.locator("#campaign-count")).to_have_text("10 trials.")
    for scale in ("0.8", "0.9", "1.1", "1.2"):
        campaign.get_by_label(scale, exact=True).uncheck()
    expect(page.locator("#campaign-count")).to_contain_text("2 trials. Analyze needs at least two references")
    campaign.locator("summary").click()
    campaign.get_by_label("scenario settings").fill("control.clamp_force=90 trials=3")
    expect(shown).to_contain_text("--set control.clamp_force=90 trials=3")
    expect(page.locator("#right code")).to_have_text("--set KEY=VALUE")
    page.locator("#campaign-objects input:checked").uncheck()
    expect(campaign.locator(".message .error")).to_contain_text("objects = []: expected at least 1 of them")
    expect(button.get_by_text("Start the campaign")).to_be_disabled()
    expect(campaign.locator(".command")).to_have_count(0)

    expect(go(page, "measure", "trial")).to_contain_text("impact-rs trial push")
    page.locator("#trial-scale").fill("9")
    expect(page.locator("#part-trial .message .error")).to_contain_text("expected a number > 0 and <= 3 [-]")
    expect(button.get_by_text("Run the trial")).to_be_disabled()
    page.locator("#trial-scale").fill("0.93")  # between two steps of the arrows
    expect(command(page)).to_contain_text("--scale 0.93")


def test_a_form_shows_the_command_of_its_newest_content_alone_and_asks_while_it_is_in_sight(visit: Visit) -> None:
    """And its button stays where it is, whatever the length of the command."""
    asked: list[str] = []

    def heard(sent: Request) -> None:
        if sent.url.endswith("/api/command"):
            asked.append(sent.post_data_json["command"])

    page = visit("compare")
    page.on("request", heard)
    shown, trials = go(page, "measure", "campaign"), page.locator("#campaign-trials")
    expect(shown).to_contain_text("--trials 2")
    place = page.get_by_role("button", name="Start the campaign").bounding_box()
    held = Held(page, "**/api/command")
    for count in ("6", "7", "8"):
        with page.expect_request("**/api/command"):
            trials.fill(count)
        expect(shown).to_be_hidden()
    held.answer_last_of(3)
    expect(shown).to_contain_text("--trials 8")
    expect(shown).to_be_visible()
    held.let_go()
    assert "--trials 8" in shown.inner_text()
    page.locator("#campaign-output").fill("campaigns/" + 60 * "long/")  # a command of several lines
    expect(shown).to_contain_text("long/long")
    assert page.get_by_role("button", name="Start the campaign").bounding_box() == place
    assert set(asked) == {"campaign"}


def test_what_a_form_suggests_is_the_newest_and_writes_over_nothing(
    visit: Visit, tmp_path: Path, push_campaign: Path
) -> None:
    """A model, until one is chosen; a name for the next one; a folder that has not this trial already."""

    def write(name: str, when: float) -> None:
        file = tmp_path / "models" / f"{name}.yaml"
        file.parent.mkdir(exist_ok=True)
        file.write_text(f"name: {name}\neffects: []\n")
        os.utime(file, (when, when))

    write("new", 4e9)
    write("model_2", 1e9)
    trial = "cat_food__case_2__s1.000__r0"
    shutil.copytree(push_campaign / trial, tmp_path / "trials" / trial)
    page = visit("history/versions")
    expect(page.locator("#history-model")).to_have_value("models/new.yaml")
    expect(page.locator("#history-runs")).to_have_value("trials")  # the first there is
    expect(page.locator("#history-output")).to_have_value("reports/history_trials_new")
    page.select_option("#history-model", "nominal")
    write("newer", 4.1e9)
    expect(page.locator("#history-model option[value='models/newer.yaml']")).to_be_attached()
    expect(page.locator("#history-model")).to_have_value("nominal")
    go(page, "add")
    expect(page.locator("#add-output")).to_have_value("models/model_3.yaml")
    write("model_3", 1e9)
    expect(page.locator("#add-output")).to_have_value("models/model_4.yaml")
    go(page, "measure", "trial")
    expect(page.locator("#trial-output")).to_have_value("trials")
    page.select_option("#trial-object", "cat_food")
    page.select_option("#trial-case", "case_2")
    expect(page.locator("#trial-output")).to_have_value("trials_2")


def test_a_formula_is_checked_while_it_is_written_and_offered_once_it_is_saved(visit: Visit, tmp_path: Path) -> None:
    """The newest text, whatever answer comes last."""
    page = visit("add")
    text, check = page.locator("#formula"), page.locator("#formula-check")
    expect(check).to_contain_text("end_effector_force.y: gives N")
    good = text.input_value()
    wrong = good.replace("N s/m", "N m")
    text.fill(wrong)
    expect(check.locator(".error")).to_contain_text("expected N")
    held = Held(page, "**/api/formulas/check")
    for count, content in enumerate((wrong + "\n", good), start=1):
        text.fill(content)
        held.wait_for(count)
    held.answer_last_of(2)
    expect(check.locator(".good")).to_contain_text("cable_drag")
    held.let_go()
    expect(check.locator(".error")).to_have_count(0)
    page.get_by_role("button", name="Save the formulas").click()
    expect(check).to_contain_text("formulas/mine.yaml")
    go(page, "diagnose")
    expect(page.locator("#diagnose-formulas option")).to_have_count(2)
    assert (tmp_path / "formulas" / "mine.yaml").exists()


def test_the_newest_page_of_the_manual_is_open_whatever_answer_comes_last(visit: Visit) -> None:
    page = visit("compare")
    held = Held(page, "**/manual/*.md")
    for count, step in enumerate(("compare", "measure"), start=1):
        go(page, step)
        page.get_by_role("link", name="In the manual").click()
        held.wait_for(count)
    held.answer_last_of(2)
    expect(page.locator("#manual h1")).to_have_text("Bags")
    held.let_go()
    expect(page.locator("#manual h1")).to_have_text("Bags")


# ---- jobs -----------------------------------------------------------------------------------------------------------


def test_a_real_job_from_click_to_result(visit: Visit, tmp_path: Path) -> None:
    """An effect of a diagnosis becomes a model, by ``impact-rs`` itself."""
    found = reports.diagnosed()
    scale = EstimateDocument(estimate=1.1, ci95=(1.08, 1.12), unit="-")
    mass = found.effects[0].model_copy(update={"parameters": {"scale": scale}})
    write_document(found.model_copy(update={"effects": (mass,)}), tmp_path / "diagnosis.json")
    page = visit("diagnose")
    page.locator("#ranking tr", has_text="object_mass").get_by_role("button").click()
    expect(page.locator("#add-effect input:checked")).to_have_value("object_mass")
    start(page, "Add the effects")
    expect(page.locator("#models .tree")).to_contain_text("object_mass")
    assert json.loads((tmp_path / ".workbench" / "jobs" / "0001" / "job.json").read_text())["exit_code"] == 0


# By step and tab: the button, the results, where the job writes them, where they are chosen and shown, what is said.
RESULTS = {
    "predict/limits": (
        "Compute the limits", "limits/push", "limits/push", "#limits-page", "iframe", "limit 0.4 m/s, planned 0.5 m/s"),
    "measure/rehearse": (
        "Rehearse", "rehearsals/push", "rehearsals/push", "#rehearse-page", "iframe", "case_1: not passed"),
    "measure/design": (
        "Plan the trials", "plans/plan_1.yaml", "plans/plan_1.yaml", "#design-file", "#planned", "2 trials"),
    "compare": (
        "Compare", "reports/seen", "reports/compare_runs_nominal", "#compare-report", "#compare-result .answer",
        "nominal: score 61.8, where 1 is noise"),
    "diagnose": (
        "Diagnose", "reports/diagnosed", "reports/diagnose_runs_nominal", "#diagnose-file", "#ranking",
        "nominal: object_mass+joint_coulomb_friction"),
    "history/versions": (
        "Show the history", "reports/history", "reports/history_runs_nominal", "", "iframe", "nominal 61.8"),
    "investigate/loop": (
        "Investigate", "investigations/1", "investigations/1", "#investigate-file", "#ending",
        "not at its end, after 2 trials in 1 round"),
}  # fmt: skip


def test_a_job_that_fails_shows_its_one_line(visit: Visit, stub: Stub, tmp_path: Path) -> None:
    stub.tells(prints=f"impact-rs campaign: {tmp_path}/campaigns/taken: a file is there", code=2)
    page = visit("measure/campaign")
    expect(command(page)).to_contain_text("--trials 2")
    job = start(page, "Start the campaign", 2)
    for place in (job.locator(".state"), page.locator("#part-campaign .actions .reply")):
        expect(place).to_contain_text("failed: campaigns/taken: a file is there")  # paths are those of the folder


def test_a_running_job_is_seen_by_other_tabs_stopped_there_and_continued(visit: Visit, stub: Stub) -> None:
    stub.tells(total=10, done=4, waits=True)
    page = visit("measure/campaign")
    expect(command(page)).to_contain_text("--trials 2")
    job = start(page, "Start the campaign", "running")
    expect(job.locator("progress")).to_have_attribute("value", "0.4")
    expect(page.locator("#jobs-line")).to_contain_text("4 of 10")
    page.reload()
    expect(job).to_have_attribute("data-state", "running")
    other = visit("compare")
    own = other.locator("#job-list > li").first
    expect(own).to_have_attribute("data-state", "running")
    other.locator("#jobs-toggle").click()
    own.get_by_role("button", name="Output").click()
    expect(own.locator("pre")).to_contain_text("it has begun")
    own.get_by_role("button", name="Stop").click()
    for seen in (job, own):
        expect(seen).to_have_attribute("data-state", "130")
    stub.tells(prints="it has gone on")
    own.get_by_role("button", name="Continue").click()
    for seen in (job, own):
        expect(seen).to_have_attribute("data-job", "2")
        expect(seen).to_have_attribute("data-state", "0")


@pytest.mark.parametrize("place", RESULTS)
def test_the_result_of_a_job_stands_in_its_step_when_it_is_done(
    visit: Visit, stub: Stub, tmp_path: Path, prepared: Path, push_campaign: Path, place: str
) -> None:
    """Kills a step that does not turn to what its job has written."""
    label, results, written, choice, where, said = RESULTS[place]
    (tmp_path / "runs").mkdir()
    shutil.copy(push_campaign / "manifest.yaml", tmp_path / "runs")
    if choice:  # what is newest needs none
        copy = shutil.copytree if (prepared / results).is_dir() else shutil.copy
        (tmp_path / "earlier" / results).parent.mkdir(parents=True)
        copy(prepared / results, tmp_path / "earlier" / results)
    stub.tells(results={prepared / results: tmp_path / written})
    page = visit(place)
    expect(page.locator("main > section:visible .command")).to_be_visible()
    start(page, label)
    if choice:
        expect(page.locator(choice)).to_have_value(re.compile(f"^{written}"))
    expect(page.locator(f"main > section:visible {where}")).to_be_visible()
    expect(page.locator(f"[data-says='{place}']")).to_contain_text(said)


def test_a_running_diagnosis_shows_the_ranking_so_far(visit: Visit, stub: Stub, tmp_path: Path, full: Path) -> None:
    stub.tells(total=10, done=4, ranking={"object_mass": 1.3, "gap": 60.0}, waits=True)
    page = visit("diagnose")
    start(page, "Diagnose", "running")
    rows = page.locator("main > section:visible .bars li")
    expect(rows).to_have_text([re.compile("object_mass.*1.3"), re.compile("gap.*60")])
    stub.go()
    expect(rows).to_have_count(0)


def test_an_investigation_is_followed_to_its_end(visit: Visit, stub: Stub, tmp_path: Path) -> None:
    page = visit("investigate/loop")
    expect(command(page)).to_contain_text(f"impact-rs investigate {tmp_path}/investigations/1")
    expect(page.locator("#investigate-budget")).to_have_attribute("min", "6")
    page.locator("#investigate-blind").fill("7")
    page.locator("#investigate-budget").fill("8")
    expect(command(page)).to_contain_text("--budget 8 --blind 7")
    stub.tells(waits=True)
    job = start(page, "Investigate", "running")
    reports.investigated(tmp_path / "investigations" / "1")
    expect(page.locator("#ending")).to_contain_text("goes on")
    expect(page.frame_locator("#investigate-result iframe").locator("h1")).to_be_visible()
    shutil.rmtree(tmp_path / "investigations" / "1")
    reports.investigated(tmp_path / "investigations" / "1", "UNDECIDED")
    stub.go()
    expect(job).to_have_attribute("data-state", "0")
    expect(page.locator("#ending")).to_contain_text("UNDECIDED")


def test_a_cell_asks_in_the_page_no_comes_first_and_a_closed_page_is_a_no(
    visit: Visit, stub: Stub, tmp_path: Path
) -> None:
    question = "The last run stopped. Is the cell safe, the arm at rest, and shall it go on?"
    stub.tells(questions=(question,))
    page = visit("investigate/loop")
    expect(command(page)).to_be_visible()
    start(page, "Investigate", "running")
    row = page.locator("#questions > div")
    expect(row).to_contain_text(question)
    expect(row.get_by_role("button")).to_have_text(["No", "Yes"])
    expect(row.get_by_role("button", name="No")).to_have_class("primary")
    accessible(page)
    picture(page, "workbench_question")
    sent: list[str | None] = []

    def kept(route: Route) -> None:
        sent.append(route.request.post_data)
        route.fulfill(status=400, json={"error": "kept by the test"})

    page.route("**/api/answer", kept)
    row.get_by_role("button", name="Yes").click()
    expect(row.locator(".reply")).to_have_text("kept by the test")
    assert sent == [json.dumps({"job": 1, "question": 1, "yes": True}, separators=(",", ":"))]
    page.unroute("**/api/answer")
    row.get_by_role("button", name="No").click()
    expect(row).to_have_count(0)
    start(page, "Investigate", "running")
    expect(row).to_have_count(1)
    page.context.close()
    for number in (1, 2):
        output = tmp_path / ".workbench" / "jobs" / f"000{number}" / "output.txt"
        until(lambda output=output: f"{question}: False" in output.read_text(), lambda: time.sleep(0.05))


def test_a_single_trial_is_shown_below_its_form_and_again_after_a_reload(
    visit: Visit, stub: Stub, tmp_path: Path, push_campaign: Path
) -> None:
    trial = "cat_food__case_2__s1.000__r0"
    stub.tells(results={push_campaign / trial: tmp_path / "single" / trial})
    page = visit("measure/trial")
    page.select_option("#trial-object", "cat_food")
    page.select_option("#trial-case", "case_2")
    page.locator("#trial-output").fill("single")
    expect(command(page)).to_contain_text("trial push cat_food case_2 -o")
    start(page, "Run the trial")
    for _ in range(2):
        expect(page.locator("#trial-shown h3").first).to_contain_text(trial)
        expect(page.locator("#trial-replay .replay-time")).to_contain_text("the impact")
        expect(page.locator("#trial-shown .plot .scatterlayer")).to_have_count(3)
        page.reload()


def test_a_plan_is_designed_shown_and_run_by_a_button(visit: Visit, stub: Stub, tmp_path: Path, prepared: Path) -> None:
    page = visit("measure/design")
    mistake, planned = page.locator("#part-design .message .error"), tmp_path / "plans" / "plan_1.yaml"
    expect(command(page)).to_contain_text(f"impact-rs design --budget 18 -o {planned}")
    page.locator("#design-budget").fill("0")
    expect(mistake).to_contain_text("budget = 0: expected greater than or equal to 1")
    page.locator("#design-budget").fill("6")
    page.locator("#design-scenarios").fill("push pusch")
    expect(mistake).to_contain_text("did you mean 'push'")
    page.locator("#design-scenarios").fill("push")
    expect(command(page)).to_contain_text(f"--budget 6 -o {planned} --scenarios push")
    stub.tells(results={prepared / "plans" / "plan_1.yaml": planned})
    start(page, "Plan the trials")
    expect(page.locator("#design-output")).to_have_value("plans/plan_2.yaml")  # what is there is not written over
    expect(page.locator("#planned tbody td")).to_have_text(["2", "push of parcel", "distinguish a from b"])
    expect(page.locator("#pairs tbody td")).to_have_text(["a", "b", "50.0 %", "90.0 %"])
    assert ordered(page, "Run the plan") == {
        "command": "campaign",
        "plan": "plans/plan_1.yaml",
        "output": "campaigns/plan_1",
    }


def ordered(page: Page, label: str) -> dict[str, object]:
    """What a button orders, which is not done."""
    page.route("**/api/jobs", lambda route: route.abort())
    with page.expect_request("**/api/jobs") as asked:
        page.get_by_role("button", name=label).click()
    order: dict[str, object] = asked.value.post_data_json
    return order


# ---- results --------------------------------------------------------------------------------------------------------


DRAWN = """() => [...document.querySelectorAll('.js-plotly-plot')].filter((node) => node.offsetWidth > 0)
    .map((node) => [node._fullLayout.width, node._fullLayout.height, node.clientWidth, node.clientHeight])"""


def test_a_figure_keeps_its_height_when_the_window_is_resized(visit: Visit, full: Path) -> None:
    page = visit("compare")
    expect(page.locator("#compare-result .js-plotly-plot .main-svg").first).to_be_visible()
    before = [height for _, height, *_ in page.evaluate(DRAWN)]
    assert before
    for width in (820, 400, 1280):
        page.set_viewport_size({"width": width, "height": 800})
        page.wait_for_function(f"() => ({DRAWN})().every(([width, , place]) => Math.abs(width - place) < 1.5)")
        sizes = page.evaluate(DRAWN)
        assert [height for _, height, *_ in sizes] == before
        assert all(place >= height - 1 for _, height, _, place in sizes)  # nothing below is covered


DRAWN_IN_PALETTE = """async (colour) => {
    const {draw, plotPlace} = await import('/static/figures.js'), node = plotPlace('');
    document.body.append(node);
    const layout = {annotations: [{text: 'x', font: {color: colour}}]};
    await draw(node, {data: [{y: [1, 2], line: {color: colour}}], layout});
    return [node.data[0].line.color, node.layout.annotations[0].font.color];
}"""


def test_a_figure_has_the_colours_of_the_palette_on_a_dark_page(visit: Visit) -> None:
    """Kills a text or a curve that keeps its dark colour, which is hardly seen there."""
    page = visit("add", color_scheme="dark")
    dark = dict(re.findall(r"--figure-([0-9a-f]{6}): (#[0-9a-f]{6})", PALETTE.read_text(encoding="utf-8")))
    assert page.evaluate(DRAWN_IN_PALETTE, "#555555") == [dark["555555"]] * 2
    assert page.evaluate(DRAWN_IN_PALETTE, "#0072B2") == [dark["0072b2"]] * 2
    assert page.evaluate(DRAWN_IN_PALETTE, "#E69F00") == ["#E69F00"] * 2


def test_a_place_of_a_comparison_has_its_signal_and_its_moment_in_the_replay(visit: Visit, full: Path) -> None:
    """The newest place, also where it is chosen while the signals of the report are still being read."""
    page = visit("compare")
    replay, places, signal = page.locator("#compare-result .replays"), page.locator("#cell option"), "#signal"
    expect(replay.locator(".replay-time")).to_contain_text("the impact")
    assert page.locator("#compare-result details[open] iframe").count() == 0
    held = Held(page, "**/files/**")
    for index in (1, 0):
        page.select_option("#cell", str(index))
    held.wait_for(1)
    expect(page.locator(signal)).to_be_empty()
    held.let_go()
    expect(page.locator(f"{signal} .scatterlayer .trace")).to_have_count(3)  # measured, model, residual
    expect(page.locator(f"{signal} .note")).to_contain_text((places.first.text_content() or "").partition(",")[0])
    expect(replay.locator(".replay-time")).to_have_text(re.compile(rf"^{reports.IMPACT:.3f} s"))
    page.locator("#compare-result .plot .nsewdrag").last.click()  # a cell of the other run
    expect(page.locator(f"{signal} .scatterlayer .trace")).to_have_count(3)


CURSOR_TIME = """() => {
    const plot = document.querySelector('#recorded-shown .plot'), {xaxis} = plot._fullLayout;
    const left = (node) => node.getBoundingClientRect().left, width = plot._fullLayout.width;
    return [xaxis.p2d(left(plot.querySelector('.cursor')) + 1 - left(plot) - xaxis._offset), width];
}"""


def test_a_recorded_trial_opens_in_3d_with_one_click(visit: Visit, full: Path) -> None:
    """Drawn with WebGL; the time of the bodies is the line in every figure, also in one that has another width."""
    page = visit("compare", webgl=True)
    page.locator("[data-entry='campaign campaigns/push']").click()
    trial = page.locator("#recorded-trials button").first
    trial.click()
    expect(page.locator("#recorded-shown h3").first).to_contain_text(trial.get_attribute("data-trial") or "")
    expect(page.locator("#recorded-replay canvas")).to_be_visible()
    cursor = page.locator("#recorded-shown .plot .cursor").first
    expect(cursor).to_be_visible()
    now = page.evaluate(CURSOR_TIME)
    page.set_viewport_size({"width": 900, "height": 800})
    page.wait_for_function(
        f"([time, width]) => {{ const [now, narrow] = ({CURSOR_TIME})();"
        " return narrow < width - 50 && Math.abs(now - time) < 0.01; }",
        arg=now,
    )
    before = cursor.bounding_box()
    page.locator("#recorded-replay input[type=range]").focus()
    page.keyboard.press("Home")
    page.wait_for_function(
        "(left) => document.querySelector('#recorded-shown .plot .cursor').getBoundingClientRect().left < left",
        arg=(before or {})["x"],
    )
    page.set_viewport_size({"width": 1280, "height": 1100})
    page.get_by_role("button", name="Impact", exact=True).click()
    picture(page, "workbench_trial")


def test_a_diagnosis_is_ranked_and_asks_for_a_law_where_no_effect_explains_what_is_left(
    visit: Visit, full: Path
) -> None:
    """Each effect with its error beside the other chosen ones and with all; a law by the options of the diagnosis."""
    options = {"runs": str(full / "campaigns" / "push"), "since": "push/parcel", "effects": ["gap"]}
    (full / "reports" / "open").mkdir()
    write_document(
        reports.diagnosed(verdict="NONE-EXPLAINS", named=(), options=options), full / "reports/open/diagnosis.json"
    )
    page = visit("diagnose")
    page.select_option("#diagnose-file", "reports/diagnosed/diagnosis.json")
    rows = page.locator("#ranking tbody tr")
    expect(rows.filter(has_text="object_mass").first).to_contain_text("61.8 → 1.3")
    expect(rows.filter(has_text="base_tilt")).to_contain_text("1.3 → 60.2")  # beside the chosen ones
    expect(page.locator("#law")).to_have_count(0)
    expect(page.locator("#diagnose-result a")).to_have_count(1)
    page.select_option("#diagnose-file", "reports/open/diagnosis.json")
    expect(page.locator("#law")).to_be_visible()
    expect(page.locator("#diagnose-result a")).to_have_count(0)  # no report was written beside it: none is offered
    order = ordered(page, "Look for a law")
    assert (order["command"], order["runs"]) == ("discover", "campaigns/push")
    assert (order["since"], order["effects"]) == ("push/parcel", ["gap"])
    assert (order["report"], order["output"]) == ("reports/open", "reports/open/discovery.json")


def test_what_a_practice_campaign_hid_is_revealed_beside_the_estimate(visit: Visit, full: Path) -> None:
    """Right for its own diagnosis; and a campaign without a diagnosis says what to do."""
    hidden = {"name": "object_mass", "parameters": {"mass": {"value": 1.1, "unit": "kg"}}}
    truth = json.dumps({"kind": "single", "effects": [hidden], "outside": None})
    for name in ("blind", "later"):
        (full / name / "runs").mkdir(parents=True)
        (full / name / "truth.json").write_text(truth)
    shutil.move(full / "campaigns" / "push" / "cat_food__case_2__s1.000__r0", full / "blind" / "runs")
    named = reports.diagnosed(verdict="object_mass", named=("object_mass",))
    own = named.runs.model_copy(update={"digest": runs_digest(full / "blind" / "runs")})
    write_document(named.model_copy(update={"runs": own}), full / "reports" / "diagnosed" / "diagnosis.json")
    page = visit("measure/blind")
    revealed, refused = page.locator("[data-practice=blind]"), page.locator("[data-practice=later]")
    revealed.get_by_role("button", name="Reveal").click()
    expect(revealed.locator("[data-correct]")).to_have_attribute("data-correct", "true")
    expect(revealed.locator("tbody td")).to_have_text(["mass [kg]", "1.1", "1.1", "1.08 … 1.12", "✓"])
    expect(revealed.locator(".command")).to_contain_text("blind score")
    refused.get_by_role("button", name="Reveal").click()
    expect(refused.locator(".error")).to_contain_text("diagnose them first")
    accessible(page)
    go(page, "diagnose")
    page.select_option("#diagnose-file", "reports/diagnosed/diagnosis.json")
    page.locator("#reveal").click()
    expect(page.locator("#revealed [data-correct]")).to_have_attribute("data-correct", "true")


def test_runs_are_chosen_filtered_and_pinned_over_each_other(visit: Visit, full: Path) -> None:
    page = visit("overlay")
    plot, rows = page.locator("#overlay-plot"), page.locator("#overlay-runs-list li[data-key]")
    traces, buttons = plot.locator(".scatterlayer .trace"), page.locator("#part-overlay-runs").get_by_role("button")
    expect(traces).to_have_count(3)
    page.locator("#overlay-runs-filter").fill("cat s1.2")
    expect(rows).to_have_count(1)
    buttons.get_by_text("Choose none").click()
    rows.locator("button").click()  # pinned, and thereby chosen
    expect(traces).to_have_count(1)
    page.locator("#overlay-runs-filter").fill("s1.0")
    buttons.get_by_text("Choose all below").click()
    expect(traces).to_have_count(2)
    expect(rows.first).to_contain_text("s1.2")
    page.locator("#overlay-runs-filter").fill("")
    expect(rows).to_have_count(3)
    shown = plot.get_attribute("data-shown")
    page.reload()  # what was chosen and pinned is still so
    expect(plot).to_have_attribute("data-shown", shown or "")
    expect(rows.first.locator("button")).to_have_attribute("aria-pressed", "true")
    expect(rows.first).to_contain_text("s1.2")
    go(page, "overlay", "overlay-models")
    expect(page.locator("#overlay-models-plot .scatterlayer .trace")).to_have_count(2)  # a comparison, and measured
    go(page, "overlay", "overlay-estimates")
    expect(page.locator("#overlay-estimates .scatterlayer .trace").first).to_be_attached()
    expect(page.locator("#overlay-parameter")).to_have_value(re.compile("object_mass"))  # what was named comes first
    expect(page.locator("#part-overlay-estimates .note")).to_contain_text("1 diagnosis")


def kept_runs(folder: Path) -> list[str]:
    """Runs that the server has kept as chosen."""
    file = folder / ".workbench" / "overlay.json"
    chosen: list[str] = (json.loads(file.read_text())["runs"] or {"chosen": []})["chosen"] if file.exists() else []
    return chosen


def test_a_choice_is_kept_where_the_page_is_left_at_once(
    visit: Visit, full: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also one that waits for an earlier one: kills a pause before the post, and a post that ends with its page."""
    left = threading.Event()

    def slow(path: Path, text: str) -> None:
        left.wait(PATIENCE)
        write_whole(path, text)

    monkeypatch.setattr(kept_choices, "write_whole", slow)
    page = visit("overlay")
    rows = page.locator("#overlay-runs-list li[data-key]")
    expect(page.locator("#overlay-plot .scatterlayer .trace")).to_have_count(3)
    last = rows.nth(1).get_attribute("data-key")
    rows.nth(0).get_by_role("checkbox").uncheck()
    rows.nth(2).get_by_role("checkbox").uncheck()
    page.reload()
    left.set()
    until(lambda: kept_runs(full) == [last], lambda: time.sleep(0.05), str(kept_runs(full)))


def test_choices_are_kept_one_after_the_other(visit: Visit, full: Path) -> None:
    """The newest one, also where an earlier post is slow: kills posts that overtake each other."""
    page = visit("overlay")
    rows = page.locator("#overlay-runs-list li[data-key]")
    expect(page.locator("#overlay-plot .scatterlayer .trace")).to_have_count(3)
    held = Held(page, "**/api/choices")
    rows.nth(0).get_by_role("checkbox").uncheck()
    rows.nth(2).get_by_role("checkbox").uncheck()
    held.answer_last_of(1)
    page.evaluate(FRAMES, 6)
    held.let_go()
    last = rows.nth(1).get_attribute("data-key")
    until(lambda: kept_runs(full) == [last], lambda: page.evaluate("1"), str(kept_runs(full)))


def test_a_folder_of_recordings_is_described_from_lists_and_becomes_a_comparison(visit: Visit, tmp_path: Path) -> None:
    """Numbers of a preview are compared in test_recording_description.py."""
    topics = {"/mocap/box/pose": "/mocap/parcel/pose"}
    BagFormat(topics=topics).write(tmp_path / "lab" / "parcel_1", Signals.known())
    page = visit("compare")
    page.locator("[data-entry='lab lab']").click()
    part = page.locator("#part-laboratory")
    velocity, pose = part.locator("[data-lab-signal=velocity]"), part.locator("[data-lab-signal=object_pose]")
    expect(velocity.locator("p")).to_contain_text("1000 Hz; from")
    velocity.get_by_label("unit").select_option("deg/s")
    expect(velocity.locator("p")).to_have_class("error")
    velocity.get_by_label("unit").select_option("rad/s")
    expect(velocity.locator("p")).to_have_class("note")
    expect(part.locator("[data-lab-signal] .plot .xy .scatterlayer")).to_have_count(5)  # four of the arm, one object
    expect(part.locator("[data-lab-signal] .error")).to_have_count(0)
    expect(page.get_by_label("object of parcel_1")).to_have_value("parcel")  # as it is called
    in_metres = pose.locator("p").inner_text()
    pose.get_by_label("unit").select_option("mm")
    expect(pose.locator("p")).not_to_have_text(in_metres)  # the new preview is there, and moves no button any more
    page.locator("#lab-save").click()
    expect(part.locator(".message .error")).to_contain_text("parcel_1: the centre of 'parcel' is first at")
    pose.get_by_label("unit").select_option("m")
    expect(pose.locator("p")).to_have_text(in_metres)
    page.locator("#lab-save").click()
    expect(page.locator("#lab-written")).to_contain_text("lab/experiment.yaml, lab/mapping.yaml, lab/runs.csv")
    part.get_by_role("button", name="Compare").click()
    expect(page.locator("#compare-runs")).to_have_value("lab")
    expect(page.locator("#compare-experiment")).to_have_value("lab/experiment.yaml")
    expect(command(page)).to_contain_text(f"compare {tmp_path}/lab -o")


def test_files_are_imported_and_their_impacts_followed(visit: Visit, stub: Stub, tmp_path: Path) -> None:
    """What a job prints stands below its form; a table of impacts leads to the forms that take it."""
    (tmp_path / "raw").mkdir()
    (tmp_path / "raw" / "run_1.csv").write_text("time,q1\n0,1\n")
    described, table = tmp_path.parent / f"{tmp_path.name}.yaml", tmp_path.parent / f"{tmp_path.name}.csv"
    described.write_text("scenario: push\nmapping: joint_state\n")
    table.write_text("run,vx_before [m/s],vx_after [m/s]\n")
    page = visit("laboratory/import")
    page.get_by_label("raw", exact=True).check()
    page.select_option("#import-robot", "franka_fer")
    expect(command(page)).to_contain_text(f"import {tmp_path}/raw --robot franka_fer -o {tmp_path}/raw")
    stub.tells(prints="2 runs, 0 of them hits", results={described: tmp_path / "raw" / "experiment.yaml"})
    start(page, "Look at the files")
    expect(page.locator("[data-printed=import] pre")).to_contain_text("2 runs, 0 of them hits")
    expect(go(page, "laboratory", "impacts")).to_contain_text(
        f"impacts {tmp_path}/raw --experiment {tmp_path}/raw/experiment.yaml -o {tmp_path}/impacts"
    )
    stub.tells(prints="2 impacts of 2 runs", results={table: tmp_path / "impacts" / "raw.csv"})
    start(page, "Find the impacts")
    expect(page.locator("[data-printed=impacts] pre")).to_contain_text("2 impacts of 2 runs")
    page.locator("[data-table='impacts/raw.csv']").get_by_role("button", name="Follow").click()
    expect(command(page)).to_contain_text(re.compile("follow .*-o .*models/followed_1.yaml --state .*/raw.npz"))
    expect(command(page)).to_contain_text(f"--impacts {tmp_path}/impacts/raw.csv --scenario push")
    assert page.locator("[data-entry='lab impacts']").count() == 0  # a table of impacts is no recording
