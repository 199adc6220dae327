# SPDX-License-Identifier: Apache-2.0
"""Effects of arms that do not share their parameters.

An :class:`~impact_rs_sim.effects.base.ArmEffect` has one set of parameters for all arms: a hypothesis about a robot
type, which halves the number of unknowns of two arms. Here every arm has its own parameters, ``coulomb_left_joint1``
and ``coulomb_right_joint1``, for as many joints as that arm has; arms of different types need this.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from impact_rs_sim.effects.base import ArmEffect, Effect, Joints, Parameter, Values, digest, types_of
from impact_rs_sim.errors import InputError
from impact_rs_sim.physics import Physics
from impact_rs_sim.robots.robot import Array, JointType


class EachArm(Effect):
    """An effect of arms with separate parameters for every arm.

    Args:
        effect: The effect on one arm.
        joints: Joints by arm; parameters come arm by arm, in this order.
    """

    def __init__(self, effect: ArmEffect, joints: Mapping[str, Joints]) -> None:
        self.effect, self.joints = effect, dict(joints)
        self.name, self.acts_on, self.sentence = effect.name, effect.acts_on, effect.sentence
        self.phases = effect.phases
        self.reading, self.calibration = effect.reading, effect.calibration
        self.calibrates, self.lasting = effect.calibrates, effect.lasting
        self.shown_by_load = effect.shown_by_load
        self.parameters = tuple(
            replace(parameter, name=f"{parameter.name}_{arm}", arm=arm)
            for arm in joints
            for parameter in effect.parameters
        )

    def apply(self, physics: Physics, values: Values) -> Physics:
        """See :meth:`Effect.apply`; parameters of arms that are not in the scene are ignored.

        Raises:
            InputError: An arm of the scene has no parameters here, or other joints.
        """
        self._check(physics)
        arms = {}
        for name in physics.arms:
            arm_values = {parameter.name: values[f"{parameter.name}_{name}"] for parameter in self.effect.parameters}
            arms[name] = self.effect.apply(_alone(physics, name), arm_values).arms[name]
        return replace(physics, arms=arms)

    def scalars_by_parameter(self, joints: Joints) -> list[tuple[str, list[Parameter]]]:
        """See :meth:`Effect.scalars_by_parameter`; ``joints`` is ignored: this effect has the joints of every arm."""
        del joints
        return [(parameter.name, parameter.scalars(self.joints[parameter.arm])) for parameter in self.parameters]

    def bounds(self, physics: Physics) -> tuple[Array, Array]:
        """See :meth:`Effect.bounds`; an arm that is not in the scene has the bounds of its parameters.

        Raises:
            InputError: As :meth:`apply`.
        """
        self._check(physics)
        scalars = self.scalars(0)
        lower, upper = np.array([scalar.lower for scalar in scalars]), np.array([scalar.upper for scalar in scalars])
        for name in physics.arms:
            indices = [index for index, scalar in enumerate(scalars) if scalar.arm == name]
            lower[indices], upper[indices] = self.effect.bounds(_alone(physics, name))
        return lower, upper

    def with_parameters(self, change: Callable[[Parameter], Parameter]) -> EachArm:
        """See :meth:`Effect.with_parameters`."""
        return EachArm(replace(self.effect, parameters=tuple(map(change, self.effect.parameters))), self.joints)

    @property
    def identity(self) -> str:
        """See :attr:`Effect.identity`."""
        return digest(super().identity, self.effect.identity, repr(self.joints))

    def _joints(self, physics: Physics) -> Joints:
        """Empty: the arms share no joints."""
        del physics
        return ()

    def _check(self, physics: Physics) -> None:
        for name, joints in physics.arm_joints:
            if name not in self.joints or types_of(self.joints[name]) != joints:
                arms = ", ".join(f"{arm} with {_text(types_of(types))}" for arm, types in self.joints.items())
                raise InputError(
                    f"effect {self.name!r} has parameters for arms {arms}; here is arm {name!r} with {_text(joints)}"
                )


def of_each(effect: Effect, joints: Mapping[str, Joints]) -> Effect:
    """The effect with separate parameters for every arm if it is an arm effect, else the effect itself.

    Args:
        effect: Any effect.
        joints: Joints by arm; empty: arms share their parameters.
    """
    return EachArm(effect, joints) if joints and isinstance(effect, ArmEffect) else effect


def _text(joints: Sequence[JointType]) -> str:
    """Text of the joints."""
    sliding = joints.count("prismatic")
    return f"{len(joints)} joints" + (f", {sliding} of them sliding" if sliding else "")


def _alone(physics: Physics, name: str) -> Physics:
    """The scene with one of its arms."""
    return replace(physics, arms={name: physics.arms[name]})
