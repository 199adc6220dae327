# SPDX-License-Identifier: Apache-2.0
"""How far a whole job is, and how long it still takes, from its stages and an earlier job of the same command.

A command reports one stage at a time (:mod:`impact_rs_sim.progress`), and stages in which nothing is expected to be
done. Stages that are over say how fast this job is against the earlier one; the rest takes as much longer. What is
shown falls from look to look: an estimate replaces it where it is smaller, or clearly larger.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from impact_rs_sim.progress import ENDS, HOLD_OUT, SEARCH

STAGES: dict[str, dict[str, float]] = {  # s, on one core; the first job of a folder is held against them
    "compare": {"reading bags": 6.3, "replays of the model": 4.0},  # 18 trials
    "diagnose": {  # 16 runs of a laboratory with another mass of the object, processor time
        "reading bags": 3.9,
        "replays of the model": 0.6,
        "sensitivities of all effects": 8.1,
        SEARCH: 6.8,
        HOLD_OUT: 18.0,
        ENDS: 7.0,  # with what follows the hold-out
    },
}
PART_OF = {  # stages that are counted as one: they alternate, or one of them stands for the other
    "reading runs": "reading bags",
    "clock of the commands": "replays of the model",
    "sensitivities in free motion": "sensitivities of all effects",
    "sensitivities": SEARCH,
    "new sensitivities": SEARCH,
    "final sensitivities": SEARCH,
    "every run again": SEARCH,
    "probes of effects": SEARCH,
}
IN_ROUNDS = (SEARCH, ENDS)  # stages whose steps are counted anew in each of many rounds
MIN_INCREASE_RATIO = 1.15  # of a longer time over the one that is shown, from which it replaces it


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
    stages, known = _joined(found.get("stages", {})), _joined(usual)
    order = [name for name in known if name not in {PART_OF.get(empty, empty) for empty in found.get("empty", ())}]
    current = PART_OF.get(found["what"], found["what"])
    furthest = max((order.index(name) for name in stages if name in order), default=-1)
    over = [name for name in order[:furthest] if name in stages and name != current]
    expected = sum(known[name] for name in over)
    pace = sum(stages[name] for name in over) / expected if expected > 0.0 else 1.0
    left = pace * sum(known[name] for name in order[furthest + 1 :])
    if current not in order[:furthest]:
        here = max(0.0, pace * known.get(current, 0.0) - stages.get(current, 0.0))
        steps = done / total if of_stage is not None and current not in IN_ROUNDS and current == found["what"] else 0.0
        here = (1.0 - steps) * here + steps * (of_stage or 0.0) if current in known else of_stage or 0.0
        left += here  # the more steps are done, the more they say: the parts of a hold-out take differently long
    elapsed = sum(stages.values())
    return Remaining(now, elapsed / (elapsed + left) if elapsed + left > 0.0 else 0.0, left)


def _joined(seconds: Mapping[str, float]) -> dict[str, float]:
    """Seconds of stages, with those that are counted as one together, in the order of their beginning."""
    found: dict[str, float] = {}
    for name, value in seconds.items():
        whole = PART_OF.get(name, name)
        found[whole] = found.get(whole, 0.0) + value
    return found


def shown(before: Remaining | None, new: Remaining) -> Remaining:
    """What is shown after an earlier look: the share does not shrink, and the time falls."""
    if before is None:
        return new
    share = new.share if before.share is None or new.share is None else max(before.share, new.share)
    if before.left is None or new.left is None:
        return Remaining(new.at, share, new.left)
    falling = max(0.0, before.left - (new.at - before.at))
    left = new.left if new.left > MIN_INCREASE_RATIO * falling else min(falling, new.left)
    return Remaining(new.at, share, left)
