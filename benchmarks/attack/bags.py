# SPDX-License-Identifier: Apache-2.0
"""Mutants of one recorded bag: which are read with other numbers? ``./run python -m benchmarks.attack.bags``.

A mutant is refused (``BagError``), or read with the very numbers that were recorded. With ``--unsealed`` the bag is one
of another program, without checksums, and the count of silent changes is what checksums are for.
"""

from __future__ import annotations

import hashlib
import random
import re
import shutil
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

from rosbags.rosbag2 import Reader, StoragePlugin, Writer

from benchmarks.attack.referee import Referee, arguments
from impact_rs_trials.bags import checksums, topics
from impact_rs_trials.bags.reader import BagError, TrialBag
from impact_rs_trials.bags.types import typestore
from impact_rs_trials.campaign import make_manifest, run_one

SECONDS = 20.0
Change = Callable[[random.Random, bytes], bytes]


def recorded(folder: Path, sealed: bool) -> Path:
    """A trial without ``/tf`` and the truth: every topic that is ever analysed."""
    manifest = make_manifest("push", ["cat_food"], ["case_2"], [1.0], 1)
    run_one(folder, manifest.trial(manifest.keys[0]))
    source, target = folder / manifest.keys[0].name, folder / "bag"
    with Reader(source) as reader, Writer(target, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        for name, value in (reader.storage.metadata.custom or {}).items():
            if sealed or name != checksums.NAME:
                writer.set_custom_data(name, value)
        kept = [c for c in reader.connections if not c.topic.startswith(("/tf", "/truth"))]
        new = {c.topic: writer.add_connection(c.topic, c.msgtype, typestore=typestore()) for c in kept}
        for connection, moment, data in reader.messages(connections=kept):
            writer.write(new[connection.topic], moment, data)
    if sealed:
        checksums.seal(target)
    return target


def numbers(path: Path) -> str:
    """Digest of all that an analysis can read of a bag."""
    bag = TrialBag.open(path)
    found = [repr((bag.info, sorted(bag.metadata.items()), sorted(bag.counts.items(), key=str), bag.reason))]
    for topic in sorted(topics.recorded(list(bag.info.robots), truth=False)):
        found.append(hashlib.sha256(b"".join(bag.serialized(topic))).hexdigest())
    for arm in bag.info.robots:
        found.append(repr((bag.controller(arm).twist.tobytes(), bag.impact_time(arm))))
    return hashlib.sha256("".join(found).encode()).hexdigest()


def flip(chance: random.Random, data: bytes) -> bytes:
    """One bit."""
    changed = bytearray(data)
    changed[chance.randrange(len(data))] ^= 1 << chance.randrange(8)
    return bytes(changed)


def ends_flip(chance: random.Random, data: bytes) -> bytes:
    """One bit of what frames the messages: header, metadata, summary, footer."""
    changed = bytearray(data)
    place = chance.choice(
        (chance.randrange(min(200, len(data))), len(data) - 1 - chance.randrange(min(9000, len(data))))
    )
    changed[place] ^= 1 << chance.randrange(8)
    return bytes(changed)


def overwrite(chance: random.Random, data: bytes) -> bytes:
    """A run of bytes: noise, or zeros as a lost block of a disk leaves them."""
    start, size = chance.randrange(len(data)), chance.choice((1, 4, 8, 512, 4096))
    noise = chance.randbytes(size) if chance.random() < 0.5 else bytes(size)
    return data[:start] + noise[: len(data) - start] + data[start + size :]


def cut(chance: random.Random, data: bytes) -> bytes:
    """Broken off."""
    return data[: chance.randrange(len(data))]


def splice(chance: random.Random, data: bytes) -> bytes:
    """A run of bytes lost, or there twice."""
    start, size = chance.randrange(len(data)), chance.choice((1, 8, 100, 4096))
    return data[:start] + (
        data[start + size :] if chance.random() < 0.5 else data[start - size if start > size else 0 :]
    )


def edit(chance: random.Random, data: bytes) -> bytes:
    """A line of text lost, twice, with another value, or elsewhere."""
    lines = data.decode().splitlines(keepends=True)
    place = chance.randrange(len(lines))
    kind = chance.randrange(4)
    if kind == 0:
        del lines[place]
    elif kind == 1:
        lines.insert(chance.randrange(len(lines)), lines[place])
    elif kind == 2:
        value = chance.choice(("null", "[]", "-1", "1e999", "'OK'", "{a: b}", "*a", "9" * 50, ""))
        lines[place] = re.sub(r": .*", f": {value}", lines[place])
    else:
        lines[place] = lines[place].replace(chance.choice("0123456789"), chance.choice("0123456789"))
    return "".join(lines).encode()


ATTACKS: dict[str, tuple[Change, ...]] = {
    ".mcap": (flip, flip, flip, flip, ends_flip, ends_flip, overwrite, cut, splice),
    ".yaml": (flip, flip, edit, edit, edit, overwrite, cut, splice),
}


def main(argv: list[str] | None = None) -> int:
    """Run the campaign."""
    parser = arguments(__doc__, 10_000)
    parser.add_argument("--unsealed", action="store_true", help="attack a bag without checksums, for comparison")
    options = parser.parse_args(argv)
    chance, referee = random.Random(options.seed), Referee(("refused", "the same numbers"))
    with tempfile.TemporaryDirectory() as folder:
        bag = recorded(Path(folder), not options.unsealed)
        whole, mutant = numbers(bag), shutil.copytree(bag, Path(folder) / "mutant")
        contents = {file.name: file.read_bytes() for file in bag.iterdir()}

        def attack() -> str:
            try:
                return "the same numbers" if numbers(mutant) == whole else "other numbers"
            except BagError:
                return "refused"

        for _ in range(options.count):
            name = chance.choice([name for name in contents for _ in range(4 if name.endswith(".mcap") else 1)])
            change = chance.choice(ATTACKS[Path(name).suffix])
            (mutant / name).write_bytes(change(chance, contents[name]))
            referee.judge(f"{change.__name__} of {name}", attack, SECONDS)
            (mutant / name).write_bytes(contents[name])
    return referee.end()


if __name__ == "__main__":
    sys.exit(main())
