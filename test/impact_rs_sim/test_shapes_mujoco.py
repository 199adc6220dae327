# SPDX-License-Identifier: Apache-2.0
"""Plastic impacts of 200 random bodies on a table: the map against MuJoCo, with its own contact search and solver.

MuJoCo regularises: a contact leaves 1e-4 of its approach velocity. Its friction lets a sliding contact open, so
friction is none, or so large that a single point sticks; both simulators then obey the same law.
"""

from __future__ import annotations

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from twin_scene import scene

from impact_rs_sim.impact_map import ImpactProblem, compute_impact_map
from impact_rs_sim.physics import ObjectPhysics
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.scene import BodyState
from impact_rs_sim.shapes import ConvexShape, hull_of

STEP = 1e-4  # s
STUCK = 50.0  # friction coefficient with which a point sticks in the draws below
MODEL = """<mujoco>
<option timestep="{step}" gravity="0 0 0" cone="elliptic" iterations="200" tolerance="1e-14" impratio="1e3">
<flag multiccd="enable"/></option><asset>{asset}</asset><worldbody>
<geom name="table" type="plane" size="9 9 1"/>
<body name="thing" pos="{pos}" quat="{quat}"><freejoint/>
<inertial pos="{com}" mass="{mass}" diaginertia="{inertia}"/><geom name="thing" {form}/></body></worldbody>
<contact><pair geom1="table" geom2="thing" condim="{condim}" friction="{friction} {friction} 0 0 0" margin="1e-3"
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


def of_mujoco(thing: ObjectPhysics, state: BodyState, friction: float) -> Array:
    """Twist at the middle after one step of MuJoCo."""
    half, kind, asset = thing.size / 2.0, thing.shape.kind, ""
    extents = {"sphere": half[:1], "capsule": [half[0], half[2] - half[0]], "cylinder": [half[0], half[2]]}.get(
        kind, half
    )
    form = f'type="{kind}" size="{text(np.array(extents))}"'
    if kind == "hull":
        asset = f'<mesh name="thing" vertex="{text(np.array(thing.shape.corners))}"/>'
        form = 'type="mesh" mesh="thing"'
    x, y, z, w = pin.Quaternion(state.rotation).coeffs()
    xml = MODEL.format(
        step=STEP,
        rate=1.0 / STEP,
        asset=asset,
        form=form,
        pos=text(state.position),
        quat=text(np.array([w, x, y, z])),
        com=text(thing.com_offset),
        mass=thing.mass,
        inertia=text(thing.inertia),
        condim=3 if friction else 1,
        friction=friction,
    )
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    data.qvel[:3], data.qvel[3:] = state.twist[:3], state.rotation.T @ state.twist[3:]
    mujoco.mj_step(model, data)
    return np.array([*data.qvel[:3], *(state.rotation @ data.qvel[3:])])


@pytest.mark.parametrize("friction", [0.0, STUCK])
@pytest.mark.parametrize("kind", ["box", "sphere", "capsule", "cylinder", "hull"])
def test_a_thrown_body_lands_as_in_mujoco(kind: str, friction: float) -> None:
    """20 problems each; kills a contact point beside the lowest one, and a centre of mass taken for the middle."""
    rng, compared = np.random.default_rng(9), 0
    for _ in range(20):
        thing, state = thrown(rng, kind)
        physics = scene({}, object=thing, support_height=0.0, support_size=(18.0, 18.0), support_friction=friction)
        found = compute_impact_map(ImpactProblem(physics, {}, state, {}))
        assert len(found.contacts) >= 1
        if len(found.contacts) > 1:  # nearly level: points within 1 mm take part in the map, one in MuJoCo's step
            continue
        np.testing.assert_allclose(found.object_twist, of_mujoco(thing, state, friction), atol=0.02)
        compared += 1
    assert compared >= 12
