# SPDX-License-Identifier: Apache-2.0
"""Plastic impacts of random bodies, on a table and on each other: the map against MuJoCo's contact search and solver.

MuJoCo regularises: a contact leaves 1e-4 of its approach velocity. Its friction lets a sliding contact open, so
friction is none, or so large that a single point sticks; both simulators then obey the same law.
"""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from twin_scene import scene

from impact_rs_sim import _kernel
from impact_rs_sim.impact_map import ImpactProblem, compute_impact_map
from impact_rs_sim.impact_map.contacts import ALIGNED, ConvexBody
from impact_rs_sim.physics import Neighbour, ObjectPhysics
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.scene import BodyState
from impact_rs_sim.shapes import ConvexShape, hull_of

STEP = 1e-4  # s
STUCK = 50.0  # friction coefficient with which a point sticks in the draws below
MODEL = """<mujoco>
<option timestep="{step}" gravity="0 0 0" cone="elliptic" iterations="200" tolerance="1e-14" impratio="1e3">
<flag multiccd="enable"/></option><asset>{asset}</asset><worldbody>{table}{bodies}</worldbody>
<contact><pair geom1="{first}" geom2="{second}" condim="{condim}" friction="{friction} {friction} 0 0 0" margin="1e-3"
solref="-1e-6 -{rate}" solimp="0.9999 0.9999 0.001"/></contact></mujoco>"""


def text(values: Array) -> str:
    return " ".join(repr(float(value)) for value in np.ravel(values))


def thrown(rng: np.random.Generator, kind: str) -> tuple[ObjectPhysics, BodyState]:
    """A body that touches the table at z = 0 with what is lowest, and comes down."""
    size = 2.0 * rng.uniform(0.04, 0.1, 3)
    shape = ConvexShape("box")
    if kind == "hull":
        points = rng.normal(size=(30, 3))
        points = np.vstack((points, -points)) * size / 6.0
        size = 2.0 * np.abs(points).max(axis=0)
        shape = hull_of(tuple(map(tuple, points.tolist())))
    elif kind != "box":
        shape = ConvexShape(kind)
        size[1] = size[0]
        size[2] = {"sphere": size[0], "capsule": size[0] + size[2], "cylinder": size[2]}[kind]
    mass = float(rng.uniform(0.3, 2.0))
    spread = rng.uniform(0.3, 1.0, 3) * mass * 0.003
    inertia = spread.sum() - spread
    com = rng.uniform(-0.2, 0.2, 3) * size / 2.0
    rotation = pin.exp3(rng.normal(size=3))
    height = float(shape.support(size, -rotation.T @ [0.0, 0.0, 1.0]))
    twist = np.array([*rng.uniform(-1.0, 1.0, 2), -2.0, *rng.uniform(-2.0, 2.0, 3)])
    return ObjectPhysics(mass, size, inertia, com, shape), BodyState(np.array([0.0, 0.0, height]), rotation, twist)


def form_of(body: ObjectPhysics, name: str) -> tuple[str, str]:
    """Geom of a body, and its asset."""
    half, kind = body.size / 2.0, body.shape.kind
    if kind == "hull":
        asset = f'<mesh name="{name}" vertex="{text(np.array(body.shape.corners))}"/>'
        return f'type="mesh" mesh="{name}"', asset
    extents = {"sphere": half[:1], "capsule": [half[0], half[2] - half[0]], "cylinder": [half[0], half[2]]}.get(
        kind, half
    )
    return f'type="{kind}" size="{text(np.array(extents))}"', ""


def body_xml(body: ObjectPhysics, state: BodyState, name: str) -> tuple[str, str]:
    """A free body with its geom, and its asset."""
    form, asset = form_of(body, name)
    x, y, z, w = pin.Quaternion(state.rotation).coeffs()
    return (
        f'<body name="{name}" pos="{text(state.position)}" quat="{text(np.array([w, x, y, z]))}"><freejoint/>'
        f'<inertial pos="{text(body.com_offset)}" mass="{body.mass}" diaginertia="{text(body.inertia)}"/>'
        f'<geom name="{name}" {form}/></body>'
    ), asset


def of_mujoco(
    bodies: dict[str, tuple[ObjectPhysics, BodyState]], pair: tuple[str, str], friction: float, table: bool
) -> tuple[list[Array], Array]:
    """Twists at the middles after one step of MuJoCo, in which one pair may touch, and the normal of its contact."""
    parts = [body_xml(*body, name) for name, body in bodies.items()]
    xml = MODEL.format(
        step=STEP,
        rate=1.0 / STEP,
        asset="".join(asset for _, asset in parts),
        table='<geom name="table" type="plane" size="9 9 1"/>' if table else "",
        bodies="".join(body for body, _ in parts),
        first=pair[0],
        second=pair[1],
        condim=3 if friction else 1,
        friction=friction,
    )
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    states = [state for _, state in bodies.values()]
    data.qvel[:] = np.concatenate([[*one.twist[:3], *(one.rotation.T @ one.twist[3:])] for one in states])
    mujoco.mj_step(model, data)
    found = data.qvel.reshape(-1, 6)
    twists = [np.array([*own[:3], *(one.rotation @ own[3:])]) for own, one in zip(found, states, strict=True)]
    return twists, np.array(data.contact[0].frame[:3])


@pytest.mark.parametrize("friction", [0.0, STUCK])
@pytest.mark.parametrize("kind", ["box", "sphere", "capsule", "cylinder", "hull"])
def test_a_thrown_body_lands_as_in_mujoco(kind: str, friction: float) -> None:
    """20 problems each; kills a contact point beside the lowest one, and a centre of mass taken for the middle."""
    rng, compared = np.random.default_rng(9), 0
    for _ in range(20):
        body, state = thrown(rng, kind)
        physics = scene({}, object=body, support_height=0.0, support_size=(18.0, 18.0), support_friction=friction)
        found = compute_impact_map(ImpactProblem(physics, {}, state, {}))
        assert len(found.contacts) >= 1
        if len(found.contacts) > 1:  # nearly level: points within 1 mm take part in the map, one in MuJoCo's step
            continue
        (expected,), _ = of_mujoco({"body": (body, state)}, ("table", "body"), friction, table=True)
        np.testing.assert_allclose(found.object_twist, expected, atol=0.02)
        compared += 1
    assert compared >= 12


def meeting(rng: np.random.Generator, first: str, second: str) -> dict[str, tuple[ObjectPhysics, BodyState]]:
    """Two bodies that touch and come closer."""
    body, state = thrown(rng, first)
    other, beside = thrown(rng, second)
    way = rng.normal(size=3)
    way /= np.linalg.norm(way)
    state = replace(state, position=np.zeros(3), twist=np.append(2.0 * way, state.twist[3:]))
    beside = replace(beside, position=0.5 * way, twist=np.append(np.zeros(3), beside.twist[3:]))
    for _ in range(20):  # along the normal until they touch
        one, two = (
            ConvexBody(own.position, own.rotation, body.size / 2.0, body.shape)
            for body, own in ((body, state), (other, beside))
        )
        apart, normal, *_ = _kernel.meet(one.parts, two.parts, ALIGNED)
        beside = replace(beside, position=beside.position - apart * normal)
    return {"object": (body, state), "other": (other, beside)}


def apart(bodies: dict[str, tuple[ObjectPhysics, BodyState]], normal: Array) -> float:
    """Separation along a direction from the first to the second [m]."""
    (body, state), (other, beside) = bodies.values()
    reaches = (
        body.shape.support(body.size, own.rotation.T @ way)
        for body, own, way in ((body, state, normal), (other, beside, -normal))
    )
    return float(normal @ (beside.position - state.position) - sum(reaches))


@pytest.mark.parametrize(
    ("first", "second"), [("box", "sphere"), ("capsule", "box"), ("hull", "sphere"), ("hull", "box")]
)
def test_two_thrown_bodies_hit_each_other_as_in_mujoco(first: str, second: str) -> None:
    """15 problems each, without friction; kills a reaction that the first body lacks, and one with the wrong lever.

    Where two edges cross, MuJoCo may take the normal of a face nearby, along which the bodies overlap: ours is right.
    """
    rng, compared = np.random.default_rng(4), 0
    for _ in range(15):
        bodies = meeting(rng, first, second)
        (body, state), (other, beside) = bodies.values()
        place = Neighbour("other", other, np.zeros(3), np.eye(3))
        physics = scene({}, object=body, neighbours=(place,))
        found = compute_impact_map(ImpactProblem(physics, {}, state, {}, neighbours=(beside,)))
        if len(found.contacts) != 1 or np.linalg.norm(found.contacts[0].impulse) < 0.1:
            continue
        expected, normal = of_mujoco(bodies, ("object", "other"), 0.0, table=False)
        normal = normal * np.sign(normal @ found.contacts[0].normal)
        if normal @ found.contacts[0].normal < 1.0 - 1e-5:
            assert apart(bodies, normal) < apart(bodies, found.contacts[0].normal) - 1e-5
            continue
        for twist, own in zip(found.twists.values(), expected, strict=True):
            np.testing.assert_allclose(twist, own, atol=0.03)
        compared += 1
    assert compared >= 8
