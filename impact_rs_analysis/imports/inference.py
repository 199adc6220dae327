"""Which effects the torque balance needs: regression, hold-out by time, and significance that knows about correlation.

With y the rest of the rigid model in units of each joint's own rest, X the columns of the effects in parameter scales:

    y = X beta + eps,        lower <= beta <= upper

There is only one condition, so stretches of time stand in for conditions: what a fit is judged by is its error on
stretches it has not seen, with a guard on either side. Neighbouring samples are not independent; the scores of blocks
of about a second are: p comes from flipping their signs at random (the wild cluster bootstrap of the score), intervals
from the cluster-robust covariance. p is adjusted for the number of questions asked (Benjamini and Hochberg).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear
from scipy.stats import false_discovery_control
from scipy.stats import t as student

from impact_rs_analysis.diagnosis.candidates import PRIOR, tail_probability
from impact_rs_analysis.evidence.torque_balance import Column, TorqueBalance
from impact_rs_sim.errors import InputError
from impact_rs_sim.robot import Array

Integers = NDArray[np.int64]
BLOCKS = 24  # at least, of 0.5 s or more
LONGEST_BLOCK = 2.0  # s
SHORTEST_BLOCK = 0.5  # s
FOLDS = 6
FLIPS = 2000


@dataclass(frozen=True)
class Pieces:
    """How the samples are cut into blocks and folds.

    Attributes:
        block: Block of each sample, ``(k,)``.
        fold: Fold of each block, ``(B,)``.
        guard: Per fold, blocks that are neither trained on nor judged by, because they touch it.
        seconds: Length of a block [s].
    """

    block: Integers
    fold: Integers
    guard: tuple[tuple[int, ...], ...]
    seconds: float

    @property
    def count(self) -> int:
        """Number of blocks."""
        return int(self.fold.size)


def cut(balance: TorqueBalance) -> Pieces:
    """Cut the motions into blocks, and the blocks into folds of neighbours.

    Raises:
        InputError: Too short to hold anything out.
    """
    lengths = [(motion.time[motion.kept].size, motion.rate) for motion in balance.motions]
    total = sum(size / rate for size, rate in lengths)
    seconds = float(np.clip(total / BLOCKS, SHORTEST_BLOCK, LONGEST_BLOCK))
    block, first, recording = [], 0, []
    for number, (size, rate) in enumerate(lengths):
        parts = max(1, round(size / rate / seconds))
        block.append(first + np.minimum(np.arange(size) * parts // size, parts - 1))
        recording += [number] * parts
        first += parts
    if first < 2 * FOLDS:
        raise InputError(
            f"{total:.3g} s of usable motion, at least {2 * FOLDS * SHORTEST_BLOCK:g} s are needed to hold some out"
        )
    fold = np.arange(first, dtype=np.int64) * FOLDS // first
    guard = tuple(
        tuple(
            index
            for index in range(first)
            if fold[index] != number
            and any(
                0 <= near < first and fold[near] == number and recording[near] == recording[index]
                for near in (index - 1, index + 1)
            )
        )
        for number in range(FOLDS)
    )
    return Pieces(np.concatenate(block), fold, guard, seconds)


def _bounded(gram: Array, score: Array, lower: Array, upper: Array) -> Array:
    """Minimise ``b^T gram b / 2 - score^T b`` within bounds: active set, and lsq_linear where that does not settle."""
    side = np.zeros(score.size)  # -1 at the lower bound, +1 at the upper one, 0 free
    for _ in range(20):
        beta = np.where(side < 0, lower, np.where(side > 0, upper, 0.0))
        free = side == 0
        if np.any(free):
            pull = score[free] - gram[np.ix_(free, ~free)] @ beta[~free]
            beta[free] = np.linalg.solve(gram[np.ix_(free, free)], pull)
        slope = score - gram @ beta
        too_low, too_high = free & (beta < lower - 1e-9), free & (beta > upper + 1e-9)
        release = ((side < 0) & (slope > 1e-9)) | ((side > 0) & (slope < -1e-9))
        if not np.any(too_low | too_high | release):
            return np.asarray(beta)
        side[release] = 0.0
        side[too_low], side[too_high] = -1.0, 1.0
    root = np.linalg.cholesky(gram).T
    return np.asarray(lsq_linear(root, np.linalg.solve(root.T, score), bounds=(lower, upper)).x)


class Regression:
    """All columns at once, as normal equations per block and joint; a model is a list of columns.

    Args:
        rest: Recorded minus predicted torque of the model underneath, ``(k, n)`` [N m].
        columns: Everything that may be fitted.
        pieces: Blocks and folds.

    Attributes:
        sigma: Unit of each joint: the root mean square of its rest, ``(n,)`` [N m].
    """

    def __init__(self, rest: Array, columns: list[Column], pieces: Pieces) -> None:
        self.columns, self.pieces, self.rest = columns, pieces, rest
        joints = rest.shape[1]
        self.sigma = np.sqrt(np.mean(np.square(rest), axis=0))
        blocks, count = pieces.count, len(columns)
        self._gram = np.zeros((blocks, joints, count, count))
        self._score = np.zeros((blocks, joints, count))
        self._power = np.zeros((blocks, joints))
        self._samples = np.bincount(pieces.block, minlength=blocks).astype(float)
        for block in range(blocks):
            chosen = pieces.block == block
            for joint in range(joints):
                y = rest[chosen, joint] / self.sigma[joint]
                x = np.column_stack([c.values[chosen, joint] * c.scale for c in columns]) / self.sigma[joint]
                self._gram[block, joint] = x.T @ x
                self._score[block, joint] = x.T @ y
                self._power[block, joint] = y @ y
        scale = np.array([column.scale for column in columns])
        nominal = np.array([column.nominal for column in columns])
        self._lower = (np.array([column.lower for column in columns]) - nominal) / scale
        self._upper = (np.array([column.upper for column in columns]) - nominal) / scale
        self._scale, self._nominal = scale, nominal
        rng = np.random.default_rng(0)
        self._signs = rng.choice([-1.0, 1.0], size=(FLIPS, blocks))
        self._errors: dict[tuple[int, ...], Array] = {}
        self._fits: dict[tuple[int, ...], Array] = {}

    def solve(self, model: tuple[int, ...], blocks: Array | None = None) -> Array:
        """Estimates in parameter scales from the nominal values, within the bounds, ``(p,)``."""
        chosen = list(model)
        if not chosen:
            return np.zeros(0)
        pick = slice(None) if blocks is None else blocks
        gram = self._gram[pick].sum(axis=(0, 1))[np.ix_(chosen, chosen)]
        score = self._score[pick].sum(axis=(0, 1))[chosen]
        gram = gram + np.eye(len(chosen)) / PRIOR**2
        return _bounded(gram, score, self._lower[chosen], self._upper[chosen])

    def held_out(self, model: tuple[int, ...]) -> Array:
        """Mean square error per fold and joint, predicted from the other folds, ``(FOLDS, n)`` [N m squared]."""
        if model not in self._errors:
            errors = []
            chosen = list(model)
            for fold in range(FOLDS):
                inside = self.pieces.fold == fold
                training = ~inside
                training[list(self.pieces.guard[fold])] = False
                beta = self.solve(model, training)
                gram = self._gram[inside].sum(axis=0)[:, chosen][:, :, chosen]
                score = self._score[inside].sum(axis=0)[:, chosen]
                power = self._power[inside].sum(axis=0)
                squares = power - 2.0 * score @ beta + np.einsum("p,jpq,q->j", beta, gram, beta)
                errors.append(np.maximum(squares, 0.0) / self._samples[inside].sum() * np.square(self.sigma))
            self._errors[model] = np.array(errors)
        return self._errors[model]

    def _fit(self, model: tuple[int, ...]) -> Array:
        """:meth:`solve` on everything, remembered."""
        if model not in self._fits:
            self._fits[model] = self.solve(model)
        return self._fits[model]

    def estimate(self, model: tuple[int, ...]) -> Array:
        """Estimates in their own units, ``(p,)``."""
        chosen = list(model)
        return np.asarray(self._nominal[chosen] + self._fit(model) * self._scale[chosen])

    def residual(self, model: tuple[int, ...]) -> Array:
        """What a model leaves, ``(k, n)`` [N m]."""
        left = self.rest.copy()
        for value, index in zip(self._fit(model), model, strict=True):
            left -= value * self._scale[index] * self.columns[index].values
        return left

    def _block_scores(self, model: tuple[int, ...], beta: Array, wanted: list[int]) -> Array:
        """Scores of columns per block at the fit of a model, ``(B, w)``."""
        score = self._score.sum(axis=1)[:, wanted]
        gram = self._gram.sum(axis=1)[:, wanted][:, :, list(model)]
        return np.asarray(score - gram @ beta)

    def half_width(self, model: tuple[int, ...]) -> Array:
        """Half width of the 95 % intervals, cluster-robust, in units of the parameters, ``(p,)``."""
        chosen = list(model)
        beta = self._fit(model)
        gram = self._gram.sum(axis=(0, 1))[np.ix_(chosen, chosen)] + np.eye(len(chosen)) / PRIOR**2
        inverse = np.linalg.inv(gram)
        scores = self._block_scores(model, beta, chosen)
        blocks = self.pieces.count
        covariance = inverse @ (scores.T @ scores) @ inverse * blocks / (blocks - 1)
        width = student.ppf(0.975, blocks - 1) * np.sqrt(np.maximum(np.diag(covariance), 0.0))
        return np.asarray(width * self._scale[chosen])

    def p_value(self, model: tuple[int, ...], added: tuple[int, ...]) -> float:
        """p of columns adding nothing to a model (score test, signs of blocks flipped)."""
        full = model + added
        beta = self._fit(full)[len(model) :]
        if np.all(np.abs(beta) < 1e-9):
            return 1.0  # a bound forbids it, a negative friction for example
        base = self._fit(model)
        wanted = list(added)
        free = [
            index
            for index, value in zip(model, base, strict=True)
            if self._lower[index] + 1e-9 < value < self._upper[index] - 1e-9
        ]
        scores = self._block_scores(model, base, wanted)
        total = self._gram.sum(axis=(0, 1))
        information = total[np.ix_(wanted, wanted)] + np.eye(len(wanted)) / PRIOR**2
        if free:
            projection = np.linalg.solve(
                total[np.ix_(free, free)] + np.eye(len(free)) / PRIOR**2, total[np.ix_(free, wanted)]
            )
            scores = scores - self._block_scores(model, base, free) @ projection
            information = information - total[np.ix_(wanted, free)] @ projection
        try:
            weight = np.linalg.inv(information)
        except np.linalg.LinAlgError:
            return 1.0
        observed = scores.sum(axis=0)
        null = self._signs @ scores
        return tail_probability(
            float(observed @ weight @ observed), np.asarray(np.einsum("fp,pq,fq->f", null, weight, null))
        )


def adjusted(p_values: dict[str, float]) -> dict[str, float]:
    """Benjamini and Hochberg's adjustment."""
    if not p_values:
        return {}
    return dict(zip(p_values, false_discovery_control(list(p_values.values())).tolist(), strict=True))
