# SPDX-License-Identifier: Apache-2.0
"""Speed limits obey the physics of hits: closed forms, and what makes an arm hit slower."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from scipy.stats import norm

from impact_rs_analysis.limits import drawn_hits
from impact_rs_analysis.limits.drawn_hits import Hits, drawn_springs, observed
from impact_rs_analysis.limits.hit_bounds import Bounds, Thresholds, bounds_of
from impact_rs_analysis.limits.poses import LimitTask, limit_of, moved
from impact_rs_analysis.limits.speed import SpeedLimit, speed_limit
from impact_rs_cli.main import main
from impact_rs_sim.errors import InputError
from impact_rs_sim.impact_map import ImpactProblem, compute_impact_map
from impact_rs_sim.proportion import reach_of
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_sim.scenarios.trial_settings import Uncertainties
from impact_rs_sim.scene import ArmMotion, Scene

FRICTIONLESS = {"contact.friction": 0.0, "support.friction": 0.0}
EXACT = Uncertainties(**dict.fromkeys(Uncertainties.model_fields, 0.0))
DRAWS = 40


def scene_of(item: str = "cat_food", **settings: Any) -> Scene:
    return Scene.resolve(load_scenario("push").with_settings(settings), item, "case_1")


def limit(scene: Scene, thresholds: Thresholds, draws: int = 0, wider: float = 0.0) -> SpeedLimit:
    """Without draws: of the nominal hit; ``wider``: half the widths of the scenario times this."""
    stated = EXACT.model_copy(update={key: wider * width for key, width in scene.scenario.uncertainty})
    return speed_limit(Hits(scene, thresholds, stated, draws))


def test_the_jump_of_a_frictionless_hit_is_proportional_and_the_limit_is_bound_over_slope() -> None:
    hits = Hits(scene_of(**FRICTIONLESS), Thresholds())
    jumps = np.array(hits.bounds.kinds) == "jump"
    slope = hits.values(1.0)[0, jumps].max() / hits.speed
    assert hits.speed == pytest.approx(0.5)  # m/s, along the normal
    for bound in (0.1, 0.2, 0.4):
        found = limit(hits.scene, Thresholds(velocity_jump=bound)).by_kind["jump"]
        assert found == pytest.approx(bound / slope, rel=0.02)
    np.testing.assert_allclose(hits.values(3.0)[0, jumps].max(), 3.0 * slope * hits.speed, rtol=0.04)


def test_a_stiff_arm_with_a_damped_pad_jumps_as_the_rigid_impact_map_says_and_a_pad_that_bounces_adds_to_it() -> None:
    scene = scene_of("juice", **FRICTIONLESS, **{"timing.drive_period": 2.5e-5})
    (state,), (arm,) = scene.arms.values(), scene.physics.arms.values()
    (after,) = compute_impact_map(ImpactProblem.at_nominal_impact(scene)).joint_velocity.values()
    rigid = np.abs(after - state.velocity).max()

    def jump(pad_damping: float) -> float:
        pad = pad_damping * arm.pad_damping
        stiff = replace(arm, stiffness=100.0 * arm.stiffness, damping=10.0 * arm.damping, pad_damping=pad)
        hits = Hits(replace(scene, physics=replace(scene.physics, arms={"arm": stiff})), Thresholds())
        return float(hits.values(1.0)[0, np.array(hits.bounds.kinds) == "jump"].max())

    assert jump(30.0) == pytest.approx(rigid, rel=0.03)
    assert jump(1.0) > 1.2 * rigid


def test_a_harder_gear_allows_more_and_a_heavier_object_less() -> None:
    thresholds = Thresholds(velocity_jump=0.3, external_torque=40.0, external_force=150.0)
    parcel, juice = (limit(scene_of(item), thresholds) for item in ("parcel", "juice"))
    for kind in ("jump", "reflex", "force"):
        assert juice.by_kind[kind] < 0.9 * parcel.by_kind[kind], kind
    assert juice.speed < parcel.speed
    twice = limit(scene_of("juice"), Thresholds(0.6, 80.0, 300.0))
    assert twice.by_kind["jump"] == pytest.approx(2.0 * juice.by_kind["jump"], rel=0.03)
    assert 1.5 < twice.by_kind["force"] / juice.by_kind["force"] < 2.5  # the support's friction does not double


def test_a_wider_uncertainty_allows_less() -> None:
    thresholds = Thresholds(velocity_jump=0.3, external_torque=40.0)
    exact, stated, wide = (
        limit(scene_of(), thresholds, draws, wider) for draws, wider in ((0, 0.0), (DRAWS, 1.0), (DRAWS, 3.0))
    )
    for kind in ("jump", "reflex"):
        assert wide.by_kind[kind] < stated.by_kind[kind] < exact.by_kind[kind], kind
    assert stated.speed < stated.median


def test_the_limit_is_that_speed_at_which_99_of_100_draws_keep_every_bound() -> None:
    """Ratios v g with g normal, in closed form 1 / Q_0.99(g); kills another level, and a quantile of the wrong side."""

    class Proportional:
        scene, speed = scene_of(), 0.5
        bounds = Bounds(("a", "b"), ("jump", "force"), ("rad/s", "N"), np.ones(2))
        slopes = np.column_stack((norm.ppf((np.arange(1000) + 0.5) / 1000, 0.8, 0.1), np.full(1000, 0.2)))
        ratios_at_rest = np.zeros_like(slopes)

        def ratios(self, scale: float) -> np.ndarray:
            return scale * self.slopes

    found = speed_limit(cast(Hits, Proportional()))
    assert found.speed == found.by_kind["jump"] == pytest.approx(0.5 / norm.ppf(0.99, 0.8, 0.1), rel=2e-3)
    assert found.median == pytest.approx(0.5 / 0.8, rel=2e-3)
    assert found.by_kind["force"] == pytest.approx(0.5 / 0.2, rel=1e-3) and found.binding == "a"


@pytest.mark.parametrize("planned", [0.01, 0.5, 3.0])
def test_the_limit_of_every_kind_is_simulated_whatever_speed_is_planned(planned: float) -> None:
    """Of y = v + v^2 / 2 and its multiples; kills a kind extrapolated from the joint search, and a plan as its cap."""

    class Bent:
        scene, speed = scene_of(), planned
        bounds = Bounds(("a", "b", "c"), ("jump", "force", "reflex"), ("rad/s", "N", "N m"), np.ones(3))
        ratios_at_rest = np.zeros((1, 3))

        def ratios(self, scale: float) -> np.ndarray:
            v = scale * self.speed
            return (v + 0.5 * v**2) * np.array([[4.0, 0.5, 0.01]])

    found = speed_limit(cast(Hits, Bent()))
    exact = {"jump": np.sqrt(1.5) - 1.0, "force": np.sqrt(5.0) - 1.0, "reflex": np.inf}
    assert found.by_kind == pytest.approx(exact, rel=0.01)
    assert found.speed == found.by_kind["jump"]


def test_draws_scatter_by_the_discrepancy_of_the_twin_and_by_springs_as_stated(monkeypatch: pytest.MonkeyPatch) -> None:
    """Jumps by share v_n / l, logarithms of others by their share, springs by theirs; kills widths times two."""
    scene = scene_of()
    (arm,), rng = scene.physics.arms.values(), np.random.default_rng(0)
    springs = np.array([drawn_springs(arm, rng).stiffness / arm.stiffness for _ in range(200)])
    assert springs.std() == pytest.approx(drawn_hits.STIFFNESS_HALF_WIDTH / 1.96, rel=0.1)
    for name in ("STIFFNESS_HALF_WIDTH", "DAMPING_HALF_WIDTH"):
        monkeypatch.setattr(drawn_hits, name, 0.0)
    hits = Hits(scene, Thresholds(velocity_jump=0.3), EXACT, 60)
    values, kinds = hits.values(1.0), np.array(hits.bounds.kinds)

    def largest(kind: str) -> np.ndarray:
        own = values[:, kinds == kind]
        return np.asarray(own[:, own.mean(axis=0).argmax()])

    share = drawn_hits.JUMP_SHARES["square"] * hits.speed / reach_of(arm.facts)
    assert largest("jump").std(ddof=1) == pytest.approx(share, rel=0.4)
    for kind, width in drawn_hits.PEAK_SHARES.items():
        assert np.log(largest(kind)).std(ddof=1) == pytest.approx(width, rel=0.4), kind


def test_the_approach_itself_respects_the_speed_limits_of_joints() -> None:
    scene = scene_of()
    (state,), (model,) = scene.arms.values(), scene.models.values()
    found = limit(scene, Thresholds())
    assert 0.9 * found.planned < found.by_kind["speed"]
    assert found.by_kind["speed"] <= found.planned / np.abs(state.velocity / model.velocity_max).max() * 1.001


def test_an_arm_that_cannot_carry_itself_may_not_hit_at_all() -> None:
    scenario = load_scenario("push")
    facts = scenario.robots["arm"].robot_facts
    weak = facts.limits.model_copy(update={"torque_Nm": tuple(0.05 * torque for torque in facts.limits.torque_Nm)})
    arm = scenario.robots["arm"].model_copy(update={"facts": facts.model_copy(update={"limits": weak})})
    found = limit(Scene.resolve(scenario.model_copy(update={"robots": {"arm": arm}}), "juice", "1"), Thresholds())
    assert found.speed == found.by_kind["torque"] == 0.0
    assert "joint torque" in found.binding


def test_the_observer_sees_an_external_torque_behind_its_filter() -> None:
    """A torque tau_ext from 5 ms on, links that it alone accelerates: r = tau_ext (1 - exp(-k t))."""
    (model,) = scene_of().models.values()
    q, gain, period = np.array(load_scenario("push").robots["arm"].impact.joint_guess), 500.0, 2.5e-4
    external = np.linspace(-20.0, 30.0, model.joint_count)
    time = np.arange(200) * period
    since = np.maximum(time - 0.005, 0.0)[:, None]
    velocity = since * np.linalg.solve(model.mass_matrix(q), external)
    torque = np.tile(model.gravity_torque(q), (200, 1))
    seen = observed(model, q, time, ArmMotion(velocity, velocity, torque, velocity, velocity), gain)
    expected = external * (1.0 - np.exp(-gain * since))
    np.testing.assert_allclose(seen, expected, atol=0.07 * np.abs(external).max())  # one period of 1/k is 12 %
    np.testing.assert_allclose(seen[-1], external, rtol=1e-3)


def test_joint_torque_alone_is_no_external_torque() -> None:
    """A motor that accelerates the links: M dq = int (tau_J - tau_J0), and the observer sees nothing."""
    (model,) = scene_of().models.values()
    q, period = np.array(load_scenario("push").robots["arm"].impact.joint_guess), 2.5e-4
    time = np.arange(100) * period
    driven = np.sin(200.0 * time)[:, None] * np.ones(model.joint_count)
    passed = np.vstack((np.zeros_like(driven[:1]), np.cumsum(driven[:-1], axis=0))) * period
    velocity = passed @ np.linalg.inv(model.mass_matrix(q))
    motion = ArmMotion(velocity, velocity, model.gravity_torque(q) + driven, velocity, velocity)
    assert np.abs(observed(model, q, time, motion, 500.0)).max() < 1e-9


def test_thresholds_of_the_scenario_or_the_robot_file_are_taken_and_what_they_lack_is_named() -> None:
    scenario = load_scenario("push_fr3")
    fr3 = Scene.resolve(scenario, "parcel", "1")
    of_file = {"arm": scenario.robots["arm"].model_copy(update={"reflexes": None})}
    of_facts = Scene.resolve(scenario.model_copy(update={"robots": of_file}), "parcel", "1")
    for scene, joint_1 in ((fr3, 100.0), (of_facts, 35.0)):  # N m
        found = bounds_of(scene.physics)
        assert found.unknown == ("jump",)
        assert found.values[list(found.kinds).index("reflex")] == joint_1
    assert bounds_of(scene_of().physics).unknown == ("jump", "reflex", "force")
    assert bounds_of(fr3.physics, Thresholds(0.5, 80.0, 200.0)).unknown == ()


def test_a_hit_is_moved_with_its_object_and_support_and_out_of_reach_has_no_limit() -> None:
    scenario = load_scenario("push")
    before, after = (Scene.resolve(one, "juice", "1") for one in (scenario, moved(scenario, 0.05, -0.03)))
    np.testing.assert_allclose(after.object.position - before.object.position, [0.05, 0.0, -0.03], atol=1e-9)
    far = limit_of(LimitTask(scenario, "juice", "1", x=2.0, draws=2))
    assert far.limit is None
    assert "nearest pose" in far.reason


def test_two_arms_have_one_limit_and_bounds_of_both() -> None:
    scene = Scene.resolve(load_scenario("grab"), "parcel", "1")
    hits = Hits(scene, Thresholds(velocity_jump=0.5))
    assert {name.split()[0] for name in hits.bounds.names} == {"left", "right"}
    assert 0.0 < speed_limit(hits).by_kind["jump"] < 2.0


def test_the_command_writes_page_table_and_document(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    line = ["limits", "push_fr3", "--objects", "juice", "--cases", "1", "--draws", "20", "--jobs", "1", "--json"]
    assert main([*line, "--places", "2", "--jump", "0.5", "-o", str(tmp_path / "out")]) == 0
    document = json.loads(capsys.readouterr().out)
    assert json.loads((tmp_path / "out" / "limits.json").read_text()) == document
    (found,) = document["limits"]
    assert found["without_bound"] == []
    assert found["limit_m_s"] <= min(found["by_kind_m_s"].values()) + 1e-3
    assert len(document["places"]) == 4
    rows = (tmp_path / "out" / "limits.csv").read_text().splitlines()
    assert rows[0].startswith("object,case,x [m],z [m],planned [m/s],limit [m/s],jump [m/s]")
    assert len(rows) == 2 + sum(place["limit"] is not None for place in document["places"])
    page = (tmp_path / "out" / "limits.html").read_text()
    assert "How fast may push_fr3 hit?" in page and f"{found['limit_m_s']:.3f}" in page


@pytest.mark.parametrize(
    ("line", "said"),
    [
        (["push", "--jump", "0"], "argument --jump: expected a number above 0, got 0"),
        (["push", "--places", "99"], "argument --places: expected 0 to 25"),
        (["excite"], "object_gap"),
        (["push", "--objects", "brick"], "has no object 'brick'"),
    ],
)
def test_a_mistake_is_one_line(line: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["limits", *line]) == 2
    assert said in capsys.readouterr().err


def test_a_pad_that_goes_away_from_the_object_is_refused() -> None:
    scenario = load_scenario("push").with_settings({"cases.case_1.robots.arm.ante_velocity": [0.0, 0.3, 0.0]})
    with pytest.raises(InputError, match="arm 'arm' does not approach the object"):
        Hits(Scene.resolve(scenario, "juice", "1"), Thresholds())
