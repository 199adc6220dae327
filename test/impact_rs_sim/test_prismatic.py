"""Joints that slide: closed forms of a cart with a pendulum and of a rail, in units of metres, newtons and kilograms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from impact_rs_sim.assumed_drive import SPEED, assumed_drive
from impact_rs_sim.drive import DriveStart
from impact_rs_sim.errors import Infeasible, InputError
from impact_rs_sim.impact_map import ImpactProblem, predict_impact
from impact_rs_sim.impact_map.derivatives import chain_derivative
from impact_rs_sim.impact_map.parameters import parameters_of
from impact_rs_sim.impact_map.problem import check_problem
from impact_rs_sim.mechanics import Mechanics
from impact_rs_sim.physics import JointFriction, Physics
from impact_rs_sim.robot import EndEffector, RobotFacts, load_facts
from impact_rs_sim.robot_check import check_drives, check_facts
from impact_rs_sim.robot_model import RobotModel
from impact_rs_sim.scenario import load_scenario
from impact_rs_sim.scene import ArmState, BodyState

PERIOD = 2.5e-4  # s
CART, BOB, LENGTH, ROD = 3.0, 1.2, 0.4, 0.02  # kg, kg, m, kg m^2 of the bob about its own centre
PAD = EndEffector(1e-9, np.zeros(3), 1e-12 * np.eye(3), 0.0, 0.0, (0.05, 0.05, 0.005))
TURNED = {"y": (-np.pi / 2, 0.0, 0.0), "x": (0.0, np.pi / 2, 0.0)}  # rpy whose z is that axis of A


def facts_of(
    *joints: tuple[str, str, float, tuple[float, float, float], float], flange: tuple[float, float, float] = (0, 0, 0)
) -> RobotFacts:
    """Joints one in the other: type, axis in A at q = 0, mass, centre in axes of A, moment of every axis [kg m^2]."""
    before, origins, links = np.eye(3), [], []
    for kind, axis, mass, com, moment in joints:
        turn = np.eye(3) if axis == "z" else _rotation(TURNED[axis])
        rpy = _rpy(before.T @ turn)
        origins.append({"type": kind, "xyz": (0, 0, 0), "rpy": rpy})
        links.append({"mass": mass, "com": tuple(turn.T @ com), "inertia": (moment, 0, 0, moment, 0, moment)})
        before = turn
    count = len(joints)
    return RobotFacts.model_validate(
        {
            "source": "closed form",
            "joints": origins,
            "flange": {"xyz": tuple(before.T @ flange), "rpy": _rpy(before.T @ _rotation(TURNED["x"]))},
            "limits": {
                "position_min_rad": [-2.0] * count,
                "position_max_rad": [2.0] * count,
                "velocity_rad_s": [3.0] * count,
                "torque_Nm": [200.0] * count,
            },
            "links": links,
        }
    )


def _rotation(rpy: tuple[float, float, float]) -> np.ndarray:
    import pinocchio as pin

    return np.asarray(pin.rpy.rpyToMatrix(*rpy))


def _rpy(rotation: np.ndarray) -> tuple[float, ...]:
    import pinocchio as pin

    return tuple(pin.rpy.matrixToRpy(rotation))
