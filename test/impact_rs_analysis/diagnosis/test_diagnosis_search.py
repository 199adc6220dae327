"""The search on a world with a closed form: what is planted is found, what is not there is not."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import binom

from impact_rs_analysis.diagnosis.candidates import NormalEquations
from impact_rs_analysis.diagnosis.diagnose import _estimates, _tied, choose
from impact_rs_analysis.diagnosis.search import SIGNIFICANT, Search, _broyden, fit
from impact_rs_analysis.evidence.clusters import ConditionEvidence
from impact_rs_sim.effects import Effect
from impact_rs_sim.effects.base import Parameter
from impact_rs_sim.model import Model

FEATURES, CONDITIONS, REPEATS = 40, 6, 3
FLOOR = 0.6  # share of a feature's scale that nobody cares about


class Analytic(Effect):
    """An effect without physics: its features are known in closed form."""

    acts_on, sentence = "test", "An effect of the test."

    def __init__(self, name: str, parameters: tuple[Parameter, ...]) -> None:
        self.name, self.parameters = name, parameters  # type: ignore[misc]

    def apply(self, physics, values):  # noqa: ANN001, ANN201
        return physics


def _parameter(name: str, nominal: float = 0.0) -> Parameter:
    return Parameter(name, "-", nominal, -50.0, 50.0, 1.0, name)


EFFECTS = [
    Analytic("straight", (_parameter("a"),)),
    Analytic("bent", (_parameter("b"),)),
    Analytic("twin_of_straight", (_parameter("c"),)),
    Analytic("payload", (_parameter("mass"), _parameter("lever"))),
    Analytic("of_joints", tuple(_parameter(f"joint{number}") for number in range(7))),
    Analytic("of_motors", tuple(_parameter(f"motor{number}") for number in range(7))),
]
FREE = (0, 1)  # conditions in which nothing is hit, where there are any


@dataclass(frozen=True)
class World:
    """Features of every condition as functions of the parameters."""

    seed: int
    free: tuple[int, ...] = ()

    def direction(self, condition: int, number: int) -> np.ndarray:
        return np.random.default_rng([10_000 + number, condition]).standard_normal(FEATURES)

    def features(self, condition: int, added: tuple) -> np.ndarray:
        result = np.zeros(FEATURES)
        for name, values in added:
            if name == "straight":
                result += values[0] * self.direction(condition, 0)
            elif name == "twin_of_straight":
                result += 0.5 * values[0] * self.direction(condition, 0)
            elif name == "bent":
                result += 20.0 * np.tanh(values[0] / 6.0) * self.direction(condition, 1)
                result += 0.05 * values[0] ** 2 * self.direction(condition, 2)
            elif name == "payload":
                mass, lever = values
                result += mass * self.direction(condition, 3) + mass * lever * self.direction(condition, 4)
            elif name == "of_joints":
                result += sum(value * self.direction(condition, 10 + j) for j, value in enumerate(values))
            elif name == "of_motors":
                result += sum(value * self.direction(condition, 20 + j) for j, value in enumerate(values))
            elif name == "outside":
                result += values[0] * self.direction(condition, 5)
        return result

    def evidence(self, truth: tuple, believed: tuple = ()) -> list[ConditionEvidence]:
        """Measured minus believed; noise depends on the seed alone, not on what is believed."""
        found = []
        for number in range(CONDITIONS):
            noise = np.random.default_rng([self.seed, number]).standard_normal((REPEATS, FEATURES))
            sigma = np.sqrt(1.0 + (FLOOR / 2.0) ** 2) * np.ones(FEATURES)
            rows = self.features(number, truth) - self.features(number, believed) + noise
            plan = SimpleNamespace(expects_impact=number not in self.free)
            condition = SimpleNamespace(number=number, plan=plan, label=str(number))
            found.append(ConditionEvidence(condition, rows / sigma, sigma, 1.0 / sigma))  # type: ignore[arg-type]
        return found

    def search(
        self, truth: tuple, only: tuple[str, ...] = ("straight", "bent", "payload"), asked: list | None = None
    ) -> Search:
        asked = [] if asked is None else asked

        def store(rollouts, what=""):  # noqa: ANN001, ANN202
            asked.extend(rollouts)
            return [self.features(rollout.condition.number, rollout.added) for rollout in rollouts]

        return Search(
            [effect for effect in EFFECTS if effect.name in only],
            Model(name="nothing"),
            self.evidence(truth),
            store,  # type: ignore[arg-type]
            lambda added: self.evidence(truth, added),
        )


def test_nothing_is_found_where_nothing_is_hidden() -> None:
    false_alarms = sum(choose(World(seed).search(()))[0] is not None for seed in range(40))
    assert false_alarms <= 1


@pytest.mark.parametrize(
    ("name", "values"), [("straight", (0.8,)), ("straight", (30.0,)), ("bent", (2.0,)), ("bent", (9.0,))]
)
def test_a_hidden_effect_is_named_and_estimated_however_strong_it_is(name: str, values: tuple[float, ...]) -> None:
    for seed in range(5):
        search = World(seed).search(((name, values),))
        chosen, _ = choose(search)
        assert chosen is not None and chosen.candidate.names == (name,)
        assert chosen.estimate[0] == pytest.approx(values[0], abs=0.1)
        assert search.lack_of_fit < SIGNIFICANT < search.lack_of_fit_of(chosen)


def test_a_parameter_that_cannot_be_seen_at_nominal_is_found_all_the_same() -> None:
    """The lever of a payload moves nothing while the payload has no mass."""
    search = World(3).search((("payload", (4.0, -1.5)),))
    chosen, _ = choose(search)
    assert chosen is not None and chosen.candidate.names == ("payload",)
    np.testing.assert_allclose(chosen.estimate, (4.0, -1.5), atol=0.1)


def test_two_hidden_effects_are_both_named() -> None:
    chosen, _ = choose(World(4).search((("straight", (3.0,)), ("bent", (5.0,)))))
    assert chosen is not None and set(chosen.candidate.names) == {"straight", "bent"}


def test_effects_with_parallel_signatures_tie() -> None:
    search = World(5).search((("straight", (5.0,)),), ("straight", "twin_of_straight", "bent"))
    chosen, rivals = choose(search)
    assert chosen is not None
    best, *others = rivals[chosen.candidate.names[-1]]
    tied = {rival.candidate.names[-1] for rival in others if _tied(search, best, rival)}
    assert tied | {best.candidate.names[-1]} == {"straight", "twin_of_straight"}


def test_what_no_effect_explains_leaves_a_lack_of_fit() -> None:
    search = World(6).search((("outside", (5.0,)),))
    chosen, _ = choose(search)
    assert search.lack_of_fit_of(chosen) < SIGNIFICANT


def test_95_percent_intervals_hold_the_truth_95_times_in_100() -> None:
    """Counted over 200 campaigns; the bounds are what chance allows a true share of 93 to 98 percent."""
    count, inside = 200, 0
    for seed in range(count):
        chosen = fit(*(lambda s: (s.singles["straight"], s.evidence))(World(seed).search((("straight", (2.0,)),))))
        (estimate,) = _estimates(chosen, "straight")
        inside += estimate.low <= 2.0 <= estimate.high
    assert binom.ppf(0.005, count, 0.93) <= inside <= binom.ppf(0.995, count, 0.98)


def test_an_update_of_the_sensitivities_gives_the_step_just_made_exactly() -> None:
    search = World(7).search((("bent", (9.0,)),))
    before = search.singles["bent"]
    after = search._at(before, np.array([4.0]), search.evidence)
    assert after is not None
    updated = _broyden(before, after)
    for jacobian, here, there in zip(updated.jacobians, before.offsets, after.offsets, strict=True):
        np.testing.assert_allclose(jacobian @ np.array([4.0]), there - here, rtol=1e-12)


def test_leaving_a_condition_out_uses_all_others() -> None:
    search = World(8).search((("straight", (2.0,)),))
    candidate = search.singles["straight"]
    for number in range(CONDITIONS):
        others = [item for index, item in enumerate(search.evidence) if index != number]
        without = type(candidate)(
            candidate.effects,
            candidate.point,
            tuple(o for index, o in enumerate(candidate.offsets) if index != number),
            tuple(j for index, j in enumerate(candidate.jacobians) if index != number),
        )
        direct = NormalEquations(without, others).solve()
        np.testing.assert_allclose(NormalEquations(candidate, search.evidence).left_out[number], direct, rtol=1e-9)


def test_most_effects_of_the_joints_that_are_absent_are_not_tried_in_contact() -> None:
    ruled_out = 0
    for seed in range(20):
        asked: list = []
        search = World(seed, FREE).search((), ("bent", "of_joints"), asked)
        tried = {rollout.condition.number for rollout in asked if rollout.added and rollout.added[0][0] == "of_joints"}
        assert tried == (set(FREE) if search.ruled_out else set(range(CONDITIONS)))
        assert set(search.p_values) == {"bent", "of_joints"}
        ruled_out += bool(search.ruled_out)
    assert ruled_out >= 14


@pytest.mark.parametrize("size", [1.0, 30.0])
def test_an_effect_of_the_joints_is_found_beside_one_of_the_contact(size: float) -> None:
    values = tuple(size * (-1.0) ** joint for joint in range(7))
    search = World(2, FREE).search((("of_joints", values), ("bent", (5.0,))), ("bent", "of_joints"))
    assert not search.ruled_out
    chosen, _ = choose(search)
    assert chosen is not None and set(chosen.candidate.names) == {"bent", "of_joints"}


@pytest.mark.parametrize("size", [1.0, 30.0])
def test_where_one_effect_explains_free_motion_others_of_the_joints_are_not_tried_in_contact(size: float) -> None:
    values = tuple(size * (-1.0) ** joint for joint in range(7))
    asked: list = []
    search = World(2, FREE).search((("of_joints", values),), ("of_joints", "of_motors", "bent"), asked)
    assert search.ruled_out == {"of_motors"}
    moved = {rollout.condition.number for rollout in asked if rollout.added and rollout.added[0][0] == "of_motors"}
    assert moved == set(FREE)
    chosen, _ = choose(search)
    assert chosen is not None and chosen.candidate.names == ("of_joints",)


@pytest.mark.parametrize("size", [1.0, 30.0])
def test_two_effects_of_the_joints_are_both_tried_in_contact_and_named(size: float) -> None:
    values = tuple(size * (-1.0) ** joint for joint in range(7))
    search = World(2, FREE).search((("of_joints", values), ("of_motors", values)), ("of_joints", "of_motors", "bent"))
    assert not search.ruled_out
    chosen, _ = choose(search)
    assert chosen is not None and set(chosen.candidate.names) == {"of_joints", "of_motors"}
