"""The library of physical effects, and the way to add one's own.

A Python package adds effects by an entry point in the group ``impact_rs.effects`` that names a subclass of
:class:`~impact_rs_sim.effects.base.Effect`; a YAML file adds them as formulas
(:mod:`impact_rs_sim.effects.formula`).
"""

from __future__ import annotations

import functools
from importlib.metadata import entry_points

from impact_rs_sim.effects.actuation_delay import ActuationDelay
from impact_rs_sim.effects.base import Effect, Parameter, ScalarParameter
from impact_rs_sim.effects.base_tilt import BaseTilt
from impact_rs_sim.effects.end_effector_payload import EndEffectorPayload
from impact_rs_sim.effects.external_spring import ExternalSpring
from impact_rs_sim.effects.joint_coulomb_friction import JointCoulombFriction
from impact_rs_sim.effects.joint_stiffness import JointStiffness
from impact_rs_sim.effects.joint_stribeck_friction import JointStribeckFriction
from impact_rs_sim.effects.joint_viscous_friction import JointViscousFriction
from impact_rs_sim.effects.motor_inertia_scale import MotorInertiaScale
from impact_rs_sim.effects.object_com_offset import ObjectComOffset
from impact_rs_sim.effects.object_mass import ObjectMass
from impact_rs_sim.effects.pad_compliance import PadCompliance
from impact_rs_sim.effects.pad_friction import PadFriction
from impact_rs_sim.effects.restitution import Restitution
from impact_rs_sim.effects.support_friction import SupportFriction
from impact_rs_sim.effects.torque_gain import TorqueGain
from impact_rs_sim.effects.torque_offset import TorqueOffset
from impact_rs_sim.errors import InputError

__all__ = ["Effect", "Parameter", "ScalarParameter", "library"]

ENTRY_POINT_GROUP = "impact_rs.effects"
BUILT_IN: tuple[type[Effect], ...] = (
    JointCoulombFriction,
    JointViscousFriction,
    JointStribeckFriction,
    TorqueOffset,
    TorqueGain,
    ActuationDelay,
    MotorInertiaScale,
    JointStiffness,
    EndEffectorPayload,
    Restitution,
    PadCompliance,
    PadFriction,
    SupportFriction,
    ObjectMass,
    ObjectComOffset,
    BaseTilt,
    ExternalSpring,
)


@functools.cache
def library() -> dict[str, Effect]:
    """Every known effect by name: the built-in ones, then those that installed packages add.

    Raises:
        InputError: An entry point that is no effect, or that takes a name that is taken.
    """
    effects: dict[str, Effect] = {effect.name: effect() for effect in BUILT_IN}
    for entry in entry_points(group=ENTRY_POINT_GROUP):
        try:
            loaded = entry.load()
        except Exception as error:  # somebody else's package can fail in any way
            raise InputError(f"entry point {entry.value!r} of {ENTRY_POINT_GROUP} cannot be loaded: {error}") from None
        if not (isinstance(loaded, type) and issubclass(loaded, Effect)):
            raise InputError(f"entry point {entry.value!r} of {ENTRY_POINT_GROUP} is no subclass of Effect")
        if loaded.name in effects:
            raise InputError(f"entry point {entry.value!r}: there is already an effect called {loaded.name!r}")
        effects[loaded.name] = loaded()
    return effects
