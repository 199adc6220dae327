# SPDX-License-Identifier: Apache-2.0
"""Results that are kept: the most recently used ones, for several threads."""

from __future__ import annotations

import pickle
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import pytest

from impact_rs_sim.recent import Recent


@pytest.fixture
def hasty_threads() -> Iterator[None]:
    """Threads that take turns every microsecond."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(before)


def test_the_least_recently_used_result_is_given_up_and_made_again() -> None:
    made: list[int] = []

    def result(key: int) -> int:
        return kept.of(key, lambda: made.append(key) or -key)

    kept = Recent[int](2)
    assert [result(key) for key in (1, 2, 1, 3, 1, 2)] == [-1, -2, -1, -3, -1, -2]
    assert made == [1, 2, 3, 2]


def test_threads_find_the_result_of_their_key_while_others_push_it_out(hasty_threads: None) -> None:
    """Kills: a result that another thread gives up between the look and the answer, a KeyError once in a while."""
    kept = Recent[int](2)

    def look(start: int) -> bool:
        return all(kept.of(key % 5, lambda key=key: key % 5) == key % 5 for key in range(start, start + 20_000))

    with ThreadPoolExecutor(4) as threads:
        assert all(threads.map(look, range(4)))


def test_a_result_that_needs_another_one_is_made_and_a_cache_can_be_pickled() -> None:
    kept = Recent[int](3)
    assert kept.of("outer", lambda: 1 + kept.of("inner", lambda: 1)) == 2
    assert pickle.loads(pickle.dumps(kept)).of("outer", lambda: 0) == 2
