# SPDX-License-Identifier: Apache-2.0
"""A bag is complete or it has no name."""

from __future__ import annotations

import errno
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
import yaml
from rosbags.interfaces import QosDurability
from rosbags.rosbag2 import Reader

from impact_rs_sim.errors import InputError
from impact_rs_trials.bags import topics, writer
from impact_rs_trials.bags.types import typestore
from impact_rs_trials.bags.writer import BagWriter, partial_path

STORE = typestore()
TOPIC = topics.joint_states("arm")


def message(number: int):
    types = STORE.types
    header = types["std_msgs/msg/Header"](
        stamp=types["builtin_interfaces/msg/Time"](sec=number, nanosec=0), frame_id="world"
    )
    return types[topics.JOINT_STATE](
        header=header, name=["a"], position=np.array([float(number)]), velocity=np.zeros(0), effort=np.zeros(0)
    )


def text(value: str):
    return STORE.types[topics.STRING](data=value)


def read(path: Path) -> list[tuple[str, int]]:
    with Reader(path) as reader:
        return [(connection.topic, stamp) for connection, stamp, _ in reader.messages()]


def said(path: Path, name: str) -> str | None:
    """An entry of the metadata."""
    with Reader(path) as reader:
        return (reader.storage.metadata.custom or {}).get(name)


def test_a_finished_bag_has_name_and_outcome_and_leaves_nothing(tmp_path: Path) -> None:
    path = tmp_path / "runs" / "trial"
    with BagWriter.create(path, ["arm"]) as bag:
        assert partial_path(path).is_dir()
        assert not path.exists()
        for number in range(3):
            bag.write(TOPIC, 10 * number, message(number))
        bag.finish("OK")
    assert said(path, "outcome") == "OK"
    assert read(path) == [(TOPIC, 0), (TOPIC, 10), (TOPIC, 20)]
    assert bag.messages == 3
    assert [entry.name for entry in path.parent.iterdir()] == ["trial"]


def test_a_bag_says_which_topics_it_could_have_and_lacks(tmp_path: Path) -> None:
    whole = [name for name in topics.recorded(["arm"]) if name != topics.DIAGNOSTICS]
    for name, present in (
        ("whole", whole),
        ("robot", [name for name in whole if not name.startswith((topics.TRUTH, topics.CLOCK))]),
        ("careless", [name for name in whole if name not in (topics.truth_joint_states("arm"), topics.OBJECT_POSE)]),
        ("without impact", [name for name in whole if name != topics.impact_event("arm")]),
    ):
        with BagWriter.create(tmp_path / name, ["arm"]) as bag:
            for topic in present:
                bag.write_raw(topic, 0, b"\0\1\0\0")
            bag.finish("OK")
    assert [said(tmp_path / name, "missing") for name in ("whole", "robot", "careless", "without impact")] == [
        None,
        "/clock, /truth",
        "/object/pose, /truth/arm/joint_states",
        None,
    ]


def test_topics_are_written_in_the_order_they_came_whatever_is_kept_back(tmp_path: Path) -> None:
    path = tmp_path / "trial"
    raw = bytes(STORE.serialize_cdr(message(7), topics.JOINT_STATE))
    with BagWriter.create(path, ["arm"]) as bag:
        bag.write(TOPIC, 1, message(1))
        bag.write(topics.ROBOT_DESCRIPTION, 2, text("urdf"))
        bag.write_raw(TOPIC, 3, raw)
        bag.write(TOPIC, 4, message(4))
        bag.finish("OK")
    assert read(path) == [(TOPIC, 1), (topics.ROBOT_DESCRIPTION, 2), (TOPIC, 3), (TOPIC, 4)]


def test_more_than_a_block_of_messages_loses_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(writer, "MAX_BLOCK_MESSAGES", 4)
    path = tmp_path / "trial"
    with BagWriter.create(path, ["arm"]) as bag:
        for number in range(11):
            bag.write(TOPIC, number, message(number))
        bag.finish("OK")
    assert [stamp for _, stamp in read(path)] == list(range(11))


def test_a_trial_that_breaks_off_is_kept_under_its_hidden_name_as_aborted(tmp_path: Path) -> None:
    path = tmp_path / "trial"
    with pytest.raises(RuntimeError, match="plug pulled"), BagWriter.create(path, ["arm"]) as bag:
        bag.write(TOPIC, 0, message(0))
        raise RuntimeError("plug pulled")
    assert not path.exists()
    assert said(partial_path(path), "outcome") == "ABORTED"
    assert len(read(partial_path(path))) == 1
    with BagWriter.create(path, ["arm"]) as again:  # the next attempt starts from nothing
        again.finish("OK")
    assert read(path) == []


def test_a_full_disk_leaves_no_half_of_a_bag(tmp_path: Path) -> None:
    path = tmp_path / "trial"
    with pytest.raises(OSError, match="space") as caught, BagWriter.create(path, ["arm"]) as bag:
        bag.write(TOPIC, 0, message(0))
        raise OSError(errno.ENOSPC, "no space left")
    assert caught.value.filename == str(path)
    assert not partial_path(path).exists()


def test_a_bag_that_is_there_is_never_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "trial"
    with BagWriter.create(path, ["arm"]) as bag:
        bag.finish("OK")
    with pytest.raises(InputError, match="exists already"):
        BagWriter.create(path, ["arm"])
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written"):
        BagWriter.create(tmp_path / "file" / "trial", ["arm"])


def test_topics_with_one_message_are_latched_on_playback(tmp_path: Path) -> None:
    path = tmp_path / "trial"
    with BagWriter.create(path, ["arm"]) as bag:
        bag.finish("OK")
    with Reader(path) as reader:
        for connection in reader.connections:
            profiles = connection.ext.offered_qos_profiles
            latched = [profile.durability for profile in profiles] == [QosDurability.TRANSIENT_LOCAL]
            assert latched == (connection.topic in (topics.TF_STATIC, *topics.latched(["arm"]))), connection.topic


@pytest.mark.parametrize("truth", [True, False])
def test_a_bag_has_every_topic_and_the_truth_only_where_known(tmp_path: Path, truth: bool) -> None:
    path = tmp_path / "trial"
    with BagWriter.create(path, ["left", "right"], truth) as bag:
        bag.finish("OK")
    with Reader(path) as reader:
        found = {connection.topic for connection in reader.connections}
    assert {topics.joint_states("left"), topics.controller_state("right"), topics.OBJECT_POSE} <= found
    assert any(name.startswith(topics.TRUTH) for name in found) == truth


def test_a_bag_says_its_offers_and_when_it_was_recorded(tmp_path: Path) -> None:
    before = datetime.now(UTC).replace(microsecond=0)
    with BagWriter.create(tmp_path / "trial", ["arm"]) as bag:
        bag.write(TOPIC, 0, message(0))
        bag.finish("OK")
    metadata = yaml.safe_load((tmp_path / "trial" / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert before <= datetime.fromisoformat(metadata["custom_data"]["recorded"]) <= datetime.now(UTC)
    described = [entry["topic_metadata"] for entry in metadata["topics_with_message_count"]]
    offered = {entry["name"]: entry["offered_qos_profiles"] for entry in described}
    assert offered.keys() == topics.recorded(["arm"]).keys()
    assert all(len(profiles) == 1 for profiles in offered.values())
    found = {topic: (profiles[0]["depth"], profiles[0]["durability"]) for topic, profiles in offered.items()}
    assert found[TOPIC] == (4000, "volatile")
    assert found[topics.TF] == (100, "volatile")
    assert found[topics.CLOCK] == found[topics.DIAGNOSTICS] == found[topics.impact_event("arm")] == (10, "volatile")
    assert found[topics.TF_STATIC] == found[topics.OBJECT_DESCRIPTION] == (1, "transient_local")
    assert {profiles[0]["reliability"] for profiles in offered.values()} == {"reliable"}


def test_a_name_that_no_folder_can_have_is_refused(tmp_path: Path) -> None:
    """Kills a raw OSError of a name with more than 255 bytes."""
    with pytest.raises(InputError, match="cannot be written: File name too long"):
        BagWriter.create(tmp_path / ("x" * 256), ["arm"])


def test_a_folder_that_appears_while_its_bag_is_recorded_is_left_alone(tmp_path: Path) -> None:
    """Kills a raw OSError, which did not say where the bag is."""
    path = tmp_path / "trial"
    with pytest.raises(InputError, match=r"cannot be made: Directory not empty; the bag is in .*/\.partial/trial"):  # noqa: SIM117
        with BagWriter.create(path, ["arm"]) as bag:
            bag.write(TOPIC, 0, message(0))
            (path / "of_another_program").mkdir(parents=True)
            bag.finish("OK")
    assert read(partial_path(path)) == [(TOPIC, 0)]
