# SPDX-License-Identifier: Apache-2.0
"""Stages that a diagnosis reports: the folds of its hold-out, and what it does not expect to do."""

from __future__ import annotations

import pickle

from analytic_world import EFFECTS, AnalyticSource

from impact_rs_analysis.diagnosis.diagnose import findings_of
from impact_rs_sim.progress import HOLD_OUT, SEARCH

Reports = list[tuple[str, int, int]]


def reports_of(source: AnalyticSource) -> Reports:
    """What the search of an effect reports."""
    found: Reports = []
    source.progress = lambda stage, done, total: found.append((stage, done, total))
    findings_of(source, [EFFECTS["straight"]])
    return found


def test_without_lack_of_fit_neither_search_nor_hold_out_are_expected() -> None:
    """Kills a time left that holds two thirds of work which is not done."""
    assert reports_of(AnalyticSource(2)) == [(SEARCH, 0, 0), (HOLD_OUT, 0, 0), (HOLD_OUT, 0, 0)]


def test_every_fold_of_the_hold_out_is_reported() -> None:
    """Kills silence through most of the time of a recording."""
    assert reports_of(AnalyticSource(1, (("straight", (3.0,)),))) == [(HOLD_OUT, fold, 6) for fold in range(7)]


def test_a_copy_for_a_worker_does_not_report() -> None:
    """Kills a diagnosis on workers that ends because a report cannot be pickled."""
    source = AnalyticSource(1)
    source.progress = lambda *_: None
    assert "progress" not in source.__getstate__() and AnalyticSource.progress is None
    source.model = source.physics = None  # type: ignore[assignment]
    assert pickle.loads(pickle.dumps(source)).progress is None
