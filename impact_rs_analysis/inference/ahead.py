# SPDX-License-Identifier: Apache-2.0
"""Probability that further trials decide between two explanations, before they are measured.

Along the difference of two explanations, a squared distance g apart in units of the noise, a measurement is
z ~ N(+-sqrt(g)/2, 1). The noise is estimated from nu degrees of freedom, so that with X ~ chi^2_nu the log likelihood
ratio that a diagnosis will find is (:mod:`.student`)

    l = (nu + 1) / 2 [log(1 + (z + a)^2 / X) - log(1 + (z - a)^2 / X)],        a = sqrt(g) / 2

A diagnosis distinguishes them where |l| > log R, with R = ``DECISIVE_LIKELIHOOD_RATIO``. With c = R^(2 / (nu + 1)) and
k = (c + 1) / (c - 1) this is (z -+ k a)^2 + X < (k^2 - 1) a^2, a noncentral chi square with nu + 1 degrees of freedom:
the probability is

    p = F(b; nu + 1, (k - 1)^2 a^2) + F(b; nu + 1, (k + 1)^2 a^2),        b = (k^2 - 1) a^2

whose second term is the probability of deciding for the wrong explanation. If the noise is known, l ~ N(+-g/2, g).
"""

from __future__ import annotations

import numpy as np
import scipy

from impact_rs_analysis.inference.belief import Columns, fitted_out
from impact_rs_analysis.inference.student import DECISIVE_LIKELIHOOD_RATIO
from impact_rs_sim.robots.robot import Array

MAX_SQUARED_DISTANCE = 1e6  # [-]; beyond, every pair is decided


def distance(information: Array, first: int, second: int, uncertain: Columns) -> float:
    """Squared Mahalanobis distance g of two predictions, with their common uncertainty projected out [-].

    Args:
        information: Information matrix of all columns, ``(n, n)``.
        first: Column of the first prediction.
        second: Column of the second prediction.
        uncertain: Columns of the uncertain parameters, each in standard deviations.
    """
    contrast = np.zeros(len(information))
    contrast[[first, second]] = 1.0, -1.0
    return float(contrast @ fitted_out(information, uncertain, 1.0) @ contrast)


def probability(gain: Array, freedom: float = np.inf) -> Array:
    """Probability p that the next diagnosis distinguishes two explanations [-].

    Args:
        gain: Their squared distance g [-].
        freedom: nu, degrees of freedom of the scatter; infinite: it is known; 0: no pair is decided.
    """
    half = np.sqrt(np.clip(gain, 0.0, MAX_SQUARED_DISTANCE)) / 2.0
    if freedom <= 0.0:
        return np.zeros_like(half)
    if np.isinf(freedom):
        behind = np.log(DECISIVE_LIKELIHOOD_RATIO) / (2.0 * np.maximum(half, 1e-9))
        return np.asarray(scipy.special.ndtr(half - behind) + scipy.special.ndtr(-half - behind))
    ratio = DECISIVE_LIKELIHOOD_RATIO ** (2.0 / (freedom + 1.0))
    k = (ratio + 1.0) / (ratio - 1.0)
    ends = [scipy.special.chndtr((k**2 - 1.0) * half**2, freedom + 1.0, np.square((k + s) * half)) for s in (-1, 1)]
    return np.asarray(ends[0] + ends[1])


def promised(now: float, freedom: float, times: float, further: float) -> float:
    """Probability p after further trials, which multiply the squared distance [-].

    Args:
        now: Present p.
        freedom: Present nu.
        times: Factor of the squared distance.
        further: Additional degrees of freedom.
    """
    if not 0.0 < now < float(probability(np.array(MAX_SQUARED_DISTANCE), freedom)):
        return now
    gain = scipy.optimize.brentq(lambda g: float(probability(np.array(g), freedom)) - now, 0.0, MAX_SQUARED_DISTANCE)
    return float(probability(np.array(times * gain), freedom + further))
