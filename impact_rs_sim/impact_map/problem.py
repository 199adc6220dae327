"""The impact map as a question and its answer, whatever engine solves it.

Given the configuration, the ante-impact velocities v^- of all bodies and the motor inertia B, find v^+ and contact
impulses L such that, with the generalised inertia of arms (M + B) and object,

    (M + B) (v^+ - v^-) = J_c^T L                              momentum balance
    0 <= L_n  perpendicular to  J_n v^+ + e J_n v^- >= 0       Newton restitution, per contact point
    |L_t| <= mu L_n, opposing the sliding velocity J_t v^+     Coulomb friction

(paper sec. Simulation framework; Glocker 2006; Acary and Brogliato 2008). The impact is instantaneous: positions,
gravity and every other finite force drop out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from impact_rs_sim.errors import InputError
from impact_rs_sim.physics import MOTOR_INERTIA_MODELS, Physics
from impact_rs_sim.robot import Array
from impact_rs_sim.scene import ArmState, BodyState, Scene


@dataclass(frozen=True)
class ImpactProblem:
    """One question to the impact map.

    Attributes:
        physics: Parameters of the scene; motor inertia and restitution are taken from the fields below instead.
        arms: Configuration and ante-impact velocity by arm.
        object: Pose and ante-impact twist of the object.
        motor_inertia: Diagonal of B by arm, ``(n,)`` [kg m^2].
        restitution: Newton restitution e of every closing contact [-].
    """

    physics: Physics
    arms: dict[str, ArmState]
    object: BodyState
    motor_inertia: dict[str, Array]
    restitution: float = 0.0

    @staticmethod
    def at_nominal_impact(scene: Scene, motor_inertia: str = "reduced") -> ImpactProblem:
        """The question of the reference generator: the scene at its nominal impact.

        Raises:
            InputError: ``motor_inertia`` is none of ``reduced``, ``rotor`` and ``zero``.
        """
        if motor_inertia not in MOTOR_INERTIA_MODELS:
            raise InputError(f"no motor-inertia model {motor_inertia!r}; known: {', '.join(MOTOR_INERTIA_MODELS)}")
        return ImpactProblem(
            physics=scene.physics,
            arms=scene.arms,
            object=scene.object,
            motor_inertia={name: arm.motor_inertia(motor_inertia) for name, arm in scene.physics.arms.items()},
            restitution=scene.physics.restitution,
        )


@dataclass(frozen=True)
class ContactImpulse:
    """One contact point of the answer.

    Attributes:
        body_a: ``object``, always.
        body_b: Name of the arm, or ``support``.
        position: Contact point in A, ``(3,)`` [m].
        normal: Unit normal on the object, pointing from ``body_b`` into the object, in A, ``(3,)``.
        impulse: Impulse on the object, in A, ``(3,)`` [N s].
    """

    body_a: str
    body_b: str
    position: Array
    normal: Array
    impulse: Array


@dataclass(frozen=True)
class Residual:
    """How far an answer is from the laws above; each is a maximum over the contact points.

    Attributes:
        penetration_velocity: Largest violation of J_n v^+ + e J_n v^- >= 0 [m/s].
        complementarity: Largest separation velocity J_n v^+ + e J_n v^- of a point that carries an impulse, weighted
            with its share of the largest impulse [m/s].
        friction_cone: Largest violation of the friction law: impulse outside the cone, or not opposed to sliding, as
            a velocity [m/s].
        momentum: Largest entry of (M + B)^-1 ((M + B)(v^+ - v^-) - J_c^T L): momentum balance as a joint velocity
            [rad/s] or body velocity [m/s, rad/s].
    """

    penetration_velocity: float
    complementarity: float
    friction_cone: float
    momentum: float

    @property
    def largest(self) -> float:
        """The largest of the four."""
        return max(self.penetration_velocity, self.complementarity, self.friction_cone, self.momentum)


@dataclass(frozen=True)
class ImpactResult:
    """Answer of an engine.

    Attributes:
        joint_velocity: Post-impact joint velocity by arm, ``(n,)`` [rad/s].
        end_effector_twist: Post-impact twist of frame E by arm, in E[A], ``(6,)`` [m/s, rad/s].
        object_twist: Post-impact twist of the object at its geometric centre, axes of A, ``(6,)`` [m/s, rad/s].
        contacts: Contact points with their impulses.
        residual: How well the answer obeys the laws.
        engine: Name of the engine.
        iterations: Iterations of the engine's outer loop.
        elapsed: Wall-clock time [s].
    """

    joint_velocity: dict[str, Array]
    end_effector_twist: dict[str, Array]
    object_twist: Array
    contacts: tuple[ContactImpulse, ...]
    residual: Residual
    engine: str
    iterations: int
    elapsed: float


class ImpactMapError(RuntimeError):
    """An engine found no answer that obeys the laws; the message says which law and by how much."""


def check_problem(problem: ImpactProblem, penetration_tolerance: float = 1e-3) -> None:
    """Refuse a question that has no answer.

    Args:
        problem: The question.
        penetration_tolerance: Deepest accepted overlap of pad and object, or object and support [m].

    Raises:
        InputError: Non-finite or wrong-length state, joint positions or velocities beyond their limits, negative
            mass or motor inertia, restitution outside [0, 1], a rotation that is none, or initial penetration.
    """
    raise NotImplementedError


def kinetic_energy(problem: ImpactProblem, result: ImpactResult | None = None) -> float:
    """Kinetic energy with (M + B), before the impact or, with ``result``, after it [J]."""
    object_state = problem.object
    twist = object_state.twist if result is None else result.object_twist
    thing = problem.physics.object
    offset = object_state.rotation @ thing.com_offset
    linear = twist[:3] + np.cross(twist[3:], offset)
    angular = object_state.rotation.T @ twist[3:]
    energy = 0.5 * (thing.mass * linear @ linear + thing.inertia @ np.square(angular))
    for name, arm in problem.arms.items():
        dq = arm.velocity if result is None else result.joint_velocity[name]
        inertia = problem.physics.robot_model(name).mass_matrix(arm.position)
        inertia = inertia + np.diag(problem.motor_inertia[name])
        energy += 0.5 * dq @ inertia @ dq
    return float(energy)
