# SPDX-License-Identifier: Apache-2.0
"""A drafted scenario is that of its robot, stable, reachable, and its trials end well."""

from __future__ import annotations

import numpy as np
import pytest

from impact_rs_control.closed_loop import make_plant, run_closed_loop
from impact_rs_sim.errors import InputError
from impact_rs_sim.robot_check import check_drives, empty_flange
from impact_rs_sim.robots.robot import load_facts
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_sim.scenarios.object_proposal import ProposedObject, propose_object
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_sim.scenarios.trial_settings import ASSUMED_MOTOR_INERTIA
from impact_rs_trials import scenario_draft
from impact_rs_trials.scenario_draft import Draft, Pose, draft, scenario_text
from impact_rs_trials.spec import TrialSpec

UR5E, FR3, FER = (load_facts(name) for name in ("ur5e", "franka_fr3", "franka_fer"))


@pytest.fixture(scope="module")
def six_joints() -> Draft:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(scenario_draft, "SEARCHED_POSES", 12)
        return draft("ur5e", UR5E, "push")


def test_a_draft_for_six_joints_is_a_valid_file_whose_trials_ran(six_joints: Draft, tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text(six_joints.text)
    scenario = load_scenario(str(path))
    assert scenario.name == "push_ur5e"
    assert scenario.robots["arm"].drive.type == "rigid"
    assert all(robot.posture_joints == {} for case in scenario.cases.values() for robot in case.robots.values())
    stable, assumed = check_drives(UR5E, scenario)
    assert stable.outcome == "ok" and "assumed: motor_inertia_rotor, stiffness, damping" in assumed.found
    assert scenario.uncertainty.motor_inertia == ASSUMED_MOTOR_INERTIA


@pytest.mark.parametrize(
    "geometry",
    ['<cylinder radius="0.05" length="0.18"/>', pytest.param('<box size="0.2 0.15 0.18"/>', marks=pytest.mark.slow)],
)
def test_a_draft_with_an_object_of_a_urdf_is_a_scenario_whose_trial_runs(geometry: str, tmp_path) -> None:
    """The file holds the object; one of its trials, from the file, ends well."""
    urdf = tmp_path / "thing.urdf"
    inertia = '<inertia ixx="0.004" ixy="0" ixz="0" iyy="0.004" iyz="0" izz="0.002"/>'
    own = f'<inertial><mass value="0.9"/>{inertia}</inertial><collision><geometry>{geometry}</geometry></collision>'
    urdf.write_text(f'<robot name="thing"><link name="thing">{own}</link></robot>')
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(scenario_draft, "SEARCHED_POSES", 12)
        found = draft("ur5e", UR5E, "push", proposed=propose_object(urdf))
    assert "mass 0.9 kg of the URDF's inertial" in found.choices["objects.thing"]
    (tmp_path / "mine.yaml").write_text(found.text)
    scenario = load_scenario(str(tmp_path / "mine.yaml"))
    assert list(scenario.objects) == ["thing"] and scenario.name == "push_ur5e_thing"
    np.testing.assert_allclose(scenario.object("thing").moments, [0.004, 0.004, 0.002])
    scenario_draft._simulate(scenario)


def test_free_motion_has_no_object(tmp_path) -> None:
    with pytest.raises(InputError, match="excite moves freely and hits nothing"):
        draft("ur5e", UR5E, "excite", proposed=ProposedObject("ball", {}, ()))


def test_a_draft_marks_what_its_robot_does_not_say() -> None:
    """The rotor inertia of an FR3 is published, what its torque loop leaves of it is not."""
    model = RobotModel(FR3, empty_flange())
    pose = Pose(np.array([0.4, 0.1, 0.6]), np.zeros(7), 1.0)
    scenario = scenario_draft._read(scenario_text("franka_fr3", FR3, "push", model, pose, 1.0), FR3)
    assert scenario.robots["arm"].drive.assumed == ("motor_inertia_reduced", "stiffness", "damping")
    assert scenario.uncertainty.motor_inertia == ASSUMED_MOTOR_INERTIA
    rigid = FR3.model_copy(update={"joint_torque_loop": False})
    known = scenario_draft._read(
        scenario_text("mine", rigid, "push", model, Pose(np.zeros(3), np.zeros(7), 1.0), 1.0), rigid
    )
    assert known.robots["arm"].drive.assumed == ("stiffness", "damping")
    assert known.uncertainty.motor_inertia == 0.1  # B_rho is published, and the links carry it


def test_a_draft_says_why_it_chose_what_it_chose(six_joints: Draft) -> None:
    """In its head as in its choices: the pose with the joint nearest to its limit, the drive, and the posture."""
    head = six_joints.text[: six_joints.text.index("\nname:")].replace("\n#   ", " ")
    assert all(f"# * {key}: {why}." in head for key, why in six_joints.choices.items())
    model = RobotModel(UR5E, empty_flange())
    q = np.array(six_joints.scenario.robots["arm"].impact.joint_guess)
    nearest = int(np.argmin(np.minimum(q - model.position_min, model.position_max - q)))
    assert f"joint {nearest + 1} is nearest to its limit there" in six_joints.choices["impact"]
    assert "rigid" in six_joints.choices["drive"]
    assert "posture" not in six_joints.choices["cases"]


def test_six_joints_follow_their_references_without_a_posture_task(six_joints: Draft, tmp_path):
    """Before the hit the pad is where it shall be, within two millimetres at half a metre per second."""
    plan = TrialSpec.of(six_joints.scenario, "parcel", "case_1").plan
    arm = plan.arms["arm"]
    assert arm.posture == ()
    plant, reached = make_plant(plan, 1), np.zeros(3)
    for tick in run_closed_loop(plan, plant):
        if tick.number == 800:
            reached = tick.commands["arm"].position
            break
    plant.close()
    np.testing.assert_allclose(reached, arm.ante_position.position[800], atol=2e-3)


def test_the_second_arm_of_a_grab_is_the_first_turned_about_the_object() -> None:
    model = RobotModel(FR3, empty_flange())
    pose = Pose(np.array([0.4, 0.1, 0.6]), np.zeros(7), 1.0)
    scenario = scenario_draft._read(scenario_text("franka_fr3", FR3, "grab", model, pose, 1.0), FR3)
    middle = np.append(scenario.object_position, 0.0)
    left, right = scenario.robots["left"], scenario.robots["right"]
    for own, other in ((left.base.position, right.base.position), (left.impact.position, right.impact.position)):
        np.testing.assert_allclose(np.add(own, other)[:2], 2.0 * middle[:2], atol=1e-6)
    assert right.base.yaw == pytest.approx(np.pi, abs=1e-4)
    np.testing.assert_allclose(left.impact.pad_normal, np.negative(right.impact.pad_normal))


def test_a_way_that_leaves_the_limits_has_no_score() -> None:
    model = RobotModel(FER, empty_flange())
    q = np.array(load_scenario("push").robots["arm"].impact.joint_guess)
    near = scenario_draft._path_score(model, q, np.array([0.0, -0.2, 0.0]), 0.5)
    far = scenario_draft._path_score(model, q, np.array([0.0, -2.0, 0.0]), 0.5)
    assert near > 0.0
    assert far == 0.0
    for stop in (model.position_min, model.position_max):
        at_stop = q.copy()
        at_stop[5] = stop[5]
        assert scenario_draft._path_score(model, at_stop, np.array([0.0, -0.01, 0.0]), 0.5) == 0.0


def test_too_few_joints_are_told_in_one_line() -> None:
    few = UR5E.model_copy(
        update={
            "joints": UR5E.joints[:3],
            "links": UR5E.links[:3],
            "limits": UR5E.limits.model_copy(
                update={key: value[:3] for key, value in UR5E.limits.model_dump().items()}
            ),
        }
    )
    with pytest.raises(InputError, match="3 joints: .* needs six"):
        draft("small", few, "push")


def test_links_that_are_no_bodies_are_told_before_any_pose_is_tried() -> None:
    flat = UR5E.links[1].model_copy(update={"inertia": (0.1, 0.0, 0.0, 0.1, 0.0, 0.3)})
    wrong = UR5E.model_copy(update={"links": (UR5E.links[0], flat, *UR5E.links[2:])})
    with pytest.raises(InputError, match=r"^mine: inertias are those of bodies: link 2: .* 1.5 of the sum"):
        draft("mine", wrong, "push", lambda *_: pytest.fail("a pose was tried"))


def test_a_slower_motion_there_and_back_is_a_shorter_one_and_takes_as_long() -> None:
    model = RobotModel(FR3, empty_flange())
    pose = Pose(np.array([0.4, 0.1, 0.6]), np.zeros(7), 1.0)
    whole, half = (
        scenario_draft._read(scenario_text("franka_fr3", FR3, "excite", model, pose, speed), FR3)
        for speed in (1.0, 0.5)
    )
    np.testing.assert_allclose(half.excursion.end, 0.5 * np.array(whole.excursion.end))
    assert half.excursion.joint_1 == pytest.approx(0.5 * whole.excursion.joint_1)
    ends = [scenario.excursion_end(scenario.cases["slow"].robots["arm"]) for scenario in (whole, half)]
    assert ends[1] == pytest.approx(ends[0], rel=1e-6)
