# SPDX-License-Identifier: Apache-2.0
"""Relations between signals: planted factors, lags, friction and offsets of clocks are recovered with their errors."""

from __future__ import annotations

import numpy as np
import pytest

from impact_rs_trials.recordings.relations import (
    AveragedMotion,
    averaged,
    correlation,
    cross_correlation,
    dry_friction,
    fit,
    fit_with_lag,
    held_out_misfit,
    odd_blocks,
    pooled,
)

TIME = np.arange(0.0, 8.0, 0.01)
X = np.column_stack((np.sin(1.3 * TIME), np.cos(0.7 * TIME) + 0.3 * np.sin(2.9 * TIME)))
RATE = np.gradient(X, TIME, axis=0)


def test_factors_are_recovered_within_their_standard_errors() -> None:
    """Kills a standard error of dependent samples, or one that divides by the power of the wrong signal."""
    rng, draws = np.random.default_rng(1), []
    for _ in range(200):
        found = fit(X, X * [57.3, -1.0] + rng.normal(0.0, 0.2, X.shape))
        draws.append((found.factor - [57.3, -1.0]) / found.standard_error)
    assert np.std(draws, axis=0) == pytest.approx(1.0, abs=0.15)
    assert np.mean(draws, axis=0) == pytest.approx(0.0, abs=0.2)


def test_averaged_noise_has_as_many_independent_errors_as_windows() -> None:
    """Kills AveragedMotion.independent that counts every sample of a moving average."""
    rng, draws = np.random.default_rng(2), []
    motion = AveragedMotion.of(TIME, X)
    for _ in range(200):
        found = motion.velocity_relation(TIME, RATE + rng.normal(0.0, 0.2, X.shape))
        draws.append((found.factor - 1.0) / found.standard_error)
    assert np.std(draws, axis=0) == pytest.approx(1.0, abs=0.2)


def test_friction_is_projected_out_of_a_torque() -> None:
    """Kills a fit that leaves the further columns in either signal: friction of the size of the torque turns a."""
    friction = dry_friction(RATE), RATE
    torque = 2.0 * X + 1.5 * friction[0] - 0.4 * friction[1]
    assert fit(X, torque, friction).factor == pytest.approx(2.0, abs=1e-9)
    assert fit(X, torque, friction).misfit == pytest.approx(0.0, abs=1e-9)
    assert abs(fit(X, torque).factor[1] - 2.0) > 0.01


def test_a_bounded_factor_keeps_its_sign() -> None:
    assert fit(X, -9.0 * X, bounds=(0.5, 2.0)).factor == pytest.approx(-2.0)
    assert fit(X, 0.01 * X, bounds=(0.5, 2.0)).factor == pytest.approx(0.5)


def test_the_log_likelihood_is_that_of_normal_noise() -> None:
    """Kills a likelihood without the count of independent samples: -k/2 log(1 - correlation^2)."""
    noisy = X + np.random.default_rng(3).normal(0.0, 0.5, X.shape)
    found = fit(X, noisy, independent=40.0)
    np.testing.assert_allclose(found.log_likelihood, -20.0 * np.log(1.0 - found.correlation**2), rtol=1e-6)


@pytest.mark.parametrize("lag", [0.02, -0.01])
def test_a_lag_is_recovered_with_its_sign(lag: float) -> None:
    """Kills a turned sign: a positive lag is a signal that is older than what it should be."""
    motion = AveragedMotion.of(TIME, X)
    late = np.column_stack([np.interp(TIME - lag, TIME, column) for column in RATE.T])
    relation, found, error = fit_with_lag(
        motion.velocity, motion.acceleration, averaged(TIME, late)[1], motion.independent
    )
    assert relation.factor == pytest.approx(1.0, abs=0.01)
    assert found == pytest.approx(lag, abs=2e-3)
    assert np.all(error < 2e-3)


def test_one_factor_of_all_columns_and_correlations_about_zero() -> None:
    assert pooled(X, 3.0 * X).factor[0] == pytest.approx(3.0)
    assert correlation(X[:, 0], -2.0 * X[:, 0]) == pytest.approx(-1.0)
    assert correlation(np.ones(50), np.full(50, 4.0)) == pytest.approx(1.0)  # constants go together about zero


def test_unseen_samples_are_predicted_by_the_others() -> None:
    """Kills a misfit of seen samples: as many regressors as samples of noise would leave nothing of them."""
    rng = np.random.default_rng(4)
    noise, odd = rng.standard_normal((200, 1)), odd_blocks(200)
    assert 90 <= odd.sum() <= 110 and not odd[0]
    left = held_out_misfit(rng.standard_normal((200, 80)), noise, odd)
    assert left > np.sum(noise**2)
    assert held_out_misfit(noise, 3.0 * noise, odd) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("lag", [70, -35])
def test_the_cross_correlation_peaks_at_the_offset_of_two_clocks(lag: int) -> None:
    """Kills lags of the other sign; ``second`` is ``first``, ``lag`` samples later."""
    rng = np.random.default_rng(5)
    signal = np.cumsum(rng.standard_normal((1000, 2)), axis=0)
    first, second = signal[200:800], signal[200 + lag : 800 + lag]
    together, lags, overlap = cross_correlation(first - first.mean(axis=0), second - second.mean(axis=0))
    allowed = np.where(overlap > 300, together, 0.0)
    assert lags[int(np.argmax(allowed))] == lag
