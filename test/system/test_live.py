# SPDX-License-Identifier: Apache-2.0
"""``show --live`` as a person uses it: a graph that runs, its page in a headless browser, Ctrl-C at the end."""

from __future__ import annotations

import os
import shutil
import signal
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from fake_graph import FakeGraph, fake_graph
from playwright.sync_api import Page, expect, sync_playwright
from processes import Running, running, until

from impact_rs_analysis.following.documents import PublishedChange, PublishedPrediction, RefusedHit
from impact_rs_ros.identify_node import TOPICS
from impact_rs_ros.message_types import filled
from impact_rs_ros.spectator import FOLLOWED
from impact_rs_sim.rotations import quaternion_of
from impact_rs_sim.scene import Scene

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
SOFTWARE = ("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
needs_browser = pytest.mark.skipif(CHROMIUM is None, reason="no chromium or chrome on this machine")
IMAGES = Path(__file__).resolve().parents[2] / "docs" / "images"
expect.set_options(timeout=60_000.0)


@pytest.fixture(scope="module")
def domain(domain_ids: Callable[[], int]) -> int:
    return domain_ids()


@pytest.fixture
def shown(domain: int) -> Iterator[tuple[Running, str]]:
    """``impact-rs show --live`` and its address."""
    command = [sys.executable, "-m", "impact_rs_cli.main", "show", "--live", "--namespace", "cell_a", "--no-browser"]
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell may let its jobs ignore it
    with running(command, {"ROS_DOMAIN_ID": str(domain)}, signal.SIGKILL) as process:
        yield process, process.address()
    signal.signal(signal.SIGINT, before)


def test_without_a_graph_it_says_how_to_start_one_and_ctrl_c_is_no_failure(
    shown: tuple[Running, str], domain: int
) -> None:
    line = shown[0].line(f"no graph runs in ROS domain {domain}, namespace /cell_a; ")
    assert line.endswith(" up push starts one. Waiting\n")
    assert shown[0].end(signal.SIGINT)[0] == 0


@pytest.fixture
def page(shown: tuple[Running, str]) -> Iterator[Page]:
    """The page, which asks nobody else for anything and throws no error."""
    process, address = shown
    wrong: list[str] = []
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=SOFTWARE)
        made = browser.new_page(viewport={"width": 1000, "height": 700})
        home = address.partition("/?")[0]
        made.on(
            "request", lambda asked: None if asked.url.startswith((home, "data:", "blob:")) else wrong.append(asked.url)
        )
        made.on("pageerror", lambda error: wrong.append(str(error)))
        made.goto(address)
        yield made
        assert process.process.poll() is None
        process.process.send_signal(signal.SIGINT)
        expect(made.get_by_role("alert")).to_be_visible()
        assert process.end()[0] == 0  # though the page still listens
        browser.close()
    assert wrong == []


HAND = """(name) => { const live = window.impact_rs.live;
  return live?.state && live.measured.links[name] ? live.measured.positions()[name] : null; }"""


def told_until(page: Page, tell: Callable[[], None], name: str, expected: np.ndarray, where: str = "") -> None:
    """Tell again and again, for nobody waits for a spectator, until a link is seen where it should be."""
    hand = HAND.replace("impact_rs.", f"impact_rs.{where}")
    deadline = time.monotonic() + 60.0
    while True:
        tell()
        found = page.evaluate(hand, name)
        if found is not None and np.allclose(found, expected, atol=1e-6):
            return
        assert time.monotonic() < deadline, (found, expected)
        page.evaluate("new Promise(requestAnimationFrame)")


@pytest.fixture
def workbench(domain: int, tmp_path: Path) -> Iterator[Page]:
    """The step *Measure* of a workbench, which throws no error."""
    command = [sys.executable, "-m", "impact_rs_cli.main", "workbench", str(tmp_path / "bench"), "--no-browser"]
    errors: list[str] = []
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    with running(command, {"ROS_DOMAIN_ID": str(domain)}, signal.SIGINT) as process, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=SOFTWARE)
        page = browser.new_page(viewport={"width": 1280, "height": 1100})
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.goto(process.address())
        page.locator("[data-step=measure]").click()
        yield page
    signal.signal(signal.SIGINT, before)
    assert errors == []


@pytest.mark.slow
@needs_browser
def test_trials_of_a_job_are_watched_while_they_run(workbench: Page) -> None:
    page = workbench
    page.locator("#part-campaign summary").click()
    page.locator("#campaign-via").select_option("nodes")
    page.locator("#campaign-namespace").fill("cell_b")
    expect(page.locator("#part-campaign .command code")).to_contain_text("--via nodes --namespace cell_b")
    page.get_by_role("button", name="Start the campaign").click()
    page.locator("#jobs-toggle").click()
    job = page.locator("#job-list li").first
    job.get_by_role("button", name="Watch").click()
    page.locator("#jobs-toggle").click()
    expect(page.locator("#live-namespace")).to_have_value("cell_b")
    expect(page.locator("#live-status")).to_contain_text("Now: push, ")
    page.wait_for_function("() => document.querySelector('#live-velocity').data?.[0]?.x.at(-1) > 1.2", timeout=60_000.0)
    if os.environ.get("IMPACT_RS_PICTURES"):
        page.screenshot(path=IMAGES / "workbench_live.png", animations="disabled")
    page.locator("#jobs-toggle").click()
    job.get_by_role("button", name="Stop").click()
    expect(job).not_to_have_attribute("data-state", "running")


@pytest.mark.slow
@needs_browser
def test_running_nodes_are_seen_in_the_workbench_with_their_signals(workbench: Page, domain: int) -> None:
    """Watched while the tab is in sight, and no longer."""
    page = workbench
    with fake_graph(domain, "/cell_a") as graph:
        page.locator("#tab-live").click()
        expect(page.locator("#live-status")).to_contain_text("No graph runs in ROS domain")
        page.locator("#live-namespace").fill("cell a")
        page.keyboard.press("Tab")
        expect(page.locator("#live-status.error")).to_contain_text("cell a")
        page.locator("#live-namespace").fill("cell_a")
        page.keyboard.press("Tab")
        scene = graph.trial("push").scene
        expect(page.locator("#live-status")).to_contain_text("nothing has moved yet")
        model, q, speed = scene.physics.robot_model("arm"), np.linspace(-0.3, 0.3, 7), np.linspace(0.1, 0.7, 7)
        time = 0.0

        def tell() -> None:
            nonlocal time
            time += 0.01
            graph.force_on_pad("arm", (0.0, -30.0, -40.0))
            graph.joints("arm", q, time, speed)

        told_until(page, tell, "arm_end_effector", model.placement(q).translation, "nodes.watched?.")
        newest = "() => document.querySelector('#live-velocity').data.map((one) => one.y.at(-1))"
        expect(page.locator("#live-velocity .scatterlayer .trace")).to_have_count(7)
        assert page.evaluate(newest) == pytest.approx(speed)
        until(lambda: page.locator("#live-force .scatterlayer .trace").count(), tell)
        assert page.evaluate(newest.replace("velocity", "force")) == pytest.approx([50.0])
        _what_identify_says(page, graph)
        page.locator("[data-step=predict]").click()
        until(lambda: graph.node.count_subscribers("/cell_a/arm/joint_states") == 0, lambda: page.evaluate("1"))


def _what_identify_says(page: Page, graph: FakeGraph) -> None:
    """Believed parameters, the next hit, and a change with its command."""
    believed = {
        "parameter": "object_mass.scale",
        "estimate": 1.2496,
        "ci95": [1.2454, 1.2538],
        "change": 0.2496,
        "unit": "-",
    }
    value = {
        "signal": "object velocity",
        "index": "y",
        "phase": "push",
        "value": -0.488,
        "ci95": [-0.51, -0.46],
        "unit": "m/s",
    }
    cause = {
        "effect": "object_mass",
        "share": 1.0,
        "since": "r36",
        "parameters": [believed],
        "words": "0.15 kg heavier",
    }
    words = "since r36 the object is 0.15 kg heavier (object_mass: scale +0.252 [0.233, 0.271])"
    change = {"hit": "r37", "since": "r36", "hits": 2, "log10_ratio": 5.9, "false_alarm": 1e5, "causes": [cause]}
    documents = {
        "prediction": PublishedPrediction(condition="juice", like="push/r40", values=[value], followed=[believed]),
        "change": PublishedChange(**change, words=words, diagnose="impact-rs diagnose day --since r36"),
        "refused": RefusedHit(hit="r41", reason="NaN in joint velocities"),
    }
    for name, document in documents.items():
        topic = f"/identify/{name}"
        graph.say(topic, FOLLOWED[topic], filled(TOPICS[name], document.model_dump()), latched=True)
    place = page.locator("#live-followed")
    expect(place).to_contain_text("Followed hits")
    expect(place).to_contain_text("the object is 0.15 kg heavier")
    expect(place.locator(".command code")).to_have_text("impact-rs diagnose day --since r36")
    expect(place.locator("table").first).to_contain_text("1.2454 to 1.2538")
    expect(place).to_contain_text("No hit: r41: NaN in joint velocities")
    place.locator("summary").click()
    expect(place.locator("details table")).to_contain_text("−0.510 to −0.460 m/s")


@needs_browser
def test_arms_object_and_force_are_shown_and_a_new_scenario_is_a_new_scene(page: Page, domain: int) -> None:
    expect(page.locator("#status")).to_contain_text("No graph runs")
    with fake_graph(domain, "/cell_a") as graph:
        _push(page, graph)
        _grab(page, graph)
    expect(page.locator("#status")).to_contain_text("the nodes have ended", ignore_case=True)
    assert page.evaluate(HAND, "left_end_effector") is not None  # the last state stays


def _push(page: Page, graph: FakeGraph) -> None:
    scene = graph.trial("push").scene
    expect(page.locator("#status")).to_contain_text("nothing has moved yet")
    model, place = scene.physics.robot_model("arm"), np.array([0.5, -0.1, 0.6, 0.0, 0.0, 0.6, 0.8])
    rng = np.random.default_rng(1)
    for number in range(3):
        q = rng.uniform(-0.5, 0.5, 7)

        def tell(q: np.ndarray = q, number: int = number) -> None:
            graph.object(place)
            graph.force_on_pad("arm", (0.0, -30.0, -40.0))
            graph.joints("arm", q, 0.25 * (number + 1))

        told_until(page, tell, "arm_end_effector", model.placement(q).translation)
    expect(page.locator("#status")).to_contain_text("push, cat_food, case_2")
    expect(page.locator(".replay-time")).to_have_text("0.750 s · force 50 N")
    seen = page.evaluate("window.impact_rs.live.measured.object.position.toArray()")
    assert seen == pytest.approx(place[:3])
    arrow = page.evaluate("window.impact_rs.live.forces[0].root.localToWorld(new THREE.Vector3(0, 1, 0)).toArray()")
    assert np.subtract(arrow, model.placement(q).translation) == pytest.approx([0.0, 0.6, 0.8], abs=1e-6)
    if os.environ.get("IMPACT_RS_PICTURES"):
        _picture_at_impact(page, graph, scene)
    expect(page.locator("#status")).to_contain_text("at rest until the next trial", ignore_case=True)


def _picture_at_impact(page: Page, graph: FakeGraph, scene: Scene) -> None:
    """The picture of the manual: arm and object where they meet."""
    q = scene.arms["arm"].position

    def tell() -> None:
        graph.object(np.append(scene.object.position, quaternion_of(scene.object.rotation)))
        graph.force_on_pad("arm", (0.0, 120.0, 0.0))
        graph.joints("arm", q, 1.0)

    told_until(page, tell, "arm_end_effector", scene.physics.robot_model("arm").placement(q).translation)
    page.locator("canvas").dblclick()
    page.screenshot(path=IMAGES / "live.png", animations="disabled")


def _grab(page: Page, graph: FakeGraph) -> None:
    physics = graph.trial("grab").scene.physics
    places = {arm: np.full(7, 0.1 * number) for number, arm in enumerate(physics.arms, start=1)}

    def tell() -> None:
        for arm, q in places.items():
            graph.joints(arm, q, 0.1)

    for arm, q in places.items():
        told_until(page, tell, f"{arm}_end_effector", physics.robot_model(arm).placement(q).translation)
    expect(page.locator("#status")).to_contain_text("grab, cat_food, case_2")
    assert page.evaluate("window.impact_rs.live.measured.object.visible") is False  # nobody has told where it is
