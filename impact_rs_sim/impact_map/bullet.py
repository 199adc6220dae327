"""The impact map on Bullet, which knows no reflected inertia: B is brought in from outside.

One step of Bullet from (q, v^-) without gravity and with the joint impulse tau gives v^+(tau). The impulse that motors of
inertia B exert on the links in the impact is their own loss of momentum,

    tau = -B (v^+(tau) - v^-),

solved by Newton's method: the derivative of v^+ follows from the contact modes (open, sticking, sliding) that Bullet
found, and Bullet has the last word in the residual. With B = 0 the first step is the answer, and it is plain Bullet.

What is set on purpose, and why:

* The step is so short that Coriolis forces and the motion within the step drop out.
* Bullet's box-box detector sees overlapping boxes only. The base of every arm that touches is moved ``GAP_TOLERANCE``
  towards the object, and the support as much upwards: a translation, which changes no Jacobian, and every point that
  counts as touching overlaps. Contact ERP is 0, so no overlap turns into velocity.
* Bullet applies joint torques before it evaluates Newton's restitution, whose approach velocity would contain tau. Its
  restitution is 0. Instead the step starts from u^- + s and s is taken off its answer, with J_n s = e J_n u^- and
  J_t s = 0 at the contact points: the normal velocity that Bullet keeps from being negative is then u^+ + e u^-, and the
  sliding velocity is that of u^+.
* Contact points survive in Bullet's manifolds from call to call. The object is moved out of reach first, which empties
  them, so an answer depends on its question only.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from impact_rs_sim.bullet_world import BulletWorld
from impact_rs_sim.impact_map.contacts import (
    GAP_TOLERANCE,
    SUPPORT,
    ContactPoint,
    boxes,
    contact_frame,
    separating_face,
)
from impact_rs_sim.impact_map.engine import Engine
from impact_rs_sim.impact_map.problem import ImpactProblem
from impact_rs_sim.impact_map.system import System
from impact_rs_sim.physics import Physics
from impact_rs_sim.robot import Array
from impact_rs_sim.scene import ArmState, BodyState


class BulletEngine(Engine):
    """Impact map by single steps of Bullet."""

    name = "bullet"
    tolerance = 1e-2  # m/s

    _STEP = 1e-7  # s
    _ITERATIONS = 2000
    _RESIDUAL = 1e-24
    _NEWTON_STEPS = 20
    _NEWTON_TOLERANCE = 1e-9  # m/s and rad/s, of u^+

    def __init__(self, physics: Physics) -> None:
        super().__init__(physics)
        self._world = BulletWorld(
            physics,
            time_step=self._STEP,
            gravity=False,
            compliant_pads=False,
            iterations=self._ITERATIONS,
            residual_threshold=self._RESIDUAL,
            contact_erp=0.0,
        )
        self._far = BodyState(np.array([0.0, 0.0, 1e3]), np.eye(3), np.zeros(6))

    def close(self) -> None:
        """Disconnect from Bullet."""
        self._world.close()

    def _solve(self, problem: ImpactProblem, system: System) -> tuple[Sequence[ContactPoint], Array, Array, int]:
        shifts = self._bring_together(problem)
        start = system.velocity
        if problem.restitution > 0.0:
            self._place(problem, start)
            self._world.client.performCollisionDetection()
            start = start + _restitution_shift(system, self._contacts(shifts)[0], problem.restitution)
        arms = system.columns["object"].start
        motor = np.diag(system.inertia - system.link_inertia)[:arms]
        impulse = np.zeros(arms)
        for count in range(1, self._NEWTON_STEPS + 1):
            after = self._step(problem, system, start, impulse)
            contacts, impulses = self._contacts(shifts)
            velocity = after - start + system.velocity
            defect = impulse + motor * (after - start)[:arms]
            if not np.any(motor):
                break
            derivative = _derivative(system, contacts, impulses, velocity)[:arms, :arms]
            correction = np.linalg.solve(np.eye(arms) + motor[:, None] * derivative, -defect)
            if np.max(np.abs(derivative @ correction)) < self._NEWTON_TOLERANCE:
                break
            impulse = impulse + correction
        return contacts, impulses, velocity, count

    def _bring_together(self, problem: ImpactProblem) -> dict[str, Array]:
        """Move arms and support until touching boxes overlap; returns what each was moved by, ``(3,)`` [m]."""
        world, physics = self._world, self.physics
        client = world.client
        world.set_object(self._far)
        client.performCollisionDetection()
        thing, partners = boxes(physics, problem.object, self._placements(problem))
        shifts = {}
        for name, partner in partners.items():
            separation, normal, _ = separating_face(partner, thing)
            touching = separation <= GAP_TOLERANCE
            shifts[name] = GAP_TOLERANCE * normal if touching else np.zeros(3)
            if name == SUPPORT:
                body, position = world.support, partner.centre
                rotation = [0.0, 0.0, 0.0, 1.0]
            else:
                body, position = world.arms[name], physics.arms[name].base.translation
                _, rotation = client.getBasePositionAndOrientation(body)
            client.resetBasePositionAndOrientation(body, (position + shifts[name]).tolist(), rotation)
        return shifts

    def _place(self, problem: ImpactProblem, velocity: Array) -> None:
        start = 0
        for name, state in problem.arms.items():
            stop = start + state.position.size
            self._world.set_arm(name, ArmState(state.position, velocity[start:stop]))
            start = stop
        self._world.set_object(BodyState(problem.object.position, problem.object.rotation, velocity[start:]))

    def _step(self, problem: ImpactProblem, system: System, start: Array, impulse: Array) -> Array:
        """u after one step from u = ``start`` with joint impulses ``impulse`` [N m s]."""
        self._place(problem, start)
        for name in problem.arms:
            self._world.apply_torque(name, impulse[system.columns[name]] / self._STEP)
        self._world.step()
        arms = [self._world.arm_state(name).velocity for name in problem.arms]
        return np.concatenate((*arms, self._world.object_state().twist))

    def _contacts(self, shifts: dict[str, Array]) -> tuple[list[ContactPoint], Array]:
        """Bullet's contact points, moved back to where they belong, and their impulses ``(m, 3)`` [N s]."""
        world, physics = self._world, self.physics
        names = {body: name for name, body in world.arms.items()}
        if world.support is not None:
            names[world.support] = SUPPORT
        contacts, impulses = [], []
        # Asked for one pair, Bullet may swap the bodies and turn the normal, but not the friction directions.
        for point in world.client.getContactPoints():
            if world.object not in point[1:3]:
                continue
            object_first = point[1] == world.object
            sign = 1.0 if object_first else -1.0  # Bullet's impulses act on its first body
            name = names[point[2] if object_first else point[1]]
            on_object, on_partner = (np.array(p) for p in ((point[5], point[6]) if object_first else (point[6], point[5])))
            normal = sign * np.array(point[7])
            gap = float(normal @ (on_object - on_partner + shifts[name]))
            friction = physics.support_friction if name == SUPPORT else physics.pad_friction
            contacts.append(ContactPoint(name, on_object, normal, gap, friction))
            force = np.array(point[7]) * point[9]
            force += np.array(point[11]) * point[10] + np.array(point[13]) * point[12]
            impulses.append(sign * force * self._STEP)
        return contacts, np.array(impulses).reshape(-1, 3)


def _restitution_shift(system: System, contacts: Sequence[ContactPoint], restitution: float) -> Array:
    """s with J_n s = e J_n u^- and J_t s = 0, ``(nv,)``."""
    if not contacts:
        return np.zeros_like(system.velocity)
    jacobian = system.jacobian(contacts)
    normals = np.array([contact.normal for contact in contacts])
    before = (jacobian @ system.velocity).reshape(-1, 3)
    wanted = restitution * np.sum(before * normals, axis=1)[:, None] * normals
    return np.asarray(np.linalg.lstsq(jacobian, wanted.ravel(), rcond=1e-10)[0])


def _derivative(system: System, contacts: Sequence[ContactPoint], impulses: Array, velocity: Array) -> Array:
    """du^+ / dtau of the links alone, with the contact modes of an answer, ``(nv, nv)``.

    Open points drop out, sticking ones keep their velocity, sliding ones keep their normal velocity while the friction
    impulse follows the sliding direction.
    """
    inverse = np.linalg.inv(system.link_inertia)
    largest = np.max(np.sum(impulses * impulses, axis=1), initial=0.0) ** 0.5
    rows = []
    jacobian = system.jacobian(contacts).reshape(-1, 3, velocity.size)
    blocks = []
    for contact, impulse, block in zip(contacts, impulses, jacobian, strict=True):
        frame = contact_frame(contact.normal)
        local, relative = frame @ impulse, frame @ block @ velocity
        if local[2] <= 1e-9 * largest:
            continue
        speed = float(np.hypot(relative[0], relative[1]))
        radius = contact.friction * local[2]
        # Rows C dL + S J du = 0 of this point: what its mode demands.
        force, motion = np.zeros((3, 3)), np.eye(3)
        if np.hypot(local[0], local[1]) >= radius * (1.0 - 1e-6) and speed > 1e-9:
            direction = relative[:2] / speed
            force[:2, :2] = np.eye(2)
            force[:2, 2] = contact.friction * direction
            motion[:2, :2] = radius / speed * (np.eye(2) - np.outer(direction, direction))
        elif contact.friction == 0.0:
            force[:2, :2], motion[:2, :2] = np.eye(2), 0.0
        rows.append((force, motion))
        blocks.append(frame @ block)
    if not rows:
        return inverse
    size = 3 * len(rows)
    force, motion = np.zeros((size, size)), np.zeros((size, size))
    for index, (of_force, of_motion) in enumerate(rows):
        where = slice(3 * index, 3 * index + 3)
        force[where, where], motion[where, where] = of_force, of_motion
    stacked = np.vstack(blocks)
    response = inverse @ stacked.T
    demand = motion @ stacked
    change = np.linalg.lstsq(force + demand @ response, -demand @ inverse, rcond=1e-10)[0]
    return np.asarray(inverse + response @ change)
