# SPDX-License-Identifier: Apache-2.0
"""Attacks on bags of ROS 2: on their messages, on their files, and on their ``metadata.yaml``."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

from benchmarks.attacks.binary import BYTES
from benchmarks.attacks.clean_files import JOINTS, Rng, Table
from impact_rs_trials.bags.types import typestore

FORMS = (".mcap", ".db3", " bare.mcap")  # folders with metadata.yaml, and a file without any
STATES, BALL_TOPIC = "/arm/joint_states", "/tracker/ball"
JOINT_STATE, POSE, TEXT = "sensor_msgs/msg/JointState", "geometry_msgs/msg/PoseStamped", "std_msgs/msg/String"
START = 1_763_500_000 * 10**9  # ns, of the wall clock
LATE = 300_000  # ns from stamp to log
STORE = typestore()
MAKE = {name.split("/")[-1]: kind for name, kind in STORE.types.items()}


@dataclass(frozen=True)
class Sample:
    """One message.

    Attributes:
        topic: Where it is published.
        log: When the recorder took it [ns].
        stamp: Of its header [ns].
        numbers: Position, velocity and effort of the joints; or place and quaternion of a pose, in one array.
        names: Of the joints.
        kind: Message type.
        raw: What is recorded in place of the message.
    """

    topic: str
    log: int
    stamp: int
    numbers: tuple[np.ndarray, ...]
    names: tuple[str, ...] = ()
    kind: str = JOINT_STATE
    raw: bytes | None = None

    def serialized(self) -> bytes:
        """In CDR."""
        if self.raw is not None:
            return self.raw
        header = MAKE["Header"](MAKE["Time"](*divmod(self.stamp, 10**9)), "world")
        if self.kind == TEXT:
            message: Any = MAKE["String"]("not a state")
        elif self.kind == POSE:
            position, quaternion = self.numbers[0][:3], self.numbers[0][3:]
            message = MAKE["PoseStamped"](
                header, MAKE["Pose"](MAKE["Point"](*position), MAKE["Quaternion"](*quaternion))
            )
        else:
            message = MAKE["JointState"](header, list(self.names), *self.numbers)
        return bytes(STORE.serialize_cdr(message, self.kind))


Samples = list[Sample]


def joint_states(motion: dict[str, np.ndarray]) -> Samples:
    """A motion as joint states."""
    names = tuple(f"joint{joint}" for joint in JOINTS)
    stamps = START + np.round(1e9 * motion["t"]).astype(int)
    rows = zip(stamps.tolist(), motion["q"], motion["dq"], motion["tau"], strict=True)
    return [Sample(STATES, stamp + LATE, stamp, tuple(numbers), names) for stamp, *numbers in rows]


def ball_poses(rows: Table) -> Samples:
    """A table of stamps and places as poses of a ball that hardly turns."""
    rng, samples = np.random.default_rng(5), []
    for t, *position in np.array(rows[1:], dtype=float).tolist():
        quaternion = np.append(1e-4 * rng.standard_normal(3), 1.0)
        stamp = START + round(1e9 * t)
        numbers = np.concatenate((position, quaternion / np.linalg.norm(quaternion)))
        samples.append(Sample(BALL_TOPIC, stamp + LATE, stamp, (numbers,), kind=POSE))
    return samples


# ---- attacks on messages --------------------------------------------------------------------------------------------


def _some(samples: Samples, rng: Rng, change: Callable[[Sample], Sample]) -> Samples:
    chosen = set(rng.choice(len(samples), int(rng.integers(1, 4)), replace=False).tolist())
    return [change(sample) if number in chosen else sample for number, sample in enumerate(samples)]


def _from_the_middle(samples: Samples, rng: Rng, change: Callable[[Sample], Sample]) -> Samples:
    first = int(rng.integers(len(samples) // 4, 3 * len(samples) // 4))
    return [*samples[:first], *(change(sample) for sample in samples[first:])]


def _with(number: float) -> Callable[[Samples, Rng], Samples]:
    def attack(samples: Samples, rng: Rng) -> Samples:
        def change(sample: Sample) -> Sample:
            numbers = [signal.copy() for signal in sample.numbers]
            chosen = numbers[int(rng.integers(len(numbers)))]
            chosen[int(rng.integers(chosen.size))] = number
            return replace(sample, numbers=tuple(numbers))

        return _some(samples, rng, change)

    return attack


def _ordered(sample: Sample, order: Sequence[int]) -> Sample:
    """Joints in another order, with their names."""
    if not sample.names:
        return sample
    names = tuple(sample.names[joint] for joint in order)
    return replace(sample, names=names, numbers=tuple(signal[list(order)] for signal in sample.numbers))


def _permuted(samples: Samples, rng: Rng) -> Samples:
    order = rng.permutation(7).tolist()
    return _from_the_middle(samples, rng, lambda sample: _ordered(sample, order))


def _named(change: Callable[[tuple[str, ...]], tuple[str, ...]]) -> Callable[[Samples, Rng], Samples]:
    return lambda samples, rng: _from_the_middle(
        samples, rng, lambda sample: replace(sample, names=change(sample.names))
    )


def _numbers(change: Callable[[np.ndarray], np.ndarray], which: int = 0) -> Callable[[Samples, Rng], Samples]:
    """Other numbers from the middle on, of the position (0), velocity (1) or torque (2)."""

    def changed(sample: Sample) -> Sample:
        numbers = list(sample.numbers)
        index = min(which, len(numbers) - 1)
        numbers[index] = change(numbers[index])
        return replace(sample, numbers=tuple(numbers))

    return lambda samples, rng: _from_the_middle(samples, rng, changed)


def _gripper(sample: Sample) -> Sample:
    if not sample.names:
        return sample
    numbers = tuple(np.append(signal, 0.04) for signal in sample.numbers)
    return replace(sample, names=(*sample.names, "finger_joint"), numbers=numbers)


def _two_publishers(names: Callable[[tuple[str, ...]], tuple[str, ...]]) -> Callable[[Samples, Rng], Samples]:
    def attack(samples: Samples, rng: Rng) -> Samples:
        shift = int(rng.integers(10**6, 10**7))
        second_publisher = [
            replace(sample, log=sample.log + shift, stamp=sample.stamp + shift, names=names(sample.names),
                    numbers=tuple(0.9 * part for part in sample.numbers))
            for sample in samples
        ]  # fmt: skip
        return sorted([*samples, *second_publisher], key=lambda sample: sample.log)

    return attack


def _clock(change: Callable[[int, Rng], int]) -> Callable[[Samples, Rng], Samples]:
    return lambda samples, rng: _from_the_middle(
        samples, rng, lambda sample: replace(sample, stamp=change(sample.stamp, rng))
    )


def _logs(samples: Samples, logs: Sequence[int]) -> Samples:
    return [replace(sample, log=int(log)) for sample, log in zip(samples, logs, strict=True)]


def _shuffled(samples: Samples, rng: Rng) -> Samples:
    return _logs([samples[int(number)] for number in rng.permutation(len(samples))], [s.log for s in samples])


def _lost(samples: Samples, rng: Rng) -> Samples:
    first = int(rng.integers(len(samples) // 20, len(samples) // 2))
    return samples[:first] + samples[first + len(samples) // 4 :]


def _further(**change: Any) -> Callable[[Samples, Rng], Samples]:
    """A few messages of another kind, or under another name, between the others."""
    return lambda samples, rng: sorted(
        [*samples, *(replace(sample, log=sample.log + 1000, **change) for sample in samples[::40])],
        key=lambda sample: sample.log,
    )


MESSAGES: dict[str, Callable[[Samples, Rng], Samples]] = {
    "joints in another order": lambda samples, rng: [_ordered(sample, [3, 1, 0, 2, 6, 5, 4]) for sample in samples],
    "joints in another order later": _permuted,
    "renamed joint later": _named(lambda names: ("joint_x", *names[1:])),
    "no names later": _named(lambda names: ()),
    "same name twice later": _named(lambda names: (*names[:1], *names[:1], *names[2:])),
    "swapped numbers later": _numbers(lambda values: values[[2, 1, 0, *range(3, values.size)]]),
    "a gripper later": lambda samples, rng: _from_the_middle(samples, rng, _gripper),
    "a joint less later": lambda samples, rng: _from_the_middle(samples, rng, lambda s: _ordered(s, range(6))),
    "fewer numbers later": _numbers(lambda values: values[:-1]),
    "no velocity": lambda samples, rng: [
        replace(s, numbers=(*s.numbers[:1], s.numbers[-1][:0], *s.numbers[2:])) for s in samples
    ],
    "no torque later": _numbers(lambda values: values[:0], 2),
    "degrees later": _numbers(lambda values: values * 57.29578),
    "zeros later": _numbers(lambda values: 0.0 * values, 1),
    "all zeros later": lambda samples, rng: _from_the_middle(
        samples, rng, lambda sample: replace(sample, numbers=tuple(0.0 * part for part in sample.numbers))
    ),
    "nan": _with(np.nan),
    "inf": _with(np.inf),
    "huge": _with(1e300),
    "shuffled": _shuffled,
    "reversed": lambda samples, rng: _logs(samples[::-1], [sample.log for sample in samples]),
    "logs back": lambda samples, rng: _logs(samples, [sample.log for sample in samples][::-1]),
    "logs alike": lambda samples, rng: _logs(samples, [samples[0].log for _ in samples]),
    "logs drift": lambda samples, rng: _logs(samples, [sample.log + 10**6 * n for n, sample in enumerate(samples)]),
    "stamps back": lambda samples, rng: [replace(s, stamp=START + 10**10 - s.stamp % 10**10) for s in samples],
    "a stamp back": lambda samples, rng: _some(samples, rng, lambda s: replace(s, stamp=s.stamp - 5 * 10**7)),
    "stamps of zero": lambda samples, rng: [replace(sample, stamp=0) for sample in samples],
    "stamps of zero later": _clock(lambda stamp, rng: 0),
    "stamps stand still": lambda samples, rng: [replace(sample, stamp=START) for sample in samples],
    "another day later": _clock(lambda stamp, rng: stamp + 86_400 * 10**9),
    "an hour back later": _clock(lambda stamp, rng: stamp - 3600 * 10**9),
    "two publishers": _two_publishers(lambda names: names),
    "two arms": _two_publishers(lambda names: tuple(f"left_{name}" for name in names)),
    "doubled messages": lambda samples, rng: [sample for sample in samples for _ in range(2)],
    "lost messages": _lost,
    "one message": lambda samples, rng: samples[:1],
    "no message": lambda samples, rng: [],
    "another topic": lambda samples, rng: [replace(sample, topic="/nothing") for sample in samples],
    "another type": lambda samples, rng: [replace(sample, kind=TEXT) for sample in samples],
    "another type beside": _further(kind=TEXT),
    "another topic beside": _further(topic="/other/joint_states"),
    "cut messages": lambda samples, rng: _some(
        samples, rng, lambda s: replace(s, raw=s.serialized()[: int(rng.integers(len(s.serialized())))])
    ),
    "longer messages": lambda samples, rng: _some(
        samples, rng, lambda sample: replace(sample, raw=sample.serialized() + rng.bytes(int(rng.integers(1, 40))))
    ),
    "empty messages": lambda samples, rng: _some(samples, rng, lambda sample: replace(sample, raw=b"")),
    "bytes as messages": lambda samples, rng: _some(samples, rng, lambda sample: replace(sample, raw=rng.bytes(80))),
    "other encapsulation": lambda samples, rng: [replace(s, raw=b"\0\0" + s.serialized()[2:]) for s in samples],
}  # fmt: skip

# ---- attacks on metadata.yaml ---------------------------------------------------------------------------------------


def _put(key: str, value: str) -> Callable[[str, Rng], str]:
    return lambda text, rng: re.sub(rf"(?m)^(\s*(?:- )?{key}:).*$", rf"\1 {value}", text)


def _files(instead: str) -> Callable[[str, Rng], str]:
    return lambda text, rng: re.sub(r"(?m)^(\s+)- (log\S*)$", instead, text)


def _other_storage(text: str, rng: Rng) -> str:
    return re.sub(": (mcap|sqlite3)", lambda match: ": sqlite3" if match[1] == "mcap" else ": mcap", text)


def _compressed(text: str, rng: Rng) -> str:
    return _put("compression_format", "zstd")(_put("compression_mode", "MESSAGE")(text, rng), rng)


def _no_topics(text: str, rng: Rng) -> str:
    return re.sub(r"(?s)topics_with_message_count:.*?(?=\n  \w)", "topics_with_message_count: []", text)


METADATA: dict[str, Callable[[str, Rng], str]] = {
    "metadata empty": lambda text, rng: "",
    "metadata cut": lambda text, rng: text[: int(rng.integers(len(text)))],
    "metadata a list": lambda text, rng: "- 1\n- 2\n",
    "metadata no YAML": lambda text, rng: "{" + text,
    "metadata with a tag": lambda text, rng: text + "\nmore: !!python/object:os.system {}\n",
    "metadata in bytes": lambda text, rng: rng.bytes(300).decode("latin-1"),
    "metadata of another version": _put("version", "99"),
    "metadata without a version": lambda text, rng: text.replace("version:", "virsion:"),
    "metadata with another storage": _put("storage_identifier", "tape"),
    "metadata with the other storage": _other_storage,
    "metadata with another type": _put("type", TEXT),
    "metadata with another topic": _put("name", "/other/joint_states"),
    "metadata with another format": _put("serialization_format", "json"),
    "metadata counts less": _put("message_count", "120"),
    "metadata counts nothing": _put("message_count", "0"),
    "metadata counts too many": _put("message_count", "99999"),
    "metadata counts below zero": _put("message_count", "-5"),
    "metadata counts in words": _put("message_count", "many"),
    "metadata counts other nanoseconds": _put("nanoseconds(?:_since_epoch)?", "5"),
    "metadata says compressed": _put("compression_mode", "MESSAGE"),
    "metadata says compressed in zstd": _compressed,
    "metadata without topics": _no_topics,
    "metadata with a file that is not there": _files(r"\1- \2\n\1- log_1.mcap"),
    "metadata with a path": _files(r"\1- /data/\2"),
    "metadata names a file twice": _files(r"\1- \2\n\1- \2"),
}  # fmt: skip

# ---- attacks on files -----------------------------------------------------------------------------------------------

COMPRESSED = {
    "zstd of the file": CompressionMode.FILE,
    "zstd of messages": CompressionMode.MESSAGE,
    "zstd of chunks": CompressionMode.STORAGE,
}
FOLDERS = (
    "metadata missing",
    "storage missing",
    "another file in the folder",
    "half of it in a file that is not named",
)
OF_JOINTS = (  # what poses have not
    *(name for name in MESSAGES if re.search("joint|names?|gripper|arms|torques?|velocity|fewer", name)),
    "degrees later",
)
ATTACKS = (*MESSAGES, *METADATA, *COMPRESSED, *FOLDERS, *(f"file: {name}" for name in BYTES))
ON_FOLDERS = (*METADATA, *FOLDERS, "zstd of the file", "zstd of messages")  # nothing of a file without metadata
ON_POSES = tuple(name for name in ATTACKS if name not in OF_JOINTS)


def write_bag(path: Path, samples: Samples, form: str, attack: str, rng: Rng) -> Path:
    """A bag of a form with an attack, or as it is where the attack is none of these.

    Args:
        path: Of the folder.
        samples: What it holds.
        form: One of :data:`FORMS`.
        attack: One of :data:`ATTACKS`.
        rng: Draws where it strikes.
    """
    mode = COMPRESSED.get(attack, CompressionMode.NONE)
    mode = CompressionMode.MESSAGE if mode == CompressionMode.STORAGE and form == ".db3" else mode
    if attack in MESSAGES:
        samples = MESSAGES[attack](samples, rng)
    half = len(samples) // 2
    if attack == FOLDERS[3]:
        _write(path.with_name("other"), samples[half:], form, mode)
        samples = samples[:half]
    _write(path, samples, form, mode)
    (storage,) = [file for file in path.iterdir() if file.name != "metadata.yaml"]
    described = path / "metadata.yaml"
    if attack == FOLDERS[0]:
        described.unlink()
    elif attack == FOLDERS[1]:
        storage.unlink()
    elif attack == FOLDERS[2]:
        (path / "notes.csv").write_text("t,q_1\n0,1\n", encoding="utf-8")
    elif attack == FOLDERS[3]:
        (second,) = [file for file in path.with_name("other").iterdir() if file.name != "metadata.yaml"]
        second.rename(path / f"log_1{storage.suffix}")
    elif attack in METADATA:
        text = described.read_text(encoding="utf-8")
        described.write_text(METADATA[attack](text, rng), encoding="utf-8")
    elif attack.startswith("file: "):
        storage.write_bytes(BYTES[attack.removeprefix("file: ")](storage.read_bytes(), rng))
    if form != FORMS[2] or not storage.exists():
        return path
    bare = path.with_name("log.mcap")
    shutil.move(storage, bare)
    return bare


def _write(path: Path, samples: Samples, form: str, mode: CompressionMode) -> None:
    plugin = StoragePlugin.SQLITE3 if form == ".db3" else StoragePlugin.MCAP
    writer = Writer(path, version=9, storage_plugin=plugin)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        connections: dict[tuple[str, str], Any] = {}
        for sample in samples:
            key = (sample.topic, sample.kind)
            if key not in connections:
                connections[key] = writer.add_connection(*key, typestore=STORE)
            writer.write(connections[key], sample.log, sample.serialized())
