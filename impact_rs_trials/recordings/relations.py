# SPDX-License-Identifier: Apache-2.0
"""Linear relations between signals: factor, lag, correlation, standard errors and likelihood, column by column.

Positions predict the other signals of the joints: velocities are dq/dt, torques are M ddq + h. A measured signal y_j
differs from its prediction x_j by unit and sign, by a lag, by friction and by noise:

    y_j = a_j x_j + sum_i c_ij z_ij + noise

Least squares gives a_j after projection of x_j and y_j to the complement of the further columns z_ij (Frisch and Waugh
1933). With the residuals r of N samples, of which k are independent (k = N / w after moving averages over w samples),

    standard error     s_a^2 = (sum r^2 / k) / sum x^2
    correlation        sum x y / sqrt(sum x^2 sum y^2)                          about zero: signals have a true zero
    log likelihood     -k/2 log(sum r^2 / sum y^2)                              of normal noise, its size marginalised
    lag, first order   y = a x(t - L)  ~  a x - a L dx/dt

Conclusions are drawn by the callers; all their thresholds are in this module.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from impact_rs_sim.robots.robot import Array, RobotFacts

# Factors between a measured and an expected signal [-].
SAME_UNIT_FACTORS = (0.8, 1.25)  # the unit is found: low-passed velocities differ by less, units by 57 and more
PLAUSIBLE_FACTORS = (0.5, 2.0)  # outside: wrong unit, sign or joint; rough models, friction and loads stay inside
SINGLE_GRAVITY_FACTORS = (0.5, 1.5)  # of the gravity torque in a torque; gravity added twice has the factor 2
TORQUE_UNIT_FACTORS = (0.2, 5.0)  # a unit of torque is possible: N m and mN m differ by 1000
MAX_FACTOR_ERROR = 0.1  # of a velocity: a low-pass attenuates as much
MIN_REPORTED_SIGMA = 5.0  # standard errors; many joints, runs and signals are tested
# Correlations [-].
MIN_CORRELATION = 0.8  # a factor is believed
MIN_CORRELATION_OF_COLUMNS = 0.95  # a column without a name is the derivative of another one
MAX_CORRELATION_DRIVING = -0.5  # of torque and velocity, below which friction would drive the joint
# Log likelihoods [-] and what they are compared with.
DECISIVE_LOG_ODDS = float(np.log(100.0))  # log Bayes factor (Jeffreys 1961)
DECISIVE_LOG_LIKELIHOOD = 30.0  # gain of the better model; errors of models are larger than noise
# Samples and speeds.
MIN_SPEED_SHARE = 0.02  # of the data sheet's velocity, rms, from which a joint moves [-]
FULL_FRICTION_RAD_S = 0.02  # speed from which Coulomb friction is full
AVERAGED_S = 0.05  # of the moving average: encoders are quantised
MIN_AVERAGED_SAMPLES = 5
CROSS_VALIDATION_BLOCKS = 20  # of a recording; even ones predict odd ones and vice versa
MIN_MISFIT_SHARE = 1e-12  # of the power, residual of a fit of exact numbers


@dataclass(frozen=True)
class LinearRelation:
    """Fit of measured columns by expected ones.

    Attributes:
        factor: a, ``(n,)``.
        standard_error: Of the factor, ``(n,)``.
        correlation: About zero, ``(n,)``.
        misfit: Sum of squared residuals, ``(n,)``.
        power: Sum of squares of the measured columns, ``(n,)``.
        unexplained: Sum of squared residuals of a fit by the further columns alone, ``(n,)``.
        independent: Number of independent errors, one for all columns or ``(n,)``.
    """

    factor: Array
    standard_error: Array
    correlation: Array
    misfit: Array
    power: Array
    unexplained: Array
    independent: float | Array

    @property
    def log_likelihood(self) -> Array:
        """Log likelihood ratio of the fit to noise alone, by column, ``(n,)``."""
        return np.asarray(
            -0.5 * self.independent * np.log(self.misfit / np.maximum(self.power, 1e-300) + MIN_MISFIT_SHARE)
        )

    @property
    def log_likelihood_ratio(self) -> Array:
        """Log likelihood ratio of the fit to the further columns alone, by column, ``(n,)``."""
        power = np.maximum(self.power, 1e-300)
        ratio = (self.misfit / power + MIN_MISFIT_SHARE) / (self.unexplained / power + MIN_MISFIT_SHARE)
        return np.asarray(-0.5 * self.independent * np.log(ratio))


def fit(
    expected: Array,
    measured: Array,
    further: Sequence[Array] = (),
    independent: float | Array | None = None,
    bounds: tuple[float, float] | None = None,
) -> LinearRelation:
    """Fit ``measured = a expected + sum c further`` in every column.

    Args:
        expected: x, ``(k, n)``.
        measured: y, ``(k, n)``.
        further: Signals z whose factors are fitted as well, each ``(k, n)``.
        independent: Number of independent errors, one for all columns or ``(n,)``; None: the number of samples.
        bounds: Smallest and largest size of the factor; None: any.
    """
    x, y = expected, measured
    if further:
        basis = np.linalg.qr(np.stack(further, axis=-1).swapaxes(0, 1))[0]
        x, y = (signal - np.einsum("jkf,jf->kj", basis, np.einsum("jkf,kj->jf", basis, signal)) for signal in (x, y))
    power, product = np.maximum(np.sum(x * x, axis=0), 1e-300), np.sum(x * y, axis=0)
    factor = product / power
    if bounds is not None:
        factor = np.where(factor < 0.0, -1.0, 1.0) * np.clip(np.abs(factor), *bounds)
    misfit, unexplained = np.sum(np.square(y - factor * x), axis=0), np.sum(y * y, axis=0)
    count = max(1.0, float(len(x))) if independent is None else independent
    size = np.sqrt(power) * np.sqrt(np.maximum(unexplained, 1e-300))
    total = np.sum(np.square(measured), axis=0)
    return LinearRelation(factor, np.sqrt(misfit / count / power), product / size, misfit, total, unexplained, count)


def effective_samples(first: Array, second: Array) -> Array:
    """Independent pairs of samples of two autocorrelated signals ``(k, n)`` (Bartlett 1946), ``(n,)``.

    The correlation of unrelated signals has the variance sum_h rho_1(h) rho_2(h) / k over all lags h, with their
    autocorrelations rho; k_effective independent samples give 1 / k_effective.
    """
    count = len(first)
    length = scipy.fft.next_fast_len(2 * count, real=True)
    spectra = [np.abs(np.fft.rfft(signal - signal.mean(axis=0), length, axis=0)) ** 2 for signal in (first, second)]
    rho_1, rho_2 = (np.fft.irfft(spectrum, length, axis=0)[:count] for spectrum in spectra)  # times the powers
    product = rho_1 * rho_2 / np.maximum(rho_1[0] * rho_2[0], 1e-300)
    return np.asarray(count / np.clip(product[0] + 2.0 * np.sum(product[1:], axis=0), 1.0, 0.5 * count))


def pooled(expected: Array, measured: Array) -> LinearRelation:
    """Fit with one factor of all columns."""
    return fit(expected.reshape(-1, 1), measured.reshape(-1, 1))


def correlation(first: Array, second: Array) -> float:
    """Correlation of two signals ``(k,)`` about zero."""
    return float(fit(first[:, None], second[:, None]).correlation[0])


def fit_with_lag(
    expected: Array, derivative: Array, measured: Array, independent: float
) -> tuple[LinearRelation, Array, Array]:
    """Fit ``measured(t) = a expected(t - L)`` to first order in L.

    Args:
        expected: x, ``(k, n)``.
        derivative: dx/dt, ``(k, n)``.
        measured: y, ``(k, n)``.
        independent: Number of independent errors.

    Returns:
        The fit; L of every column and its standard error, ``(n,)`` [s].
    """
    relation = fit(expected, measured, [derivative], independent)
    late = fit(derivative, measured, [expected], independent)
    with np.errstate(divide="ignore", invalid="ignore"):  # of columns that do not change
        return relation, -late.factor / relation.factor, late.standard_error / np.abs(relation.factor)


# ---- motions --------------------------------------------------------------------------------------------------------


def evenly(count: int, max_count: int) -> NDArray[np.signedinteger]:
    """Indices of at most ``max_count`` of ``count`` samples, at even distances."""
    return np.unique(np.linspace(0, count - 1, min(count, max_count)).astype(int))


def averaged(time: Array, values: Array) -> tuple[Array, Array]:
    """Moving averages over some hundredths of a second, ``(k,)`` and ``(k, c)``."""
    period = float(np.median(np.diff(time)))
    width = int(
        np.clip(round(AVERAGED_S / max(period, 1e-9)), MIN_AVERAGED_SAMPLES, max(MIN_AVERAGED_SAMPLES, time.size // 20))
    )
    window = np.ones(width) / width
    mean = np.column_stack([np.convolve(column, window, "valid") for column in values.T])
    return np.convolve(time, window, "valid"), mean


@dataclass(frozen=True)
class AveragedMotion:
    """Positions after a moving average, with their derivatives.

    Attributes:
        time: ``(k,)`` [s].
        position: q, ``(k, n)``.
        velocity: dq/dt by central differences, ``(k, n)``.
        width: Samples of the moving average, with one independent error.
    """

    time: Array
    position: Array
    velocity: Array
    width: int

    @staticmethod
    def of(time: Array, position: Array) -> AveragedMotion:
        """Averaged motion from positions ``(k, n)`` at timestamps ``(k,)`` [s]."""
        averaged_time, q = averaged(time, position)
        width = max(1, time.size - averaged_time.size + 1)
        return AveragedMotion(averaged_time, q, np.gradient(q, averaged_time, axis=0), width)

    @property
    def acceleration(self) -> Array:
        """Second derivative, ``(k, n)``."""
        return np.asarray(np.gradient(self.velocity, self.time, axis=0))

    @property
    def independent(self) -> float:
        """Number of independent errors."""
        return self.time.size / self.width

    def velocity_relation(self, time: Array, measured: Array) -> LinearRelation:
        """Fit of a signal ``(k, n)`` at the original timestamps by the derivative."""
        return fit(self.velocity, averaged(time, measured)[1], independent=self.independent)


def moves(velocity: Array, facts: RobotFacts) -> NDArray[np.bool_]:
    """Mask of the moving joints, by their velocities ``(k, n)`` [rad/s]; ``(n,)``."""
    limits = np.array(facts.limits.velocity_rad_s)
    return np.asarray(np.sqrt(np.mean(np.square(velocity), axis=0)) > MIN_SPEED_SHARE * limits)


def dry_friction(velocity: Array) -> Array:
    """Regressor of Coulomb friction from velocities ``(k, n)`` [rad/s]: their signs, smooth about zero."""
    return np.asarray(np.tanh(velocity / FULL_FRICTION_RAD_S))


# ---- prediction of unseen samples -----------------------------------------------------------------------------------


def odd_blocks(count: int) -> NDArray[np.bool_]:
    """Mask of the samples in odd blocks, ``(count,)``."""
    return np.asarray(np.floor(np.linspace(0.0, CROSS_VALIDATION_BLOCKS, count, endpoint=False)).astype(int) % 2 == 1)


def held_out_misfit(basis: Array, measured: Array, odd: NDArray[np.bool_]) -> Array:
    """Sum of squared residuals in two-fold cross-validation, ``(c,)``.

    Args:
        basis: Regressors, ``(k, f)``.
        measured: Signals, ``(k, c)``.
        odd: Mask of the second fold, ``(k,)``.
    """
    misfit = np.zeros(measured.shape[1])
    for held_out in (odd, ~odd):
        factors = np.linalg.lstsq(basis[~held_out], measured[~held_out], rcond=None)[0]
        misfit += np.sum(np.square(measured[held_out] - basis[held_out] @ factors), axis=0)
    return misfit


# ---- lags of any size -----------------------------------------------------------------------------------------------


def cross_correlation(first: Array, second: Array) -> tuple[Array, Array, Array]:
    """Normalised cross-correlation over the overlap: absolute values (factors may differ in sign), summed over columns.

    Args:
        first: Centred columns, ``(k, c)``.
        second: Centred columns on the same even grid, ``(m, c)``.

    Returns:
        Correlation by lag, ``(k + m - 1,)``; the lags, and the overlap of both at each lag [samples].
    """
    scale = np.linalg.norm(second, axis=0) * np.linalg.norm(first, axis=0)
    weight = np.divide(1.0, scale, out=np.zeros_like(scale), where=scale > 1e-9 * max(float(scale.max()), 1e-300))
    total = np.zeros(len(first) + len(second) - 1)
    powers = np.zeros((2, total.size))
    ones = (np.ones(len(first)), np.ones(len(second)))
    for a, b, w in zip(first.T, second.T, weight, strict=True):
        sized = (a / max(np.linalg.norm(a), 1e-300), b / max(np.linalg.norm(b), 1e-300))
        if w == 0.0:
            continue
        total += np.abs(scipy.signal.correlate(*sized, method="fft"))
        powers[0] += scipy.signal.correlate(np.square(sized[0]), ones[1], method="fft")
        powers[1] += scipy.signal.correlate(ones[0], np.square(sized[1]), method="fft")
    lags = scipy.signal.correlation_lags(len(first), len(second))
    overlap = np.rint(scipy.signal.correlate(*ones, method="fft"))
    energy = np.sqrt(np.maximum(powers[0], 0.0) * np.maximum(powers[1], 0.0))
    return np.divide(total, energy, out=np.zeros_like(total), where=energy > 1e-6 * energy.max()), lags, overlap
