# SPDX-License-Identifier: Apache-2.0
"""Runs in 3D in a browser: bodies are where Pinocchio says, and one time cursor moves them and the figures."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from browser import needs_browser, opened
from playwright.sync_api import Browser, Page
from plotly.offline import get_plotlyjs_version
from reports import APART
from scenes import PHYSICS, joints_track

from impact_rs_analysis.evidence.tracks import ArmTrack, Track, TrackSide
from impact_rs_analysis.report.animation import animation_data
from impact_rs_analysis.report.page import BUNDLE, TEMPLATES
from impact_rs_analysis.report.scene_3d import described_scene
from impact_rs_cli.main import main
from impact_rs_sim.physics import Physics
from impact_rs_sim.robots.robot import Mesh
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_trials.bags.reader import TrialBag
from impact_rs_trials.spec import TrialSpec

LARGEST_PAGE = 3e6  # bytes
DESK = {"width": 1280, "height": 720}
PHONE = {"width": 390, "height": 844}


@pytest.fixture(scope="module")
def windows(browser: Browser) -> Iterator[Callable[[Path], Page]]:
    """Windows that stay open for the tests of this file; whatever a page complains of is wrong."""
    pages: dict[Path, Page] = {}
    with ExitStack() as held:

        def window(path: Path) -> Page:
            if path not in pages:
                pages[path] = held.enter_context(opened(browser, path.as_uri(), reduced_motion="reduce"))
            return pages[path]

        yield window


@pytest.fixture
def shown(windows: Callable[[Path], Page]) -> Callable[[Path], Page]:
    """Shows a page as it begins."""

    def show(path: Path) -> Page:
        page = windows(path)
        page.set_viewport_size(DESK)
        page.evaluate("""() => { const {replay} = window.impact_rs ?? {};
            if (replay) { replay.speed.value = 'slow'; replay.larger.value = '1'; replay.show(0); } }""")
        return page

    return show


@pytest.fixture
def trial(report: Callable[[str], Path]) -> Path:
    """The page of a push."""
    return report("trial")


def until(page: Page, condition: str) -> None:
    """Wait for something in the page, picture by picture; its policy forbids what ``wait_for_function`` does."""
    page.evaluate(f"async () => {{ while (!({condition})) await new Promise(requestAnimationFrame); }}")


ALONE = """<!DOCTYPE html><meta charset="utf-8"><div id="here"></div>
<script>{three}</script><script>{replay}</script>
<script>var here = document.getElementById('here'); {program}</script>"""


def component(path: Path, program: str) -> Path:
    """The 3D alone, as another page has it: two scripts, a program, and one element."""
    three, replay = (BUNDLE / "three.min.js").read_text(), (TEMPLATES / "replay.js").read_text()
    path.write_text(ALONE.format(three=three, replay=replay, program=program))
    return path


CORNERS = ("0 0 0", "0 .1 0", ".1 0 0", "0 0 0", ".1 0 0", "0 0 .1", "0 0 0", "0 0 .1", "0 .1 0")
TRIANGLES = "solid\n" + "".join(f"vertex {corner}\n" for corner in CORNERS)


def sliding(physics: Physics) -> Physics:
    """The same with one joint of the right arm that slides along its axis."""
    arm = physics.arms["right"]
    joints = list(arm.facts.joints)
    joints[2] = joints[2].model_copy(update={"type": "prismatic"})
    facts = arm.facts.model_copy(update={"joints": tuple(joints)})
    return replace(physics, arms=physics.arms | {"right": replace(arm, facts=facts)})


@needs_browser
def test_links_of_every_arm_are_where_pinocchio_says(shown: Callable[[Path], Page], tmp_path: Path) -> None:
    """Two arms, mounted apart, of seven joints and of six, one of which slides; between two samples as well."""
    (tmp_path / "base.stl").write_text(TRIANGLES)
    physics = sliding(PHYSICS)
    left = physics.arms["left"]
    base = Mesh(file=(tmp_path / "base.stl").as_uri())
    facts = left.facts.model_copy(update={"base_meshes": (base,)})
    physics = replace(physics, arms=physics.arms | {"left": replace(left, facts=facts)})
    time, rng = np.arange(11) / 100.0, np.random.default_rng(1)
    sides = [
        {
            name: rng.uniform(-0.5, 0.5, (time.size, own.facts.joint_count)).astype("<f4").astype(float)
            for name, own in physics.arms.items()
        }
        for _ in range(2)
    ]
    data = json.dumps(animation_data([joints_track(time, *sides, impact=0.05, physics=physics)]))
    page = shown(component(tmp_path / "page.html", f"var replay = new ImpactReplay(here, {data});"))
    mesh = "replay.measured.links.left_base.children.find((child) => child.isMesh)"
    assert page.evaluate(f"{mesh}.geometry.attributes.position.count") == len(CORNERS)  # the arm's own mesh is seen
    for moment, before, share in ((0.0, 0, 0.0), (0.05, 5, 0.0), (0.073, 7, 0.3), (0.1, 10, 0.0)):
        after = min(before + 1, time.size - 1)
        found = page.evaluate(
            "(time) => { replay.seek(time); return [replay.measured.positions(), replay.model.positions()]; }", moment
        )
        for side, positions in zip(sides, found, strict=True):
            for name, model in physics.robot_models().items():
                rows = side[name]
                q = (1.0 - share) * rows[before] + share * rows[after]
                for link, placement in model.link_placements(q).items():
                    assert positions[f"{name}_{link}"] == pytest.approx(placement.translation, abs=1e-6), (name, link)


@needs_browser
def test_neighbours_of_the_object_are_where_they_were_measured(shown: Callable[[Path], Page], tmp_path: Path) -> None:
    """And those of the model where they were predicted; one that was not tracked is not shown."""
    spec = TrialSpec.of(load_scenario("push_two_boxes"), "box", "case_1")
    physics, time = spec.scene.physics, np.arange(5) / 100.0
    poses = np.column_stack((time, 0.0 * time, 0.5 - time, np.tile([0.0, 0.0, 0.0, 1.0], (5, 1))))
    arms = {"arm": ArmTrack(np.tile(spec.scene.arms["arm"].position, (5, 1)))}
    sides = [TrackSide(arms, poses, neighbours={"behind": poses + shift}) for shift in (0.25, np.nan)]
    track = Track("two", time, physics=physics, measured=sides[0], predicted=sides[1])
    data = json.dumps(animation_data([track]))
    page = shown(component(tmp_path / "page.html", f"var replay = new ImpactReplay(here, {data});"))
    measured, model = page.evaluate(
        """() => { replay.seek(0.02); return [replay.measured, replay.model].map((side) =>
             side.objects.map((one) => one.visible && one.position.toArray())); }"""
    )
    assert measured[0] == pytest.approx(poses[2, :3], abs=1e-6)
    assert measured[1] == pytest.approx(poses[2, :3] + 0.25, abs=1e-6)
    assert model[0] == pytest.approx(poses[2, :3], abs=1e-6) and model[1] is False


ROBOT = """<robot name="r"><link name="foot"/><link name="a"/><link name="b"/><link name="c"/><link name="tip"/>
<joint name="one" type="revolute"><parent link="foot"/><child link="a"/><origin xyz="0.1 0 0.3" rpy="0.3 -0.2 0.1"/>
<axis xyz="1 2 -2"/><limit lower="-3" upper="3" velocity="1" effort="1"/></joint>
<joint name="two" type="prismatic"><parent link="a"/><child link="b"/><origin xyz="0 0.2 0" rpy="0 0.5 0"/>
<axis xyz="0 -1 0"/><limit lower="-3" upper="3" velocity="1" effort="1"/></joint>
<joint name="three" type="revolute"><parent link="b"/><child link="c"/><origin xyz="0.2 0 0.1"/>
<limit lower="-3" upper="3" velocity="1" effort="1"/></joint>
<joint name="end" type="fixed"><parent link="c"/><child link="tip"/><origin xyz="0 0.1 0.4"/></joint></robot>"""


@needs_browser
def test_links_of_another_robot_are_where_pinocchio_says(shown: Callable[[Path], Page], tmp_path: Path) -> None:
    """Joints turn about and slide along axes that are not z; there is no arm of ours and no object."""
    scene, _ = described_scene(ROBOT)
    path = component(tmp_path / "live.html", f"var live = new ImpactLive(here); live.show({json.dumps(scene)});")
    page, model = shown(path), pin.buildModelFromXML(ROBOT)
    data = model.createData()
    for q in np.random.default_rng(1).uniform(-1.0, 1.0, (3, 3)):
        found = page.evaluate(
            "(joints) => { live.update({time: null, joints, object: null, forces: null});"
            " return live.measured.positions(); }",
            q.tolist(),
        )
        pin.framesForwardKinematics(model, data, q)
        for link in ("a", "b", "c", "tip"):
            assert found[link] == pytest.approx(data.oMf[model.getFrameId(link)].translation, abs=1e-6), link


def check_where_it_was_measured(page: Page, bag: TrialBag, moments: tuple[float, ...]) -> None:
    """End effector and object of the page are where the bag's sample nearest to each moment [s] has them."""
    measured, seen = bag.joints("/arm/joint_states"), bag.poses("/object/pose")
    model = bag.info.spec.scene.physics.robot_model("arm")
    for moment in moments:
        row, tracked = int(np.argmin(np.abs(measured.time - moment))), int(np.argmin(np.abs(seen.time - moment)))
        hand, box = page.evaluate(
            """(time) => { const {replay} = window.impact_rs; replay.seek(time);
                 return [replay.measured.positions().arm_end_effector, replay.measured.object.position.toArray()]; }""",
            moment,
        )
        assert hand == pytest.approx(model.placement(measured.position[row]).translation, abs=1e-6)
        assert box == pytest.approx(seen.position[tracked], abs=1e-6)


@needs_browser
def test_end_effector_and_object_of_a_trial_are_where_they_were_measured(
    shown: Callable[[Path], Page], trial: Path, bag: TrialBag
) -> None:
    check_where_it_was_measured(shown(trial), bag, (0.0, 0.9, 0.904, 0.94, 1.8))


CURSORS = """() => [...document.querySelectorAll('.plot[data-run]')].map((plot) => {
  const line = plot.querySelector('.cursor'), axis = plot._fullLayout.xaxis, box = plot.getBoundingClientRect();
  return line.hidden ? null : axis.p2d(line.getBoundingClientRect().left + 1 - box.left - axis._offset);
})"""


@needs_browser
def test_one_seek_moves_the_bodies_and_the_line_in_every_figure(shown: Callable[[Path], Page], trial: Path) -> None:
    page = shown(trial)
    until(page, "document.querySelectorAll('.cursor').length === 3")
    for moment in (0.3, 0.91):
        page.evaluate("(time) => window.impact_rs.replay.seek(time)", moment)
        assert page.evaluate(CURSORS) == pytest.approx([moment] * 3, abs=2e-3)  # a pixel
        assert f"{moment:.3f} s" in page.inner_text(".replay-time")


@needs_browser
def test_a_tap_on_a_curve_moves_the_time(shown: Callable[[Path], Page], trial: Path) -> None:
    page = shown(trial)
    plot = page.locator(".plot[data-run]").first
    plot.scroll_into_view_if_needed()
    until(page, "document.querySelectorAll('.cursor').length === 3")
    x, y = plot.evaluate(
        """(plot) => {
             const {xaxis, yaxis} = plot._fullLayout, curve = plot.calcdata[1], {x, y} = curve[curve.length >> 2];
             return [xaxis._offset + xaxis.d2p(x), yaxis._offset + yaxis.d2p(y)]; }"""
    )
    plot.click(position={"x": x, "y": y})
    until(page, "Math.abs(window.impact_rs.replay.time - 0.902) > 0.1")


@needs_browser
def test_the_keyboard_plays_steps_and_finds_the_impact(shown: Callable[[Path], Page], trial: Path) -> None:
    page = shown(trial)

    def time() -> float:
        return float(page.evaluate("window.impact_rs.replay.time"))

    page.get_by_role("button", name="Impact").click()
    page.locator(".replay input[type=range]").focus()
    impact = time()
    for key, expected in (
        ("ArrowRight", impact + 0.001),
        ("Shift+ArrowRight", impact + 0.011),
        ("ArrowLeft", impact + 0.010),
        ("Home", 0.0),
        ("End", 1.8),
        ("i", impact),
    ):
        page.keyboard.press(key)
        assert time() == pytest.approx(expected, abs=1e-6), key
    page.keyboard.press("Home")
    page.keyboard.press("Space")
    until(page, "window.impact_rs.replay.playing && window.impact_rs.replay.time > 0.05")
    page.keyboard.press("Space")
    assert page.evaluate("window.impact_rs.replay.playing") is None
    assert page.get_by_role("button", name="Play").is_visible()


@needs_browser
def test_the_impact_is_played_a_hundred_times_slower(shown: Callable[[Path], Page], trial: Path) -> None:
    """80 ms of the slider's 1.8 s are 8 s of playing time; at 1 : 1 they are as long as they were."""
    page = shown(trial)
    length = """() => { const {replay} = window.impact_rs;
      return [replay.playedAt(0.962) - replay.playedAt(0.882), replay.length]; }"""
    begin = page.evaluate("window.impact_rs.replay.run.impact") - 0.02
    assert begin == pytest.approx(0.882, abs=2e-3)
    slow, whole = page.evaluate(length)
    assert slow == pytest.approx(8.0, abs=0.2)
    assert whole == pytest.approx(1.72 + 8.0, abs=1e-3)
    page.get_by_label("speed").select_option("1 : 1")
    assert page.evaluate(length) == pytest.approx([0.08, 1.8], abs=1e-5)
    page.get_by_label("speed").select_option("slow")


@needs_browser
def test_nothing_moves_by_itself_and_everything_has_an_accessible_name(
    shown: Callable[[Path], Page], trial: Path
) -> None:
    page = shown(trial)
    assert page.evaluate("window.impact_rs.replay.playing") is None
    assert "0 ms" not in (page.get_by_role("slider", name="time").get_attribute("aria-valuetext") or "")
    assert page.get_by_role("group", name=re.compile("space plays")).is_visible()


@pytest.fixture(scope="module")
def laboratory_page(bag: TrialBag, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page of the same push, as a run of a laboratory."""
    folder = tmp_path_factory.mktemp("laboratory")
    shutil.copytree(bag.path, folder / "run_1")
    (folder / "runs.csv").write_text("bag,object,kind\nrun_1,cat_food,hit\n")
    (folder / "experiment.yaml").write_text("scenario: push\nmapping: impact_rs\n")
    page = folder / "page.html"
    command = ["show", str(folder), "--experiment", str(folder / "experiment.yaml"), "--run", "run_1"]
    assert main([*command, "--no-browser", "-o", str(page), "--jobs", "1"]) == 0
    return page


@needs_browser
def test_a_laboratory_run_begins_at_its_impact_and_moves_as_measured(
    shown: Callable[[Path], Page], laboratory_page: Path, bag: TrialBag
) -> None:
    page = shown(laboratory_page)
    until(page, "document.querySelectorAll('.cursor').length === 3")
    begin = page.evaluate("window.impact_rs.replay.time")
    assert begin == pytest.approx(bag.impact_time("arm"), abs=0.003)
    assert page.evaluate("window.impact_rs.replay.run.slow") == pytest.approx([begin - 0.02, begin + 0.06])
    check_where_it_was_measured(page, bag, (0.3, 0.94, 1.8))


@needs_browser
def test_the_run_that_is_chosen_is_seen_beside_its_model(
    shown: Callable[[Path], Page], report: Callable[[str], Path]
) -> None:
    """And what the model does differently is shown as many times as large as was chosen."""
    page = shown(report("comparison"))
    labels = page.locator("#track-set option").all_inner_texts()
    page.get_by_label("run over time").select_option(labels[-1])
    assert page.evaluate("window.impact_rs.replay.run.label") == labels[-1]
    until(page, "document.querySelectorAll('.cursor').length === 1")
    page.evaluate("window.impact_rs.replay.seek(0.95)")
    assert page.evaluate(CURSORS) == pytest.approx([0.95], abs=2e-3)
    ghost = """(larger) => { const {replay} = window.impact_rs; replay.larger.value = larger; replay.seek(1.2);
      const at = (bodies) => bodies.object.position.toArray();
      return at(replay.model).map((one, i) => one - at(replay.measured)[i]); }"""
    for larger in ("1", "10"):
        assert page.evaluate(ghost, larger) == pytest.approx([0.0, float(larger) * APART, 0.0], abs=1e-6)


@needs_browser
def test_what_was_not_recorded_is_neither_played_nor_made_up(
    shown: Callable[[Path], Page], report: Callable[[str], Path]
) -> None:
    """Between two stretches the bodies stay where the first one ends."""
    page = shown(report("comparison"))
    hand = """(time) => { const {replay} = window.impact_rs;
      replay.seek(time); return replay.measured.positions().left_end_effector; }"""
    before, between, after = (page.evaluate(hand, time) for time in (0.3, 0.55, 0.81))
    assert between == pytest.approx(before, abs=1e-6) and between != pytest.approx(after, abs=1e-3)
    played = [page.evaluate("(time) => window.impact_rs.replay.playedAt(time)", time) for time in (0.3, 0.8)]
    assert played[0] == pytest.approx(played[1], abs=1e-6)


@needs_browser
@pytest.mark.parametrize("kind", ["trial", "comparison", "analysis"])
def test_a_page_with_bodies_in_3d_fits_a_phone_and_is_no_larger_than_a_mail(
    shown: Callable[[Path], Page], kind: str, report: Callable[[str], Path]
) -> None:
    path = report(kind)
    page = shown(path)
    page.set_viewport_size(PHONE)
    until(page, f"document.documentElement.scrollWidth <= {PHONE['width']}")  # figures follow a little later
    assert path.stat().st_size <= LARGEST_PAGE


PICTURE = """(time) => { const {replay} = window.impact_rs, {canvas} = replay; replay.seek(time);
  const copy = Object.assign(document.createElement('canvas'), {width: canvas.width, height: canvas.height});
  const pen = copy.getContext('2d'), colours = {};
  pen.drawImage(canvas, 0, 0);
  new Uint32Array(pen.getImageData(0, 0, copy.width, copy.height).data.buffer).forEach((colour) => {
    colours[colour] = 1 + (colours[colour] || 0);
  });
  return colours; }"""
COUNT = """() => { const {renderer} = window.impact_rs.replay, own = renderer.render.bind(renderer);
  window.drawn = 0; renderer.render = (...given) => { window.drawn += 1; own(...given); }; }"""
OUT_OF_SIGHT = {
    "scrollTo(0, document.body.scrollHeight)": "scrollTo(0, 0)",
    "document.querySelector('.replay').hidden = true": "document.querySelector('.replay').hidden = false",
}
SEEK = "(time) => window.impact_rs.replay.seek(time)"


@needs_browser
def test_what_is_in_sight_is_drawn_and_what_is_out_of_sight_when_it_comes_back(browser: Browser, trial: Path) -> None:
    """Kills a scene that stays empty or old, and one that is drawn while nobody sees it."""
    with opened(browser, trial.as_uri(), webgl=True, reduced_motion="reduce") as page:
        until(page, "window.impact_rs.replay.inSight && !window.impact_rs.replay.stale")
        assert page.get_by_role("img", name=re.compile("in 3D")).is_visible()
        at_rest, at_impact = page.evaluate(PICTURE, 0.0), page.evaluate(PICTURE, 0.91)
        assert len(at_impact) > 100 and at_rest != at_impact
        page.evaluate(COUNT)
        for hide, show in OUT_OF_SIGHT.items():
            page.evaluate(hide)
            until(page, "window.impact_rs.replay.inSight === false")
            before = page.evaluate("window.drawn")
            for time in (0.1, 0.2, 0.3):
                page.evaluate(SEEK, time)
            assert page.evaluate("window.drawn") == before
            page.evaluate(show)
            until(page, f"window.drawn > {before} && !window.impact_rs.replay.stale")


@needs_browser
def test_without_webgl_the_page_says_so_and_the_time_moves_the_figures(
    shown: Callable[[Path], Page], trial: Path
) -> None:
    page = shown(trial)
    assert "no WebGL" in page.inner_text(".replay")
    until(page, "document.querySelectorAll('.cursor').length === 3")
    page.evaluate(SEEK, 0.3)
    assert page.evaluate(CURSORS) == pytest.approx([0.3] * 3, abs=2e-3)


def test_figures_are_drawn_by_the_plotly_that_python_writes_for() -> None:
    head = (BUNDLE / "plotly-cartesian.min.js").read_text(encoding="utf-8")[:100]
    assert f"plotly.js (cartesian - minified) v{get_plotlyjs_version()}" in head


def test_the_bundle_is_of_the_versions_that_its_recipe_names() -> None:
    recipe = json.loads((BUNDLE / "package.json").read_text(encoding="utf-8"))["devDependencies"]
    assert recipe["plotly.js-cartesian-dist-min"] == get_plotlyjs_version()
    assert f"three.js {recipe['three']}, MIT" in (BUNDLE / "three.min.js").read_text(encoding="utf-8")[:100]
    for name in ("three", "plotly"):
        assert "MIT License" in (BUNDLE / f"LICENSE.{name}.txt").read_text().replace("The MIT", "MIT")
