# SPDX-License-Identifier: Apache-2.0
"""Effects at the contacts: restitution, stiffness, friction, mounting of pads; friction, stiffness of the support.

Effects of a single impact act in impact tables alone (:mod:`impact_rs_sim.impact_map.contact_laws`). In a trial the
restitution results from stiffness and damping of the pad.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy

from impact_rs_sim.effects.base import (
    SINGLE_IMPACT,
    ArmEffect,
    Joints,
    Parameter,
    SceneEffect,
    Values,
    number,
    types_of,
)
from impact_rs_sim.effects.quantity_laws import Added, Multiplied
from impact_rs_sim.physics import ArmPhysics, ContactCondition, ContactLaw, ObjectPhysics, Physics
from impact_rs_sim.robots.robot import Array

SLIP_FRICTION_STEP = -0.4  # finite-difference step of a friction coefficient, from sticking to slipping [-]
DISSIPATION_SERIES = (1.0, -2.0 / 3.0, 4.0 / 9.0, -44.0 / 135.0)  # of hunt_crossley_restitution, by powers of d v
MAX_OF_SERIES = 0.01  # of d v; the next term of the series is 3e-9 there, the rounding of Lambert's function 2e-6


@dataclass(frozen=True)
class RestitutionEffect(SceneEffect):
    """More or less restitution than assumed; the sum stays between 0 and 1."""

    def bounds(self, physics: Physics) -> tuple[Array, Array]:
        """See :meth:`Effect.bounds`; down to minus the assumed restitution, unless a user gives a higher lower end."""
        lower, upper = super().bounds(physics)
        assumed = physics.restitution + physics.bounce
        given = self.parameters[0].firm
        return np.maximum(np.where(given, lower, -np.inf), 0.0 - assumed), np.minimum(upper, 1.0 - assumed)


@dataclass(frozen=True)
class FrictionEffect(SceneEffect):
    """More or less friction than assumed; the sum is at least 0.

    It is a sum, not a factor, because a contact that is assumed to be frictionless may have friction.
    """

    def bounds(self, physics: Physics) -> tuple[Array, Array]:
        """See :meth:`Effect.bounds`; the coefficient stays at least 0."""
        lower, upper = super().bounds(physics)
        return np.maximum(lower, -float(getattr(physics, self.name))), upper

    def steps(self, joints: Joints, at: Array) -> Array:
        """See :meth:`Effect.steps`; for single impacts of a free body they lead from sticking to slipping."""
        return super().steps(joints, at) if types_of(joints) else np.array([SLIP_FRICTION_STEP])


@dataclass(frozen=True)
class ReturningEffect(SceneEffect):
    """Effect with a coefficient of tangential or spin restitution, which never exceeds 1, however wide its range."""

    def bounds(self, physics: Physics) -> tuple[Array, Array]:
        """See :meth:`Effect.bounds`."""
        lower, upper = super().bounds(physics)
        shares = np.array([parameter.name == "restitution" for parameter in self.parameters])
        return lower, np.where(shares, np.minimum(upper, 1.0), upper)


def _restitution(physics: Physics, values: Values) -> Physics:
    """Effect law: bounce of a single rigid impact, and damping of compliant pads.

    A single impact has e = restitution + bounce. A plant has compliant pads and no e: their damping changes
    (:func:`_with_restitution_added`), and the restitution results from it. The impact map of a whole push keeps its e,
    because a series of bounces under a constant push has the same end as one inelastic impact (paper sec. Single-arm
    hit-and-push scenario).
    """
    increase = number(values, "restitution")
    if increase == 0.0:
        return physics
    arms = {name: _with_restitution_added(arm, increase, physics.object) for name, arm in physics.arms.items()}
    return replace(physics, arms=arms, bounce=physics.bounce + increase)


def _with_restitution_added(arm: ArmPhysics, increase: float, object_: ObjectPhysics) -> ArmPhysics:
    """The arm with the pad damping for a restitution larger by ``increase`` [-], between 0 and 1."""
    if arm.pad_stiffness is None:
        return arm
    restitution = arm.pad_restitution(object_) + increase
    return replace(arm, pad_damping=arm.pad_damping_of(restitution, object_))


@dataclass(frozen=True)
class RestitutionFall(ContactLaw):
    """Restitution that falls with the closing speed, e = e_0 - k v, not below 0.

    Hunt and Crossley's contact, f = (stiffness + damping rate) depth^n, has e = 1 - alpha v at small speed v with
    alpha = 2/3 of damping over stiffness (Hunt and Crossley 1975); Goldsmith (1960) measured the same line on metals.

    Attributes:
        fall: k [s/m].
    """

    fall: float

    def apply(self, contact: ContactCondition) -> ContactCondition:
        """See :meth:`ContactLaw.apply`."""
        return replace(contact, restitution=np.maximum(contact.restitution - self.fall * contact.closing, 0.0))


def hunt_crossley_restitution(loss: Array) -> Array:
    """Restitution of a contact force f = k x^n (1 + d dx/dt), by a = d v, dissipation times closing speed.

    The balance of work over the impact is independent of k and n and gives

        a (1 + e) = log((1 + a) / (1 - a e))        e = (1 + W_0(-(1 + a) exp(-1 - a))) / a

    with Lambert's function W_0 (Hunt and Crossley 1975; Drake's compliant contact has this d). At small speed
    e = 1 - 2 a / 3, and no rebound is faster than 1 / d.

    Args:
        loss: a >= 0, ``(m,)`` [-].

    Returns:
        ``(m,)`` [-].
    """
    series = np.polynomial.polynomial.polyval(loss, DISSIPATION_SERIES)
    above = 1.0 + np.maximum(loss, MAX_OF_SERIES)
    exact = (1.0 + scipy.special.lambertw(-above * np.exp(-above)).real) / (above - 1.0)
    return np.where(loss < MAX_OF_SERIES, series, exact)


@dataclass(frozen=True)
class ContactDissipation(ContactLaw):
    """Restitution of a dissipative contact, e = e_0 g(d v), see :func:`hunt_crossley_restitution`.

    Attributes:
        dissipation: d [s/m].
    """

    dissipation: float

    def apply(self, contact: ContactCondition) -> ContactCondition:
        """See :meth:`ContactLaw.apply`."""
        share = hunt_crossley_restitution(self.dissipation * np.maximum(contact.closing, 0.0))
        return replace(contact, restitution=contact.restitution * share)


@dataclass(frozen=True)
class RestitutionThreshold(ContactLaw):
    """Restitution that falls to 0 at low speed: e = e_0 sqrt(1 - (v_s / v)^n) for v > v_s, else 0.

    Parting from an adhesive contact takes a constant energy m v_s^2 / 2, so that n = 2 (Thornton and Ning 1998, Powder
    Technology 99). A threshold of a physics engine, below which nothing bounces, is the limit of large n.

    Attributes:
        speed: v_s [m/s].
        order: n [-].
    """

    speed: float
    order: float

    def apply(self, contact: ContactCondition) -> ContactCondition:
        """See :meth:`ContactLaw.apply`."""
        ratio = self.speed / np.maximum(contact.closing, self.speed)
        return replace(contact, restitution=contact.restitution * np.sqrt(1.0 - ratio**self.order))


@dataclass(frozen=True)
class TangentialRestitution(ContactLaw):
    """Tangential restitution of a sticking contact, u_t^+ = -beta u_t^- with beta = beta_0 - k s >= 0, s the slip.

    (Garwin 1969; Walton 1993; Cross 2002.) If friction is too weak for that, the contact slides by Coulomb's law.

    Attributes:
        restitution: beta_0 [-].
        fall: k [s/m].
    """

    restitution: float
    fall: float

    def apply(self, contact: ContactCondition) -> ContactCondition:
        """See :meth:`ContactLaw.apply`."""
        share = np.maximum(self.restitution - self.fall * contact.slip, 0.0)
        return replace(contact, tangential_restitution=contact.tangential_restitution + share)


@dataclass(frozen=True)
class DrillingFriction(ContactLaw):
    """A moment about the normal, |M_n| <= a L_n, against omega_n^+ + gamma omega_n^- (Johnson 1985, sec. 7.4).

    Attributes:
        arm: a [m].
        restitution: gamma [-].
    """

    arm: float
    restitution: float

    def apply(self, contact: ContactCondition) -> ContactCondition:
        """See :meth:`ContactLaw.apply`."""
        return replace(
            contact,
            drilling_arm=contact.drilling_arm + self.arm,
            spin_restitution=contact.spin_restitution + self.restitution,
        )


@dataclass(frozen=True)
class WithContactLaw:
    """Effect law that adds a contact law, unless the first parameter is 0.

    Attributes:
        kind: The contact law.
        parameters: Names of the parameters, in the order of its attributes.
    """

    kind: Callable[..., ContactLaw]
    parameters: tuple[str, ...]

    def __call__(self, physics: Physics, values: Values) -> Physics:
        """The physics with the contact law."""
        numbers = [number(values, name) for name in self.parameters]
        return replace(physics, contact_laws=(*physics.contact_laws, self.kind(*numbers))) if numbers[0] else physics


RESTITUTION = RestitutionEffect(
    name="restitution",
    acts_on="contact",
    sentence="The object bounces off what it hits more or less than assumed.",
    parameters=(Parameter("restitution", "-", 0.0, 0.0, 1.0, 0.1, "restitution of pad and object beyond the assumed"),),
    law=_restitution,
    phases=("contact",),
)

PAD_COMPLIANCE = ArmEffect(
    name="pad_compliance",
    acts_on="contact",
    sentence="The silicone cover of the pad is softer or stiffer than assumed.",
    parameters=(Parameter("scale", "-", 1.0, 0.1, 10.0, 0.2, "pad stiffness over its assumed value"),),
    law=Multiplied("pad_stiffness", "scale"),
    phases=("contact",),
)

# Further starts (far), and the step of the pad, reach coefficients at which contacts slide: while all contacts stick,
# friction has no influence.
PAD_FRICTION = FrictionEffect(
    name="pad_friction",
    acts_on="contact",
    sentence="The pad grips the object more or less than assumed.",
    parameters=(
        Parameter(
            "friction", "-", 0.0, -2.0, 2.0, 0.1, "coefficient beyond the assumed", step=-0.4, far=(-0.8, -0.4, 0.4)
        ),
    ),
    law=Added("pad_friction", ("friction",), minimum=0.0),
    phases=("contact",),
)

SUPPORT_FRICTION = FrictionEffect(
    name="support_friction",
    acts_on="contact",
    sentence="The object slides on its support with more or less friction than assumed.",
    parameters=(
        Parameter("friction", "-", 0.0, -2.0, 2.0, 0.03, "coefficient beyond the assumed", far=(-0.8, -0.4, 0.4)),
    ),
    law=Added("support_friction", ("friction",), minimum=0.0),
    phases=("contact",),
)

OBJECT_FRICTION = FrictionEffect(
    name="object_friction",
    acts_on="neighbour",
    sentence="The object slides along its neighbours with more or less friction than assumed.",
    parameters=(Parameter("friction", "-", 0.0, -2.0, 2.0, 0.03, "coefficient beyond the assumed", far=(-0.3, 0.4)),),
    law=Added("object_friction", ("friction",), minimum=0.0),
    phases=("contact",),
    drawn=False,
)

# Model files of 0.2.0 and before multiply the assumed coefficient.
FORMER = {
    effect.name: SceneEffect(
        effect.name,
        effect.acts_on,
        effect.sentence,
        (Parameter("scale", "-", 1.0, 0.0, 4.0, 0.2, "friction coefficient over its assumed value"),),
        Multiplied(effect.name, "scale"),
        ("contact",),
    )
    for effect in (PAD_FRICTION, SUPPORT_FRICTION)
}

# Two effects, not one with two parameters: shear recovers when the load ends and creep does not, so each is observable
# and a complete law by itself. Together they are a Maxwell element.
PAD_SHEAR = ArmEffect(
    name="pad_shear",
    acts_on="contact",
    sentence="The silicone cover of the pad yields sideways under friction, and springs back.",
    parameters=(Parameter("compliance", "m/N", 0.0, 0.0, 3e-4, 1.5e-5, "shear of the pad over the friction force"),),
    law=Added("pad_shear_compliance", ("compliance",)),
    phases=("contact",),
)

PAD_CREEP = ArmEffect(
    name="pad_creep",
    acts_on="contact",
    sentence="What sticks to the pad creeps along it under load, and does not come back.",
    parameters=(Parameter("creep", "m/(s N)", 0.0, 0.0, 0.02, 1e-3, "speed of creep over the friction force"),),
    law=Added("pad_creep", ("creep",)),
    phases=("contact",),
)

PAD_TILT = ArmEffect(
    name="pad_tilt",
    acts_on="contact",
    sentence="The pad is mounted askew, so that it meets the object with an edge or a corner first.",
    parameters=(
        Parameter("roll", "rad", 0.0, -0.1, 0.1, 0.002, "tilt of the pad about x of frame E"),
        Parameter("pitch", "rad", 0.0, -0.1, 0.1, 0.002, "tilt of the pad about y of frame E"),
    ),
    law=Added("end_effector.pad_tilt", ("roll", "pitch")),
    phases=("contact",),
)

PAD_POSITION = ArmEffect(
    name="pad_position",
    acts_on="contact",
    sentence="The pad is elsewhere on the flange: the tool is longer than assumed, or mounted beside its axis.",
    parameters=(
        Parameter("x", "m", 0.0, -0.05, 0.05, 0.002, "pad along x of frame E"),
        Parameter("y", "m", 0.0, -0.05, 0.05, 0.002, "pad along y of frame E"),
        Parameter("z", "m", 0.0, -0.05, 0.05, 0.002, "pad along z of frame E: longer tool"),
    ),
    law=Added("end_effector.pad_offset", ("x", "y", "z")),
    phases=("contact",),
    lasting=True,
)

SUPPORT_COMPLIANCE = SceneEffect(
    name="support_compliance",
    acts_on="contact",
    sentence="What the object stands on gives way when something presses it down or lifts it.",
    parameters=(Parameter("compliance", "m/N", 0.0, 0.0, 1e-4, 5e-7, "yield of the support over the load on it"),),
    law=Added("support_compliance", ("compliance",)),
    phases=("contact",),
)

ROLLING_RESISTANCE = SceneEffect(
    name="rolling_resistance",
    acts_on="contact",
    sentence="Edges of the object dig in: a moment resists its tipping and rolling on pad and support.",
    parameters=(Parameter("arm", "m", 0.0, 0.0, 0.03, 2e-3, "resisting moment over the normal force"),),
    law=Added("rolling_arm", ("arm",)),
    phases=("contact",),
)

RESTITUTION_FALL = SceneEffect(
    name="restitution_fall",
    acts_on="contact",
    sentence="The faster the object comes, the less it bounces.",
    # No body is known to bounce more at a higher speed: a negative fall would only stand in for missing restitution.
    parameters=(Parameter("fall", "s/m", 0.0, 0.0, 0.5, 0.01, "fall of restitution with the closing speed"),),
    law=WithContactLaw(RestitutionFall, ("fall",)),
    phases=SINGLE_IMPACT,
)

CONTACT_DISSIPATION = SceneEffect(
    name="contact_dissipation",
    acts_on="contact",
    sentence="The contact dissipates with speed: fast impacts bounce less, and no rebound exceeds a certain speed.",
    parameters=(
        Parameter("dissipation", "s/m", 0.0, 0.0, 5.0, 0.02, "dissipation of Hunt and Crossley's contact", step=0.1),
    ),
    law=WithContactLaw(ContactDissipation, ("dissipation",)),
    phases=SINGLE_IMPACT,
)

RESTITUTION_THRESHOLD = SceneEffect(
    name="restitution_threshold",
    acts_on="contact",
    sentence="Slow impacts stick: below some closing speed nothing bounces.",
    parameters=(
        Parameter("speed", "m/s", 0.0, 0.0, 5.0, 0.05, "closing speed below which nothing bounces", step=0.3),
        Parameter(
            "order",
            "-",
            2.0,
            2.0,
            100.0,
            1.0,
            "sharpness: 2 of adhesion, large of a physics engine's threshold",
            firm=True,
            shape=True,
            grid=(2.0, 8.0, 40.0),
            hidden=(2.0, 8.0),
        ),
    ),
    law=WithContactLaw(RestitutionThreshold, ("speed", "order")),
    phases=SINGLE_IMPACT,
)

TANGENTIAL_RESTITUTION = ReturningEffect(
    name="tangential_restitution",
    acts_on="contact",
    sentence="The contact grips and springs back sideways: its slip is reversed.",
    parameters=(
        Parameter("restitution", "-", 0.0, 0.0, 1.0, 0.1, "share of the slip that is returned"),
        Parameter(
            "fall", "s/m", 0.0, -0.5, 0.5, 0.01, "fall of that share with the slip", shape=True, hidden=(0.0, 0.05)
        ),
    ),
    law=WithContactLaw(TangentialRestitution, ("restitution", "fall")),
    phases=SINGLE_IMPACT,
)

DRILLING_FRICTION = ReturningEffect(
    name="drilling_friction",
    acts_on="contact",
    sentence="The contact has an extent: a moment resists spinning about its normal.",
    parameters=(
        Parameter("arm", "m", 0.0, 0.0, 0.05, 5e-4, "resisting moment over the normal force"),
        Parameter(
            "restitution", "-", 0.0, 0.0, 1.0, 0.1, "share of the spin that is returned", shape=True, hidden=(0.0, 0.5)
        ),
    ),
    law=WithContactLaw(DrillingFriction, ("arm", "restitution")),
    phases=SINGLE_IMPACT,
)
