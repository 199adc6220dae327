# SPDX-License-Identifier: Apache-2.0
"""Position servos: their law, the torque of a log without torque, and their columns found by an import.

Logs are in closed form: a motion q(t) takes the torque tau of inverse dynamics and friction, and a servo gives it
towards q_desired = q + (tau + kd dq) / kp.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from builders import mapping_in
from joint_recordings import Columns, write_npz
from servo_arm import servo_mapping
from slender_arm import slender_arm

from impact_rs_sim.errors import InputError
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_trials.recordings.importing.import_recordings import ImportDraft, ImportOptions, draft_import
from impact_rs_trials.recordings.mapping import MountedEndEffector
from impact_rs_trials.recordings.recording import read_recordings
from impact_rs_trials.recordings.servo import Servo, ServoLaw

from .test_torque_readings import swing, write

TIME = np.arange(0.0, 10.0, 0.01)  # s
KP, KD = np.array([900.0, 1200.0, 700.0, 150.0, 130.0, 90.0]), np.array([30.0, 40.0, 25.0, 4.0, 3.0, 2.0])
BIG = np.full(2, 1e3)  # N m


def law(**changed: Any) -> ServoLaw:
    return ServoLaw.of(Servo(kp=(100.0, 50.0), kd=(4.0, 2.0), **changed), BIG)


def servo_of_ur(lifted: bool = False) -> Columns:
    """A UR10e under servos; ``lifted``: a controller adds the gravity torque. Its noise is that of the torque, 0.05."""
    motion = swing("ur10e")
    torque = motion["effort"] - (motion["weight"] if lifted else 0.0)
    desired = motion["position"] + (torque + KD * motion["velocity"]) / KP
    return motion | {"torque": torque, "q_desired": desired}


def draft_of(folder: Path, motion: Columns, **signals: np.ndarray) -> ImportDraft:
    file = write(folder / "run.csv", motion, **signals)
    return draft_import([file], folder, ImportOptions(robot="ur10e"))


def rows(gains: np.ndarray) -> np.ndarray:
    return np.ones((TIME.size, 1)) * gains


def test_a_servo_pulls_towards_its_target_and_is_damped() -> None:
    """By hand. Kills q - q_d, + kd dq, and a clip before the damping."""
    q, dq, target, rate = (np.array(values) for values in ([0.1, 0.2], [1.0, -1.0], [0.3, 0.2], [0.5, 0.5]))
    np.testing.assert_allclose(law().torque(q, dq, target, rate), [16.0, 2.0])
    np.testing.assert_allclose(law(damps="error").torque(q, dq, target, rate), [18.0, 3.0])
    np.testing.assert_allclose(law(torque_max=(10.0, 1.0)).torque(q, dq, target, rate), [10.0, 1.0])
    np.testing.assert_allclose(law(torque_max=(17.0, 1.0)).torque(q, -dq, target, rate), [17.0, -1.0])


def test_late_commands_are_those_of_an_earlier_time() -> None:
    """A ramp of 0.2 rad/s that acts 50 ms late is 0.01 rad behind. Kills a delay of the measured position."""
    target = np.outer(0.2 * TIME, [1.0, 1.0])
    still = np.zeros_like(target)
    late = law().late(TIME, still, still, target, still, 0.05)
    np.testing.assert_allclose(late, law().torque(still, still, target - 0.01, still), atol=1e-9)


def swung_servo() -> Columns:
    """The arm of :mod:`servo_arm`, without friction, in closed form."""
    model = RobotModel(slender_arm(("revolute",) * 2), MountedEndEffector().build())
    frequencies = np.array([0.31, 0.43])
    omega = 2.0 * np.pi * frequencies
    q = np.array([-1.2, 0.3]) + 0.5 * np.sin(omega * TIME[:, None])
    dq, ddq = 0.5 * omega * np.cos(omega * TIME[:, None]), -0.5 * omega**2 * np.sin(omega * TIME[:, None])
    torque = np.array([model.inverse_dynamics(*state) for state in zip(q, dq, ddq, strict=True)])
    desired = q + (torque + np.array([6.0, 4.0]) * dq) / np.array([150.0, 100.0])
    return {"time": TIME, "position": q, "velocity": dq, "q_desired": desired, "torque": torque}


def test_the_torque_of_a_log_without_torque_is_that_of_its_servos(tmp_path: Path) -> None:
    log = swung_servo()
    (run,) = read_recordings(write_npz(tmp_path / "run.npz", log), servo_mapping(tmp_path))
    np.testing.assert_allclose(run.signals.arms["arm"].torque, log["torque"], atol=1e-9)
    assert not run.remarks


def test_targets_that_come_rarely_are_held(tmp_path: Path) -> None:
    """Every fifth target has a sample of its own file's time. Kills a target that is interpolated to the next one."""
    log = swung_servo()
    slow = {"time_of_targets": log["time"][::5], "q_desired": log["q_desired"][::5]}
    mapping = servo_mapping(tmp_path)
    own = mapping.signals["q_desired"].model_copy(update={"time_array": "time_of_targets"})
    mapping = mapping.model_copy(update={"signals": {**mapping.signals, "q_desired": own}})
    (run,) = read_recordings(write_npz(tmp_path / "run.npz", log | slow), mapping)
    held = np.repeat(slow["q_desired"], 5, axis=0)
    np.testing.assert_allclose(run.signals.arms["arm"].q_desired, held, atol=1e-12)


def test_a_saturated_servo_gives_its_largest_torque_which_is_said_and_a_wrong_unit_is_refused(tmp_path: Path) -> None:
    log = swung_servo()
    file = write_npz(tmp_path / "run.npz", log)
    most = 0.9 * np.abs(log["torque"]).max(axis=0)
    servo = {"kp": (150.0, 100.0), "kd": (6.0, 4.0), "torque_max": most.tolist()}
    (run,) = read_recordings(file, servo_mapping(tmp_path, servo))
    assert np.abs(run.signals.arms["arm"].torque).max() <= most.max()
    assert any("the servo of joint 1 is at its largest torque in" in remark for remark in run.remarks)
    with pytest.raises(InputError, match="wrong unit of the gain or of q_desired"):
        read_recordings(file, servo_mapping(tmp_path, {"kp": (15e4, 10e4), "kd": (6e3, 4e3)}))


def test_gains_of_another_robot_are_doubted_by_the_gravity_torque(tmp_path: Path) -> None:
    log = swung_servo()
    file = write_npz(tmp_path / "run.npz", log)
    (run,) = read_recordings(file, servo_mapping(tmp_path, {"kp": (50.0, 100.0), "kd": (2.0, 4.0)}))
    (doubt,) = [remark for remark in run.remarks if "servo.kp" in remark]
    assert "times the gravity torque" in doubt


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"servo": {"kp": [1.0]}}, "servo.kp has 1 entries, expected 2"),
        ({"torque_measured_at": "link"}, "servo gives the torque of motors"),
        ({"servo": {"kp": [1.0, 0.0]}}, "servo.kp"),
    ],
)
def test_servos_that_cannot_be_are_refused(changed: dict[str, Any], message: str, tmp_path: Path) -> None:
    changed = dict(changed)
    with pytest.raises(InputError, match=message):
        servo_mapping(tmp_path, changed.pop("servo", None), **changed)


def test_import_finds_targets_and_gains_and_the_mapping_gives_the_torque(tmp_path: Path) -> None:
    log = servo_of_ur()
    draft = draft_of(tmp_path, log, q_des=log["q_desired"], kp=rows(KP), kd=rows(KD))
    mapping = mapping_in(draft, tmp_path)
    assert mapping.servo is not None and mapping.torque_meaning == "whole"
    assert mapping.servo.gains == "given" and mapping.servo.damps == "velocity"
    assert mapping.servo.kp == pytest.approx(KP) and mapping.servo.kd == pytest.approx(KD)
    assert mapping.signals["q_desired"].column == "q_des_{joint}"
    assert next(line.sure for line in draft.lines if line.key == "signals.q_desired.unit")
    (run,) = read_recordings(tmp_path / "run.csv", mapping)
    np.testing.assert_allclose(run.signals.arms["arm"].torque, log["torque"], atol=1e-3)


def test_targets_of_trajectory_controllers_are_damped_by_the_velocity_error(tmp_path: Path) -> None:
    """q_desired and q exchange nothing but the damping. Kills a choice of kd's form by its name."""
    log = servo_of_ur()
    desired = log["position"] + log["torque"] / KP
    rate = np.gradient(desired, TIME, axis=0)
    desired = log["position"] + (log["torque"] - KD * (rate - log["velocity"])) / KP
    draft = draft_of(tmp_path, log, target=desired, kp=rows(KP), kd=rows(KD))
    servo = mapping_in(draft, tmp_path).servo
    assert servo is not None and servo.damps == "error"


@pytest.mark.parametrize("unit", ["rad", "deg"])
def test_without_gains_import_estimates_them_from_gravity_and_says_what_the_log_cannot_hold(
    unit: str, tmp_path: Path
) -> None:
    log = servo_of_ur()
    per = 1.0 if unit == "rad" else 180.0 / np.pi
    motion = log | {"position": per * log["position"], "velocity": per * log["velocity"]}
    draft = draft_of(tmp_path, motion, action=per * log["q_desired"])
    mapping = mapping_in(draft, tmp_path)
    assert mapping.signals["q_desired"].unit == unit
    assert mapping.servo is not None and mapping.servo.gains == "estimated" and mapping.servo.kd is None
    np.testing.assert_allclose(np.array(mapping.servo.kp)[1:3], KP[1:3], rtol=0.1)  # they carry the arm
    assert not next(line.sure for line in draft.lines if line.key == "servo")
    assert any("cannot distinguish masses from gains" in remark for remark in draft.remarks)


def test_the_order_of_joints_without_names_is_found_by_the_torque_of_servos(tmp_path: Path) -> None:
    """Columns from tip to base. Kills an order that a recorded torque alone shows."""
    log, back = servo_of_ur(), slice(None, None, -1)
    motion = log | {name: log[name][:, back] for name in ("position", "velocity")}
    draft = draft_of(tmp_path, motion, q_des=log["q_desired"][:, back], kp=rows(KP[back]), kd=rows(KD[back]))
    mapping = mapping_in(draft, tmp_path)
    assert mapping.signals["q_desired"].columns == tuple(f"q_des_{joint}" for joint in range(6, 0, -1))
    assert mapping.servo is not None and mapping.servo.kp == pytest.approx(KP)


def test_a_controller_that_adds_gravity_is_seen(tmp_path: Path) -> None:
    """Kills a meaning that is whole wherever a servo was found."""
    log = servo_of_ur(lifted=True)
    draft = draft_of(tmp_path, log, q_des=log["q_desired"], kp=rows(KP), kd=rows(KD))
    mapping = mapping_in(draft, tmp_path)
    assert mapping.torque_meaning == "without_gravity"
    (run,) = read_recordings(tmp_path / "run.csv", mapping)
    np.testing.assert_allclose(run.signals.arms["arm"].torque, log["effort"], atol=1e-3)


def test_without_gravity_gains_follow_from_inertia_as_if_motors_had_none(tmp_path: Path) -> None:
    """Kills an acceleration beside the inertial torque, which leaves nothing to find gains from."""
    log = servo_of_ur(lifted=True)
    servo = mapping_in(draft_of(tmp_path, log, q_des=log["q_desired"]), tmp_path).servo
    assert servo is not None
    np.testing.assert_allclose(np.array(servo.kp)[:3], KP[:3], rtol=0.1)


def test_target_and_position_without_names_are_found_by_the_sign_of_the_gain(tmp_path: Path) -> None:
    """A joint hangs behind its target. Kills a gain below zero."""
    log = servo_of_ur()
    names = [f"{name}{joint}" for name in "ab" for joint in range(1, 7)]
    table = np.column_stack([log["time"], log["q_desired"], log["position"]])
    np.savetxt(tmp_path / "run.csv", table, delimiter=",", header=",".join(["time", *names]), comments="", fmt="%.12g")
    draft = draft_import([tmp_path / "run.csv"], tmp_path, ImportOptions(robot="ur10e"))
    signals = mapping_in(draft, tmp_path).signals
    assert (signals["position"].column, signals["q_desired"].column) == ("b{joint}", "a{joint}")
    assert next(line.sure for line in draft.lines if line.key == "signals.q_desired.unit")


def test_gains_that_change_are_not_taken_and_said(tmp_path: Path) -> None:
    log = servo_of_ur()
    changing = rows(KP) * (1.0 + 0.5 * np.sin(TIME))[:, None]
    draft = draft_of(tmp_path, log, q_des=log["q_desired"], kp=changing, kd=rows(KD))
    servo = mapping_in(draft, tmp_path).servo
    assert servo is not None and servo.gains == "estimated"
    assert any("kp_1 … kp_6 changes" in remark for remark in draft.remarks)


@pytest.mark.parametrize("name", ["q_filtered", "q_target"])
def test_a_copy_of_the_positions_is_no_target_of_a_servo(name: str, tmp_path: Path) -> None:
    """A late copy differs by the velocity alone, and a planned path by noise. Kills a role by the name."""
    motion = swing("ur10e")
    noise = np.random.default_rng(1).normal(0.0, 1e-4, motion["position"].shape)
    with pytest.raises(InputError, match="desired positions of servos that make it"):
        draft_of(tmp_path, motion, **{name: motion["position"] - 0.02 * motion["velocity"] + noise})


def test_a_target_that_pushes_joints_away_is_none_of_a_servo(tmp_path: Path) -> None:
    """Its error has the wrong sign. Kills a gain below zero."""
    log = servo_of_ur()
    with pytest.raises(InputError, match="desired positions of servos that make it"):
        draft_of(tmp_path, log, q_des=2.0 * log["position"] - log["q_desired"])


def test_servos_are_preferred_to_a_torque_that_was_not_measured(tmp_path: Path) -> None:
    """A controller's feedforward, and numbers that are called a torque. Kills a torque that is taken by its name."""
    log = servo_of_ur()
    share = np.random.default_rng(3).uniform(0.0, 100.0, log["position"].shape)  # of hobby servos, in percent
    for numbers in (log["computed"], share):
        draft = draft_of(tmp_path, log, q_des=log["q_desired"], kp=rows(KP), kd=rows(KD), torque=numbers)
        assert mapping_in(draft, tmp_path).servo is not None
        assert any("torque_1 … torque_6 is left out" in remark for remark in draft.remarks)


def test_a_recorded_torque_is_preferred_to_that_of_servos(tmp_path: Path) -> None:
    log = servo_of_ur()
    draft = draft_of(tmp_path, log, q_des=log["q_desired"], kp=rows(KP), kd=rows(KD), effort=log["effort"])
    mapping = mapping_in(draft, tmp_path)
    assert mapping.servo is None and mapping.signals["torque"].column == "effort_{joint}"
