# SPDX-License-Identifier: Apache-2.0
"""Limits that a URDF lacks are the measured ranges of the joints, and each is noted."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
import pytest

from impact_rs_cli.main import main
from impact_rs_sim.errors import InputError
from impact_rs_sim.robot import load_facts
from impact_rs_sim.robot_import import import_urdf
from impact_rs_trials.recordings.measured_limits import measured_limits

BODY = (
    '<inertial><origin xyz="0 0 0.1"/><mass value="1"/><inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" '
    'iyz="0"/></inertial>'
)
ARM = (
    f'<robot name="arm"><link name="base"/><link name="upper">{BODY}</link><link name="fore">{BODY}</link>'
    '<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 0 1"/>'
    '<limit lower="0" upper="0" velocity="0" effort="0"/></joint>'
    '<joint name="elbow" type="revolute"><parent link="upper"/><child link="fore"/><axis xyz="0 0 1"/>'
    '<limit lower="-2" upper="2" velocity="3"/></joint></robot>'
)


@pytest.fixture
def urdf(tmp_path: Path) -> Path:
    """As a drawing program writes it: zeros, and no effort."""
    (tmp_path / "arm.urdf").write_text(ARM, encoding="utf-8")
    return tmp_path / "arm.urdf"


def recording(path: Path, names: str, turn: float = 1.0) -> Path:
    """Positions of two joints, the second at twice the range of the first, their velocities and torques."""
    time = np.linspace(0.0, 2.0 * np.pi, 200)
    first, second = np.sin(time) + 0.2, 2.0 * np.sin(time)
    rates = np.cos(time), -2.5 * np.cos(time)
    efforts = 4.0 * np.cos(time), 7.0 * np.cos(time)
    np.savetxt(
        path, turn * np.column_stack([first, second, *rates, *efforts]), delimiter=",", header=names, comments=""
    )
    return path


NUMBERED = "q1,q2,dq1,dq2,tau1,tau2"
NAMED = "shoulder_position,elbow_position,shoulder_velocity,elbow_velocity,shoulder_effort,elbow_effort"
TURNED = "position_tilt,position_swing,velocity_tilt,velocity_swing,effort_tilt,effort_swing"


@pytest.mark.parametrize("names", [NUMBERED, NAMED])
def test_limits_that_are_missing_or_0_are_measured_and_said(urdf: Path, tmp_path: Path, names: str) -> None:
    robot = import_urdf(urdf, measured=partial(measured_limits, recording(tmp_path / "log.csv", names)))
    limits = robot.facts.limits
    assert limits.position_min_rad == pytest.approx((-0.8, -2.0), abs=1e-3)  # of the elbow it is that of the URDF
    assert limits.position_max_rad == pytest.approx((1.2, 2.0), abs=1e-3)
    assert limits.velocity_rad_s == pytest.approx((1.0, 3.0), abs=1e-3)
    assert limits.torque_Nm == pytest.approx((4.0, 7.0), abs=1e-3)
    noted = [note for note in robot.notes if "as measured" in note]
    assert [note.split(" as measured")[0] for note in noted] == [
        "Limits of joint shoulder",
        "Velocity limit of joint shoulder",
        "Effort limit of joint shoulder",
        "Effort limit of joint elbow",
    ]


def test_columns_named_after_joints_may_stand_in_any_order(tmp_path: Path) -> None:
    found = measured_limits(recording(tmp_path / "log.csv", TURNED), ["swing", "tilt"])
    assert found["tilt", "position"] == pytest.approx((-0.8, 1.2), abs=1e-3)
    assert found["swing", "effort"] == pytest.approx((7.0,), abs=1e-3)


def test_what_is_given_goes_before_what_is_measured(urdf: Path, tmp_path: Path) -> None:
    shown = partial(measured_limits, recording(tmp_path / "log.csv", NUMBERED))
    robot = import_urdf(urdf, limits=["*.effort=10", "shoulder.position=-3:3"], measured=shown)
    assert robot.facts.limits.torque_Nm == (10.0, 10.0)
    assert robot.facts.limits.position_max_rad == (3.0, 2.0)


def test_a_recording_that_does_not_say_it_is_refused(urdf: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="limit effort.*--limits shoulder.effort=MOST says it, or --measured"):
        import_urdf(urdf, limits=["*.position=-3:3", "*.velocity=3"])
    with pytest.raises(InputError, match="no 2 columns of positions"):
        measured_limits(recording(tmp_path / "log.csv", "a,b,c,d,e,f"), ["shoulder", "elbow"])
    with pytest.raises(InputError, match="expected rad or m, not degrees or mm"):
        measured_limits(recording(tmp_path / "log.csv", NUMBERED, turn=57.3), ["shoulder", "elbow"])
    with pytest.raises(InputError, match="expected a table"):
        measured_limits(tmp_path / "log.mcap", ["shoulder", "elbow"])


def test_the_command_writes_facts_with_measured_limits(urdf: Path, tmp_path: Path) -> None:
    log, mine = recording(tmp_path / "log.csv", NAMED), tmp_path / "mine.yaml"
    assert main(["robot", "import", str(urdf), "--measured", str(log), "-o", str(mine)]) == 0
    assert load_facts(str(mine)).limits.torque_Nm == pytest.approx((4.0, 7.0), abs=1e-3)
    assert "# Effort limit of joint elbow as measured" in mine.read_text(encoding="utf-8")
