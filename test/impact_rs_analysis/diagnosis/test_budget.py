# SPDX-License-Identifier: Apache-2.0
"""A diagnosis of a model that is far off ends in its processor time, and says what it did not try.

The clock counts simulations, of which equal ones are made once, so that the same search always ends at the same place.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import pytest
from analytic_world import EFFECTS, AnalyticSource, knowing

from impact_rs_analysis.diagnosis.diagnose import diagnose
from impact_rs_analysis.diagnosis.document import DiagnosisDocument
from impact_rs_analysis.diagnosis.search.budget import UNLIMITED, Budget, StopRequest
from impact_rs_analysis.diagnosis.search.effect_selection import Search
from impact_rs_analysis.diagnosis.search.fit import Evidence
from impact_rs_analysis.evidence.cluster import Added
from impact_rs_analysis.evidence.source import View
from impact_rs_sim.robots.robot import Array

CONSIDERED = ("straight", "bent", "payload", "stick_slip", "of_joints", "of_motors", "rippled", "saturated")
FAR_OFF = (("straight", (20.0,)), ("stick_slip", (3.0, 2.0, -2.5)), ("saturated", (9.0,)), ("outside", (6.0,)))
ENOUGH, LIMIT = 1e6, 1000.0  # simulations
ONE_STEP = 100  # of them, of one fit, which nothing interrupts


class Counted(AnalyticSource):
    """The world with a count of its different simulations."""

    def __init__(self, hidden: Added = FAR_OFF) -> None:
        super().__init__(3, hidden)
        self.made: set[tuple[int, Added]] = set()

    def predict(self, wanted: Sequence[tuple[int, Added]], what: str) -> list[Array | None]:
        self.made.update(wanted)
        return super().predict(wanted, what)


@cache
def diagnosed(limit: float | None) -> tuple[DiagnosisDocument, int]:
    """Diagnosis of a model that is far off, and the simulations that it took."""
    source = Counted()
    knowing(source, *(EFFECTS[name] for name in CONSIDERED))
    budget = UNLIMITED if limit is None else Budget(limit, lambda: len(source.made))
    return diagnose(source, source.model, budget=budget), len(source.made)


def test_a_search_ends_in_its_time_with_the_best_answer_so_far() -> None:
    whole, needed = diagnosed(None)
    assert whole.budget.left_out == () and needed > 3 * LIMIT
    found, taken = diagnosed(LIMIT)
    assert taken < LIMIT + 8 * ONE_STEP  # of the search, of each fold of the hold-out, and of the ends of intervals
    assert "straight" in found.named  # by far the largest
    assert found.hold_out.folds == 6 and found.held_out_error_after < 0.7 * found.held_out_error_before
    assert found.verdict.leaves_residuals


def test_what_was_not_tried_is_said() -> None:
    found, _ = diagnosed(LIMIT)
    assert found.budget.limit == LIMIT
    assert any(what.startswith("effects in addition to straight") for what in found.budget.left_out)
    first = found.remarks[0]
    assert first.startswith("not tried, because the processor time of 1000 s was spent: ") and "--budget" in first
    assert all(what in first for what in found.budget.left_out)


def test_the_same_time_gives_the_same_answer() -> None:
    assert diagnosed(LIMIT) == diagnosed.__wrapped__(LIMIT)


def test_enough_time_changes_nothing() -> None:
    assert diagnosed(ENOUGH)[0].model_copy(update={"budget": diagnosed(None)[0].budget}) == diagnosed(None)[0]


def test_a_part_of_a_budget_notes_what_it_leaves_out_with_the_whole() -> None:
    now = [0.0]
    whole = Budget(10.0, lambda: now[0])
    half = whole.part(0.5)
    now[0] = 6.0
    assert half.leaves_out("a fit") and not whole.leaves_out("another fit")
    assert whole.remaining == pytest.approx(4.0) and list(whole.left_out) == ["a fit"]


@pytest.mark.parametrize(("limit", "complete"), [(ENOUGH, True), (LIMIT, False)])
def test_a_view_whose_search_is_cut_has_no_verdict(
    limit: float, complete: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its first steps may name the wrong effect. Kills: a view that is kept, or left out without a word."""
    source, other = Counted(()), Counted()
    for world in (source, other):
        knowing(world, *(EFFECTS[name] for name in CONSIDERED))
    monkeypatch.setattr(source, "views", lambda: (View("another world", other, "an option"),))
    budget = Budget(limit, lambda: float(len(source.made) + len(other.made)))
    document = diagnose(source, source.model, budget=budget)
    assert [view.name for view in document.views] == (["another world"] if complete else [])
    assert document.budget.left_out == (() if complete else ("the verdict on another world",))
    assert len(other.made) > 0


def test_a_fit_that_is_reported_goes_on_when_the_time_is_spent() -> None:
    """A bent effect of 8, ended after one step: 6.3. Kills: an interval about a point that is no optimum."""
    source, stop = AnalyticSource(3, (("bent", (8.0,)),)), StopRequest()
    search = Search([EFFECTS["bent"]], Evidence.of(source, budget=Budget(0.0, stop=stop)))
    cut = search.fitted(["bent"])
    assert not cut.converged and cut.estimate[0] < 7.0
    whole = search.finished(cut)
    assert whole.converged and whole.estimate[0] == pytest.approx(8.0, abs=0.1)
    stop.made = True
    assert search.finished(cut).estimate[0] < 7.5  # a user who stops it does not wait


def test_a_search_that_is_stopped_names_what_it_has_found_until_then() -> None:
    """Stopped at its first fit of two effects. Kills: folds search on; the document does not say so."""
    source, stop = Counted(), StopRequest()
    knowing(source, *(EFFECTS[name] for name in CONSIDERED))

    def stopping(names: str, error: float) -> None:
        del error
        stop.made = stop.made or "+" in names

    found = diagnose(source, source.model, progress=stopping, budget=Budget(stop=stop))
    assert found.budget.stopped and "the searches of the hold-out" in found.budget.left_out
    assert found.remarks[0].startswith("not tried, because the search was stopped: ")
    assert "straight" in found.named and found.hold_out.searched == 0
    assert len(source.made) < diagnosed(None)[1] / 3


def test_a_search_that_is_stopped_at_once_still_names_the_largest_effect() -> None:
    """Kills: nothing is missing where nothing was tried."""
    source, stop = Counted(), StopRequest()
    knowing(source, *(EFFECTS[name] for name in CONSIDERED))
    stop.made = True
    found = diagnose(source, source.model, budget=Budget(stop=stop))
    assert found.budget.stopped and "straight" in found.named
