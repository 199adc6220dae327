# SPDX-License-Identifier: Apache-2.0
"""Physical consistency of the inertial parameters after an effect (:mod:`impact_rs_sim.robots.bodies`).

Each effect has its own parameters of masses and moments (mass of a payload, density of a link), several effects may
change one body, and users may add effects. So no parametrisation of the inertia (log-Cholesky: Rucker and Wensing 2022,
IEEE RA-L 7(2)) covers all of them. Instead an effect that makes a body physically inconsistent is refused, and fits
stop at the boundary of the set of consistent bodies.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from impact_rs_sim.errors import NotABody
from impact_rs_sim.physics import ArmPhysics, ObjectPhysics, Physics
from impact_rs_sim.robots.bodies import is_physically_consistent, second_moments
from impact_rs_sim.robots.robot import Array, Link
from impact_rs_sim.robots.robot_model import mounted_inertia

# Most values of a numeric covariate that may be levels with separate parameters; with more it is linear.
MAX_COVARIATE_VALUES = 8


class InertialBody(NamedTuple):
    """Inertial parameters of one body.

    Attributes:
        name: Name for messages.
        mass: Mass [kg].
        inertia: About the centre of mass, ``(3, 3)`` [kg m^2].
    """

    name: str
    mass: float
    inertia: Array

    @property
    def exists(self) -> bool:
        """Whether a rigid body can have this mass and inertia."""
        return is_physically_consistent(self.mass, self.inertia)


def check_bodies(before: Physics, after: Physics, effect: str) -> None:
    """Refuse a change that makes a body physically inconsistent.

    The link with the flange includes everything mounted on it, because the dynamics depend on the sum. A body that was
    inconsistent before the change is not attributed to the effect.

    Args:
        before: Physics without the effect.
        after: Physics with it.
        effect: Name of the effect, for the message.

    Raises:
        NotABody: The effect makes a mass, second moments or a motor inertia negative.
    """
    for name, arm in after.arms.items():
        arm_before = before.arms[name]
        if arm.facts is not arm_before.facts or arm.end_effector is not arm_before.end_effector:
            for number, (link, changed) in enumerate(
                zip(arm_before.facts.links, arm.facts.links, strict=True), start=1
            ):
                if number != arm.facts.flange_link and (changed.mass, changed.inertia) != (link.mass, link.inertia):
                    _check(partial(_link, name, number, link), _link(name, number, changed), effect)
            _check(partial(_last_link, name, arm_before), _last_link(name, arm), effect)
        if arm.motor_inertia_reduced is not arm_before.motor_inertia_reduced:
            negative = (arm.motor_inertia_reduced < 0.0) & (arm_before.motor_inertia_reduced >= 0.0)
            if np.any(negative):
                joint = int(np.argmax(negative))
                raise NotABody(
                    f"effect {effect!r} gives the motor of joint {joint + 1} of arm {name!r} an inertia of "
                    f"{arm.motor_inertia_reduced[joint]:.3g} kg m^2; expected 0 or more"
                )
    if after.object is not before.object and not after.object.fixed:
        _check(partial(_object, before.object), _object(after.object), effect)
    for neighbour_before, neighbour in zip(before.neighbours, after.neighbours, strict=True):
        if neighbour.body is not neighbour_before.body:
            name = f"neighbour {neighbour.name!r}"
            _check(partial(_object, neighbour_before.body, name), _object(neighbour.body, name), effect)


def bodies_differ(before: Physics, after: Physics) -> bool:
    """Whether inertial parameters of arms or objects differ."""
    return _numbers(before) != _numbers(after)


def of_other_bodies(worlds: Sequence[Physics]) -> list[Physics]:
    """Representatives of several physics: one for each set of bodies, and of circumstances that bodies may depend on.

    A circumstance with many different numbers, on which parameters depend linearly, is kept at its smallest and
    largest.
    """
    by_bodies: dict[str, dict[object, Physics]] = {}
    for physics in worlds:
        by_bodies.setdefault(repr(_numbers(physics)), {}).setdefault(tuple(physics.circumstances.items()), physics)
    representatives: dict[int, Physics] = {}
    for same_bodies in by_bodies.values():
        for name in next(iter(same_bodies.values())).circumstances or ("",):
            by_value = {physics.circumstances.get(name, ""): physics for physics in same_bodies.values()}
            numbers = sorted(value for value in by_value if isinstance(value, float))
            chosen = [numbers[0], numbers[-1]] if len(numbers) > MAX_COVARIATE_VALUES else list(by_value)
            representatives |= {id(by_value[value]): by_value[value] for value in chosen}
    return list(representatives.values())


def _numbers(physics: Physics) -> list[object]:
    """All inertial parameters."""
    objects = (physics.object, *(neighbour.body for neighbour in physics.neighbours))
    numbers: list[object] = [number for body in objects for number in (body.mass, body.inertia.tobytes())]
    for arm in physics.arms.values():
        tool = arm.end_effector
        numbers += [tool.mass, tool.com.tobytes(), tool.inertia.tobytes(), arm.motor_inertia_reduced.tobytes()]
        numbers += [(link.mass, link.com, link.inertia) for link in arm.facts.links]
    return numbers


def _check(before: Callable[[], InertialBody], after: InertialBody, effect: str) -> None:
    """Refuse if a body becomes physically inconsistent."""
    if not after.exists and before().exists:
        moments = ", ".join(f"{value:.3g}" for value in np.linalg.eigvalsh(second_moments(after.inertia)))
        raise NotABody(
            f"effect {effect!r} leaves {after.name} a mass of {after.mass:.4g} kg with principal second moments "
            f"{moments} kg m^2, which no rigid body has; expected a positive mass and no negative moment: take less "
            "away, or take it from where the body has it"
        )


def _link(name: str, number: int, link: Link) -> InertialBody:
    return InertialBody(f"link {number} of arm {name!r}", link.mass, link.inertia_matrix)


def _last_link(name: str, arm: ArmPhysics) -> InertialBody:
    """The link with the flange, with its end effector."""
    inertia = mounted_inertia(arm.facts, arm.end_effector)
    return InertialBody(f"link {arm.facts.flange_link} of arm {name!r}", inertia.mass, inertia.inertia)


def _object(body: ObjectPhysics, name: str = "the object") -> InertialBody:
    return InertialBody(name, body.mass, np.diag(body.inertia))
