# SPDX-License-Identifier: Apache-2.0
"""Scenes as data: joints and shapes of our own arms, and of a robot that is described elsewhere."""

from __future__ import annotations

import base64
from dataclasses import replace

import numpy as np
import pytest
from refusals import refusal
from scenes import PHYSICS, joints_track

from impact_rs_analysis.evidence.tracks import Track
from impact_rs_analysis.report.animation import (
    MAX_ROWS_PER_RUN,
    MAX_RUNS_OF_ALL_ROWS,
    ReplayPart,
    animation_data,
    shown_rows,
)
from impact_rs_analysis.report.scene_3d import described_scene, moving_joints, scene_data


def test_every_moving_joint_has_its_column_arm_after_arm() -> None:
    scene = scene_data(PHYSICS)
    columns = {joint["child"]: joint["column"] for joint in scene["joints"] if "column" in joint}
    assert columns == {f"left_link{n + 1}": n for n in range(7)} | {f"right_link{n + 1}": 7 + n for n in range(6)}
    assert scene["arms"] == ["left", "right"]


def test_every_link_hangs_on_the_world_and_the_pad_is_a_box_of_its_size() -> None:
    scene = scene_data(PHYSICS)
    parents = {joint["child"]: joint["parent"] for joint in scene["joints"]}
    for link in scene["links"]:
        way = [link]
        while way[-1] != "world":
            way.append(parents[way[-1]])
    (pad,) = [shape for shape in scene["links"]["left_end_effector"] if shape["kind"] == "box"]
    assert pad["size"] == pytest.approx(PHYSICS.arms["left"].end_effector.pad_size)
    assert scene["object"] == pytest.approx(PHYSICS.object.size)


def test_what_we_describe_ourselves_is_the_same_scene_when_it_is_read() -> None:
    scene, joints = described_scene(PHYSICS.description())
    own = scene_data(PHYSICS)
    assert joints == moving_joints(PHYSICS)
    assert (scene["joints"], scene["links"], scene["root"]) == (own["joints"], own["links"], "world")
    assert (scene["arms"], scene["object"]) == ([], None)


ROBOT = """<robot name="r"><link name="foot"><visual><geometry><sphere radius="0.2"/></geometry></visual></link>
<link name="arm"><visual><geometry><mesh filename="package://nowhere/arm.dae"/></geometry></visual>
<collision><geometry><box size="0.1 0.2 0.3"/></geometry></collision></link>
<link name="bare"><visual><geometry><mesh filename="package://nowhere/bare.dae"/></geometry></visual></link>
<link name="tip"/><link name="finger"/>
<joint name="turn" type="continuous"><parent link="foot"/><child link="arm"/><axis xyz="0 2 0"/></joint>
<joint name="slide" type="prismatic"><parent link="arm"/><child link="bare"/></joint>
<joint name="fixed" type="fixed"><parent link="bare"/><child link="tip"/><origin xyz="0 0 0.4"/></joint>
<joint name="same" type="revolute"><parent link="tip"/><child link="finger"/><mimic joint="turn"/></joint></robot>"""


def test_joints_of_another_robot_keep_their_axes_and_others_stand_still() -> None:
    scene, joints = described_scene(ROBOT)
    assert joints == ["turn", "slide"]
    assert [joint.get("column") for joint in scene["joints"]] == [0, 1, None, None]
    assert [joint.get("axis") for joint in scene["joints"]] == [[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], None, None]
    assert scene["root"] == "foot"


def test_a_link_without_readable_shapes_is_its_collision_shape_or_a_stick() -> None:
    links = described_scene(ROBOT)[0]["links"]
    assert [shape["kind"] for shape in links["arm"]] == ["box"]
    (stick,) = links["bare"]
    assert (stick["kind"], stick["length"], stick["position"]) == ("cylinder", [0.4], [0.0, 0.0, 0.2])
    assert links["tip"] == []


def test_a_sphere_is_a_closed_mesh_of_its_size() -> None:
    (ball,) = described_scene(ROBOT)[0]["links"]["foot"]
    vertices, faces = (
        np.frombuffer(base64.b64decode(ball[name]), "<f4").reshape(-1, 3) for name in ("vertices", "faces")
    )
    assert np.linalg.norm(vertices, axis=1) == pytest.approx(0.2)
    corners = vertices[faces.astype(int)]
    volume = np.sum(np.cross(corners[:, 0], corners[:, 1]) * corners[:, 2]) / 6.0  # positive: faces look outwards
    assert volume == pytest.approx(4.0 / 3.0 * np.pi * 0.2**3, rel=0.1)


@pytest.mark.parametrize(
    "urdf",
    ["no XML", "<robot/>", ROBOT.replace('<child link="arm"/>', '<child link="leg"/>'), ROBOT.replace("0 2 0", "up"),
     ROBOT.replace('<link name="finger"/>', '<link name="finger"/><link name="loose"/>'),
     ROBOT.replace('xyz="0 0 0.4"', 'rpy="0 0"')],
)  # fmt: skip
def test_what_is_no_urdf_is_refused_in_one_line(urdf: str) -> None:
    assert "no URDF that can be drawn" in refusal(described_scene, urdf)


# ---- Runs in 3D as data: samples where they are needed


def moving(time: np.ndarray, starts: tuple[int, ...] = (0,), impact: float | None = 0.5) -> Track:
    """Every joint is where the clock is."""
    joints = {name: np.tile(time, (own.facts.joint_count, 1)).T for name, own in PHYSICS.arms.items()}
    return joints_track(time, joints, starts=starts, impact=impact)


def times(run: dict) -> np.ndarray:
    return np.frombuffer(base64.b64decode(run["time"]), dtype="<f4")


def test_every_sample_about_the_impact_is_kept_and_few_elsewhere() -> None:
    time = np.arange(1001) / 1000.0
    kept = time[shown_rows(moving(time), 0.001, 0.01)]
    assert np.diff(kept[(kept >= 0.48) & (kept <= 0.56)]) == pytest.approx(0.001)
    assert np.diff(kept[kept < 0.48]) == pytest.approx(0.01)
    assert (kept[0], kept[-1]) == (0.0, 1.0)


def test_both_ends_of_every_stretch_are_kept() -> None:
    time = np.concatenate((np.arange(105) / 1000.0, 0.3 + np.arange(105) / 1000.0))
    run = animation_data([moving(time, starts=(0, 105), impact=None)])["runs"][0]
    kept, second = times(run), run["starts"][1]
    assert kept[[0, second - 1, second, -1]] == pytest.approx([0.0, 0.104, 0.3, 0.404])
    assert (run["impact"], run["slow"]) == (None, None)


def test_numbers_are_float32_row_by_row() -> None:
    time = np.arange(3) / 100.0
    (run,) = animation_data([moving(time)])["runs"]
    joints = np.frombuffer(base64.b64decode(run["measured"]["joints"]), dtype="<f4").reshape(3, 13)
    assert joints[2] == pytest.approx(0.02)
    assert (run["measured"]["object"], run["measured"]["forces"], run["model"]) == (None, None, None)


def test_runs_of_one_scene_share_it() -> None:
    run = moving(np.arange(3) / 100.0)
    heavier = replace(run, physics=replace(PHYSICS, object=replace(PHYSICS.object, size=2.0 * PHYSICS.object.size)))
    data = animation_data([run, heavier, run])
    assert [entry["scene"] for entry in data["runs"]] == [0, 1, 0]
    assert len(data["scenes"]) == 2


def test_many_runs_have_fewer_samples_each() -> None:
    run = moving(np.arange(1001) / 1000.0)
    few, many = (
        len(animation_data(count * [run])["runs"][0]["time"])
        for count in (MAX_RUNS_OF_ALL_ROWS, 2 * MAX_RUNS_OF_ALL_ROWS)
    )
    assert many == pytest.approx(few / 2.0, rel=0.1)


def test_a_long_recording_has_no_more_samples_than_are_seen() -> None:
    run = animation_data([moving(np.arange(600_001) / 1000.0, impact=None)])["runs"][0]
    kept = times(run)
    assert MAX_ROWS_PER_RUN <= kept.size <= MAX_ROWS_PER_RUN + 2
    assert (kept[0], kept[-1]) == (0.0, 600.0)


def test_a_page_without_runs_has_no_part() -> None:
    assert ReplayPart.of([]) is None
    one = ReplayPart.of([moving(np.arange(3) / 100.0)])
    assert one is not None
    assert (one.choose, one.labels) == (False, ["run"])
