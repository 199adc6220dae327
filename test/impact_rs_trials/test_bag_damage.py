# SPDX-License-Identifier: Apache-2.0
"""A damaged bag is refused, or read with the very numbers that were recorded."""

from __future__ import annotations

import hashlib
import shutil
from pathlib import Path

import pytest
from damage import damaged, edited, flipped, repeatable
from hypothesis import given
from hypothesis import strategies as st

from impact_rs_trials.bags import topics
from impact_rs_trials.bags.reader import BagError, TrialBag

VALUES = ("null", "[]", "-1", "1e999", "'OK'", "{a: b}", "*a", "9" * 50, "")


def numbers(path: Path) -> str:
    """Digest of all that an analysis can read of a bag."""
    bag = TrialBag.open(path)
    found = [repr((bag.info, sorted(bag.metadata.items()), sorted(bag.counts.items(), key=str), bag.reason))]
    for topic in sorted(topics.recorded(list(bag.info.robots))):
        found.append(hashlib.sha256(b"".join(bag.serialized(topic))).hexdigest())
    for arm in bag.info.robots:
        found.append(repr((bag.controller(arm).twist.tobytes(), bag.impact_time(arm))))
    return hashlib.sha256("".join(found).encode()).hexdigest()


def changes_of(file: Path) -> st.SearchStrategy[bytes]:
    """Damage anywhere, and more of it at both ends, where the frame of the messages is; in YAML that of lines too."""
    data = file.read_bytes()
    if file.suffix == ".yaml":
        return st.one_of(damaged(data), edited(data.decode(), VALUES, ":"))
    return st.one_of(damaged(data), flipped(data, 0, 200), flipped(data, len(data) - 9000))


@pytest.mark.parametrize("suffix", [".mcap", ".yaml"])
def test_a_damaged_bag_is_refused_or_has_the_same_numbers(push_campaign: Path, suffix: str, tmp_path: Path) -> None:
    trial = next(path for path in sorted(push_campaign.iterdir()) if (path / "metadata.yaml").exists())
    bag = shutil.copytree(trial, tmp_path / "bag")
    whole = numbers(bag)
    assert TrialBag.open(bag).sealed
    (file,) = bag.glob(f"*{suffix}")

    @repeatable(40)
    @given(changes_of(file))
    def check(content: bytes) -> None:
        file.write_bytes(content)
        try:
            found = numbers(bag)
        except BagError:
            return
        assert found == whole

    check()
