# SPDX-License-Identifier: Apache-2.0
"""Blind campaigns: what is hidden is drawn from the seed, within the bounds that effects declare."""

import json
from pathlib import Path

import numpy as np
import pytest
from trials import nominal_physics

from impact_rs_sim.effects import library
from impact_rs_sim.errors import InputError
from impact_rs_sim.plant.unmodelled import OUTSIDE
from impact_rs_sim.scenarios.scenario_files import scenario_path
from impact_rs_trials.blind import RUNS, SIZES, TRUTH, Secret, draw, draw_outside, draw_truth, hide, make, specs, tasks


@pytest.mark.parametrize("name", sorted(library()))
@pytest.mark.parametrize("joint_count", [6, 7])
def test_hidden_values_lie_some_scales_from_nominal_within_bounds(name, joint_count):
    for seed in range(12):
        for magnitude in (1.0, 4.0, 50.0):
            hidden = draw(name, magnitude, np.random.default_rng(seed), joint_count)
            scalars = library()[name].scalars(joint_count)
            assert len(hidden.values) == len(scalars)
            for value, scalar in zip(hidden.values, scalars, strict=True):
                if scalar.hidden is not None:
                    assert scalar.hidden[0] <= value <= scalar.hidden[1]
                    continue
                room = 0.9 * np.array([scalar.nominal - scalar.lower, scalar.upper - scalar.nominal])
                assert -room[0] - 1e-12 <= value - scalar.nominal <= room[1] + 1e-12
                side = room[1] if value > scalar.nominal else room[0]
                away = abs(value - scalar.nominal)
                assert away == pytest.approx(side) or 0.7 <= away / (magnitude * scalar.scale) <= 1.3


def test_a_hidden_payload_adds_mass_up_to_nine_tenths_of_the_bound():
    masses = [draw("end_effector_payload", size, np.random.default_rng(7), 7).values[0] for size in (1.0, 100.0)]
    assert 0.07 <= masses[0] <= 0.13
    assert masses[1] == pytest.approx(2.7)


def test_effects_that_can_go_both_ways_do():
    offsets = np.array([draw("torque_offset", 1.0, np.random.default_rng(seed), 7).values for seed in range(20)])
    assert np.all((offsets > 0.0).any(axis=0) & (offsets < 0.0).any(axis=0))


def test_the_same_seed_hides_the_same_as_ever():
    """Numbers of the first release: published blind campaigns of a named effect can be made again."""
    (payload,) = draw_truth(5, "single", "end_effector_payload", None)
    assert payload.values[:4] == pytest.approx(
        (0.8294326025098256, 0.01218952892703902, -0.021239183866414085, -0.04780629373298296), rel=1e-14
    )
    (sticky,) = draw_truth(3, "single", "joint_stribeck_friction", None)
    assert (sticky.values[0], sticky.values[-1]) == pytest.approx((0.20513311108996682, 0.07694738285947944), rel=1e-14)
    assert {item.name for item in draw_truth(11, "pair", None, None)} <= set(library())  # depends on what is there
    physics = hide(nominal_physics(), [payload])
    assert physics.arms["arm"].end_effector.mass == pytest.approx(0.6 + payload.values[0])


@pytest.mark.parametrize("name", sorted(library()))
def test_an_effect_twice_as_large_is_twice_as_far_from_nominal(name: str) -> None:
    effect = library()[name]
    small, large = (draw(name, size, np.random.default_rng(5), 7) for size in (0.5, 1.0))
    for scalar, one, two in zip(effect.scalars(7), small.values, large.values, strict=True):
        if scalar.hidden is None:
            assert two - scalar.nominal == pytest.approx(2.0 * (one - scalar.nominal), rel=1e-9)


@pytest.mark.parametrize(("kind", "count"), [("single", 1), ("pair", 2), ("null", 0), ("outside", 0)])
def test_every_kind_hides_its_number_of_effects_and_the_seed_decides_which(kind: str, count: int) -> None:
    drawn = [draw_truth(seed, kind, None, None) for seed in range(40)]
    assert {len(hidden) for hidden in drawn} == {count}
    assert all(len({item.name for item in hidden}) == count for hidden in drawn)
    assert drawn == [draw_truth(seed, kind, None, None) for seed in range(40)]
    if count:
        assert len({item.name for hidden in drawn for item in hidden}) > 8
        sizes = [item.magnitude for hidden in drawn for item in hidden]
        assert 1.0 <= min(sizes) < 2.0 < 5.0 < max(sizes) <= 10.0


def test_outside_effects_have_one_to_four_times_a_noticeable_size() -> None:
    drawn = [draw_outside(seed, None, None) for seed in range(60)]
    assert {name for name, _ in drawn} == set(OUTSIDE)
    assert all(1.0 <= size <= 4.0 for _, size in drawn)
    assert draw_outside(0, "backlash", 2.5) == ("backlash", 2.5)


@pytest.mark.parametrize(
    ("call", "complaint"),
    [
        (lambda: draw_truth(0, "triple", None, None), "no kind 'triple'"),
        (lambda: draw_truth(0, "single", "gravity", None), "no effect 'gravity'"),
        (lambda: draw_truth(0, "pair", "object_mass", None), "expected two effects as FIRST\\+SECOND"),
        (lambda: draw_truth(0, "pair", "object_mass+object_mass", None), "expected two effects"),
        (lambda: draw_truth(0, "single", "object_mass+restitution", None), "expected one effect"),
        (lambda: draw_truth(0, "pair", "object_mass+gravity", None), "no effect 'gravity'"),
        (lambda: Secret.drawn(0, effect="neighbour_mass"), "no object has neighbours"),
        (lambda: Secret.drawn(0, effect="object_friction"), "push_two_boxes"),
        (lambda: draw_outside(0, "gravity", None), "no outside effect 'gravity'"),
        (lambda: tasks(Path("."), 0, "huge", [], None, 0.0), "no size 'huge'"),
    ],
)
def test_an_unknown_kind_effect_or_size_is_refused(call, complaint: str) -> None:
    with pytest.raises(InputError, match=complaint):
        call()


def test_a_blind_campaign_has_all_conditions_and_the_truth_beside(tmp_path: Path) -> None:
    seen = []

    def record(function, todo):
        seen.extend(todo)
        return ["OK"] * len(todo)

    progress = list(make(tmp_path, 7, record, "single", "object_mass", "small", 2.0))
    size = SIZES["small"]
    pushes = len(size.objects) * len(size.cases) * size.repeats
    assert progress == [(number, len(seen)) for number in range(1, len(seen) + 1)]
    assert sum(task.trial.spec.scenario.name == "push" for task in seen) == pushes
    assert len({task.trial.seed for task in seen}) == len(seen)
    truth = json.loads((tmp_path / TRUTH).read_text())
    assert [effect["name"] for effect in truth["effects"]] == ["object_mass"]
    (value,) = (entry["value"] for entry in truth["effects"][0]["parameters"].values())
    assert (value,) == seen[0].hidden[0].values
    assert {task.directory for task in seen} == {str(tmp_path / RUNS)}
    with pytest.raises(InputError, match="another blind campaign"):
        list(make(tmp_path, 8, record, "single", "object_mass", "small", 2.0))


def test_a_pair_can_be_named() -> None:
    assert [item.name for item in draw_truth(3, "pair", "restitution+object_mass", 2.0)] == [
        "restitution",
        "object_mass",
    ]


def test_a_scenario_with_other_objects_is_recorded_with_its_own() -> None:
    """Kills a campaign of a wall that looks for the boxes of push."""
    found = [(spec.scene.object_name, spec.scene.case_name, repeats) for spec, repeats in specs("small", ["hit_wall"])]
    assert found == [("wall", "case_1", 3), ("wall", "case_2", 3)]


def test_both_arms_of_a_grab_hide_the_effect() -> None:
    """Kills a draw for one arm, whose other arm stays nominal."""
    secret = Secret.drawn(7, effect="joint_coulomb_friction", scenarios=["grab_cylinder"])
    conditions = specs("small", ["grab_cylinder"])
    assert len(conditions) == 4
    for spec, _ in conditions:
        arms = hide(spec.scene.physics, list(secret.hidden)).arms
        assert set(arms) == {"left", "right"}
        for arm in arms.values():
            np.testing.assert_array_equal(arm.friction.coulomb, secret.hidden[0].values)


def test_a_centre_of_mass_is_hidden_inside_every_box_of_the_campaign(tmp_path: Path) -> None:
    smallest = np.min([spec.plan.scene.physics.object.size / 2.0 for spec, _ in specs("small")], axis=0)
    for seed in range(10):
        hidden = draw_truth(
            seed, "single", "object_com_offset", 10.0, worlds=[s.plan.scene.physics for s, _ in specs("small")]
        )
        assert np.all(np.abs(hidden[0].values) < smallest)


def test_another_robot_is_hidden_behind_with_its_own_number_of_joints(tmp_path) -> None:
    """Truth and tasks are those of the scenarios that were asked for; arms of two kinds in one campaign are refused."""
    path = tmp_path / "six.yaml"
    path.write_text(scenario_path("push_ur5e").read_text(encoding="utf-8"))
    for _ in make(tmp_path / "blind", 1, map, "single", "torque_offset", "small", work=str, scenarios=(str(path),)):
        pass
    truth = json.loads((tmp_path / "blind" / TRUTH).read_text())
    assert len(truth["effects"][0]["parameters"]) == 6
    assert truth["scenarios"] == [str(path)]
    with pytest.raises(InputError, match=r"same number of joints, .*got .*six.yaml: 6, push: 7"):
        next(make(tmp_path / "both", 1, map, scenarios=(str(path), "push")))


def test_a_seed_keeps_what_it_hid_before_effects_were_added() -> None:
    """Tutorials and boards rest on it. Kills a draw among effects that are only hidden by name."""
    hidden = {seed: draw_truth(seed, "single", None, None)[0].name for seed in (3, 7, 8)}
    assert hidden == {3: "rolling_resistance", 7: "torque_gain", 8: "pad_tilt"}


@pytest.mark.parametrize("name", ["torque_sensor_drift", "command_clock_offset"])
def test_what_no_plant_shows_is_not_hidden(name: str) -> None:
    """Kills a truth that is not in the trials."""
    with pytest.raises(InputError, match="a plant cannot hide torque_sensor_drift and command_clock_offset"):
        Secret.drawn(3, "single", name, 3.0)
