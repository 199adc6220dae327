# SPDX-License-Identifier: Apache-2.0
"""Arms that would collide with each other, with the table or the ground are refused before they move."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from trials import scene_of

from impact_rs_control.plan import plan_trial
from impact_rs_sim.clearance import RADIUS, capsules, check_clearance, deepest_penetration
from impact_rs_sim.errors import InputError
from impact_rs_sim.robot_model import RobotModel
from impact_rs_sim.scenario import load_scenario
from impact_rs_sim.scene import Scene

SCENE = scene_of("grab", "juice", "case_1")
POSITIONS = {name: state.position for name, state in SCENE.arms.items()}


def test_the_hull_ends_at_the_pad_and_has_no_gap() -> None:
    model = SCENE.models["left"]
    hull = capsules(model, POSITIONS["left"])
    ends = []
    for _, shape, place in hull:
        along = place.getRotation()[:, 2] * shape.halfLength
        ends.append((place.getTranslation() - along, place.getTranslation() + along))
    for (_, end), (start, _) in zip(ends, ends[1:], strict=False):
        np.testing.assert_allclose(end, start, atol=1e-9)
    pad = model.placement(POSITIONS["left"])
    np.testing.assert_allclose(ends[-1][1] + RADIUS * pad.rotation[:, 2], pad.translation, atol=1e-9)


def test_the_scenario_keeps_its_arms_apart() -> None:
    check_clearance(SCENE.models, POSITIONS, "at the impact")


def test_an_arm_inside_another_is_named_with_its_links_and_by_how_much() -> None:
    left = SCENE.models["left"]
    facts, effector = SCENE.physics.arms["left"].facts, SCENE.physics.arms["left"].end_effector
    shifted = RobotModel(
        facts, effector, pin.SE3(left.base.rotation, left.base.translation + np.array([0.0, -0.1, 0.0]))
    )
    positions = {"left": POSITIONS["left"], "right": POSITIONS["left"]}
    with pytest.raises(InputError, match=r"'left' and 'right' collide at the impact: \w+ and \w+ overlap by 0\.\d+ m"):
        check_clearance({"left": left, "right": shifted}, positions, "at the impact")


def test_bases_too_close_are_refused_before_the_trial() -> None:
    scenario = load_scenario("grab")
    content = scenario.model_dump()
    content["robots"]["left"]["base"]["position"] = [0.0, 0.05, 0.0]
    content["robots"]["right"]["base"]["position"] = [0.0, -0.05, 0.0]
    with pytest.raises(InputError, match="collide|reach"):
        plan_trial(Scene.resolve(type(scenario).model_validate(content), "juice", "case_1"))


def poses(scene: Scene, name: str = "arm") -> tuple[np.ndarray, np.ndarray]:
    """The pose of an arm at the impact, as a path of one sample."""
    return scene.arms[name].position[None], np.zeros(3)


@pytest.mark.parametrize("depth", [0.005, 0.015])
def test_a_pad_in_the_table_where_the_object_stands_is_found_with_its_depth(depth: float) -> None:
    """Raised by so much that the lower edge of the pad, 30 mm above it, is below its surface."""
    push = scene_of("push", "cat_food", "case_1")
    positions, way = poses(push)
    physics, place = push.physics, push.object.position
    assert deepest_penetration(physics, "arm", positions, push.object, way) is None
    raised = replace(physics, support_height=physics.support_height + 0.03 + depth)
    found = deepest_penetration(raised, "arm", positions, push.object, way)
    assert found is not None
    assert (found.part, found.partner, found.index) == ("its pad", "support", 0)
    assert found.depth == pytest.approx(depth, abs=1e-6)
    away = replace(push.object, position=place - [0.0, 0.1, 0.0])  # nobody knows whether the table reaches there
    assert deepest_penetration(raised, "arm", positions, away, way) is None
    assert deepest_penetration(raised, "arm", positions, away, np.array([0.0, 0.1, 0.0])) == found
    aside = replace(raised, support_size=(0.2, 0.2))  # ends before the object
    assert deepest_penetration(aside, "arm", positions, push.object, way) is None


def test_a_link_below_the_ground_is_found_and_the_mounting_is_not() -> None:
    push = scene_of("push", "cat_food", "case_1")
    positions, way = poses(push)
    model, physics = push.models["arm"], push.physics
    folded = positions.copy()
    folded[0, 1] = 2.0  # the shoulder lays the upper arm below the horizontal
    found = deepest_penetration(physics, "arm", folded, push.object, way)
    assert found is not None and found.partner == "ground"
    lowest = min(place.translation[2] for place in model.link_placements(folded[0]).values())
    assert -lowest < found.depth < -lowest + 0.2
    sunk = replace(
        physics, arms={"arm": replace(physics.arms["arm"], base=pin.SE3(np.eye(3), np.array([0, 0, -0.01])))}
    )
    assert deepest_penetration(sunk, "arm", positions, push.object, way) is None


@pytest.mark.parametrize("name", ["push", "push_fr3", "push_iiwa7", "push_ur5e", "grab", "grab_fr3", "excite"])
def test_shipped_scenarios_keep_clear_of_support_and_ground(name: str) -> None:
    scenario = load_scenario(name)
    for item in scenario.objects:
        for case in scenario.cases:
            plan_trial(Scene.resolve(scenario, item, case))
