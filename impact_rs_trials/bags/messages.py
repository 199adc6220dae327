# SPDX-License-Identifier: Apache-2.0
"""Messages from plans, measurements and commands, the same for bags written in-process and for nodes.

:class:`MessageMaker` fills messages of the classes that a :class:`MessageTypes` provides: messages of the ``rosbags``
typestore, or rosidl's. A stamp is the origin of the trial plus a whole number of nanoseconds per tick; in simulation
the origin is 0, and stamps are trial time.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import pinocchio as pin

from impact_rs_control.controller import ArmCommand, ImpactDetection
from impact_rs_control.plan import ArmPlan, TrialPlan
from impact_rs_sim.physics import Physics
from impact_rs_sim.plant.plant import ArmTruth
from impact_rs_sim.plant.sensors import ArmMeasurement, ObjectMeasurement
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.robots.urdf import WORLD, joint_names
from impact_rs_sim.rotations import quaternion_of
from impact_rs_sim.scene import BodyState
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.trial_info import TrialInfo
from impact_rs_trials.bags.types import typestore

TF_PERIOD_S = 0.02  # viewers need no shorter one


@dataclass(frozen=True)
class Frame:
    """A frame of ``/tf``.

    Attributes:
        parent: Name of the parent frame.
        name: Name of the frame.
        placement: Placement in the axes of the parent.
    """

    parent: str
    name: str
    placement: pin.SE3


class MessageTypes(Protocol):
    """Source of message classes."""

    def type(self, name: str) -> Any:
        """Class of the message ``package/msg/Name``."""

    def floats(self, values: Array) -> Any:
        """``values`` as this family wants an unbounded float64 array."""


class RosbagsTypes:
    """Message classes of the ``rosbags`` typestore."""

    def __init__(self) -> None:
        self._types = typestore().types

    def type(self, name: str) -> Any:
        """Class of the message ``package/msg/Name``."""
        return self._types[name]

    def floats(self, values: Array) -> Array:
        """Rosbags takes NumPy arrays."""
        return values


class MessageMaker:
    """Fills the messages of one trial.

    Args:
        types: Source of message classes.
        plan: The trial.

    Attributes:
        joints: Names of the joints of every arm, as messages have them.
        origin_ns: Stamp of tick 0 [ns]: ROS time on a robot, 0 in simulation.
    """

    def __init__(self, types: MessageTypes, plan: TrialPlan) -> None:
        self.origin_ns = 0
        self._types = types
        self._plan = plan
        self._header = types.type("std_msgs/msg/Header")
        self._time = types.type("builtin_interfaces/msg/Time")
        self._joint_state = types.type(topics.JOINT_STATE)
        self._controller_state = types.type(topics.CONTROLLER_STATE)
        self._point = types.type("geometry_msgs/msg/Point")
        self._vector = types.type("geometry_msgs/msg/Vector3")
        self._quaternion = types.type("geometry_msgs/msg/Quaternion")
        self._period_ns = round(plan.scene.scenario.timing.control_period * 1e9)
        self.joints = joints_of(plan.scene.physics)
        self._empty = types.floats(np.zeros(0))
        self._references = {name: reference_columns(arm) for name, arm in plan.arms.items()}

    def nanoseconds(self, tick: int) -> int:
        """Trial time of a tick [ns]."""
        return tick * self._period_ns

    def stamp(self, tick: int) -> Any:
        """``builtin_interfaces/Time`` of a tick."""
        seconds, nanoseconds = divmod(self.origin_ns + tick * self._period_ns, 1_000_000_000)
        return self._time(sec=seconds, nanosec=nanoseconds)

    def header(self, tick: int, frame: str = WORLD) -> Any:
        """``std_msgs/Header`` of a tick."""
        return self._header(stamp=self.stamp(tick), frame_id=frame)

    def clock(self, tick: int) -> Any:
        """``rosgraph_msgs/Clock``."""
        return self._types.type(topics.CLOCK_TYPE)(clock=self.stamp(tick))

    def _joints_message(self, tick: int, arm: str, position: Any, velocity: Any, effort: Any) -> Any:
        return self._joint_state(
            header=self.header(tick), name=self.joints[arm], position=position, velocity=velocity, effort=effort
        )

    def joint_states(self, tick: int, arm: str, measured: ArmMeasurement | ArmTruth) -> Any:
        """q, dq, tau_J."""
        floats = self._types.floats
        return self._joints_message(
            tick, arm, floats(measured.position), floats(measured.velocity), floats(measured.torque)
        )

    def motor_states(self, tick: int, arm: str, measured: ArmMeasurement) -> Any:
        """Theta, dtheta; no effort: the motor's own torque is not measured."""
        floats = self._types.floats
        return self._joints_message(
            tick, arm, floats(measured.motor_position), floats(measured.motor_velocity), self._empty
        )

    def joint_command(self, tick: int, arm: str, torque: Array) -> Any:
        """Desired torque tau_d."""
        return self._joints_message(tick, arm, self._empty, self._empty, self._types.floats(torque))

    def controller_state(self, tick: int, arm: str, command: ArmCommand) -> Any:
        """References, feedback and QP of one tick."""
        references = {name: column[tick] for name, column in self._references[arm].items()}
        return self._controller_state(
            header=self.header(tick),
            trial_time=1e-9 * self.nanoseconds(tick),
            robot=arm,
            mode=int(command.mode),
            gamma=float(command.gamma),
            **references,
            position=command.position,
            twist=command.twist,
            feedback_acceleration=command.feedback,
            net_feedback=command.net_feedback,
            commanded_torque=self._types.floats(command.torque),
            external_wrench=command.wrench,
            qp_status=int(command.qp_status),
            qp_iterations=int(command.qp_iterations),
            qp_solve_time=float(command.qp_solve_time),
        )

    def impact_event(self, tick: int, arm: str, detection: ImpactDetection) -> Any:
        """The detected impact."""
        return self._types.type(topics.IMPACT_EVENT)(
            header=self.header(tick),
            robot=arm,
            detected_time=float(detection.time),
            residual=float(detection.force),
            threshold=float(detection.threshold),
            external_wrench=detection.wrench,
            twist=detection.twist,
        )

    def _twist(self, values: Array) -> Any:
        """Linear [m/s], then angular [rad/s]."""
        linear, angular = self._vector(**_xyz(values[:3])), self._vector(**_xyz(values[3:]))
        return self._types.type("geometry_msgs/msg/Twist")(linear=linear, angular=angular)

    def _wrench(self, values: Array) -> Any:
        """Force [N], then torque [N m]."""
        force, torque = self._vector(**_xyz(values[:3])), self._vector(**_xyz(values[3:]))
        return self._types.type("geometry_msgs/msg/Wrench")(force=force, torque=torque)

    def _pose(self, tick: int, position: Array, quaternion: Array) -> Any:
        x, y, z, w = quaternion.tolist()
        pose = self._types.type("geometry_msgs/msg/Pose")(
            position=self._point(**_xyz(position)), orientation=self._quaternion(x=x, y=y, z=z, w=w)
        )
        return self._types.type(topics.POSE)(header=self.header(tick), pose=pose)

    def object_pose(self, tick: int, measured: ObjectMeasurement) -> Any:
        """Tracked pose of the object."""
        return self._pose(tick, measured.position, measured.quaternion)

    def truth_object_pose(self, tick: int, state: BodyState) -> Any:
        """True pose of the object."""
        return self._pose(tick, state.position, quaternion_of(state.rotation))

    def truth_object_twist(self, tick: int, state: BodyState) -> Any:
        """True twist of the object."""
        return self._types.type(topics.TWIST)(header=self.header(tick), twist=self._twist(state.twist))

    def truth_contact_wrench(self, tick: int, truth: ArmTruth) -> Any:
        """True force of the object on the pad."""
        wrench = self._wrench(np.append(truth.pad_force, np.zeros(3)))
        return self._types.type(topics.WRENCH)(header=self.header(tick), wrench=wrench)

    def trial_info(self, info: TrialInfo) -> Any:
        """Identity of the trial."""
        return self._types.type(topics.TRIAL_INFO_TYPE)(**info.values())

    def robot_description(self, urdf: str) -> Any:
        """``std_msgs/String`` with a URDF."""
        return self._types.type(topics.STRING)(data=urdf)

    def transforms(self, tick: int, frames: Iterable[Frame]) -> Any:
        """``tf2_msgs/TFMessage``."""
        make = self._types.type("geometry_msgs/msg/TransformStamped")
        transform = self._types.type("geometry_msgs/msg/Transform")
        messages = []
        for frame in frames:
            x, y, z, w = quaternion_of(frame.placement.rotation).tolist()
            messages.append(
                make(
                    header=self.header(tick, frame.parent),
                    child_frame_id=frame.name,
                    transform=transform(
                        translation=self._vector(**_xyz(frame.placement.translation)),
                        rotation=self._quaternion(x=x, y=y, z=z, w=w),
                    ),
                )
            )
        return self._types.type(topics.TF_MESSAGE)(transforms=messages)


def joints_of(physics: Physics) -> dict[str, list[str]]:
    """Names of the joints of every arm in messages, base to tip."""
    return {name: [f"{name}_{joint}" for joint in joint_names(arm.facts)] for name, arm in physics.arms.items()}


def pose_values(pose: Any) -> Array:
    """Position [m] and quaternion ``(x, y, z, w)`` of a ``geometry_msgs/Pose``, ``(7,)``."""
    position, orientation = pose.position, pose.orientation
    return np.array([position.x, position.y, position.z, orientation.x, orientation.y, orientation.z, orientation.w])


def _xyz(values: Array) -> dict[str, float]:
    x, y, z = values.tolist()
    return {"x": x, "y": y, "z": z}


def reference_columns(arm: ArmPlan) -> dict[str, Array]:
    """Fields of ControllerState that follow from the plan, one row per tick; of the posture the first joint only."""
    columns = {}
    for phase, position, posture in (
        ("ante", arm.ante_position, arm.ante_posture),
        ("post", arm.post_position, arm.post_posture),
    ):
        columns[f"{phase}_position"] = position.position
        columns[f"{phase}_velocity"] = position.velocity
        columns[f"{phase}_acceleration"] = position.acceleration
        rows = np.hstack([part[:, :1] for part in (posture.position, posture.velocity, posture.acceleration)])
        columns[f"{phase}_posture"] = rows if rows.size else np.zeros((len(rows), 3))
    return columns
