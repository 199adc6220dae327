# SPDX-License-Identifier: Apache-2.0
"""Noise of a table without repeats, by nearest-neighbour regression over the ante-impact states.

The residual of a model is a smooth function of the state before the impact, plus noise. A linear function fitted to the
k nearest rows of row i predicts its residual r_i with the error e_i, and

    var(e_i) = s^2 (1 + h_i),        h_i = x_i^T (X^T X)^-1 x_i        X: states of the neighbours, with a constant

so s^2 is the mean of e_i^2 / (1 + h_i) (local regression: Cleveland and Devlin 1988). Curvature between neighbours
biases s upwards, never downwards: noise is not mistaken for a missing law, but a missing law may be mistaken for noise.
"""

from __future__ import annotations

import numpy as np
import scipy

from impact_rs_sim.robots.robot import Array

NEIGHBOURS_PER_COEFFICIENT = 3
MIN_SPREAD_SHARE = 1e-9  # of the largest value of a coordinate; less is rounding
MIN_ROWS_PER_COEFFICIENT = 12  # with fewer, neighbours are far apart


def nearest_neighbour_noise(states: Array, residuals: Array) -> Array | None:
    """Standard deviation of the noise of every residual, ``(F,)``.

    Args:
        states: State of each row, ``(rows, d)``; every coordinate is standardised.
        residuals: Residuals of each row, ``(rows, F)``.

    Returns:
        None with too few rows for their number of coordinates.
    """
    spread = states.std(axis=0)
    varied = spread > MIN_SPREAD_SHARE * np.abs(states).max(axis=0, initial=0.0)
    if not varied.any():  # all rows are repeats
        return np.asarray(residuals.std(axis=0, ddof=1)) if len(residuals) >= MIN_ROWS_PER_COEFFICIENT else None
    states = (states - states.mean(axis=0))[:, varied] / spread[varied]
    rows, coordinates = states.shape
    count = NEIGHBOURS_PER_COEFFICIENT * (coordinates + 1)
    if rows < MIN_ROWS_PER_COEFFICIENT * (coordinates + 1):
        return None
    _, near = scipy.spatial.cKDTree(states).query(states, k=count + 1)
    near = np.array([[other for other in nearest if other != row][:count] for row, nearest in enumerate(near)])
    moved = np.concatenate((np.ones((rows, count, 1)), states[near] - states[:, None]), axis=2)
    inverse = np.linalg.pinv(moved)  # (rows, d + 1, count); its first row gives the value at the state itself
    expected = np.einsum("nk,nkf->nf", inverse[:, 0], residuals[near])
    uncertainty = 1.0 + np.sum(np.square(inverse[:, 0]), axis=1)
    return np.asarray(np.sqrt(np.mean(np.square(residuals - expected) / uncertainty[:, None], axis=0)))
