# SPDX-License-Identifier: Apache-2.0
"""No bit of a bag changes unnoticed, and bags of others are still read."""

from __future__ import annotations

import random
import re
import shutil
import struct
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import Reader, StoragePlugin, Writer

from impact_rs_trials.bags import checksums, topics
from impact_rs_trials.bags.reader import BagError, TrialBag
from impact_rs_trials.bags.types import typestore
from impact_rs_trials.bags.writer import SealedWriter

STORE = typestore()
OLD_BAG = Path(__file__).parent / "data" / "bag_of_0_1_0" / "cat_food__case_2__s1.000__r0"


@pytest.fixture
def bag(push_bag: Path, tmp_path: Path) -> Path:
    """A copy of a bag, to be damaged."""
    return shutil.copytree(push_bag, tmp_path / "bag")


def mcap(bag: Path) -> Path:
    (path,) = bag.glob("*.mcap")
    return path


def refused(bag: Path) -> str:
    with pytest.raises(BagError) as caught:
        TrialBag.open(bag)
    return caught.value.reason


def test_every_flipped_bit_of_a_bag_is_found_when_it_is_opened(bag: Path) -> None:
    path, chance = mcap(bag), random.Random(1)
    data = path.read_bytes()
    places = [*range(60), *range(len(data) - 60, len(data)), *(chance.randrange(len(data)) for _ in range(60))]
    for place in places:
        changed = bytearray(data)
        changed[place] ^= 1 << chance.randrange(8)
        path.write_bytes(changed)
        assert refused(bag)


def test_a_bag_that_was_cut_off_or_grew_is_refused(bag: Path) -> None:
    data = mcap(bag).read_bytes()
    for changed in (data[:-1], data[: len(data) // 2], data[:8], b"", data + b"\0", data + data[-8:], data[8:]):
        mcap(bag).write_bytes(changed)
        assert refused(bag)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("outcome: OK", "outcome: LIMIT"),
        ("outcome: OK", "outcome: OK "),
        ("checksums: crc32", "checksums: none"),
        ("    checksums: crc32\n", ""),
        ("seed: '", "seed: '1"),
        (r"message_count: \d+", "message_count: null"),
    ],
)
def test_metadata_that_were_changed_are_refused(bag: Path, old: str, new: str) -> None:
    path = bag / "metadata.yaml"
    text = path.read_text()
    assert re.search(old, text)
    path.write_text(re.sub(old, new, text))
    assert "metadata.yaml is not the one that was recorded" in refused(bag)


def test_a_bag_that_says_it_has_checksums_and_has_none_is_refused(bag: Path) -> None:
    data = bytearray(mcap(bag).read_bytes())
    end = data.rindex(b"\x0f" + struct.pack("<Q", 4)) + 9
    data[end : end + 4] = bytes(4)
    data[-12:-8] = bytes(4)
    mcap(bag).write_bytes(data)
    assert "checksum" in refused(bag)


def test_somebody_elses_reader_finds_every_checksum_right(bag: Path) -> None:
    from mcap.records import Chunk, DataEnd, Footer
    from mcap.stream_reader import StreamReader

    with mcap(bag).open("rb") as file:
        records = list(StreamReader(file, emit_chunks=True, validate_crcs=True).records)
    sums = [record.uncompressed_crc for record in records if isinstance(record, Chunk)]
    sums += [record.data_section_crc for record in records if isinstance(record, DataEnd)]
    sums += [record.summary_crc for record in records if isinstance(record, Footer)]
    assert len(sums) > 3
    assert all(sums)
    with mcap(bag).open("rb") as file:  # and messages, which it reads chunk by chunk
        assert sum(1 for _ in StreamReader(file, validate_crcs=True).records) > 10_000


def test_sealed_metadata_read_as_rosbags_wrote_them(tmp_path: Path) -> None:
    custom = {"long": "word 'and' " * 40, "odd": 'ä: "\n\t\\\x01', "empty": "", "number": "1e3"}
    for kind in (Writer, SealedWriter):
        with kind(tmp_path / kind.__name__, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            connection = writer.add_connection("/text", topics.STRING, typestore=STORE)
            message = STORE.types[topics.STRING](data="")
            writer.write(connection, 7, STORE.serialize_cdr(message, topics.STRING))
            for name, text in custom.items():
                writer.set_custom_data(name, text)
        with Reader(tmp_path / kind.__name__) as reader:
            assert custom.items() <= reader.storage.metadata.custom.items()
            assert [stamp for _, stamp, _ in reader.messages()] == [7]
        assert checksums.check(tmp_path / kind.__name__) == (kind is SealedWriter)


def test_bags_of_earlier_versions_and_others_are_read_as_unsealed(bag: Path, tmp_path: Path, rewrite_bag) -> None:
    assert TrialBag.open(bag).sealed
    assert not TrialBag.open(OLD_BAG).sealed
    rewrite_bag(bag, tmp_path / "other", lambda topic: True)
    other = TrialBag.open(tmp_path / "other")
    assert not other.sealed
    np.testing.assert_array_equal(other.controller("arm").twist, TrialBag.open(bag).controller("arm").twist)


def test_a_checksum_of_another_program_is_held_against_its_bag(bag: Path, tmp_path: Path, rewrite_bag) -> None:
    rewrite_bag(bag, tmp_path / "other", lambda topic: True)
    data = bytearray(mcap(tmp_path / "other").read_bytes())
    data[-12:-8] = b"\1\2\3\4"  # of the summary
    mcap(tmp_path / "other").write_bytes(data)
    assert "checksum" in refused(tmp_path / "other")
