# SPDX-License-Identifier: Apache-2.0
"""Scenario files: the scene, the motion of the robots, and the measurement.

A scenario (``config/scenarios/*.yaml``) holds nominal values. Estimated physics is in model files.

An unknown name raises an :class:`InputError` that lists the known ones; an invalid file raises one with file and key.
"""

from __future__ import annotations

import functools
import hashlib
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Self, TypeVar

import numpy as np
import pinocchio as pin
from pydantic import Field, ValidationInfo, field_validator, model_validator

from impact_rs_sim.errors import InputError, did_you_mean, shortened
from impact_rs_sim.files import is_file
from impact_rs_sim.paths import config_directory
from impact_rs_sim.robots.bodies import is_physically_consistent
from impact_rs_sim.robots.robot import Array, EndEffector, Inertial, Reflexes, RobotFacts, load_facts
from impact_rs_sim.robots.robot_model import STANDARD_GRAVITY, RobotModel
from impact_rs_sim.robots.tool_spring import ToolSpring, about, is_a_spring
from impact_rs_sim.rotations import AXES
from impact_rs_sim.scenarios.friction_compensation import FrictionCompensation
from impact_rs_sim.scenarios.object_mesh import read_object_mesh
from impact_rs_sim.schema import (
    Matrix6,
    Name,
    NonNegativeVector,
    PositiveVector,
    PositiveVector3,
    Schema,
    Vector,
    Vector3,
    Vector6,
    load,
    load_mapping,
    omitted,
    validate,
)
from impact_rs_sim.shapes import ConvexShape, check_extents, hull_of

Positive = Annotated[float, Field(gt=0.0)]
NonNegative = Annotated[float, Field(ge=0.0)]

CORNER_TOLERANCE_M = 1e-6  # of the corners of a hull and its size
UNIT_TOLERANCE = 1e-6  # of the length of a unit vector [-]
# Relative half width of the 95 % interval of an assumed motor inertia: from 0 to three times the assumed value. Three
# times an assumed B_theta is B_rho, the inertia if the torque loop has no effect. Known values of B_rho, over the value
# scaled from a Franka arm by the torque limit: 0.8 to 2.5 in a Franka arm, 1.1 to 3.1 in a UR10e, 0.05 to 0.4 in a
# Stäubli TX40 (docs/real_data.md). 18 of 19 joints lie below three.
ASSUMED_MOTOR_INERTIA = 2.0
Item = TypeVar("Item")


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


def guided_object(consumer: str, key: str, file: str | None = None) -> InputError:
    """Refusal of an object on a hinge or slide by ``consumer``, which takes free and fixed objects."""
    return InputError(
        f"{consumer} takes objects that are free or fixed, and this one has a hinge or slide; impact-rs map takes it",
        key=key,
        file=file,
    )


def _is_unit(vector: Array | tuple[float, ...]) -> bool:
    """Whether a vector has length 1 up to rounding."""
    return bool(abs(np.linalg.norm(vector) - 1.0) <= UNIT_TOLERANCE)


def _check_unit(name: str, vector: tuple[float, ...]) -> None:
    """Refuse a direction that is no unit vector."""
    if not _is_unit(vector):
        raise ValueError(f"{name} must be a unit vector")


def _check_axes(normal: Array, up: Array) -> None:
    """Refuse axes of a pad that are not perpendicular unit vectors."""
    if not (_is_unit(normal) and _is_unit(up)):
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


class Hinge(Schema):
    """A fixed axis about which an object turns, like a door."""

    axis: Vector3 = Field(description="direction of the hinge, in axes of the object, unit vector")
    point: Vector3 = Field(description="a point on it from the geometric centre, in axes of the object [m]")

    @model_validator(mode="after")
    def _along_a_unit_vector(self) -> Self:
        _check_unit("axis", self.axis)
        return self


class ObjectSpec(Schema):
    """A rigid convex object: free, on a hinge or a slide, or fixed to the world."""

    label: str = Field(description="name for tables and figures")
    fixed: bool = omitted(
        False,
        description="whether it is fixed, such as a wall, without mass, com_offset and inertia [-]",
    )
    mass: Positive | None = Field(
        None,
        exclude_if=lambda value: value is None,
        validate_default=True,
        description="mass [kg]; absent where it is fixed",
    )
    size: PositiveVector3 = Field(description="extent along x, y and z [m]")
    com_offset: Vector3 = Field((0.0, 0.0, 0.0), description="centre of mass from the geometric centre [m]")
    shape: Literal["box", "sphere", "capsule", "cylinder", "hull"] = omitted(
        "box",
        description="shape with the extents size; capsule and cylinder have the axis z [-]",
    )
    corners: tuple[Vector3, ...] = omitted(
        (),
        description="corners of a hull from the middle of its bounding box [m]; or mesh, a path from the scenario's"
        " folder, in place of shape, corners, size, com_offset and inertia",
    )
    rpy: Vector3 = omitted(
        (0.0, 0.0, 0.0),
        description="roll, pitch, yaw at rest; pitch pi/2: a cylinder lies [rad]",
    )
    hinge: Hinge | None = omitted(None, description="axis of a door; absent: it is free")
    slide: Vector3 | None = omitted(
        None,
        description="direction in which a drawer slides, unit vector in its axes; absent: it is free",
    )
    inertia: PositiveVector3 | None = omitted(
        None,
        description="principal moments about the centre of mass, in its axes; absent: homogeneous, about the "
        "geometric centre [kg m^2]",
    )
    moments_per_mass: PositiveVector3 | None = omitted(
        None,
        description="in place of inertia: principal moments over the mass; mesh has those of an even density [m^2]",
    )

    @field_validator("mass")
    @classmethod
    def _mass_where_it_moves(cls, mass: float | None, info: ValidationInfo) -> float | None:
        fixed = info.data.get("fixed", False)
        if fixed and mass is not None:
            raise ValueError("nothing moves a fixed object: leave its mass out")
        if not fixed and mass is None:
            raise ValueError("missing; of an object that nothing moves, as a wall, say fixed: true")
        return mass

    @field_validator("inertia", "moments_per_mass")
    @classmethod
    def _inertia_of_a_body(cls, inertia: tuple[float, float, float] | None) -> tuple[float, float, float] | None:
        if inertia is not None and not is_physically_consistent(1.0, np.diag(inertia)):
            raise ValueError("no rigid body has these moments; expected none larger than the sum of the other two")
        return inertia

    @model_validator(mode="after")
    def _size_of_its_shape(self) -> Self:
        check_extents(self.shape, self.size)
        if (self.shape == "hull") != bool(self.corners):
            raise ValueError("corners belong to shape: hull, and a hull needs them [m]")
        if self.corners:
            corners = np.array(self.form.corners)
            extents = np.maximum(corners.max(axis=0), -corners.min(axis=0))
            if np.max(np.abs(2.0 * extents - self.size)) > CORNER_TOLERANCE_M:
                raise ValueError(f"size must be the extents of the corners, {(2.0 * extents).tolist()} [m]")
            if self.inertia is None and self.moments_per_mass is None and not self.fixed:
                raise ValueError("inertia is required for a hull; mesh has that of an even density [kg m^2]")
        return self

    @model_validator(mode="after")
    def _fixed_without_inertia(self) -> Self:
        if self.fixed and (self.inertia or self.moments_per_mass or any(self.com_offset)):
            raise ValueError("nothing moves a fixed object: leave com_offset, inertia and moments_per_mass out")
        return self

    @model_validator(mode="after")
    def _guided_in_one_way(self) -> Self:
        constraints = {"fixed": self.fixed, "hinge": self.hinge is not None, "slide": self.slide is not None}
        if len(stated := [name for name, is_stated in constraints.items() if is_stated]) > 1:
            raise ValueError(
                f"{stated[1]} stands beside {stated[0]}, expected one of them: either says how it may move"
            )
        if self.slide is not None:
            _check_unit("slide", self.slide)
        return self

    @property
    def freedom(self) -> Array | None:
        """Twist of its centre in its own axes per velocity of hinge or slide, ``(6, 1)``; None: it has neither."""
        if self.hinge is not None:
            axis = np.array(self.hinge.axis)
            return np.concatenate((np.cross(self.hinge.point, axis), axis))[:, None]
        return None if self.slide is None else np.array([*self.slide, 0.0, 0.0, 0.0])[:, None]

    @property
    def form(self) -> ConvexShape:
        """Its shape for the geometry."""
        return hull_of(self.corners) if self.shape == "hull" else ConvexShape(self.shape)

    @property
    def moments(self) -> Array:
        """Principal moments about its centre of mass, ``(3,)`` [kg m^2]; infinite for a fixed object."""
        if self.mass is None:
            return np.full(3, np.inf)
        if self.inertia is not None:
            return np.array(self.inertia)
        if self.moments_per_mass is not None:
            return self.mass * np.array(self.moments_per_mass)
        return self.form.moments(self.mass, np.array(self.size))

    @property
    def rotation(self) -> Array:
        """Axes of the object at rest in A, ``(3, 3)``."""
        return np.eye(3) if self.rpy == (0.0, 0.0, 0.0) else np.asarray(pin.rpy.rpyToMatrix(*self.rpy))

    def reach(self, direction: Array) -> float:
        """Support function at rest: extent from its centre along a unit vector in A, ``(3,)`` [m]."""
        return float(self.form.support(np.array(self.size), self.rotation.T @ direction))


class NeighbourSpec(ObjectSpec):
    """A free object on the support beside another object, which hits it."""

    direction: tuple[float, float] = Field(
        description="unit vector along x and y from the neighbour before it, or the object"
    )
    gap: NonNegative = omitted(0.0, description="distance between both at rest [m]")

    @model_validator(mode="after")
    def _free_in_a_direction(self) -> Self:
        if self.fixed:
            raise ValueError("fixed neighbours are not supported: a fixed object is the one that is hit")
        if self.freedom is not None:
            raise ValueError("neighbours on a hinge or slide are not supported: leave hinge and slide out")
        _check_unit("direction", self.direction)
        return self


class Support(Schema):
    """The horizontal surface the object lies on."""

    height: float = Field(description="height of the surface [m]")
    friction: NonNegative = Field(description="friction with the object [-]")
    size: tuple[Positive, Positive] = Field((2.0, 2.0), description="extent along x and y [m]")


class Contact(Schema):
    """Contact law between pad and object."""

    friction: NonNegative = Field(description="friction between pad and object [-]")
    restitution: Annotated[float, Field(ge=0.0, le=1.0)] = Field(
        0.0, description="restitution of the impact map; in a trial 0, or that of the pads [-]"
    )
    restitution_law: Literal["newton", "poisson"] = omitted(
        "newton",
        description="newton: ratio of velocities (may gain energy with friction); poisson: of impulses",
    )
    object_friction: Positive = omitted(0.4, description="friction between object and neighbour [-]")


class CaseRobot(Schema):
    """Motion of one arm in one case."""

    ante_velocity: Vector3 = Field(description="end-effector velocity just before impact [m/s]")
    joint_1: float | None = Field(
        None,
        description="position of joint 1 at impact (seven joints) [rad], prismatic [m]; absent: free",
    )
    joint_1_velocity: float | None = Field(
        None, description="velocity of joint 1 at impact [rad/s], prismatic [m/s]; absent: least-norm joint velocity"
    )
    hands: dict[str, Vector3] = omitted(
        {}, description="velocity of each further hand just before impact, by name [m/s]"
    )
    posture: dict[str, float] = omitted(
        {},
        description="positions of other joints at impact, such as joint_3: 0.2 [rad], prismatic [m]",
    )

    @model_validator(mode="after")
    def _a_posture_of_joints(self) -> Self:
        for name in self.posture:
            if re.fullmatch(r"joint_[1-9]\d*", name) is None:
                raise ValueError(f"posture names {name!r}, expected joint_N with N counted from 1 at the base")
        if self.joint_1 is not None and "joint_1" in self.posture:
            raise ValueError("joint_1 stands in posture as well; give it once [rad]")
        if self.joint_1_velocity is not None and 0 not in self.posture_joints:
            raise ValueError("joint_1_velocity needs a position joint_1 [rad]")
        return self

    @property
    def posture_joints(self) -> dict[int, float]:
        """Joints of the posture task, counted from 0, in order, with their positions at impact [rad]."""
        positions = {int(name.removeprefix("joint_")) - 1: value for name, value in self.posture.items()}
        if self.joint_1 is not None:
            positions[0] = self.joint_1
        return dict(sorted(positions.items()))


class Case(Schema):
    """One ante-impact state."""

    label: str = Field(description="name for tables and figures")
    robots: dict[str, CaseRobot] = Field(description="what each arm does")


class Excursion(Schema):
    """A motion there and back without contact; its peak speed is the magnitude of the case's ante_velocity."""

    start: Vector3 = Field(description="start of frame E from its pose at impact [m]")
    end: Vector3 = Field(description="turning point of frame E from its pose at impact [m]")
    joint_1: float = Field(
        0.0,
        description="change of joint 1 to the turning point, if the posture task holds it [rad], prismatic [m]",
    )
    twist: float = Field(description="rotation of E about the pad's normal to the turning point [rad]")
    begin: Positive = Field(description="when the motion begins [s]")
    rest: Annotated[float, Field(ge=0.0, description="rest at the turning point [s]")]


class Timing(Schema):
    """Times of a trial."""

    nominal_impact: Positive = Field(description="T_nom, nominal impact time [s]")
    approach: Positive = Field(description="duration of the motion that ends at T_nom [s]")
    overrun: Positive = Field(description="the ante-impact reference keeps its velocity past T_nom for this long [s]")
    stop: Positive = Field(description="time in which it then stops [s]")
    push: Positive = Field(description="duration of the post-impact reference until rest [s]")
    slide: Positive = Field(description="time in which the pad stops sliding on the object [s]")
    duration: Positive = Field(description="length of a trial [s]")
    window_before: Positive = Field(description="net feedback starts at T_nom minus this [s]")
    window_after: Positive = Field(description="net feedback ends at T_nom plus this [s]")
    control_period: Positive = Field(0.001, description="period of the controller [s]")
    drive_period: Positive = Field(0.00025, description="period of the torque loop [s]")

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if self.approach > self.nominal_impact:
            raise ValueError("timing.approach must not be longer than timing.nominal_impact [s]")
        if self.nominal_impact + self.window_after > self.duration:
            raise ValueError("the window ends after the trial: nominal_impact + window_after > duration [s]")
        ratio = self.control_period / self.drive_period
        if abs(ratio - round(ratio)) > 1e-9 or ratio < 1:
            raise ValueError("control_period must be a whole multiple of drive_period [s]")
        return self

    @property
    def window(self) -> tuple[float, float]:
        """``(t1, t2)`` of paper eq. a_fb_net [s]."""
        return self.nominal_impact - self.window_before, self.nominal_impact + self.window_after

    @property
    def substeps(self) -> int:
        """Drive periods in one control period."""
        return round(self.control_period / self.drive_period)

    @property
    def ticks(self) -> int:
        """Control periods in one trial."""
        return round(self.duration / self.control_period)


class Gains(Schema):
    """Task gains and weights of the QP (paper eqs. e_pos_ante, e_theta_ante, QP_ante)."""

    position: Positive = Field(description="k_p [1/s^2]")
    orientation: Positive = Field(description="k_theta before impact [1/s^2]")
    orientation_post: Positive = Field(description="k_theta after impact [1/s^2]")
    posture: Positive = Field(description="k_q [1/s^2]")
    position_weight: Positive = Field(description="w_p [s^4/m^2]")
    orientation_weight: Positive = Field(description="w_theta [s^4/rad^2]")
    posture_weight: Positive = Field(description="w_q [s^4/rad^2]")


class Detection(Schema):
    """Impact detection from measured signals."""

    observer_gain: Positive = Field(description="gain of the momentum observer [1/s]")
    threshold: Positive = Field(description="force against the motion at an impact [N]")
    arm_before: Positive = Field(description="detection starts this long before T_nom [s]")


class Control(Schema):
    """Controller settings."""

    gains: Gains = Field(description="task gains")
    interim_duration: Positive = Field(description="Delta t_int, length of the interim mode [s]")
    clamp_force: NonNegative = Field(
        0.0, description="force of every pad after the impact [N]; 0: the object is pushed, not held"
    )
    detection: Detection = Field(description="impact detection")
    reference_contact: Literal["first", "settled"] = omitted(
        "first",
        description="velocity that the post-impact references follow: after the first simultaneous impact, or of the "
        "settled contact",
    )


class Sensors(Schema):
    """Errors of the measurement."""

    joint_position_resolution: NonNegative = Field(description="encoder step [rad], prismatic [m]")
    joint_velocity_noise: NonNegative = Field(description="standard deviation [rad/s], prismatic [m/s]")
    joint_torque_noise: NonNegative = Field(description="standard deviation [N m], prismatic [N]")
    object_position_noise: NonNegative = Field(description="standard deviation [m]")
    object_orientation_noise: NonNegative = Field(description="standard deviation [rad]")
    object_period: Positive = Field(0.004, description="period of the object tracker [s]")


class Scatter(Schema):
    """Scatter from trial to trial, standard deviations."""

    object_position: NonNegative = Field(description="object position in the plane [m]")
    object_yaw: NonNegative = Field(description="object orientation about z [rad]")
    joint_position: NonNegative = Field(description="initial joint positions [rad], prismatic [m]")
    support_friction: NonNegative = Field(description="relative change of the support's friction [-]")


class Uncertainties(Schema):
    """Uncertainty of the numbers of a prediction: half the width of a 95 % interval, and its source."""

    motor_inertia: NonNegative = Field(
        0.10,
        description="B_theta, or B_rho of a rigid drive, relative, each joint by itself; the paper: known to 10 %; "
        f"assumed: {ASSUMED_MOTOR_INERTIA:g}, from none to three times the number [-]",
    )
    link_inertia: NonNegative = Field(
        0.05, description="M of the arm, relative; difference of published parameter sets [-]"
    )
    object_mass: NonNegative = Field(0.005, description="mass with its moments, relative; kitchen scales [-]")
    object_inertia: NonNegative = Field(0.10, description="each moment, relative; assumed [-]")
    object_com_offset: NonNegative = Field(0.005, description="centre of mass, each axis; assumed, as above [m]")
    object_position: NonNegative = Field(
        0.003,
        description="object in the plane, each axis; twice scatter.object_position of push [m]",
    )
    object_yaw: NonNegative = Field(0.012, description="object about z; twice scatter.object_yaw of push [rad]")
    joint_position: NonNegative = Field(
        4e-4, description="each joint; twice scatter.joint_position of push [rad], prismatic [m]"
    )
    joint_velocity: NonNegative = Field(
        4e-3,
        description="each joint; twice sensors.joint_velocity_noise of push [rad/s], prismatic [m/s]",
    )
    contact_point: NonNegative = Field(
        0.002, description="contact points along the pad, each axis; assumed: rounded edges [m]"
    )
    pad_friction: NonNegative = Field(0.20, description="Coulomb coefficient, relative; assumed [-]")
    support_friction: NonNegative = Field(0.20, description="Coulomb coefficient, relative; assumed [-]")
    restitution: NonNegative = Field(0.0, description="restitution [-]")


class Scenario(Schema):
    """A whole experiment (``config/scenarios/*.yaml``)."""

    name: Name = Field(description="name of the scenario")
    description: str = Field(description="what happens, in a sentence")
    axis: Literal["x", "y", "z"] = Field(description="axis of the measure")
    object_position: tuple[float, float] | None = Field(
        None,
        description="middle of the object, x and y [m]; absent: at the only pad",
    )
    object_gap: NonNegative = Field(
        0.0, description="distance between pad and object at the impact pose [m]; 0: the pad hits"
    )
    excursion: Excursion | None = Field(None, description="a motion there and back without contact; absent: a hit")
    robots: dict[Name, Robot] = Field(min_length=1, description="arms by name")
    objects: dict[Name, ObjectSpec] = Field(min_length=1, description="objects by name")
    neighbours: dict[Name, NeighbourSpec] = omitted(
        {},
        description="further, tracked objects in a row, which the object hits, by name",
    )
    support: Support = Field(description="what the object lies on")
    contact: Contact = Field(description="contact between pad and object")
    cases: dict[Name, Case] = Field(min_length=1, description="cases by name")
    velocity_scales: PositiveVector = Field(description="post-impact references, as fractions of the prediction [-]")
    trials: Annotated[int, Field(ge=1)] = Field(description="repeats of every scale")
    timing: Timing = Field(description="times")
    control: Control = Field(description="controller")
    sensors: Sensors = Field(description="measurement")
    scatter: Scatter = Field(description="trial-to-trial scatter")
    gravity: Vector3 = omitted(
        STANDARD_GRAVITY,
        description="gravity; x and y components tilt the table [m/s^2]",
    )
    uncertainty: Uncertainties = omitted(
        Uncertainties(),
        description="assumed half widths of 95 % intervals, for `impact-rs map --uncertainty`",
    )
    friction_compensation: FrictionCompensation | None = omitted(
        None,
        description="file of `impact-rs friction identify`, a path from the scenario's folder",
    )

    @model_validator(mode="after")
    def _friction_compensation_fits(self) -> Self:
        if self.friction_compensation is not None:
            _check_compensation(self.friction_compensation, self)
        return self

    @model_validator(mode="after")
    def _every_case_moves_every_robot(self) -> Self:
        for case_name, case in self.cases.items():
            if set(case.robots) != set(self.robots):
                raise ValueError(
                    f"cases.{case_name}.robots names {sorted(case.robots)}, expected {sorted(self.robots)}"
                )
            for name, robot in case.robots.items():
                count = self.robots[name].robot_facts.joint_count
                if missing := [joint + 1 for joint in robot.posture_joints if joint >= count]:
                    key_path = f"cases.{case_name}.robots.{name}.posture"
                    raise ValueError(f"{key_path} names joint_{missing[0]}, but the arm has {count} joints")
                if set(robot.hands) != set(self.robots[name].hands):
                    key_path = f"cases.{case_name}.robots.{name}.hands"
                    raise ValueError(
                        f"{key_path} names {sorted(robot.hands)}, expected a velocity of each hand of the robot [m/s]: "
                        f"{sorted(self.robots[name].hands)}"
                    )
        return self

    @model_validator(mode="after")
    def _bodies_with_names_of_their_own(self) -> Self:
        names = {"object", "support"}
        hands = {f"robots.{name}.hands": set(robot.hands) for name, robot in self.robots.items()}
        for key, bodies in {"robots": set(self.robots), "neighbours": set(self.neighbours), **hands}.items():
            if repeated := names & bodies:
                raise ValueError(f"{key}.{min(repeated)}: another body has this name; choose another one")
            names |= bodies
        return self

    @model_validator(mode="after")
    def _neighbours_of_a_free_object(self) -> Self:
        if not self.neighbours:
            return self
        if fixed := [name for name, spec in self.objects.items() if spec.fixed]:
            raise ValueError(f"objects.{fixed[0]} is fixed and hits no neighbour: leave neighbours out")
        if guided := [name for name, spec in self.objects.items() if spec.freedom is not None]:
            raise ValueError(f"objects.{guided[0]} is on a hinge or slide and hits no neighbour: leave neighbours out")
        return self

    @model_validator(mode="after")
    def _given_joints_say_where_everything_is(self) -> Self:
        for name, robot in self.robots.items():
            if robot.impact.joint_position is None:
                continue
            key = f"robots.{name}.impact.joint_position"
            if self.object_position is not None:
                raise ValueError(f"{key} says where the object stands, at the pad: leave object_position out [m]")
            for case_name, case in self.cases.items():
                if case.robots[name].posture_joints:
                    raise ValueError(
                        f"{key} holds every joint: leave joint_1 and posture out of cases.{case_name}.robots.{name}"
                    )
        return self

    @model_validator(mode="after")
    def _several_arms_need_an_object_between_them(self) -> Self:
        if len(self.robots) > 1 and self.object_position is None:
            raise ValueError("with several arms, object_position must say where the object stands [m]")
        for name, robot in self.robots.items():
            if robot.hands and robot.impact.joint_position is None and self.object_position is None:
                raise ValueError(f"object_position: missing; it says where the hands of {name} meet the object [m]")
        return self

    @model_validator(mode="after")
    def _excursion_fits(self) -> Self:
        if self.excursion is None:
            return self
        if self.object_gap <= 0.0:
            raise ValueError("an excursion is a motion without contact: object_gap must be > 0 [m]")
        if self.excursion.start == self.excursion.end:
            raise ValueError("excursion.end must differ from start [m]: the motion has the speed of ante_velocity")
        for name, case in self.cases.items():
            for arm, robot in case.robots.items():
                if not any(robot.ante_velocity):
                    raise ValueError(
                        f"cases.{name}.robots.{arm}.ante_velocity is 0: expected the excursion's peak speed, > 0 [m/s]"
                    )
                if self.excursion.joint_1 != 0.0 and 0 not in robot.posture_joints:
                    raise ValueError(f"excursion.joint_1 moves joint 1, which cases.{name} does not hold: give joint_1")
                end = self.excursion_end(robot)
                if end > self.timing.duration:
                    raise ValueError(
                        f"cases.{name}: there and back at this speed ends at {end:.2f} s, after timing.duration [s]"
                    )
        return self

    def impact_placement(self, robot: str, object_name: str, hand: str = "") -> pin.SE3:
        """Placement of frame E of an arm, or of its ``hand``, in the inertial frame when its pad touches an object."""
        pose = self.robots[robot].hands[hand].impact if hand else self.robots[robot]
        assert pose is not None  # a hand without pose has given joints, and is not asked for
        placement = pose.placement if isinstance(pose, HandPose) else pose.impact_placement
        if self.object_position is not None:
            normal = placement.rotation[:, 2]
            centre = np.append(self.object_position, placement.translation[2])
            depth = self.object(object_name).reach(-normal) + self.object_gap
            placement.translation += normal * ((centre - placement.translation) @ normal - depth)
        return placement

    def neighbour_shifts(self, object_name: str) -> list[Array]:
        """Centres of the neighbours at rest from the centre of an object, in A, ``(3,)`` each [m]."""
        down, previous = np.array([0.0, 0.0, -1.0]), self.object(object_name)
        position, height, shifts = np.zeros(3), previous.reach(down), []
        for neighbour in self.neighbours.values():
            along = np.append(neighbour.direction, 0.0)
            position = position + along * (previous.reach(along) + neighbour.gap + neighbour.reach(-along))
            shifts.append(position + [0.0, 0.0, neighbour.reach(down) - height])
            previous = neighbour
        return shifts

    def excursion_leg(self, robot: CaseRobot) -> float:
        """Duration of one leg of the excursion [s]; a quintic from rest to rest peaks at 15/8 of its mean speed."""
        assert self.excursion is not None
        distance = np.linalg.norm(np.array(self.excursion.end) - np.array(self.excursion.start))
        return float(15.0 / 8.0 * distance / np.linalg.norm(robot.ante_velocity))

    def excursion_end(self, robot: CaseRobot) -> float:
        """End of the excursion [s]."""
        assert self.excursion is not None
        return self.excursion.begin + 2.0 * self.excursion_leg(robot) + self.excursion.rest

    def with_settings(self, settings: Mapping[str, Any]) -> Scenario:
        """The scenario with other values.

        Args:
            settings: Values by dotted key, as in ``control.clamp_force``; lists and mappings as in YAML.
        """
        if not settings:
            return self
        settings_data = self.model_dump(mode="json")
        for key, value in settings.items():
            section: Any = settings_data
            *parents, last = key.split(".")
            for part in parents:
                section = section.setdefault(part, {})
                if not isinstance(section, dict):
                    raise InputError(f"{part!r} is a value and has no keys of its own", key=key)
            section[last] = value
        return validate(Scenario, settings_data, f"scenario {self.name!r}")

    @property
    def digest(self) -> str:
        """Digest of the motion of the arms, without names, number of trials and velocity scales."""
        excluded: dict[str, Any] = dict.fromkeys(
            ("name", "description", "velocity_scales", "trials", "friction_compensation", "uncertainty"), True
        )
        excluded["robots"] = {"__all__": {"drive": {"assumed"}}}
        return hashlib.sha256(self.model_dump_json(exclude=excluded).encode()).hexdigest()[:16]

    @property
    def axis_index(self) -> int:
        """0, 1 or 2 for x, y, z."""
        return AXES.index(self.axis)

    def check_chains(self, consumer: str) -> None:
        """Refuse trees, and objects on hinges and slides, because ``consumer`` takes serial arms and other objects.

        Raises:
            InputError: A robot is a tree, or its base floats; or an object has a hinge or a slide.
        """
        for name, robot in self.robots.items():
            robot.robot_facts.check_chain(consumer, f"robots.{name}", self.name)
        for name, spec in self.objects.items():
            if spec.freedom is not None:
                raise guided_object(consumer, f"objects.{name}", self.name)

    def object(self, name: str) -> ObjectSpec:
        """The object ``name``."""
        return _choose("object", name, self.objects, self.name)

    def case(self, name: str) -> Case:
        """The case ``name``; ``1`` is short for ``case_1``."""
        return self.cases[self.case_name(name)]

    def case_name(self, name: str) -> str:
        """Full name of the case ``name``; ``1`` is short for ``case_1``."""
        full = f"case_{name}" if f"case_{name}" in self.cases else name
        _choose("case", full, self.cases, self.name)
        return full


def _choose(kind: str, name: str, table: dict[str, Item], scenario: str) -> Item:
    if name not in table:
        names = ", ".join(table)
        suggestion = did_you_mean(name, table)
        raise InputError(f"scenario {scenario!r} has no {kind} {shortened(name)!r}; it has: {names}{suggestion}")
    return table[name]


def scenario_path(name: str) -> Path:
    """Path of the scenario ``name`` in the config folder, or ``name`` itself where it is a path to a YAML file."""
    directory = config_directory() / "scenarios"
    path = Path(name) if name.endswith((".yaml", ".yml")) else directory / f"{name}.yaml"
    if not is_file(path):
        names = sorted(file.stem for file in directory.glob("*.yaml"))
        raise InputError(
            f"no scenario {shortened(name)!r}; known scenarios: {', '.join(names)}, or give a path to a .yaml file"
            f"{did_you_mean(name, names)}"
        )
    return path


def _check_compensation(compensation: FrictionCompensation, scenario: Scenario) -> None:
    cases = {name: set(case.robots) for name, case in scenario.cases.items()}
    sets = dict.fromkeys(scenario.objects, cases)
    compensation.check(scenario.name, scenario.digest, sets, scenario.timing.duration)


@functools.lru_cache(maxsize=32)
def _named_files(path: Path, modified: int) -> tuple[Path, ...]:
    """Files of robots and meshes of objects that a scenario names."""
    del modified
    data, files = load_mapping(path), []
    for section, key in (("robots", "facts"), ("objects", "mesh"), ("neighbours", "mesh")):
        entries = data.get(section)
        specs = entries.values() if isinstance(entries, dict) else ()
        names = [spec.get(key) for spec in specs if isinstance(spec, dict)]
        files += [path.parent / name for name in names if isinstance(name, str)]
    return tuple(files)


def _modified(path: Path) -> int:
    """Modification time of a file [ns since 1970]; 0: it does not exist."""
    return path.stat().st_mtime_ns if is_file(path) else 0


def _read_robot_files(data: dict[str, Any], directory: Path) -> None:
    """Replace paths to robot facts by the facts, so that bags contain them."""
    robots = data.get("robots")
    for robot in robots.values() if isinstance(robots, dict) else ():
        facts = robot.get("facts") if isinstance(robot, dict) else None
        if isinstance(facts, str) and facts.endswith((".yaml", ".yml")):
            robot["facts"] = load(RobotFacts, directory / facts).model_dump()


def _read_meshes(data: dict[str, Any], directory: Path) -> None:
    """Replace paths to meshes of objects by shape, size and inertia of the meshes, so that bags contain them."""
    sections = {key: data.get(key) for key in ("objects", "neighbours")}
    bodies = {
        f"{key}.{name}": spec
        for key, section in sections.items()
        if isinstance(section, dict)
        for name, spec in section.items()
        if isinstance(spec, dict) and isinstance(spec.get("mesh"), str)
    }
    for key, spec in bodies.items():
        if redundant := {"shape", "corners", "size"} & set(spec):
            raise InputError("mesh has shape, corners and size: leave these out", key=f"{key}.{min(redundant)}")
        mesh = read_object_mesh(directory / spec.pop("mesh"))
        spec |= {"shape": "hull", "corners": mesh.corners.tolist(), "size": mesh.size.tolist()}
        if not spec.get("fixed"):
            spec.setdefault("com_offset", mesh.com.tolist())
            spec.setdefault("moments_per_mass", mesh.moments.tolist())


@functools.lru_cache(maxsize=32)
def _load_cached(path: Path, modified: tuple[int, ...]) -> tuple[Scenario, Path | None]:
    """The scenario of a file, and the file of its friction compensation.

    Args:
        path: The file.
        modified: Modification times of the file and of the files that it names, part of the cache key.
    """
    del modified
    data = load_mapping(path)
    compensation = data.get("friction_compensation")
    if isinstance(compensation, str):
        del data["friction_compensation"]
    _read_robot_files(data, path.parent)
    _read_meshes(data, path.parent)
    return validate(Scenario, data, path), path.parent / compensation if isinstance(compensation, str) else None


@functools.lru_cache(maxsize=32)
def _compensated(
    path: Path, modified: tuple[int, ...], compensation_path: Path, compensation_modified: int
) -> Scenario:
    del compensation_modified
    scenario, _ = _load_cached(path, modified)
    compensation = load(FrictionCompensation, compensation_path)
    try:
        _check_compensation(compensation, scenario)
    except InputError as error:
        raise error.in_file(compensation_path) from None
    return scenario.model_copy(update={"friction_compensation": compensation})


def load_scenario(name: str) -> Scenario:
    """Load a scenario by name or path, and the friction compensation that it names."""
    path = scenario_path(name).resolve()
    own_time = _modified(path)
    modified = (own_time, *map(_modified, _named_files(path, own_time)))
    scenario, compensation = _load_cached(path, modified)
    if compensation is None:
        return scenario
    if not is_file(compensation):
        raise InputError("no such file", file=path, key="friction_compensation", value=str(compensation))
    return _compensated(path, modified, compensation, compensation.stat().st_mtime_ns)
