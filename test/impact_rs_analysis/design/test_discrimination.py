# SPDX-License-Identifier: Apache-2.0
"""Expected discrimination against closed forms, and against likelihood ratios of simulated measurements."""

import numpy as np
import pytest
import scipy

from impact_rs_analysis.design.discrimination import RIVAL_RANGE_SCALES, Discrimination
from impact_rs_analysis.design.explanations import AS_IS, Decision, Explanation
from impact_rs_analysis.evidence.cluster import INDEPENDENT_DISCREPANCY_SHARE
from impact_rs_analysis.inference.ahead import probability
from impact_rs_analysis.inference.student import DECISIVE_LIKELIHOOD_RATIO, log_density

from .made_up_trials import DISCREPANCY, SCATTER, estimated_pair, trial


def gain(counts: Discrimination, **repeats: int) -> float:
    return float(counts.gains(counts.total(repeats))[0][0][0])


def blur_of(repeats: int, share: float = 1.0) -> float:
    """Variance of a feature's mean; ``share`` of the discrepancy is feature by feature."""
    return SCATTER**2 / repeats + (1.0 - SCATTER**2 - DISCREPANCY**2) + share * DISCREPANCY**2


def test_the_distance_is_that_of_the_predictions_over_what_blurs_them() -> None:
    counts = Discrimination(estimated_pair(), [trial("a", [[0.3, -0.4], [0.0, 0.1]])])
    assert gain(counts, a=3) == pytest.approx((0.3**2 + 0.5**2) / blur_of(3))


def test_repeats_average_scatter_and_not_the_discrepancy_of_the_simulation() -> None:
    counts = Discrimination(estimated_pair(), [trial("a", [[1.0], [0.0]])])
    assert gain(counts, a=1) == pytest.approx(1.0)
    assert gain(counts, a=10**6) == pytest.approx(1.0 / (1.0 - SCATTER**2), rel=1e-4)


@pytest.mark.parametrize("repeats", [2, 4])
def test_as_many_pairs_are_distinguished_as_said(repeats: int) -> None:
    """Measurements drawn from the model of the module, judged by their likelihood with the full covariance.

    The scale of the noise is drawn with the degrees of freedom of the repeats. Kills a probability of the likelier one,
    and one of a known noise.
    """
    rng, freedom = np.random.default_rng(2), 2 * (repeats - 1)
    trials = [
        trial(
            name,
            rng.normal(size=(2, 6)),
            [0.3 * rng.normal(size=(2, 6)) for _ in range(2)],
            np.array([[DISCREPANCY, -DISCREPANCY] * 3]),
        )
        for name in "ab"
    ]
    counts = Discrimination(estimated_pair(2), trials)
    assert counts.freedom({"a": repeats, "b": repeats}) == freedom
    said = counts.probabilities(counts.total({"a": repeats, "b": repeats}), freedom)[0]

    patterns = np.sqrt(1.0 - INDEPENDENT_DISCREPANCY_SHARE) * np.hstack([one.cluster.patterns for one in trials])
    spreads = [np.hstack([one.spreads[h] for one in trials]) for h in range(2)]
    blur = np.diag(np.full(12, blur_of(repeats, INDEPENDENT_DISCREPANCY_SHARE)))
    covariance = blur + patterns.T @ patterns + sum(rows.T @ rows for rows in spreads)
    difference = np.subtract(*np.hstack([one.centres for one in trials]))
    way = np.linalg.solve(covariance, difference)
    way, apart = way / np.sqrt(way @ difference), np.sqrt(way @ difference)
    draws = rng.multivariate_normal(difference / 2.0, covariance, size=20_000) @ way
    scale = np.sqrt(rng.chisquare(freedom, 20_000) / freedom)
    squares = [np.square((draws - side * apart / 2.0) / scale) for side in (1.0, -1.0)]
    first, second = (np.array([log_density(one, 0.0, 1, freedom) for one in own]) for own in squares)
    assert np.mean(np.abs(first - second) > np.log(DECISIVE_LIKELIHOOD_RATIO)) == pytest.approx(said, abs=0.01)
    assert 0.3 < said < 0.9


def test_a_rival_whose_parameters_can_imitate_it_is_not_distinguished() -> None:
    difference = np.array([0.4, -0.2, 0.3])
    far = Discrimination(estimated_pair(), [trial("a", [difference, np.zeros(3)])])
    none = np.zeros((1, 3))
    near = Discrimination(estimated_pair(1), [trial("a", [difference, np.zeros(3)], [none, 30.0 * difference[None]])])
    assert gain(near, a=5) < 0.01 * gain(far, a=5)


def test_a_difference_along_the_discrepancy_counts_less_than_one_across_it() -> None:
    along = np.array([[DISCREPANCY, DISCREPANCY]])
    counts = [
        Discrimination(estimated_pair(), [trial("a", [way, [0.0, 0.0]], patterns=along)])
        for way in ([0.5, 0.5], [0.5, -0.5])
    ]
    assert gain(counts[0], a=20) < 0.7 * gain(counts[1], a=20)


def test_conditions_share_the_amplitude_of_their_discrepancy() -> None:
    """Where the explanations differ with opposite sign in two conditions, the shared error cancels."""
    along = np.array([[DISCREPANCY, DISCREPANCY]])
    same, opposite = (
        Discrimination(
            estimated_pair(),
            [
                trial("a", [[0.5, 0.5], [0.0, 0.0]], patterns=along),
                trial("b", [[sign * 0.5, sign * 0.5], [0.0, 0.0]], patterns=along),
            ],
        )
        for sign in (1.0, -1.0)
    )
    assert gain(same, a=4, b=4) < 0.8 * gain(opposite, a=4, b=4)


def test_without_estimates_the_rival_is_fitted_anew() -> None:
    """What least squares leave of one effect's change, the other fitted in a wide range."""
    first, second = np.array([[0.6, 0.0, 0.3]]), np.array([[0.5, 0.1, 0.0]])
    decision = Decision.between(
        [Explanation("first", varied=((("a", (1.0,)),),)), Explanation("second", varied=((("b", (1.0,)),),))], "effects"
    )
    one = trial("a", np.zeros((2, 3)), [first, second])
    counts = Discrimination(decision, [one])
    blur = blur_of(2)
    expected = []
    for own, other in ((first, second), (second, first)):
        rows = np.vstack([other.T / np.sqrt(blur), [[1.0 / RIVAL_RANGE_SCALES]]])
        target = np.append(own[0] / np.sqrt(blur), 0.0)
        share = np.linalg.lstsq(rows, target, rcond=None)[0]
        expected.append(np.sum(np.square(target - rows @ share)))
    found = counts.gains(counts.total({"a": 2}))[0]
    assert [float(ways[0]) for ways in found] == pytest.approx(expected)
    assert counts.probabilities(counts.total({"a": 2}))[0] == pytest.approx(probability(np.array(min(expected))))


def test_an_effect_that_another_can_imitate_is_not_distinguished_from_it() -> None:
    """The direction in which less is distinguished: of the parameters of the other one half are seen."""
    visible, alike = np.array([[30.0, 0.0]]), np.array([[0.0, 30.0]])
    decision = Decision.between(
        [
            Explanation("friction", varied=((("f", (1.0, 0.0)),), (("f", (0.0, 1.0)),))),
            Explanation("offset", varied=((("o", (1.0,)),),)),
        ],
        "effects",
    )
    counts = Discrimination(decision, [trial("a", np.zeros((2, 2)), [np.vstack((visible, alike)), alike])])
    total = counts.total({"a": 5})
    assert counts.probabilities(total)[0] == pytest.approx(0.0, abs=0.01)
    assert [float(probability(ways).mean()) for ways in counts.gains(total)[0]] == pytest.approx([0.5, 0.0], abs=0.01)


def test_nothing_is_known_before_the_first_trial() -> None:
    decision = Decision.between([Explanation(AS_IS), Explanation("mass", varied=((("m", (1.0,)),),))], "effects")
    counts = Discrimination(decision, [trial("a", np.zeros((2, 1)), [np.zeros((0, 1)), np.ones((1, 1))])])
    assert counts.probabilities(counts.total({}))[0] == 0.0
    assert counts.probabilities(counts.total({"a": 2}))[0] > 0.01


def test_the_information_on_parameters_is_that_of_least_squares() -> None:
    rows = np.array([[0.7, 0.2, 0.0], [0.1, 0.4, 0.5]])
    one = Explanation("mass", (("m", (1.0,)),), ((("m", (1.1,)),), (("m", (1.0,)),)))
    made = trial("a", np.zeros((1, 3)), [rows])
    counts = Discrimination(Decision("parameters", (one,)), [made])
    weighed = rows / blur_of(3) @ rows.T
    assert counts.utility(counts.total({"a": 3})) == pytest.approx(
        0.5 * np.linalg.slogdet(np.eye(2) + weighed)[1], rel=1e-9
    )


def test_a_further_trial_never_informs_less() -> None:
    rng = np.random.default_rng(5)
    patterns = DISCREPANCY * scipy.linalg.orth(rng.normal(size=(4, 2))).T
    trials = [
        trial(name, rng.normal(size=(2, 4)), [rng.normal(size=(2, 4)) for _ in range(2)], patterns) for name in "abc"
    ]
    counts = Discrimination(estimated_pair(2), trials)
    for _ in range(30):
        repeats = {name: int(rng.integers(0, 4)) for name in "abc"}
        more = {name: count + int(rng.integers(0, 2)) for name, count in repeats.items()}
        assert counts.utility(counts.total(more)) >= counts.utility(counts.total(repeats)) - 1e-12


def test_what_estimates_contain_is_not_counted_again() -> None:
    """Two tied explanations were fitted to the trials so far; of a library without estimates those still inform."""
    trials = [trial("a", [[0.9], [0.0]], [np.ones((1, 1)), np.ones((1, 1))], repeats=4)]
    tied = Discrimination(estimated_pair(1), trials)
    open_pair = Decision.between([Explanation(AS_IS), Explanation("mass", varied=((("m", (1.0,)),),))], "effects")
    fresh = Discrimination(open_pair, [trial("a", np.zeros((2, 1)), [np.zeros((0, 1)), np.ones((1, 1))], repeats=4)])
    assert tied.measured == fresh.measured == {"a": 4}
    assert tied.probabilities(tied.total(tied.counted))[0] == 0.0
    assert fresh.probabilities(fresh.total(fresh.counted))[0] > 0.01


def test_repeats_before_and_of_the_plan_count_for_the_scatter() -> None:
    trials = [trial("a", [[0.0], [1.0]], repeats=3), trial("b", [[0.0], [1.0]])]
    counts = Discrimination(estimated_pair(0), trials)
    assert counts.freedom({}) == 2.0
    assert counts.freedom({"a": 1, "b": 2}) == 4.0
