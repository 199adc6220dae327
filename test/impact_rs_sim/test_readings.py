# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
import scipy.signal

from impact_rs_sim.readings import Filter, filtered

PERIOD, T = 1e-3, 0.0188
TIME = PERIOD * np.arange(400)
INPUT = np.column_stack([np.sin(7.0 * TIME) + 0.3 * TIME, np.cos(11.0 * TIME)])
BEFORE = 3000  # samples, in which every filter settles
FIRST_ORDER, BUTTERWORTH = [T, 1.0], [0.5 * T**2, T, 1.0]
CASES = {(T, 0.0): FIRST_ORDER, (0.0, T): BUTTERWORTH, (T, T): np.polymul(FIRST_ORDER, BUTTERWORTH)}


def simulated(denominator, before):
    """Output of the differential equation, by scipy.signal.lsim, after the samples before."""
    whole = np.vstack((before, INPUT))
    time = PERIOD * np.arange(len(whole))
    change = whole - whole[0]
    outputs = [scipy.signal.lsim(([1.0], denominator), column, time)[1] for column in change.T]
    return np.column_stack(outputs)[len(before) :] + whole[0]


@pytest.mark.parametrize("lags", CASES, ids=["first order", "Butterworth", "both"])
def test_filters_are_those_of_their_differential_equations(lags):
    """After a ramp, and of sample by sample after rest; kills a wrong sign of the complex part, and a wrong start."""
    slope = np.polyfit(TIME[:4], INPUT[:4], 1)[0]
    ramp = INPUT[0] + np.outer(PERIOD * np.arange(-BEFORE, 0), slope)
    error = 2e-4 if all(lags) else 1e-12  # the input of the second filter is not linear between samples
    np.testing.assert_allclose(filtered(TIME, INPUT, lags), simulated(CASES[lags], ramp), atol=error)
    by_sample = Filter(0.0, lags, PERIOD)
    found = np.array([by_sample(k, row) for k, row in enumerate(INPUT)])
    np.testing.assert_allclose(found, simulated(CASES[lags], np.repeat(INPUT[:1], BEFORE, axis=0)), atol=error)


def test_the_cut_off_of_a_butterworth_filter():
    """Its gain is 1 / sqrt(2) at f = sqrt(2) / (2 pi T), and the phase -90 degrees (Butterworth 1930)."""
    time = PERIOD * np.arange(4000)
    angle = np.sqrt(2.0) / T * time
    found = filtered(time, np.sin(angle)[:, None], (0.0, T))[2000:, 0]
    np.testing.assert_allclose(found, -np.cos(angle[2000:]) / np.sqrt(2.0), atol=1e-3)


def test_a_filter_goes_on_from_its_first_reading_and_slope():
    """From the middle of a transient as the whole; kills a start at rest, and one with the slope of the input."""
    step = np.vstack((np.zeros((50, 2)), np.ones((350, 2))))
    for lags in ((T, 0.0), (0.0, T)):
        whole = filtered(TIME, step, lags, (np.zeros(2), np.zeros(2)))
        slope = np.gradient(whole, PERIOD, axis=0)[60]
        np.testing.assert_allclose(filtered(TIME[60:], step[60:], lags, (whole[60], slope)), whole[60:], atol=1e-3)


def test_a_filter_much_faster_than_the_samples_changes_nothing():
    """A fit ends at a bound up to the rounding; kills exp(period / 1e-19), which overflows."""
    np.testing.assert_allclose(filtered(TIME, INPUT, (1e-19, 1e-12)), INPUT, atol=1e-9)
