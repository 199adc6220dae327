# SPDX-License-Identifier: Apache-2.0
"""Cylinders, capsules and pyramids that land on a plane in MuJoCo or Bullet; nothing of our geometry or map is used.

With a stiffness and a damping (negative ``solref``) MuJoCo gives the acceleration of a contact, -k x - b v, whatever
the masses, and so one restitution for all bodies. A sliding contact of MuJoCo opens by its friction, so there is
no friction there; Bullet has both, and exact capsules.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pybullet
from impact_table_cases import POSE

Array = np.ndarray
MASS = 0.5  # kg
STEP = 2e-7  # s, of MuJoCo; a contact lasts 0.1 ms, in which nothing turns
STIFFNESS, DAMPING = 1e9, 12e3  # 1/s^2, 1/s, of a contact per unit of mass
SIDE, HEIGHT = 0.1, 0.12  # m, of a pyramid with a square base
SIZES = {"cylinder": (0.08, 0.08, 0.14), "capsule": (0.06, 0.06, 0.09), "mesh": (SIDE, SIDE, HEIGHT)}
PYRAMID = np.array([[x, y, -0.5 * HEIGHT] for x, y in ((1, 1), (-1, 1), (-1, -1), (1, -1))] + [[0, 0, 0.5 * HEIGHT]])
PYRAMID[:4, :2] *= SIDE / 2.0
PYRAMID_COM = np.array([0.0, 0.0, -0.25 * HEIGHT])  # a quarter of the height over the base
TWISTS = [f"{v}{axis}_{when}" for when in ("before", "after") for v in "vw" for axis in "xyz"]
HEADER = [
    *POSE, *(f"{name} [{'m/s' if name[0] == 'v' else 'rad/s'}]" for name in TWISTS), "shape", "mesh", "mass [kg]",
    "size_x [m]", "size_y [m]", "size_z [m]", "friction [-]", "restitution [-]",
]  # fmt: skip


def moments(kind: str) -> Array:
    """Moments about the centre of mass, from tables of solids, ``(3,)`` [kg m^2]."""
    a, r, h = SIDE, SIZES[kind][0] / 2.0, SIZES[kind][2]
    if kind == "mesh":
        return MASS * np.array([a * a / 20.0 + 3.0 * h * h / 80.0] * 2 + [a * a / 10.0])
    if kind == "cylinder":
        return MASS * np.array([(3.0 * r * r + h * h) / 12.0] * 2 + [r * r / 2.0])
    tube = h - 2.0 * r  # between two half balls of volume 4/3 pi r^3 together
    share = tube / (tube + 4.0 / 3.0 * r)
    ball = 1.0 - share
    across = share * (tube**2 / 12.0 + r * r / 4.0) + ball * (0.4 * r * r + tube**2 / 4.0 + 3.0 / 8.0 * tube * r)
    return MASS * np.array([across, across, share * r * r / 2.0 + ball * 0.4 * r * r])


def com(kind: str) -> Array:
    """Centre of mass from the middle of the bounding box, ``(3,)`` [m]."""
    return PYRAMID_COM if kind == "mesh" else np.zeros(3)


def lowest(kind: str, rotation: Array, normal: Array) -> Array:
    """The lowest point of a tilted body from the middle of its bounding box, in A, ``(3,)`` [m]."""
    if kind == "mesh":
        corners = PYRAMID @ rotation.T
        return corners[int(np.argmin(corners @ normal))]
    axis, radius, half = rotation[:, 2], SIZES[kind][0] / 2.0, SIZES[kind][2] / 2.0
    down = -np.sign(axis @ normal) * axis
    if kind == "capsule":
        return (half - radius) * down - radius * normal
    across = -normal + (normal @ axis) * axis
    return half * down + radius * across / np.linalg.norm(across)


def write_pyramid(path: Path) -> Path:
    """The pyramid as STL, in metres."""
    triangles = [(0, 2, 1), (0, 3, 2), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)]
    lines = ["solid pyramid"]
    for triangle in triangles:
        lines += ["facet normal 0 0 0", "outer loop"]
        lines += [f"vertex {' '.join(repr(float(number)) for number in PYRAMID[corner])}" for corner in triangle]
        lines += ["endloop", "endfacet"]
    path.write_text("\n".join([*lines, "endsolid pyramid"]))
    return path


def thrown(rng: np.random.Generator, kind: str) -> tuple[Array, Array, Array]:
    """Middle of a tilted body that touches z = 0, its rotation, and the twist of its middle, falling."""
    while True:
        rotation = pin.exp3(rng.uniform(-np.pi, np.pi, 3))
        first, second = np.sort(PYRAMID @ rotation[2])[:2]
        clear = second - first > 0.005 if kind == "mesh" else 0.25 < abs(rotation[2, 2]) < 0.95
        if clear:  # of its edges, its base and its wall
            break
    twist = np.array([*rng.uniform(-1.5, 1.5, 2), -rng.uniform(1.0, 2.0), *rng.normal(0.0, 2.0, 3)])
    point = lowest(kind, rotation, np.array([0.0, 0.0, 1.0]))
    return np.array([0.1, -0.2, -point[2]]), rotation, twist


def in_mujoco(kind: str, place: Array, rotation: Array, twist: Array) -> Array:
    """Twist of the middle after the impact, ``(6,)``."""
    half = np.array(SIZES[kind]) / 2.0
    form = {
        "cylinder": f'type="cylinder" size="{half[0]} {half[2]}"',
        "capsule": f'type="capsule" size="{half[0]} {half[2] - half[0]}"',
        "mesh": 'type="mesh" mesh="pyramid"',
    }[kind]
    text = " ".join
    # A mesh has its frame at its centre of mass, with its principal axes.
    corners = text(repr(float(number)) for number in PYRAMID.ravel())
    inertia = text(repr(float(number)) for number in moments(kind))
    middle = text(repr(float(number)) for number in com(kind))
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><option timestep="{STEP}" gravity="0 0 0" integrator="Euler"/>'
        f'<asset><mesh name="pyramid" vertex="{corners}"/></asset><worldbody>'
        '<geom name="floor" type="plane" size="9 9 1"/><body><freejoint/>'
        f'<inertial pos="{middle}" mass="{MASS}" diaginertia="{inertia}"/>'
        f'<geom name="thing" {form}/></body></worldbody><contact><pair geom1="floor" geom2="thing" condim="1" '
        f'solref="-{STIFFNESS} -{DAMPING}" solimp="0.9999 0.9999 0.001"/></contact></mujoco>'
    )
    data = mujoco.MjData(model)
    x, y, z, w = pin.Quaternion(rotation).coeffs()
    data.qpos[:] = [*place, w, x, y, z]
    data.qvel[:] = [*twist[:3], *(rotation.T @ twist[3:])]
    touched = False
    while not touched or data.ncon:
        mujoco.mj_step(model, data)
        touched = touched or data.ncon > 0
    turned = np.array(data.xmat[1]).reshape(3, 3)
    return np.array([*data.qvel[:3], *(turned @ data.qvel[3:])])


@contextmanager
def in_bullet(friction: float, restitution: float) -> Iterator[Callable[[Array, Array, Array], Array]]:
    """Twist of a capsule after one step of Bullet, as a function of place, rotation and twist."""
    client = pybullet.connect(pybullet.DIRECT)
    try:
        radius, _, height = np.array(SIZES["capsule"]) * [0.5, 0.5, 1.0]
        flat = pybullet.createCollisionShape(pybullet.GEOM_PLANE, physicsClientId=client)
        shape = pybullet.createCollisionShape(
            pybullet.GEOM_CAPSULE, radius=radius, height=height - 2.0 * radius, physicsClientId=client
        )
        floor = pybullet.createMultiBody(0.0, flat, physicsClientId=client)
        thing = pybullet.createMultiBody(MASS, shape, physicsClientId=client)
        for body in (floor, thing):  # of a pair Bullet takes the products
            pybullet.changeDynamics(
                body, -1, lateralFriction=np.sqrt(friction), restitution=np.sqrt(restitution), rollingFriction=0.0,
                spinningFriction=0.0, linearDamping=0.0, angularDamping=0.0, physicsClientId=client,
            )  # fmt: skip
        pybullet.changeDynamics(thing, -1, localInertiaDiagonal=moments("capsule").tolist(), physicsClientId=client)
        pybullet.setPhysicsEngineParameter(
            fixedTimeStep=0.02, numSolverIterations=500, restitutionVelocityThreshold=0.0, contactERP=0.0,
            physicsClientId=client,
        )  # fmt: skip

        def step(place: Array, rotation: Array, twist: Array) -> Array:
            quaternion = pin.Quaternion(rotation).coeffs().tolist()
            pybullet.resetBasePositionAndOrientation(thing, place.tolist(), quaternion, physicsClientId=client)
            pybullet.resetBaseVelocity(thing, twist[:3].tolist(), twist[3:].tolist(), physicsClientId=client)
            pybullet.stepSimulation(physicsClientId=client)
            return np.concatenate(pybullet.getBaseVelocity(thing, physicsClientId=client))

        yield step
    finally:
        pybullet.disconnect(client)
