# SPDX-License-Identifier: Apache-2.0
"""Robot facts and end effector: the data a URDF is written from, without derived values.

A joint rotates about the z axis of its frame (``revolute``) or translates along it (``prismatic``). Values per joint
have the units of its coordinate, :data:`UNITS`; docstrings say rad, N m, kg m^2 for a prismatic joint's m, N, kg.
"""

from __future__ import annotations

import functools
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from pydantic import Field, model_validator

from impact_rs_sim.errors import InputError, shortened
from impact_rs_sim.files import is_file
from impact_rs_sim.paths import config_directory
from impact_rs_sim.schema import NonNegativeVector, PositiveVector, Schema, Vector, Vector3, load, omitted
from impact_rs_sim.shapes import BOX, ConvexShape

Array = NDArray[np.float64]
JointType = Literal["revolute", "prismatic"]


@dataclass(frozen=True)
class JointUnits:
    """Units of the coordinate of a joint and of the quantities derived from it.

    Attributes:
        position: Of q.
        velocity: Of dq.
        acceleration: Of ddq.
        effort: Of its force or torque.
        inertia: Of the inertia that it moves.
        stiffness: Of its spring.
        damping: Of its damper.
    """

    position: str
    velocity: str
    acceleration: str
    effort: str
    inertia: str
    stiffness: str
    damping: str


UNITS: dict[JointType, JointUnits] = {
    "revolute": JointUnits("rad", "rad/s", "rad/s^2", "N m", "kg m^2", "N m/rad", "N m s/rad"),
    "prismatic": JointUnits("m", "m/s", "m/s^2", "N", "kg", "N/m", "N s/m"),
}


def joined_units(units: Iterable[str]) -> str:
    """Text of the units of several joints, ``rad or m`` for example."""
    return " or ".join(dict.fromkeys(units))


Share = Annotated[float, Field(ge=0.0, le=1.0)]
Share3 = tuple[Share, Share, Share]


class JointOrigin(Schema):
    """Placement of a joint in the previous link, and its type: rotation about its own +z, or translation along it."""

    type: JointType = omitted("revolute", description="revolute: turns about +z; prismatic: slides along +z")
    xyz: Vector3 = Field(description="origin of the joint in the previous link [m]")
    rpy: Vector3 = Field(description="roll, pitch, yaw of the joint in the previous link [rad]")

    @property
    def units(self) -> JointUnits:
        """Units of the values of this joint."""
        return UNITS[self.type]


class Flange(Schema):
    """Placement of the flange in the last link; the end effector stands on its +z."""

    xyz: Vector3 = Field(description="origin of the flange in the last link [m]")
    rpy: Vector3 = omitted((0.0, 0.0, 0.0), description="roll, pitch, yaw of the flange in the last link [rad]")

    @property
    def rotation(self) -> Array:
        """Axes of the flange in the last link, ``(3, 3)``."""
        return np.asarray(pin.rpy.rpyToMatrix(*self.rpy))


class Mesh(Schema):
    """Mesh of a link for viewers; without influence on the physics."""

    file: str = Field(pattern=r"^(package|file)://", description="where a viewer finds it, package://... or file://...")
    xyz: Vector3 = Field((0.0, 0.0, 0.0), description="origin of the mesh in the link [m]")
    rpy: Vector3 = Field((0.0, 0.0, 0.0), description="roll, pitch, yaw of the mesh in the link [rad]")
    scale: Vector3 = Field((1.0, 1.0, 1.0), description="scale along the axes of the mesh [-]")


class Link(Schema):
    """Inertial parameters of one link, in the axes of the link frame."""

    mass: Annotated[float, Field(gt=0.0, description="mass of the link [kg]")]
    com: Vector3 = Field(description="centre of mass in the link frame [m]")
    inertia: tuple[float, float, float, float, float, float] = Field(
        description="ixx, ixy, ixz, iyy, iyz, izz about the centre of mass [kg m^2]"
    )
    meshes: tuple[Mesh, ...] = omitted((), description="what viewers show; none: a simple shape")
    name: str = omitted("", description="name of the link in its source file, for messages")

    @property
    def inertia_matrix(self) -> Array:
        """Inertia about the centre of mass, ``(3, 3)`` [kg m^2]."""
        ixx, ixy, ixz, iyy, iyz, izz = self.inertia
        return np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]])


class Limits(Schema):
    """Hardware limits, one entry per joint; of a prismatic joint m, m/s and N, whatever the names of the keys say."""

    position_min_rad: Vector = Field(description="lower joint position limits [rad], prismatic [m]")
    position_max_rad: Vector = Field(description="upper joint position limits [rad], prismatic [m]")
    velocity_rad_s: PositiveVector = Field(description="joint velocity limits [rad/s], prismatic [m/s]")
    torque_Nm: PositiveVector = Field(description="joint torque limits [N m], prismatic [N]")


class SigmoidFriction(Schema):
    """Joint friction of Gaz et al. 2019: ``a / (1 + exp(-b (dq + c))) - a / (1 + exp(-b c))``."""

    a: NonNegativeVector = Field(description="height of the sigmoid per joint [N m], prismatic [N]")
    b: PositiveVector = Field(description="slope of the sigmoid per joint [s/rad], prismatic [s/m]")
    c: Vector = Field(description="shift of the sigmoid per joint [rad/s], prismatic [m/s]")


class Reflexes(Schema):
    """Thresholds of the robot's own collision reflexes; a missing one is unknown."""

    source: str = Field("", description="where the thresholds come from, and how they are changed")
    external_torque_Nm: PositiveVector | None = Field(
        None, description="external joint torque at which the robot stops itself, per joint [N m], prismatic [N]"
    )
    external_force_N: Annotated[float, Field(gt=0.0)] | None = Field(
        None, description="external force at the end effector at which the robot stops itself [N]"
    )
    velocity_jump_rad_s: PositiveVector | None = Field(
        None,
        description="largest joint velocity jump that the gears endure [rad/s], prismatic [m/s]",
    )
    observer_gain: Annotated[float, Field(gt=0.0)] = Field(
        500.0, description="rate of the filter of external torques and forces [1/s]"
    )


class Colours(Schema):
    """Colours of the simple shapes in which viewers show an arm; without influence on the physics."""

    shell: Share3 = Field((0.92, 0.92, 0.94), description="tubes and housings, red green blue from 0 to 1 [-]")
    joint: Share3 = Field(
        (0.25, 0.27, 0.3), description="rings of the joints and the foot, red green blue from 0 to 1 [-]"
    )


class RobotFacts(Schema):
    """Public facts about an arm (``config/robots/*.yaml``)."""

    source: str = Field(description="where the numbers come from")
    joints: tuple[JointOrigin, ...] = Field(min_length=1, description="joint origins")
    flange: Flange = Field(description="flange on the last link")
    limits: Limits = Field(description="hardware limits")
    links: tuple[Link, ...] = Field(min_length=1, description="link inertials")
    base_meshes: tuple[Mesh, ...] = omitted((), description="what viewers show of the base; none: a simple shape")
    colours: Colours = omitted(Colours(), description="of the simple shapes in viewers")
    friction: SigmoidFriction | None = Field(None, description="identified joint friction")
    reflected_rotor_inertia_other_source_kg_m2: PositiveVector | None = Field(
        None, description="reflected rotor inertia per joint from another source [kg m^2], prismatic [kg]"
    )
    joint_stiffness_typical_Nm_per_rad: PositiveVector | None = Field(
        None, description="order of magnitude of the joint stiffness [N m/rad], prismatic [N/m]"
    )
    reflexes: Reflexes | None = omitted(None, description="what stops the robot by itself at a hit")
    joint_torque_loop: bool = omitted(
        True, description="whether the joints have torque sensors and a torque loop; false: drive.type rigid"
    )

    assumed: tuple[str, ...] = Field(
        (),
        exclude_if=lambda value: value == (),
        repr=False,
        description="estimated or assumed numbers, neither measured nor published by the maker, and why, in words; "
        "`robot check`, reports and verdicts repeat it",
    )

    @model_validator(mode="after")
    def _same_length_everywhere(self) -> Self:
        count = len(self.joints)
        lengths = {
            "links": len(self.links),
            **{f"limits.{name}": len(getattr(self.limits, name)) for name in Limits.model_fields},
        }
        for name in ("external_torque_Nm", "velocity_jump_rad_s"):
            if self.reflexes is not None and (values := getattr(self.reflexes, name)) is not None:
                lengths[f"reflexes.{name}"] = len(values)
        for name, length in lengths.items():
            if length != count:
                raise ValueError(f"{name} has {length} entries, expected one per joint ({count})")
        return self

    @property
    def joint_count(self) -> int:
        """Number of joints."""
        return len(self.joints)

    @property
    def joint_types(self) -> tuple[JointType, ...]:
        """Type of every joint, base to tip."""
        return tuple(joint.type for joint in self.joints)

    @property
    def units(self) -> tuple[JointUnits, ...]:
        """Units of the values of every joint, base to tip."""
        return tuple(joint.units for joint in self.joints)


@functools.lru_cache(maxsize=16)
def load_facts(name: str) -> RobotFacts:
    """Facts of the robot ``name``: ``config/robots/NAME.yaml``, or a path to such a file.

    Raises:
        InputError: There is no such robot, or its file breaks the schema.
    """
    directory = config_directory() / "robots"
    path = Path(name) if name.endswith((".yaml", ".yml")) else directory / f"{name}.yaml"
    if not is_file(path):
        known = ", ".join(sorted(file.stem for file in directory.glob("*.yaml")))
        raise InputError(f"no robot {shortened(name)!r}; known robots: {known}")
    return load(RobotFacts, path)


@dataclass(frozen=True, eq=False)
class EndEffector:
    """Rigid end effector with a pad, in the end-effector frame E.

    E has its origin at the centre of the pad's outer face; +z points out of the pad.

    Attributes:
        mass: Mass [kg].
        com: Centre of mass in E, ``(3,)`` [m].
        inertia: Inertia about the centre of mass in axes of E, ``(3, 3)`` [kg m^2].
        length: Distance from the flange to the pad's outer face, along the flange axis [m].
        mount_yaw: Rotation of E about the flange axis [rad].
        pad_size: Width (x), height (y) and thickness (z) of the pad [m].
        pad_tilt: Roll and pitch of the pad in E, about the centre of its outer face: about x, then about the y of E
            [rad]. E stays where it is: the tilt is unknown to the controller.
        pad_offset: Middle of the pad's outer face in E [m]; likewise unknown to the controller.
        shape: Shape of the pad within the extents ``pad_size``.
        mount_offset: Origin of E across the flange axis, along x and y of the flange [m].
        mount_tilt: Roll and pitch of E in the flange, before its yaw as rpy in a URDF [rad].
    """

    mass: float
    com: Array
    inertia: Array
    length: float
    mount_yaw: float
    pad_size: tuple[float, float, float]
    pad_tilt: tuple[float, float] = (0.0, 0.0)
    pad_offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    shape: ConvexShape = BOX
    mount_offset: tuple[float, float] = (0.0, 0.0)
    mount_tilt: tuple[float, float] = (0.0, 0.0)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, EndEffector) and self._numbers == other._numbers

    def __hash__(self) -> int:
        return hash(self._numbers)

    @property
    def _numbers(self) -> tuple[object, ...]:
        arrays = self.com.tobytes(), self.inertia.tobytes()
        return (
            self.mass,
            *arrays,
            self.length,
            self.mount_yaw,
            tuple(self.pad_size),
            tuple(self.pad_tilt),
            self.pad_offset,
            self.shape,
            *self.mount_numbers,
        )

    @property
    def mount_numbers(self) -> tuple[float, ...]:
        """Position of E on the flange [m] and roll, pitch, yaw there [rad]."""
        return (*self.mount_offset, self.length, *self.mount_tilt, self.mount_yaw)

    @property
    def mount(self) -> pin.SE3:
        """Placement of E on the flange."""
        numbers = self.mount_numbers
        return pin.SE3(pin.rpy.rpyToMatrix(*numbers[3:]), np.array(numbers[:3]))

    @property
    def pad_placement(self) -> pin.SE3:
        """Middle and axes of the pad in E."""
        rotation = pin.rpy.rpyToMatrix(*self.pad_tilt, 0.0)
        return pin.SE3(rotation, np.array(self.pad_offset) - self.pad_size[2] / 2.0 * rotation[:, 2])
