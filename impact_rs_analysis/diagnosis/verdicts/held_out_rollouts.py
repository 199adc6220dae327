# SPDX-License-Identifier: Apache-2.0
"""Held-out rollouts: open-loop predictions of held-out motions from measured states.

Every fold of the hold-out is rolled out with the model, and with the effects fitted without the fold, from the same
measured states (:mod:`impact_rs_analysis.evidence.rollouts`). The torque balance measures errors of acceleration, a
rollout their integral. If a model of the right class lacks an effect, both improve with it. If the balance improves and
rollouts get worse, the effect imitates another cause.

Rollouts that do not overlap are paired, after minus before, and tested by Wilcoxon's signed-rank test (Wilcoxon 1945)
of the mean squared error of the joints, each over its mean square under both models. They are compared at the longest
horizon at which one of the two models predicts: its squared error is below

    2 var(q),

the squared difference of two random moments of the motion (limit of predictability, against climatology: Leith 1974,
Mon. Weather Rev. 102). At longer horizons a wrist of little inertia has turned several times, and the errors of right
and wrong models differ by chance.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy

from impact_rs_analysis.diagnosis.document import HeldOutRollouts
from impact_rs_analysis.diagnosis.search.hold_out import HoldOut
from impact_rs_analysis.evidence.levels import rounded
from impact_rs_analysis.evidence.rollouts import MIN_STARTS_APART, FreeMotion, Rollouts
from impact_rs_analysis.evidence.source import Source
from impact_rs_sim.robots.robot import Array


def held_out_rollouts(source: Source, hold_out: HoldOut | None) -> HeldOutRollouts | None:
    """Rollouts of every fold without and with the effects that were fitted to the other folds.

    None without a motion, or if the effects change no motion, as effects of contact alone.

    Args:
        source: Measurements with the model's predictions.
        hold_out: Result of the hold-out; None: there was none.
    """
    if hold_out is None:
        return None
    parts = [
        (motion, added)
        for fold, added in zip(hold_out.folds, hold_out.added, strict=True)
        for motion in source.free_motions(fold.held_out)
    ]
    before = source.rollouts([(motion, ()) for motion, _ in parts])
    after = source.rollouts(parts)
    if before is None or after is None:
        return None
    row = _row_compared(before, after, [motion for motion, _ in parts])
    change = _changes(before, after, row)
    nonzero = change[change != 0.0]
    if not nonzero.size:
        return None
    # Exact, not by permutation in spite of ties: only diverged rollouts tie, and 8,192 permutations take a second.
    p_value = float(scipy.stats.wilcoxon(nonzero, method="exact").pvalue) if nonzero.size >= MIN_STARTS_APART else None
    return HeldOutRollouts(
        before=before.document(),
        after=after.document(),
        horizon_s=rounded(float(before.time[row])),
        compared=change.size,
        closer=int(np.sum(change < 0.0)),
        p_value=p_value,
    )


def _row_compared(before: Rollouts, after: Rollouts, motions: Sequence[FreeMotion]) -> int:
    """Row of the longest horizon at which one of the two models predicts; of the shortest if neither does."""
    positions: dict[str, list[Array]] = {}
    for motion in motions:
        positions.setdefault(motion.arm, []).append(motion.position)
    spreads = {arm: 2.0 * np.var(np.concatenate(rows), axis=0) for arm, rows in positions.items()}
    rows = min(before.rows, after.rows, key=len)
    for row in rows[:0:-1]:
        with np.errstate(invalid="ignore"):
            if min(np.mean(_scores(rollouts, spreads, row)) for rollouts in (before, after)) < 1.0:
                return row
    return rows[0]


def _changes(before: Rollouts, after: Rollouts, row: int) -> Array:
    """Change of the error of every rollout that overlaps no other, at one row, ``(S,)`` [-]."""
    scales: dict[str, Array] = {}
    for arm in dict.fromkeys(part.arm for part in before.parts):
        squares = [np.square(part.joints[row]) for part in (*before.parts, *after.parts) if part.arm == arm]
        scales[arm] = np.nanmean(np.concatenate(squares), axis=0)
    scores = [_scores(rollouts, scales, row)[rollouts.apart] for rollouts in (after, before)]
    with np.errstate(invalid="ignore"):
        return np.nan_to_num(scores[0] - scores[1], nan=0.0)


def _scores(rollouts: Rollouts, scales: dict[str, Array], row: int) -> Array:
    """Mean squared error of the joints of every rollout, over its scale, ``(S,)`` [-]; infinite if it diverged."""
    rows: Sequence[Array] = [
        np.mean(np.square(part.joints[row]) / np.maximum(scales[part.arm], 1e-300), axis=1) for part in rollouts.parts
    ]
    return np.nan_to_num(np.concatenate(rows), nan=np.inf)
