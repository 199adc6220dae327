# SPDX-License-Identifier: Apache-2.0
"""Objects of a scenario, what they lie on, and their contacts."""

from __future__ import annotations

from typing import Annotated, Literal, Self

import numpy as np
import pinocchio as pin
from pydantic import Field, ValidationInfo, field_validator, model_validator

from impact_rs_sim.errors import InputError
from impact_rs_sim.robots.bodies import is_physically_consistent
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.rotations import check_unit
from impact_rs_sim.schema import NonNegative, Positive, PositiveVector3, Schema, Vector3, omitted
from impact_rs_sim.shapes import ConvexShape, check_extents, hull_of

CORNER_TOLERANCE_M = 1e-6  # of the corners of a hull and its size


def guided_object(consumer: str, key: str, file: str | None = None) -> InputError:
    """Refusal of an object on a hinge or slide by ``consumer``, which takes free and fixed objects."""
    return InputError(
        f"{consumer} takes objects that are free or fixed, and this one has a hinge or slide; impact-rs map takes it",
        key=key,
        file=file,
    )


class Hinge(Schema):
    """A fixed axis about which an object turns, like a door."""

    axis: Vector3 = Field(description="direction of the hinge, in axes of the object, unit vector")
    point: Vector3 = Field(description="a point on it from the geometric centre, in axes of the object [m]")

    @model_validator(mode="after")
    def _along_a_unit_vector(self) -> Self:
        check_unit("axis", self.axis)
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
            check_unit("slide", self.slide)
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
        check_unit("direction", self.direction)
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
