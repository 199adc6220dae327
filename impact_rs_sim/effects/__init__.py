# SPDX-License-Identifier: Apache-2.0
"""The library of physical effects, and how to extend it.

A Python package adds effects by an entry point in the group ``impact_rs.effects`` that names a subclass of
:class:`~impact_rs_sim.effects.base.Effect`, or an instance of one; a YAML file adds them as formulas
(:mod:`impact_rs_sim.effects.formula`).
"""

from __future__ import annotations

import functools
from importlib.metadata import entry_points

from impact_rs_sim.effects.actuation import ACTUATION_DELAY, TORQUE_GAIN, TORQUE_OFFSET
from impact_rs_sim.effects.base import SINGLE_IMPACT, ArmEffect, Effect, Parameter, SceneEffect
from impact_rs_sim.effects.contact import (
    CONTACT_DISSIPATION,
    DRILLING_FRICTION,
    OBJECT_FRICTION,
    PAD_COMPLIANCE,
    PAD_CREEP,
    PAD_FRICTION,
    PAD_POSITION,
    PAD_SHEAR,
    PAD_TILT,
    RESTITUTION,
    RESTITUTION_FALL,
    RESTITUTION_THRESHOLD,
    ROLLING_RESISTANCE,
    SUPPORT_COMPLIANCE,
    SUPPORT_FRICTION,
    TANGENTIAL_RESTITUTION,
)
from impact_rs_sim.effects.joint import JOINT_ELASTICITY, JOINT_STIFFNESS
from impact_rs_sim.effects.link import END_EFFECTOR_PAYLOAD, LINK_COM, LINK_INERTIA, LINK_MASS
from impact_rs_sim.effects.motor import (
    ADDED_MOTOR_INERTIA,
    ASYMMETRIC_FRICTION,
    COULOMB_FRICTION,
    JOINT_DIFFERENCE_FRICTION,
    JOINT_SUM_FRICTION,
    LOAD_DEPENDENT_FRICTION,
    MOTOR_INERTIA_SCALE,
    REVERSAL_WIDTH,
    STIFF_CONTROL,
    STRIBECK_FRICTION,
    VISCOUS_FRICTION,
)
from impact_rs_sim.effects.object import NEIGHBOUR_MASS, OBJECT_COM_OFFSET, OBJECT_MASS
from impact_rs_sim.effects.sensing import SENSOR_EFFECTS, TORQUE_DELAY, TWIST_EFFECTS
from impact_rs_sim.effects.surroundings import BASE_TILT, EXTERNAL_SPRING
from impact_rs_sim.errors import InputError

__all__ = ["ArmEffect", "Effect", "Parameter", "SceneEffect", "library", "of_trials"]

ENTRY_POINT_GROUP = "impact_rs.effects"
BUILT_IN: tuple[Effect, ...] = (
    COULOMB_FRICTION,
    VISCOUS_FRICTION,
    STRIBECK_FRICTION,
    TORQUE_OFFSET,
    TORQUE_GAIN,
    ACTUATION_DELAY,
    MOTOR_INERTIA_SCALE,
    JOINT_STIFFNESS,
    END_EFFECTOR_PAYLOAD,
    RESTITUTION,
    PAD_COMPLIANCE,
    PAD_FRICTION,
    SUPPORT_FRICTION,
    OBJECT_MASS,
    OBJECT_COM_OFFSET,
    BASE_TILT,
    EXTERNAL_SPRING,
    PAD_SHEAR,
    PAD_CREEP,
    PAD_TILT,
    SUPPORT_COMPLIANCE,
    ROLLING_RESISTANCE,
    RESTITUTION_FALL,
    CONTACT_DISSIPATION,
    RESTITUTION_THRESHOLD,
    TANGENTIAL_RESTITUTION,
    DRILLING_FRICTION,
    LINK_MASS,
    LINK_COM,
    LINK_INERTIA,
    ADDED_MOTOR_INERTIA,
    JOINT_ELASTICITY,
    TORQUE_DELAY,
    *TWIST_EFFECTS,
    PAD_POSITION,
    *SENSOR_EFFECTS,
    LOAD_DEPENDENT_FRICTION,
    ASYMMETRIC_FRICTION,
    JOINT_SUM_FRICTION,
    JOINT_DIFFERENCE_FRICTION,
    STIFF_CONTROL,
    NEIGHBOUR_MASS,
    OBJECT_FRICTION,
    REVERSAL_WIDTH,
)


@functools.cache
def library() -> dict[str, Effect]:
    """Every known effect by name: built-in ones, then those of installed packages.

    Raises:
        InputError: An entry point is no effect, or has the name of another effect.
    """
    effects = {effect.name: effect for effect in BUILT_IN}
    for entry in entry_points(group=ENTRY_POINT_GROUP):
        try:
            loaded = entry.load()
            effect = loaded() if isinstance(loaded, type) and issubclass(loaded, Effect) else loaded
        except Exception as error:  # a third-party package can raise any exception
            raise InputError(f"entry point {entry.value!r} of {ENTRY_POINT_GROUP} cannot be loaded: {error}") from None
        if not isinstance(effect, Effect):
            raise InputError(f"entry point {entry.value!r} of {ENTRY_POINT_GROUP} is no subclass or instance of Effect")
        if effect.name in effects:
            raise InputError(f"entry point {entry.value!r}: there is already an effect called {effect.name!r}")
        effects[effect.name] = effect
    return effects


def of_trials() -> dict[str, Effect]:
    """The effects of the library that a search in trials considers."""
    return {
        name: effect for name, effect in library().items() if effect.phases != SINGLE_IMPACT and not effect.calibrates
    }
