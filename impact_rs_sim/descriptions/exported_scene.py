# SPDX-License-Identifier: Apache-2.0
"""Scene at its impact with the effects of a model, as exported to other simulators.

The exported arm has rigid joints and the motor inertia B that the user chose: ``(M + B) ddq + h = tau + J^T f`` (paper
eq. EOM_motor_mod without elasticity). Joint friction follows the same equation; where the torque loop is off
(B_rho), the motors feel ``B_rho B_theta^-1 tau_fric``. The contact is either ``rigid``, with the restitution of the
impact map, or ``compliant``, with the stiffness and damping of the pad, from which its restitution follows.

Physics that a format cannot represent is listed, never dropped silently: a format names the :class:`ExportedQuantity`
members that it supports, and :meth:`ExportedScene.left_out` lists the others.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from impact_rs_sim.errors import InputError
from impact_rs_sim.impact_map.problem import ImpactProblem, check_physics
from impact_rs_sim.model import Model
from impact_rs_sim.physics import SHARP_WIDTH_RAD_S, ArmPhysics, Physics
from impact_rs_sim.robots.robot import Array, joined_units, travel_per_rad
from impact_rs_sim.robots.robot_model import STANDARD_GRAVITY
from impact_rs_sim.scene import ArmState, BodyState, Scene
from impact_rs_sim.version import package_version

PADS = ("rigid", "compliant")
FACE_CORNERS = 4  # contact points of a face, which share its stiffness and damping
# Stiffness of a rigid support over the mass of the object; g over it is the sinkage of the object, 6.5 micrometres.
RIGID_SUPPORT_STIFFNESS_OVER_MASS_PER_S2 = 1.5e6


class ExportedQuantity(Enum):
    """Quantity beyond kinematics and inertias that a format may represent; the value is its name for the user."""

    MOTOR_INERTIA = "motor inertia B"
    COULOMB_FRICTION = "Coulomb friction of the joints"
    VISCOUS_FRICTION = "viscous friction of the joints"
    TORQUE_OFFSET = "offset of the commanded torque"
    TORQUE_GAIN = "gain of the commanded torque"
    CONTACT_FRICTION = "friction of pads and support"
    RESTITUTION = "restitution of the contact"
    PAD_COMPLIANCE = "stiffness and damping of the pads"
    ROLLING = "resistance to rolling"
    SUPPORT_COMPLIANCE = "compliance of the support"
    GRAVITY = "direction of gravity"
    PAD_TILT = "tilt of the pads"
    HULL = "shape of the object"


@dataclass(frozen=True)
class ExportedScene:
    """A scene at its impact.

    Attributes:
        title: Scenario, object and case.
        physics: Nominal physics with the effects of the model.
        arms: State just before the impact, by arm.
        object: Pose and twist of the object.
        motor_inertia: Diagonal of B by arm, ``(n,)`` [kg m^2].
        motor_inertia_name: ``reduced``, ``rotor`` or ``zero``.
        pads: One of :data:`PADS`.
        source: Source of the numbers: scenario, model and version.
    """

    title: str
    physics: Physics
    arms: dict[str, ArmState]
    object: BodyState
    motor_inertia: dict[str, Array]
    motor_inertia_name: str
    pads: str
    source: tuple[str, ...]

    @staticmethod
    def of(scene: Scene, model: Model, motor_inertia: str = "reduced", pads: str = "rigid") -> ExportedScene:
        """A scene with the effects of a model.

        Raises:
            InputError: The model does not fit the arms, there is no such motor inertia, an arm is a tree or has no
                compliant pad, or a body is physically inconsistent.
        """
        physics = model.apply(scene.physics)
        check_physics(physics)
        if physics.neighbours:
            raise InputError(
                "exported worlds have one object: leave neighbours out", file=scene.scenario.name, key="neighbours"
            )
        problem = ImpactProblem.at_nominal_impact(replace(scene, physics=physics), motor_inertia)
        scene.scenario.check_chains("an exported world")
        for name, arm in physics.arms.items():
            if pads == "compliant" and arm.pad_stiffness is None:
                raise InputError(
                    "the pad is rigid, expected a stiffness [N/m] for --pads compliant",
                    file=scene.scenario.name,
                    key=f"robots.{name}.end_effector.pad.stiffness",
                )
        return ExportedScene(
            title=f"{scene.scenario.name} {scene.object_name} {scene.case_name}",
            physics=physics,
            arms=problem.arms,
            object=problem.object,
            motor_inertia=problem.motor_inertia,
            motor_inertia_name=motor_inertia,
            pads=pads,
            source=(
                f"scenario {scene.scenario.name}, object {scene.object_name}, case {scene.case_name}",
                f"model {model.name} (digest {model.digest}): "
                + (", ".join(effect.name for effect in model.effects) or "no effect beyond the nominal values"),
                f"written by impact-rs {package_version()}".rstrip(),
            ),
        )

    @property
    def restitution(self) -> float:
        """Coefficient of restitution of a single impact: impact map plus bounce [-]."""
        return min(1.0, self.physics.restitution + self.physics.bounce)

    @property
    def standing_height(self) -> float | None:
        """Height of the support's surface before the object's weight presses it down [m]; None: no support."""
        physics = self.physics
        if physics.support_height is None:
            return None
        return physics.support_height - float(physics.gravity[2]) * physics.object.mass * physics.support_compliance

    def friction(self, name: str) -> tuple[Array, Array]:
        """Coulomb and viscous friction of the rigid joints of an arm, ``(n,)`` each [N m], [N m s/rad].

        The friction of Gaz et al. is included as Coulomb friction of half the height of its sigmoid.
        """
        arm = self.physics.arms[name]
        coulomb = arm.friction.coulomb.copy()
        if arm.friction.sigmoid is not None:
            coulomb = coulomb + np.array(arm.friction.sigmoid.a) / 2.0
        shaping = np.ones_like(coulomb)
        if self.motor_inertia_name == "rotor":
            shaping = arm.motor_inertia_rotor / arm.motor_inertia_reduced
        return shaping * coulomb, shaping * arm.friction.viscous

    def closing_speed(self, name: str) -> float:
        """Closing speed of the pad of an arm and the object along the pad axis [m/s]."""
        return max(float(self._axis(name) @ (self._jacobian(name) @ self.arms[name].velocity)), 0.0)

    def impact_mass(self, name: str) -> float:
        """Reduced (effective) mass of pad and object along the pad axis, for a central impact [kg].

        ``1 / m = n^T J (M + B)^-1 J^T n + 1 / m_object``
        """
        return 1.0 / (self._mobility(name) + 1.0 / self.physics.object.mass)

    def restitution_of_pad(self, name: str) -> float:
        """Coefficient of restitution of a central pad impact: the scene's, or from stiffness and damping [-]."""
        arm = self.physics.arms[name]
        if self.pads == "rigid" or arm.pad_stiffness is None:
            return self.restitution
        return replace(arm, pad_mobility=self._mobility(name)).pad_restitution(self.physics.object)

    @property
    def support_contact(self) -> tuple[float, float]:
        """Stiffness and damping of the whole support under the object [N/m, N s/m].

        The inverse of the model's compliance, or, for a rigid support, a stiffness at which the object sinks in by
        micrometres. The damping is half the critical damping.
        """
        compliance, mass = self.physics.support_compliance, self.physics.object.mass
        stiffness = 1.0 / compliance if compliance else RIGID_SUPPORT_STIFFNESS_OVER_MASS_PER_S2 * mass
        return stiffness, math.sqrt(stiffness * mass)

    def left_out(self, supported: frozenset[ExportedQuantity]) -> list[str]:
        """Names of the physics of this scene that a format with the quantities ``supported`` cannot represent."""
        texts = [text for name, arm in self.physics.arms.items() for text in self._of_arm(name, arm, supported)]
        return [*dict.fromkeys((*texts, *self._of_scene(supported)))]

    def _of_arm(self, name: str, arm: ArmPhysics, supported: frozenset[ExportedQuantity]) -> Iterator[str]:
        units = arm.facts.units
        yield (
            f"{name}: elasticity of the joints, K = {_list(arm.stiffness)} {joined_units(u.stiffness for u in units)}, "
            f"D = {_list(arm.damping)} {joined_units(u.damping for u in units)}; the joints of this file are rigid"
        )
        efforts = joined_units(unit.effort for unit in units)
        inertia = self.motor_inertia[name]
        coulomb, viscous = self.friction(name)
        quantities = {
            ExportedQuantity.MOTOR_INERTIA: (
                inertia.any(),
                f"{_list(inertia)} {joined_units(u.inertia for u in units)}",
            ),
            ExportedQuantity.COULOMB_FRICTION: (coulomb.any(), f"{_list(coulomb)} {efforts}"),
            ExportedQuantity.VISCOUS_FRICTION: (
                viscous.any(),
                f"{_list(viscous)} {joined_units(u.damping for u in units)}",
            ),
            ExportedQuantity.TORQUE_OFFSET: (arm.torque_offset.any(), f"{_list(arm.torque_offset)} {efforts}"),
            ExportedQuantity.TORQUE_GAIN: ((arm.torque_gain != 1.0).any(), f"{_list(arm.torque_gain)}"),
        }
        for quantity, (present, values) in quantities.items():
            if present and quantity not in supported:
                yield f"{name}: {quantity.value}, {values}"
        yield from _friction_left_out(name, arm)
        if arm.pad_stiffness is not None and (self.pads == "rigid" or ExportedQuantity.PAD_COMPLIANCE not in supported):
            rigid = ExportedQuantity.PAD_COMPLIANCE in supported
            yield (
                f"{name}: stiffness and damping of the pad, {arm.pad_stiffness:g} N/m, {arm.pad_damping:g} N s/m"
                + ("; the pads of this file are rigid (--pads rigid)" if rigid else "")
            )
        for quantity_name, value, unit in (
            ("delay of the commanded torque", arm.actuation_delay, "s"),
            ("yield of the pad along its face", arm.pad_shear_compliance, "m/N"),
            ("creep of the pad along its face", arm.pad_creep, "m/(s N)"),
        ):
            if value:
                yield f"{name}: {quantity_name}, {value:g} {unit}"
        if arm.tool_spring is not None:
            compliance = _list(np.diag(arm.tool_spring.compliance))
            yield f"{name}: compliance of the tool, {compliance} m/N and rad/(N m), diagonal of its matrix at E"
        if not arm.readings.exact:
            yield f"{name}: sensor models, {arm.readings.in_words}"
        for load in arm.loads:
            yield f"{name}: a load from outside the arm, {_named(load)}"

    def _of_scene(self, supported: frozenset[ExportedQuantity]) -> Iterator[str]:
        physics, shape = self.physics, self.physics.object.shape
        tilts = {
            name: arm.end_effector.pad_tilt for name, arm in physics.arms.items() if any(arm.end_effector.pad_tilt)
        }
        level = np.allclose(physics.gravity, STANDARD_GRAVITY, rtol=0.0, atol=1e-12)
        quantities = {
            ExportedQuantity.GRAVITY: "" if level else f"{_list(physics.gravity)} m/s^2",
            ExportedQuantity.PAD_TILT: ", ".join(
                f"{name} {roll:g}, {pitch:g} rad" for name, (roll, pitch) in tilts.items()
            ),
            ExportedQuantity.HULL: f"a hull of {len(shape.corners)} corners" if shape.kind == "hull" else "",
            ExportedQuantity.CONTACT_FRICTION: f"pads {physics.pad_friction:g}, support {physics.support_friction:g}",
            ExportedQuantity.RESTITUTION: f"{self.restitution:g}" if self.pads == "rigid" else "",
            ExportedQuantity.ROLLING: f"lever {physics.rolling_arm:g} m" if physics.rolling_arm else "",
            ExportedQuantity.SUPPORT_COMPLIANCE: f"{physics.support_compliance:g} m/N"
            if physics.support_compliance
            else "",
        }
        for quantity, values in quantities.items():
            if values and quantity not in supported:
                yield f"{quantity.value}, {values}"
        if self.pads == "compliant" and self.restitution:
            yield f"restitution {self.restitution:g}; it follows from stiffness and damping of the pads"
        if self.restitution and physics.restitution_law != "newton":
            yield f"restitution law of {physics.restitution_law.capitalize()}; compliant contacts have their own"
        for name, arm in physics.arms.items():
            if any(arm.end_effector.pad_offset) and ExportedQuantity.PAD_TILT not in supported:
                yield f"{name}: where the pad is, {_list(np.array(arm.end_effector.pad_offset))} m from its place"
        if not physics.tracker.exact:
            yield f"sensor model of the object tracker, {physics.tracker}"
        if not physics.twist_readings.exact:
            yield f"how the twist of the body was measured, {physics.twist_readings}"
        for law in physics.contact_laws:
            yield f"a law of the contact, {_named(law)}"
        for load in physics.object_loads:
            yield f"a load on the object, {_named(load)}"

    def _axis(self, name: str) -> Array:
        """Outward normal of the pad in A, ``(3,)``."""
        placement = self.physics.robot_model(name).placement(self.arms[name].position)
        return np.asarray((placement * self.physics.arms[name].end_effector.pad_placement).rotation[:, 2])

    def _mobility(self, name: str) -> float:
        """n^T J (M + B)^-1 J^T n of the pad [1/kg]."""
        model, inertia = self.physics.robot_model(name), self.motor_inertia[name]
        return model.mobility(self.arms[name].position, self._axis(name), inertia)

    def _jacobian(self, name: str) -> Array:
        """Linear part of the Jacobian of E, ``(3, n)``."""
        return self.physics.robot_model(name).jacobian(self.arms[name].position)[:3]


def _list(values: Array) -> str:
    """Values as text; a single number if all are equal."""
    texts = [f"{value:.6g}" for value in values]
    return texts[0] if len(set(texts)) == 1 else "[" + ", ".join(texts) + "]"


def _named(law: object) -> str:
    """Name of a law with its parameters."""
    name, numbers = getattr(law, "name", None), getattr(law, "numbers", None)
    if name is None or numbers is None:
        return repr(law)
    return f"{name} with " + ", ".join(f"{key} = {value:g}" for key, value in numbers.items())


def _friction_left_out(name: str, arm: ArmPhysics) -> Iterator[str]:
    """Friction of an arm beyond Coulomb and viscous friction, which no format holds."""
    friction, units = arm.friction, arm.facts.units
    efforts, velocities = joined_units(unit.effort for unit in units), joined_units(unit.velocity for unit in units)
    if friction.stribeck.any():
        yield (
            f"{name}: Stribeck friction, {_list(friction.stribeck)} {efforts} above Coulomb friction at rest, gone "
            f"at {_list(friction.stribeck_velocity)} {velocities}"
        )
    widths = np.broadcast_to(friction.smoothing, friction.coulomb.shape)
    if np.any(widths > SHARP_WIDTH_RAD_S * travel_per_rad(arm.facts.joint_types)):
        yield f"{name}: width of dry friction at a reversal, {_list(widths)} {velocities}"
    if friction.asymmetry is not None:
        yield f"{name}: asymmetry of friction, {_list(friction.asymmetry)} {efforts} more forward and less backward"
    if friction.load is not None:
        yield f"{name}: friction that grows with the load, {_list(friction.load)} of the transmitted torque"
    for shaft in friction.shafts:
        yield (
            f"{name}: friction of shafts that turn with the {'sum' if shaft.ratio > 0.0 else 'difference'} of two "
            f"joints, {_list(shaft.coulomb)} {efforts} and {_list(shaft.viscous)} "
            f"{joined_units(u.damping for u in units)}"
        )
    if friction.sigmoid is not None:
        yield (
            f"{name}: course of the identified friction (Gaz et al. 2019) near rest, and its asymmetry; half the "
            "height of its sigmoid counts as Coulomb friction"
        )
