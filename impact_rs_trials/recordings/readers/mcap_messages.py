# SPDX-License-Identifier: Apache-2.0
"""MCAP files without ROS: channels of JSON and Protobuf messages, as Foxglove's libraries write them.

Messages get the form of ROS messages, so that :mod:`bag_file` finds topics and fields by equal names:

    {"timestamp": {"sec": 1, "nsec": 0}, ...}       header.stamp
    {"position": [0.1, 0.2]}                        position, an array of numbers
    {"q1": 0.1, "q2": 0.2}                          q, numbers whose names differ in a count from 0 or 1
    {"position": {"hip": 0.1, "knee": 0.2}}         position, and name, the joints
    {"joints": [{"name": "hip", "position": 0.1}]}  joints.position and joints.name (foxglove.JointStates)

Booleans, texts and lists of other values do not change. ``null`` becomes nan. Channels in CDR, written by a library
other than ros2 bag, are read like topics of a bag.
"""

from __future__ import annotations

import json
import logging
import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from types import SimpleNamespace
from typing import IO, Any

import numpy as np
from mcap.reader import McapReader, make_reader
from mcap.records import Channel, Schema
from rosbags.interfaces import Connection, ConnectionExtRosbag2, MessageDefinition, MessageDefinitionFormat

from impact_rs_sim.errors import InputError
from impact_rs_sim.optional_packages import require
from impact_rs_trials.recordings.readers.text_file import suffix_of

logger = logging.getLogger(__name__)

ROS2 = "ros2"  # profile of the files that rosbags reads
STAMPS = (("sec", "nanosec"), ("sec", "nsec"), ("seconds", "nanos"), ("secs", "nsecs"))
PARTS_OF_VECTORS = {"x", "y", "z", "w", "r", "g", "b", "a"}
COUNTED = re.compile(r"^(\D*)(\d+)(\D*)$")


def is_without_ros(path: Path) -> bool:
    """Whether a path is a readable MCAP file that ROS 2 did not record."""
    if suffix_of(path) != ".mcap" or not path.is_file():
        return False
    try:
        with path.open("rb") as stream:
            return str(make_reader(stream).get_header().profile) != ROS2
    except Exception as error:  # a damaged file can fail anywhere inside the library; rosbags gives the reason
        logger.debug("%s: no MCAP file (%s: %s)", path, type(error).__name__, error)
        return False


class McapMessages:
    """Reader of an MCAP file without ROS, with the part of the interface of ``rosbags`` readers that is used here.

    Args:
        path: The file.

    Attributes:
        connections: Topics with their types.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._stream: IO[bytes] | None = None
        self.connections: list[Connection] = []

    def __enter__(self) -> McapMessages:
        self._stream = self._path.open("rb")
        summary = self._reader.get_summary()
        if summary is None or not summary.channels:
            text = "an MCAP file without an index or without a channel; `mcap recover FILE -o NEW.mcap` writes an index"
            raise InputError(text, file=self._path)
        counts = {} if summary.statistics is None else summary.statistics.channel_message_counts
        self.connections = [
            self._connection(channel, summary.schemas.get(channel.schema_id), counts.get(number, 0))
            for number, channel in summary.channels.items()
        ]
        return self

    def __exit__(self, *_: object) -> None:
        if self._stream is not None:
            self._stream.close()

    @property
    def topics(self) -> dict[str, Connection]:
        """Topics by name."""
        return {connection.topic: connection for connection in self.connections}

    def messages(self, connections: Collection[Connection] = ()) -> Iterator[tuple[Connection, int, Any]]:
        """Topic, log time [ns] and message in the order of log times; a message is decoded, or bytes if it is in CDR.

        Args:
            connections: Topics to read; empty: all.

        Raises:
            InputError: A message cannot be decoded.
            MissingPackage: The decoder of Protobuf is not installed.
        """
        by_id = {connection.id: connection for connection in connections or self.connections}
        topics = [connection.topic for connection in by_id.values()]
        decoders: dict[int, Callable[[bytes], Any]] = {}
        for schema, channel, message in self._reader.iter_messages(topics=topics):
            if channel.id not in by_id:
                continue
            if channel.id not in decoders:
                decoders[channel.id] = self._decoder(channel, schema)
            try:
                content = decoders[channel.id](message.data)
            except Exception as error:  # a damaged message can fail anywhere inside a library
                text = f"{channel.topic}: a message is not {channel.message_encoding} ({type(error).__name__}: {error})"
                raise InputError(text, file=self._path) from None
            yield by_id[channel.id], message.log_time, content

    @cached_property
    def _reader(self) -> McapReader:
        assert self._stream is not None
        return make_reader(self._stream)

    def _connection(self, channel: Channel, schema: Schema | None, count: int) -> Connection:
        cdr = channel.message_encoding == "cdr" and schema is not None and schema.encoding == "ros2msg"
        text = schema.data.decode() if cdr and schema is not None else ""
        kind = MessageDefinitionFormat.MSG if cdr else MessageDefinitionFormat.NONE
        return Connection(
            channel.id,
            channel.topic,
            channel.message_encoding if schema is None else schema.name,
            MessageDefinition(kind, text),
            "",
            count,
            ConnectionExtRosbag2(channel.message_encoding, []),
            self,
        )

    def _decoder(self, channel: Channel, schema: Schema | None) -> Callable[[bytes], Any]:
        """Decoder of the messages of a channel."""
        kind = channel.message_encoding if schema is None else schema.name
        if channel.message_encoding == "json":
            return lambda data: as_message(json.loads(data), kind)
        if channel.message_encoding == "cdr":
            return lambda data: data
        if channel.message_encoding == "protobuf":
            decode = _protobuf_decoder(self._path, schema)
            return lambda data: as_message(_plain(decode(data)), kind)
        raise InputError(
            f"{channel.topic}: messages are encoded as {channel.message_encoding!r}; expected json, protobuf or cdr",
            file=self._path,
        )


def _protobuf_decoder(path: Path, schema: Schema | None) -> Callable[[bytes], Any]:
    require("mcap_protobuf", path, "mcap-protobuf-support")
    from mcap_protobuf.decoder import DecoderFactory

    decode = DecoderFactory().decoder_for("protobuf", schema)
    if decode is None:
        raise InputError("a channel in Protobuf without a schema in Protobuf", file=path)
    return decode


def _plain(value: Any) -> Any:
    """A message of Protobuf as JSON has it: dictionaries, lists and numbers."""
    if hasattr(value, "DESCRIPTOR"):
        return {field.name: _plain(getattr(value, field.name)) for field in value.DESCRIPTOR.fields}
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (str, bytes, int, float)):
        return value
    return [_plain(item) for item in value]


def as_message(content: Any, kind: str) -> Any:
    """A decoded message in the form of a ROS message.

    Args:
        content: Content of the message: a dictionary, or numbers alone, which get the field ``data``.
        kind: Name of the message type.
    """
    message = _with_fields(content if isinstance(content, Mapping) else {"data": content})
    message.__msgtype__ = kind
    if not hasattr(message, "header"):
        stamp = next((time for time in map(_stamp, vars(message).values()) if time is not None), None)
        if stamp is not None:
            message.header = SimpleNamespace(stamp=stamp, __msgtype__="header")
    elif hasattr(message.header, "stamp"):
        message.header.stamp = _stamp(message.header.stamp) or message.header.stamp
    return message


def _stamp(value: Any) -> SimpleNamespace | None:
    """A ROS stamp from seconds and nanoseconds under other names; None: the value is no time."""
    for seconds, nanoseconds in STAMPS:
        if hasattr(value, seconds) and hasattr(value, nanoseconds):
            return SimpleNamespace(sec=getattr(value, seconds), nanosec=getattr(value, nanoseconds))
    return None


def _with_fields(content: Mapping[str, Any]) -> SimpleNamespace:
    """A dictionary as a message, whose numbers are in arrays."""
    fields = {key: _field(value) for key, value in content.items()}
    for key, value in _counted(content).items():
        fields.setdefault(key, value)
    joints = [tuple(value) for value in content.values() if _by_joint(value)]
    if len(set(joints)) == 1 and "name" not in fields:
        fields["name"] = list(joints[0])
    return SimpleNamespace(**fields, __msgtype__="")


def _field(value: Any) -> Any:
    if _by_joint(value):
        return _numbers(list(value.values()))
    if isinstance(value, Mapping):
        return _with_fields(value)
    if not isinstance(value, list) or not value:
        return value
    if all(map(_is_number, value)):
        return _numbers(value)
    if all(isinstance(item, Mapping) for item in value) and len({tuple(item) for item in value}) == 1:
        return _with_fields({key: [item[key] for item in value] for key in value[0]})
    return value


def _by_joint(value: Any) -> bool:
    """Whether a value holds a number for each of several joints by name."""
    if not isinstance(value, Mapping) or len(value) < 2 or not all(map(_is_number, value.values())):
        return False
    return not (set(value) <= PARTS_OF_VECTORS or any(set(value) == set(names) for names in STAMPS))


def _counted(content: Mapping[str, Any]) -> dict[str, Any]:
    """Arrays of numbers whose names differ only in a count from 0 or 1, by the name without the count."""
    groups: dict[str, dict[int, Any]] = {}
    for key, value in content.items():
        match = COUNTED.match(key)
        if match and _is_number(value):
            name = re.sub("__+", "_", match[1] + match[3]).strip("_")
            groups.setdefault(name, {})[int(match[2])] = value
    return {
        name: _numbers([by_number[number] for number in sorted(by_number)])
        for name, by_number in groups.items()
        if name
        and len(by_number) > 1
        and sorted(by_number) in (list(range(len(by_number))), list(range(1, len(by_number) + 1)))
    }


def _is_number(value: Any) -> bool:
    return value is None or (isinstance(value, (int, float)) and not isinstance(value, bool))


def _numbers(values: Sequence[Any]) -> Any:
    return np.array(values, dtype=float)  # None is NaN
