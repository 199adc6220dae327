# SPDX-License-Identifier: Apache-2.0
"""Two arms that would collide are told before they move."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from trials import scene_of

from impact_rs_control.plan import plan_trial
from impact_rs_sim.clearance import RADIUS, capsules, check_clearance
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
