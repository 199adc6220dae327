# SPDX-License-Identifier: Apache-2.0
"""The impact map extracted from the physics engine Bullet; the motor inertia B, which Bullet lacks, is added outside.

This engine is the independent check of :mod:`impact_rs_sim.impact_map.solve`, and the idea of the paper: an impact map
from single steps of a physics engine.

One step of Bullet from (q, u^-) without gravity, with the inertia M' and the generalised impulse p, gives u^+(p). It
obeys the laws of :mod:`impact_rs_sim.impact_map.problem` if

    p = -(M + B - M') (u^+(p) - u^-) + J_t^T c(u^+(p)),

solved by Newton's method for the inertial part, with the derivative at fixed contact modes, and by fixed-point
iteration for c, from p = 0: with B = 0 and no sliding the first step is the answer, and it is plain Bullet. The parts:

* **M'**: every link carries its rotor as a thin disc about the joint axis, which is M + B up to couplings between
  joints. With M' = M the iteration diverges at the wrist, where B is a hundred times M.
* **c**: Bullet's friction cone scales each of its two friction axes with the inverse mass along it, so that its
  friction opposes ``D^-1 v_t`` and not the sliding velocity ``v_t``. c corrects the direction; it is 0 at sticking
  points.

Settings and their reasons:

* The step is so short that Coriolis forces and the motion within the step drop out.
* Bullet's box-box detector sees overlapping boxes only. The base of every arm that touches is moved ``GAP_TOLERANCE``
  towards the object, and the support upwards by as much, so that all touching points overlap. A translation changes no
  Jacobian. Contact ERP is 0, so no overlap turns into velocity.
* Bullet applies joint torques before it evaluates Newton's restitution, whose approach velocity would contain p. Its
  restitution is 0. Instead the step starts from u^- + s and s is taken off its answer, with J_n s = e min(J_n u^-, 0)
  and J_t s = 0 at the contact points: the normal velocity that Bullet keeps from being negative is then
  J_n u^+ + e min(J_n u^-, 0), and the sliding velocity belongs to u^+.
* Contact points survive in Bullet's manifolds from call to call. The object is moved out of reach first, which empties
  them, so a result depends on its problem only.
* Bullet's sequential impulses converge linearly, and may end in a small limit cycle. Few iterations suffice for most
  problems; hard ones (on the edge of sticking and sliding) are solved again with many.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from impact_rs_sim.errors import InputError
from impact_rs_sim.impact_map.contacts import GAP_TOLERANCE, SUPPORT, ContactPair, ContactPoint
from impact_rs_sim.impact_map.laws import ContactTerms, System
from impact_rs_sim.impact_map.problem import ImpactProblem
from impact_rs_sim.impact_map.solve import Engine, Solution
from impact_rs_sim.physics import Physics
from impact_rs_sim.plant.bullet_world import BulletWorld
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.scene import ArmState, BodyState

_STEP_S = 1e-7  # Coriolis forces and the motion within it drop out
_SETTLED_M2_S2 = 1e-20  # largest squared change of a row at which Bullet's solver stops
_DISC_INERTIA = np.array([0.5, 0.0, 0.0, 0.5, 0.0, 1.0])  # thin, about the joint axis; order of Link.inertia
_FAR = BodyState(np.array([0.0, 0.0, 1e3]), np.eye(3), np.zeros(6))


@dataclass(frozen=True)
class _Effort:
    """Effort of one attempt.

    Attributes:
        solver_iterations: Iterations of Bullet's solver in a step.
        steps: Largest number of Bullet's steps.
        patience: Steps without progress that end it.
        damping: Share of a Newton step that is taken [-].
        accepted: Residual above which the next effort follows [m/s].
    """

    solver_iterations: int
    steps: int
    patience: int
    damping: float
    accepted: float


class BulletEngine(Engine):
    """Impact map by single steps of Bullet."""

    name = "bullet"
    tolerance = 1e-2  # m/s; most answers are below 1e-4

    _GOAL_M_S = 1e-5  # residual that ends the iteration
    _EFFORTS = (
        _Effort(solver_iterations=200, steps=16, patience=5, damping=1.0, accepted=1e-4),
        _Effort(solver_iterations=1000, steps=60, patience=15, damping=0.5, accepted=np.inf),
    )
    _MAX_WORLDS = 4  # worlds kept for the next problem, one per motor inertia

    def __init__(self, physics: Physics) -> None:
        super().__init__(physics)
        self._worlds: OrderedDict[bytes, _World] = OrderedDict()

    def close(self) -> None:
        """Disconnect from Bullet."""
        while self._worlds:
            self._worlds.popitem()[1].bullet.close()

    def _world(self, motor_inertia: Mapping[str, Array]) -> _World:
        key = b"".join(np.asarray(motor_inertia[name], dtype=float).tobytes() for name in self.physics.arms)
        if key not in self._worlds:
            self._worlds[key] = _World.load(self.physics, motor_inertia)
            while len(self._worlds) > self._MAX_WORLDS:
                self._worlds.popitem(last=False)[1].bullet.close()
        self._worlds.move_to_end(key)
        return self._worlds[key]

    def _solve(self, problem: ImpactProblem, system: System, pairs: Sequence[ContactPair]) -> Solution:
        if self.physics.neighbours:
            raise InputError("engine 'bullet' has one object, 'exact' several", key="engine", value=self.name)
        shapes = [self.physics.object.shape, *(arm.end_effector.shape for arm in self.physics.arms.values())]
        for kind in {shape.kind for shape in shapes} - {"box", "sphere"}:
            raise InputError(
                f"a single step of Bullet finds one point of a {kind} on a face; engine 'exact' finds all",
                key="engine",
                value=self.name,
            )
        world = self._world(problem.motor_inertia)
        world.bring_together(pairs)
        world.set_state(problem, system.velocity)
        world.bullet.client.performCollisionDetection()
        contacts = world.contacts()
        terms = ContactTerms.of(system, contacts, problem.restitution)
        if not contacts:
            return Solution(terms, np.zeros((0, 3)), system.velocity.copy(), 0)
        run = _Run(
            problem=problem,
            system=system,
            terms=terms,
            inertia=world.inertia(problem, system),
            start=system.velocity + _restitution_shift(terms),
        )
        best, count = _Attempt(np.inf, np.zeros((len(contacts), 3)), system.velocity), 0
        for effort in self._EFFORTS:
            best, steps = self._iterate(world, run, effort, best)
            count += steps
            if best.error <= effort.accepted:
                break
        return Solution(terms, best.impulses, best.velocity, count)

    def _iterate(self, world: _World, run: _Run, effort: _Effort, best: _Attempt) -> tuple[_Attempt, int]:
        """Improve on ``best``; returns the best answer so far and the number of Bullet's steps."""
        world.bullet.client.setPhysicsEngineParameter(numSolverIterations=effort.solver_iterations)
        terms, system = run.terms, run.system
        missing = system.inertia - run.inertia
        count, stalled = 0, 0
        inertial, extra = np.zeros(run.start.size), np.zeros((len(terms.contacts), 3))
        while best.error > self._GOAL_M_S and stalled < effort.patience and count < effort.steps:
            count += 1
            answer, impulses = run.judge(world, inertial, extra)
            stalled = 0 if answer.error < 0.9 * best.error else stalled + 1
            best = min(best, answer, key=lambda candidate: candidate.error)
            total = _coulomb(terms, impulses, extra, answer.velocity)
            change = effort.damping * (total - impulses - extra)
            extra = extra + change
            jump = answer.velocity - system.velocity
            slope = _response(terms, run.inertia, impulses, answer.velocity)
            defect = inertial + missing @ (jump + slope @ (terms.jacobian.T @ change.ravel()))
            inertial = inertial - effort.damping * np.linalg.solve(np.eye(jump.size) + missing @ slope, defect)
        return best, count


@dataclass(frozen=True)
class _Attempt:
    """Impulses on the object ``(m, 3)`` [N s], u^+ ``(nv,)``, and their largest residual [m/s]."""

    error: float
    impulses: Array
    velocity: Array


@dataclass(frozen=True)
class _Run:
    """One problem in one world; ``inertia`` is M', and ``start`` is u^- + s."""

    problem: ImpactProblem
    system: System
    terms: ContactTerms
    inertia: Array
    start: Array

    def judge(self, world: _World, inertial: Array, extra: Array) -> tuple[_Attempt, Array]:
        """One step of Bullet with a generalised impulse ``(nv,)`` and extra friction ``(m, 3)``.

        Returns:
            The resulting attempt, and the part of its impulses that Bullet applied, ``(m, 3)`` [N s].
        """
        generalised_impulse = inertial + self.terms.jacobian.T @ extra.ravel()
        jump = world.step(self.problem, self.system, self.inertia, self.start, generalised_impulse) - self.start
        impulses = world.impulses(self.terms.contacts)
        velocity = self.system.velocity + jump
        error = self.terms.residual(impulses + extra, velocity).largest
        return _Attempt(error if np.isfinite(error) else np.inf, impulses + extra, velocity), impulses


@dataclass(frozen=True)
class _Partner:
    """A contact partner: its body in Bullet, and the shift of this body from the scene, ``(3,)`` [m]."""

    body: int
    shift: Array


class _World:
    """A Bullet world whose links carry their rotors as discs."""

    def __init__(self, bullet: BulletWorld) -> None:
        self.bullet = bullet
        self._models = bullet.physics.robot_models()
        self._partners: dict[str, _Partner] = {}

    @classmethod
    def load(cls, physics: Physics, motor_inertia: Mapping[str, Array]) -> _World:
        """The world of a scene, with these rotors."""
        physics.object.check_free("the engine bullet")
        arms = {}
        for name, arm in physics.arms.items():
            arm.facts.check_chain("the engine bullet", f"robots.{name}")
            links = tuple(
                link.model_copy(update={"inertia": tuple(np.add(link.inertia, rotor * _DISC_INERTIA).tolist())})
                for link, rotor in zip(arm.facts.links, motor_inertia[name], strict=True)
            )
            arms[name] = replace(arm, facts=arm.facts.model_copy(update={"links": links}))
        bullet = BulletWorld.load(
            replace(physics, arms=arms),
            time_step=_STEP_S,
            gravity=False,
            compliant_pads=False,
            iterations=BulletEngine._EFFORTS[0].solver_iterations,
            residual_threshold=_SETTLED_M2_S2,
            contact_erp=0.0,
            small_steps=False,
        )
        for name, body in bullet.arms.items():
            # A separate call: together with some other arguments Bullet ignores the friction of a link silently.
            link = bullet.end_effector_link[name]
            bullet.client.changeDynamics(body, link, lateralFriction=physics.pad_friction)
        return cls(bullet)

    def inertia(self, problem: ImpactProblem, system: System) -> Array:
        """M' of the whole system, ``(nv, nv)``."""
        inertia = system.inertia.copy()
        for name, model in self._models.items():
            block = system.columns[name]
            inertia[block, block] = model.mass_matrix(problem.arms[name].position)
        return inertia

    def bring_together(self, pairs: Sequence[ContactPair]) -> None:
        """Empty the manifolds, and move arms and support until touching boxes overlap."""
        client = self.bullet.client
        self.bullet.set_object(_FAR)
        client.performCollisionDetection()
        for pair in pairs:
            name = pair.partner
            shift = GAP_TOLERANCE * pair.normal if pair.separation <= GAP_TOLERANCE else np.zeros(3)
            if name == SUPPORT:
                assert self.bullet.support is not None
                body, origin = self.bullet.support, pair.box.centre
            else:
                body, origin = self.bullet.arms[name], self.bullet.physics.arms[name].base.translation
            _, rotation = client.getBasePositionAndOrientation(body)
            client.resetBasePositionAndOrientation(body, (origin + shift).tolist(), rotation)
            self._partners[name] = _Partner(body, shift)

    def set_state(self, problem: ImpactProblem, velocity: Array) -> None:
        """Set all configurations, and the velocity u, ``(nv,)``."""
        start = 0
        for name, state in problem.arms.items():
            stop = start + state.position.size
            self.bullet.set_arm(name, ArmState(state.position, velocity[start:stop]))
            start = stop
        self.bullet.set_object(BodyState(problem.object.position, problem.object.rotation, velocity[start:]))

    def step(self, problem: ImpactProblem, system: System, inertia: Array, start: Array, push: Array) -> Array:
        """u after one step from u = ``start`` with the generalised impulse ``push``, ``(nv,)`` [N m s, N s]."""
        object_ = system.columns["object"]
        start = start.copy()
        start[object_] += np.linalg.solve(inertia[object_, object_], push[object_])
        self.set_state(problem, start)
        for name in problem.arms:
            self.bullet.apply_torque(name, push[system.columns[name]] / _STEP_S)
        self.bullet.step()
        arms = [self.bullet.arm_state(name).velocity for name in problem.arms]
        return np.concatenate((*arms, self.bullet.object_state().twist))

    def contacts(self) -> list[ContactPoint]:
        """Bullet's contact points, with the shifts of arms and support removed from the gaps."""
        physics = self.bullet.physics
        names = {partner.body: name for name, partner in self._partners.items()}
        contacts = []
        for point in self._points():
            first = point[1] == self.bullet.object
            name = names[point[2] if first else point[1]]
            on_object, on_partner = np.array([point[5], point[6]] if first else [point[6], point[5]])
            normal = (1.0 if first else -1.0) * np.array(point[7])
            gap = float(normal @ (on_object - on_partner + self._partners[name].shift))
            friction = physics.support_friction if name == SUPPORT else physics.pad_friction
            contacts.append(ContactPoint(name, on_object, normal, gap, friction))
        return contacts

    def impulses(self, contacts: Sequence[ContactPoint]) -> Array:
        """Impulses on the object at the points of an earlier step, in their order, ``(m, 3)`` [N s]."""
        impulses = np.zeros((len(contacts), 3))
        partners = [self._partners[contact.partner].body for contact in contacts]
        positions = np.array([contact.position for contact in contacts])
        for point in self._points():
            first = point[1] == self.bullet.object
            partner, position = (point[2], point[5]) if first else (point[1], point[6])
            distance = np.sum(np.square(positions - position), axis=1)
            distance[[body != partner for body in partners]] = np.inf
            impulses[int(np.argmin(distance))] += self._impulse(point)
        return impulses

    def _points(self) -> list:
        # Queried for one pair, Bullet may swap the bodies and flip the normal, but not the friction directions.
        return [point for point in self.bullet.client.getContactPoints() if self.bullet.object in point[1:3]]

    def _impulse(self, point: tuple) -> Array:
        sign = _STEP_S if point[1] == self.bullet.object else -_STEP_S  # Bullet's impulses act on its first body
        directions = np.array((point[7], point[11], point[13]))
        return np.asarray(sign * (np.array((point[9], point[10], point[12])) @ directions))


def _restitution_shift(terms: ContactTerms) -> Array:
    """s with J_n s = e min(J_n u^-, 0) and J_t s = 0, ``(nv,)``."""
    if not np.any(terms.rebound):
        return np.zeros_like(terms.before)
    rebounds = terms.rebound[:, None] * terms.normals
    return np.asarray(np.linalg.lstsq(terms.jacobian, rebounds.ravel(), rcond=1e-10)[0])


def _coulomb(terms: ContactTerms, impulses: Array, extra: Array, velocity: Array) -> Array:
    """Impulses with Bullet's normal components and Coulomb friction, ``(m, 3)`` [N s]."""
    pressing = np.maximum(terms.split(impulses)[0], 0.0)
    radius = terms.friction * pressing
    slides, opposed = terms.sliding(impulses, velocity)
    _, friction = terms.split(impulses + extra)
    friction = friction * np.minimum(1.0, radius / np.maximum(np.linalg.norm(friction, axis=1), 1e-300))[:, None]
    return np.asarray(
        pressing[:, None] * terms.normals + np.where(slides[:, None], radius[:, None] * opposed, friction)
    )


def _response(terms: ContactTerms, inertia: Array, impulses: Array, velocity: Array) -> Array:
    """du^+ / dp of Bullet's step while every contact point keeps its mode, ``(nv, nv)``.

    ``M'^-1 - M'^-1 D^T (C M'^-1 D^T)^+ C M'^-1``, with the rows C of the velocities that the modes keep at zero (all
    three of a sticking point, the normal one of a sliding point), and D of the corresponding impulses.
    """
    pressing, _ = terms.split(impulses)
    jacobian = terms.jacobian.reshape(len(pressing), 3, -1)
    slides, opposed = terms.sliding(impulses, velocity)
    rows, impulse_rows = [], []
    for index in np.flatnonzero(pressing > 1e-9 * np.max(pressing, initial=0.0)):
        if slides[index]:
            normal = terms.normals[index]
            rows.append(normal @ jacobian[index])
            impulse_rows.append((normal + terms.friction[index] * opposed[index]) @ jacobian[index])
        else:
            rows.extend(jacobian[index])
            impulse_rows.extend(jacobian[index])
    inverse: Array = np.asarray(np.linalg.inv(inertia), dtype=float)
    if not rows:
        return inverse
    velocity_response, impulse_response = np.array(rows) @ inverse, inverse @ np.array(impulse_rows).T
    inverse_constraint = np.linalg.pinv(np.array(rows) @ impulse_response, rcond=1e-9)
    return np.asarray(inverse - impulse_response @ inverse_constraint @ velocity_response, dtype=float)
