# SPDX-License-Identifier: Apache-2.0
"""A model that is followed from hit to hit: planted changes are found, quiet days stay quiet, a restart goes on."""

from __future__ import annotations

import copy
import csv
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from impact_table_cases import NOISE, arm_table, write_csv
from intervals import assert_covers

from impact_rs_analysis.evidence.replays.measured_runs import read_trial
from impact_rs_analysis.evidence.replays.replay_cache import ReplayCache
from impact_rs_analysis.evidence.tables.map_discrepancy import NO_MAP_DISCREPANCY
from impact_rs_analysis.following import change, hits, posterior, proposals, recent_residuals
from impact_rs_analysis.following.documents import Change, HitDocument
from impact_rs_analysis.following.follow import Follower, HitsSince
from impact_rs_analysis.following.hits import BagHitSource, TableHitSource
from impact_rs_analysis.following.state import restore_state, save_state
from impact_rs_sim.effects import library
from impact_rs_sim.errors import InputError
from impact_rs_sim.model import Model, load_model, save_model
from impact_rs_sim.numbers import NORMAL_95
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_trials.bags.record import record_trial
from impact_rs_trials.bags.trial_info import VIA, TrialInfo
from impact_rs_trials.campaign import Trial
from impact_rs_trials.recordings.impacts.impact_table import read_impact_table
from impact_rs_trials.spec import TrialSpec

NOMINAL = load_model("nominal")
PUSH = load_scenario("push")
SHORT_TIMING = {"nominal_impact": 0.45, "approach": 0.4, "overrun": 0.1, "stop": 0.15, "push": 0.25, "slide": 0.1}
Rows = list[list[object]]
FEW = ("object_mass", "restitution", "pad_friction")  # each further effect costs a solution of the map a hit
FOUR = (*FEW, "support_friction")


def rows_of(hidden: dict[str, Sequence[float]], repeats: int, seed: int) -> Rows:
    """Impacts in random order, with their time in the last column."""
    _, rows = arm_table(hidden, repeats, seed)
    order = np.random.default_rng(seed).permutation(len(rows))
    return [rows[place] for place in order]


def write(path: Path, rows: Rows, times: Sequence[float] | None = None) -> Path:
    header, _ = arm_table({}, 0)
    stamped = [[*row, float(n) if times is None else times[n]] for n, row in enumerate(rows)]
    return write_csv(path, [*header, "time [s]"], stamped)


def following(path: Path, model: Model = NOMINAL, only: Iterable[str] | None = FEW, **hit_source: object) -> Follower:
    return Follower(
        TableHitSource(lambda: read_impact_table(path, PUSH), model, **hit_source),
        model,
        None if only is None else list(only),
    )  # type: ignore[arg-type]


def changes(documents: Sequence[HitDocument]) -> list[Change]:
    return [document.change for document in documents if document.change is not None]


def _model(path: Path, scale: float, interval: tuple[float, float]) -> Model:
    path.write_text(
        "name: m\neffects:\n- name: object_mass\n  parameters:\n    scale:\n"
        f"      estimate: {scale}\n      unit: '-'\n      ci95: [{interval[0]}, {interval[1]}]\n"
    )
    return load_model(path)


QUIET = rows_of({}, 4, seed=1)
Day = Callable[..., Follower]


@pytest.fixture(scope="module")
def taught(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """State of a follower that quiet hits have taught."""
    folder = tmp_path_factory.mktemp("taught")
    follower = following(write(folder / "hits.csv", QUIET))
    assert not changes(list(follower.arrived())) and follower.watching
    save_state(follower, folder / "state.npz")
    return folder / "state.npz"


@pytest.fixture
def day(taught: Path, tmp_path: Path) -> Day:
    """Goes on after the quiet hits with some rows."""

    def goes_on(*parts: Rows, times: Sequence[float] | None = None) -> Follower:
        later = [row for part in parts for row in part]
        moments = [*range(len(QUIET)), *(range(len(QUIET), len(QUIET) + len(later)) if times is None else times)]
        follower = following(write(tmp_path / "hits.csv", QUIET + later, moments))
        restore_state(follower, taught)
        return follower

    return goes_on


# ---- what is believed, against closed forms --------------------------------------------------------------------------


def sigma_of(follower: Follower) -> np.ndarray:
    """Standard deviation of every feature: noise of the table, and half the relevance limit."""
    (hit, *_), layout = follower.hit_source.arrived(), "impacts"
    noise = np.repeat((NOISE[2], 0.005, 0.02), (len(hit.measured) - 6, 3, 3))
    return np.hypot(noise, follower.hit_source.limits([hit], layout) / 2.0)


@pytest.mark.parametrize(("stated", "known"), [(1.2, 0.15), (1.25, 0.005)], ids=["moved", "kept"])
def test_the_interval_of_a_parameter_is_that_of_least_squares_with_its_prior(
    tmp_path: Path, stated: float, known: float
) -> None:
    """1.96 / sqrt(sum |J / sigma|^2 + 1 / prior^2); kills widths times two, a lost prior, hits that count twice."""
    model = _model(tmp_path / "m.yaml", stated, (stated - known, stated + known))
    path = write(tmp_path / "hits.csv", rows_of({"object_mass": [1.25]}, 6, seed=6))
    sigma = sigma_of(following(path, model, ["object_mass"], discrepancy=NO_MAP_DISCREPANCY))
    follower = following(path, model, ["object_mass"], discrepancy=NO_MAP_DISCREPANCY)
    information = (NORMAL_95 / known) ** 2
    for hit in follower.hit_source.arrived():
        assert not changes(follower.take([hit]))
        above, below = follower.hit_source.predict(hit, [(("object_mass", (scale,)),) for scale in (1.26, 1.24)])
        assert above is not None and below is not None
        information += float(np.sum(np.square((above - below) / 0.02 / sigma)))
    (mass,) = follower.followed()
    assert mass.parameter == "object_mass.scale" and mass.change == pytest.approx(mass.estimate - stated)
    assert_covers(mass.ci95, 1.25, NORMAL_95 / np.sqrt(information), within=1.3)


def test_the_next_hit_of_each_condition_is_predicted_with_its_unit_and_the_noise_of_a_hit(
    taught: Path, tmp_path: Path
) -> None:
    """Kills intervals of predictions that leave out the noise, the square root or Student's quantile."""
    path = write(tmp_path / "hits.csv", QUIET)
    follower = following(path)
    assert follower.prediction() is None
    sigma = sigma_of(following(path))
    restore_state(follower, taught)
    conditions = {str(row[0]) + ", " + str(row[1]) for row in QUIET}
    assert len(conditions) > 4
    for condition in conditions:
        found = follower.prediction(condition)
        assert found is not None and found.condition == condition
        assert {value.unit for value in found.values} == {"rad/s", "m/s"}
        for value, own in zip(found.values, sigma, strict=True):
            assert_covers(value.ci95, value.value, NORMAL_95 * own, within=2.0)  # its own start is uncertain too
        assert np.median([np.ptp(v.ci95) / 2.0 / own for v, own in zip(found.values, sigma, strict=True)]) < 3.0


def test_quiet_hits_are_no_change_and_are_predicted_as_the_noise_says(day: Day) -> None:
    """Errors are in standard deviations of a hit: their mean square is 1."""
    documents = list(day(rows_of({}, 8, seed=3)).arrived())
    assert not changes(documents)
    assert np.mean([document.error**2 for document in documents if document.error is not None]) == pytest.approx(
        1.0, abs=0.25
    )


def test_a_prediction_is_the_mixture_of_the_explanations(day: Day) -> None:
    """Two that disagree widen the interval by their distance; kills the term of the mixture and equal shares."""
    follower = day([])
    one, other = copy.copy(follower.watch.likeliest), copy.copy(follower.watch.likeliest)
    other.posterior = other.posterior.copy()
    other.point = follower.watch.hit_model.candidate.nominal.copy()
    other.point[follower.watch.hit_model.candidate.part("object_mass")] = 1.5
    apart = []
    for shares in ((0.0, -50.0), (-50.0, 0.0), (0.0, 0.0)):
        one.log_weight, other.log_weight = shares
        follower.watch.hypotheses = [one, other]
        found = follower.prediction()
        assert found is not None
        apart.append(np.array([(value.value, np.ptp(value.ci95) / 2.0) for value in found.values]).T)
    (first, half), (second, _), (mean, wide) = apart
    np.testing.assert_allclose(mean, (first + second) / 2.0, atol=1e-9)
    far = np.argmax(np.abs(first - second) / half)
    assert abs(first - second)[far] > 4.0 * half[far]
    assert wide[far] == pytest.approx(NORMAL_95 * abs(first - second)[far] / 2.0, rel=0.2)


def test_the_scatter_is_learnt_from_hits_enough_and_from_repeats_enough(tmp_path: Path) -> None:
    """Of eight hits in six conditions only two repeat others; a third one does. Kills either gate."""
    kinds: dict[tuple[object, object], Rows] = {}
    for row in QUIET:
        kinds.setdefault((row[0], row[1]), []).append(row)
    rows = [own[n] for n in range(2) for own in kinds.values()]
    hit_source = TableHitSource(lambda: read_impact_table(write(tmp_path / "hits.csv", rows), PUSH), NOMINAL)
    documents = list(Follower(hit_source, NOMINAL, ["object_mass"], learnt=8).arrived())
    assert [document.error is None for document in documents] == [True] * 9 + [False] * 3
    assert all(document.error is None for document in list(following(tmp_path / "hits.csv").arrived()))


def test_one_repeated_condition_among_others_does_not_keep_the_follower_learning(tmp_path: Path) -> None:
    """Twice the hits that are needed teach the scatter; kills a wait for repeats that never come."""
    path = write(tmp_path / "hits.csv", QUIET[:20])
    with path.open(newline="", encoding="utf-8") as file:
        names, *rows = csv.reader(file)
    place = names.index("condition")
    rows.sort(key=lambda row: row[names.index("object")])
    single = [[*r[:place], "again" if n < 2 else f"condition {n}", *r[place + 1 :]] for n, r in enumerate(rows)]
    hit_source = TableHitSource(lambda: read_impact_table(write_csv(path, names, single), PUSH), NOMINAL)
    documents = list(Follower(hit_source, NOMINAL, ["object_mass"], learnt=8).arrived())
    assert [document.error is None for document in documents] == [True] * 16 + [False] * 4


def test_a_model_that_predicts_hardly_any_of_the_first_hits_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    follower = following(write(tmp_path / "hits.csv", QUIET))
    monkeypatch.setattr(follower.hit_source, "predict", lambda hit, added: [None] * len(added))
    with pytest.raises(InputError, match="model 'nominal' predicts 0 of the first 20 hits"):
        list(follower.arrived())


def test_hits_that_nothing_predicts_teach_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Kills: the last quiet hit counts again with every one of them."""
    follower = following(write(tmp_path / "hits.csv", rows_of({}, 8, seed=1)))
    arriving = follower.arrived()
    for _ in range(30):
        next(arriving)
    assert follower.watch is not None
    calibration = follower.watch.hit_model.calibration
    before = calibration.freedom, dict(calibration.squares)
    monkeypatch.setattr(follower.hit_source, "predict", lambda hit, added: [None] * len(added))
    assert all(document.error is None and document.change is None for document in arriving)
    assert (calibration.freedom, dict(calibration.squares)) == before


# ---- changes ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("effect", "values", "sign", "least"),
    [
        ("object_mass", [1.3], 1.0, 5),
        ("restitution", [0.2], 1.0, 5),
        ("pad_friction", [-0.4], -1.0, 8),  # shows only where the contact then slips
        pytest.param("object_mass", [0.75], -1.0, 5, marks=pytest.mark.slow),
        pytest.param("end_effector_payload", [0.5, 0.0, 0.0, -0.04], 1.0, 8, marks=pytest.mark.slow),
    ],
)
@pytest.mark.parametrize("whole", [False, pytest.param(True, marks=pytest.mark.slow)], ids=["some", "library"])
def test_a_step_is_found_within_some_hits_with_its_sign_and_size(
    tmp_path: Path, effect: str, values: list[float], sign: float, least: int, whole: bool
) -> None:
    """Among some effects, and among all that hits can show, which takes more hits to tell apart."""
    quiet = rows_of({}, 7, seed=1) if whole else QUIET
    path = write(tmp_path / "hits.csv", quiet + rows_of({effect: values}, 2, seed=2))
    follower = following(path, only=None if whole else dict.fromkeys((*FOUR, effect)))
    documents = list(follower.arrived())
    (change,) = changes(documents)
    found = [document.name for document in documents].index(change.hit) - len(quiet) + 1
    assert 2 <= found <= least  # one hit alone is never a change
    (cause,) = (one for one in change.causes if one.effect == follower.watch.likeliest.effect == effect)
    assert sign * cause.parameters[0].change > 0.0
    (believed,) = (one for one in follower.followed() if one.parameter == cause.parameters[0].parameter)
    half = believed.ci95[1] - believed.estimate
    assert abs(believed.estimate - values[0]) < 2.0 * half


def test_hits_in_any_order_of_rows_are_taken_in_time_order_and_simultaneous_ones_together(day: Day) -> None:
    """Stable names decide between hits of one stamp: estimates are the same to rounding."""
    rows = rows_of({"object_mass": [1.3]}, 1, seed=7)
    found = []
    for order in (range(len(rows)), np.random.default_rng(0).permutation(len(rows)).tolist()):
        follower = day([rows[n] for n in order], times=[float(len(QUIET) + n // 3) for n in order])
        (change,) = changes(list(follower.arrived()))
        assert change.since_time is not None and change.since_time >= len(QUIET) - 1
        (mass,) = follower.followed()
        assert mass.parameter == "object_mass.scale"
        found.append(mass.estimate)
    assert found[0] == pytest.approx(found[1], rel=1e-6)


def test_one_odd_hit_is_no_change_and_moves_the_prediction_little(day: Day) -> None:
    odd, quiet = rows_of({"restitution": [0.4]}, 1, seed=4)[:1], rows_of({}, 1, seed=5)
    first, *later = list(day(odd, quiet).arrived())
    assert not changes([first, *later])
    assert first.odd and first.error is not None and first.error > 5.0
    assert all(document.error is not None and document.error < 2.0 for document in later)


@pytest.mark.parametrize(
    ("effect", "values"),
    [("pad_friction", [-0.5]), pytest.param("object_mass", [0.5], marks=pytest.mark.slow)],
)
def test_large_changes_whose_sensitivities_bend_are_explained_by_their_effect_in_the_end(
    tmp_path: Path, effect: str, values: list[float]
) -> None:
    """By first-order sensitivities another effect explains the first hits better."""
    follower = following(write(tmp_path / "hits.csv", QUIET + rows_of({effect: values}, 2, seed=2)), only=FOUR)
    documents = list(follower.arrived())
    assert follower.watch.likeliest.effect == effect
    late = [document.error for document in documents[-3:]]
    assert max(error for error in late if error is not None) < 1.6


def test_a_slow_drift_is_followed_with_its_sign(day: Day) -> None:
    drifting = [rows_of({"restitution": [0.3 * n / 30.0]}, 1, seed=100 + n)[0] for n in range(30)]
    documents = list(day(drifting).arrived())
    found = changes(documents)
    named = [cause for change in found for cause in change.causes if cause.effect == "restitution"]
    assert len(named) == len(found) > 2  # a first small step may have another name as well
    assert all(cause.parameters[0].change > 0.0 for cause in named)
    assert not found[0].again and found[-1].again
    late = [document for document in documents[-10:] if document.error is not None and document.of_model is not None]
    followed, frozen = (np.mean([getattr(d, name) for d in late]) for name in ("error", "of_model"))
    assert followed < 0.5 * frozen


@pytest.mark.slow
def test_a_sensor_that_drifts_slowly_is_no_change(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The scale of all velocities after the impact, by 2 % over 240 hits; test_belief has the law of the drift."""
    header, _ = arm_table({}, 0)
    after = [place for place, name in enumerate(header) if "after" in name]
    rows = rows_of({}, 40, seed=1)
    for number, row in enumerate(rows):
        for place in after:
            row[place] = float(str(row[place])) * (1.0 + 0.02 * number / len(rows))
    path = write(tmp_path / "hits.csv", rows)
    assert not changes(list(following(path, only=None).arrived()))
    monkeypatch.setattr(posterior, "DISCREPANCY_RENEWAL", 1e-9)
    assert changes(list(following(path, only=None).arrived()))


def test_a_misfit_that_wears_in_and_no_effect_explains_is_predicted_from_recent_hits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The object seems to turn about an axis that no contact here can turn it about, more and more."""
    rows = rows_of({}, 10, seed=3)
    for number, row in enumerate(rows):
        row[-3] = float(str(row[-3])) + 0.6 * max(number - 20, 0) / len(rows)
    path = write(tmp_path / "hits.csv", rows)

    def late() -> float:
        documents = [one for one in following(path, only=["object_mass"]).arrived() if one.error is not None]
        return float(np.sqrt(np.mean([one.error**2 for one in documents[-20:] if one.error is not None])))

    corrected = late()
    monkeypatch.setattr(recent_residuals, "MIN_LEAD", 1e9)
    assert corrected < 0.85 * late()


def test_a_table_without_conditions_is_followed(tmp_path: Path) -> None:
    path = write(tmp_path / "hits.csv", QUIET + rows_of({"restitution": [0.2]}, 1, seed=2))
    with path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.reader(file))
    place = rows[0].index("condition")
    bare = write_csv(path, [n for n in rows[0] if n != "condition"], [r[:place] + r[place + 1 :] for r in rows[1:]])
    (change,) = changes(list(following(bare).arrived()))
    assert change.causes[0].effect == "restitution"


# ---- several explanations --------------------------------------------------------------------------------------------


def test_a_likely_explanation_that_is_not_the_first_is_linearised_anew(day: Day) -> None:
    """A second step makes the likeliest explanation be linearised anew, wherever it stands; kills index 0 for it."""
    follower = day(rows_of({"object_mass": [1.5]}, 1, seed=2), rows_of({"object_mass": [2.2]}, 1, seed=4))
    arriving = follower.hit_source.arrived()
    for hit in islice(arriving, 6):
        follower.take([hit])
    unlikely, likely = copy.copy(follower.watch.likeliest), follower.watch.likeliest
    unlikely.posterior, unlikely.log_weight = likely.posterior.copy(), likely.log_weight - 5.0
    follower.watch.hypotheses = [unlikely, likely]
    for hit in arriving:
        follower.take([hit])
    (mass,) = follower.followed()
    assert mass.estimate == pytest.approx(2.2, abs=0.1)


def test_an_explanation_that_predicts_nothing_is_ruled_out_by_one_that_does(
    day: Day, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Kills a hit that is not predicted and costs nothing, and hypotheses that are never dropped."""
    follower = day(rows_of({}, 1, seed=5))
    first, second, *_ = follower.hit_source.arrived()
    seeing, blind = follower.watch.likeliest, copy.copy(follower.watch.likeliest)
    scale = 1.0 + 1e-9
    blind.point, blind.posterior = blind.point.copy(), blind.posterior.copy()
    blind.point[follower.watch.hit_model.candidate.part("object_mass")] = scale
    seeing.log_weight, blind.log_weight = 0.0, -1.0
    follower.watch.hypotheses, predict = [seeing, blind], follower.hit_source.predict

    def blinded(hit: hits.Hit, added: Sequence[tuple]) -> list:  # type: ignore[type-arg]
        return [None] * len(added) if ("object_mass", (scale,)) in added[0] else predict(hit, added)

    monkeypatch.setattr(follower.hit_source, "predict", blinded)
    (document,) = follower.take([first])
    assert follower.watch.hypotheses == [seeing] and not follower.hit_source.skipped
    assert follower.watch.probabilities() == [1.0] and document.resolved == ""
    follower.watch.hypotheses = [blind]
    (document,) = follower.take([second])
    assert document.error is None and "predicts no impact" in follower.hit_source.skipped[second.name]
    assert follower.watch.hypotheses == [blind]


@pytest.mark.parametrize(
    ("others", "left", "resolved"),
    [((2.5,), 2, ""), ((3.5,), 1, "it is object_mass"), ((0.5, 8.0), 2, ""), ((0.5, 6.0), 3, "")],
)
def test_a_cause_is_dropped_below_one_in_a_thousand_and_known_from_95_percent_on(
    day: Day, others: Sequence[float], left: int, resolved: str
) -> None:
    """Probabilities 0.92, 0.97, and of a third 2e-4 and 1.5e-3; kills either bound, and causes that are never known."""
    follower = day(rows_of({}, 1, seed=5))
    first = next(follower.hit_source.arrived())
    follower.watch.likeliest.effect = "object_mass"
    found = [copy.deepcopy(follower.watch.likeliest.recent) for _ in others]
    for behind, recent in zip(others, found, strict=True):
        one = copy.copy(follower.watch.likeliest)
        one.posterior, one.recent, one.log_weight = one.posterior.copy(), recent, -behind
        follower.watch.hypotheses.append(one)
    (document,) = follower.take([first])
    assert len(follower.watch.hypotheses) == left
    assert document.resolved == resolved


def test_a_hit_raises_the_explanation_that_predicts_it(day: Day) -> None:
    """Kills probabilities that hits do not change."""
    follower = day(rows_of({"object_mass": [1.5]}, 1, seed=2))
    other = copy.copy(follower.watch.likeliest)
    other.point, other.posterior = other.point.copy(), other.posterior.copy()
    other.recent, other.log_weight = copy.deepcopy(other.recent), -2.0
    other.point[follower.watch.hit_model.candidate.part("object_mass")] = 1.5
    follower.watch.hypotheses.append(other)
    follower.take([next(follower.hit_source.arrived())])
    assert follower.watch.likeliest is other and follower.watch.probabilities().max() > 0.95


def test_two_odd_hits_of_a_kind_among_others_are_no_change(day: Day, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the quarter that speaks for it most a change must still hold, also once it was fitted."""
    odd, quiet = rows_of({"restitution": [0.3]}, 1, seed=4), rows_of({}, 1, seed=5)
    rows = [odd[0], quiet[0], quiet[1], quiet[2], odd[1], quiet[3], quiet[4]]
    monkeypatch.setattr(change, "support", lambda gains: 1.0)
    assert not changes(list(day(rows).arrived()))


def apart(path: Path, hidden: dict[str, Sequence[float]], only: Sequence[str], seed: int = 2) -> Change:
    """The change that some hits show and leave open."""
    follower = following(write(path / "hits.csv", QUIET + rows_of(hidden, 1, seed)), only=only)
    (change,) = changes(list(follower.arrived()))
    assert len(change.causes) == 2 and change.words.endswith(change.apart)
    return change


def test_mass_and_motors_that_hits_do_not_tell_apart_are_distinguished_by_a_lift_if_the_difference_can_be_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Kills a check without its own uncertainty, and one that is proposed where both read the same."""
    lift = proposals.HITLESS_CHECKS[0]
    monkeypatch.setattr(proposals, "HITLESS_CHECKS", (lift,))
    change = apart(tmp_path, {"object_mass": [1.1]}, ["object_mass", "motor_inertia_scale"])
    mass = change.causes[0].parameters[0]
    assert (change.causes[0].effect, mass.parameter) == ("object_mass", "object_mass.scale")
    assert change.apart.startswith("one measurement, lift the object, distinguishes them (")
    heavier, as_before = (float(text.split()[0]) for text in change.apart.partition("(")[2].split(", "))
    assert min(abs(as_before - 9.81 * item.mass) for item in PUSH.objects.values()) < 0.05  # N
    assert heavier == pytest.approx(mass.estimate * as_before, rel=0.01)
    blunt = lift._replace(resolution=10.0 * lift.resolution)
    monkeypatch.setattr(proposals, "HITLESS_CHECKS", (blunt,))
    change = apart(tmp_path, {"object_mass": [1.1]}, ["object_mass", "motor_inertia_scale"])
    assert change.apart == "a free motion distinguishes them (motor_inertia_scale would show there)"


def test_one_more_hit_of_a_kind_that_was_measured_is_proposed_where_it_decides(tmp_path: Path) -> None:
    change = apart(tmp_path, {"object_mass": [1.3]}, ["object_mass", "motor_inertia_scale", "restitution"])
    assert change.apart.startswith("one hit of ") and "distinguishes them (" in change.apart


def test_hits_at_other_speeds_are_proposed_where_those_at_hand_do_not_decide(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(proposals, "MIN_DECISIVE_DISTANCE", 10.0)
    change = apart(tmp_path, {"restitution": [0.06]}, ["object_mass", "restitution"], seed=5)
    assert " at twice the speed, not measured yet, distinguishes them (" in change.apart
    hit_source = following(write(tmp_path / "hits.csv", QUIET)).hit_source
    fast, slow = hit_source.unmeasured([next(hit_source.arrived())])
    assert fast.measured == pytest.approx(4.0 * slow.measured)


def test_where_nothing_tells_causes_apart_it_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Both show in a free motion, and neither in what one reads."""
    monkeypatch.setattr(proposals, "HITLESS_CHECKS", ())
    change = apart(tmp_path, {"motor_inertia_scale": [1.2]}, ["motor_inertia_scale", "end_effector_payload"])
    assert change.apart.startswith("no hit of these kinds and nothing")


# ---- restarts --------------------------------------------------------------------------------------------------------


def test_a_state_that_is_saved_after_any_hit_goes_on_as_if_it_had_never_ended(tmp_path: Path) -> None:
    rows = QUIET + rows_of({"object_mass": [1.3]}, 1, seed=8)
    whole = following(write(tmp_path / "all.csv", rows))
    expected = {document.name: document for document in whole.arrived()}
    path, state = tmp_path / "hits.csv", tmp_path / "state.npz"
    for end in (10, len(QUIET), len(QUIET) + 1, len(QUIET) + 2, len(rows)):
        write(path, rows[:end])
        follower = following(path)
        if state.exists():
            restore_state(follower, state)
        for document in follower.arrived():
            same = expected.pop(document.name)
            if same.error is not None:
                assert document.error == pytest.approx(same.error, rel=1e-6)
            assert (document.change is None) == (same.change is None)
        save_state(follower, state)
    assert not expected
    assert follower.followed()[0].estimate == pytest.approx(whole.followed()[0].estimate, rel=1e-6)
    assert follower.changed == whole.changed


def test_a_state_that_is_saved_between_hits_loses_none_and_announces_each_change(taught: Path, tmp_path: Path) -> None:
    """Simultaneous hits belong together: state is never saved before all of them were handed over."""
    rows = QUIET + rows_of({"object_mass": [1.3]}, 2, seed=8)
    path = write(tmp_path / "hits.csv", rows, [*range(len(QUIET)), *(100.0 + n // 3 for n in range(12))])
    state, reported = tmp_path / "state.npz", []
    state.write_bytes(taught.read_bytes())
    found: list[Change] = []
    for _ in range(len(rows)):  # killed in the middle of every second instant
        follower = following(path)
        restore_state(follower, state)
        own = list(islice(follower.arrived(partial(save_state, follower, state)), 5))
        reported += [document.name for document in own]
        found += changes(own)
        if len(own) < 5:
            break
    assert set(reported) == {f"row {n + 1}" for n in range(len(QUIET), len(rows))}
    assert len({change.hit for change in found}) == 1


def test_a_state_of_another_model_no_state_or_a_row_that_is_gone_is_refused_with_its_name(
    taught: Path, tmp_path: Path
) -> None:
    path, state = write(tmp_path / "hits.csv", QUIET), tmp_path / "state.npz"
    with pytest.raises(InputError, match="another model"):
        restore_state(following(path, _model(tmp_path / "m.yaml", 1.2, (1.0, 1.4))), taught)
    state.write_bytes(b"no archive")
    with pytest.raises(InputError, match="not a state file"):
        restore_state(following(path), state)
    write(path, QUIET[:-1])
    with pytest.raises(InputError, match=f"row {len(QUIET)}, which the state knows, is gone"):
        restore_state(following(path), taught)


def test_the_followed_model_predicts_as_the_follower_does(day: Day, tmp_path: Path) -> None:
    follower = day(rows_of({"object_mass": [1.3]}, 1, seed=9))
    list(follower.arrived())
    save_model(follower.model_now("now", "nominal.yaml"), tmp_path / "now.yaml")
    model = load_model(tmp_path / "now.yaml")
    again = following(write(tmp_path / "after.csv", rows_of({"object_mass": [1.3]}, 5, seed=10)), model)
    assert [item.name for item in model.effects] == ["object_mass"]
    assert not changes(list(again.arrived()))
    with pytest.raises(InputError, match="too few hits to follow a model: 0 of 20"):
        following(tmp_path / "hits.csv").model_now("now", "nominal.yaml")


def test_hits_since_a_change_are_enough_for_a_diagnosis_with_three_conditions_and_three_repeats() -> None:
    assert not HitsSince("a", ("a", "b", "a", "b", "a", "b", "a")).diagnosable
    assert not HitsSince("a", ("a", "b", "c", "a", "b")).diagnosable
    assert HitsSince("a", ("a", "b", "c", "a", "b", "c")).diagnosable
    assert not HitsSince("a", ("",) * 5).diagnosable and HitsSince("a", ("",) * 6).diagnosable


# ---- trials ----------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def trials(made_once: Callable[[str, Callable[[Path], None]], Path]) -> Path:
    """Short pushes on the plant; after the first six the object is half as heavy again."""

    def run(folder: Path) -> None:
        timing = PUSH.timing.model_copy(update=SHORT_TIMING | {"window_after": 0.25, "duration": 0.8})
        few = PUSH.model_copy(update={"timing": timing, "objects": {"juice": PUSH.objects["juice"]}})
        spec = TrialSpec.of(few, "juice", "case_2")
        for repeat in range(9):
            trial = Trial.of(spec, repeat, 3)
            physics = spec.plan.scene.physics
            if repeat >= 6:
                physics = library()["object_mass"].apply_vector(physics, np.array([1.5]))
            info = TrialInfo.of(spec.plan, trial.key, trial.seed, VIA["bullet"])
            record_trial(spec.plan, info, folder / trial.key.name, physics)

    return made_once("trials_to_follow", run)


def test_a_change_of_the_plant_is_followed_through_its_trials(trials: Path) -> None:
    hit_source = BagHitSource(trials, NOMINAL, ReplayCache(map))
    follower = Follower(hit_source, NOMINAL, ["object_mass"], learnt=6, mean_time=1000.0)
    (change,) = changes(list(follower.arrived()))
    assert change.causes[0].effect == "object_mass"
    (mass,) = follower.followed()
    assert mass.estimate == pytest.approx(1.5, abs=0.06)


def test_bags_are_read_when_they_are_due_and_what_was_not_measured_is_simulated(
    trials: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    read: list[str] = []
    monkeypatch.setattr(hits, "read_trial", lambda path: (read.append(path.name), read_trial(path))[1])
    hit_source = BagHitSource(trials, NOMINAL, ReplayCache(map))
    arriving = hit_source.arrived()
    assert next(arriving).name.endswith("r0") and len(read) == 1 and hit_source.waiting == 8
    second = next(arriving)
    assert second.name.endswith("r1") and len(read) == 2 and hit_source.waiting == 7
    another = next(hit_source.unmeasured([second]))
    assert another.condition != second.condition and another.condition.startswith("push/juice/case_")


def test_the_next_hit_after_a_free_motion_is_one_with_an_impact(hidden_campaign: Path) -> None:
    follower = Follower(BagHitSource(hidden_campaign, NOMINAL, ReplayCache(map)), NOMINAL, ["object_mass"], learnt=4)
    found = list(follower.hit_source.arrived())
    pushes = [hit for hit in found if hit.has_contact]
    assert len(pushes) == 4
    for hit in [*pushes, *(hit for hit in found if not hit.has_contact)]:
        follower.take([hit])
    prediction = follower.prediction()
    assert prediction is not None and prediction.like == pushes[-1].name
    assert {"impact", "push"} <= {value.phase for value in prediction.values}


def test_what_was_learnt_of_another_parameter_is_not_learnt_again_with_a_second_cause(tmp_path: Path) -> None:
    """Mass 1.2 by the model and 1.25, then restitution, then friction. Kills: 1.28 [1.27, 1.29] and two causes."""
    model = _model(tmp_path / "m.yaml", 1.2, (1.05, 1.35))
    mass, more = {"object_mass": [1.25]}, {"restitution": [0.4]}
    rows = rows_of(mass, 6, 1) + rows_of(mass | more, 1, 2) + rows_of(mass | more | {"pad_friction": [-0.3]}, 2, 3)
    follower = following(write(tmp_path / "h.csv", rows), model, discrepancy=NO_MAP_DISCREPANCY)
    found = changes(list(follower.arrived()))
    assert [[cause.effect for cause in change.causes] for change in found] == [["restitution"], ["pad_friction"]]
    scale = next(one for one in follower.followed() if one.parameter == "object_mass.scale")
    low, high = scale.ci95
    assert low < 1.25 < high and high - low < 0.03


def test_effects_that_no_hit_shows_are_refused(tmp_path: Path) -> None:
    """Kills: a statistic of nothing, which no document takes."""
    follower = following(write(tmp_path / "h.csv", rows_of({}, 6, 1)), only=["joint_stiffness"])
    with pytest.raises(InputError, match="hits show none of the followed effects: joint_stiffness"):
        list(follower.arrived())
