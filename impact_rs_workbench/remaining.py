# SPDX-License-Identifier: Apache-2.0
"""Progress and remaining time of a whole job, from its stages and an earlier job of the same command.

A command reports one stage at a time (:mod:`impact_rs_sim.progress`), and stages that it expects to be empty. The
finished stages give the pace of this job relative to the earlier one; the remaining stages are assumed to have it, too.
The shown time falls steadily: a new estimate replaces it if it is smaller, or clearly larger.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from impact_rs_sim.progress import ENDS, HOLD_OUT, SEARCH

STAGES: dict[str, dict[str, float]] = {  # s, on one core; expected of the first job of a folder
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
PART_OF = {  # group of a stage: its stages alternate, or one of them replaces another
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
MIN_INCREASE_RATIO = 1.15  # of a longer estimate over the shown one, from which it replaces it


@dataclass(frozen=True)
class Remaining:
    """Progress of a whole job.

    Attributes:
        time: When it was estimated [s of the wall clock].
        share: Part of the job that is done, 0 to 1; None: unknown.
        seconds: Remaining time [s]; None: unknown.
    """

    time: float
    share: float | None = None
    seconds: float | None = None


def remaining(progress: Mapping[str, Any], usual: Mapping[str, float], now: float) -> Remaining:
    """Estimate of the whole job.

    Args:
        progress: Its progress file.
        usual: Seconds of the stages of an earlier job; empty: none is known, and the stage stands for the job.
        now: Now [s of the wall clock].
    """
    done, total = progress["done"], progress["total"]
    steps = done - progress["first"]  # of this run: an earlier run of the command may have done the first ones
    elapsed = progress["at"] - progress["since"]
    rest_of_stage = None if not total or steps <= 0 else elapsed / steps * (total - done)
    if len(usual) < 2:  # a single stage stands for the job, whatever the size of an earlier one
        return Remaining(now, done / total if total else None, rest_of_stage)
    stages, expected = _merged(progress.get("stages", {})), _merged(usual)
    empty = {PART_OF.get(name, name) for name in progress.get("empty", ())}
    order = [name for name in expected if name not in empty]
    current = PART_OF.get(progress["what"], progress["what"])
    furthest = max((order.index(name) for name in stages if name in order), default=-1)
    finished = [name for name in order[:furthest] if name in stages and name != current]
    expected_so_far = sum(expected[name] for name in finished)
    pace = sum(stages[name] for name in finished) / expected_so_far if expected_so_far > 0.0 else 1.0
    seconds = pace * sum(expected[name] for name in order[furthest + 1 :])
    if current not in order[:furthest]:
        use_steps = rest_of_stage is not None and current not in IN_ROUNDS and current == progress["what"]
        # The more steps are done, the more they say: the parts of a hold-out differ in duration.
        weight = done / total if use_steps else 0.0
        by_pace = max(0.0, pace * expected.get(current, 0.0) - stages.get(current, 0.0))
        by_steps = rest_of_stage or 0.0
        seconds += (1.0 - weight) * by_pace + weight * by_steps if current in expected else by_steps
    spent = sum(stages.values())
    return Remaining(now, spent / (spent + seconds) if spent + seconds > 0.0 else 0.0, seconds)


def _merged(seconds: Mapping[str, float]) -> dict[str, float]:
    """Seconds of stages in the order of their beginning, with stages of one group (``PART_OF``) added up."""
    merged: dict[str, float] = {}
    for name, value in seconds.items():
        group = PART_OF.get(name, name)
        merged[group] = merged.get(group, 0.0) + value
    return merged


def smoothed(previous: Remaining | None, new: Remaining) -> Remaining:
    """Estimate to show after a previous one: the share does not shrink, and the remaining time falls."""
    if previous is None:
        return new
    share = new.share if previous.share is None or new.share is None else max(previous.share, new.share)
    if previous.seconds is None or new.seconds is None:
        return Remaining(new.time, share, new.seconds)
    falling = max(0.0, previous.seconds - (new.time - previous.time))
    seconds = new.seconds if new.seconds > MIN_INCREASE_RATIO * falling else min(falling, new.seconds)
    return Remaining(new.time, share, seconds)
