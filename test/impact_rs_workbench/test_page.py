# SPDX-License-Identifier: Apache-2.0
"""The page as a person uses it: the loop by mouse and keyboard in a headless browser, files as the only memory.

Waits are for what shall be there, never for time.
"""

from __future__ import annotations

import json
import os
import re
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from axe_playwright_python.sync_playwright import Axe
from mixed_grab import FILE
from playwright.sync_api import Browser, Page, Route, ViewportSize, expect, sync_playwright

from impact_rs_cli.main import main
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.reader import TrialBag

BROWSER = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
pytestmark = pytest.mark.skipif(BROWSER is None, reason="no chromium or chrome on this machine")
SLOW = 300_000.0  # ms, for a job on a machine with other work
expect.set_options(timeout=60_000.0)
DESK: ViewportSize = {"width": 1280, "height": 800}
IMAGES = Path(__file__).resolve().parents[2] / "docs" / "images"


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with sync_playwright() as playwright:
        made = playwright.chromium.launch(executable_path=BROWSER, args=["--no-sandbox"])
        yield made
        made.close()


@pytest.fixture(scope="module")
def address(
    served: Callable[[Path], str], hidden_campaign: Path, tmp_path_factory: pytest.TempPathFactory
) -> tuple[str, Path]:
    """A workbench with a small campaign that hides an effect, and its folder."""
    folder = tmp_path_factory.mktemp("loop") / "workbench"
    shutil.copytree(hidden_campaign, folder / "blind" / "runs")
    return served(folder), folder


@contextmanager
def opened(browser: Browser, address: str) -> Iterator[Page]:
    """A page that asks nobody else for anything and throws no error."""
    context = browser.new_context(viewport=DESK)
    made = context.new_page()
    made.set_default_timeout(60_000.0)
    elsewhere: list[str] = []
    errors: list[str] = []
    home = re.match(r"http://[^/]+", address)
    assert home is not None
    made.on(
        "request", lambda sent: None if sent.url.startswith((home[0], "data:", "blob:")) else elsewhere.append(sent.url)
    )
    made.on("pageerror", lambda error: errors.append(str(error)))
    made.goto(address)
    expect(made.locator("#predict-plot")).to_have_attribute("data-shown", re.compile("."))
    yield made
    context.close()
    assert not elsewhere
    assert not errors


@pytest.fixture
def page(browser: Browser, address: tuple[str, Path]) -> Iterator[Page]:
    with opened(browser, address[0]) as made:
        yield made


@pytest.fixture(scope="module")
def one_page(browser: Browser, address: tuple[str, Path]) -> Iterator[Page]:
    with opened(browser, address[0]) as made:
        yield made


@pytest.fixture
def looked_at(one_page: Page) -> Page:
    """The page of all tests that look at it, at other sizes and in other colours, and tell it nothing."""
    one_page.set_viewport_size(DESK)
    one_page.emulate_media(color_scheme="light")
    one_page.locator("[data-step=predict]").click()
    return one_page


def job(page: Page, state: str | int = 0) -> None:
    """Wait until the newest job has ended so."""
    expect(page.locator("#job-list > li").first).to_have_attribute("data-state", str(state), timeout=SLOW)


def start(page: Page, label: str) -> None:
    """Start a job with the button of the step, and wait until it shows."""
    count = page.locator("#job-list > li[data-job]").count()
    page.locator("main form:visible").get_by_role("button", name=label, exact=True).click()
    expect(page.locator("#job-list > li[data-job]")).to_have_count(count + 1)


def picture(page: Page, name: str, folder: Path) -> None:
    """What the manual shows: into its folder where IMPACT_RS_PICTURES is set, else beside the workbench."""
    target = IMAGES if os.environ.get("IMPACT_RS_PICTURES") else folder.parent
    page.evaluate("scrollTo(0, 0)")
    page.screenshot(path=target / f"{name}.png", animations="disabled")


def test_a_slider_moved_with_the_keyboard_moves_the_prediction_and_its_command(
    page: Page, address: tuple[str, Path]
) -> None:
    before = page.locator("#predict-table tr.main td").nth(2).inner_text()
    page.locator("[data-key='contact.restitution']").focus()
    for _ in range(40):
        page.keyboard.press("ArrowRight")
    expect(page.locator("#predict-plot")).to_have_attribute("data-shown", '{"contact.restitution":0.2}')
    expect(page.locator(".command code").first).to_contain_text("--set contact.restitution=0.2")
    assert page.locator("#predict-table tr.main td").nth(2).inner_text() != before
    expect(page.locator("#right h2")).to_have_text("restitution e")  # what the selected thing is
    expect(page.locator("#predict-plot .scatterlayer .trace")).to_have_count(
        7
    )  # band, three lines, object, two in the legend
    picture(page, "workbench", address[1])


def test_a_button_stays_under_a_click_while_its_command_is_told(page: Page, address: tuple[str, Path]) -> None:
    page.locator("[data-step=history]").click()
    button = page.locator("main form:visible").get_by_role("button", name="Show the history", exact=True)
    told = page.locator("main form:visible .message")
    page.select_option("#history-runs", "blind/runs")
    expect(told.locator("code")).to_contain_text("history")
    place = button.bounding_box()
    page.locator("#history-output").fill("reports/" + 60 * "long_")  # a command of several lines
    expect(told.locator("code")).to_contain_text("long_long")
    assert button.bounding_box() == place


@pytest.mark.timeout(900)
def test_the_whole_loop_by_mouse_names_the_hidden_effect_and_the_error_falls(
    page: Page, address: tuple[str, Path]
) -> None:
    page.locator("[data-step=compare]").click()
    page.select_option("#compare-runs", "blind/runs")
    page.locator("#compare-output").fill("reports/first")
    start(page, "Compare")
    job(page)
    expect(page.locator("#compare-result .answer")).to_contain_text("Residual of model 'nominal' in 6 trials")
    heat_map = page.locator("#compare-result .plot .nsewdrag").last
    heat_map.click()
    expect(page.locator("#signal .scatterlayer .trace")).to_have_count(3)  # measured, model, residual
    picture(page, "workbench_compare", address[1])

    page.locator("[data-step=diagnose]").click()
    page.select_option("#diagnose-runs", "blind/runs")
    page.locator("#diagnose-effects").fill("support_friction")
    page.locator("#diagnose-output").fill("reports/diagnosis")
    start(page, "Diagnose")
    job(page)
    expect(page.locator("#verdict")).to_contain_text("Model 'nominal' lacks support_friction.")
    expect(page.locator("#ranking tr.main")).to_contain_text("CONFIRMED")

    page.locator("#ranking tr.main button").click()
    expect(page.locator("#add-effect")).to_have_value("support_friction")
    start(page, "Add the effect")
    job(page)
    expect(page.locator("#models .tree")).to_contain_text("support_friction")

    page.locator("[data-step=history]").click()
    page.select_option("#history-model", "models/model_2.yaml")
    page.locator("#history-output").fill("reports/history")
    start(page, "Show the history")
    job(page)
    expect(page.frame_locator("#history-result iframe").locator("td", has_text="model_2")).to_be_visible()
    history = json.loads((address[1] / "reports" / "history" / "history.json").read_text())["history"]
    assert history[1]["error_fit"] < 0.5 * history[0]["error_fit"]
    expect(page.locator("#models .tree small").last).to_contain_text("held out")


def figures(page: Page) -> list[list[float]]:
    """Of every figure that is seen: width and height that it is drawn with, and those of its place."""
    found: list[list[float]] = page.evaluate(
        """() => [...document.querySelectorAll('.js-plotly-plot')].filter((node) => node.offsetWidth > 0)
            .map((node) => [node._fullLayout.width, node._fullLayout.height, node.clientWidth, node.clientHeight])"""
    )
    return found


@pytest.fixture(scope="module")
def reported(address: tuple[str, Path], diagnosed: Path, hidden_campaign: Path) -> Path:
    """The folder with a comparison and a diagnosis in it, of 'nominal' and of one more model."""
    folder = address[1]
    told = main(["compare", str(hidden_campaign), "-o", str(folder / "reports" / "seen"), "--jobs", "1"])
    assert told == 0
    (folder / "reports" / "diagnosed").mkdir()
    shutil.copy(diagnosed, folder / "reports" / "diagnosed" / "diagnosis.json")
    return folder


@pytest.mark.parametrize(("step", "count"), [("compare", 2), ("diagnose", 1)])
def test_a_figure_keeps_its_height_and_covers_nothing_when_the_window_is_resized(
    page: Page, reported: Path, step: str, count: int
) -> None:
    page.locator(f"[data-step={step}]").click()
    chosen = {"compare": "reports/seen/compare.html", "diagnose": "reports/diagnosed/diagnosis.json"}[step]
    page.select_option({"compare": "#compare-report", "diagnose": "#diagnose-file"}[step], chosen)
    expect(page.locator(f"#{step}-result .js-plotly-plot .main-svg").first).to_be_visible()
    before = [height for _, height, *_ in figures(page)]
    assert len(before) >= count
    for width in (820, 400, 1280):
        page.set_viewport_size({"width": width, "height": 800})
        page.wait_for_function(
            """() => [...document.querySelectorAll('.js-plotly-plot')].filter((node) => node.offsetWidth > 0)
                .every((node) => Math.abs(node._fullLayout.width - node.clientWidth) < 1.5)"""
        )
        for (drawn_width, drawn, place_width, place), height in zip(figures(page), before, strict=True):
            assert abs(drawn_width - place_width) < 1.5
            assert drawn == height
            assert place >= drawn - 1
    if step == "diagnose":
        page.locator("#ranking button").first.click()  # nothing lies on it
        expect(page.locator("[data-step=add]")).to_have_attribute("aria-current", "step")


def test_measure_this_opens_a_campaign_of_what_was_predicted_at_the_first_click(page: Page) -> None:
    page.select_option("#predict-object", "juice")
    page.select_option("#predict-case", "case_3")
    page.get_by_role("button", name="Measure this").click()
    told = page.locator("#part-campaign .command code")
    expect(told).to_contain_text("--objects juice --cases case_3")
    expect(told).to_contain_text("campaign push -o")
    expect(told).to_contain_text("push_juice")


def test_a_campaign_as_it_is_offered_can_be_analysed_and_says_how_much_it_is(page: Page) -> None:
    page.locator("[data-step=measure]").click()
    told = page.locator("#part-campaign .command code")
    expect(told).to_contain_text("--scales 0.8 0.9 1 1.1 1.2 --trials 2")
    expect(page.locator("#campaign-count")).to_have_text("10 trials.")
    for scale in ("0.8", "0.9", "1.1", "1.2"):
        page.locator("#part-campaign").get_by_label(scale, exact=True).uncheck()
    expect(page.locator("#campaign-count")).to_contain_text("2 trials. Analyze needs at least two references")


def test_a_campaign_without_an_object_is_refused_on_the_page(page: Page) -> None:
    page.locator("[data-step=measure]").click()
    button = page.get_by_role("button", name="Start the campaign")
    expect(button).to_be_enabled()
    checked = page.locator("#part-campaign fieldset").first.locator("input:checked")
    expect(checked).to_have_count(1)  # the form is filled in once the scenario has been read
    checked.uncheck()
    expect(page.locator("#part-campaign .message .error")).to_contain_text("objects = []: expected at least 1 of them")
    expect(button).to_be_disabled()
    expect(page.locator("#part-campaign .command")).to_have_count(0)


def test_a_scale_beyond_the_limit_of_trials_is_refused_on_the_page(page: Page) -> None:
    page.locator("[data-step=measure]").click()
    page.get_by_role("tab", name="Single trial").click()
    expect(page.locator("#part-trial .command code")).to_contain_text("impact-rs trial push")
    page.locator("#trial-scale").fill("9")
    expect(page.locator("#part-trial .message .error")).to_contain_text("expected a number > 0 and <= 3 [-]")
    expect(page.get_by_role("button", name="Run the trial")).to_be_disabled()
    page.locator("#trial-scale").fill("0.93")  # between two steps of the arrows
    expect(page.locator("#part-trial .command code")).to_contain_text("--scale 0.93")


class Held:
    """Answers of the server that are kept back until somebody lets them go."""

    def __init__(self, page: Page, pattern: str) -> None:
        self._routes: list[Route] = []
        page.route(pattern, lambda route: self._routes.append(route))
        self._page, self._pattern = page, pattern

    def let_go(self) -> None:
        """Answer what was asked."""
        for route in self._routes:
            route.continue_()
        self._routes.clear()
        self._page.unroute(self._pattern)

    def answer_last_of(self, count: int) -> None:
        """Answer the last question alone, once so many were asked."""
        while len(self._routes) < count:
            self._page.evaluate("1")  # hears of requests meanwhile
        self._routes.pop().continue_()


def test_what_is_asked_anew_shows_no_numbers_and_no_command_of_what_was_asked_before(page: Page) -> None:
    table, command = page.locator("#predict-table tbody tr"), page.locator("main > section:visible .command")
    expect(command).to_contain_text("cat_food")
    held = Held(page, "**/api/predict")
    page.select_option("#predict-object", "juice")
    expect(table).to_have_count(0)
    expect(command).to_have_count(0)
    expect(page.locator("#predict-facts")).to_have_text("Computing …")
    expect(page.locator("#predict-plot .scatterlayer")).to_have_count(0)
    held.let_go()
    expect(command).to_contain_text("juice")
    expect(table.first).to_be_visible()
    held = Held(page, "**/api/predict")
    page.locator("[data-key='contact.restitution']").focus()
    page.keyboard.press("ArrowRight")
    expect(page.locator("#predict-numbers")).to_be_hidden()  # of the slider as it was
    held.let_go()
    expect(page.locator("#predict-numbers")).to_be_visible()
    expect(command).to_contain_text("contact.restitution")


def test_a_form_that_changes_hides_the_command_of_the_form_as_it_was(page: Page) -> None:
    page.locator("[data-step=measure]").click()
    told = page.locator("#part-campaign .command code")
    expect(told).to_contain_text("--trials 2")
    held = Held(page, "**/api/command")
    page.get_by_label("repeats of each").fill("7")
    expect(told).to_be_hidden()
    held.let_go()
    expect(told).to_contain_text("--trials 7")
    expect(told).to_be_visible()


def test_history_opens_on_the_newest_model(page: Page, address: tuple[str, Path]) -> None:
    folder = address[1] / "family"
    folder.mkdir()
    for name, when in (("new", 4e9), ("old", 1e9)):
        (folder / f"{name}.yaml").write_text(f"name: {name}\neffects: []\n")
        os.utime(folder / f"{name}.yaml", (when, when))
    page.locator("[data-step=history]").click()
    expect(page.locator("#history-model")).to_have_value("family/new.yaml")
    page.select_option("#history-model", "nominal")
    (folder / "newer.yaml").write_text("name: newer\neffects: []\n")
    os.utime(folder / "newer.yaml", (4.1e9, 4.1e9))
    expect(page.locator("#history-model option[value='family/newer.yaml']")).to_be_attached()
    expect(page.locator("#history-model")).to_have_value("nominal")  # which somebody has chosen
    shutil.rmtree(folder)


def test_the_next_model_is_not_written_over_an_earlier_one(page: Page, address: tuple[str, Path]) -> None:
    page.locator("[data-step=add]").click()
    output = page.locator("#add-output")
    expect(output).to_have_value(re.compile("^models/model_[0-9]+.yaml$"))
    name = output.input_value()
    (address[1] / "models").mkdir(exist_ok=True)
    (address[1] / name).write_text("name: earlier\neffects: []\n")
    expect(output).not_to_have_value(name)
    expect(output).to_have_value(re.compile("^models/model_[0-9]+.yaml$"))
    (address[1] / name).unlink()


def test_names_and_notes_are_text_and_no_markup(page: Page, address: tuple[str, Path]) -> None:
    name = "<img src=x>&amp;"
    (address[1] / "m.yaml").write_text(json.dumps({"name": name, "effects": [], "note": "<b>bold</b>"}))
    button = page.locator("[data-entry='model m.yaml']")
    expect(button).to_contain_text(name)
    button.click()
    expect(page.locator("#right")).to_contain_text("<b>bold</b>")
    expect(page.locator("#right h2")).to_have_text(name)
    (address[1] / "m.yaml").unlink()


def test_an_earlier_command_that_is_answered_last_is_not_shown(page: Page) -> None:
    page.locator("[data-step=measure]").click()
    told = page.locator("#part-campaign .command code")
    expect(told).to_contain_text("--trials 2")
    held = Held(page, "**/api/command")
    for trials in ("7", "8"):
        with page.expect_request("**/api/command"):
            page.get_by_label("repeats of each").fill(trials)
    held.answer_last_of(2)
    expect(told).to_contain_text("--trials 8")
    with page.expect_response("**/api/command"):
        held.let_go()
    page.evaluate("() => fetch('/api/jobs').then((answer) => answer.json())")  # behind it in the queue
    assert "--trials 8" in told.inner_text()


def shown(page: Page, arm: str, signal: str) -> np.ndarray:
    """What the preview of a signal has drawn, ``(k, n)``."""
    plot = page.locator(f"[data-lab-arm={arm}] [data-lab-signal={signal}] .plot")
    expect(plot.locator(".scatterlayer .trace").first).to_be_attached()
    return np.array(plot.evaluate("node => node.data.map((trace) => [...trace.y])")).T


def accessible(page: Page) -> None:
    found = Axe().run(page).response["violations"]
    assert [(one["id"], one["nodes"][0]["html"]) for one in found] == []


@pytest.mark.timeout(600)
def test_a_folder_of_recordings_is_described_from_lists_and_compared(
    page: Page, address: tuple[str, Path], hidden_campaign: Path, rewrite_bag: Callable[..., None]
) -> None:
    trials = sorted((hidden_campaign / "push").glob("parcel*"))
    for number, trial in enumerate(trials, start=1):  # as others record: nothing of ours is in them
        kept = {topics.joint_states("arm"), topics.joint_command("arm"), topics.OBJECT_POSE}
        rewrite_bag(trial, address[1] / "lab" / f"parcel_{number}", kept.__contains__)
    expect(page.locator("#laboratories")).to_contain_text("2 recordings, not described")
    page.locator("#laboratories button").click()
    line = page.locator("[data-lab-signal=velocity] p")
    expect(line).to_contain_text("1000 Hz; from")
    measured = TrialBag.open(trials[0]).joints(topics.joint_states("arm"))
    seen = shown(page, "arm", "velocity")
    np.testing.assert_allclose(seen, measured.velocity[:: -(-len(measured.velocity) // 300)], rtol=1e-4, atol=1e-9)

    page.locator("[data-lab-signal=velocity]").get_by_label("unit").select_option("deg/s")
    expect(line).to_have_class("error")
    expect(line).to_contain_text("velocity is 0.0175 times the derivative of position, expected 1: wrong unit")
    np.testing.assert_allclose(shown(page, "arm", "velocity"), np.radians(seen), rtol=1e-3, atol=1e-9)
    page.locator("[data-lab-signal=velocity]").get_by_label("unit").select_option("rad/s")
    expect(line).to_have_class("note")
    joints = page.get_by_label("joints in order")
    names = joints.input_value()
    joints.fill(names.replace("joint7", "joint9"))
    joints.blur()
    expect(page.locator("[data-lab-signal=torque] p")).to_contain_text("joint arm_joint9 is missing; the message")
    joints.fill(names)
    joints.blur()
    expect(page.locator("[data-lab-signal] .plot .xy .scatterlayer")).to_have_count(5)  # four of the arm, one object
    expect(page.locator("[data-lab-signal] .error")).to_have_count(0)
    accessible(page)

    expect(page.get_by_label("object of parcel_1")).to_have_value("parcel")  # as it is called
    pose_unit = page.locator("[data-lab-signal=object_pose]").get_by_label("unit")
    pose_line = page.locator("[data-lab-signal=object_pose] p")
    in_metres = pose_line.inner_text()
    pose_unit.select_option("mm")
    expect(pose_line).not_to_have_text(in_metres)  # the new preview is there, and moves the button below it no more
    page.locator("#lab-save").click()
    expect(page.locator("#part-laboratory .message .error")).to_contain_text(
        "parcel_1: the centre of 'parcel' is first at"
    )
    pose_unit.select_option("m")
    expect(pose_line).to_have_text(in_metres)
    page.get_by_label("condition of parcel_2").fill("case_1")
    page.locator("#lab-save").click()
    expect(page.locator("#lab-written")).to_contain_text("lab/experiment.yaml, lab/mapping.yaml, lab/runs.csv")
    expect(page.locator("#laboratories")).to_contain_text("described")
    page.locator("#part-laboratory").get_by_role("button", name="Compare").click()
    expect(page.locator("#compare-runs")).to_have_value("lab")
    start(page, "Compare")
    job(page)
    expect(page.locator("#compare-result .answer")).to_contain_text("Residual of model 'nominal' in 2 trials")


def test_two_arms_of_different_kinds_are_predicted_and_described(
    page: Page, address: tuple[str, Path], mixed_trial: Path, rewrite_bag: Callable[..., None]
) -> None:
    shutil.copy(FILE, address[1] / "mixed_grab.yaml")
    rewrite_bag(mixed_trial, address[1] / "two" / "run_1", lambda topic: not topic.startswith(("/trial", "/truth")))
    expect(page.locator("#predict-scenario option[value='mixed_grab.yaml']")).to_be_attached()
    expect(page.locator("#predict-arm")).to_be_hidden()  # of one arm
    page.select_option("#predict-scenario", "mixed_grab.yaml")
    page.select_option("#predict-object", "parcel")
    page.select_option("#predict-arm", "right")
    expect(page.locator("#predict-facts")).to_contain_text("Impulse of the pads on the object left [")
    expect(page.locator("#predict-table tr.main td:first-child")).to_have_text(["left, z", "right, z", "object, z"])
    expect(page.locator("#predict-plot .scatterlayer .trace")).to_have_count(7)  # the map of the right arm
    expect(page.locator("#predict-plot .legendtext").nth(5)).to_have_text("right, here")
    place = page.locator("#predict-plot").evaluate(
        "node => node.layout.shapes.find((one) => one.type === 'circle').yanchor"
    )
    assert f"{place:.3f}" == page.locator("#predict-table tr.main td").nth(6).inner_text()
    page.locator("[data-key=speed]").focus()
    page.keyboard.press("ArrowLeft")
    expect(page.locator(".command code").first).to_contain_text("right.ante_velocity=")

    page.locator("[data-entry='lab two']").click()
    page.select_option("#lab-scenario", "mixed_grab.yaml")
    expect(page.locator("[data-lab-signal] .plot .xy .scatterlayer")).to_have_count(9)
    for arm, count in (("left", 7), ("right", 6)):
        torque = TrialBag.open(mixed_trial).joints(topics.joint_states(arm)).effort
        seen = shown(page, arm, "torque")
        assert seen.shape[1] == count
        np.testing.assert_allclose(seen, torque[:: -(-len(torque) // 300)], rtol=1e-4, atol=1e-9)
    effort = page.locator("[data-lab-arm=right] select[data-signal=torque]")
    effort.select_option("/left/joint_states: effort (7)")
    expect(page.locator("[data-lab-arm=right] .error")).to_contain_text("joint right_joint1 is missing")
    expect(page.locator("[data-lab-arm=left] .error")).to_have_count(0)
    effort.select_option("/right/joint_states: effort (6)")
    expect(page.locator("[data-lab-signal] .plot .xy .scatterlayer")).to_have_count(9)
    accessible(page)
    picture(page, "workbench_laboratory", address[1])
    page.locator("#lab-save").click()
    expect(page.locator("#lab-written")).to_contain_text("two/mapping_left.yaml, two/mapping_right.yaml")
    page.set_viewport_size({"width": 360, "height": 800})
    expect(page.locator("html")).to_have_js_property("scrollWidth", 360)


def test_a_job_that_fails_shows_its_one_line(page: Page, address: tuple[str, Path]) -> None:
    (address[1] / "models").mkdir(exist_ok=True)
    (address[1] / "campaigns").mkdir(exist_ok=True)
    (address[1] / "campaigns" / "taken").write_text("a file where the campaign wants its folder")
    page.locator("[data-step=measure]").click()
    page.locator("#campaign-output").fill("campaigns/taken")
    expect(page.locator("#part-campaign .command code")).to_contain_text("campaigns/taken")
    start(page, "Start the campaign")
    job(page, 2)
    expect(page.locator("#job-list .state").first).to_contain_text("✗ failed:")


@pytest.mark.timeout(600)
def test_a_page_that_is_loaded_again_and_a_second_tab_see_the_job_that_runs(page: Page) -> None:
    page.locator("[data-step=measure]").click()
    page.locator("#campaign-output").fill("campaigns/long")
    page.get_by_label("repeats of each").fill("40")
    expect(page.locator("#part-campaign .command code")).to_contain_text("--trials 40")
    start(page, "Start the campaign")
    expect(page.locator("#job-list progress").first).to_have_attribute("value", re.compile("[1-9]"), timeout=SLOW)
    page.reload()
    expect(page.locator("#job-list > li").first).to_have_attribute("data-state", "running")
    other = page.context.new_page()
    other.goto(page.url)
    expect(other.locator("#job-list > li").first).to_have_attribute("data-state", "running")
    expect(other.locator("#part-campaign .command code")).to_contain_text("impact-rs campaign")  # nothing moves now
    stop = other.locator("#job-list > li").first.get_by_role("button", name="Stop")
    stop.hover()
    other.mouse.down()
    done = other.locator("#job-list progress").first.get_attribute("value")
    assert done is not None
    expect(other.locator("#job-list progress").first).not_to_have_attribute("value", done, timeout=SLOW)
    other.mouse.up()  # a slow click, while the job has gone on
    job(page, 130)
    expect(page.locator("#job-list .state").first).to_contain_text("■ stopped: interrupted; the same command goes on")
    expect(page.locator("#campaigns")).to_contain_text("campaigns/long")
    other.close()


def test_a_formula_is_checked_while_it_is_written(page: Page, address: tuple[str, Path]) -> None:
    page.locator("[data-step=add]").click()
    expect(page.locator("#formula-check")).to_contain_text("end_effector_force.y: gives N")
    page.locator("#formula").fill(page.locator("#formula").input_value().replace("N s/m", "N m"))
    expect(page.locator("#formula-check .error")).to_contain_text("expected N")
    page.locator("#formula").fill(page.locator("#formula").input_value().replace("N m", "N s/m"))
    expect(page.locator("#formula-check .good")).to_contain_text("cable_drag")
    page.get_by_role("button", name="Save the formulas").click()
    expect(page.locator("#formula-check")).to_contain_text("Saved as formulas/mine.yaml.")
    page.locator("[data-step=diagnose]").click()
    expect(page.locator("#diagnose-formulas option")).to_have_count(2)
    assert (address[1] / "formulas" / "mine.yaml").exists()


@pytest.mark.parametrize("width", [360, 820, 1280])
def test_nothing_is_wider_than_the_screen_of_a_phone_a_tablet_or_a_laptop(looked_at: Page, width: int) -> None:
    looked_at.set_viewport_size({"width": width, "height": 800})
    for step in ("predict", "measure", "compare", "diagnose", "add", "history"):
        looked_at.locator(f"[data-step={step}]").click()
        expect(looked_at.locator("main > section:visible h2").first).to_be_visible()
        expect(looked_at.locator("html")).to_have_js_property("scrollWidth", width)


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_axe_finds_nothing_that_keeps_anybody_out(looked_at: Page, scheme: Literal["light", "dark"]) -> None:
    """Names, roles, order of headings, contrast: the rules of axe-core, step by step."""
    looked_at.emulate_media(color_scheme=scheme)
    for step in ("predict", "measure", "compare", "diagnose", "add", "history"):
        looked_at.locator(f"[data-step={step}]").click()
        expect(looked_at.locator("main > section:visible h2").first).to_be_visible()
        found = Axe().run(looked_at).response["violations"]
        assert [(one["id"], one["nodes"][0]["html"]) for one in found] == [], step


def test_every_control_has_a_name_and_the_manual_opens_by_keyboard(looked_at: Page) -> None:
    nameless = looked_at.evaluate(
        """() => [...document.querySelectorAll('input, select, textarea, button')]
            .filter((node) => !(node.labels?.length || node.ariaLabel || node.textContent.trim()))
            .map((node) => node.outerHTML)"""
    )
    assert nameless == []
    looked_at.get_by_role("link", name="In the manual").focus()
    looked_at.keyboard.press("Enter")
    expect(looked_at.locator("#manual h1")).to_have_text("Physics")
    looked_at.keyboard.press("Escape")
    expect(looked_at.locator("#manual")).to_be_hidden()
