# SPDX-License-Identifier: Apache-2.0
"""What a torque signal holds: with or without gravity, measured or computed, in which order of the joints."""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np
import pytest
from builders import mapping_in
from joint_recordings import Columns, swinging
from measured_data import measured_data
from slender_arm import FLAT, mapping_of, slender_arm

from impact_rs_sim.errors import InputError
from impact_rs_sim.robots.robot import load_facts
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_trials.recordings.checks.torque_readings import (
    MotionTorque,
    exactness,
    gravity_alone,
    is_computed,
    lacks_gravity,
    motor_inertia_in,
    order_of_joints,
)
from impact_rs_trials.recordings.importing.import_recordings import ImportDraft, ImportOptions, draft_import
from impact_rs_trials.recordings.importing.import_texts import Line
from impact_rs_trials.recordings.mapping import Mapping, MountedEndEffector
from impact_rs_trials.recordings.recording import read_recordings
from impact_rs_trials.recordings.relations import DECISIVE_LOG_LIKELIHOOD

TIME = np.arange(0.0, 10.0, 0.01)
CENTRES = {"ur10e": [0.0, -1.2, 1.4, -0.4, 0.5, 0.2], "kuka_iiwa7": [0.1, 0.6, 0.2, -1.2, 0.3, 0.9, 0.1]}  # rad
FRICTION = 0.05  # of the largest torque


def model_of(robot: str, load: float = 0.0) -> RobotModel:
    tool = MountedEndEffector(mass=load, com=(0.0, 0.0, 0.05))
    return RobotModel(load_facts(robot), tool.build())


@functools.cache
def swing(robot: str, load: float = 0.0, friction: float = FRICTION, speed: float = 1.0) -> Columns:
    """An arm swings with a load against dry friction; ``weight`` and ``computed`` are those of the arm alone."""
    model, bare = model_of(robot, load), model_of(robot)
    joints = np.arange(model.joint_count)
    frequencies = speed * (0.11 + 0.02 * joints), speed * (0.31 + 0.03 * joints)
    moved, computed = (swinging(one, TIME, np.array(CENTRES[robot]), frequencies, (0.5, 0.1)) for one in (model, bare))
    noise = np.random.default_rng(0).normal(0.0, 0.05, moved["effort"].shape)
    dry = friction * model.torque_max * np.tanh(moved["velocity"] / 0.02)
    weight = np.array([bare.gravity_torque(q) for q in moved["position"]])
    return moved | {"effort": moved["effort"] + dry + noise, "weight": weight, "computed": computed["effort"]}


def seen(robot: str, motion: Columns, torque: np.ndarray) -> MotionTorque:
    return MotionTorque.from_signals(motion["time"], motion["position"], motion["velocity"], torque, model_of(robot))


def write(path: Path, motion: Columns, **signals: np.ndarray) -> Path:
    """A table of positions, velocities and further signals, with numbered columns."""
    signals = {"q": motion["position"], "dq": motion["velocity"], **signals}
    names = [f"{name}_{joint}" for name, one in signals.items() for joint in range(1, one.shape[1] + 1)]
    table = np.column_stack([motion["time"], *signals.values()])
    np.savetxt(path, table, delimiter=",", header=",".join(["time", *names]), comments="", fmt="%.12g")
    return path


def imported(folder: Path, robot: str, motion: Columns, **signals: np.ndarray) -> tuple[ImportDraft, Mapping]:
    file = write(folder / "run.csv", motion, **signals)
    draft = draft_import([file], folder, ImportOptions(robot=robot))
    return draft, mapping_in(draft, folder)


def line_of(draft: ImportDraft, key: str) -> Line:
    return next(line for line in draft.lines if line.key == key)


@pytest.mark.parametrize("robot", list(CENTRES))
def test_a_torque_without_the_arms_weight_is_seen_and_the_weight_is_added(robot: str, tmp_path: Path) -> None:
    """By a mapping by hand that says nothing of it it is refused. Kills a weight that is subtracted, or added twice."""
    motion = swing(robot)
    lifted = motion["effort"] - motion["weight"]
    draft, mapping = imported(tmp_path, robot, motion, effort=lifted)
    assert mapping.torque_meaning == "without_gravity"
    said = line_of(draft, "torque_meaning")
    assert said.sure and "over whole" in said.evidence and "over external" in said.evidence
    assert any("gravity torque of the model is added to it" in remark for remark in draft.remarks)
    (run,) = read_recordings(tmp_path / "run.csv", mapping)
    np.testing.assert_allclose(run.signals.arms["arm"].torque, motion["effort"], atol=1e-6)
    with pytest.raises(InputError, match="torque holds the torque of inertia without gravity") as refused:
        read_recordings(tmp_path / "run.csv", mapping.model_copy(update={"torque_meaning": "whole"}))
    assert "torque_meaning: without_gravity" in str(refused.value)


@pytest.mark.parametrize("robot", list(CENTRES))
def test_the_meaning_of_a_whole_torque_is_written_with_its_margin(robot: str, tmp_path: Path) -> None:
    motion = swing(robot)
    draft, mapping = imported(tmp_path, robot, motion, effort=motion["effort"])
    assert mapping.torque_meaning == "whole" and line_of(draft, "torque_meaning").sure
    (run,) = read_recordings(tmp_path / "run.csv", mapping)
    np.testing.assert_allclose(run.signals.arms["arm"].torque, motion["effort"], atol=1e-6)


@pytest.mark.parametrize("name", ["tau_ext", "effort"])
@pytest.mark.parametrize("robot", list(CENTRES))
def test_an_external_torque_gets_the_torque_of_the_model_back(robot: str, name: str, tmp_path: Path) -> None:
    """Of it friction is left, by which it is seen under any name. Kills an inertia that is not added."""
    motion = swing(robot)
    draft, mapping = imported(tmp_path, robot, motion, **{name: motion["effort"] - motion["computed"]})
    assert mapping.torque_meaning == "external" and line_of(draft, "torque_meaning").sure
    (run,) = read_recordings(tmp_path / "run.csv", mapping)
    inside = slice(5, -5)  # differences at the ends are one-sided
    apart = run.signals.arms["arm"].torque[inside] - motion["effort"][inside]
    assert np.sqrt(np.mean(np.square(apart))) < 0.01 * np.sqrt(np.mean(np.square(motion["effort"])))


def test_a_named_torque_of_noise_is_not_one_without_the_model(tmp_path: Path) -> None:
    """Neither friction nor a name says that anything was subtracted. Kills a meaning of whatever goes with nothing."""
    motion = swing("ur10e")
    noise = np.random.default_rng(5).normal(0.0, 1.0, motion["effort"].shape)
    _, mapping = imported(tmp_path, "ur10e", motion, effort=noise)
    assert mapping.torque_meaning == "whole"


@pytest.mark.parametrize("part", ["computed", "weight"])
def test_a_controllers_own_target_is_never_taken_for_a_measurement(part: str, tmp_path: Path) -> None:
    """Feedforward and gravity compensation. Kills a target that is read, and one that is preferred to a measurement."""
    motion = swing("ur10e")
    draft, mapping = imported(tmp_path, "ur10e", motion, torque=motion[part])
    assert mapping.torque_meaning == "target"
    assert "a target that a controller computed" in line_of(draft, "torque_meaning").evidence
    with pytest.raises(InputError, match="no measurement"):
        read_recordings(tmp_path / "run.csv", mapping)
    _, mapping = imported(tmp_path, "ur10e", motion, torque=motion[part], load=motion["effort"])
    assert mapping.torque_meaning == "whole" and mapping.signals["torque"].column == "load_{joint}"


def test_a_measured_torque_near_the_model_is_no_target() -> None:
    """Friction of 1 %, or noise of 0.2 %, is enough. Kills an exactness of fitted factors."""
    exact = swing("ur10e", friction=0.0)
    assert exactness(seen("ur10e", exact, exact["computed"])) is not None
    assert exactness(seen("ur10e", exact, 1.01 * exact["computed"])) is None
    noise = np.random.default_rng(2).normal(0.0, 0.5, exact["computed"].shape)
    assert exactness(seen("ur10e", exact, exact["computed"] + noise)) is None


def test_gravity_compensation_with_masses_of_its_own_is_a_target(tmp_path: Path) -> None:
    """A controller that knows of a load. Kills a gravity torque of the model alone, and one factor for each joint."""
    bare, loaded = swing("ur10e", speed=3.0), model_of("ur10e", 6.0)
    weight = np.array([loaded.gravity_torque(q) for q in bare["position"]]).round(1)
    draft, mapping = imported(tmp_path, "ur10e", bare, torque=weight)
    assert mapping.torque_meaning == "target"
    assert "holds nothing of the inertia" in line_of(draft, "torque_meaning").evidence


@pytest.mark.parametrize("speed", [0.02, 3.0])
def test_a_torque_that_moves_the_arm_is_no_gravity_compensation(speed: float) -> None:
    """Without friction, so slow that gravity is all of it, or fast. Kills a residual without a look at the inertia."""
    moved = swing("ur10e", load=6.0, friction=0.0, speed=speed)
    assert gravity_alone(seen("ur10e", moved, moved["effort"])) is None


def test_inertia_of_motors_shows_in_a_torque_before_the_gears_alone(tmp_path: Path) -> None:
    """At an arm whose facts say link it is doubted. Kills the acceleration of the links alone."""
    motion = swing("kuka_iiwa7")
    inertia = np.linspace(1.0, 0.2, 7)  # kg m^2
    acceleration = np.gradient(motion["velocity"], motion["time"], axis=0)
    links, motors = motion["effort"], motion["effort"] + inertia * acceleration
    assert motor_inertia_in(seen("kuka_iiwa7", motion, links), "whole")[0] < DECISIVE_LOG_LIKELIHOOD
    gain, found = motor_inertia_in(seen("kuka_iiwa7", motion, motors), "whole")
    assert gain > 10.0 * DECISIVE_LOG_LIKELIHOOD and np.all(found <= 1.1 * inertia)
    draft, mapping = imported(tmp_path, "kuka_iiwa7", motion, effort=motors)
    assert mapping.torque_measured_at == "link"
    assert any("torque_measured_at: motor" in remark for remark in draft.remarks)
    draft, _ = imported(tmp_path, "kuka_iiwa7", motion, effort=links)
    assert not any("torque_measured_at: motor" in remark for remark in draft.remarks)


def test_the_torque_with_the_weight_is_taken_where_both_are_there(tmp_path: Path) -> None:
    """That without it goes with the motion as well, in the joint whose axis is vertical."""
    motion = swing("ur10e")
    lifted = motion["effort"] - motion["weight"]
    file = write(tmp_path / "run.csv", motion, tau_controller=lifted, tau_gear=motion["effort"])
    draft = draft_import([file], tmp_path, ImportOptions(robot="ur10e"))
    (run,) = read_recordings(file, mapping_in(draft, tmp_path))
    np.testing.assert_allclose(run.signals.arms["arm"].torque, motion["effort"], atol=1e-6)


@pytest.mark.parametrize("robot", list(CENTRES))
@pytest.mark.parametrize("load", [0.0, 3.0, 7.0])
@pytest.mark.parametrize("friction", [0.0, 0.1])
@pytest.mark.parametrize("speed", [0.2, 1.0, 3.0])
def test_a_whole_torque_is_never_said_to_lack_the_weight(
    robot: str, load: float, friction: float, speed: float
) -> None:
    motion = swing(robot, load, friction, speed)
    for gain in (0.6, 1.0, 1.6):
        assert lacks_gravity(seen(robot, motion, gain * motion["effort"])) is None


def test_a_torque_of_friction_alone_is_not_one_without_weight() -> None:
    motion = swing("ur10e")
    alone = motion["effort"] - motion["computed"]
    assert lacks_gravity(seen("ur10e", motion, alone)) is None


def test_where_gravity_takes_no_torque_nothing_can_lack_it(tmp_path: Path) -> None:
    """Vertical axes: the torque with and without the weight are the same."""
    facts = slender_arm(("revolute",) * 3, FLAT)
    model = RobotModel(facts, mapping_of(tmp_path, facts).end_effector.build())
    motion = swinging(model, TIME, 0.2, (np.array([0.2, 0.3, 0.4]), np.array([0.5, 0.6, 0.7])), (0.4, 0.1))
    found = MotionTorque.from_signals(TIME, motion["position"], motion["velocity"], motion["effort"], model)
    assert lacks_gravity(found) is None


@pytest.mark.parametrize("load", [0.0, 2.6])
def test_motor_currents_are_preferred_to_a_torque_that_was_computed(load: float, tmp_path: Path) -> None:
    """Names favour the computed one: it is called torque, the currents bear no name that says so."""
    motion = swing("ur10e", load)
    constants = np.array([12.0, 12.0, 11.0, 9.0, 9.0, 9.0])
    file = write(tmp_path / "run.csv", motion, torque=motion["computed"], motor=motion["effort"] / constants)
    draft = draft_import([file], tmp_path, ImportOptions(robot="ur10e"))
    mapping = mapping_in(draft, tmp_path)
    assert mapping.signals["torque"].column == "motor_{joint}" and mapping.signals["torque"].unit == "A"
    (said,) = [remark for remark in draft.remarks if "torque_1 … torque_6" in remark]
    assert "is left out: it follows the model of the arm without any friction" in said


def test_a_computed_torque_alone_is_assumed_and_said(tmp_path: Path) -> None:
    motion = swing("ur10e")
    file = write(tmp_path / "run.csv", motion, effort=motion["computed"])
    draft = draft_import([file], tmp_path, ImportOptions(robot="ur10e"))
    assert not next(line.sure for line in draft.lines if line.key == "signals.torque.unit")
    assert any("nothing that the model lacks, as a load, can show in it" in remark for remark in draft.remarks)


@pytest.mark.parametrize("friction", [0.01, 0.03, 0.1])
def test_a_torque_that_drives_friction_was_measured(friction: float) -> None:
    motion = swing("ur10e", friction=friction)
    assert not is_computed(seen("ur10e", motion, motion["effort"]))
    assert is_computed(seen("ur10e", motion, motion["computed"]))


def test_torque_sensors_behind_the_gears_see_no_friction_and_are_believed(tmp_path: Path) -> None:
    motion = swing("kuka_iiwa7", friction=0.0)
    file = write(tmp_path / "run.csv", motion, effort=motion["effort"])
    assert draft_import([file], tmp_path, ImportOptions(robot="kuka_iiwa7")).remarks == ()


@pytest.mark.parametrize(
    ("robot", "order"),
    [("ur10e", (2, 1, 0, 3, 4, 5)), ("ur10e", (3, 0, 1, 2, 5, 4)), ("kuka_iiwa7", (3, 4, 0, 1, 2, 6, 5))],
)
@pytest.mark.parametrize("load", [0.0, pytest.param(2.0, marks=pytest.mark.slow)])
def test_columns_in_another_order_are_put_right_by_the_torque_of_the_arm(
    robot: str, order: tuple[int, ...], load: float, tmp_path: Path
) -> None:
    motion = swing(robot, load)
    mixed = {name: values[:, list(order)] for name, values in motion.items() if name != "time"} | {"time": TIME}
    file = write(tmp_path / "run.csv", mixed, effort=mixed["effort"])
    draft = draft_import([file], tmp_path, ImportOptions(robot=robot))
    joints = next(line for line in draft.lines if line.key == "joints")
    listed = ", ".join(str(order.index(joint) + 1) for joint in range(len(order)))
    assert f"base to tip the columns are {listed}:" in joints.evidence and not joints.sure
    (run,) = read_recordings(file, mapping_in(draft, tmp_path))
    np.testing.assert_allclose(run.signals.arms["arm"].position, motion["position"], atol=1e-9)
    np.testing.assert_allclose(run.signals.arms["arm"].torque, motion["effort"], atol=1e-6)


@pytest.mark.parametrize("robot", list(CENTRES))
@pytest.mark.parametrize("load", [0.0, 7.0])
@pytest.mark.parametrize("friction", [0.0, 0.1, 0.3])
def test_joints_in_order_are_left_alone(robot: str, load: float, friction: float) -> None:
    motion = swing(robot, load, friction)
    assert order_of_joints(seen(robot, motion, motion["effort"])) is None


def test_columns_without_names_in_another_order_are_put_right(tmp_path: Path) -> None:
    """In the order of the file no torque fits. Kills a search for the order in torques alone that fit already."""
    motion, order = swing("ur10e"), (2, 0, 4, 1, 5, 3)
    mixed = [motion[name][:, list(order)] for name in ("position", "velocity", "effort")]
    np.savetxt(tmp_path / "run.txt", np.column_stack((TIME, *mixed)), delimiter=",")
    draft = draft_import([tmp_path / "run.txt"], tmp_path, ImportOptions(robot="ur10e"))
    (run,) = read_recordings(tmp_path / "run.txt", mapping_in(draft, tmp_path))
    np.testing.assert_allclose(run.signals.arms["arm"].position, motion["position"], atol=1e-9)
    np.testing.assert_allclose(run.signals.arms["arm"].torque, motion["effort"], atol=1e-6)


def test_torques_before_the_gears_show_no_order(tmp_path: Path) -> None:
    """Numbers a hundred times too small are nearest to the order with the smallest gravity torque. Kills that order."""
    motion, order = swing("ur10e"), (2, 0, 4, 1, 5, 3)
    mixed = {name: values[:, list(order)] for name, values in motion.items() if name != "time"} | {"time": TIME}
    file = write(tmp_path / "run.csv", mixed, effort=mixed["effort"] / 101.0)
    draft = draft_import([file], tmp_path, ImportOptions(robot="ur10e"))
    assert next(line for line in draft.lines if line.key == "joints").evidence == (
        "columns hold the joints from base to tip"
    )


def test_a_signal_that_does_not_go_with_the_motion_is_not_excused(tmp_path: Path) -> None:
    motion = swing("ur10e")
    noise = np.random.default_rng(1).normal(0.0, 10.0, motion["effort"].shape)
    file = write(tmp_path / "run.csv", motion, effort=noise)
    draft = draft_import([file], tmp_path, ImportOptions(robot="ur10e"))
    said = next(line for line in draft.lines if line.key == "signals.torque.unit")
    assert not said.sure and "too little torque" not in said.evidence
    assert "N m rms in joint 2, from which the signal is" in said.evidence


def test_a_recording_of_another_laboratory_without_the_weight_is_seen(tmp_path: Path) -> None:
    file = measured_data("cases", "small", "no_gravity.csv")
    mapping = mapping_in(draft_import([file], tmp_path, ImportOptions(robot="ur10e")), tmp_path)
    assert mapping.torque_meaning == "without_gravity"
    assert len(read_recordings(file, mapping)) == 1
