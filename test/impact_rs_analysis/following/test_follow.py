# SPDX-License-Identifier: Apache-2.0
"""A model that is followed from hit to hit: planted changes are found, quiet days stay quiet, a restart goes on."""

from __future__ import annotations

import copy
import csv
from collections.abc import Sequence
from functools import partial
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from impact_table_cases import arm_table, write_csv

from impact_rs_analysis.evidence.measured_runs import read_trial
from impact_rs_analysis.evidence.replay_cache import ReplayCache
from impact_rs_analysis.following import follow, hits, posterior, recent_residuals
from impact_rs_analysis.following.follow import Follower, HitsSince
from impact_rs_analysis.following.hits import BagDoor, TableDoor
from impact_rs_analysis.following.lessons import Change, HitDocument
from impact_rs_analysis.following.posterior import Posterior
from impact_rs_analysis.following.state import restore_state, save_state
from impact_rs_sim.effects import library
from impact_rs_sim.errors import InputError
from impact_rs_sim.model import Model, load_model, save_model
from impact_rs_sim.scenario import load_scenario
from impact_rs_trials.bags.record import record_trial
from impact_rs_trials.bags.trial_info import VIA, TrialInfo
from impact_rs_trials.campaign import Trial
from impact_rs_trials.recordings.impact_table import read_impact_table
from impact_rs_trials.spec import TrialSpec

NOMINAL = load_model("nominal")
PUSH = load_scenario("push")
Rows = list[list[object]]


def rows_of(hidden: dict[str, Sequence[float]], repeats: int, seed: int) -> Rows:
    """Impacts in random order, with their time in the last column."""
    _, rows = arm_table(hidden, repeats, seed)
    order = np.random.default_rng(seed).permutation(len(rows))
    return [rows[place] for place in order]


def write(path: Path, rows: Rows, times: Sequence[float] | None = None) -> Path:
    header, _ = arm_table({}, 1)
    stamped = [[*row, float(n) if times is None else times[n]] for n, row in enumerate(rows)]
    return write_csv(path, [*header, "time [s]"], stamped)


def following(path: Path, model: Model = NOMINAL, learn: int = 20) -> Follower:
    return Follower(TableDoor(lambda: read_impact_table(path, PUSH), model), model, learnt=learn)


def changes(documents: Sequence[HitDocument]) -> list[Change]:
    return [document.change for document in documents if document.change is not None]


QUIET = rows_of({}, 7, seed=1)


@pytest.mark.parametrize(
    ("effect", "values", "sign", "hits"),
    [
        ("object_mass", [1.3], 1.0, 5),
        ("object_mass", [0.75], -1.0, 5),
        ("restitution", [0.2], 1.0, 5),
        ("pad_friction", [-0.4], -1.0, 8),  # shows only where the contact then slips
        ("end_effector_payload", [0.5, 0.0, 0.0, -0.04], 1.0, 5),
    ],
)
def test_a_step_is_found_within_some_hits_with_its_sign_and_size(
    tmp_path: Path, effect: str, values: list[float], sign: float, hits: int
) -> None:
    path = write(tmp_path / "hits.csv", QUIET + rows_of({effect: values}, 2, seed=2))
    follower = following(path)
    documents = list(follower.arrived())
    (change,) = changes(documents)
    found = [document.name for document in documents].index(change.hit) - len(QUIET) + 1
    assert 2 <= found <= hits  # one hit alone is never a change
    cause = change.causes[0]
    assert cause.effect == effect
    assert sign * cause.parameters[0].change > 0.0
    (believed,) = (one for one in follower.followed() if one.parameter == cause.parameters[0].parameter)
    half = believed.ci95[1] - believed.estimate
    assert abs(believed.estimate - values[0]) < 2.0 * half


def test_quiet_hits_are_no_change_and_are_predicted_as_the_intervals_say(tmp_path: Path) -> None:
    follower = following(write(tmp_path / "hits.csv", rows_of({}, 20, seed=3)))
    covered: list[bool] = []
    for hit in follower.door.arrived():
        if follower.watching:
            prediction = follower._predicted(follower.likeliest, hit)
            assert prediction is not None
            covered += (np.abs(hit.measured - prediction[0]) < 1.96 * np.sqrt(prediction[1])).tolist()
        assert not changes(follower.take([hit]))
    assert 0.93 < np.mean(covered) < 0.99


def test_a_likely_explanation_that_is_not_the_first_is_linearised_anew(tmp_path: Path) -> None:
    follower = following(write(tmp_path / "hits.csv", QUIET + rows_of({"object_mass": [1.5]}, 2, seed=2)))
    *hits, last = list(follower.door.arrived())
    for hit in hits:
        follower.take([hit])
    unlikely, likely = copy.copy(follower.likeliest), follower.likeliest
    unlikely.log_weight = likely.log_weight - 5.0
    follower.hypotheses, follower._mean_time = [unlikely, likely], 1e-9
    follower.take([last])
    assert follower.followed()[0].estimate == pytest.approx(1.5, abs=0.05)


def test_an_explanation_that_predicts_nothing_is_ruled_out_by_one_that_does(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    follower = following(write(tmp_path / "hits.csv", QUIET))
    *hits, first, second = list(follower.door.arrived())
    for hit in hits:
        follower.take([hit])
    seeing, blind = follower.likeliest, copy.copy(follower.likeliest)
    blind.point, blind.posterior = blind.point + 1e-9, blind.posterior.copy()
    seeing.log_weight, blind.log_weight = 0.0, -1.0
    follower.hypotheses, evidence = [seeing, blind], follower._evidence
    monkeypatch.setattr(
        follower, "_evidence", lambda hit, point, *rest: None if point is blind.point else evidence(hit, point, *rest)
    )
    follower.take([first])
    assert follower.likeliest is seeing and not follower.door.skipped
    assert follower.probabilities()[0] > 0.95
    follower.hypotheses = [blind]
    (document,) = follower.take([second])
    assert document.error is None and "predicts no impact" in follower.door.skipped[second.name]
    assert follower.hypotheses == [blind]


@pytest.mark.parametrize(("effect", "values"), [("pad_friction", [-0.5]), ("object_mass", [0.5])])
def test_large_changes_whose_sensitivities_bend_are_explained_by_their_effect_in_the_end(
    tmp_path: Path, effect: str, values: list[float]
) -> None:
    """By first-order sensitivities another effect explains the first hits better."""
    follower = following(write(tmp_path / "hits.csv", QUIET + rows_of({effect: values}, 2, seed=2)))
    documents = list(follower.arrived())
    assert follower.likeliest.effect == effect
    late = [document.error for document in documents[-3:]]
    assert max(error for error in late if error is not None) < 1.6


def test_one_odd_hit_is_no_change_and_moves_the_prediction_little(tmp_path: Path) -> None:
    odd = rows_of({"restitution": [0.4]}, 1, seed=4)[:1]
    quiet = rows_of({}, 2, seed=5)
    follower = following(write(tmp_path / "hits.csv", QUIET + odd + quiet))
    documents = list(follower.arrived())
    assert not changes(documents)
    place = len(QUIET)
    assert documents[place].odd
    assert documents[place].error is not None and documents[place].error > 5.0
    assert all(document.error is not None and document.error < 2.0 for document in documents[place + 1 :])


def test_what_the_model_states_with_an_interval_is_sharpened_and_a_wrong_value_is_moved(tmp_path: Path) -> None:
    model = load_model(_model(tmp_path / "m.yaml", 1.2, (1.05, 1.35)))
    follower = following(write(tmp_path / "hits.csv", rows_of({"object_mass": [1.25]}, 8, seed=6)), model)
    assert not changes(list(follower.arrived()))
    (mass,) = follower.followed()
    assert mass.parameter == "object_mass.scale"
    assert mass.ci95[1] - mass.ci95[0] < 0.5 * (1.35 - 1.05)
    assert abs(mass.estimate - 1.25) < abs(mass.estimate - 1.2)


def _model(path: Path, scale: float, interval: tuple[float, float]) -> Path:
    path.write_text(
        "name: m\neffects:\n- name: object_mass\n  parameters:\n    scale:\n"
        f"      estimate: {scale}\n      unit: '-'\n      ci95: [{interval[0]}, {interval[1]}]\n"
    )
    return path


def test_a_slow_drift_is_followed_with_its_sign(tmp_path: Path) -> None:
    rows = list(QUIET)
    for number in range(60):
        rows += rows_of({"restitution": [0.3 * number / 60.0]}, 1, seed=100 + number)[:1]
    follower = following(write(tmp_path / "hits.csv", rows))
    documents = list(follower.arrived())
    found = changes(documents)
    named = [change for change in found if change.causes[0].effect == "restitution"]
    assert len(named) >= max(2, len(found) - 1) and found[0] is named[0]  # one of five may have another name
    assert all(change.causes[0].parameters[0].change > 0.0 for change in named)
    assert all(change.again for change in named[1:])
    late = [document for document in documents[-20:] if document.error is not None and document.of_model is not None]
    followed, frozen = (np.mean([getattr(d, name) for d in late]) for name in ("error", "of_model"))
    assert followed < 0.5 * frozen


def test_a_sensor_that_drifts_slowly_is_no_change(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The scale of all velocities after the impact, by 2 % over 240 hits."""
    header, _ = arm_table({}, 1)
    after = [place for place, name in enumerate(header) if "after" in name]
    rows = rows_of({}, 40, seed=1)
    for number, row in enumerate(rows):
        for place in after:
            row[place] = float(str(row[place])) * (1.0 + 0.02 * number / len(rows))
    path = write(tmp_path / "hits.csv", rows)
    assert not changes(list(following(path).arrived()))
    monkeypatch.setattr(posterior, "DRIFT", 1e-9)
    assert changes(list(following(path).arrived()))


def test_the_order_of_simultaneous_rows_and_of_effects_does_not_matter(tmp_path: Path) -> None:
    rows = QUIET + rows_of({"object_mass": [1.3]}, 1, seed=7)
    times = [float(number // 3) for number in range(len(rows))]
    first = following(write(tmp_path / "a.csv", rows, times))
    list(first.arrived())
    shuffled = sorted(range(len(rows)), key=lambda n: (n // 3, -n))
    second = following(write(tmp_path / "b.csv", [rows[n] for n in shuffled], times))
    list(second.arrived())
    one, other = first.followed(), second.followed()
    assert [own.parameter for own in one] == [own.parameter for own in other] == ["object_mass.scale"]
    np.testing.assert_allclose(one[0].estimate, other[0].estimate, rtol=1e-6)


def test_rows_that_are_not_in_time_order_are_taken_in_time_order(tmp_path: Path) -> None:
    rows = QUIET + rows_of({"object_mass": [1.3]}, 1, seed=7)
    order = np.random.default_rng(0).permutation(len(rows)).tolist()
    follower = following(write(tmp_path / "hits.csv", [rows[n] for n in order], [float(n) for n in order]))
    (change,) = changes(list(follower.arrived()))
    assert change.since_time is not None and change.since_time >= len(QUIET) - 1


def test_a_later_run_goes_on_from_the_state_as_if_it_had_never_ended(tmp_path: Path) -> None:
    rows = QUIET + rows_of({"object_mass": [1.3]}, 2, seed=8)
    whole = following(write(tmp_path / "all.csv", rows))
    expected = {document.name: document for document in whole.arrived()}
    path, state = tmp_path / "hits.csv", tmp_path / "state.npz"
    for end in (10, 30, len(QUIET) + 1, len(QUIET) + 2, len(QUIET) + 5, len(rows)):
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


def test_a_state_of_another_model_or_no_state_is_refused_with_its_name(tmp_path: Path) -> None:
    path, state = write(tmp_path / "hits.csv", QUIET), tmp_path / "state.npz"
    follower = following(path)
    list(follower.arrived())
    save_state(follower, state)
    other = load_model(_model(tmp_path / "m.yaml", 1.2, (1.0, 1.4)))
    with pytest.raises(InputError, match="another model"):
        restore_state(following(path, other), state)
    state.write_bytes(b"no archive")
    with pytest.raises(InputError, match="not a state file"):
        restore_state(following(path), state)


def test_a_row_that_the_state_needs_and_is_gone_is_named(tmp_path: Path) -> None:
    path, state = write(tmp_path / "hits.csv", QUIET), tmp_path / "state.npz"
    follower = following(path)
    list(follower.arrived())
    save_state(follower, state)
    write(path, QUIET[:-1])
    with pytest.raises(InputError, match=f"row {len(QUIET)}, which the state knows, is gone"):
        restore_state(following(path), state)


def test_the_followed_model_predicts_as_the_follower_does(tmp_path: Path) -> None:
    path = write(tmp_path / "hits.csv", QUIET + rows_of({"object_mass": [1.3]}, 3, seed=9))
    follower = following(path)
    list(follower.arrived())
    save_model(follower.model_now("now", "nominal.yaml"), tmp_path / "now.yaml")
    again = following(write(tmp_path / "after.csv", rows_of({"object_mass": [1.3]}, 6, seed=10)), learn=20)
    again = Follower(again.door, model := load_model(tmp_path / "now.yaml"), learnt=20)
    assert [item.name for item in model.effects] == ["object_mass"]
    assert not changes(list(again.arrived()))


def test_the_next_hit_of_each_condition_is_predicted_with_its_unit(tmp_path: Path) -> None:
    follower = following(write(tmp_path / "hits.csv", QUIET))
    assert follower.prediction() is None
    hits = {hit.condition for hit in follower.door.arrived() if follower.take([hit])}
    for condition in hits:
        prediction = follower.prediction(condition)
        assert prediction is not None and prediction.condition == condition
        assert {value.unit for value in prediction.values} == {"rad/s", "m/s"}
        assert all(low < value.value < high for value in prediction.values for low, high in [value.ci95])


@pytest.fixture(scope="module")
def day(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Pushes on the plant; after the first twelve the object is a quarter heavier, and joints rub."""
    folder = tmp_path_factory.mktemp("day")
    spec = TrialSpec.of(PUSH, "juice", "case_2")
    for repeat in range(16):
        trial = Trial.of(spec, repeat, 3)
        physics = spec.plan.scene.physics
        if repeat >= 12:
            physics = library()["object_mass"].apply_vector(physics, np.array([1.25]))
        info = TrialInfo.of(spec.plan, trial.key, trial.seed, VIA["bullet"])
        record_trial(spec.plan, info, folder / trial.key.name, physics)
    return folder


def test_trials_and_tables_tell_the_same_change(day: Path, tmp_path: Path) -> None:
    """The same change of the plant, by the replay of trials, and of a rigid map, by its table."""
    trials = Follower(BagDoor(day, NOMINAL, ReplayCache(map)), NOMINAL, ["object_mass", "restitution"], learnt=12)
    table = following(write(tmp_path / "hits.csv", QUIET + rows_of({"object_mass": [1.25]}, 1, seed=2)))
    for follower in (trials, table):
        (change,) = changes(list(follower.arrived()))
        assert change.causes[0].effect == "object_mass"
        (mass,) = follower.followed()
        assert mass.estimate == pytest.approx(1.25, abs=0.03)


def test_the_next_hit_after_a_free_motion_is_one_with_an_impact(hidden_campaign: Path) -> None:
    follower = Follower(BagDoor(hidden_campaign, NOMINAL, ReplayCache(map)), NOMINAL, ["object_mass"], learnt=4)
    hits = list(follower.door.arrived())
    pushes = [hit for hit in hits if hit.hits]
    assert len(pushes) == 4
    for hit in [*pushes, *(hit for hit in hits if not hit.hits)]:
        follower.take([hit])
    prediction = follower.prediction()
    assert prediction is not None and prediction.like == pushes[-1].name
    assert {"impact", "push"} <= {value.phase for value in prediction.values}


def test_bags_are_read_when_they_are_due(day: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    read: list[str] = []
    monkeypatch.setattr(hits, "read_trial", lambda path: (read.append(path.name), read_trial(path))[1])
    door = BagDoor(day, NOMINAL, ReplayCache(map))
    arriving = door.arrived()
    assert next(arriving).name.endswith("r0") and len(read) == 1 and door.waiting == 15
    assert next(arriving).name.endswith("r1") and len(read) == 2 and door.waiting == 14


def test_where_measured_trials_do_not_decide_one_that_was_not_measured_is_proposed(
    day: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    follower = Follower(BagDoor(day, NOMINAL, ReplayCache(map)), NOMINAL, ["object_mass", "restitution"], learnt=12)
    list(follower.arrived())
    heavier, bouncing = follower.likeliest, copy.copy(follower.likeliest)
    bouncing.effect, bouncing.point = "restitution", np.array([1.0, 0.3])
    bouncing.posterior = Posterior.of([], np.array([]))
    follower.hypotheses = [heavier, bouncing]
    few = PUSH.model_copy(update={"objects": {"juice": PUSH.objects["juice"]}})
    follower.door._scenarios = {"push": few}  # type: ignore[attr-defined]
    measured = [hit.name for hit in follower._last.values()]
    assert follower._apart().startswith("one hit of push/juice/case_2 distinguishes them (")
    forecast = follower._forecast
    monkeypatch.setattr(follow, "CHECKS", ())
    monkeypatch.setattr(follower, "_forecast", lambda one, hit: None if hit.name in measured else forecast(one, hit))
    assert " of push/juice/case_" in (words := follower._apart())
    assert words.startswith("a hit of push/juice/case_") and ", not measured yet, distinguishes them (" in words
    monkeypatch.setattr(follower.door, "unmeasured", lambda _: iter(()))
    assert follower._apart() == "no hit of these kinds and nothing that can be measured without one distinguishes them"


@pytest.fixture
def tied(tmp_path: Path) -> Follower:
    """An object 30 % heavier, or else a support with 0.2 more friction: nothing is known beside that."""
    follower = following(write(tmp_path / "hits.csv", QUIET + rows_of({"object_mass": [1.3]}, 2, seed=2)))
    list(follower.arrived())
    heavier, rubbing = follower.likeliest, copy.copy(follower.likeliest)
    assert follower.candidate is not None
    point = follower.candidate.nominal.copy()
    point[follower.candidate.part("support_friction")] = 0.2
    rubbing.effect, rubbing.point, rubbing.log_weight = "support_friction", point, heavier.log_weight - 0.5
    rubbing.posterior = Posterior.of([], np.array([]))
    follower.hypotheses = [heavier, rubbing]
    return follower


def test_mass_and_friction_that_no_hit_tells_apart_are_told_apart_by_a_lift(
    tied: Follower, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tied, "_forecast", lambda *_: None)
    mass = tied._last[""].physics.object.mass
    weights = [9.81 * mass * tied.followed()[0].estimate, 9.81 * mass]
    expected = f"{weights[0]:.3g} N if object_mass, {weights[1]:.3g} N if support_friction"
    assert tied._apart() == f"one measurement, lift the object, distinguishes them ({expected})"


def test_a_cause_whose_size_is_not_known_is_not_told_apart_by_a_lift(
    tied: Follower, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tied, "_forecast", lambda *_: None)
    heavier = tied.hypotheses[0]
    heavier.posterior = Posterior.of(heavier.posterior.followed, np.array([100.0]))
    heavier.point[tied.candidate.part("object_mass")] = 1.3  # type: ignore[union-attr]
    assert "lift the object" not in tied._apart()


def test_hits_at_other_speeds_are_proposed_where_those_at_hand_do_not_decide(
    tied: Follower, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(follow, "CHECKS", ())
    forecast = tied._forecast
    monkeypatch.setattr(tied, "_forecast", lambda one, hit: forecast(one, hit) if "speed" in hit.condition else None)
    words = tied._apart()
    assert " at twice the speed, not measured yet, distinguishes them (" in words
    (fast, slow) = list(tied.door.unmeasured([tied._last[""]]))
    assert fast.measured == pytest.approx(4.0 * slow.measured)


def test_hits_since_a_change_are_enough_for_a_diagnosis_with_three_conditions_and_three_repeats() -> None:
    assert not HitsSince("a", ("a", "b", "a", "b", "a", "b", "a")).diagnosable
    assert not HitsSince("a", ("a", "b", "c", "a", "b")).diagnosable
    assert HitsSince("a", ("a", "b", "c", "a", "b", "c")).diagnosable
    assert not HitsSince("a", ("",) * 5).diagnosable and HitsSince("a", ("",) * 6).diagnosable


def test_a_state_that_is_saved_between_hits_loses_none_and_announces_each_change(tmp_path: Path) -> None:
    """Simultaneous hits belong together: state is never saved before all of them were handed over."""
    rows = QUIET + rows_of({"object_mass": [1.3]}, 2, seed=8)
    path = write(tmp_path / "hits.csv", rows, [float(number // 3) for number in range(len(rows))])
    whole = [document.name for document in following(path).arrived()]
    state, reported = tmp_path / "state.npz", []
    found: list[Change] = []
    for _ in range(len(rows)):  # killed in the middle of every fifth instant
        follower = following(path)
        if state.exists():
            restore_state(follower, state)
        own = list(islice(follower.arrived(partial(save_state, follower, state)), 13))
        reported += [document.name for document in own]
        found += changes(own)
        if len(own) < 13:
            break
    assert set(reported) == set(whole)
    assert {change.hit for change in found} == {change.hit for change in changes(list(following(path).arrived()))}


def test_a_table_without_conditions_is_followed(tmp_path: Path) -> None:
    path = write(tmp_path / "hits.csv", QUIET + rows_of({"restitution": [0.2]}, 1, seed=2))
    with path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.reader(file))
    place = rows[0].index("condition")
    bare = write_csv(path, [n for n in rows[0] if n != "condition"], [r[:place] + r[place + 1 :] for r in rows[1:]])
    (change,) = changes(list(following(bare).arrived()))
    assert change.causes[0].effect == "restitution"


def test_a_misfit_that_wears_in_and_no_effect_explains_is_predicted_from_recent_hits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The object seems to turn about an axis that no contact here can turn it about, more and more."""
    rows = rows_of({}, 12, seed=3)
    for number, row in enumerate(rows):
        row[-3] = float(str(row[-3])) + 0.6 * max(number - 25, 0) / len(rows)
    path = write(tmp_path / "hits.csv", rows)

    def late() -> float:
        documents = [one for one in following(path).arrived() if one.error is not None]
        return float(np.sqrt(np.mean([one.error**2 for one in documents[-25:] if one.error is not None])))

    corrected = late()
    monkeypatch.setattr(recent_residuals, "LEAD", 1e9)
    assert corrected < 0.85 * late()
