# SPDX-License-Identifier: Apache-2.0
"""How far a whole job is, and how long it still takes, from its stages and an earlier job of the same command.

A command reports one stage at a time (:mod:`impact_rs_sim.progress`). Stages that are over say how fast this job is
against the earlier one; the rest takes as much longer. What is shown falls from look to look: an estimate replaces it
where it is smaller, or by far larger.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

STAGES: dict[str, dict[str, float]] = {  # s, of 18 trials on one core; the first job of a folder is held against them
    "compare": {"reading bags": 6.3, "replays of the model": 4.0},
    "diagnose": {
        "reading bags": 7.7,
        "replays of the model": 1.0,
        "sensitivities of all effects": 9.0,
        "fit of the shortlist": 25.0,
        "new sensitivities": 8.0,
    },
}
FAR = 1.5  # times the remaining time that is shown, from which a longer one replaces it
SLACK = 3.0  # s, added to that


@dataclass(frozen=True)
class Remaining:
    """Progress of a whole job.

    Attributes:
        at: When [s of the wall clock].
        share: Part of the job that is done, 0 to 1; None: not known.
        left: Remaining time [s]; None: not known.
    """

    at: float
    share: float | None = None
    left: float | None = None


def remaining(found: Mapping[str, Any], usual: Mapping[str, float], now: float) -> Remaining:
    """Estimate of the whole job.

    Args:
        found: Its progress file.
        usual: Seconds of the stages of an earlier job; empty: none is known, and the stage stands for the job.
        now: Now [s of the wall clock].
    """
    done, total, first = found["done"], found["total"], found["first"]
    own, spent = done - first, found["at"] - found["since"]  # an earlier run of the command may have done the first
    of_stage = None if not total or own <= 0 else spent / own * (total - done)
    if len(usual) < 2:  # a single stage stands for the job, whatever the size of an earlier one
        return Remaining(now, done / total if total else None, of_stage)
    stages: dict[str, float] = found.get("stages", {})
    over = [name for name in stages if name != found["what"] and name in usual]
    known = sum(usual[name] for name in over)
    pace = sum(stages[name] for name in over) / known if known > 0.0 else 1.0
    later = (name for name in usual if name != found["what"])
    rest = sum(max(0.0, pace * usual[name] - stages.get(name, 0.0)) for name in later)
    current = max(0.0, pace * usual.get(found["what"], 0.0) - stages.get(found["what"], 0.0))
    left = rest + max(current, of_stage or 0.0)
    elapsed = sum(stages.values())
    return Remaining(now, elapsed / (elapsed + left) if elapsed + left > 0.0 else 0.0, left)


def shown(before: Remaining | None, new: Remaining) -> Remaining:
    """What is shown after an earlier look: the share does not shrink, and the time falls."""
    if before is None:
        return new
    share = new.share if before.share is None or new.share is None else max(before.share, new.share)
    if before.left is None or new.left is None:
        return Remaining(new.at, share, new.left)
    falling = max(0.0, before.left - (new.at - before.at))
    left = new.left if new.left > FAR * falling + SLACK else min(falling, new.left)
    return Remaining(new.at, share, left)
