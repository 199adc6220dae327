# SPDX-License-Identifier: Apache-2.0
"""The small campaign: analysed once, and copies that a test may change."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from impact_rs_analysis.measure.analyze import Analysis, analyze_campaign


@pytest.fixture(scope="session")
def push_analysis(push_campaign: Path) -> Analysis:
    """Analysis of ``push_campaign``."""
    return analyze_campaign(push_campaign)


@pytest.fixture
def campaign(push_campaign: Path, tmp_path: Path) -> Path:
    """A copy of ``push_campaign``."""
    return Path(shutil.copytree(push_campaign, tmp_path / "push"))


@pytest.fixture
def with_outcome(push_campaign: Path, rewrite_bag: Callable) -> Callable[[Path, str], None]:
    """Writes the bag of a trial again without checksums and, in its metadata, with another outcome."""

    def write(bag: Path, outcome: str) -> None:
        shutil.rmtree(bag, ignore_errors=True)
        rewrite_bag(push_campaign / bag.name, bag, lambda topic: True)
        metadata = bag / "metadata.yaml"
        metadata.write_text(metadata.read_text().replace("outcome: OK", f"outcome: {outcome}"))

    return write
