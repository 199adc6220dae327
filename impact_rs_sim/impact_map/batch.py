# SPDX-License-Identifier: Apache-2.0
"""Many impact problems of one scene at once, in arrays: for samples, sweeps and controllers that try many inputs.

    batch = ImpactBatch(physics, arms, body, motor_inertia)     # e.g. 10,000 joint states, or motor inertias
    answers = solve_batch(batch)
    answers.joint_velocity["arm"]                               # (10000, 7)

The results are those of the engine ``exact``, problem by problem.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from impact_rs_sim.errors import InputError
from impact_rs_sim.impact_map.engine import ENERGY_TOLERANCE
from impact_rs_sim.impact_map.exact import SOLVED, CompiledMap, ExactEngine
from impact_rs_sim.impact_map.problem import ImpactMapError, ImpactProblem
from impact_rs_sim.physics import Physics
from impact_rs_sim.robot import Array
from impact_rs_sim.robot_model import RobotModel
from impact_rs_sim.scene import ArmState, BodyState


@dataclass(frozen=True)
class ImpactBatch:
    """N impact problems of one scene.

    Values that differ between problems have a first axis of length N; others are given once, as in
    :class:`~impact_rs_sim.impact_map.problem.ImpactProblem`.

    Attributes:
        physics: Parameters of the scene; motor inertia, restitution and friction are taken from the fields below.
        arms: Configuration and ante-impact velocity by arm, ``(N, n)`` or ``(n,)`` [rad, rad/s].
        object: Pose and ante-impact twist of the object.
        motor_inertia: Diagonal of B by arm, ``(N, n)`` or ``(n,)`` [kg m^2].
        restitution: Newton restitution e, ``(N,)`` or a number [-].
        pad_friction: Coulomb coefficient of the pads, ``(N,)`` or a number [-]; None: that of ``physics``.
        support_friction: Of the support, likewise.
        measured: Whether the states were measured: then a robot has been there, whatever its data sheet allows.
    """

    physics: Physics
    arms: Mapping[str, ArmState]
    object: BodyState
    motor_inertia: Mapping[str, Array]
    restitution: Array | float = 0.0
    pad_friction: Array | float | None = None
    support_friction: Array | float | None = None
    measured: bool = False

    def problem(self, number: int) -> ImpactProblem:
        """One of the problems."""

        def at(values: Array | float, axes: int) -> Array:
            array = np.asarray(values, dtype=float)
            return np.asarray(array[number] if array.ndim > axes else array)

        body, physics = self.object, self.physics
        pad, support = self.friction
        return ImpactProblem(
            physics=replace(physics, pad_friction=float(at(pad, 0)), support_friction=float(at(support, 0))),
            arms={name: ArmState(at(state.position, 1), at(state.velocity, 1)) for name, state in self.arms.items()},
            object=BodyState(at(body.position, 1), at(body.rotation, 2), at(body.twist, 1)),
            motor_inertia={name: at(values, 1) for name, values in self.motor_inertia.items()},
            restitution=float(at(self.restitution, 0)),
            measured=self.measured,
        )

    @property
    def friction(self) -> tuple[Array | float, Array | float]:
        """Coulomb coefficients of pads and support."""
        physics = self.physics
        return (
            physics.pad_friction if self.pad_friction is None else self.pad_friction,
            physics.support_friction if self.support_friction is None else self.support_friction,
        )

    def size(self) -> int:
        """N, from all shapes; 1 where no value has a first axis.

        Raises:
            InputError: A shape fits neither one problem nor N, or the arms are not those of the scene.
        """
        expected: list[tuple[str, Array | float, tuple[int, ...]]] = []
        for label, table in (("arms", self.arms), ("motor_inertia", self.motor_inertia)):
            if set(table) != set(self.physics.arms):
                names = ", ".join(self.physics.arms)
                raise InputError(f"expected one entry per arm of the scene ({names}), got {sorted(table)}", key=label)
        for name, state in self.arms.items():
            joints = (self.physics.arms[name].facts.joint_count,)
            expected += [
                (f"arms.{name}.position", state.position, joints),
                (f"arms.{name}.velocity", state.velocity, joints),
                (f"motor_inertia.{name}", self.motor_inertia[name], joints),
            ]
        body, (pad, support) = self.object, self.friction
        expected += [("object.position", body.position, (3,)), ("object.rotation", body.rotation, (3, 3))]
        expected += [("object.twist", body.twist, (6,)), ("restitution", self.restitution, ())]
        expected += [("pad_friction", pad, ()), ("support_friction", support, ())]
        count = max((len(np.asarray(values)) for _, values, one in expected if np.ndim(values) > len(one)), default=1)
        for key, values, one in expected:
            if np.shape(values) not in (one, (count, *one)):
                raise InputError(f"expected the shape {one} or {(count, *one)}, got {np.shape(values)}", key=key)
        return count


@dataclass(frozen=True)
class BatchAnswer:
    """Results of N problems; rows of nan where there is none.

    Attributes:
        joint_velocity: Post-impact joint velocity by arm, ``(N, n)`` [rad/s].
        end_effector_twist: Post-impact twist of frame E by arm, in E[A], ``(N, 6)`` [m/s, rad/s].
        object_twist: Post-impact twist of the object at its geometric centre, axes of A, ``(N, 6)`` [m/s, rad/s].
        residual: Largest distance from a law, ``(N,)`` [m/s].
        contacts: Number of contact points, ``(N,)``.
        refused: Reason by number of the problem, where there is no result.
    """

    joint_velocity: Mapping[str, Array]
    end_effector_twist: Mapping[str, Array]
    object_twist: Array
    residual: Array
    contacts: Array
    refused: Mapping[int, str]


def solve_batch(batch: ImpactBatch, models: Mapping[str, RobotModel] | None = None) -> BatchAnswer:
    """Solve all problems of a batch, by Newton's law of restitution.

    A problem without solution does not affect the others: its rows are nan, and ``refused`` has the reason.

    Args:
        batch: The problems.
        models: Rigid-body models by arm, where the caller has them already.

    Raises:
        InputError: A shape does not fit, or the scene's object or friction cannot be.
    """
    count, physics = batch.size(), batch.physics
    engine = ExactEngine(physics)
    if models is not None:
        engine.models = models
    compiled = CompiledMap(physics, engine.models)
    arms = []
    for name, state in batch.arms.items():
        terms = _kinematics(engine.models[name], np.asarray(state.position, dtype=float))
        arms.append(compiled.arm(name, state, batch.motor_inertia[name], *terms, measured=batch.measured))
    body, (pad, support) = batch.object, batch.friction
    contact = (pad, support, batch.restitution)
    found = compiled.solve(count, arms, (body.position, body.rotation, body.twist), contact)
    residual = np.max(found.residual, axis=1)
    columns = np.cumsum([0, *(engine.models[name].joint_count for name in batch.arms)])
    joints = {name: found.velocity[:, a:b] for name, a, b in zip(batch.arms, columns[:-1], columns[1:], strict=True)}
    twists = {name: found.twists[:, 6 * number : 6 * number + 6] for number, name in enumerate(batch.arms)}
    object_, contacts, refused = found.velocity[:, columns[-1] :], np.diff(found.first), {}
    shares = np.stack([np.asarray(values, dtype=float) * np.ones(count) for values in contact])
    plain = (found.status == SOLVED) & (residual <= engine.tolerance) & np.all(shares >= 0.0, axis=0)
    plain &= np.all(np.isfinite(shares), axis=0) & (shares[2] <= 1.0)
    plain &= found.energy[:, 1] <= ENERGY_TOLERANCE * found.energy[:, 0]
    for number in np.flatnonzero(~plain):
        rows = [*(rows[number] for rows in (*joints.values(), *twists.values())), object_[number]]
        try:
            answer = engine.solve(batch.problem(int(number)))
        except (InputError, ImpactMapError) as error:
            refused[int(number)] = str(error)
            residual[number], contacts[number] = np.nan, 0
            for row in rows:
                row[:] = np.nan
            continue
        residual[number], contacts[number] = answer.residual.largest, len(answer.contacts)
        values = (*answer.joint_velocity.values(), *answer.end_effector_twist.values(), answer.object_twist)
        for row, value in zip(rows, values, strict=True):
            row[:] = value
    return BatchAnswer(joints, twists, object_, residual, contacts, refused)


def _kinematics(model: RobotModel, positions: Array) -> tuple[Array, Array, Array, Array]:
    """M, J, and position and axes of frame E, of one configuration or of many."""
    if positions.ndim == 1:
        inertia, jacobian, place = model.at_impact(positions)
        return inertia, jacobian, place.translation, place.rotation
    count, joints = positions.shape
    inertias, jacobians = np.empty((count, joints, joints)), np.empty((count, 6, joints))
    places, axes = np.empty((count, 3)), np.empty((count, 3, 3))
    for number, q in enumerate(positions):
        inertias[number], jacobians[number], place = model.at_impact(q)
        places[number], axes[number] = place.translation, place.rotation
    return inertias, jacobians, places, axes
