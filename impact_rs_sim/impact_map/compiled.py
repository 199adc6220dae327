# SPDX-License-Identifier: Apache-2.0
"""The compiled impact map: from the kinematics of the arms to velocities, one problem or many in one call.

``src/impact.cpp`` finds contact points, sets up the Delassus operator, solves the laws
(:mod:`impact_rs_sim.impact_map.newton`) and the residuals (:mod:`impact_rs_sim.impact_map.residual`). It solves
problems with valid data and Newton's law of restitution. All others, and those for which it does not converge, are
solved or refused with a reason by :mod:`impact_rs_sim.impact_map.engine`, step by step.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from impact_rs_sim import _kernel
from impact_rs_sim.impact_map.contacts import ALIGNED, GAP_TOLERANCE, ContactPoint, support_box
from impact_rs_sim.impact_map.newton import COMPLIANCE
from impact_rs_sim.impact_map.problem import LIMIT_SLACK, PENETRATION_TOLERANCE, ImpactProblem, check_physics
from impact_rs_sim.physics import Physics
from impact_rs_sim.robot import Array
from impact_rs_sim.robot_model import RobotModel
from impact_rs_sim.scene import ArmState

SOLVED = 0  # status of a solved problem
STATES = ("open", "stick", "slide")

_RULES = (ALIGNED, GAP_TOLERANCE, PENETRATION_TOLERANCE, COMPLIANCE)
_ANYTHING = np.finfo(float).max
_Parts = tuple[Sequence[int], Array, Array, Array]  # partner, position, normal and gap of contact points


class Compiled(NamedTuple):
    """Solutions of N problems; their M contact points are concatenated.

    Attributes:
        status: ``SOLVED``, or another number, ``(N,)``.
        velocity: u^+, ``(N, nv)`` [rad/s, m/s]; nan where the data are invalid.
        twists: Of frame E of every arm in E[A] after the impact, ``(N, 6 k)`` [m/s, rad/s].
        residual: In the order of :class:`~impact_rs_sim.impact_map.problem.Residual`, ``(N, 4)`` [m/s].
        energy: Kinetic energy before, and what the impact adds, ``(N, 2)`` [J].
        steps: Of the solver, ``(N,)``.
        first: Number of the first contact point, ``(N + 1,)``.
        partner: Number of the arm at every point, or of arms where it is the support, ``(M,)``.
        state: Index into ``STATES``, ``(M,)``.
        position: On the object in A, ``(M, 3)`` [m].
        normal: Into the object, in A, ``(M, 3)``.
        gap: ``(M,)`` [m].
        impulse: On the object, in A, ``(M, 3)`` [N s].
    """

    status: Array
    velocity: Array
    twists: Array
    residual: Array
    energy: Array
    steps: Array
    first: Array
    partner: Array
    state: Array
    position: Array
    normal: Array
    gap: Array
    impulse: Array


class CompiledMap:
    """The compiled map of one scene.

    Args:
        physics: Parameters of the scene.
        models: Rigid-body models by arm.

    Raises:
        InputError: The object or a friction cannot be.
    """

    def __init__(self, physics: Physics, models: Mapping[str, RobotModel]) -> None:
        check_physics(physics)
        self.physics = physics
        self.models = models
        self._limits, self._pads = {}, {}
        for name, arm in physics.arms.items():
            model, pad = models[name], arm.end_effector.pad_placement
            slack = LIMIT_SLACK
            bounds = (model.position_min - slack, model.position_max + slack, model.velocity_max + slack)
            free = np.full(model.joint_count, _ANYTHING)
            self._limits[name] = {False: bounds, True: (-free, free, free)}
            half = np.array(arm.end_effector.pad_size) / 2.0
            self._pads[name] = (np.array(pad.translation), np.array(pad.rotation), half)
        object_ = physics.object
        self._object = (object_.mass, object_.size / 2.0, object_.inertia, object_.com_offset)
        self._kept: tuple[Sequence[ContactPoint], tuple[str, ...], _Parts] | None = None
        support = support_box(physics)
        self._support = None if support is None else np.concatenate((support.centre, support.half))

    def answer(self, problem: ImpactProblem, points: Sequence[ContactPoint] | None = None) -> Compiled | None:
        """The solution of one problem of this scene, N = 1; None: not a problem for the compiled map.

        Args:
            problem: The problem.
            points: Contact points, whose friction is that of the scene all the same; None: where bodies touch.
        """
        if problem.restitution_law != "newton" or not 0.0 <= problem.restitution <= 1.0:
            return None
        if problem.arms.keys() != self._pads.keys() or problem.motor_inertia.keys() != self._pads.keys():
            return None
        arms = []
        for name, state in problem.arms.items():
            model, motor = self.models[name], problem.motor_inertia[name]
            shape = (model.joint_count,)
            if not state.position.shape == state.velocity.shape == motor.shape == shape:
                return None
            inertia, jacobian, place = model.at_impact(state.position)
            arms.append(
                self.arm(
                    name, state, motor, inertia, jacobian, place.translation, place.rotation, measured=problem.measured
                )
            )
        body, physics = problem.object, self.physics
        if body.position.shape != (3,) or body.rotation.shape != (3, 3) or body.twist.shape != (6,):
            return None
        contact = (physics.pad_friction, physics.support_friction, problem.restitution)
        given = None if points is None else self._given(points, tuple(problem.arms))
        return self.solve(1, arms, (body.position, body.rotation, body.twist), contact, given)

    def _given(self, points: Sequence[ContactPoint], names: tuple[str, ...]) -> _Parts:
        """Contact points as the kernel takes them; kept, because one set is mostly asked about again and again."""
        if self._kept is None or self._kept[0] is not points or self._kept[1] != names:
            self._kept = (points, names, _parts(points, names))
        return self._kept[2]

    def arm(
        self,
        name: str,
        state: ArmState,
        motor: Array,
        inertia: Array,
        jacobian: Array,
        position: Array,
        rotation: Array,
        measured: bool = False,
    ) -> tuple[Array, ...]:
        """One arm as :func:`impact_rs_sim._kernel.solve_impacts` takes it."""
        limits = self._limits[name][measured]
        of_frame = (inertia, jacobian, position, rotation)
        return (state.position, state.velocity, motor, *limits, *of_frame, *self._pads[name])

    def solve(
        self,
        count: int,
        arms: Sequence[Sequence[Array]],
        body: tuple[Array, Array, Array],
        contact: tuple[Array | float, Array | float, Array | float],
        points: _Parts | None = None,
    ) -> Compiled:
        """Solutions of ``count`` problems; arguments as :func:`impact_rs_sim._kernel.solve_impacts` takes them."""
        object_ = (*body, *self._object)
        return Compiled(*_kernel.solve_impacts(count, arms, object_, contact, self._support, _RULES, points=points))


def _parts(points: Sequence[ContactPoint], names: Sequence[str]) -> _Parts:
    """Contact points as the kernel takes them."""
    return (
        [names.index(point.partner) if point.partner in names else len(names) for point in points],
        np.array([point.position for point in points]),
        np.array([point.normal for point in points]),
        np.array([point.gap for point in points]),
    )
