# SPDX-License-Identifier: Apache-2.0
"""Robots of a scenario: base, drive, end effector, hands, and the configuration at the impact."""

from __future__ import annotations

from typing import Literal, Self

import numpy as np
import pinocchio as pin
from pydantic import Field, field_validator, model_validator

from impact_rs_sim.robots.bodies import is_physically_consistent
from impact_rs_sim.robots.robot import Array, EndEffector, Inertial, Reflexes, RobotFacts, load_facts
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_sim.robots.tool_spring import ToolSpring, about, is_a_spring
from impact_rs_sim.rotations import UNIT_TOLERANCE, is_unit
from impact_rs_sim.schema import (
    Matrix6,
    Name,
    NonNegative,
    NonNegativeVector,
    Positive,
    PositiveVector,
    PositiveVector3,
    Schema,
    Vector,
    Vector3,
    Vector6,
    omitted,
)
from impact_rs_sim.shapes import ConvexShape, check_extents


class Base(Schema):
    """Mounting of an arm."""

    position: Vector3 = Field(description="origin of its base [m]")
    yaw: float = Field(0.0, description="rotation about z [rad]")
    roll: float = omitted(0.0, description="rotation about x, first, as rpy in a URDF; pi: from a ceiling [rad]")
    pitch: float = omitted(0.0, description="rotation about y, second; pi/2: on a wall [rad]")

    @property
    def placement(self) -> pin.SE3:
        """Placement of the base in the inertial frame."""
        return pin.SE3(pin.rpy.rpyToMatrix(self.roll, self.pitch, self.yaw), np.array(self.position))


class Pad(Schema):
    """The flat pad that hits, and the silicone cover that makes it compliant."""

    size: PositiveVector3 = Field(description="width, height, thickness [m]")
    stiffness: Positive | None = Field(None, description="stiffness of its whole face [N/m]; absent: rigid")
    damping: NonNegative = Field(0.0, description="damping of its whole face [N s/m]")
    shape: Literal["box", "sphere", "cylinder"] = omitted(
        "box",
        description="sphere: three equal extents; cylinder: a round pad, equal width and height; frame E is at the "
        "foremost point [-]",
    )

    @model_validator(mode="after")
    def _size_of_its_shape(self) -> Self:
        check_extents(self.shape, self.size)
        return self


class ToolCompliance(Schema):
    """Spring and damper between flange and pad: a force sensor, a flexure or a slender tool."""

    diagonal: Vector6 | None = omitted(
        None,
        description="displacement along x, y, z of frame E per force, rotation per moment, about centre [m/N, rad/(N "
        "m)]; 0: rigid",
    )
    matrix: Matrix6 | None = omitted(
        None,
        description="in place of diagonal: compliance matrix [m/N, 1/N, rad/(N m)]",
    )
    centre: Vector3 = omitted(
        (0.0, 0.0, 0.0),
        description="point in frame E through which forces cause no rotation [m]",
    )
    lag: NonNegative = omitted(0.0, description="damping over stiffness, 2 zeta / omega of a mass on the spring [s]")

    @model_validator(mode="after")
    def _a_spring(self) -> Self:
        if (self.diagonal is None) == (self.matrix is None):
            raise ValueError("expected one of both: diagonal (6 numbers) or matrix (six rows of six)")
        if not is_a_spring(self._given):
            key = "diagonal: an entry is" if self.matrix is None else "matrix: not symmetric, or an eigenvalue"
            raise ValueError(f"{key} below 0; a spring stores energy only, so that no work can be drawn from it")
        return self

    @property
    def _given(self) -> Array:
        return np.diag(self.diagonal) if self.diagonal is not None else np.array(self.matrix)

    def build(self) -> ToolSpring | None:
        """The spring about the origin of E; None where all is rigid."""
        return ToolSpring.of(about(self._given, np.array(self.centre)), self.lag)


class EndEffectorSpec(Schema):
    """Rigid end effector on the flange; its frame E lies in the middle of the pad's outer face, +z outwards."""

    mass: Positive = Field(description="mass [kg]")
    com: Vector3 = Field(description="centre of mass in frame E [m]")
    inertia: PositiveVector3 = Field(description="principal moments about the centre of mass, axes of frame E [kg m^2]")
    length: Positive = Field(description="from the flange to the pad's outer face, along the flange axis [m]")
    mount_yaw: float = Field(0.0, description="rotation of the pad about the flange axis [rad]")
    mount_offset: tuple[float, float] = omitted(
        (0.0, 0.0),
        description="middle of the pad from the flange axis, along x and y of the flange [m]",
    )
    mount_tilt: tuple[float, float] = omitted(
        (0.0, 0.0), description="roll and pitch of the pad on the flange, before mount_yaw [rad]"
    )
    pad: Pad = Field(description="the pad")
    compliance: ToolCompliance | None = omitted(
        None, description="spring and damper between flange and pad, in the twin; absent: the tool is rigid"
    )

    @field_validator("inertia")
    @classmethod
    def _of_a_body(cls, inertia: tuple[float, float, float]) -> tuple[float, float, float]:
        if not is_physically_consistent(1.0, np.diag(inertia)):
            raise ValueError("no rigid body has these moments; expected none larger than the sum of the other two")
        return inertia

    @property
    def tool_spring(self) -> ToolSpring | None:
        """Spring and damper between flange and pad; None: the tool is rigid."""
        return None if self.compliance is None else self.compliance.build()

    def build(self) -> EndEffector:
        """The rigid body for the URDF."""
        return EndEffector(
            mass=self.mass,
            com=np.array(self.com),
            inertia=np.diag(self.inertia),
            length=self.length,
            mount_yaw=self.mount_yaw,
            mount_offset=self.mount_offset,
            mount_tilt=self.mount_tilt,
            pad_size=self.pad.size,
            shape=ConvexShape(self.pad.shape),
        )


DriveNumber = Literal["motor_inertia_rotor", "motor_inertia_reduced", "stiffness", "damping"]


class DriveSettings(Schema):
    """Motor side of the joints (paper eqs. EOM_motor, torque_control_law)."""

    type: Literal["torque_loop", "rigid"] = omitted(
        "torque_loop",
        description="torque_loop: a joint torque loop reduces the motor inertia to B_theta; rigid: the links carry "
        "B_rho",
    )
    motor_inertia_rotor: PositiveVector = Field(
        description="B_rho: rotor inertia times squared gear ratio [kg m^2], prismatic [kg]"
    )
    motor_inertia_reduced: PositiveVector | None = omitted(
        None,
        description="B_theta: motor inertia that the torque loop leaves [kg m^2], prismatic [kg]; required for "
        "torque_loop, absent for rigid",
    )
    stiffness: PositiveVector = Field(description="K: joint stiffness; rigid: of the gear [N m/rad], prismatic [N/m]")
    damping: NonNegativeVector = Field(description="D: joint damping [N m s/rad], prismatic [N s/m]")
    friction: Literal["none", "identified"] = Field(
        "none", description="joint friction in the plant: none, or that of the robot facts"
    )
    actuation_delay: NonNegative = Field(0.0, description="delay of the desired torque [s]")
    assumed: tuple[DriveNumber, ...] = omitted(
        (),
        description="keys of this section with assumed numbers, which reports and verdicts name",
    )

    @model_validator(mode="after")
    def _inertia_of_its_type(self) -> Self:
        if self.type == "torque_loop" and self.motor_inertia_reduced is None:
            raise ValueError(
                "motor_inertia_reduced (B_theta) is required for type torque_loop [kg m^2]; without a torque loop say "
                "type: rigid"
            )
        if self.type == "rigid" and self.motor_inertia_reduced is not None:
            raise ValueError("motor_inertia_reduced is what a torque loop leaves; type rigid has none: leave it out")
        if missing := [name for name in self.assumed if getattr(self, name) is None]:
            raise ValueError(f"assumed names {missing[0]}, which is not in this section")
        return self

    @property
    def assumes_motor_inertia(self) -> bool:
        """Whether :attr:`reflected_inertia` is an assumption."""
        name = "motor_inertia_rotor" if self.motor_inertia_reduced is None else "motor_inertia_reduced"
        return name in self.assumed

    @property
    def reflected_inertia(self) -> tuple[float, ...]:
        """Motor inertia per joint, seen at the links: B_theta with a torque loop, else B_rho [kg m^2]."""
        return self.motor_inertia_rotor if self.motor_inertia_reduced is None else self.motor_inertia_reduced


POSE_KEYS = ("position", "pad_normal", "pad_up", "joint_guess")


def _check_axes(normal: Array, up: Array) -> None:
    """Refuse axes of a pad that are not perpendicular unit vectors."""
    if not (is_unit(normal) and is_unit(up)):
        raise ValueError("pad_normal and pad_up must be unit vectors")
    if abs(normal @ up) > UNIT_TOLERANCE:
        raise ValueError("pad_normal and pad_up must be perpendicular")


def _placement_of(position: Vector3, normal: Vector3, up: Vector3) -> pin.SE3:
    """Placement of a frame E by its origin, the direction out of its pad and its y axis."""
    return pin.SE3(np.column_stack((np.cross(up, normal), up, normal)), np.array(position))


class ImpactPose(Schema):
    """Configuration of the arm at the impact: the pose of frame E, or the position of every joint."""

    position: Vector3 | None = omitted(None, description="origin of frame E at impact [m]")
    pad_normal: Vector3 | None = omitted(None, description="direction out of the pad at impact, unit vector")
    pad_up: Vector3 | None = omitted(None, description="direction of E's y axis at impact, unit vector")
    joint_guess: Vector | None = omitted(
        None, description="joint positions to start inverse kinematics from [rad], prismatic [m]"
    )
    joint_position: Vector | None = omitted(
        None,
        description="joint positions at impact, in place of the four keys above [rad], prismatic [m]",
    )

    @property
    def placement(self) -> pin.SE3:
        """Placement of E in the inertial frame at impact, if it is given as a pose."""
        assert self.position is not None and self.pad_normal is not None and self.pad_up is not None
        return _placement_of(self.position, self.pad_normal, self.pad_up)

    @model_validator(mode="after")
    def _one_of_both(self) -> Self:
        missing = [name for name in POSE_KEYS if getattr(self, name) is None]
        if self.joint_position is None and missing:
            raise ValueError(
                f"expected joint_position, or {', '.join(POSE_KEYS[:-1])} and {POSE_KEYS[-1]}; "
                f"missing: {', '.join(missing)}"
            )
        if self.joint_position is not None and len(missing) < len(POSE_KEYS):
            stated = next(name for name in POSE_KEYS if name not in missing)
            raise ValueError(f"joint_position stands beside {stated}, expected one of both: it says where E is")
        return self

    @model_validator(mode="after")
    def _orthonormal(self) -> Self:
        if self.joint_position is None:
            _check_axes(np.array(self.pad_normal), np.array(self.pad_up))
        return self


class HandPose(Schema):
    """Pose of the pad of a further hand at the impact."""

    position: Vector3 = Field(description="origin of its frame E at impact [m]")
    pad_normal: Vector3 = Field(description="direction out of its pad at impact, unit vector")
    pad_up: Vector3 = Field(description="direction of its y axis at impact, unit vector")

    @model_validator(mode="after")
    def _orthonormal(self) -> Self:
        _check_axes(np.array(self.pad_normal), np.array(self.pad_up))
        return self

    @property
    def placement(self) -> pin.SE3:
        """Placement of its frame E in the inertial frame at impact."""
        return _placement_of(self.position, self.pad_normal, self.pad_up)


class HandSpec(Schema):
    """A further hand of a robot, which hits at once."""

    end_effector: EndEffectorSpec = Field(description="end effector on its flange")
    impact: HandPose | None = omitted(
        None, description="pose of its pad at the impact; absent with impact.joint_position"
    )


class Robot(Schema):
    """One arm of the scene."""

    facts: str | RobotFacts = Field(
        description="robot in config/robots, or path of a YAML file from the scenario's folder. That file has these "
        "keys"
    )
    base: Base = Field(description="mounting of the arm, or pose of a floating base at the impact")
    end_effector: EndEffectorSpec = Field(description="end effector")
    drive: DriveSettings = Field(description="motor side")
    impact: ImpactPose = Field(description="pose at impact")
    hands: dict[Name, HandSpec] = omitted(
        {}, description="further hands of the facts, by name, which hit at the same moment"
    )
    reflexes: Reflexes | None = omitted(
        None,
        description="reflex thresholds in these trials, with the keys of the facts, in their place",
    )

    @model_validator(mode="after")
    def _one_entry_per_joint(self) -> Self:
        count = self.robot_facts.joint_count
        for name in ("motor_inertia_rotor", "motor_inertia_reduced", "stiffness", "damping"):
            values = getattr(self.drive, name)
            length = count if values is None else len(values)
            if length != count:
                raise ValueError(f"drive.{name} has {length} entries, expected one per joint ({count})")
        if self.robot_facts.floating_base is not None and self.impact.joint_position is None:
            raise ValueError(
                "impact: a base that floats reaches any pose; expected joint_position, and the pose of the base at "
                "the impact in base"
            )
        key = "joint_guess" if self.impact.joint_position is None else "joint_position"
        if len(getattr(self.impact, key)) != count:
            raise ValueError(f"impact.{key} must have one entry per joint ({count}) [rad], prismatic [m]")
        for name in ("external_torque_Nm", "velocity_jump_rad_s"):
            values = None if self.reflexes is None else getattr(self.reflexes, name)
            if values is not None and len(values) != count:
                raise ValueError(f"reflexes.{name} has {len(values)} entries, expected one per joint ({count})")
        if self.drive.type == "torque_loop" and not self.robot_facts.joint_torque_loop:
            raise ValueError(f"{self.facts_name} has no torque loop that could shape its inertia: drive.type: rigid")
        if self.drive.friction == "identified" and self.robot_facts.friction is None:
            raise ValueError(f"drive.friction is 'identified', but {self.facts_name} has none in its facts")
        return self

    @model_validator(mode="after")
    def _hands_of_its_facts(self) -> Self:
        hand_names = [hand.name for hand in self.robot_facts.hands]
        for name, hand in self.hands.items():
            if name not in hand_names:
                raise ValueError(
                    f"hands.{name}: {self.facts_name} has no such hand; it has: {', '.join(hand_names) or 'none'}; "
                    "impact-rs robot import --hand LINK writes one"
                )
            if hand.impact is None and self.impact.joint_position is None:
                raise ValueError(f"hands.{name}.impact: missing; expected the pose of its pad, as impact has it")
            if hand.impact is not None and self.impact.joint_position is not None:
                raise ValueError(f"hands.{name}.impact: joint_position says where the hand is: leave it out")
        return self

    @model_validator(mode="after")
    def _facts_of_a_robot_that_can_be(self) -> Self:
        """Refuse negative moments of inertia and empty ranges; ``robot check`` reads such facts and reports them."""
        base = self.robot_facts.floating_base
        bodies: dict[str, Inertial] = {f"links.{number}": link for number, link in enumerate(self.robot_facts.links)}
        for key, link in (bodies if base is None else bodies | {"floating_base": base}).items():
            smallest = float(np.linalg.eigvalsh(link.inertia_matrix)[0])
            if smallest < 0.0:
                key_path = f"{self.facts_name}: {key}.inertia"
                raise ValueError(f"{key_path} has the principal moment {smallest:.3g}, expected none below 0 [kg m^2]")
        limits = self.robot_facts.limits
        for number, (low, high) in enumerate(zip(limits.position_min_rad, limits.position_max_rad, strict=True)):
            if low >= high:
                raise ValueError(
                    f"{self.facts_name}: limits.position_min_rad.{number} = {low:g} must be below position_max_rad = "
                    f"{high:g} [rad]"
                )
        return self

    @property
    def robot_facts(self) -> RobotFacts:
        """Kinematics, inertials and limits."""
        return load_facts(self.facts) if isinstance(self.facts, str) else self.facts

    @property
    def impact_placement(self) -> pin.SE3:
        """Placement of E in the inertial frame at impact, as given or by forward kinematics."""
        if self.impact.joint_position is None:
            return self.impact.placement
        model = RobotModel(self.robot_facts, self.end_effector.build(), self.base.placement)
        return model.placement(model.position_of(np.array(self.impact.joint_position)))

    @property
    def assumed(self) -> tuple[str, ...]:
        """Assumptions about the arm, neither measured nor published: keys of its drive, and entries of its facts."""
        return (*(f"drive.{name}" for name in self.drive.assumed), *self.robot_facts.assumed)

    @property
    def facts_name(self) -> str:
        """Name of the robot in errors: its name in config/robots, or the source of its facts."""
        return self.facts if isinstance(self.facts, str) else self.facts.source
