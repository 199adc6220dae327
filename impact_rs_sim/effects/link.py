# SPDX-License-Identifier: Apache-2.0
"""Effects on the inertia of the links.

A payload of mass m with centre p and radius of gyration r on the end effector of mass m_0, centre c_0:

    m' = m_0 + m,    m' c' = m_0 c_0 + m p,    I' = I_0 + m_0 S(c_0 - c') + m (r^2 1 + S(p - c'))

with S(d) = |d|^2 1 - d d^T.

m < 0 removes mass: the remainder must be physically consistent, and p must lie in the homogeneous ellipsoid of last
link and end effector. One radius r for all axes suffices, because slow motions hardly excite the rotational inertia of
a payload.

A link whose moment about its joint axis z changes is stretched across z, by D = diag(s, s, 1) with s^2 = I'_zz / I_zz:
its second moments of mass become D (tr(I)/2 1 - I) D, moments of a body for any I'_zz > 0.

Torque is linear in the inertial parameters of the links, and depends on combinations of them only. For a link i behind
a joint about its z axis, the mass, m z and the moment about y can be moved into link i-1 (Gautier and Khalil 1990,
direct calculation of minimum inertial parameters, eq. 21). So the base parameters of a link are fitted: its centre of
mass across the axis (:data:`LINK_COM`) and its moment of inertia about the axis (:data:`LINK_INERTIA`); or its mass
with a fixed centre (:data:`LINK_MASS`), which changes the same combinations with fewer numbers.

No model of an arm is exact: screws, cables and grease have mass, and shapes are simplified. :data:`LINK_ERRORS` deforms
every link, x' = c + d + (1 + E)(x - c) with E symmetric, and multiplies its density by 1 + s:

    m' = (1 + s) m,    c' = c + d,    S' = (1 + s) (1 + E) S (1 + E)    (second moments about the centre)

which changes all ten inertial parameters of a link and keeps it physically consistent for any s > -1 (the congruence of
Rucker and Wensing 2022, IEEE RA-L 7(2)). It is no candidate of a search. It states how wrong the links of a model may
be (``link_deviation`` of the robot), so that errors of this size are not explained by a load.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from impact_rs_sim.effects.base import ArmEffect, Parameter, Values, number, vector3
from impact_rs_sim.errors import NotABody
from impact_rs_sim.physics import ArmPhysics, Physics
from impact_rs_sim.robots.bodies import IDENTITY, ellipsoid_contains, inertia_of, second_moments
from impact_rs_sim.robots.robot import Array, Link
from impact_rs_sim.robots.robot_model import mounted_inertia

MAX_REMOVABLE_MOMENT_SHARE = 0.99  # share of a link's moment of inertia about its axis; the rest may be a rod [-]
MAX_LINK_DEVIATIONS = 3.0  # standard deviations; larger errors are left to LINK_MASS, LINK_COM and LINK_INERTIA
MIN_MASS_KG = 1e-6  # if payload and end effector nearly cancel, the centre of mass goes to infinity


@dataclass(frozen=True)
class PayloadEffect(ArmEffect):
    """A body on the end effector: mass, centre of mass (3 parameters) and radius of gyration."""

    def bounds(self, physics: Physics) -> tuple[Array, Array]:
        """See :meth:`Effect.bounds`.

        At most the mass of the last link with its end effector can be removed. Lengths are at most those of the tool
        plus the longest link of the arm; a range that a user gives stays.
        """
        lower, upper = super().bounds(physics)
        for arm in physics.arms.values():
            lower[0] = max(lower[0], -mounted_inertia(arm.facts, arm.end_effector).mass)
            reach = _reach(arm)
            for position, parameter in enumerate(self.parameters[1:], start=1):
                if not parameter.firm and reach > 0.0:
                    lower[position], upper[position] = max(lower[position], -reach), min(upper[position], reach)
        return lower, upper


def _reach(arm: ArmPhysics) -> float:
    """Length of the tool plus the longest link [m]."""
    positions = [arm.facts.joints[number].xyz for number in arm.facts.path[1:]] + [arm.facts.flange.xyz]
    return arm.end_effector.length + max(float(np.linalg.norm(position)) for position in positions)


def _payload(arm: ArmPhysics, values: Values) -> ArmPhysics:
    added, position = number(values, "mass"), vector3(values, ("com_x", "com_y", "com_z"))
    if added == 0.0:
        return arm
    if added < 0.0:
        _check_removable(arm, added, position)
    tool = arm.end_effector
    if abs(tool.mass + added) < MIN_MASS_KG:
        added = MIN_MASS_KG - tool.mass
    mass, gyration_inertia = tool.mass + added, added * number(values, "gyration") ** 2 * IDENTITY
    com = (tool.mass * tool.com + added * position) / mass
    inertia = tool.inertia + tool.mass * _steiner(tool.com - com) + gyration_inertia + added * _steiner(position - com)
    return replace(arm, end_effector=replace(tool, mass=mass, com=com, inertia=inertia))


def _check_removable(arm: ArmPhysics, added: float, position: Array) -> None:
    """Refuse to remove mass at a position outside last link and end effector."""
    body = mounted_inertia(arm.facts, arm.end_effector)
    if body.mass > 0.0 and not ellipsoid_contains(body.mass, body.lever, body.inertia, position):
        raise NotABody(
            f"a payload of {added:.3g} kg with its centre at {np.round(position, 4).tolist()} m "
            f"takes away mass that is not there: last link and end effector are {body.mass:.3g} kg "
            f"about {np.round(body.lever, 4).tolist()} m"
        )


def _steiner(offset: Array) -> Array:
    """S(d) = |d|^2 1 - d d^T of an offset d, ``(3, 3)`` [m^2]."""
    return np.asarray(offset @ offset * IDENTITY - offset[:, None] * offset)


def _com_parameter(axis: str, nominal: float, hidden: tuple[float, float]) -> Parameter:
    meaning = f"where the added mass sits, {axis} of frame E"
    return Parameter(f"com_{axis}", "m", nominal, -0.2, 0.2, 0.02, meaning, shape=True, hidden=hidden)


END_EFFECTOR_PAYLOAD = PayloadEffect(
    name="end_effector_payload",
    acts_on="link inertia",
    sentence="Something heavier or lighter than assumed is mounted on the end effector.",
    parameters=(
        Parameter("mass", "kg", 0.0, -0.5, 3.0, 0.1, "added mass"),
        _com_parameter("x", 0.0, (-0.04, 0.04)),
        _com_parameter("y", 0.0, (-0.04, 0.04)),
        _com_parameter("z", -0.04, (-0.1, 0.02)),
        Parameter(
            "gyration",
            "m",
            0.0,
            0.0,
            0.1,
            0.02,
            "radius of gyration of the added mass about its centre",
            step=0.05,  # its square acts, so that smaller steps from 0 show nothing
            shape=True,
            prior=0.05,  # of a gripper; the Franka hand has 0.034 to 0.058 m
        ),
    ),
    law=_payload,
)


def _with_links(arm: ArmPhysics, links: Sequence[Link]) -> ArmPhysics:
    """The arm with other links."""
    return replace(arm, facts=arm.facts.model_copy(update={"links": tuple(links)}))


def _of_links(arm: ArmPhysics, values: Array) -> list[float]:
    """Values per joint ``(n,)`` by link; the link of a joint that follows another has the value of the followed one."""
    return [float(values[coordinate]) for coordinate in arm.facts.coordinates]


def _link_mass(arm: ArmPhysics, values: Values) -> ArmPhysics:
    """Effect law: a link of the same shape and another density."""
    pairs = zip(arm.facts.links, _of_links(arm, values["scale"]), strict=True)
    return _with_links(
        arm,
        [
            link.model_copy(
                update={"mass": scale * link.mass, "inertia": tuple(scale * moment for moment in link.inertia)}
            )
            for link, scale in pairs
        ],
    )


def _link_com(arm: ArmPhysics, values: Values) -> ArmPhysics:
    shifts = (_of_links(arm, values[name]) for name in ("com_x", "com_y"))
    positions = zip(arm.facts.links, *shifts, strict=True)
    return _with_links(
        arm,
        [link.model_copy(update={"com": (link.com[0] + x, link.com[1] + y, link.com[2])}) for link, x, y in positions],
    )


def _link_inertia(arm: ArmPhysics, values: Values) -> ArmPhysics:
    pairs = zip(arm.facts.links, _of_links(arm, values["inertia"]), strict=True)
    return _with_links(
        arm,
        [
            link if more == 0.0 else link.model_copy(update={"inertia": _with_axial_moment(link, more)})
            for link, more in pairs
        ],
    )


def _with_axial_moment(link: Link, more: float) -> tuple[float, ...]:
    """Moments of a link with ``more`` [kg m^2] about its axis; without a moment there, equal shares along x and y."""
    if more == 0.0:
        return link.inertia
    moments, about_axis = second_moments(link.inertia_matrix), link.inertia[5]
    if about_axis > 0.0:
        across = math.sqrt(max(1.0 + more / about_axis, 0.0))
        moments = moments * np.outer((across, across, 1.0), (across, across, 1.0))
    else:
        moments = moments + np.diag((more / 2.0, more / 2.0, 0.0))
    (ixx, ixy, ixz), (_, iyy, iyz), (_, _, izz) = inertia_of(moments).tolist()
    return ixx, ixy, ixz, iyy, iyz, izz


@dataclass(frozen=True)
class LinkInertiaEffect(ArmEffect):
    """Moments of inertia of the links about their joint axes."""

    def bounds(self, physics: Physics) -> tuple[Array, Array]:
        """See :meth:`Effect.bounds`; at most a share of the moment of a link about its axis is removable."""
        lower, upper = super().bounds(physics)
        for arm in physics.arms.values():
            for link, coordinate in zip(arm.facts.links, arm.facts.coordinates, strict=True):
                lower[coordinate] = max(lower[coordinate], -MAX_REMOVABLE_MOMENT_SHARE * link.inertia[5])
        return lower, upper


LINK_MASS = ArmEffect(
    name="link_mass",
    acts_on="link inertia",
    sentence="A link is heavier or lighter than the model says, with its centre of mass where the model has it.",
    parameters=(
        Parameter("scale", "-", 1.0, 0.2, 3.0, 0.05, "mass of the link over its assumed value", per_joint=True),
    ),
    law=_link_mass,
    calibrates=True,
)

LINK_COM = ArmEffect(
    name="link_com",
    acts_on="link inertia",
    sentence="The centre of mass of a link lies elsewhere across its joint axis than the model says.",
    parameters=tuple(
        Parameter(
            f"com_{axis}",
            "m",
            0.0,
            -0.1,
            0.1,
            0.005,
            f"shift along {axis} of the link's frame",
            per_joint=True,
            firm=True,  # within the link
        )
        for axis in "xy"
    ),
    law=_link_com,
    calibrates=True,
)

LINK_INERTIA = LinkInertiaEffect(
    name="link_inertia",
    acts_on="link inertia",
    sentence="A link resists turning about its joint axis more or less than the model says.",
    parameters=(
        Parameter("inertia", "kg m^2", 0.0, -1.0, 1.0, 0.02, "added moment about the joint axis", True, of_link=True),
    ),
    law=_link_inertia,
    calibrates=True,
)


def _link_errors(arm: ArmPhysics, values: Values) -> ArmPhysics:
    changes = (
        arm.facts.link_deviation * np.array([values[parameter.name] for parameter in LINK_ERRORS.parameters]).T
    )  # (n, 10)
    return _with_links(
        arm,
        [
            _deformed(link, changes[coordinate])
            for link, coordinate in zip(arm.facts.links, arm.facts.coordinates, strict=True)
        ],
    )


def _deformed(link: Link, change: Array) -> Link:
    """A link deformed by changes ``(10,)``: density, shift over radius of gyration, strain xx, yy, zz, xy, xz, yz."""
    if link.mass <= 0.0 or not np.any(change):
        return link
    moments, density = second_moments(link.inertia_matrix), 1.0 + change[0]
    xx, yy, zz, xy, xz, yz = change[4:]
    strain = IDENTITY + np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    radius = math.sqrt(max(float(moments.trace()), 0.0) / link.mass)
    (ixx, ixy, ixz), (_, iyy, iyz), (_, _, izz) = inertia_of(density * strain @ moments @ strain).tolist()
    x, y, z = np.add(link.com, radius * change[1:4]).tolist()
    inertia = (ixx, ixy, ixz, iyy, iyz, izz)
    return link.model_copy(update={"mass": density * link.mass, "com": (x, y, z), "inertia": inertia})


def _deviation_parameter(name: str, meaning: str) -> Parameter:
    limit = MAX_LINK_DEVIATIONS
    return Parameter(name, "-", 0.0, -limit, limit, 1.0, f"{meaning}, over link_deviation", True, firm=True, prior=1.0)


LINK_ERRORS = ArmEffect(
    name="link_errors",
    acts_on="link inertia",
    sentence="Density, centre of mass and shape of the links are a little different from the model.",
    parameters=(
        _deviation_parameter("density", "change of the density"),
        *(_deviation_parameter(f"shift_{axis}", f"shift along {axis} over the radius of gyration") for axis in "xyz"),
        *(
            _deviation_parameter(f"strain_{axes}", f"strain along {axes}")
            for axes in ("xx", "yy", "zz", "xy", "xz", "yz")
        ),
    ),
    law=_link_errors,
    calibrates=True,
)
LINK_EFFECTS = (LINK_MASS, LINK_COM, LINK_INERTIA)  # effects that name one wrong link
