# SPDX-License-Identifier: Apache-2.0
"""A world with a closed form: features are known functions of parameters, noise is normal with a known covariance."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache

import numpy as np
from scipy.stats import binom

from impact_rs_analysis.diagnosis.search.candidate import Candidate, linearise
from impact_rs_analysis.diagnosis.search.fit import Evidence
from impact_rs_analysis.evidence.cluster import Added, Cluster, Feature
from impact_rs_analysis.evidence.source import Covariate, Source
from impact_rs_sim.effects import ArmEffect, Effect, Parameter
from impact_rs_sim.effects.depending import Depending
from impact_rs_sim.model import Model
from impact_rs_sim.physics import Physics
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.scenarios.scenario_files import load_scenario

FEATURES = 40
FLOOR = 0.3  # relevance limit, in multiples of the noise
PHYSICS = Physics.nominal(load_scenario("push"), "juice")  # for the number of joints alone


def parameter(
    name: str, nominal: float = 0.0, shape: bool = False, lower: float = -50.0, grid: tuple[float, ...] = ()
) -> Parameter:
    return Parameter(name, "-", nominal, lower, 50.0, 1.0, name, shape=shape, grid=grid)


def effect(name: str, parameters: tuple[Parameter, ...], phases: tuple[str, ...] = ("free", "contact")) -> Effect:
    return ArmEffect(name, "contact", "An effect of the test.", parameters, lambda arm, _: arm, phases)


EFFECTS = {
    item.name: item
    for item in (
        effect("straight", (parameter("a"),)),
        effect("bent", (parameter("b"),), ("contact",)),
        effect("twin_of_straight", (parameter("c"), parameter("c_2"))),
        effect("payload", (parameter("mass"), parameter("lever", 0.5, shape=True))),
        effect("of_joints", tuple(parameter(f"joint{number}") for number in range(7))),
        effect("of_motors", tuple(parameter(f"motor{number}") for number in range(7))),
        effect("one_sided", (parameter("d", lower=0.0),)),
        effect("inverse", (Parameter("s", "-", 1.0, 0.2, 5.0, 0.1, "s"),)),
        effect("fading", (parameter("e"), parameter("rate", 1.0, True, 0.01, (0.1, 1.0, 10.0)))),
        effect("constant", (parameter("k"),)),
        effect("sticking", (parameter("h"),)),
        effect("local", (parameter("everywhere"), parameter("in_one_place"))),
        effect(
            "sizes_and_rate", (*(parameter(f"size{n}") for n in range(4)), parameter("common_rate", 1.0, True, 0.01))
        ),
        effect("rippled", (parameter("r"),)),
        effect("stick_slip", tuple(parameter(f"breakaway{n}") for n in range(3))),
        effect("saturated", (parameter("u", lower=0.0),)),
        effect("turning", (parameter("v"),)),
        effect("circling", (parameter("angle"),)),
        effect("slight", (parameter("w"),), ("contact",)),
        effect("nearly_bent", (parameter("x"),), ("contact",)),
        effect("levelling", (parameter("z"),)),
        effect("nearly_levelling", (parameter("q"),)),
        effect("askew", (parameter("p"),)),
        effect("straight_and_askew", (parameter("o"),)),
        effect("more_than_straight", tuple(parameter(f"y{n}") for n in range(6))),
        effect("dry", (parameter("f", lower=0.0), parameter("fade", 1.0, True, 0.01, (0.1, 1.0, 10.0)))),
    )
}

TIPPING = effect(
    "tipping", (parameter("g"), Parameter("height", "-", 0.0, -50.0, 50.0, 1.0, "height", far=(-8.0, 8.0)))
)
MISPLACING = effect("misplacing", (parameter("offset"),))


@cache
def direction(cluster: int, number: int) -> Array:
    return np.random.default_rng([10_000 + number, cluster]).standard_normal(FEATURES)


def features(cluster: int, added: Added) -> Array:
    def along(number: int) -> Array:
        return direction(cluster, number)

    result, along_track = np.zeros(FEATURES), np.linspace(0.0, 3.0, FEATURES)
    for name, values in added:
        first, second = (*values, 0.0)[:2]
        if name == "straight":
            result += first * along(0)
        elif name == "twin_of_straight":
            result += 0.5 * first * along(0) + second * along(6)
        elif name == "askew":
            result += first * along(6)
        elif name == "straight_and_askew":  # as a payload, which acts as offsets of two joints do
            result += first * (along(0) + along(6))
        elif name == "bent":
            result += 20.0 * np.tanh(first / 6.0) * along(1) + 0.05 * first**2 * along(2)
        elif name == "more_than_straight":
            result += first * along(0) + sum(value * along(120 + n) for n, value in enumerate(values[1:]))
        elif name == "nearly_bent":  # as creep and shear of a pad, which differ where a contact lasts
            result += 20.0 * np.tanh(first / 6.0) * along(1) + 0.05 * first**2 * along(2)
            result += 0.7 * np.clip(first - 2.0, 0.0, 1.0) * along(94) if cluster == 0 else 0.0
        elif name == "payload":
            result += first * along(3) + first * second * along(4)
        elif name == "of_joints":
            result += sum(value * along(10 + joint) for joint, value in enumerate(values))
        elif name == "of_motors":
            result += sum(value * along(20 + joint) for joint, value in enumerate(values))
        elif name == "constant":  # what fading is where it does not
            result += first * (1.0 + 0.1 * cluster)
        elif name == "fading":
            result += first * np.exp(-second * along_track) * (1.0 + 0.1 * cluster)
        elif name == "one_sided":
            result += first * along(7)
        elif name == "inverse":  # as deflection goes with stiffness
            result += 100.0 * (1.0 / first - 1.0) * along(8)
        elif name == "tipping":  # as a box that stands flat does, until its weight is too high or too low
            result += first * along(30) + 0.01 * second * along(33)
            result += max(second - 4.0, 0.0) * along(31) + max(-second - 4.0, 0.0) * along(32)
        elif name == "sticking":
            result += np.sign(first) * max(abs(first) - 6.0, 0.0) * along(34)
        elif name == "local":
            result += first * along(40) + (second * along(41) if cluster == 0 else 0.0)
        elif name == "sizes_and_rate":  # as friction of the joints that fades at a common speed
            faded = np.exp(-values[-1] * along_track)
            result += sum(value * faded * along(70 + joint) for joint, value in enumerate(values[:-1]))
        elif name == "rippled":  # as an object that touches once more or once less
            result += (first + 0.2 * np.sin(12.0 * first)) * along(80)
        elif name == "stick_slip":  # as joints that slip once more or once less: small minima beside the valley
            for joint, value in enumerate(values):
                result += value * along(100 + joint) + 0.5 * np.sin(12.0 * value) * along(110 + joint)
        elif name == "saturated":  # as a damping that takes most of the velocity
            result += 30.0 * (1.0 - np.exp(-first / 12.0)) * along(90)
        elif name == "turning":  # as restitution, which first shows where a contact opens
            result += 0.5 * first * np.exp(-(first**2) / 4.0) * along(91) + 1e-3 * first**2 * along(92)
        elif name == "circling":  # as a pad that an offset moves into the object and out again
            first_half = np.arange(FEATURES) < FEATURES // 2
            result += np.where(first_half, np.sin(first), 1.0 - np.cos(first)) * along(96)
        elif name == "levelling":  # as a pad off its place, which in one condition soon moves nothing further
            result += (5.0 * np.tanh(first) if cluster == 0 else first) * along(97)
        elif name == "nearly_levelling":
            result += 0.5 * first * along(97) + 0.8 * first * along(98)
        elif name == "slight":  # as a moment that resists tipping, of a box that soon does not tip any more
            result += 0.04 * np.tanh(first / 0.5) * along(93)
        elif name == "misplacing":  # as the offset of an encoder, by which a pad begins inside the object
            free = np.arange(FEATURES) < FEATURES // 2
            result += np.where(free, 0.5 * first, 30.0 * np.sin(first / 4.0)) * along(95)
        elif name == "outside":
            result += first * along(5)
    for _, values in (one for one in added if one[0] == "dry"):  # takes its part of whatever drives, and no more
        driving, held = result + 3.0 * along(50), values[0] * np.exp(-values[1] * along_track)
        result += np.clip(-driving, -held, held)
    return result


class AnalyticSource(Source):
    """Clusters of the world.

    Args:
        seed: Of the noise.
        truth: What is hidden.
        design: Repeats of every cluster.
        free: Clusters in which nothing is hit.
        correlation: Root of the noise's covariance, ``(F, F)``; None: independent features.
        discrepancy: Standard deviation of what the simulator itself is off by, known to the source [-].
        simulator: Seed of what it is off by; None: it is right.
        repeated: Whether rows are repeats; if not, every cluster is one stretch of a recording.
    """

    def __init__(
        self,
        seed: int,
        truth: Added = (),
        design: Sequence[int] = (3,) * 6,
        free: Sequence[int] = (),
        correlation: Array | None = None,
        discrepancy: float = 0.0,
        simulator: int | None = None,
        repeated: bool = True,
    ) -> None:
        self.model, self.physics, self.repeated = Model(name="nothing"), PHYSICS, repeated
        self.asked: list[tuple[int, Added]] = []
        self._truth = truth
        noises = []
        for number, count in enumerate(design):
            noise = np.random.default_rng([seed, number]).standard_normal((count, FEATURES))
            noises.append(noise if correlation is None else noise @ correlation)
        own = np.zeros(FEATURES)
        if simulator is not None:
            own = discrepancy * np.random.default_rng(simulator).standard_normal(FEATURES)
        self._measured = [features(n, truth) + own + noise for n, noise in enumerate(noises)]
        spread = np.ones(FEATURES) if correlation is None else np.sqrt(np.sum(np.square(correlation), axis=0))
        sigma = np.sqrt(spread**2 + (FLOOR / 2.0) ** 2 + discrepancy**2)
        labels = tuple(Feature("impact", f"signal {f % 4}", "x", f // 4, "m/s", FLOOR) for f in range(FEATURES))
        self.clusters = tuple(
            Cluster(
                name=str(number),
                condition_key=("world", "object", str(number)),
                layout="free" if number in free else "hit",
                unit=str(number) if repeated else "recording",
                contact=number not in free,
                features=labels,
                residuals=rows / sigma,
                sigma=sigma,
                pure_error=spread / sigma,
                discrepancy=np.full(FEATURES, discrepancy) / sigma,
            )
            for number, rows in enumerate(self._measured)
        )

    def spoil(self, number: int, change: Array) -> None:
        """Add ``change``, ``(F,)``, to what was measured in a cluster [scaled]."""
        item = self.clusters[number]
        self._measured[number] = self._measured[number] + change * item.sigma
        spoiled = replace(item, residuals=item.residuals + change)
        self.clusters = (*self.clusters[:number], spoiled, *self.clusters[number + 1 :])

    @property
    def free_motion_part(self) -> Source:
        part = copy.copy(self)
        masks = [[not item.contact or f.phase == "free" for f in item.features] for item in self.clusters]
        part.clusters = tuple(item.only(mask, contact=False) for item, mask in zip(self.clusters, masks, strict=True))

        def predict(wanted: Sequence[tuple[int, Added]], what: str) -> list[Array | None]:
            found = self.predict(wanted, what)
            return [
                None if values is None else values[masks[number]]
                for (number, _), values in zip(wanted, found, strict=True)
            ]

        part.predict = predict  # type: ignore[method-assign]
        return part

    def predict(self, wanted: Sequence[tuple[int, Added]], what: str) -> list[Array | None]:
        self.asked.extend(wanted)
        return [features(number, added) for number, added in wanted]

    def residuals_with(self, added: Added, like: Sequence[Cluster]) -> list[Cluster] | None:
        return [
            replace(item, residuals=(self._measured[int(item.name)] - features(int(item.name), added)) / item.sigma)
            for item in like
        ]


class Slipping(AnalyticSource):
    """Clusters in which ``straight`` throws every repeat to another side, and none on the mean; arguments as above."""

    SIDES = (0.6, -0.3, -0.3)

    def __init__(self, seed: int, truth: Added) -> None:
        super().__init__(seed, truth)
        self._measured = [rows + self._slipped(number, truth) for number, rows in enumerate(self._measured)]
        self.clusters = tuple(
            replace(item, residuals=rows / item.sigma) for item, rows in zip(self.clusters, self._measured, strict=True)
        )

    def _slipped(self, cluster: int, added: Added) -> Array:
        """Of every repeat, ``(3, F)``."""
        size = sum(values[0] for name, values in added if name == "straight")
        return size * np.outer(self.SIDES, direction(cluster, 60))

    def predict(self, wanted: Sequence[tuple[int, Added]], what: str) -> list[Array | None]:
        pairs = zip(wanted, super().predict(wanted, what), strict=True)
        return [values + self._slipped(number, added)[0] for (number, added), values in pairs if values is not None]

    def residuals_with(self, added: Added, like: Sequence[Cluster]) -> list[Cluster] | None:
        again = super().residuals_with(added, like) or []
        return [
            replace(item, residuals=item.residuals - self._slipped(int(item.name), added) / item.sigma)
            for item in again
        ]


class BeforeTheHit(AnalyticSource):
    """Clusters whose first half of features was measured before anything is hit; arguments as for the world."""

    def __init__(self, seed: int, truth: Added = ()) -> None:
        super().__init__(seed, truth)
        labels = tuple(
            replace(feature, phase="free") if before else feature
            for feature, before in zip(self.clusters[0].features, self.before, strict=True)
        )
        self.clusters = tuple(replace(item, features=labels) for item in self.clusters)

    @property
    def before(self) -> list[bool]:
        """Which of the features these are."""
        return [number < FEATURES // 2 for number in range(FEATURES)]


class InSessions(AnalyticSource):
    """Single rows in sessions A, B in turn, each at a temperature, on which the size of ``straight`` may depend.

    Args:
        seed: Of the noise.
        size: Of ``straight`` in a session and at a temperature.
        outside: Size of what no effect explains.
        count: Of the rows.
        warmth: Temperature by row [degC].
        sessions: Session by row; None: A and B in turn.
    """

    of_motion, interleaved = False, True

    def __init__(
        self,
        seed: int,
        size: Callable[[str | float, float], float],
        outside: float = 0.0,
        count: int = 24,
        warmth: Sequence[float] = (),
        sessions: Sequence[str | float] | None = None,
    ) -> None:
        super().__init__(seed, (("outside", (outside,)),), (1,) * count, repeated=False)
        self._sessions: Sequence[str | float] = sessions or ["AB"[number % 2] for number in range(count)]
        self._warmth = [float(value) for value in warmth]
        self._pairs: dict[str, Depending] = {}
        self.physics = replace(PHYSICS, circumstances={"session": self._sessions[0], "warmth": 0.0})
        for number, (session, warm) in enumerate(zip(self._sessions, self._warmth or [0.0] * count, strict=True)):
            self.spoil(number, size(session, warm) * direction(number, 0) / self.clusters[number].sigma)

    @property
    def covariates(self) -> tuple[Covariate, ...]:
        found = [Covariate("session", "", tuple((level,) for level in self._sessions))]
        return (*found, *([Covariate("warmth", "degC", tuple((n,) for n in self._warmth))] if self._warmth else []))

    def with_dependences(self, effects: Sequence[Depending]) -> InSessions:
        found = copy.copy(self)
        found._pairs = self._pairs | {pair.name: pair for pair in effects}
        return found

    @property
    def known_effects(self) -> dict[str, Effect]:
        return self.model.known_effects | self._pairs

    def _there(self, number: int, added: Added) -> Added:
        """Effects as they are under the circumstances of a row."""
        found = []
        for name, values in added:
            if (pair := self._pairs.get(name)) is not None:
                own = next(item for item in self.covariates if item.name == pair.covariate).values[number][0]
                weights = pair.terms.weights(own)
                name, values = pair.effect.name, tuple(weights @ np.reshape(values, (weights.size, -1)))
            found.append((name, values))
        return tuple(found)

    def predict(self, wanted: Sequence[tuple[int, Added]], what: str) -> list[Array | None]:
        return super().predict([(number, self._there(number, added)) for number, added in wanted], what)

    def residuals_with(self, added: Added, like: Sequence[Cluster]) -> list[Cluster] | None:
        found = (super(InSessions, self).residuals_with(self._there(int(one.name), added), [one]) for one in like)
        return [item for items in found for item in items or ()]


def knowing(source: AnalyticSource, *effects: Effect) -> AnalyticSource:
    """The source with a model that knows these effects alone."""

    class Knowing(Model):
        @property
        def known_effects(self):  # noqa: ANN202
            return {item.name: item for item in effects}

    source.model = Knowing(name="nothing")
    return source


def linearised(source: AnalyticSource, item: Effect) -> tuple[Candidate, Evidence]:
    """An effect linearised where it does nothing, and the evidence of all clusters."""
    evidence = Evidence.of(source)
    found = linearise(Candidate.of((item,), source), evidence.clusters, evidence.numbers, source)
    assert found is not None
    return found, evidence


def means_of(clusters: Sequence[Cluster]) -> list[Array]:
    """Mean residuals."""
    return [item.mean for item in clusters]


def assert_uniform(p_values: Sequence[float], levels: Sequence[float] = (0.05, 0.3)) -> None:
    """As many lie below each level as chance allows in all but 1 of 10,000 runs."""
    for level in levels:
        low, high = binom.ppf([5e-5, 1 - 5e-5], len(p_values), level)
        assert low <= np.count_nonzero(np.array(p_values) < level) <= high


def correlated(rank: int = 5, seed: int = 0) -> Array:
    """Root of a covariance in which few directions carry most of the noise, as along one trial."""
    rng = np.random.default_rng(seed)
    return np.vstack((3.0 * rng.standard_normal((rank, FEATURES)) / np.sqrt(rank), 0.3 * np.eye(FEATURES)))[
        :FEATURES
    ] + 0.1 * np.eye(FEATURES)
