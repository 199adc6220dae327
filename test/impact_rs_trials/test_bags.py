# SPDX-License-Identifier: Apache-2.0
"""Bags: what goes in comes out, and the columnar way is byte for byte the one of ``rosbags``."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from trials import plan_of

import impact_msgs_py
from impact_rs_sim.scenarios.scenario import Scenario
from impact_rs_trials.bags import cdr, topics
from impact_rs_trials.bags.reader import BagError, TrialBag
from impact_rs_trials.bags.trial_info import TrialKey
from impact_rs_trials.bags.types import typestore

STORE = typestore()
OLD_BAG = Path(__file__).parent / "data" / "bag_of_0_1_0" / "cat_food__case_2__s1.000__r0"  # two topics of it


def test_every_topic_of_a_trial_is_encoded_as_rosbags_does(push_bag: Path) -> None:
    with Reader(push_bag) as reader:
        for connection in reader.connections:
            rows = [bytes(data) for _, _, data in reader.messages(connections=[connection])]
            messages = [STORE.deserialize_cdr(row, connection.msgtype) for row in rows]
            if messages:
                assert [bytes(row) for row in cdr.encode(STORE, connection.msgtype, messages)] == rows


def test_every_column_of_a_trial_is_decoded_as_rosbags_does(push_bag: Path) -> None:
    bag = TrialBag.open(push_bag)
    messages = bag.messages(topics.controller_state("arm"))
    columns = bag.controller("arm")
    for name in ("mode", "gamma", "twist", "commanded_torque", "qp_iterations", "feedback_acceleration"):
        np.testing.assert_array_equal(getattr(columns, name), [getattr(m, name) for m in messages])
    joints = bag.joints(topics.joint_states("arm"))
    assert joints.position.shape == (joints.time.size, 7)
    assert bag.joints(topics.motor_states("arm")).effort.size == 0
    poses = bag.poses(topics.OBJECT_POSE)
    np.testing.assert_allclose(np.linalg.norm(poses.quaternion, axis=1), 1.0)


def test_somebody_elses_reader_reads_our_bag(push_bag: Path) -> None:
    from mcap_ros2.reader import read_ros2_messages

    path = next(push_bag.glob("*.mcap"))
    states = [m.ros_msg for m in read_ros2_messages(str(path), topics=["/arm/controller_state"])]
    ours = TrialBag.open(path.parent).controller("arm")
    assert len(states) == ours.time.size
    np.testing.assert_array_equal([m.twist for m in states[::100]], ours.twist[::100])


@pytest.mark.parametrize(
    ("make", "reason"),
    [
        (lambda path: path.mkdir(), "empty folder"),
        (lambda path: (path.mkdir(), (path / "x.mcap").write_bytes(b"")), "cut off"),
        (lambda path: path.write_bytes(b""), "bare file"),
        (lambda path: (path.mkdir(), (path / "metadata.yaml").write_text("a: [")), "bag"),
        (lambda path: (path.mkdir(), (path / "metadata.yaml").write_text("just text")), "bag"),
    ],
)
def test_a_folder_that_is_no_trial_is_refused_with_the_reason(tmp_path: Path, make, reason: str) -> None:
    make(tmp_path / "bag")
    with pytest.raises(BagError, match=reason):
        TrialBag.open(tmp_path / "bag")


def test_a_foreign_bag_says_why(push_bag: Path, tmp_path: Path, rewrite_bag) -> None:
    rewrite_bag(push_bag, tmp_path / "bag", lambda topic: topic != topics.TRIAL_INFO)
    with pytest.raises(BagError, match="not a trial of impact_rs"):
        TrialBag.open(tmp_path / "bag")


def test_a_bag_of_version_0_1_0_is_read_by_its_former_names() -> None:
    with Reader(OLD_BAG) as reader:
        definition = next(c.msgdef.data for c in reader.connections if c.topic == topics.TRIAL_INFO)
    assert "string scenario_yaml" in definition
    assert "scenario_json" not in definition
    bag = TrialBag.open(OLD_BAG)
    assert bag.outcome == "OK"
    assert bag.info.key == TrialKey("cat_food", "case_2", 1.0, 0)
    assert Scenario.model_validate_json(bag.info.scenario_json).name == bag.info.scenario == "push"
    assert (bag.info.model_yaml, bag.info.package_version, bag.info.via) == ("", "0.1.0", "inprocess")
    assert 0.89 < bag.impact_time("arm") < 0.92


def test_a_bag_with_other_fields_is_read_by_its_own_definitions(push_campaign: Path, tmp_path: Path) -> None:
    """As written with ``end_effector_twist``, the same numbers as ``twist``; as up to 0.2.0."""
    bag = TrialBag.open(sorted(push_campaign.glob("cat_food*"))[0])
    topic, kind = topics.controller_state("arm"), topics.CONTROLLER_STATE
    lines = (Path(impact_msgs_py.__file__).parent / "msg" / "ControllerState.msg").read_text().splitlines()
    definition = "\n".join((*lines, "geometry_msgs/Twist end_effector_twist"))
    before = get_typestore(Stores.ROS2_JAZZY)
    before.register(get_types_from_msg(definition, kind))
    fields = [name for name, _ in typestore().fielddefs[kind][1]]
    twist, vector = (before.types[f"geometry_msgs/msg/{name}"] for name in ("Twist", "Vector3"))

    def longer(one: Any) -> Any:
        parts = twist(linear=vector(*one.twist[:3]), angular=vector(*one.twist[3:]))
        return before.types[kind](**{name: getattr(one, name) for name in fields}, end_effector_twist=parts)

    with Writer(tmp_path / "old", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        told = writer.add_connection(topics.TRIAL_INFO, topics.TRIAL_INFO_TYPE, typestore=typestore())
        writer.write(told, 0, bag.serialized(topics.TRIAL_INFO)[0])
        states = writer.add_connection(topic, kind, typestore=before)
        for number, state in enumerate(bag.messages(topic)):
            writer.write(states, number, before.serialize_cdr(longer(state), kind))
    old = TrialBag.open(tmp_path / "old")
    for name, column in vars(bag.controller("arm")).items():
        np.testing.assert_array_equal(getattr(old.controller("arm"), name), column)
    state = old.messages(topic)[7]
    np.testing.assert_array_equal(state.twist, bag.messages(topic)[7].twist)
    assert state.end_effector_twist.linear.x == state.twist[0]
    assert not hasattr(bag.messages(topic)[7], "end_effector_twist")


def test_a_cell_that_tells_no_truth_gives_the_same_bag_without_it(push_bag: Path, tmp_path: Path) -> None:
    from impact_rs_control.closed_loop import make_plant
    from impact_rs_trials.bags.record import record_cell

    told = TrialBag.open(push_bag)
    plan = plan_of("push", "cat_food", "case_2")
    verdict, _ = record_cell(plan, told.info, tmp_path / "bag", make_plant(plan, told.info.seed))
    silent = TrialBag.open(tmp_path / "bag")
    assert verdict.outcome == told.outcome
    assert any(topic.startswith(topics.TRUTH) for topic in told.counts)
    assert silent.counts == {topic: n for topic, n in told.counts.items() if not topic.startswith(topics.TRUTH)}
    for topic in (
        topics.joint_states("arm"),
        topics.motor_states("arm"),
        topics.joint_command("arm"),
        topics.OBJECT_POSE,
    ):
        assert silent.serialized(topic) == told.serialized(topic)
