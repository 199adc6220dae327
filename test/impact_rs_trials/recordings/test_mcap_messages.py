# SPDX-License-Identifier: Apache-2.0
"""MCAP files without ROS: JSON and Protobuf messages of several layouts are imported and read as the arrays are."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from builders import mapping_in
from joint_recordings import swinging
from mcap.writer import Writer
from refusals import refusal

from impact_rs_sim.robots.robot import load_facts
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_trials.recordings.importing.candidates import candidates_of
from impact_rs_trials.recordings.importing.import_recordings import ImportOptions, draft_import
from impact_rs_trials.recordings.mapping import MountedEndEffector
from impact_rs_trials.recordings.readers.mcap_messages import as_message
from impact_rs_trials.recordings.recording import ARM, is_foreign, read_recordings

NAMES = [f"fer_joint{joint}" for joint in (3, 1, 2, 5, 4, 7, 6)]  # not in the order of the arm
ORDER = [int(name[-1]) - 1 for name in NAMES]
START = 1_700_000_000  # s
Layout = Callable[[dict[str, np.ndarray]], dict[str, Any]]


def named(row: dict[str, np.ndarray]) -> dict[str, Any]:
    return {"name": NAMES, **{key: values[ORDER].tolist() for key, values in row.items()}}


def by_joint(row: dict[str, np.ndarray]) -> dict[str, Any]:
    return {key: dict(zip(NAMES, values[ORDER].tolist(), strict=True)) for key, values in row.items()}


def records(row: dict[str, np.ndarray]) -> dict[str, Any]:
    pairs = zip(NAMES, ORDER, strict=True)
    return {"joints": [{"name": name, **{k: float(v[joint]) for k, v in row.items()}} for name, joint in pairs]}


def counted(row: dict[str, np.ndarray]) -> dict[str, Any]:
    short = {"position": "q{}", "velocity": "dq{}", "effort": "joint_{}_torque"}
    cells = ((key, number, one) for key, values in row.items() for number, one in enumerate(values.tolist()))
    return {short[key].format(number + 1): one for key, number, one in cells}


def arrays(row: dict[str, np.ndarray]) -> dict[str, Any]:
    return {"state": {key: values.tolist() for key, values in row.items()}}


@pytest.fixture(scope="module")
def columns() -> dict[str, np.ndarray]:
    steps = np.arange(7)
    speeds = 0.12 + 0.03 * steps, 0.31 + 0.02 * steps  # Hz
    centre = np.array([0.0, 0.0, 0.0, -1.8, 0.0, 1.8, 0.0])
    return swinging(
        RobotModel(load_facts("franka_fer"), MountedEndEffector().build()),
        np.arange(0.0, 12.0, 0.02),
        centre,
        speeds,
        (0.3, 0.1),
    )


def write(path: Path, columns: dict[str, np.ndarray], layout: Layout, stamped: bool = True) -> Path:
    """A file as of Foxglove's library: profile ``""``, JSON, with the log 30 ms behind the stamps."""
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="")
        schema = writer.register_schema(name="arm.State", encoding="jsonschema", data=b'{"type": "object"}')
        channel = writer.register_channel(topic="/state", message_encoding="json", schema_id=schema)
        for number, time in enumerate(columns["time"]):
            content = layout({key: values[number] for key, values in columns.items() if key != "time"})
            nanoseconds = round(1e9 * time)
            if stamped:
                content = {"timestamp": {"sec": START + nanoseconds // 10**9, "nsec": nanoseconds % 10**9}, **content}
            log = START * 10**9 + nanoseconds + 30_000_000
            writer.add_message(channel_id=channel, log_time=log, publish_time=log, data=json.dumps(content).encode())
        writer.finish()
    return path


@pytest.mark.parametrize("layout", [named, by_joint, records, counted, arrays])
def test_layouts_of_json_messages_are_imported_in_the_order_of_the_joints(
    layout: Layout, columns: dict[str, np.ndarray], tmp_path: Path
) -> None:
    """Kills joints in the order of the file, log times in the place of stamps, and a field that is not found."""
    path = write(tmp_path / "run.mcap", columns, layout)
    assert is_foreign(path)
    mapping = mapping_in(draft_import([path], tmp_path / "lab", ImportOptions(robot="franka_fer")), tmp_path)
    (run,) = read_recordings(path, mapping)
    arm = run.signals.arms[ARM]
    np.testing.assert_allclose(run.signals.time - run.signals.time[0], columns["time"], atol=1e-6)
    assert run.signals.time[0] % 1.0 == pytest.approx(0.0, abs=1e-6)  # 0.03 s by the log
    for name, values in (("position", "position"), ("velocity", "velocity"), ("torque", "effort")):
        np.testing.assert_allclose(getattr(arm, name), columns[values], atol=1e-9)


def test_messages_without_a_time_have_that_of_the_log(columns: dict[str, np.ndarray], tmp_path: Path) -> None:
    path = write(tmp_path / "run.mcap", columns, named, stamped=False)
    mapping = mapping_in(draft_import([path], tmp_path / "lab", ImportOptions(robot="franka_fer")), tmp_path)
    (run,) = read_recordings(path, mapping)
    assert run.signals.time[0] % 1.0 == pytest.approx(0.03, abs=1e-6)


def test_what_is_not_a_number_of_a_joint_stays_as_it_is() -> None:
    pose = {"position": {"x": 1, "y": 2, "z": 3}}
    found = as_message({"pose": pose, "on": [True, False], "q": [1, None], "mode_1": "a", "f2": 1.0}, "state")
    assert (found.pose.position.x, found.on, found.mode_1, found.f2) == (1, [True, False], "a", 1.0)
    np.testing.assert_array_equal(found.q, [1.0, np.nan])
    assert not hasattr(found, "name") and not hasattr(found, "header") and not hasattr(found, "f")
    np.testing.assert_array_equal(as_message([1, 2], "state").data, [1.0, 2.0])


def test_a_message_that_is_no_json_is_refused_with_its_topic(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    write_raw(path, "json", b"{")
    assert "/state: a message is not json" in refusal(candidates_of, path)
    write_raw(path, "flatbuffer", b"{")
    assert "/state: messages are encoded as 'flatbuffer'; expected json, protobuf or cdr" in refusal(
        candidates_of, path
    )


def write_raw(
    path: Path, encoding: str, data: bytes, schema: tuple[str, str, bytes] = ("s", "jsonschema", b"{}")
) -> None:
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="")
        name, kind, content = schema
        number = writer.register_schema(name=name, encoding=kind, data=content)
        channel = writer.register_channel(topic="/state", message_encoding=encoding, schema_id=number)
        writer.add_message(channel_id=channel, log_time=0, publish_time=0, data=data)
        writer.finish()


def test_a_file_without_a_channel_is_refused_with_the_command_that_may_mend_it(tmp_path: Path) -> None:
    with (tmp_path / "run.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        writer.finish()
    assert "mcap recover" in refusal(candidates_of, tmp_path / "run.mcap")


def test_protobuf_without_its_package_is_refused_with_the_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("IMPACT_RS_RUN", raising=False)
    monkeypatch.setitem(sys.modules, "mcap_protobuf", None)
    write_raw(tmp_path / "run.mcap", "protobuf", b"", ("arm.State", "protobuf", b""))
    assert "pip install mcap-protobuf-support" in refusal(candidates_of, tmp_path / "run.mcap")


def test_protobuf_messages_are_read_by_their_own_schema(tmp_path: Path) -> None:
    """A message of google.protobuf's own schemas, which need no compiler. Kills a decoder of another schema."""
    pytest.importorskip("mcap_protobuf")
    from google.protobuf import descriptor_pb2, struct_pb2

    schema = descriptor_pb2.FileDescriptorSet()
    struct_pb2.DESCRIPTOR.CopyToProto(schema.file.add())
    point = descriptor_pb2.FileDescriptorProto(name="arm.proto", package="arm", syntax="proto3")
    state = point.message_type.add(name="State")
    state.field.add(name="q", number=1, type=1, label=3)  # repeated double
    schema.file.append(point)
    data = b"\x0a\x10" + np.array([0.25, -1.5]).tobytes()  # field 1, 16 bytes
    write_raw(tmp_path / "run.mcap", "protobuf", data, ("arm.State", "protobuf", schema.SerializeToString()))
    (found,) = candidates_of(tmp_path / "run.mcap")
    assert (found.label, found.width, found.stamped) == ("/state: q (2)", 2, False)
