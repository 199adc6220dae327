# SPDX-License-Identifier: Apache-2.0
"""Trials simulated on the twin, and what a plan makes of them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from impact_rs_analysis.design.design import missing_effect, planned
from impact_rs_analysis.design.discrimination import Discrimination
from impact_rs_analysis.design.explanations import Decision, Explanation, estimated, which_effect
from impact_rs_analysis.design.forecast import Forecast, forecast_of, largest_force
from impact_rs_analysis.design.possible_trials import Envelope, PossibleTrial, possible_trials
from impact_rs_analysis.evidence.replays.measured_runs import read_runs
from impact_rs_analysis.evidence.replays.replay_cache import ReplayCache
from impact_rs_sim.effects import library
from impact_rs_sim.errors import InputError
from impact_rs_sim.model import load_model

WANTED = (
    "excite/none/fast",
    "push/juice/case_1",
    "push/juice/case_2",
    "push/juice/case_3_700mm_s",
    "push_beside/juice/case_2",
)


def some(names: tuple[str, ...] = WANTED) -> list[PossibleTrial]:
    return [trial for trial in possible_trials(["push", "excite"]) if trial.name in names]


@pytest.fixture(scope="module")
def forecast() -> Forecast:
    return forecast_of(load_model("nominal"), some(), ReplayCache(map))


def between(forecast: Forecast, *names: str) -> Decision:
    effects = [library()[name] for name in names]
    return which_effect(effects, forecast.source.joints, forecast.source.worlds)


@pytest.mark.slow
def test_whether_any_effect_is_missing_asks_for_none_by_name(forecast: Forecast) -> None:
    """Each effect against the model as it is, and no two against each other."""
    names = ("object_mass", "support_friction", "restitution")
    every, any_ = (missing_effect(names, whether_any)(forecast.source) for whether_any in (False, True))
    assert every.explanations == any_.explanations and len(every.pairs) == 6
    assert any_.pairs == ((0, 1), (0, 2), (0, 3))


def test_friction_of_the_pad_shows_where_the_pad_slips() -> None:
    """A square hit sticks, and a change of 0.1 of the coefficient changes next to nothing."""
    names = ("push/juice/case_2", "push_from_right/juice/case_2_right")
    own = forecast_of(load_model("nominal"), some(names), ReplayCache(map))
    decision = missing_effect(("pad_friction",))(own.source)
    trials = own.under(decision)
    counts = Discrimination(decision, trials)
    square, slanted = (float(counts.probabilities(counts.total({name: 2}))[0]) for name in names)
    assert square < 0.7 and slanted > 0.9


def test_what_the_arm_cannot_do_is_no_proposal(forecast: Forecast) -> None:
    assert [name for name, _ in forecast.refused] == ["push/juice/case_3_700mm_s"]
    decision = between(forecast, "object_mass")
    assert "push/juice/case_3_700mm_s" not in [trial.name for trial in forecast.under(decision)]
    plan = planned(forecast, decision, 12)
    assert plan.trials == 12
    assert "case_3_700mm_s" not in [one.case for campaign in plan.campaigns for one in campaign.conditions]


def test_a_speed_beyond_the_joints_and_a_force_beyond_the_cell_are_refused() -> None:
    fast = [t for t in possible_trials(["excite"], Envelope(speed=3.0)) if t.new_case is not None]
    assert fast
    with pytest.raises(InputError, match="within the limits.*(LIMIT|INFEASIBLE|DIVERGED|limit)"):
        forecast_of(load_model("nominal"), fast[:1], ReplayCache(map))
    with pytest.raises(InputError, match="contact force .* limit 1 N"):
        forecast_of(load_model("nominal"), some(("push/juice/case_2",)), ReplayCache(map), Envelope(force=1.0))


def test_the_largest_force_is_the_size_of_the_vector(forecast: Forecast) -> None:
    """Kills: the largest Cartesian component, below the force of an oblique hit by up to a factor of sqrt(3)."""
    runs = {run.condition: run for run in forecast.source.runs.runs}
    hit, free = runs["push/juice/case_2"], runs["excite/none/fast"]
    force = {("x", 1): 3.0, ("y", 1): -4.0, ("z", 1): 12.0, ("x", 2): 12.5}
    found = [force.get((f.index, f.bin), 1.0) * (f.signal == "contact force") for f in hit.features]
    assert largest_force(replace(hit, measured=np.array(found))) == pytest.approx(13.0)
    assert largest_force(free) == 0.0


def test_a_heavier_object_shows_in_pushes_alone_and_leaves_less_speed(forecast: Forecast) -> None:
    mass = Explanation("heavier", (("object_mass", (1.2,)),))
    trials = {trial.name: trial for trial in forecast.under(Decision.between([Explanation("as is"), mass], "rivals"))}
    assert not trials["excite/none/fast"].centres.any()
    push = trials["push/juice/case_2"]
    moved = {
        (f.signal, f.index): change
        for f, change in zip(push.cluster.features, push.centres[1], strict=True)
        if f.phase == "impact" and f.bin == 0
    }
    assert moved["object velocity", "y"] > 0.0  # it goes along -y
    assert moved["end-effector velocity", "y"] > 0.0


def test_friction_and_offset_are_distinguished_by_a_motion_there_and_back(forecast: Forecast) -> None:
    decision = between(forecast, "joint_coulomb_friction", "torque_offset")
    counts = Discrimination(decision, forecast.under(decision))
    pair = decision.pairs.index((1, 2))
    push, excite = (
        counts.probabilities(counts.total({name: 4}))[pair] for name in ("push/juice/case_2", "excite/none/fast")
    )
    assert excite > push + 0.03


def test_noise_of_the_scenario_is_the_scatter_of_a_plan(forecast: Forecast) -> None:
    for item in forecast.source.clusters:
        assert np.all(item.pure_error > 0.0)
        assert 0.05 < np.sqrt(np.mean(np.square(item.pure_error))) < 1.0


def test_trials_measured_so_far_count(forecast: Forecast, hidden_campaign: Path) -> None:
    runs = read_runs(hidden_campaign, map)
    again = forecast_of(load_model("nominal"), some(), ReplayCache(map), runs=runs)
    assert sum(again.repeats.values()) == len(runs.runs)
    decision = between(again, "object_mass", "support_friction")
    counts = Discrimination(decision, again.under(decision))
    assert counts.measured == {name: len(group) for name, group in runs.conditions.items()}
    before = counts.probabilities(counts.total(counts.measured))
    assert np.any(before > 0.6)
    plan = planned(again, decision, 2)
    assert plan.trials == 2
    assert all(pair.after >= pair.before for pair in plan.pairs)


def test_an_estimate_keeps_its_deviations_within_its_bounds(forecast: Forecast) -> None:
    one = estimated(
        "friction", (("support_friction", (0.05,)),), {"support_friction": np.array([0.1])},
        {"support_friction": (np.array([0.0]), np.array([1.0]))},
    )  # fmt: skip
    assert one.varied == (((("support_friction", (pytest.approx(0.15),))),),)
    known = estimated("known", one.centre, {"support_friction": np.zeros(1)}, {"support_friction": (np.zeros(1),) * 2})
    assert known.varied == ()


def test_the_plan_says_what_each_condition_adds(forecast: Forecast) -> None:
    decision = between(forecast, "joint_coulomb_friction", "torque_offset")
    plan = planned(forecast, decision, 8)
    conditions = [one for campaign in plan.campaigns for one in campaign.conditions]
    assert all(f"{one.trials} x {one.what}" in one.buys and "without them" in one.buys for one in conditions)
    assert any("there and back" in one.what for one in conditions)
    assert [pair.after for pair in plan.pairs] == sorted(pair.after for pair in plan.pairs)


def test_an_effect_that_no_possible_trial_shows_is_named_and_not_planned_for(forecast: Forecast) -> None:
    """A drift over a campaign changes no single trial. Kills its pairs, which no plan could distinguish."""
    plan = planned(forecast, between(forecast, "object_mass", "support_friction", "torque_sensor_drift"), 6)
    assert "no possible trial shows torque_sensor_drift" in plan.summary
    assert not any("torque_sensor_drift" in (pair.first, pair.second) for pair in plan.pairs)
    assert len(plan.pairs) == 3
