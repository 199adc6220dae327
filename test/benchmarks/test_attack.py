# SPDX-License-Identifier: Apache-2.0
"""The campaigns of attacks find what they look for, and nothing in what there is."""

from __future__ import annotations

import json
import time

import pytest

bags = pytest.importorskip("benchmarks.attack.bags", reason="run from the root of the repository")
text = pytest.importorskip("benchmarks.attack.text", reason="run from the root of the repository")
files = pytest.importorskip("benchmarks.attack.files", reason="run from the root of the repository")
commands = pytest.importorskip("benchmarks.attack.commands", reason="run from the root of the repository")
referee = pytest.importorskip("benchmarks.attack.referee", reason="run from the root of the repository")


def counts(capfd: pytest.CaptureFixture) -> dict[str, int]:
    return dict(json.loads(capfd.readouterr().out.splitlines()[-1]))


@pytest.mark.parametrize(("campaign", "count"), [(bags, 60), (text, 60), (files, 120), (commands, 15)])
def test_no_mutant_gets_through(campaign, count: int, capfd: pytest.CaptureFixture) -> None:
    assert campaign.main(["--count", str(count), "--seed", "7"]) == 0
    found = counts(capfd)
    assert found["mutants"] == count
    assert found["refused"] > count // 2


def test_without_checksums_changes_are_silent_and_the_campaign_says_so(capfd: pytest.CaptureFixture) -> None:
    assert bags.main(["--count", "30", "--unsealed"]) == 1
    assert counts(capfd)["other numbers"] > 3


def test_a_hang_and_a_traceback_are_counted(capfd: pytest.CaptureFixture) -> None:
    judged = referee.Referee(("fine",))
    judged.judge("endless", lambda: time.sleep(5) or "fine", 0.05)
    judged.judge("broken", lambda: str(1 // 0), 5.0)
    judged.judge("good", lambda: "fine", 5.0)
    assert judged.end() == 1
    told = capfd.readouterr()
    assert json.loads(told.out) | {"seconds": 0, "memory_MB": 0} == {
        "mutants": 3, "fine": 1, "hang": 1, "traceback": 1, "seconds": 0, "memory_MB": 0,
    }  # fmt: skip
    assert "ZeroDivisionError" in told.err
