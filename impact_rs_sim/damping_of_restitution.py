# SPDX-License-Identifier: Apache-2.0
"""Coefficient of restitution of a compliant contact, and its inverse: damping from restitution.

Spring and damper ``m x'' = -k x - c x'``, which part when the force is 0 (Schwager and Pöschel 2007), with
``zeta = c / (2 sqrt(k m))`` and ``s = sqrt(|1 - zeta^2|)``:

    e = exp(-(zeta / s) atan2(2 zeta s, 2 zeta^2 - 1))                zeta < 1
    e = exp(-2)                                                       zeta = 1
    e = exp(-(zeta / s) ln((zeta + s) / (zeta - s)))                  zeta > 1

Spring and damper of Hunt and Crossley (1975), ``m x'' = -k x (1 + d x')``: the integral of ``v dv / (1 + d v)`` from v
to -e v vanishes, so that

    d v (1 + e) = ln((1 + d v) / (1 - d v e)),        d v = 3 (1 - e) / (2 e)    near e = 1, to third order
"""

from __future__ import annotations

import math

import scipy

NEARLY_ELASTIC = 1.0 - 1e-4  # restitution from which the series of d v is exact to 1e-8 [-]
MIN_RESTITUTION = 1e-3  # smallest restitution with its exact damping; 0 would need an infinite damping


def restitution_of(damping_ratio: float) -> float:
    """Coefficient of restitution of spring and damper with the damping ratio zeta >= 0 [-]."""
    zeta = damping_ratio
    if zeta == 0.0:
        return 1.0
    if abs(zeta - 1.0) < 1e-9:
        return math.exp(-2.0)
    root = math.sqrt(abs(1.0 - zeta * zeta))
    if zeta < 1.0:
        return math.exp(-zeta / root * math.atan2(2.0 * zeta * root, 2.0 * zeta * zeta - 1.0))
    return math.exp(-zeta / root * 2.0 * math.log(zeta + root))


def damping_ratio_of(restitution: float) -> float:
    """Damping ratio zeta of spring and damper with the coefficient of restitution ``restitution`` in [0, 1] [-].

    A smaller restitution is replaced by :data:`MIN_RESTITUTION`.
    """
    if restitution >= 1.0:
        return 0.0
    e = max(restitution, MIN_RESTITUTION)
    return float(scipy.optimize.brentq(lambda zeta: restitution_of(zeta) - e, 1e-9, 1e3, xtol=1e-12))


def dissipation_of(restitution: float, speed: float) -> float:
    """Hunt-Crossley dissipation d with ``restitution`` in [0, 1] at a closing ``speed`` > 0 [m/s]; d is in s/m.

    A smaller restitution is replaced by :data:`MIN_RESTITUTION`.
    """
    if restitution >= NEARLY_ELASTIC:
        return 1.5 * max(1.0 / restitution - 1.0, 0.0) / speed
    e = max(restitution, MIN_RESTITUTION)

    def imbalance(product: float) -> float:
        return product * (1.0 + e) - math.log1p(product) + math.log1p(-product * e)

    # Beyond its trivial root 0 the imbalance is positive, and it falls to -inf at 1 / e.
    low, high = 1.0 - e, (1.0 - 1e-12) / e
    if imbalance(high) > 0.0:
        return high / speed
    return float(scipy.optimize.brentq(imbalance, low, high, xtol=1e-13)) / speed
