# SPDX-License-Identifier: Apache-2.0
"""The page as a person uses it: the loop by mouse and keyboard in a headless browser, files as the only memory.

Waits are for what shall be there, never for time. Numbers and commands are compared, and what carries them (``data-``
attributes, values of fields); sentences are the business of the page.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Literal

import pytest
import yaml
from axe_playwright_python.sync_playwright import Axe
from cell_investigations import about_to_move
from mixed_grab import FILE
from playwright.sync_api import Browser, Locator, Page, Request, Route, ViewportSize, expect, sync_playwright
from processes import until

from impact_rs_cli.main import main
from impact_rs_sim.scenario import load_scenario
from impact_rs_trials.bags import topics
from impact_rs_trials.experiment_plan import write_scenario

BROWSER = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
pytestmark = pytest.mark.skipif(BROWSER is None, reason="no chromium or chrome on this machine")
HIDDEN_FRICTION = 0.18  # of the support, in the campaign of the fixtures
SLOW = 300_000.0  # ms, for a job on a machine with other work
expect.set_options(timeout=60_000.0)
DESK: ViewportSize = {"width": 1280, "height": 800}
TABS = {  # of every step, as its own tests name them; where there are none, the step alone
    "predict": ("impact", "limits", "designs"),
    "measure": ("campaign", "trial", "design", "rehearse", "recorded", "live", "blind"),
    "laboratory": ("import", "laboratory", "impacts"),
    "compare": ("",),
    "diagnose": ("",),
    "add": ("",),
    "history": ("versions", "evidence"),
    "overlay": ("overlay-runs", "overlay-models", "overlay-estimates"),
    "investigate": ("loop", "follow"),
}
STEPS = tuple(TABS)
FRAMES = (
    "(count) => new Promise((done) => { const next = () => count-- ? requestAnimationFrame(next) : done(); next(); })"
)
IMAGES = Path(__file__).resolve().parents[2] / "docs" / "images"


class Held:
    """Answers of the server that come late; without a pattern none."""

    def __init__(self, page: Page, pattern: str) -> None:
        self._routes: list[Route] = []
        self._page, self._pattern = page, pattern
        if pattern:  # a route ends the cache of the browser
            page.route(pattern, lambda route: self._routes.append(route))

    def wait_for(self, count: int) -> None:
        """Until so many questions were asked."""
        while len(self._routes) < count:
            self._page.evaluate("1")  # hears of requests meanwhile

    def let_go(self) -> None:
        """Answer every question, and let the page paint."""
        for route in self._routes:
            route.fulfill(response=route.fetch())
        self._routes.clear()
        self._page.unroute(self._pattern)
        self._page.evaluate(FRAMES, 6)

    def answer_last_of(self, count: int) -> None:
        """Answer the last question alone, once so many were asked."""
        self.wait_for(count)
        self._routes.pop().continue_()


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


@pytest.fixture
def folder(address: tuple[str, Path]) -> Path:
    (address[1] / "models").mkdir(exist_ok=True)
    return address[1]


@contextmanager
def opened(browser: Browser, address: str, late: str = "") -> Iterator[tuple[Page, Held]]:
    """A page that asks no other server for anything and throws no error.

    ``late``: what it asks for at first and does not get; without it, the page has shown a prediction.
    """
    context = browser.new_context(viewport=DESK)
    made = context.new_page()
    made.set_default_timeout(60_000.0)
    elsewhere: list[str] = []
    errors: list[str] = []
    home = address.partition("/?")[0]
    made.on(
        "request", lambda sent: None if sent.url.startswith((home, "data:", "blob:")) else elsewhere.append(sent.url)
    )
    made.on("pageerror", lambda error: errors.append(str(error)))
    held = Held(made, late and f"**/{late}")
    made.goto(address)
    if late:
        held.wait_for(1)
    else:
        expect(made.locator("#predict-plot")).to_have_attribute("data-shown", re.compile("."))
    yield made, held
    context.close()
    assert elsewhere == errors == []


@pytest.fixture(scope="module")
def one_page(browser: Browser, address: tuple[str, Path]) -> Iterator[Page]:
    with opened(browser, address[0]) as (made, _):
        yield made


@pytest.fixture
def page(one_page: Page, address: tuple[str, Path]) -> Iterator[Page]:
    """The page as it begins; a new window would start a process and compile its libraries again."""
    one_page.evaluate("() => { localStorage.clear(); sessionStorage.clear(); }")
    one_page.goto("about:blank")
    one_page.set_viewport_size(DESK)
    one_page.emulate_media(color_scheme="light")
    one_page.goto(address[0])
    expect(one_page.locator("#predict-plot")).to_have_attribute("data-shown", re.compile("."))
    yield one_page
    one_page.unroute_all()


def go(page: Page, step: str, tab: str = "") -> Locator:
    """Open a step, or a tab of it; returns the command that its form shows."""
    page.locator(f"[data-step={step}]").click()
    if tab:
        page.locator(f"#tab-{tab}").click()
    return page.locator("main form:visible .command code")


def start(page: Page, label: str, state: str | int = 0) -> None:
    """Start a job with the button of the step, and wait until it is in a state; 0: done."""
    jobs = page.locator("#job-list > li[data-job]")  # the newest first, and no more than some
    last = int(jobs.first.get_attribute("data-job") or 0) if jobs.count() else 0
    page.locator("main form:visible").get_by_role("button", name=label, exact=True).click()
    expect(jobs.first).to_have_attribute("data-job", str(last + 1))
    expect(jobs.first).to_have_attribute("data-state", str(state), timeout=SLOW)


def pictures(folder: Path) -> Path:
    """Where pictures go: into the manual where IMPACT_RS_PICTURES is set, else beside the workbench."""
    return IMAGES if os.environ.get("IMPACT_RS_PICTURES") else folder.parent


def picture(page: Page, name: str, folder: Path) -> None:
    """A picture of the manual."""
    page.evaluate("scrollTo({top: 0, behavior: 'instant'})")
    page.screenshot(path=pictures(folder) / f"{name}.png", animations="disabled")


def accessible(page: Page) -> None:
    """Names, roles, order of headings, contrast: the rules of axe-core."""
    found = Axe().run(page).response["violations"]
    assert [(one["id"], one["nodes"][0]["html"]) for one in found] == []


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("step", STEPS)
def test_a_step_fits_every_screen_and_is_accessible(
    one_page: Page, step: str, scheme: Literal["light", "dark"]
) -> None:
    one_page.emulate_media(color_scheme=scheme)
    for tab in TABS[step] if scheme == "light" else TABS[step][:1]:  # the parts of all tabs have the same colours
        one_page.set_viewport_size(DESK)
        go(one_page, step, tab)
        expect(one_page.locator("main > section:visible h2").first).to_be_visible()
        for details in one_page.locator("main details.more:visible").all():
            details.evaluate("node => { node.open = true; }")
        accessible(one_page)
        for width in (360, 820, 1280):
            one_page.set_viewport_size({"width": width, "height": 800})
            expect(one_page.locator("html")).to_have_js_property("scrollWidth", width)


def test_the_first_two_lines_say_what_a_step_or_tab_is_and_what_comes_next(one_page: Page) -> None:
    """Each in its own words; what comes next is another place of the page, and the address leads back."""
    said = []
    for step, tabs in TABS.items():
        for tab in tabs:
            go(one_page, step, tab)
            lines = one_page.locator("main > section:visible .lead p")
            expect(lines).to_have_count(2)
            said.append(lines.first.inner_text())
            here, following = one_page.url, (lines.locator("a").get_attribute("href") or "").lstrip("#").split("/")
            lines.locator("a").click()
            expect(one_page.locator(f"[data-step={following[0]}]")).to_have_attribute("aria-current", "step")
            for name in following[1:]:
                expect(one_page.locator(f"main [data-part={name}]")).to_be_visible()
            assert one_page.url != here
            one_page.go_back()
            expect(lines.first).to_have_text(said[-1])
    assert all(said) and len(set(said)) == len(said)
    go(one_page, "predict", "impact")
    expect(one_page.locator("#right figure.term svg")).to_have_count(2)


@pytest.mark.parametrize("width", [360, 820, 1280])
def test_no_list_cuts_off_what_is_chosen(one_page: Page, width: int) -> None:
    """It is as wide as its text, or the text stands below it in full."""
    cut_off = """() => [...document.querySelectorAll('main label > select')].filter((node) => {
        const pen = document.createElement('canvas').getContext('2d'), text = node.selectedOptions[0]?.text ?? '';
        pen.font = getComputedStyle(node).font;
        const shown = node.parentElement.querySelector('small')?.textContent ?? '';
        return node.offsetWidth > 0 && pen.measureText(text).width + 30 > node.clientWidth && shown !== text;
    }).map((node) => node.id)"""
    one_page.set_viewport_size({"width": width, "height": 800})
    for step in STEPS:
        go(one_page, step)
        one_page.wait_for_function(f"() => !({cut_off})().length")
    one_page.set_viewport_size(DESK)


def test_jobs_are_in_sight_on_a_phone(one_page: Page) -> None:
    one_page.set_viewport_size({"width": 360, "height": 640})
    for step in STEPS:
        go(one_page, step)
        expect(one_page.locator("#jobs-toggle")).to_be_in_viewport()
    one_page.locator("#jobs-toggle").click()
    expect(one_page.locator("#job-list")).to_be_visible()
    one_page.locator("#jobs-toggle").click()
    expect(one_page.locator("#job-list")).to_be_hidden()
    one_page.set_viewport_size(DESK)


def test_arrow_keys_go_from_tab_to_tab(one_page: Page) -> None:
    go(one_page, "measure", "campaign")
    one_page.locator("#tab-campaign").focus()
    for key, tab in (
        ("ArrowRight", "trial"),
        ("End", "blind"),
        ("ArrowRight", "campaign"),
        ("ArrowLeft", "blind"),
    ):
        one_page.keyboard.press(key)
        expect(one_page.locator(f"#tab-{tab}")).to_be_focused()
        expect(one_page.locator(f"#part-{tab}")).to_be_visible()
    one_page.keyboard.press("Home")


def test_arrows_in_3d_are_the_velocities_of_the_table(page: Page) -> None:
    """Before and after of the arm in proportion, and the latter follows a slider."""
    lengths = """() => {
        const length = ({head, headLength, root}) => root.visible ? head.position.y + head.scale.y * headLength / 2 : 0;
        return impact_rs.predict.impact.picture.arrows.map((one) => [length(one.before), length(one.after)]);
    }"""
    expect(page.locator("#predict-scene")).to_have_attribute("data-shown", '["push","cat_food"]')
    before, after = (
        abs(float(page.locator("#predict-table tr.main td").nth(i).inner_text().replace("−", "-"))) for i in (1, 2)
    )
    arm, item = page.evaluate(lengths)
    assert arm[1] / arm[0] == pytest.approx(after / before, rel=0.02)
    assert item[0] == 0.0  # the object rests
    page.locator("[data-key='contact.restitution']").focus()
    for _ in range(100):
        page.keyboard.press("ArrowRight")
    expect(page.locator("#predict-plot")).to_have_attribute("data-shown", '{"contact.restitution":0.5}')
    page.wait_for_function(
        f"([arm, item]) => {{ const now = ({lengths})(); return now[0][1] < arm[1] && now[1][1] > item[1]; }}",
        arg=[arm, item],
    )


def test_every_control_has_a_name_and_the_manual_opens_by_keyboard(one_page: Page) -> None:
    one_page.set_viewport_size(DESK)
    nameless = """() => [...document.querySelectorAll('input, select, textarea, button')].filter((node) =>
        !(node.labels?.length || node.ariaLabel || node.textContent.trim())).map((node) => node.outerHTML)"""
    assert one_page.evaluate(nameless) == []
    go(one_page, "predict")
    one_page.get_by_role("link", name="In the manual").focus()
    one_page.keyboard.press("Enter")
    expect(one_page.locator("#manual h1")).to_have_text("Physics")
    one_page.keyboard.press("Escape")
    expect(one_page.locator("#manual")).to_be_hidden()


def test_a_slider_moved_by_keyboard_moves_prediction_and_command(page: Page, folder: Path) -> None:
    after = page.locator("#predict-table tr.main td").nth(2)
    before = after.inner_text()
    page.locator("[data-key='contact.restitution']").focus()
    for _ in range(40):
        page.keyboard.press("ArrowRight")
    expect(page.locator("#predict-plot")).to_have_attribute("data-shown", '{"contact.restitution":0.2}')
    expect(page.locator(".command code").first).to_contain_text("--set contact.restitution=0.2")
    assert after.inner_text() != before
    expect(page.locator("#right h2")).to_have_text("restitution e")
    expect(page.locator("#predict-plot .scatterlayer .trace")).to_have_count(7)  # band, 3 maps, object, 2 of the legend
    page.set_viewport_size({"width": 1280, "height": 1130})
    page.wait_for_function("() => document.querySelector('#predict-numbers').getBoundingClientRect().top < 1130")
    picture(page, "workbench", folder)
    page.set_viewport_size(DESK)


def test_a_found_model_is_predicted_with_the_model_that_is_chosen(page: Page, folder: Path) -> None:
    """Beside the sliders, and by a click on it on the left; when its file goes, the nominal model is back."""
    heavier = {"name": "object_mass", "parameters": {"scale": {"estimate": 1.6, "unit": "-"}}}
    file = folder / "heavier.yaml"
    file.write_text(json.dumps({"name": "heavier", "parent": "nominal", "effects": [heavier]}))
    after, command = page.locator("#predict-table tr.main td").nth(2), page.locator("section:visible .command code")
    nominal = after.inner_text()
    page.locator("[data-entry='model heavier.yaml']").click()
    expect(page.locator("#predict-model")).to_have_value("heavier.yaml")
    expect(command).to_contain_text("--model workbench/heavier.yaml")
    assert abs(float(after.inner_text().replace("−", "-"))) < abs(float(nominal.replace("−", "-"))) - 0.01
    file.unlink()
    expect(page.locator("#predict-model")).to_have_value("nominal")
    expect(command).not_to_contain_text("--model")
    expect(after).to_have_text(nominal)


def test_the_loop_by_mouse_names_the_effect_and_the_error_falls(page: Page, folder: Path) -> None:
    go(page, "compare")
    page.select_option("#compare-runs", "blind/runs")
    page.locator("#compare-output").fill("reports/first")
    start(page, "Compare")
    page.locator("#compare-result .plot .nsewdrag").last.click()
    expect(page.locator("#signal .scatterlayer .trace")).to_have_count(3)  # measured, model, residual
    page.set_viewport_size({"width": 1280, "height": 950})
    page.mouse.move(0, 0)
    page.locator("#compare-result .clickable").last.evaluate("node => node.scrollIntoView({behavior: 'instant'})")
    page.screenshot(path=pictures(folder) / "workbench_compare.png", animations="disabled")
    page.set_viewport_size(DESK)

    command = go(page, "diagnose")
    page.select_option("#diagnose-runs", "blind/runs")
    page.locator("#diagnose-effects").fill("support_friction")
    page.locator("#diagnose-report").fill("reports/diagnosis")
    expect(command).to_contain_text("-o workbench/reports/diagnosis/diagnosis.json")
    start(page, "Diagnose")
    expect(page.locator("#ranking tr.main")).to_contain_text("CONFIRMED")

    page.locator("#ranking tr.main button").click()
    expect(page.locator("#add-effect input:checked")).to_have_value("support_friction")
    start(page, "Add the effects")
    expect(page.locator("#models .tree")).to_contain_text("support_friction")

    go(page, "history")
    page.select_option("#history-model", "models/model_2.yaml")
    page.locator("#history-output").fill("reports/history")
    start(page, "Show the history")
    expect(page.frame_locator("#history-result iframe").locator("td", has_text="model_2")).to_be_visible()
    history = json.loads((folder / "reports" / "history" / "history.json").read_text())["history"]
    assert history[1]["error_fit"] < 0.5 * history[0]["error_fit"]


@pytest.fixture(scope="module")
def reported(address: tuple[str, Path], diagnosed: Path, hidden_campaign: Path) -> Path:
    """The folder with a comparison and a diagnosis in it, of 'nominal' and of one more model."""
    seen, found = address[1] / "reports" / "seen", address[1] / "reports" / "diagnosed"
    assert main(["compare", str(hidden_campaign), "-o", str(seen), "--jobs", "1"]) == 0
    found.mkdir()
    shutil.copy(diagnosed, found / "diagnosis.json")
    return address[1]


@pytest.mark.parametrize("step", ["compare", "diagnose"])
def test_a_figure_keeps_its_height_when_the_window_is_resized(page: Page, reported: Path, step: str) -> None:
    drawn = """() => [...document.querySelectorAll('.js-plotly-plot')].filter((node) => node.offsetWidth > 0)
        .map((node) => [node._fullLayout.width, node._fullLayout.height, node.clientWidth, node.clientHeight])"""
    go(page, step)
    chosen = {"compare": "reports/seen/compare.html", "diagnose": "reports/diagnosed/diagnosis.json"}[step]
    page.select_option({"compare": "#compare-report", "diagnose": "#diagnose-file"}[step], chosen)
    expect(page.locator(f"#{step}-result .js-plotly-plot .main-svg").first).to_be_visible()
    before = [height for _, height, *_ in page.evaluate(drawn)]
    assert before
    for width in (820, 400, 1280):
        page.set_viewport_size({"width": width, "height": 800})
        page.wait_for_function(f"() => ({drawn})().every(([width, , place]) => Math.abs(width - place) < 1.5)")
        sizes = page.evaluate(drawn)
        assert [height for _, height, *_ in sizes] == before
        assert all(place >= height - 1 for _, height, _, place in sizes)  # nothing below is covered
    if step == "diagnose":
        page.locator("#ranking button").first.click()
        expect(page.locator("[data-step=add]")).to_have_attribute("aria-current", "step")


def test_a_replay_of_a_report_stands_in_the_page_and_goes_to_the_chosen_place(page: Page, reported: Path) -> None:
    go(page, "compare")
    page.select_option("#compare-report", "reports/seen/compare.html")
    replay = page.locator("#compare-result .replays")
    expect(replay.locator("canvas")).to_be_visible()
    assert page.locator("#compare-result details[open] iframe").count() == 0
    page.locator("#compare-result .plot .nsewdrag").last.click()
    expect(page.locator("#signal .scatterlayer .trace")).to_have_count(3)
    expect(replay.locator(".replay-time")).to_contain_text(re.compile("[0-9] s"))
    larger = replay.get_by_label("size of what the model does differently")
    larger.select_option("10")
    replay.screenshot(path=pictures(reported) / "replay.png", animations="disabled")


def test_a_recorded_trial_opens_in_3d_with_one_click(page: Page, folder: Path) -> None:
    page.locator("[data-entry='campaign blind/runs/push']").click()
    trial = page.locator("#recorded-trials button").first
    name = trial.get_attribute("data-trial") or ""
    trial.click()
    expect(page.locator("#recorded-shown h3").first).to_contain_text(name)
    expect(page.locator("#recorded-replay canvas")).to_be_visible()
    expect(page.locator("#recorded-shown .plot .cursor").first).to_be_visible()
    before = page.locator("#recorded-shown .plot .cursor").first.bounding_box()
    page.locator("#recorded-replay input[type=range]").focus()
    page.keyboard.press("Home")
    page.wait_for_function(
        "(left) => document.querySelector('#recorded-shown .plot .cursor').getBoundingClientRect().left < left",
        arg=(before or {})["x"],
    )
    accessible(page)
    page.set_viewport_size({"width": 1280, "height": 1100})
    page.get_by_role("button", name="Impact", exact=True).click()
    picture(page, "workbench_trial", folder)


def test_a_single_trial_is_shown_below_its_form_and_again_after_a_reload(page: Page, folder: Path) -> None:
    go(page, "measure", "trial")
    page.locator("#trial-output").fill("single")
    start(page, "Run the trial")
    for _ in range(2):
        expect(page.locator("#trial-shown h3").first).to_contain_text("parcel__case_1__s1.000__r0")
        expect(page.locator("#trial-replay canvas")).to_be_visible()
        expect(page.locator("#trial-shown .plot .scatterlayer")).to_have_count(3)
        page.reload()
    shutil.rmtree(folder / "single")


def test_a_folder_that_has_the_trial_already_is_not_suggested_for_another(
    page: Page, folder: Path, hidden_campaign: Path
) -> None:
    go(page, "measure", "trial")
    output = page.locator("#trial-output")
    expect(output).to_have_value("trials")
    shutil.copytree(next((hidden_campaign / "push").glob("parcel*")), folder / "trials" / "parcel__case_1__s1.000__r0")
    expect(output).to_have_value("trials_2")
    page.select_option("#trial-object", "juice")
    expect(output).to_have_value("trials")
    shutil.rmtree(folder / "trials")


def test_how_fast_the_arm_may_hit_is_asked_and_the_hit_rehearsed_by_mouse(page: Page, folder: Path) -> None:
    command = go(page, "predict", "limits")
    expect(command).to_contain_text("limits push --objects parcel --cases case_1 -o workbench/limits/push")
    page.locator("#part-limits summary").first.click()
    page.locator("#limits-draws").fill("20")
    expect(command).to_contain_text("--draws 20")
    start(page, "Compute the limits")
    expect(page.frame_locator("#limits-result iframe").locator("h1")).to_have_text("How fast may push hit?")
    (limit,) = json.loads((folder / "limits" / "push" / "limits.json").read_text())["limits"]
    expect(page.locator("[data-says='predict/limits']")).to_contain_text(f"at {limit['limit_m_s']:.3g} m/s")
    assert page.locator("[data-entry='lab limits/push']").count() == 0  # its table is no recording
    accessible(page)
    page.locator("#part-limits summary").first.click()
    page.set_viewport_size({"width": 1280, "height": 1400})
    picture(page, "workbench_limits", folder)
    page.set_viewport_size(DESK)
    page.locator(".lead:visible a").click()
    expect(command).to_have_text(re.compile("rehearse push -o workbench/rehearsals/push$"))
    page.select_option("#rehearse-object", "juice")
    expect(command).to_contain_text("rehearse push juice")
    start(page, "Rehearse")
    report = page.frame_locator("#rehearse-result iframe")
    expect(report.locator("td", has_text="arm torque rate")).to_be_visible()
    expect(report.locator(".answer")).to_contain_text("Rehearsal passed")
    expect(page.locator("[data-says='measure/rehearse']")).to_contain_text("push, juice, case_1: passed")
    accessible(page)
    page.set_viewport_size({"width": 1280, "height": 1200})
    picture(page, "workbench_rehearsal", folder)


def test_what_a_practice_campaign_hid_is_revealed_beside_the_estimate(page: Page, reported: Path) -> None:
    """Right for its own diagnosis; and a campaign without a diagnosis says what to do."""
    hidden = {"name": "support_friction", "parameters": {"friction": {"value": HIDDEN_FRICTION, "unit": "-"}}}
    truth = {"kind": "single", "effects": [hidden], "outside": None}
    (reported / "blind" / "truth.json").write_text(json.dumps(truth))
    (reported / "later" / "runs").mkdir(parents=True, exist_ok=True)
    (reported / "later" / "truth.json").write_text(json.dumps(truth))
    go(page, "measure", "blind")
    page.locator("[data-practice=blind]").get_by_role("button", name="Reveal").click()
    expect(page.locator("[data-practice=blind] [data-correct]")).to_have_attribute("data-correct", "true")
    expect(page.locator("[data-practice=blind] tbody tr")).to_have_count(1)
    expect(page.locator("[data-practice=blind] .command")).to_contain_text("blind score")
    page.locator("[data-practice=later]").get_by_role("button", name="Reveal").click()
    expect(page.locator("[data-practice=later] .error")).to_contain_text("diagnose them first")
    accessible(page)
    found = json.loads((reported / "reports" / "diagnosed" / "diagnosis.json").read_text())
    others = found | {"runs": found["runs"] | {"digest": "of other runs"}}
    (reported / "reports" / "others").mkdir()
    (reported / "reports" / "others" / "diagnosis.json").write_text(json.dumps(others))
    go(page, "diagnose")
    for name, count in (("others", 0), ("diagnosed", 1)):
        page.select_option("#diagnose-file", f"reports/{name}/diagnosis.json")
        expect(page.locator("#ranking")).to_be_visible()
        expect(page.locator("#reveal")).to_have_count(count)
    page.locator("#reveal").click()
    expect(page.locator("#revealed [data-correct]")).to_have_attribute("data-correct", "true")
    for name in ("later", "reports/others"):
        shutil.rmtree(reported / name)
    (reported / "blind" / "truth.json").unlink()


def test_runs_are_chosen_filtered_and_pinned_over_each_other(page: Page, reported: Path) -> None:
    go(page, "overlay")
    plot, rows = page.locator("#overlay-plot"), page.locator("#overlay-runs-list li[data-key]")
    expect(plot.locator(".scatterlayer .trace")).to_have_count(3)
    count = rows.count()
    page.locator("#overlay-runs-filter").fill("juice r1")
    expect(rows).to_have_count(1)
    page.locator("#part-overlay-runs").get_by_role("button", name="Choose none").click()
    rows.locator("button").click()  # pinned, and thereby chosen
    expect(plot.locator(".scatterlayer .trace")).to_have_count(1)
    page.locator("#overlay-runs-filter").fill("parcel")
    page.locator("#part-overlay-runs").get_by_role("button", name="Choose all below").click()
    expect(plot.locator(".scatterlayer .trace")).to_have_count(3)
    expect(rows.first).to_contain_text("juice")
    page.locator("#overlay-runs-filter").fill("")
    expect(rows).to_have_count(count)
    with page.expect_response(lambda answer: answer.url.endswith("/api/choices") and answer.request.method == "POST"):
        rows.filter(has_text="parcel").last.locator("input").uncheck()
    expect(plot.locator(".scatterlayer .trace")).to_have_count(2)
    shown = plot.get_attribute("data-shown")
    page.reload()  # what was chosen and pinned is still so
    expect(plot).to_have_attribute("data-shown", shown or "")
    expect(rows.first.locator("button")).to_have_attribute("aria-pressed", "true")
    expect(rows.first).to_contain_text("juice")
    page.select_option("#overlay-signal", "Velocity of the end effector, y")
    page.set_viewport_size({"width": 1280, "height": 1100})
    picture(page, "workbench_overlay", reported)
    page.set_viewport_size(DESK)
    page.locator("#tab-overlay-models").click()
    models = len(list(reported.rglob("compare.html")))
    expect(page.locator("#overlay-models-plot .scatterlayer .trace")).to_have_count(1 + min(models, 3))  # and measured
    page.locator("#tab-overlay-estimates").click()
    expect(page.locator("#overlay-estimates .scatterlayer .trace").first).to_be_attached()
    expect(page.locator("#overlay-parameter")).to_have_value(
        re.compile("support_friction")
    )  # what was named comes first
    expect(page.locator("#part-overlay-estimates .note")).to_contain_text("at the time of its last trial")
    accessible(page)
    (reported / ".workbench" / "overlay.json").unlink()


def test_what_no_effect_explains_is_looked_for_as_a_law_by_a_button(page: Page, reported: Path) -> None:
    """In the measurements of the opened diagnosis, beside it; where effects explain everything there is no button."""
    found = json.loads((reported / "reports" / "diagnosed" / "diagnosis.json").read_text())
    found["options"] |= {"runs": str(reported / "blind" / "runs" / "push"), "since": "push/parcel", "effects": ["gap"]}
    (reported / "reports" / "open").mkdir(exist_ok=True)
    (reported / "reports" / "open" / "diagnosis.json").write_text(json.dumps(found | {"verdict": "NONE-EXPLAINS"}))
    go(page, "diagnose")
    page.select_option("#diagnose-file", "reports/diagnosed/diagnosis.json")
    expect(page.locator("#ranking")).to_be_visible()
    expect(page.locator("#law")).to_have_count(0)
    page.select_option("#diagnose-file", "reports/open/diagnosis.json")
    page.select_option("#diagnose-runs", "blind/runs")  # the form stands for the next diagnosis
    page.route("**/api/jobs", lambda route: route.abort())
    with page.expect_request("**/api/jobs") as asked:
        page.locator("#law button").click()
    order = asked.value.post_data_json
    assert (order["command"], order["runs"]) == ("discover", "blind/runs/push")
    assert (order["since"], order["effects"]) == ("push/parcel", ["gap"])
    assert (order["report"], order["output"]) == ("reports/open", "reports/open/discovery.json")


def test_the_ranking_shows_what_an_effect_adds_to_the_other_chosen_ones(page: Page, reported: Path) -> None:
    """As terminal and report do: the error with the other effects, and with it as well."""
    found = json.loads((reported / "reports" / "diagnosed" / "diagnosis.json").read_text())
    best = found["effects"][0]
    best |= {"held_out_error_before": 61.8, "held_out_error_others": 4.25, "held_out_error_after": 1.5}
    (reported / "reports" / "two").mkdir()
    (reported / "reports" / "two" / "diagnosis.json").write_text(json.dumps(found))
    go(page, "diagnose")
    page.select_option("#diagnose-file", "reports/two/diagnosis.json")
    expect(page.locator("#ranking tbody tr").filter(has_text=best["name"]).first).to_contain_text("4.25 → 1.5")
    expect(page.locator("#diagnose-result a")).to_have_count(0)  # no report was written beside it: none is offered
    shutil.rmtree(reported / "reports" / "two")


def test_trials_are_designed_shown_and_run_by_a_button(page: Page, folder: Path) -> None:
    push = load_scenario("push")
    one = {name: dict([next(iter(getattr(push, name).items()))]) for name in ("objects", "cases")}
    write_scenario(push.model_copy(update=one), folder / "small.yaml")
    command, mistake = go(page, "measure", "design"), page.locator("#part-design .message .error")
    expect(command).to_contain_text("impact-rs design --budget 18 -o workbench/plans/plan_1.yaml")
    page.locator("#design-budget").fill("0")
    expect(mistake).to_contain_text("budget = 0: expected greater than or equal to 1")
    page.locator("#design-budget").fill("6")
    page.locator("#design-scenarios").fill("push pusch")
    expect(mistake).to_contain_text("did you mean 'push'")
    page.locator("#design-scenarios").fill("small.yaml")
    expect(command).to_contain_text("--budget 6 -o workbench/plans/plan_1.yaml --scenarios workbench/small.yaml")
    start(page, "Plan the trials")
    expect(page.locator("#design-output")).to_have_value("plans/plan_2.yaml")  # what is there is not written over
    planned = yaml.safe_load((folder / "plans" / "plan_1.yaml").read_text())
    rows = page.locator("#planned tbody tr")
    expect(rows).to_have_count(sum(len(one["conditions"]) for one in planned["campaigns"]))
    assert sum(int(row.locator("td").first.inner_text()) for row in rows.all()) == 6
    expect(page.locator("#pairs tbody tr").first).to_contain_text(planned["pairs"][0]["first"])
    accessible(page)
    page.set_viewport_size({"width": 1280, "height": 1100})
    picture(page, "workbench_design", folder)
    page.route("**/api/jobs", lambda route: route.abort())
    with page.expect_request("**/api/jobs") as asked:
        page.get_by_role("button", name="Run the plan").click()
    order = asked.value.post_data_json
    assert order == {"command": "campaign", "plan": "plans/plan_1.yaml", "output": "campaigns/plan_1"}


def test_an_investigation_is_followed_stopped_and_can_go_on(page: Page, folder: Path) -> None:
    command = go(page, "investigate")
    expect(command).to_contain_text("impact-rs investigate workbench/investigations/1")
    expect(page.locator("#investigate-budget")).to_have_attribute("min", "6")
    page.locator("#investigate-blind").fill("7")
    page.locator("#investigate-budget").fill("8")
    expect(command).to_contain_text("--budget 8 --blind 7")
    start(page, "Investigate", "running")
    expect(page.locator("#ending")).to_contain_text("goes on", timeout=SLOW)
    expect(page.frame_locator("#investigate-result iframe").locator("h1")).to_be_visible()
    page.locator("#jobs-toggle").click()
    job = page.locator("#job-list > li").first
    job.get_by_role("button", name="Stop").click()
    expect(job).to_have_attribute("data-state", "130")
    expect(job.get_by_role("button", name="Continue")).to_be_visible()
    assert (folder / "investigations" / "1" / "investigation.yaml").exists()


def test_a_cell_asks_in_the_page_no_comes_first_and_a_closed_page_is_a_no(
    browser: Browser, served: Callable[[Path], str], tmp_path: Path
) -> None:
    about_to_move(tmp_path / "cell", tmp_path / "envelope.yaml")
    form = {"command": "investigate", "directory": "cell", "scenarios": ["push"], "via": "cell", "budget": 6}
    body = json.dumps(form | {"envelope": "envelope.yaml"})
    start = f"fetch('/api/jobs', {{method: 'POST', body: JSON.stringify({body})}})"
    address = served(tmp_path)
    with opened(browser, address) as (page, _):
        go(page, "investigate")
        page.evaluate(start)
        row = page.locator("#questions > div")
        expect(row).to_contain_text("Is the cell safe, the arm at rest, and shall it go on?")
        buttons = row.get_by_role("button")
        expect(buttons).to_have_text(["No", "Yes"])
        expect(row.get_by_role("button", name="No")).to_have_class("primary")
        accessible(page)
        picture(page, "workbench_question", tmp_path)
        sent: list[str | None] = []

        def kept(route: Route) -> None:
            sent.append(route.request.post_data)
            route.fulfill(status=400, body=json.dumps({"error": "kept by the test"}), content_type="application/json")

        page.route("**/api/answer", kept)
        row.get_by_role("button", name="Yes").click()
        expect(row.locator(".reply")).to_have_text("kept by the test")
        assert sent == [json.dumps({"job": 1, "question": 1, "yes": True}, separators=(",", ":"))]
        page.unroute("**/api/answer")
        row.get_by_role("button", name="No").click()
        expect(row).to_have_count(0)
        expect(page.locator("#jobs-line")).to_contain_text("Nothing was moved")
        page.evaluate(start)
        expect(row).to_have_count(1)
    record = tmp_path / ".workbench" / "jobs" / "0002" / "job.json"
    until(lambda: json.loads(record.read_text())["ended"], lambda: time.sleep(0.05))
    assert "Nothing was moved" in json.loads(record.read_text())["line"]
    assert "no, or the page was closed" in (record.parent / "output.txt").read_text()


def test_a_campaign_is_offered_counted_and_refused_on_the_page(page: Page) -> None:
    command, campaign = go(page, "measure"), page.locator("#part-campaign")
    expect(command).to_contain_text("--scales 0.8 0.9 1 1.1 1.2 --trials 2")
    expect(page.locator("#campaign-count")).to_have_text("10 trials.")
    for scale in ("0.8", "0.9", "1.1", "1.2"):
        campaign.get_by_label(scale, exact=True).uncheck()
    expect(page.locator("#campaign-count")).to_contain_text("2 trials. Analyze needs at least two references")
    campaign.locator("summary").click()
    campaign.get_by_label("scenario settings").fill("control.clamp_force=90 trials=3")
    expect(command).to_contain_text("--set control.clamp_force=90 trials=3")
    expect(page.locator("#right code")).to_have_text("--set KEY=VALUE")
    page.locator("#campaign-objects input:checked").uncheck()
    expect(campaign.locator(".message .error")).to_contain_text("objects = []: expected at least 1 of them")
    expect(page.get_by_role("button", name="Start the campaign")).to_be_disabled()
    expect(campaign.locator(".command")).to_have_count(0)


def test_a_scale_beyond_the_limit_of_trials_is_refused_on_the_page(page: Page) -> None:
    command = go(page, "measure", "trial")
    expect(command).to_contain_text("impact-rs trial push")
    page.locator("#trial-scale").fill("9")
    expect(page.locator("#part-trial .message .error")).to_contain_text("expected a number > 0 and <= 3 [-]")
    expect(page.get_by_role("button", name="Run the trial")).to_be_disabled()
    page.locator("#trial-scale").fill("0.93")  # between two steps of the arrows
    expect(command).to_contain_text("--scale 0.93")


def test_a_prediction_becomes_a_campaign_at_the_first_click(page: Page) -> None:
    page.select_option("#predict-object", "juice")
    page.select_option("#predict-case", "case_3")
    page.get_by_role("button", name="Measure this").click()
    command = page.locator("#part-campaign .command code")
    expect(command).to_contain_text(re.compile("campaign push -o .*push_juice --objects juice --cases case_3"))


def test_a_new_question_hides_numbers_and_command_of_the_last_one(page: Page) -> None:
    table, command = page.locator("#predict-table tbody tr"), page.locator("main > section:visible .command")
    expect(command).to_contain_text("cat_food")
    held = Held(page, "**/api/predict")
    page.select_option("#predict-object", "juice")
    for stale in (table, command, page.locator("#predict-plot .scatterlayer")):
        expect(stale).to_have_count(0)
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


@pytest.mark.parametrize("late", ["static/plotly.js", "api/predict", "api/sweep", "api/scene?*"])
def test_a_late_answer_of_an_earlier_question_paints_nothing(
    browser: Browser, address: tuple[str, Path], late: str
) -> None:
    """Whatever it is that comes when the page waits for another scenario already."""
    with opened(browser, address[0], late) as (page, held):
        waiting = Held(page, "**/api/scenario?*")
        page.select_option("#predict-scenario", "grab")
        waiting.wait_for(1)
        held.let_go()
        for painted in (
            "#predict-table tbody tr",
            "#predict-plot .scatterlayer",
            "#predict-plot[data-shown]",
            ".command",
        ):
            expect(page.locator(f"section:visible {painted}")).to_have_count(0)
        waiting.let_go()
        expect(page.locator("section:visible .command")).to_contain_text("map grab")
        expect(page.locator("#predict-plot .scatterlayer .trace")).to_have_count(7)
        expect(page.locator("#predict-scene")).to_have_attribute("data-shown", re.compile("grab"))


def test_a_slider_moves_while_the_questions_of_another_tab_come_first(page: Page) -> None:
    expect(page.locator("#predict-plot .scatterlayer .trace")).to_have_count(7)  # nothing is asked any more
    stopped: list[Route] = []

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


def test_the_newest_text_is_checked_whatever_answer_comes_last(page: Page) -> None:
    go(page, "add")
    text, check = page.locator("#formula"), page.locator("#formula-check")
    expect(check.locator(".good")).to_be_visible()
    good = text.input_value()
    held = Held(page, "**/api/formulas/check")
    for count, content in enumerate((good.replace("N s/m", "N m"), good), start=1):
        text.fill(content)
        held.wait_for(count)
    held.answer_last_of(2)
    expect(check.locator(".good")).to_be_visible()
    held.let_go()
    expect(check.locator(".error")).to_have_count(0)


def test_the_newest_page_of_the_manual_is_open_whatever_answer_comes_last(page: Page) -> None:
    held = Held(page, "**/manual/*.md")
    for count, step in enumerate(("predict", "measure"), start=1):
        go(page, step)
        page.get_by_role("link", name="In the manual").click()
        held.wait_for(count)
    held.answer_last_of(2)
    expect(page.locator("#manual h1")).to_have_text("Bags")
    held.let_go()
    expect(page.locator("#manual h1")).to_have_text("Bags")


def test_the_newest_place_of_a_comparison_has_its_signal(page: Page, reported: Path) -> None:
    """Also where it is chosen while the signals of the report are still being read."""
    go(page, "compare")
    page.select_option("#compare-report", "reports/seen/compare.html")
    expect(page.locator("#compare-result .replays canvas")).to_be_visible()
    held = Held(page, "**/files/**")
    places = page.locator("#cell option")
    for index in (0, 1):
        page.select_option("#cell", str(index))
    held.wait_for(1)
    expect(page.locator("#signal")).to_be_empty()
    held.let_go()
    expect(page.locator("#signal .scatterlayer .trace")).to_have_count(3)
    expect(page.locator("#signal .note")).to_contain_text((places.nth(1).text_content() or "").partition(",")[0])


def test_a_form_that_is_not_in_sight_asks_for_nothing(page: Page) -> None:
    asked: list[str] = []

    def heard(sent: Request) -> None:
        if sent.url.endswith("/api/command"):
            asked.append(sent.post_data_json["command"])

    page.on("request", heard)
    expect(go(page, "measure")).to_contain_text("--trials 2")
    expect(go(page, "measure", "trial")).to_contain_text("impact-rs trial push")
    page.remove_listener("request", heard)
    assert set(asked) == {"campaign", "trial"}


def test_a_form_shows_the_command_of_its_newest_content_alone(page: Page) -> None:
    """And its button stays where it is, whatever the length of the command."""
    command, trials = go(page, "measure"), page.locator("#campaign-trials")
    expect(command).to_contain_text("--trials 2")
    place = page.get_by_role("button", name="Start the campaign").bounding_box()
    held = Held(page, "**/api/command")
    for count in ("6", "7", "8"):
        with page.expect_request("**/api/command"):
            trials.fill(count)
        expect(command).to_be_hidden()
    held.answer_last_of(3)
    expect(command).to_contain_text("--trials 8")
    expect(command).to_be_visible()
    held.let_go()
    assert "--trials 8" in command.inner_text()
    page.locator("#campaign-output").fill("campaigns/" + 60 * "long/")  # a command of several lines
    expect(command).to_contain_text("long/long")
    assert page.get_by_role("button", name="Start the campaign").bounding_box() == place


def test_a_suggested_model_is_the_newest_until_one_is_chosen(page: Page, folder: Path) -> None:
    def write(name: str, when: float) -> Path:
        file = folder / "family" / f"{name}.yaml"
        file.parent.mkdir(exist_ok=True)
        file.write_text(f"name: {name}\neffects: []\n")
        os.utime(file, (when, when))
        return file

    write("new", 4e9)
    write("old", 1e9)
    go(page, "history")
    expect(page.locator("#history-model")).to_have_value("family/new.yaml")
    expect(page.locator("#history-runs")).to_have_value("blind/runs")  # the first there is
    expect(page.locator("#history-output")).to_have_value("reports/history_blind_runs_new")
    page.select_option("#history-model", "nominal")
    write("newer", 4.1e9)
    expect(page.locator("#history-model option[value='family/newer.yaml']")).to_be_attached()
    expect(page.locator("#history-model")).to_have_value("nominal")
    shutil.rmtree(folder / "family")


def test_the_next_model_is_not_written_over_an_earlier_one(page: Page, folder: Path) -> None:
    go(page, "add")
    output, free = page.locator("#add-output"), re.compile("^models/model_[0-9]+.yaml$")
    expect(output).to_have_value(free)
    name = output.input_value()
    (folder / name).write_text("name: earlier\neffects: []\n")
    expect(output).not_to_have_value(name)
    expect(output).to_have_value(free)
    (folder / name).unlink()


def test_names_and_notes_are_text_and_no_markup(page: Page, folder: Path) -> None:
    name = "<img src=x>&amp;"
    (folder / "m.yaml").write_text(json.dumps({"name": name, "effects": [], "note": "<b>bold</b>"}))
    button = page.locator("[data-entry='model m.yaml']")
    expect(button).to_contain_text(name)
    button.click()
    expect(page.locator("#right")).to_contain_text("<b>bold</b>")
    expect(page.locator("#right h2")).to_have_text(name)
    (folder / "m.yaml").unlink()


def test_a_folder_of_recordings_is_described_from_lists_and_compared(
    page: Page, folder: Path, hidden_campaign: Path, rewrite_bag: Callable[..., None]
) -> None:
    """Numbers of a preview are compared in test_recording_description.py."""
    kept = {topics.joint_states("arm"), topics.joint_command("arm"), topics.OBJECT_POSE}
    for number, trial in enumerate(sorted((hidden_campaign / "push").glob("parcel*")), start=1):  # nothing of ours
        rewrite_bag(trial, folder / "lab" / f"parcel_{number}", kept.__contains__)
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
    accessible(page)

    expect(page.get_by_label("object of parcel_1")).to_have_value("parcel")  # as it is called
    in_metres = pose.locator("p").inner_text()
    pose.get_by_label("unit").select_option("mm")
    expect(pose.locator("p")).not_to_have_text(in_metres)  # the new preview is there, and moves no button any more
    page.locator("#lab-save").click()
    expect(part.locator(".message .error")).to_contain_text("parcel_1: the centre of 'parcel' is first at")
    pose.get_by_label("unit").select_option("m")
    expect(pose.locator("p")).to_have_text(in_metres)
    page.get_by_label("condition of parcel_2").fill("case_1")
    page.locator("#lab-save").click()
    expect(page.locator("#lab-written")).to_contain_text("lab/experiment.yaml, lab/mapping.yaml, lab/runs.csv")
    part.get_by_role("button", name="Compare").click()
    expect(page.locator("#compare-runs")).to_have_value("lab")
    expect(page.locator("#compare-experiment")).to_have_value("lab/experiment.yaml")
    start(page, "Compare")
    expect(page.locator("#compare-result .answer")).to_contain_text("in 2 trials")

    page.locator("[data-entry='lab lab']").click()
    page.get_by_role("button", name="Show the runs").click()
    page.locator("#recorded-trials [data-trial=parcel_2]").click()
    expect(page.locator("#recorded-shown h3").first).to_have_text("Run parcel_2")
    expect(page.locator("#recorded-replay canvas")).to_be_visible()
    expect(page.locator("#recorded-shown .plot .cursor").first).to_be_visible()

    command = go(page, "laboratory", "impacts")
    expect(command).to_contain_text(
        "impacts workbench/lab --experiment workbench/lab/experiment.yaml -o workbench/impacts"
    )
    start(page, "Find the impacts")
    expect(page.locator("[data-printed=impacts] pre")).to_contain_text("2 impacts of 2 runs")
    page.locator("[data-table='impacts/lab.csv']").get_by_role("button", name="Follow").click()
    expect(command).to_contain_text(re.compile("follow .*-o workbench/models/followed_1.yaml --state .*/lab.npz"))
    expect(command).to_contain_text("--impacts workbench/impacts/lab.csv --scenario push")
    assert page.locator("[data-entry='lab impacts']").count() == 0  # a table of impacts is no recording
    shutil.rmtree(folder / "impacts")


def test_raw_files_are_described_by_their_numbers(
    page: Page, folder: Path, hidden_campaign: Path, rewrite_bag: Callable[..., None]
) -> None:
    """What is guessed is printed with its evidence; the folder then has a mapping."""
    kept = {topics.joint_states("arm"), topics.joint_command("arm")}
    for number, trial in enumerate(sorted((hidden_campaign / "excite").iterdir()), start=1):
        rewrite_bag(trial, folder / "raw" / f"run_{number}", kept.__contains__)
    command = go(page, "laboratory", "import")
    page.get_by_label("raw", exact=True).check()
    page.select_option("#import-robot", "franka_fer")
    expect(command).to_contain_text("import workbench/raw --robot franka_fer -o workbench/raw")
    start(page, "Look at the files")
    expect(page.locator("[data-printed=import] pre")).to_contain_text("2 runs, 0 of them hits")
    assert (folder / "raw" / "mapping.yaml").exists()
    shutil.rmtree(folder / "raw")


def test_two_arms_of_different_kinds_are_predicted_and_described(
    page: Page, folder: Path, mixed_trial: Path, rewrite_bag: Callable[..., None]
) -> None:
    shutil.copy(FILE, folder / "mixed_grab.yaml")
    rewrite_bag(mixed_trial, folder / "two" / "run_1", lambda topic: not topic.startswith(("/trial", "/truth")))
    expect(page.locator("#predict-scenario option[value='mixed_grab.yaml']")).to_be_attached()
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
    picture(page, "workbench_laboratory", folder)
    page.locator("#lab-save").click()
    expect(page.locator("#lab-written")).to_contain_text("two/mapping_left.yaml, two/mapping_right.yaml")
    page.set_viewport_size({"width": 360, "height": 800})
    expect(page.locator("html")).to_have_js_property("scrollWidth", 360)


def test_a_job_that_fails_shows_its_one_line(page: Page, folder: Path) -> None:
    (folder / "campaigns").mkdir(exist_ok=True)
    (folder / "campaigns" / "taken").write_text("a file where the campaign wants its folder")
    command = go(page, "measure")
    page.locator("#campaign-output").fill("campaigns/taken")
    expect(command).to_contain_text("campaigns/taken")
    start(page, "Start the campaign", 2)
    expect(page.locator("#job-list .state").first).to_contain_text("campaigns/taken")
    beside = page.locator("#part-campaign .actions .reply")
    expect(beside).to_contain_text("campaigns/taken")
    assert str(folder) not in beside.inner_text()  # paths are those of the folder


def test_a_running_job_is_seen_by_other_tabs_and_stopped_there(page: Page) -> None:
    command, jobs = go(page, "measure"), page.locator("#job-list > li")
    page.locator("#campaign-output").fill("campaigns/long")
    page.locator("#campaign-trials").fill("40")
    expect(command).to_contain_text("--trials 40")
    start(page, "Start the campaign", "running")
    expect(page.locator("#job-list progress").first).to_have_attribute("value", re.compile("[1-9]"), timeout=SLOW)
    page.reload()
    expect(jobs.first).to_have_attribute("data-state", "running")
    other = page.context.new_page()
    other.goto(page.url)
    expect(other.locator("#job-list > li").first).to_have_attribute("data-state", "running")
    expect(other.locator("#part-campaign .command code")).to_contain_text("impact-rs campaign")  # nothing moves now
    other.locator("#jobs-toggle").click()
    other.locator("#job-list > li").first.get_by_role("button", name="Stop").hover()
    other.mouse.down()
    done = other.locator("#job-list progress").first.get_attribute("value") or ""
    expect(other.locator("#job-list progress").first).not_to_have_attribute("value", done, timeout=SLOW)
    other.mouse.up()  # a slow click, while the job has gone on
    expect(jobs.first).to_have_attribute("data-state", "130", timeout=SLOW)
    expect(page.locator("#campaigns")).to_contain_text("campaigns/long")
    other.close()


def test_a_formula_is_checked_while_it_is_written(page: Page, folder: Path) -> None:
    go(page, "add")
    text, check = page.locator("#formula"), page.locator("#formula-check")
    expect(check).to_contain_text("end_effector_force.y: gives N")
    text.fill(text.input_value().replace("N s/m", "N m"))
    expect(check.locator(".error")).to_contain_text("expected N")
    text.fill(text.input_value().replace("N m", "N s/m"))
    expect(check.locator(".good")).to_contain_text("cable_drag")
    page.get_by_role("button", name="Save the formulas").click()
    expect(check).to_contain_text("formulas/mine.yaml")
    go(page, "diagnose")
    expect(page.locator("#diagnose-formulas option")).to_have_count(2)
    assert (folder / "formulas" / "mine.yaml").exists()
