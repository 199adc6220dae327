# SPDX-License-Identifier: Apache-2.0
"""A remark on many runs is printed once, with the range of its numbers."""

from __future__ import annotations

import pickle

from hypothesis import given
from hypothesis import strategies as st

from impact_rs_trials.recordings.remarks import Amount, Remark, joined, merged

WORDS = st.text(max_size=5)
PARTS = st.lists(
    st.one_of(WORDS, st.builds(Amount, st.floats(-1e3, 1e3), st.sampled_from([".3g", "+.1f"]))), max_size=6
)


def late(ms: float) -> Remark:
    return Remark("/commands: log time, less ", Amount(ms, ".1f"), " ms to be on the stamps' clock")


def test_sixteen_runs_whose_last_digit_differs_make_one_remark() -> None:
    runs = [(f"run_{number:02d}", late(0.15 + 0.01 * number)) for number in range(16)]
    assert len({remark for _, remark in runs}) > 1
    assert merged(runs) == ["16 runs: /commands: log time, less 0.1 to 0.3 ms to be on the stamps' clock"]
    assert merged(runs, 20) == ["16 of 20 runs: /commands: log time, less 0.1 to 0.3 ms to be on the stamps' clock"]


def test_a_few_runs_are_named_and_other_words_stay_apart() -> None:
    found = merged([("a", late(0.2)), ("b", late(0.2)), ("a", "no command"), ("", "on all runs")])
    assert found == [
        "a, b: /commands: log time, less 0.2 ms to be on the stamps' clock",
        "a: no command",
        "on all runs",
    ]


@given(parts=PARTS, other=st.lists(st.floats(-1e3, 1e3), min_size=6, max_size=6))
def test_other_numbers_make_no_other_kind(parts: list[str | Amount], other: list[float]) -> None:
    changed = [
        part._replace(value=new) if isinstance(part, Amount) else part for part, new in zip(parts, other, strict=False)
    ]
    assert len(merged([("a", Remark(*parts)), ("b", Remark(*changed))])) == 1
    assert merged([("", Remark(*parts))]) == ["".join(map(str, parts))]


@given(parts=PARTS)
def test_a_remark_comes_back_from_another_process_with_its_numbers(parts: list[str | Amount]) -> None:
    remark = Remark("arm: ", joined(", ", [Remark(*parts), "a"]))
    again = pickle.loads(pickle.dumps(remark))
    assert (again, again.parts) == (remark, remark.parts)
