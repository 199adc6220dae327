# SPDX-License-Identifier: Apache-2.0
"""Robot facts and end effector: the data of a URDF, without derived values.

A joint rotates about the z axis of its frame (``revolute``) or translates along it (``prismatic``). Values per joint
have the units of its coordinate, :data:`UNITS`; docstrings say rad, N m, kg m^2 for a prismatic joint's m, N, kg.

An arm is a chain: every joint is mounted on the link of the previous joint. A **tree** has joints on other links (two
arms on a torso), joints that follow others (fingers; URDF's ``mimic``), or a floating base (a humanoid, a drone). Its n
coordinates are the positions of the joints that follow no other, in the order of the file. With a floating base,
configuration and velocity begin with its pose and its twist, in Pinocchio's convention:

    q = (x, y, z, qx, qy, qz, qw, q_1 ... q_n),      v = (v_base, omega_base, dq_1 ... dq_n)

with the position of the base in A, the quaternion from its axes to those of A, and its twist in its own axes.

A tree may hit with several pads at once: one on the flange, and one on each of its further ``hands``.
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
        position: Unit of q.
        velocity: Unit of dq.
        acceleration: Unit of ddq.
        effort: Unit of its force or torque.
        inertia: Unit of the inertia that it moves.
        stiffness: Unit of its spring.
        damping: Unit of its damper.
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
PINION_RADIUS_M = 0.05  # of the pinion that converts ranges of revolute joints to prismatic ones


def travel_per_rad(kinds: Iterable[JointType]) -> Array:
    """Travel of joints per radian of a revolute joint; a pinion drives sliding joints, ``(n,)`` [rad or m]."""
    return np.array([1.0 if kind == "revolute" else PINION_RADIUS_M for kind in kinds])


BASE = "base"  # name of the base where robot facts name links
BASE_COLUMNS = (*(f"base_v{axis}" for axis in "xyz"), *(f"base_w{axis}" for axis in "xyz"))  # of a floating base
BASE_POSE_SIZE = 7  # position and quaternion of a floating base, in front of the joints


def joined_units(units: Iterable[str]) -> str:
    """Text of the units of several joints, ``rad or m`` for example."""
    return " or ".join(dict.fromkeys(units))


Share = Annotated[float, Field(ge=0.0, le=1.0)]
Share3 = tuple[Share, Share, Share]


class Mimic(Schema):
    """The joint that another one follows: ``q = ratio q_followed + offset``."""

    joint: str = Field(description="name of that joint, which follows no other")
    ratio: float = Field(1.0, description="its motion per motion of that joint [-, m/rad or rad/m]")
    offset: float = Field(0.0, description="its position where that joint is at 0 [rad], prismatic [m]")


class JointOrigin(Schema):
    """Placement of a joint in the link that carries it, and its type: rotation about its own +z, or translation."""

    type: JointType = omitted("revolute", description="revolute: turns about +z; prismatic: slides along +z")
    xyz: Vector3 = Field(description="origin of the joint in the previous link [m]")
    rpy: Vector3 = Field(description="its roll, pitch, yaw there [rad]")
    name: str = omitted("", description="name of the joint in its source file")
    parent: str = omitted("", description="name of the link that carries it, or base; absent: the previous link")
    mimic: Mimic | None = omitted(None, description="joint that it follows; absent: it moves by itself")

    @property
    def units(self) -> JointUnits:
        """Units of the values of this joint."""
        return UNITS[self.type]


class Flange(Schema):
    """Placement of the flange in the last link; the end effector stands on its +z."""

    xyz: Vector3 = Field(description="origin of the flange in the last link [m]")
    rpy: Vector3 = omitted((0.0, 0.0, 0.0), description="its roll, pitch, yaw there [rad]")
    link: str = omitted("", description="name of the link that has the flange, or base; absent: the last one")

    @property
    def rotation(self) -> Array:
        """Axes of the flange in the last link, ``(3, 3)``."""
        return np.asarray(pin.rpy.rpyToMatrix(*self.rpy))


class Hand(Flange):
    """A further flange of a tree; its pad and the pad of the first flange hit at once."""

    name: str = Field(min_length=1, description="name of the hand in scenarios, results and tables")

    @property
    def placement(self) -> pin.SE3:
        """Placement of the flange in its link."""
        return pin.SE3(self.rotation, np.array(self.xyz))


class Mesh(Schema):
    """Mesh of a link for viewers; without influence on the physics."""

    file: str = Field(pattern=r"^(package|file)://", description="its address, package://... or file://...")
    xyz: Vector3 = Field((0.0, 0.0, 0.0), description="origin of the mesh in the link [m]")
    rpy: Vector3 = Field((0.0, 0.0, 0.0), description="its roll, pitch, yaw there [rad]")
    scale: Vector3 = Field((1.0, 1.0, 1.0), description="scale along the axes of the mesh [-]")


class Inertial(Schema):
    """Inertial parameters of one link, in the axes of the link frame."""

    mass: Annotated[float, Field(gt=0.0, description="mass [kg]")]
    com: Vector3 = Field(description="centre of mass in the link frame [m]")
    inertia: tuple[float, float, float, float, float, float] = Field(
        description="ixx, ixy, ixz, iyy, iyz, izz about the centre of mass [kg m^2]"
    )

    @property
    def inertia_matrix(self) -> Array:
        """Inertia about the centre of mass, ``(3, 3)`` [kg m^2]."""
        ixx, ixy, ixz, iyy, iyz, izz = self.inertia
        return np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]])


class Link(Inertial):
    """One link of the robot: inertial parameters, and meshes for viewers."""

    meshes: tuple[Mesh, ...] = omitted((), description="what viewers show; none: a simple shape")
    name: str = omitted("", description="name of the link in its source file")


class Limits(Schema):
    """Hardware limits, one entry per joint; of a prismatic joint m, m/s and N, whatever the names of the keys say."""

    position_min_rad: Vector = Field(description="lower joint position limits [rad], prismatic [m]")
    position_max_rad: Vector = Field(description="upper joint position limits [rad], prismatic [m]")
    velocity_rad_s: PositiveVector = Field(description="joint velocity limits [rad/s], prismatic [m/s]")
    torque_Nm: PositiveVector = Field(description="joint torque limits [N m], prismatic [N]")


class SigmoidFriction(Schema):
    """Joint friction of Gaz et al. 2019: ``a / (1 + exp(-b (dq + c))) - a / (1 + exp(-b c))``."""

    a: NonNegativeVector = Field(description="height of the sigmoid [N m], prismatic [N]")
    b: PositiveVector = Field(description="slope of the sigmoid [s/rad], prismatic [s/m]")
    c: Vector = Field(description="shift of the sigmoid [rad/s], prismatic [m/s]")


class Reflexes(Schema):
    """Thresholds of the robot's own collision reflexes; a missing one is unknown."""

    source: str = Field("", description="source of the thresholds")
    external_torque_Nm: PositiveVector | None = Field(
        None, description="external joint torque at which the robot stops itself [N m], prismatic [N]"
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

    shell: Share3 = Field((0.92, 0.92, 0.94), description="tubes, red green blue from 0 to 1 [-]")
    joint: Share3 = Field((0.25, 0.27, 0.3), description="joints and foot, red green blue from 0 to 1 [-]")


class RobotFacts(Schema):
    """Published facts about a robot (``config/robots/*.yaml``)."""

    source: str = Field(description="where the numbers come from")
    joints: tuple[JointOrigin, ...] = Field(description="joint origins; in a tree depth first, each branch to its end")
    flange: Flange = Field(description="flange on the last link")
    hands: tuple[Hand, ...] = Field(
        (),
        exclude_if=lambda value: value == (),
        repr=False,
        description="further flanges with pads, such as the other hand of a torso",
    )
    limits: Limits = Field(description="limits of the joints that follow no other")
    links: tuple[Link, ...] = Field(description="link inertials, one per joint")
    link_deviation: Annotated[float, Field(gt=0.0, lt=0.3)] = omitted(
        0.1,
        description="standard deviation of densities, shapes and centres of mass (over the radius of gyration) of "
        "the links, which a load has to exceed; 0.1 for CAD, 0.03 if identified [-]",
    )
    floating_base: Inertial | None = omitted(
        None, description="inertial of a base that nothing holds; absent: the base is fixed"
    )
    base_meshes: tuple[Mesh, ...] = omitted((), description="what viewers show of the base")
    colours: Colours = omitted(Colours(), description="colours of the simple shapes in viewers")
    friction: SigmoidFriction | None = Field(None, description="identified joint friction")
    reflected_rotor_inertia_other_source_kg_m2: PositiveVector | None = Field(
        None, description="reflected rotor inertia from another source [kg m^2], prismatic [kg]"
    )
    joint_stiffness_typical_Nm_per_rad: PositiveVector | None = Field(
        None, description="order of magnitude of the joint stiffness [N m/rad], prismatic [N/m]"
    )
    reflexes: Reflexes | None = omitted(None, description="thresholds at which the robot stops itself at a hit")
    joint_torque_loop: bool = omitted(
        True, description="whether the joints have torque sensors and a torque loop; false: drive.type rigid"
    )

    assumed: tuple[str, ...] = Field(
        (),
        exclude_if=lambda value: value == (),
        repr=False,
        description="estimated or assumed numbers, in words, which reports and verdicts repeat",
    )

    @model_validator(mode="after")
    def _one_tree(self) -> Self:
        """Refuse joints and a flange on unknown links, and branches that are not in depth-first order."""
        if not self.joints and self.floating_base is None:
            raise ValueError("joints is empty, expected at least one, or floating_base: the base moves")
        if len(self.links) != len(self.joints):
            raise ValueError(f"links has {len(self.links)} entries, expected one per joint ({len(self.joints)})")
        leaders = [joint.name for joint in self.moving if joint.name]
        branch = [0]  # the links from the base to the last joint
        for number, (joint, parent) in enumerate(zip(self.joints, self.parents, strict=True), start=1):
            key = f"joints.{number - 1}"
            if parent not in branch:
                raise ValueError(
                    f"{key}.parent: {joint.parent!r} is no link that can carry it: branches stand one after the other, "
                    f"each to its end; before it: {self._names_of_links(number - 1)}"
                )
            branch = [*branch[: branch.index(parent) + 1], number]
            if joint.mimic is not None and leaders.count(joint.mimic.joint) != 1:
                raise ValueError(
                    f"{key}.mimic.joint: {joint.mimic.joint!r} is no joint that moves by itself; there are: "
                    f"{', '.join(leaders) or 'none with a name'}"
                )
        if self.flange_link < 0:
            link_names = self._names_of_links(len(self.links))
            raise ValueError(f"flange.link: {self.flange.link!r} is no link, or several; there are: {link_names}")
        if not self.flange_link and self.floating_base is None:
            raise ValueError("flange.link: the base is fixed, expected a link that moves, or floating_base")
        return self

    @model_validator(mode="after")
    def _hands_on_links(self) -> Self:
        """Refuse hands on links that are unknown or do not move, and two hands of one name."""
        for number, hand in enumerate(self.hands):
            link_names = self._names_of_links(len(self.links))
            if (link := self.link_of(hand)) < 0 or (not link and self.floating_base is None):
                raise ValueError(f"hands.{number}.link: {hand.link!r} is no link that moves; there are: {link_names}")
            if hand.name in [earlier.name for earlier in self.hands[:number]]:
                raise ValueError(f"hands.{number}.name: another hand is called {hand.name!r}")
        return self

    def _names_of_links(self, count: int) -> str:
        return ", ".join((BASE, *(link.name for link in self.links[:count] if link.name)))

    @model_validator(mode="after")
    def _same_length_everywhere(self) -> Self:
        count = self.joint_count
        lengths = {f"limits.{name}": len(getattr(self.limits, name)) for name in Limits.model_fields}
        for name in ("external_torque_Nm", "velocity_jump_rad_s"):
            if self.reflexes is not None and (values := getattr(self.reflexes, name)) is not None:
                lengths[f"reflexes.{name}"] = len(values)
        for name, length in lengths.items():
            if length != count:
                raise ValueError(f"{name} has {length} entries, expected one per joint ({count})")
        return self

    @property
    def moving(self) -> tuple[JointOrigin, ...]:
        """The joints with a coordinate, which follow no other joint, in order."""
        return tuple(joint for joint in self.joints if joint.mimic is None)

    @property
    def joint_count(self) -> int:
        """Number n of joints with a coordinate."""
        return len(self.moving)

    @property
    def joint_types(self) -> tuple[JointType, ...]:
        """Type of every joint with a coordinate, in order."""
        return tuple(joint.type for joint in self.moving)

    @property
    def units(self) -> tuple[JointUnits, ...]:
        """Units of the values of every joint with a coordinate, in order."""
        return tuple(joint.units for joint in self.moving)

    @property
    def coordinates(self) -> tuple[int, ...]:
        """Index of the coordinate that moves each joint, from 0."""
        names = [joint.name for joint in self.moving]
        independent = iter(range(len(names)))
        return tuple(
            next(independent) if joint.mimic is None else names.index(joint.mimic.joint) for joint in self.joints
        )

    @property
    def reduction(self) -> tuple[Array, Array]:
        """G and q_0: velocities of a floating base and of all N joints are G v, positions of the joints G q + q_0.

        G is ``(base + N, base + n)`` with an identity for the base, q_0 ``(base + N,)``.
        """
        base = self.base_size
        matrix = np.eye(base + len(self.joints), base + self.joint_count)
        offset = np.zeros(len(matrix))
        for row, (joint, coordinate) in enumerate(zip(self.joints, self.coordinates, strict=True), start=base):
            mimic = joint.mimic or Mimic(joint=joint.name)
            matrix[row, base:] = 0.0
            matrix[row, base + coordinate], offset[row] = mimic.ratio, mimic.offset
        return matrix, offset

    @property
    def parents(self) -> tuple[int, ...]:
        """Number of the link that carries each joint; 0: the base, -1: no link has the name."""
        return tuple(self._link(joint.parent, number) for number, joint in enumerate(self.joints))

    @property
    def flange_link(self) -> int:
        """Number of the link that has the flange; 0: the base."""
        return self.link_of(self.flange)

    def link_of(self, flange: Flange) -> int:
        """Number of the link that has a flange; 0: the base, -1: no link has the name."""
        return self._link(flange.link, len(self.links))

    def _link(self, name: str, absent: int) -> int:
        """Number of a link, ``absent`` without a name; -1: no link has the name, or several have."""
        if name in ("", BASE):
            return absent if not name else 0
        numbers = [number for number, link in enumerate(self.links, start=1) if link.name == name]
        return numbers[0] if len(numbers) == 1 else -1

    @property
    def path(self) -> tuple[int, ...]:
        """Numbers of the joints from base to flange, from 0."""
        joints, link, parents = [], self.flange_link, self.parents
        while link > 0:
            joints.append(link - 1)
            link = parents[link - 1]
        return tuple(reversed(joints))

    @property
    def is_chain(self) -> bool:
        """Whether it is a serial arm on a fixed base, as simulators and controllers require."""
        if self.floating_base is not None or self.hands:
            return False
        return self.path == tuple(range(self.joint_count)) == self.coordinates

    @property
    def base_size(self) -> int:
        """Components of the velocity of the base: 6 of a floating one, else 0."""
        return 0 if self.floating_base is None else len(BASE_COLUMNS)

    @property
    def velocity_columns(self) -> tuple[tuple[str, str], ...]:
        """Name and unit of every component of v: the twist of a floating base, then ``joint1`` ..."""
        base = tuple((name, "m/s" if "_v" in name else "rad/s") for name in BASE_COLUMNS[: self.base_size])
        return (*base, *((f"joint{number}", unit.velocity) for number, unit in enumerate(self.units, start=1)))

    def columns_of(self, values: Array) -> Array:
        """Values per joint ``(n,)``, motor inertia for example, per component of v; 0 for a floating base."""
        return values if self.floating_base is None else np.concatenate((np.zeros(self.base_size), values))

    def joints_of(self, position: Array) -> Array:
        """Positions of the joints ``(n,)`` in q, behind the pose of a floating base."""
        return position if self.floating_base is None else position[BASE_POSE_SIZE:]

    def check_chain(self, consumer: str, key: str, file: str | None = None) -> None:
        """Refuse a tree where only serial arms are computed.

        Args:
            consumer: Program part that takes only serial arms, for the message.
            key: Key that names the robot.
            file: Scenario with this key.

        Raises:
            InputError: It is a tree, or its base floats.
        """
        if not self.is_chain:
            raise InputError(
                f"{consumer} takes serial arms on a fixed base, and the facts of this robot ({self.source}) have "
                "parent, mimic, hands or floating_base; impact-rs map and tables of impacts take it, and impact-rs "
                "robot import makes a serial arm of it without --move, --hand and --floating, and with --lock "
                "JOINT=PLACE of every joint that follows another",
                key=key,
                file=file,
            )


@functools.lru_cache(maxsize=16)
def load_facts(name: str) -> RobotFacts:
    """Facts of the robot ``name``: ``config/robots/NAME.yaml``, or a path to such a file.

    Raises:
        InputError: There is no such robot, or its file breaks the schema.
    """
    directory = config_directory() / "robots"
    path = Path(name) if name.endswith((".yaml", ".yml")) else directory / f"{name}.yaml"
    if not is_file(path):
        names = ", ".join(sorted(file.stem for file in directory.glob("*.yaml")))
        raise InputError(f"no robot {shortened(name)!r}; known robots: {names}")
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
            [rad]. E does not move: the tilt is unknown to the controller.
        pad_offset: Centre of the pad's outer face in E [m], also unknown to the controller.
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
        """Centre and axes of the pad in E."""
        rotation = pin.rpy.rpyToMatrix(*self.pad_tilt, 0.0)
        return pin.SE3(rotation, np.array(self.pad_offset) - self.pad_size[2] / 2.0 * rotation[:, 2])
