"""What a blind campaign hides: drawn from its seed alone, of the size asked for, physical, and told to nobody."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from impact_rs_sim.effects import library
from impact_rs_sim.errors import InputError
from impact_rs_sim.physics import Physics
from impact_rs_sim.scenario import load_scenario
from impact_rs_sim.unmodelled import OUTSIDE
from impact_rs_trials.blind import RUNS, SIZES, TRUTH, draw, draw_outside, draw_truth, hide, make, tasks

NAMES = sorted(library())
PHYSICS = Physics.nominal(load_scenario("push"), "juice")
JOINTS = PHYSICS.joint_count


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("magnitude", [1.0, 10.0])
def test_what_is_hidden_stays_within_bounds_and_is_of_the_size_that_was_asked_for(name: str, magnitude: float) -> None:
    effect = library()[name]
    scalars = effect.scalars(JOINTS)
    for seed in range(20):
        hidden = draw(name, magnitude, np.random.default_rng(seed), JOINTS)
        assert len(hidden.values) == len(scalars)
        for scalar, value in zip(scalars, hidden.values, strict=True):
            assert scalar.lower <= value <= scalar.upper
            away, room = abs(value - scalar.nominal), max(scalar.upper - scalar.nominal, scalar.nominal - scalar.lower)
            if scalar.hidden is None and 1.3 * magnitude * scalar.scale < 0.9 * room:
                assert away <= 1.3 * magnitude * scalar.scale + 1e-12
                assert away > 0.0
        assert hide(PHYSICS, [hidden]) is not PHYSICS


@pytest.mark.parametrize("name", NAMES)
def test_an_effect_twice_as_large_is_twice_as_far_from_nominal(name: str) -> None:
    effect = library()[name]
    small, large = (draw(name, size, np.random.default_rng(5), JOINTS) for size in (0.5, 1.0))
    for scalar, one, two in zip(effect.scalars(JOINTS), small.values, large.values, strict=True):
        if scalar.hidden is None:
            assert two - scalar.nominal == pytest.approx(2.0 * (one - scalar.nominal), rel=1e-9)


def test_friction_is_only_ever_added() -> None:
    """Its nominal value is its bound."""
    for name in ("joint_coulomb_friction", "joint_viscous_friction"):
        for seed in range(20):
            assert min(draw(name, 3.0, np.random.default_rng(seed), JOINTS).values) > 0.0


def test_both_directions_are_drawn_about_equally_often() -> None:
    signs = [np.sign(draw("torque_offset", 1.0, np.random.default_rng(seed), JOINTS).values) for seed in range(100)]
    # Four standard deviations of the mean of 700 signs.
    assert abs(np.mean(signs)) < 4.0 / np.sqrt(700.0)


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


def test_outside_effects_have_a_size_between_noticeable_and_four_times_that() -> None:
    drawn = [draw_outside(seed, None, None) for seed in range(60)]
    assert {name for name, _ in drawn} == set(OUTSIDE)
    assert all(1.0 <= size <= 4.0 for _, size in drawn)
    assert draw_outside(0, "backlash", 2.5) == ("backlash", 2.5)


@pytest.mark.parametrize(
    ("call", "complaint"),
    [
        (lambda: draw_truth(0, "triple", None, None), "no kind 'triple'"),
        (lambda: draw_truth(0, "single", "gravity", None), "no effect 'gravity'"),
        (lambda: draw_outside(0, "gravity", None), "no outside effect 'gravity'"),
        (lambda: tasks(Path("."), 0, "huge", [], None, 0.0), "no size 'huge'"),
    ],
)
def test_what_there_is_none_of_is_answered_with_what_there_is(call, complaint: str) -> None:
    with pytest.raises(InputError, match=complaint):
        call()


def test_a_campaign_has_every_condition_with_its_repeats_and_the_truth_lies_beside_the_runs(tmp_path: Path) -> None:
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
