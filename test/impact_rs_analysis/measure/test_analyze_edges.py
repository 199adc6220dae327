# SPDX-License-Identifier: Apache-2.0
"""Whatever is wrong with one bag is told, and the others are used."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from impact_rs_analysis.evidence.runs import read_runs
from impact_rs_analysis.measure.analyze import analyze_campaign
from impact_rs_analysis.measure.export import export
from impact_rs_cli.main import main

ODD = "cat_food__case_2__s9.000__r0"


@pytest.fixture
def campaign(push_campaign: Path, tmp_path: Path) -> Path:
    return shutil.copytree(push_campaign, tmp_path / "push")


@pytest.fixture
def unsealed(campaign: Path, rewrite_bag: Callable) -> Path:
    """One more bag, which carries no checksums that would catch what is done to it."""
    rewrite_bag(campaign / "cat_food__case_2__s1.000__r0", campaign / ODD, lambda topic: True)
    return campaign / ODD


@pytest.mark.parametrize("count", ["null", "many", "[1]", "-1", "99999"])
def test_a_bag_whose_message_count_is_no_count_stops_nothing(campaign: Path, unsealed: Path, count: str) -> None:
    path = unsealed / "metadata.yaml"
    path.write_text(re.sub(r"message_count: \d+", f"message_count: {count}", path.read_text()))
    found = analyze_campaign(campaign)
    assert len(found.sets) == 1
    assert [bag.name for bag in found.skipped] in ([ODD], [])  # a count below what is there is none that matters
    assert count == "-1" or found.skipped


def test_any_exception_of_one_bag_is_told_in_a_line(campaign: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from impact_rs_trials.bags.reader import TrialBag

    opened = TrialBag.open.__func__

    def broken(cls: type, path: Path) -> TrialBag:
        if path.name.endswith("s0.800__r0"):
            raise ZeroDivisionError("by\nnothing")
        return opened(cls, path)

    monkeypatch.setattr(TrialBag, "open", classmethod(broken))
    reason = "damaged (ZeroDivisionError: by nothing)"
    assert [bag.reason for bag in analyze_campaign(campaign).skipped] == [reason]
    assert [told for _, told in read_runs(campaign, map).skipped] == [reason]
    for name in ("all.parquet", "all.h5"):
        found = export(campaign, campaign.parent / name, map, lambda done, total: None)
        assert (found.trials, [bag.reason for bag in found.skipped]) == (2, [reason])


def test_bags_without_checksums_are_named_as_such(campaign: Path, unsealed: Path, capfd: pytest.CaptureFixture) -> None:
    assert analyze_campaign(campaign).unsealed == (ODD,)
    assert "1 bag carries no checksums" in read_runs(campaign, map).remarks[0]
    assert main(["analyze", str(campaign)]) == 0
    assert "note: 1 bag carries no checksums" in capfd.readouterr().out
    shutil.rmtree(unsealed)
    assert analyze_campaign(campaign).unsealed == ()
    assert read_runs(campaign, map).remarks == ()


def test_a_single_bag_is_exported_as_a_campaign_of_one(push_campaign: Path, tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    found = export(push_campaign / "cat_food__case_2__s1.000__r0", tmp_path / "one.h5", map, lambda done, total: None)
    assert found.trials == 1
    with h5py.File(tmp_path / "one.h5") as file:
        assert list(file) == ["cat_food__case_2__s1.000__r0"]
