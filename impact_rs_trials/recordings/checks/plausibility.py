# SPDX-License-Identifier: Apache-2.0
"""Plausibility of a laboratory's signals: consistency with arm, object and frames of its scenario.

Implausible signals are refused; the message states the contradicting number and the most likely mistake.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin

from impact_rs_sim.errors import InputError
from impact_rs_sim.proportion import Proportion
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_sim.scenarios.scenario import Scenario
from impact_rs_trials.recordings.relations import SINGLE_GRAVITY_FACTORS, evenly, pooled
from impact_rs_trials.recordings.remarks import remark

FIRST_POSE_S = 0.1  # in which the first pose of the object is taken
HEIGHT_TOLERANCE_M = 0.05
MAX_REACH_M = 2.0  # from the base of the arm
MAX_TILT_RAD = np.deg2rad(5.0)  # rad
MIN_PUSHED_M = 0.002  # of an object that the arm pushed
MAX_TOUCH_DISTANCE_M = 0.05  # between pad and object at their nearest
MIN_REPORTED_DISTANCE_M = 0.005
MIN_GRAVITY_TORQUE_NM = 1.0  # rms, noticeable in the torques of a Franka arm
GRAVITY_SAMPLES = 200  # in which the gravity torque is compared


def gravity_torques(model: RobotModel, position: Array) -> Array:
    """g(q) at positions ``(k, n)`` [rad], ``(k, n)`` [N m]."""
    return np.array([model.gravity_torque(q) for q in position]).reshape(position.shape)


def noticed(model: RobotModel) -> float:
    """Smallest gravity torque that is noticeable in the torques of an arm of this size, rms [N m]."""
    size = Proportion.of_robots([model.facts], np.asarray(model.pinocchio.gravity.linear))
    return MIN_GRAVITY_TORQUE_NM * size.factor("N m")


def check_gravity_torque(path: Path, name: str, model: RobotModel, position: Array, torque: Array, remedy: str) -> None:
    """Check that torques include the gravity torque once: neither twice, nor with the wrong sign, nor not at all.

    Args:
        path: Run, for messages.
        name: Signal, for messages.
        model: Nominal arm.
        position: q, ``(k, n)`` [rad].
        torque: Torques at those positions, ``(k, n)`` [N m].
        remedy: Likely mistake.

    Raises:
        InputError: The ratio of torque to gravity torque is not about 1.
    """
    rows = evenly(len(position), GRAVITY_SAMPLES)
    gravity = gravity_torques(model, position[rows])
    if float(np.sum(np.square(gravity))) < noticed(model) ** 2 * rows.size:
        return
    ratio = float(pooled(gravity, torque[rows]).factor[0])
    if not SINGLE_GRAVITY_FACTORS[0] < ratio < SINGLE_GRAVITY_FACTORS[1]:
        raise InputError(
            f"{name} holds {ratio:.2f} times the gravity torque of the scenario's arm, expected about 1: {remedy}",
            file=path,
        )


def height_on_support(scenario: Scenario, name: str, rotation: Array) -> float:
    """Height in A of the centre of an object that stands on the support with axes ``rotation`` [m]."""
    item = scenario.object(name)
    return float(scenario.support.height + item.form.support(np.array(item.size), -rotation[2]))


def check_object(path: Path, scenario: Scenario, arm: str, name: str, time: Array, pose: Array) -> list[str]:
    """Check that the object stands on the support and within reach at first.

    Args:
        path: Run, for messages.
        scenario: Knows arm, object and support.
        arm: Name of the arm.
        name: Name of the object.
        time: Stamps, ``(p,)`` [s].
        pose: Geometric centre and quaternion in A, ``(p, 7)``.

    Returns:
        Warnings to the user.

    Raises:
        InputError: The object is above or below the support, or out of reach.
    """
    centre = np.median(pose[time <= time[0] + FIRST_POSE_S, :3], axis=0)
    rotation = pin.Quaternion(pose[0, 3:]).matrix()
    height = height_on_support(scenario, name, rotation)
    location = f"the centre of {name!r} is first at {np.round(centre, 3).tolist()} m"
    remedy = "pose in another frame or unit? motion_capture in the experiment file says where its world is"
    if abs(centre[2] - height) > HEIGHT_TOLERANCE_M:
        raise InputError(
            f"{location}, expected {height:.3f} m high on the support ({centre[2] - height:+.3f} m off): {remedy}",
            file=path,
        )
    distance = float(np.linalg.norm(centre - np.array(scenario.robots[arm].base.position)))
    if distance > MAX_REACH_M:
        raise InputError(
            f"{location}, {distance:.2f} m from the base of arm {arm!r}, expected less than {MAX_REACH_M:g} m: "
            f"{remedy}",
            file=path,
        )
    remarks = []
    vertical = np.abs(rotation[2])
    if np.argmax(vertical) != 2 or np.arccos(min(1.0, float(vertical[2]))) > MAX_TILT_RAD:
        remarks.append(
            f"the z axis of {name!r} does not point up at first: motion_capture.bodies says how it lies in the tracked "
            "frame"
        )
    if float(np.max(np.linalg.norm(pose[:, :3] - centre, axis=1))) < MIN_PUSHED_M:
        remarks.append(f"{name!r} never moves by {1e3 * MIN_PUSHED_M:g} mm: is it the body that is hit?")
    return remarks


def check_touch(
    path: Path, scenario: Scenario, model: RobotModel, name: str, position: Array, pose: Array
) -> list[str]:
    """Check that pad and object touch at their smallest distance: neither a gap nor a penetration.

    Args:
        path: Run, for messages.
        scenario: Has the object.
        model: Nominal arm.
        name: Name of the object.
        position: q at the timestamps of the object's pose, ``(p, n)`` [rad].
        pose: Geometric centre and quaternion of the object in A, ``(p, 7)``.

    Returns:
        Warnings to the user.

    Raises:
        InputError: Pad and object do not touch.
    """
    item, distances = scenario.object(name), []
    for q, placement in zip(position, pose, strict=True):
        pad_in_object = pin.XYZQUATToSE3(placement).actInv(model.placement(q).translation)
        distances.append(item.form.distance(np.array(item.size), pad_in_object))
    nearest = min(distances)
    half_pad = max(model.end_effector.pad_size[:2]) / 2.0  # an edge of the pad may hit while its middle passes by
    if -MAX_TOUCH_DISTANCE_M < nearest < MAX_TOUCH_DISTANCE_M + half_pad:
        if abs(nearest) < MIN_REPORTED_DISTANCE_M:
            return []
        side = "short of" if nearest > 0.0 else "inside"
        words = (
            "where they are nearest, the middle of the pad is {:.1f} mm {} {}: motion capture and robot disagree by "
            "that much, or their clocks do; or another object is hit, or only by an edge"
        )
        return [remark(words, 1e3 * abs(nearest), side, repr(name))]
    approach = (
        f"never comes nearer to {name!r} than {nearest:.3f} m"
        if nearest > 0.0
        else f"is {-nearest:.3f} m inside {name!r}"
    )
    raise InputError(
        f"the pad {approach}: pose in another frame (motion_capture in the experiment file says where its world is), "
        "of another body or on another clock?",
        file=path,
    )
