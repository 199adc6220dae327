# SPDX-License-Identifier: Apache-2.0
"""Belief about parameters and model discrepancy: linear and Gaussian.

The residual r of an observation, whitened by its noise (:mod:`.noise`), is linear in the state x,

    r = H x + noise,        cov(noise) = 1,        H = [J of some parameters | patterns P of the discrepancy]

x holds changes of parameters from the point of the linearisation, in parameter scales, and the amplitudes of the
discrepancy, standard normal before the first observation and common to all observations of a group. A constant misfit
of a group is thus attributed to the discrepancy and not to a parameter. With information matrix and vector (Kalman
filter in information form; Anderson and Moore 1979, *Optimal Filtering*, sec. 6.3)

    L = L_0 + sum w H^T H,        h = h_0 + sum w H^T r,        x ~ N(L^-1 h, L^-1)

with the weight w of an observation. To hold an observation out is to subtract it. With columns y marginalised, the
other columns x keep the information (Schur complement)

    L_xx - L_xy L_yy^-1 L_yx,        h_x - L_xy L_yy^-1 h_y
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import NDArray

from impact_rs_analysis.evidence.cluster import INDEPENDENT_DISCREPANCY_SHARE, Cluster
from impact_rs_analysis.inference.noise import noise_of
from impact_rs_sim.robots.robot import Array

Columns = NDArray[np.int_]


@dataclass(frozen=True, eq=False)
class Observation:
    """Whitened observation of one condition, stretch or hit.

    Attributes:
        residual: Measured minus predicted at the point of the linearisation, ``(F,)`` [-].
        jacobian: Sensitivity to every parameter, per scale, ``(F, p)`` [-].
        patterns: Discrepancy at amplitude 1, ``(F, k)`` [-].
        group: Observations of one group share the amplitudes.
        weight: w [-].
    """

    residual: Array
    jacobian: Array
    patterns: Array
    group: str
    weight: float = 1.0

    @cached_property
    def normal(self) -> Array:
        """w [J P r]^T [J P r], ``(p + k + 1, p + k + 1)``."""
        rows = np.hstack((self.jacobian, self.patterns, self.residual[:, None]))
        return np.asarray(self.weight * rows.T @ rows)


@dataclass
class Belief:
    """Gaussian belief about the state x.

    Attributes:
        parameters: Parameters in the state, by column of the sensitivities.
        information: L, ``(n, n)``; parameters first, then amplitudes.
        vector: h, ``(n,)``.
        groups: Columns of the amplitudes of each group.
    """

    parameters: tuple[int, ...]
    information: Array
    vector: Array
    groups: dict[str, slice] = field(default_factory=dict)
    _solved: tuple[Array, Array] | None = field(default=None, repr=False)
    _columns: dict[tuple[str, int], tuple[Columns, Columns]] = field(default_factory=dict, repr=False)

    @classmethod
    def of(cls, parameters: Sequence[int], deviations: Array) -> Belief:
        """The prior belief.

        Args:
            parameters: Parameters in the state.
            deviations: Prior standard deviation of each, in scales; infinite: unknown, ``(f,)``.
        """
        return cls(tuple(parameters), np.diag(1.0 / np.square(deviations)), np.zeros(len(parameters)))

    def copy(self) -> Belief:
        """A mutable copy."""
        information, vector = self.information.copy(), self.vector.copy()
        return Belief(self.parameters, information, vector, dict(self.groups), _columns=self._columns.copy())

    @property
    def factor(self) -> Array:
        """Lower Cholesky factor of L, ``(n, n)``."""
        return self._now()[0]

    @property
    def mean(self) -> Array:
        """Mean of the state, ``(n,)``."""
        return self._now()[1]

    def _now(self) -> tuple[Array, Array]:
        if self._solved is None:
            factor = np.asarray(np.linalg.cholesky(self.information))
            self._solved = factor, _solve(factor, self.vector)
        return self._solved

    def solve(self, columns: Array) -> Array:
        """L^-1 of some columns, ``(n, m)``."""
        return _solve(self.factor, columns)

    @property
    def covariance(self) -> Array:
        """Covariance of the parameters, in scales, ``(f, f)``."""
        count = len(self.parameters)
        return self.solve(np.eye(len(self.vector), count))[:count]

    def add(self, observation: Observation, sign: float = 1.0) -> None:
        """Condition on an observation; with ``sign`` -1, remove one."""
        columns, rows = self.columns(observation)
        self.information[columns[:, None], columns] += sign * observation.normal[rows[:, None], rows]
        self.vector[columns] += sign * observation.normal[rows, -1]
        self._solved = None

    def columns(self, observation: Observation) -> tuple[Columns, Columns]:
        """Columns of the state that an observation depends on, and their indices in its ``normal``, ``(m,)`` each."""
        key = observation.group, observation.jacobian.shape[1]
        if (columns := self._columns.get(key)) is None:
            size, count = len(self.vector), observation.patterns.shape[1]
            if observation.group not in self.groups:
                grown = np.eye(size + count)
                grown[:size, :size] = self.information
                self.information, self.vector = grown, np.concatenate((self.vector, np.zeros(count)))
                self.groups[observation.group] = slice(size, size + count)
                self._solved = None
            amplitudes = self.groups[observation.group]
            columns = self._columns[key] = (
                np.array([*range(len(self.parameters)), *range(amplitudes.start, amplitudes.stop)], dtype=int),
                np.array([*self.parameters, *range(key[1], key[1] + count)], dtype=int),
            )
        return columns

    def predictive(self, observation: Observation) -> tuple[Array, Array]:
        """Innovation (residual minus its mean prediction), ``(F,)``, and its covariance, ``(F, F)`` [-]."""
        columns, observed = self.observed(observation)
        whole_observed = np.zeros((len(self.vector), len(observation.residual)))
        whole_observed[columns] = observed.T
        covariance = np.eye(len(observation.residual)) + observed @ self.solve(whole_observed)[columns]
        if observation.group not in self.groups:
            covariance += observation.patterns @ observation.patterns.T
        return observation.residual - observed @ self.mean[columns], covariance

    def residual_of(self, observation: Observation) -> Array:
        """Residual after subtraction of the mean prediction, ``(F,)`` [-]."""
        columns, observed = self.observed(observation)
        return np.asarray(observation.residual - observed @ self.mean[columns])

    def observed(self, observation: Observation) -> tuple[Columns, Array]:
        """Columns of the state that an observation depends on, ``(m,)``, and H at them, ``(F, m)``."""
        followed = observation.jacobian[:, list(self.parameters)]
        if observation.group not in self.groups:  # its amplitudes are not in the state yet
            return np.arange(len(self.parameters)), followed
        return self.columns(observation)[0], np.hstack((followed, observation.patterns))

    def of_parameters(self) -> tuple[Array, Array]:
        """Information ``(f, f)`` and score ``(f,)`` of the parameters, with the amplitudes marginalised."""
        count = len(self.parameters)
        marginal = fitted_out(self._joint, range(count, len(self.vector)))
        return marginal[:count, :count], marginal[:count, -1]

    @property
    def _joint(self) -> Array:
        """L with h as a further row and column, ``(n + 1, n + 1)``."""
        return np.block([[self.information, self.vector[:, None]], [self.vector, np.zeros(1)]])

    def with_parameters(self, parameters: Sequence[int], fresh: Sequence[int], centre: Array, width: float) -> Belief:
        """The belief about a state with other parameters.

        Args:
            parameters: All parameters of the new state, including the present ones.
            fresh: Parameters whose prior is reset.
            centre: Prior mean of the fresh parameters, in scales, ``(fresh,)``.
            width: Prior standard deviation of the fresh parameters, in scales.
        """
        old, new, size = len(self.parameters), len(parameters), len(self.vector)
        removed = [n for n, parameter in enumerate(self.parameters) if parameter in fresh]
        stay = [n for n in range(size) if n not in removed]
        joint = fitted_out(self._joint, removed)
        order = list(parameters)
        columns = [order.index(self.parameters[n]) if n < old else n + new - old for n in stay]
        information = np.diag(np.full(size + new - old, 1.0 / width**2))
        vector = np.zeros(size + new - old)
        information[np.ix_(columns, columns)], vector[columns] = joint[np.ix_(stay, stay)], joint[stay, size]
        vector[[order.index(number) for number in fresh]] = centre / width**2
        groups = {name: slice(g.start + new - old, g.stop + new - old) for name, g in self.groups.items()}
        return Belief(tuple(parameters), information, vector, groups)

    def drift(self, group: str, share: float) -> None:
        """Random drift of the amplitudes of a group: a' = sqrt(1 - q) a + sqrt(q) v with v standard normal.

        A first-order Gauss-Markov process, whose variance stays 1 (Anderson and Moore 1979, sec. 2.3).

        Args:
            group: The group.
            share: q, share of the variance that is renewed [-].
        """
        amplitudes, memory = self.groups[group], math.sqrt(1.0 - share)
        unit = np.eye(amplitudes.stop - amplitudes.start)
        coupling, past = self.information[:, amplitudes].copy(), self.vector[amplitudes].copy()
        coupling[amplitudes] = -memory / share * unit  # with the new amplitudes a'
        eliminated = np.linalg.solve(self.information[amplitudes, amplitudes] + memory**2 / share * unit, coupling.T)
        self.information[amplitudes], self.information[:, amplitudes], self.vector[amplitudes] = 0.0, 0.0, 0.0
        self.information[amplitudes, amplitudes] = unit / share
        self.information -= coupling @ eliminated
        self.vector -= eliminated.T @ past
        self._solved = None


def fitted_out(information: Array, columns: Columns | Sequence[int], width: float = math.inf) -> Array:
    """Schur complement: information of all columns with some marginalised, ``(n, n)``; undefined in these columns.

    Args:
        information: L, ``(n, n)``.
        columns: Columns to marginalise.
        width: Standard deviation of an additional normal prior of each; infinite: no prior.
    """
    chosen = np.array(columns, dtype=int)
    if not chosen.size:
        return information
    across = information[chosen]
    fitted = across[:, chosen] + np.eye(chosen.size) / width**2
    remaining = information - across.T @ np.linalg.solve(fitted, across)
    return np.asarray(0.5 * (remaining + remaining.T))


def observation_of(item: Cluster, residual: Array, jacobian: Array, count: int) -> Observation:
    """Observation of a cluster: the mean of the repeats of a condition, or a stretch or block.

    Args:
        item: The cluster, with scatter, discrepancy and scale.
        residual: Scaled residual, ``(F,)`` [-].
        jacobian: Change of the scaled features by one scale of each parameter, ``(F, p)`` [-].
        count: Number of repeats.
    """
    whiten = noise_of(item).whitening(count)
    patterns = (
        np.zeros((0, len(residual)))
        if item.patterns is None
        else np.sqrt(1.0 - INDEPENDENT_DISCREPANCY_SHARE) * item.patterns
    )
    return Observation(whiten @ residual, whiten @ jacobian, whiten @ patterns.T, item.discrepancy_group)


def _solve(factor: Array, right: Array) -> Array:
    """L^-1 of columns by its Cholesky factor."""
    if not right.shape[0]:
        return right
    return np.asarray(scipy.linalg.cho_solve((factor, True), right, check_finite=False))
