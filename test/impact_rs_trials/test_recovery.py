# SPDX-License-Identifier: Apache-2.0
"""A bag that nobody closed is read up to where it was cut off, and never as a success."""

from __future__ import annotations

import os
import shutil
import signal
import sys
from datetime import datetime
from pathlib import Path

import numpy as np
import processes
import pytest
from rosbags.rosbag2 import Reader

from impact_rs_trials.bags import checksums, topics
from impact_rs_trials.bags.reader import BagError, TrialBag, stamped_at
from impact_rs_trials.bags.writer import RECORDED, BagWriter, partial_path

STATES = topics.joint_states("arm")
SAVED = 5  # times that the bag is saved


def write_in_parts(whole: Path, path: Path) -> tuple[BagWriter, list[int]]:
    """A copy of a trial that is saved now and then and never closed, and its size after each time."""
    trial = TrialBag.open(whole)
    writer = BagWriter.create(path, list(trial.info.robots))
    sizes = []
    with Reader(whole) as reader:
        messages = list(reader.messages())
    for number, (connection, time, data) in enumerate(messages):
        writer.write_raw(connection.topic, time, data)
        if (number + 1) % (len(messages) // SAVED) == 0:
            writer.save()
            sizes.append(mcap(path).stat().st_size)
    return writer, sizes


def mcap(path: Path) -> Path:
    (file,) = partial_path(path).glob("*.mcap")
    return file


@pytest.fixture(scope="module")
def never_closed(push_bag: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[int]]:
    path = tmp_path_factory.mktemp("runs") / "trial"
    _, sizes = write_in_parts(push_bag, path)
    return partial_path(path), sizes


@pytest.fixture
def cut(never_closed: tuple[Path, list[int]], tmp_path: Path) -> tuple[Path, list[int]]:
    """The folder of a bag that was not closed, and its size after each time it was saved."""
    folder, sizes = never_closed
    return Path(shutil.copytree(folder, tmp_path / ".partial" / "trial")), sizes


def test_what_was_saved_of_a_bag_that_was_never_closed_is_read(push_bag: Path, cut: tuple[Path, list[int]]) -> None:
    bag, full = TrialBag.open(cut[0]), TrialBag.open(push_bag)
    assert bag.info == full.info
    assert bag.path == cut[0]
    found, expected = bag.joints(STATES), full.joints(STATES)
    assert found.time.size > 0.9 * expected.time.size
    np.testing.assert_array_equal(found.position, expected.position[: found.time.size])


def test_a_bag_that_was_cut_off_is_aborted_and_says_when(cut: tuple[Path, list[int]]) -> None:
    bag = TrialBag.open(cut[0])
    assert bag.outcome == "ABORTED"
    assert bag.reason.startswith("the recording was cut off at t = 1.") or "cut off at t = 0." in bag.reason
    assert f"{bag.joints(STATES).time[-1]:.2f}" in bag.reason


def test_a_bag_that_was_cut_off_was_recorded_when_it_was_written(cut: tuple[Path, list[int]]) -> None:
    """Kills the time of reading as the time of the recording."""
    os.utime(cut[0], (1.6e9, 1.6e9))
    assert stamped_at(cut[0]) is None
    assert datetime.fromisoformat(TrialBag.open(cut[0]).metadata[RECORDED]).timestamp() == 1.6e9


def test_wherever_a_bag_breaks_off_it_is_read_up_to_the_save_before(cut: tuple[Path, list[int]]) -> None:
    folder, sizes = cut
    (file,) = folder.glob("*.mcap")
    data = file.read_bytes()
    found = []
    for size in sizes[::2]:
        for place in (size, size + 1, size + 50):  # behind a chunk and its indexes, and within the next
            file.write_bytes(data[:place])
            found.append(TrialBag.open(folder).joints(STATES).time.size)
    counts = found[::3]
    assert found == [count for count in counts for _ in range(3)]
    assert counts == sorted(set(counts))
    assert counts[0] > 0


def test_a_chunk_that_was_changed_ends_what_is_read(cut: tuple[Path, list[int]]) -> None:
    folder, sizes = cut
    (file,) = folder.glob("*.mcap")
    before = {}
    data = file.read_bytes()
    file.write_bytes(data[: sizes[1]])
    before = TrialBag.open(folder).counts
    for place in (sizes[1] + checksums.RECORD_HEAD_BYTES + checksums.CHUNK_CHECKSUM_OFFSET_BYTES, sizes[1] + 500):
        changed = bytearray(data)
        changed[place] ^= 1
        file.write_bytes(changed)
        assert TrialBag.open(folder).counts == before


def test_nothing_is_read_of_chunks_without_a_checksum(cut: tuple[Path, list[int]]) -> None:
    folder, _ = cut
    (file,) = folder.glob("*.mcap")
    data = bytearray(file.read_bytes())
    first = data.index(b"zstd") - 4 - 4
    data[first : first + 4] = bytes(4)
    file.write_bytes(data)
    with pytest.raises(BagError, match="nothing of it is left"):
        TrialBag.open(folder)


def test_reading_leaves_a_bag_that_was_cut_off_as_it_is(cut: tuple[Path, list[int]]) -> None:
    (file,) = cut[0].iterdir()
    before = file.read_bytes()
    TrialBag.open(cut[0])
    assert list(cut[0].iterdir()) == [file]
    assert file.read_bytes() == before


def test_a_bag_saved_in_parts_is_sealed_and_holds_the_same(push_bag: Path, tmp_path: Path) -> None:
    writer, _ = write_in_parts(push_bag, tmp_path / "trial")
    writer.finish("OK")
    bag, full = TrialBag.open(tmp_path / "trial"), TrialBag.open(push_bag)
    assert bag.sealed
    assert bag.counts == full.counts
    np.testing.assert_array_equal(bag.controller("arm").twist, full.controller("arm").twist)


def test_a_bag_survives_that_its_writer_is_killed(push_bag: Path, tmp_path: Path) -> None:
    program = (
        "import sys, time; from pathlib import Path; sys.path[:0] = sys.argv[3:]; import test_recovery as t\n"
        "writer, _ = t.write_in_parts(Path(sys.argv[1]), Path(sys.argv[2])); print('saved', flush=True); time.sleep(99)"
    )
    folders = [str(Path(module.__file__).parent) for module in (sys.modules[__name__], processes)]
    arguments = [sys.executable, "-c", program, str(push_bag), str(tmp_path / "trial"), *folders]
    with processes.running(arguments, end=signal.SIGKILL) as writer:
        writer.line("saved")
    bag = TrialBag.open(partial_path(tmp_path / "trial"))
    assert bag.outcome == "ABORTED"
    assert bag.joints(STATES).time.size > 1000


def test_a_finished_bag_that_lost_its_metadata_is_no_success(push_bag: Path, tmp_path: Path) -> None:
    shutil.copytree(push_bag, tmp_path / "bag")
    (tmp_path / "bag" / checksums.BAG_METADATA).unlink()
    bag = TrialBag.open(tmp_path / "bag")
    assert bag.outcome == "ABORTED"
    assert bag.counts[STATES] == TrialBag.open(push_bag).counts[STATES]
