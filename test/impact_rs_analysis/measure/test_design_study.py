# SPDX-License-Identifier: Apache-2.0
"""The design study orders designs as momentum does, and says how sure the order is."""

from __future__ import annotations

import csv
import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from impact_rs_analysis.measure.design_study import (
    MEASURES,
    Design,
    DesignConditions,
    DesignStudy,
    Estimate,
    problems_of,
    random_poses,
    study_designs,
    uncertainties_of,
    values_by,
)
from impact_rs_analysis.report.design_page import design_table, write_design_study
from impact_rs_sim.errors import InputError
from impact_rs_sim.scenarios.scenario_files import load_scenario

CONDITIONS = DesignConditions(load_scenario("push"), "cat_food", pads=("narrow", "bouncy"), draws=8)


@pytest.fixture(scope="module")
def study() -> DesignStudy:
    return study_designs(CONDITIONS, ("franka_fer", "ur5e"), poses=2)


@pytest.fixture(scope="module")
def fr3() -> DesignStudy:
    """An arm that is not the scenario's, with a torque loop."""
    return study_designs(CONDITIONS, ("franka_fr3",), poses=2)


def of(study: DesignStudy, robot: str, motor_inertia: str, pad: str) -> list[Design]:
    return [one for one in study.designs if (one.robot, one.motor_inertia, one.pad) == (robot, motor_inertia, pad)]


def test_heavier_motors_and_bouncing_pads_give_more_impulse(study: DesignStudy) -> None:
    for less, more in (
        (("reduced", "narrow"), ("rotor", "narrow")),
        (("reduced", "narrow"), ("reduced", "bouncy")),
    ):
        pairs = zip(of(study, "franka_fer", *less), of(study, "franka_fer", *more), strict=True)
        assert all(one.measures["impulse"].value < two.measures["impulse"].value for one, two in pairs)


def test_sensitivity_is_the_share_of_the_motors_in_the_effective_mass() -> None:
    """A plastic hit without friction by a pad that is nearly a point: v+ = v- m / (m + m_o).

    With ``1 / m = n^T J (M + B)^-1 J^T n``.
    """
    (stance,), _ = random_poses("franka_fer", CONDITIONS, 1)
    motor_inertia, _, problem = next(problems_of(CONDITIONS, stance))
    assert motor_inertia == "reduced"
    arm = problem.physics.arms["arm"]
    point = replace(arm, end_effector=replace(arm.end_effector, pad_size=(1e-4, 1e-4, 0.02)))
    problem = replace(problem, physics=replace(problem.physics, arms={"arm": point}, pad_friction=0.0))
    model, state, motors = problem.physics.robot_model("arm"), problem.arms["arm"], problem.motor_inertia["arm"]
    row = -model.jacobian(state.position)[1]

    def speed(scale: float) -> float:
        inertia = model.mass_matrix(state.position) + np.diag(scale * motors)
        mass = 1.0 / (row @ np.linalg.solve(inertia, row))
        return float(mass / (mass + problem.physics.object.mass))

    wanted = (speed(1.05) - speed(0.95)) / (0.1 * speed(1.0))
    found = values_by("exact", problem)
    assert found["sensitivity"] == pytest.approx(wanted, rel=5e-3)
    assert found["impulse"] == pytest.approx(problem.physics.object.mass * 0.5 * speed(1.0), rel=1e-3)


def test_an_arm_without_torque_loop_has_its_rotors_alone(study: DesignStudy) -> None:
    assert {one.motor_inertia for one in study.designs if one.robot == "ur5e"} == {"rotor"}


def test_same_seed_same_study() -> None:
    few = replace(CONDITIONS, draws=2)
    first, again = (study_designs(few, ("ur5e",), poses=1).designs for _ in range(2))
    assert first == again


def test_ranks_have_the_range_of_the_draws() -> None:
    """The object's mass is common to all: intervals overlap, and yet two designs change places in one draw alone."""

    def design(number: int, value: float, draws: tuple[float, ...]) -> Design:
        own = Estimate(value, value - 5.0, value + 5.0, draws)
        return Design("robot", number, (0.0,), "rotor", "wide", dict.fromkeys(MEASURES, own))

    designs = (design(1, 9.0, (7.0, 12.0)), design(2, 8.0, (6.0, 10.0)), design(3, 10.0, (8.0, 11.0)))
    ranked = DesignStudy(CONDITIONS, designs, {}, {}).ranked("impulse")
    assert [(found.pose, best, worst) for found, best, worst in ranked] == [(3, 1, 2), (1, 1, 2), (2, 3, 3)]


def test_designs_share_the_object_of_a_draw(study: DesignStudy, fr3: DesignStudy) -> None:
    """A heavier object takes more impulse from every arm: draws of different robots go together."""
    one, two = (
        of(found, robot, "rotor", "narrow")[0].measures["impulse"].draws
        for found, robot in ((study, "franka_fer"), (fr3, "franka_fr3"))
    )
    assert np.corrcoef(one, two)[0, 1] > 0.5


def test_a_motor_inertia_is_as_sure_as_it_is_known() -> None:
    """That of the scenario's robot to 10 %, a published one too; one scaled from another arm, none to three times."""
    stated = CONDITIONS.scenario.uncertainty.motor_inertia
    own = replace(CONDITIONS, scenario=load_scenario("push_ur5e"))
    for conditions, robot, motor_inertia, known in (
        (CONDITIONS, "franka_fer", "reduced", True),
        (CONDITIONS, "franka_fr3", "rotor", True),
        (CONDITIONS, "franka_fr3", "reduced", False),
        (CONDITIONS, "ur5e", "rotor", False),
        (own, "ur5e", "rotor", False),
    ):
        found = uncertainties_of(conditions, robot, motor_inertia).motor_inertia
        assert found == (stated if known else 2.0)


def test_what_is_assumed_makes_intervals_wide_and_none_reaches_below_zero(study: DesignStudy, fr3: DesignStudy) -> None:
    """Of one arm, with the assumed B_theta and with the published B_rho; the scenario's robot has its own drive."""

    def width(motor_inertia: str, measure: str) -> float:
        own = [one.measures[measure] for one in of(fr3, "franka_fr3", motor_inertia, "narrow")]
        return float(np.mean([one.high / one.low for one in own]))

    for measure in ("joint_jump", "sensitivity"):
        assert width("reduced", measure) > 1.5 * width("rotor", measure)
    for design in (*study.designs, *fr3.designs):
        for one in design.measures.values():
            assert 0.0 < one.low < one.value < one.high
    motors = next(problems_of(CONDITIONS, random_poses("franka_fer", CONDITIONS, 1)[0][0]))[2].motor_inertia["arm"]
    assert motors.tolist() == list(CONDITIONS.scenario.robots["arm"].drive.motor_inertia_reduced or ())


def test_table_holds_every_design_and_the_page_is_written(study: DesignStudy, tmp_path: Path) -> None:
    rows = list(csv.DictReader(io.StringIO(design_table(study))))
    assert len(rows) == len(study.designs)
    assert float(rows[0]["impulse [N s]"]) == pytest.approx(study.designs[0].measures["impulse"].value, rel=1e-4)
    page = write_design_study(study, tmp_path / "report")
    assert "franka_fer" in page.read_text(encoding="utf-8")
    assert (tmp_path / "report" / "designs.csv").is_file()


def test_a_speed_that_no_pose_reaches_is_an_error() -> None:
    with pytest.raises(InputError, match="lower --speed"):
        random_poses("ur5e", replace(CONDITIONS, speed=50.0), 1)


def test_a_study_without_any_answer_is_refused_with_the_reason() -> None:
    """Kills: a study of no designs, whose page ended in an IndexError; both reasons for none are told apart."""
    few = replace(CONDITIONS, pads=("narrow",), draws=1)
    with pytest.raises(InputError, match="ur5e: no joint torque loop, .*; give --motor-inertia rotor"):
        study_designs(replace(few, motor_inertias=("reduced",)), ("ur5e",), poses=1)
    with pytest.raises(InputError, match="ur5e/1/rotor/narrow: 1 of 1 draws have an answer, expected two"):
        study_designs(few, ("ur5e",), poses=1)
