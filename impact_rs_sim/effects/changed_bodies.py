# SPDX-License-Identifier: Apache-2.0
"""Effects leave rigid bodies (:mod:`impact_rs_sim.bodies`) behind.

Effects change masses and moments by parameters of their own (mass of a payload, density of a link), and several of them
may change one body, so no parametrisation of the inertia (log-Cholesky: Rucker and Wensing 2022, IEEE RA-L 7(2)) covers
all of them, nor those of users. Instead every effect is refused where it leaves the set of bodies, and fits end at the
edge of that set.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from impact_rs_sim.bodies import is_body, second_moments
from impact_rs_sim.errors import NotABody
from impact_rs_sim.physics import ArmPhysics, Physics
from impact_rs_sim.robot import Array
from impact_rs_sim.robot_model import link_inertias


class Body(NamedTuple):
    """Inertial parameters of one body.

    Attributes:
        name: What it is, for messages.
        mass: Mass [kg].
        inertia: About the centre of mass, ``(3, 3)`` [kg m^2].
    """

    name: str
    mass: float
    inertia: Array

    @property
    def exists(self) -> bool:
        """Whether a rigid body can have this mass and inertia."""
        return is_body(self.mass, self.inertia)


def check_bodies(before: Physics, after: Physics, effect: str) -> None:
    """Refuse a change of the physics that turns a body into something that cannot exist.

    The last link is taken with everything that is mounted on it, for dynamics depend on their sum. A body that was
    none before is left to those who check models: the change is not at fault.

    Args:
        before: Physics without the effect.
        after: Physics with it.
        effect: Name of the effect, for the message.

    Raises:
        NotABody: The effect makes a mass, second moments or a motor inertia negative.
    """
    for name, arm in after.arms.items():
        was = before.arms[name]
        if arm.facts is not was.facts or arm.end_effector is not was.end_effector:
            _check(list(_links(name, was)), list(_links(name, arm)), effect)
        if arm.motor_inertia_reduced is not was.motor_inertia_reduced:
            negative = (arm.motor_inertia_reduced < 0.0) & (was.motor_inertia_reduced >= 0.0)
            if np.any(negative):
                joint = int(np.argmax(negative))
                raise NotABody(
                    f"effect {effect!r} gives the motor of joint {joint + 1} of arm {name!r} an inertia of "
                    f"{arm.motor_inertia_reduced[joint]:.3g} kg m^2; expected 0 or more"
                )
    if after.object is not before.object:
        _check([_object(before)], [_object(after)], effect)


def differ(one: Physics, other: Physics) -> bool:
    """Whether inertial parameters of arms or object are other ones."""
    return _numbers(one) != _numbers(other)


def _numbers(physics: Physics) -> list[object]:
    """All inertial parameters."""
    numbers: list[object] = [physics.object.mass, physics.object.inertia.tobytes()]
    for arm in physics.arms.values():
        tool = arm.end_effector
        numbers += [tool.mass, tool.com.tobytes(), tool.inertia.tobytes(), arm.motor_inertia_reduced.tobytes()]
        numbers += [(link.mass, link.com, link.inertia) for link in arm.facts.links]
    return numbers


def _check(before: list[Body], after: list[Body], effect: str) -> None:
    for was, body in zip(before, after, strict=True):
        if not body.exists and was.exists:
            moments = ", ".join(f"{value:.3g}" for value in np.linalg.eigvalsh(second_moments(body.inertia)))
            raise NotABody(
                f"effect {effect!r} leaves {body.name} a mass of {body.mass:.4g} kg with principal second moments "
                f"{moments} kg m^2, which no rigid body has; expected a positive mass and no negative moment: take less "
                "away, or take it from where the body has it"
            )


def _links(name: str, arm: ArmPhysics) -> Iterator[Body]:
    """The links of an arm, the last one with its end effector."""
    for number, inertia in enumerate(link_inertias(arm.facts, arm.end_effector), start=1):
        yield Body(f"link {number} of arm {name!r}", inertia.mass, inertia.inertia)


def _object(physics: Physics) -> Body:
    return Body("the object", physics.object.mass, np.diag(physics.object.inertia))
