# SPDX-License-Identifier: Apache-2.0
"""A lag is that of its differential equation, at any sampling, in one step and over many samples alike."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from impact_rs_sim.effects.formula import Formula
from impact_rs_sim.errors import InputError
from impact_rs_sim.memory import Memory, lag_along

T = 0.2  # s
FORMULA = Formula("lag(u, T)", {"u", "T"})


def stepped(time: np.ndarray, u: np.ndarray, constant: float = T) -> np.ndarray:
    memory = Memory()
    values = [{"t": now, "u": value, "T": constant} for now, value in zip(time.tolist(), u.tolist(), strict=True)]
    return np.array([FORMULA(one, memory) for one in values])


@pytest.mark.parametrize("step", [1e-3, 0.02])
def test_a_step_is_followed_exponentially(step: float) -> None:
    """1 - exp(-t/T), t from the middle of the sampling step in which u rises, to the second order of that step."""
    time = np.arange(0.0, 1.0, step)
    found = stepped(time, np.where(time > 0.0, 1.0, 0.0))
    np.testing.assert_allclose(found[1:], 1.0 - np.exp(-(time[1:] - step / 2.0) / T), atol=0.1 * (step / T) ** 2)


@pytest.mark.parametrize("rate", [1.0, 5.0, 20.0])
def test_a_sine_is_smaller_and_later(rate: float) -> None:
    """Gain 1 / sqrt(1 + (w T)^2), phase -atan(w T), once the start has died away."""
    time = np.arange(0.0, 4.0, 2e-3)
    found, late = stepped(time, np.sin(rate * time)), time > 10.0 * T
    expected = np.sin(rate * time - np.arctan(rate * T)) / np.hypot(1.0, rate * T)
    np.testing.assert_allclose(found[late], expected[late], atol=3e-4)


def test_a_ramp_is_followed_exactly_at_any_sampling() -> None:
    """z = s (t - T (1 - exp(-t/T))): whoever records slowly finds the same time constant."""
    for time in (np.arange(0.0, 1.0, 1e-3), np.arange(0.0, 1.0, 0.1), np.array([0.0, 0.03, 0.4, 0.41, 0.9])):
        np.testing.assert_allclose(stepped(time, 3.0 * time), 3.0 * (time - T * -np.expm1(-time / T)), atol=1e-12)


@pytest.mark.parametrize(("constant", "follows"), [(0.0, True), (1e-9, True), (1e12, False), (np.inf, False)])
def test_its_limits_are_the_quantity_and_its_start(constant: float, follows: bool) -> None:
    time = np.arange(0.0, 1.0, 0.01)
    u = 2.0 + np.sin(9.0 * time)
    np.testing.assert_allclose(stepped(time, u, constant), u if follows else 2.0, atol=1e-6)


@given(st.lists(st.tuples(st.floats(1e-4, 1.0), st.floats(-5.0, 5.0), st.floats(0.0, 10.0)), min_size=1, max_size=20))
def test_many_samples_at_once_are_those_one_after_another(rows: list[tuple[float, float, float]]) -> None:
    """With a time constant that changes as well."""
    length, u, constant = (np.array(column) for column in zip(*rows, strict=True))
    time = np.cumsum(length)
    memory = Memory()
    one = [memory.lag("z", *row) for row in zip(time.tolist(), u.tolist(), constant.tolist(), strict=True)]
    np.testing.assert_allclose(lag_along(time, u, constant), one, atol=1e-9)
    np.testing.assert_array_equal(FORMULA({"t": time, "u": u, "T": constant}), lag_along(time, u, constant))


def test_a_friction_of_dahl_is_a_lag_over_the_distance() -> None:
    """F = F_c (1 - exp(-x/d)) from rest: dF/dx = (F_c - F) / d (Dahl 1968), at any speed."""
    law = Formula("lag(sign(dq), d / max(abs(dq), 1e-9))", {"dq", "d"})
    for speed in (0.01, 1.0):
        time = np.linspace(0.0, 0.3 / speed, 3000)
        dq = np.where(time > 0.0, speed, 0.0)
        np.testing.assert_allclose(law({"t": time, "dq": dq, "d": 0.05}), -np.expm1(-speed * time / 0.05), atol=2e-3)


def test_asked_twice_at_one_time_it_is_the_same() -> None:
    memory = Memory()
    first = [memory.lag("z", time, value, T) for time, value in ((0.0, 1.0), (0.1, 2.0), (0.1, 9.0))]
    assert first[1] == first[2]
    assert memory.lag("z", 0.2, 2.0, T) == pytest.approx(2.0 - (2.0 - first[1]) * np.exp(-0.5))


def test_memories_are_apart() -> None:
    """Two lags of one formula, two formulas of one text, and what two owners remember of one formula."""
    both = Formula("lag(u, T) - lag(u, 10 * T)", {"u", "T"})
    twin, whole = Formula(both.text, both.symbols), Memory()
    for formula, memory in ((both, whole.part("a")), (both, whole.part("b")), (twin, whole.part("a"))):
        assert formula({"t": 0.0, "u": 0.0, "T": T}, memory) == 0.0
        found = formula({"t": 0.1, "u": 1.0, "T": T}, memory)
        assert found == pytest.approx(2.0 * np.exp(-0.5) - 20.0 * np.exp(-0.05) + 18.0)
    assert pickle.loads(pickle.dumps(both))({"t": 0.1, "u": 1.0, "T": T}, Memory()) == 0.0


def test_a_single_state_has_no_past() -> None:
    with pytest.raises(InputError, match=r"lag\(\) depends on what was before.*acts in trials and recordings"):
        FORMULA({"t": 0.1, "u": 1.0, "T": T})
    for text in ("lag(u)", "lag(u, 1, 2, 3)"):
        with pytest.raises(InputError, match=r"lag takes a quantity, a time constant and"):
            Formula(text, {"u"})


def test_a_lag_may_start_cold() -> None:
    """z = u (1 - exp(-t/T)) from 0, in one step after another and along samples."""
    time = np.arange(0.0, 1.0, 0.05)
    cold = Formula("lag(u, T, 0)", {"u", "T"})
    expected = -3.0 * np.expm1(-time / T)
    np.testing.assert_allclose(cold({"t": time, "u": 3.0, "T": T}), expected, atol=1e-12)
    memory = Memory()
    one = [cold({"t": now, "u": 3.0, "T": T}, memory) for now in time.tolist()]
    np.testing.assert_allclose(one, expected, atol=1e-12)
