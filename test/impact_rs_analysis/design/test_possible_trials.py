# SPDX-License-Identifier: Apache-2.0
"""Trials that a cell can run, from its scenarios and its envelope."""

import numpy as np
import pytest

from impact_rs_analysis.design.possible_trials import Envelope, PossibleTrial, possible_trials
from impact_rs_sim.errors import InputError
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_trials.envelope import CellEnvelope


def speed(trial: PossibleTrial) -> float:
    robots = trial.spec.scenario.case(trial.spec.case).robots.values()
    return max(float(np.linalg.norm(robot.ante_velocity)) for robot in robots)


def test_no_trial_is_faster_than_the_scenario_or_the_envelope() -> None:
    assert max(speed(trial) for trial in possible_trials(["push"])) == pytest.approx(0.7)
    slow = possible_trials(["push", "excite"], Envelope(speed=0.45))
    assert slow and max(map(speed, slow)) <= 0.45 + 1e-9
    assert max(speed(trial) for trial in possible_trials(["push"], Envelope(speed=0.9))) == pytest.approx(0.9, abs=1e-9)


def test_another_speed_keeps_pose_and_direction() -> None:
    trials = [trial for trial in possible_trials(["push"]) if trial.spec.case.endswith("mm_s")]
    assert trials and all(trial.new_case is not None for trial in trials)
    for trial in trials:
        case = trial.spec.scenario.case(trial.spec.case)
        name = trial.spec.case.rsplit("_", 2)[0]
        own, other = case.robots["arm"], load_scenario("push").case(name).robots["arm"]
        assert own.posture_joints == other.posture_joints
        assert np.cross(own.ante_velocity, other.ante_velocity) == pytest.approx(0.0, abs=1e-6)


def test_a_hit_beside_the_centre_is_one_and_keeps_the_face_in_the_plane_of_the_pad() -> None:
    by_name = {trial.name: trial for trial in possible_trials(["push"])}
    for item, half in (("parcel", 0.09), ("juice", 0.065)):
        scene = by_name[f"push_beside/{item}/case_1"].spec.scene
        pad = scene.models["arm"].placement(scene.arms["arm"].position).translation
        assert abs(scene.object.position[0] - pad[0]) == pytest.approx(0.15 * 0.20, abs=1e-5)
        assert pad[1] - scene.object.position[1] == pytest.approx(half, abs=1e-6)


def test_an_approach_at_an_angle_lies_outside_the_friction_cone_on_either_side() -> None:
    """Sliding over closing speed is twice the friction coefficient, at the speed of the fastest case of the pose."""
    push = load_scenario("push")
    slanted = [trial for trial in possible_trials(["push"]) if "_from_" in trial.name]
    assert {trial.spec.scenario.name for trial in slanted} == {"push_from_left", "push_from_right"}
    assert len(slanted) == 2 * 2 * len(push.objects)
    for trial in slanted:
        velocity = np.array(trial.spec.scenario.case(trial.spec.case).robots["arm"].ante_velocity)
        to_the_left = np.cross([0.0, 0.0, 1.0], [0.0, -1.0, 0.0])
        side = -1.0 if trial.spec.scenario.name == "push_from_right" else 1.0  # moves away from where it comes from
        assert velocity @ to_the_left == pytest.approx(-side * 2.0 * push.contact.friction * -velocity[1], rel=1e-3)
        assert np.linalg.norm(velocity) == pytest.approx(0.7, abs=1e-4)
        assert "45 degrees off the normal" in trial.what
    assert not any("_from_" in trial.name for trial in possible_trials(["excite", "grab"]))


def test_a_way_there_and_back_ends_within_the_trial() -> None:
    trials = possible_trials(["excite"])
    scenario = load_scenario("excite")
    for trial in trials:
        for robot in trial.spec.scenario.case(trial.spec.case).robots.values():
            assert scenario.excursion_end(robot) <= scenario.timing.duration
    assert {trial.spec.scenario.name for trial in trials} == {"excite", "excite_mirrored"}


def test_every_condition_has_a_name_of_its_own() -> None:
    trials = possible_trials(["push", "excite", "grab"])
    assert len({trial.name for trial in trials}) == len(trials) > 40
    assert [trial.name for trial in trials] == sorted(trial.name for trial in trials)
    assert sum(trial.of_file for trial in trials) == 9 + 2 + len(load_scenario("grab").objects) * len(
        load_scenario("grab").cases
    )


def test_a_cell_runs_only_what_its_envelope_names_and_allows() -> None:
    cell = CellEnvelope(scenarios=("push",), objects=("parcel", "juice"), speed=0.5, impulse=0.5)
    trials = possible_trials(["push", "excite"], Envelope(cell=cell))
    assert [trial.name for trial in trials] == [  # half a newton second is too little for juice at 0.5 m/s
        "push/juice/case_1_250mm_s",
        "push/juice/case_3_250mm_s",
        *(f"push/parcel/{case}" for case in ("case_1", "case_1_250mm_s", "case_3", "case_3_250mm_s")),
    ]
    assert possible_trials(["push"], Envelope(speed=0.3, cell=cell)) == [t for t in trials if speed(t) <= 0.3]
    with pytest.raises(InputError, match=r"none of \d+ trials lies inside the envelope, push/.*allows 0.1 N s"):
        possible_trials(["push"], Envelope(cell=cell.model_copy(update={"impulse": 0.1, "objects": ()})))


def test_an_envelope_without_room_is_refused() -> None:
    with pytest.raises(InputError, match="speed"):
        Envelope(speed=0.0)
    with pytest.raises(InputError, match="force"):
        Envelope(force=float("nan"))
