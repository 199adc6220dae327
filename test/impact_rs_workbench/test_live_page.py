# SPDX-License-Identifier: Apache-2.0
"""The page of a running graph: what it reports of a snapshot, to whom, and when."""

from __future__ import annotations

import asyncio
import json
from dataclasses import replace

import numpy as np
import pytest
from mixed_grab import MIXED
from starlette.testclient import TestClient

from impact_rs_sim.physics import Physics
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_trials.snapshot import IdentifyMessages, Snapshot
from impact_rs_workbench.live_page import LiveView, application, drawn_scene, followed_of, state_of, status_text

PORT, TOKEN = 8124, "the-key-of-the-tests"
PHYSICS = Physics.nominal(MIXED, next(iter(MIXED.objects)))
POSITIONS = {f"left_joint{n + 1}": 0.1 * n for n in range(7)} | {f"right_joint{n + 1}": -0.1 * n for n in range(6)}
SEEN = Snapshot("running", "ROS domain 3, namespace /", 1, "grab, box", PHYSICS, time=0.5, positions=POSITIONS)
ROBOT = """<robot name="r"><link name="foot"/><link name="arm"/><link name="hand"/>
<joint name="b" type="revolute"><parent link="foot"/><child link="arm"/></joint>
<joint name="a" type="revolute"><parent link="arm"/><child link="hand"/></joint></robot>"""


class Graph:
    """Stands one way after the other, and then as it did last."""

    def __init__(self, *snapshots: Snapshot) -> None:
        self.snapshots = list(snapshots)

    def look(self) -> Snapshot:
        return self.snapshots.pop(0) if len(self.snapshots) > 1 else self.snapshots[0]


def test_positions_are_told_arm_after_arm_whatever_their_order_was() -> None:
    shuffled = dict(reversed(POSITIONS.items()))
    state = state_of(replace(SEEN, positions=shuffled), drawn_scene(SEEN))
    assert state is not None
    assert state["joints"] == pytest.approx([0.1 * n for n in range(7)] + [-0.1 * n for n in range(6)])
    assert (state["time"], state["object"], state["forces"]) == (0.5, None, None)


def test_nothing_is_told_until_the_joints_of_every_arm_are_known() -> None:
    left = {name: value for name, value in POSITIONS.items() if name.startswith("left")}
    assert state_of(replace(SEEN, positions=left), drawn_scene(SEEN)) is None
    assert state_of(Snapshot("absent", "here"), drawn_scene(Snapshot("absent", "here"))) is None


def test_forces_are_told_when_those_of_all_arms_are_known() -> None:
    scene, force = drawn_scene(SEEN), np.array([1.0, 2.0, 3.0])
    one = state_of(replace(SEEN, forces={"right": force}), scene)
    both = state_of(replace(SEEN, forces={"right": force, "left": -force}), scene)
    assert one is not None
    assert both is not None
    assert (one["forces"], both["forces"]) == (None, [[-1.0, -2.0, -3.0], [1.0, 2.0, 3.0]])


def test_poses_of_neighbours_are_told_in_the_order_of_the_scene() -> None:
    physics = Physics.nominal(load_scenario("push_two_boxes"), "box")
    joints = {f"arm_joint{number + 1}": 0.0 for number in range(7)}
    seen = Snapshot("running", "here", 1, physics=physics, positions=joints)
    pose = np.array([0.4, -0.1, 0.5, 0.0, 0.0, 0.0, 1.0])
    known = replace(seen, neighbours={"behind": pose})
    states = [state_of(one, drawn_scene(one)) for one in (seen, known)]
    assert [state and state["neighbours"] for state in states] == [[None], [pose.tolist()]]
    assert len(json.loads(drawn_scene(seen).text)["neighbours"]) == 1


def test_a_described_robot_is_told_as_far_as_it_is_known() -> None:
    seen = Snapshot("running", "here", 1, description=ROBOT, positions={"a": 0.3, "elsewhere": 1.0})
    state = state_of(seen, drawn_scene(seen))
    assert state is not None
    assert state["joints"] == [0.0, 0.3]


def test_what_is_going_on_is_one_line_that_says_what_to_do() -> None:
    texts = {
        situation: status_text(replace(SEEN, situation=situation), drawn_scene(SEEN), "impact-rs")
        for situation in ("absent", "idle", "running", "over", "gone")
    }
    assert texts["absent"] == ("no graph runs in ROS domain 3, namespace /; impact-rs up push starts one. Waiting")
    assert texts["running"] == "now: grab, box"
    assert "until the next trial" in texts["over"]
    assert "have ended" in texts["gone"]
    assert len(set(texts.values())) == 5


def test_a_scene_that_cannot_be_drawn_is_told_with_the_reason() -> None:
    odd = Snapshot("running", "here", 1, description="<robot/>")
    assert "the robot of /robot_description cannot be drawn: no URDF" in status_text(odd, drawn_scene(odd), "impact-rs")
    refused = Snapshot("idle", "here", 1, title="push", complaint="/trial_info: no such key")
    assert status_text(refused, drawn_scene(refused), "") == "push cannot be drawn: /trial_info: no such key"


def test_a_new_scene_is_made_once_and_what_goes_on_is_told_when_it_changes() -> None:
    absent = Snapshot("absent", "here")
    graph = Graph(absent, absent, SEEN, replace(SEEN, time=0.6), replace(SEEN, situation="over", time=0.6))
    lines: list[str] = []
    view = LiveView(graph, "impact-rs", lines.append)

    async def until_it_is_over() -> None:
        following = asyncio.create_task(view.follow())
        while len(lines) < 3:
            await asyncio.sleep(0.0)
        following.cancel()

    asyncio.run(until_it_is_over())
    assert [line.split()[0] for line in lines] == ["no", "now:", "at"]
    assert json.loads(view.news["scene"])["arms"] == ["left", "right"]
    assert json.loads(view.news["state"])["time"] == 0.6


def test_followed_hits_are_shown_newest_change_first_and_what_cannot_be_read_is_said() -> None:
    cause = {"effect": "object_mass", "share": 1.0, "since": "r3", "parameters": [], "words": "heavier"}
    change = {"hit": "r4", "since": "r3", "hits": 2, "log10_ratio": 5.0, "false_alarm": 1e5, "causes": [cause],
              "words": "since r3 the object is heavier", "diagnose": "impact-rs diagnose day --since r3"}  # fmt: skip
    texts = tuple(json.dumps(change | {"hit": hit}) for hit in ("r4", "r9"))
    found = followed_of(IdentifyMessages(changes=(*texts, "NaN"), refused='{"hit": "r7", "reason": "NaN in a signal"}'))
    assert [one["hit"] for one in found["changes"]] == ["r9", "r4"]
    assert (found["prediction"], found["diagnosis"]) == (None, None)
    assert found["refused"] == {"hit": "r7", "reason": "NaN in a signal"}
    assert len(found["unreadable"]) == 1
    assert found["unreadable"][0].startswith("a message of identify is not a valid PublishedChange: ")


def test_nobody_without_the_key_is_told_anything() -> None:
    view = LiveView(Graph(SEEN), "impact-rs", lambda _: None)
    stranger = TestClient(application(view, TOKEN, PORT), base_url=f"http://127.0.0.1:{PORT}", follow_redirects=False)
    for path in ("/", "/api/events", "/static/replay.js", "/?token=guessed"):
        answer = stranger.get(path)
        assert (answer.status_code, answer.text) == (
            403, "Open the address that impact-rs show has printed: it contains the access key."
        )  # fmt: skip
    assert stranger.get("/", params={"token": TOKEN}).status_code == 303
    assert "default-src 'none'" in stranger.get("/").headers["content-security-policy"]
    scripts = ("replay.js", "followed.js", "show.js", "stream.js", "tools.js")
    for name in ("palette.css", "page.css", "three.min.js", *scripts):
        assert stranger.get(f"/static/{name}").status_code == 200, name
    assert stranger.get("/static/live.html").status_code == 404
