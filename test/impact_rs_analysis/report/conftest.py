# SPDX-License-Identifier: Apache-2.0
"""Pages of reports and a browser, as the tests of a file share them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from browser import chromium
from playwright.sync_api import Browser
from reports import REPORTS

from impact_rs_analysis.report.trial import write_trial
from impact_rs_cli.main import main
from impact_rs_trials.bags.reader import TrialBag

BAG = "cat_food__case_2__s1.000__r0"


@pytest.fixture(scope="session")
def bag(push_campaign: Path) -> TrialBag:
    """A push."""
    return TrialBag.open(push_campaign / BAG)


@pytest.fixture(scope="session")
def report(push_campaign: Path, bag: TrialBag, made_once: Callable[..., Path]) -> Callable[[str], Path]:
    """The page of a kind of report: those of ``reports``, and of real trials ``trial`` and ``analysis``."""

    def make(folder: Path) -> None:
        for kind, write in REPORTS.items():
            write(folder / kind)
        (folder / "trial").mkdir()
        write_trial(bag, folder / "trial" / "trial.html")
        assert main(["analyze", str(push_campaign), "-o", str(folder / "analysis"), "--jobs", "1"]) == 0

    made = made_once("reports", make)
    return lambda kind: next((made / kind).glob("*.html"))


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """One process for the pages of a file."""
    with chromium() as made:
        yield made
