# SPDX-License-Identifier: Apache-2.0
"""Models for other simulators: they read them back, hit as the impact map says, and what is left out is said."""

from __future__ import annotations

from dataclasses import replace
from xml.etree import ElementTree as Xml

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from trials import scene_of

from impact_rs_sim.damping_of_restitution import damping_ratio_of, dissipation_of, restitution_of
from impact_rs_sim.descriptions import FORMATS, ExportedScene
from impact_rs_sim.effects import library
from impact_rs_sim.impact_map import ImpactProblem, compute_impact_map
from impact_rs_sim.model import Model, ModelEffect, ParameterValue, load_model
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.scene import Scene
from impact_rs_sim.shapes import hull_of

NOMINAL = load_model("nominal")
DURATION = 3e-4  # s, after which a rigid impact is over


def with_effect(name: str, **values: float) -> Model:
    """The nominal model with one effect; parameters that are not given are a scale above nominal."""
    effect = library()[name]
    parameters = {
        scalar.name: ParameterValue(estimate=values.get(scalar.name, scalar.nominal + scalar.scale), unit=scalar.unit)
        for scalar in effect.scalars(7)
    }
    return NOMINAL.with_effect(ModelEffect(name=name, parameters=parameters), name, "nominal.yaml")


def hit(scene: ExportedScene, duration: float = DURATION) -> tuple[dict[str, Array], Array]:
    """Joint velocities by arm and velocity of the object some time after the impact in MuJoCo, arms without load."""
    model = mujoco.MjModel.from_xml_string(FORMATS["mjcf"].write(scene).text)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    joints = sum(state.position.size for state in scene.arms.values())
    for _ in range(round(duration / model.opt.timestep)):
        mujoco.mj_forward(model, data)
        data.qfrc_applied[:joints] = data.qfrc_bias[:joints]
        mujoco.mj_step(model, data)
    velocities, start = {}, 0
    for name, state in scene.arms.items():
        velocities[name] = data.qvel[start : start + state.position.size].copy()
        start += state.position.size
    return velocities, data.qvel[-6:-3].copy()


def along(scene: Scene, velocities: dict[str, Array]) -> float:
    """Mean velocity of the end effectors along the axis of the scenario [m/s]."""
    axis = "xyz".index(scene.scenario.axis)
    return float(
        np.mean([scene.models[name].jacobian(scene.arms[name].position)[axis] @ v for name, v in velocities.items()])
    )


@pytest.mark.parametrize("form", ["mjcf", "drake", "urdf"])
def test_the_head_of_an_xml_file_is_a_comment_that_a_person_can_read(form: str) -> None:
    """XML allows no double hyphen in a comment: options are named without theirs."""
    text = FORMATS[form].write(ExportedScene.of(scene_of("push", "cat_food", "case_2"), NOMINAL)).text
    Xml.fromstring(text)
    head = text.partition("<!--")[2].partition("-->")[0]
    assert "- -" not in head and "--" not in head
    if form == "mjcf":
        assert "(pads rigid)" in head


@pytest.mark.parametrize("ratio", [0.05, 0.5, 0.9, 1.0, 1.5, 8.0])
def test_spring_and_damper_part_when_the_force_is_gone(ratio: float) -> None:
    """``x'' = -x - 2 zeta x'`` integrated until ``x + 2 zeta x' = 0``."""
    x, v, step = 0.0, 1.0, 1e-4
    while x + 2.0 * ratio * v > 0.0:
        v += step * (-x - 2.0 * ratio * v)
        x += step * v
    assert restitution_of(ratio) == pytest.approx(-v, abs=2e-3)


@pytest.mark.parametrize("restitution", [0.01, 0.13, 0.135335, 0.5, 0.95])
def test_damping_ratio_is_found_from_the_restitution(restitution: float) -> None:
    assert restitution_of(damping_ratio_of(restitution)) == pytest.approx(restitution, rel=1e-6)


@pytest.mark.parametrize(("restitution", "speed"), [(0.2, 0.5), (0.5, 0.3), (0.9, 1.0)])
def test_hunt_and_crossley_return_the_restitution_at_their_speed(restitution: float, speed: float) -> None:
    """``x'' = -x (1 + d x')`` integrated until it is back at 0."""
    d, x, v, step = dissipation_of(restitution, speed), 0.0, speed, 2e-5
    while x >= 0.0:
        v += step * -x * (1.0 + d * v)
        x += step * v
    assert -v / speed == pytest.approx(restitution, abs=2e-3)


@pytest.mark.parametrize("case", ["case_1", "case_2", "case_3"])
@pytest.mark.parametrize(
    ("scenario", "name"),
    [(scenario, name) for scenario in ("push", "grab") for name in ("parcel", "cat_food", "juice")],
)
def test_mujoco_model_jumps_as_the_impact_map(scenario: str, name: str, case: str) -> None:
    """Within 2 % of the study's measure. Where a pad slides in a grab of the heavy box, without friction alone.

    MuJoCo's friction pushes off what slides, Coulomb's does not.
    """
    scene = scene_of(scenario, name, case)
    if (scenario, name) == ("grab", "juice"):
        scene = replace(scene, physics=replace(scene.physics, pad_friction=0.0))
    exported = ExportedScene.of(scene, NOMINAL)
    predicted = compute_impact_map(ImpactProblem.at_nominal_impact(scene)).joint_velocity
    after = along(scene, predicted)
    assert along(scene, hit(exported)[0]) == pytest.approx(after, rel=0.02)


@pytest.mark.parametrize("inertia", ["reduced", "rotor", "zero"])
def test_each_motor_inertia_hits_as_its_own_map_says(inertia: str) -> None:
    """The maps of the three differ by 7 % and more."""
    scene = scene_of("push", "juice", "2")
    wanted = along(scene, compute_impact_map(ImpactProblem.at_nominal_impact(scene, inertia)).joint_velocity)
    assert along(scene, hit(ExportedScene.of(scene, NOMINAL, inertia))[0]) == pytest.approx(wanted, rel=0.02)


def test_restitution_of_the_model_is_that_of_the_hit() -> None:
    """A square push without friction: the object leaves with (1 + e) times the momentum."""
    scene = scene_of("push", "cat_food", "2")
    scene = replace(scene, physics=replace(scene.physics, pad_friction=0.0, support_friction=0.0))
    model = with_effect("restitution", restitution=0.5)
    exported = ExportedScene.of(scene, model)
    problem = ImpactProblem.at_nominal_impact(replace(scene, physics=exported.physics))
    problem = replace(problem, restitution=exported.restitution)
    predicted = compute_impact_map(problem)
    assert exported.restitution == pytest.approx(0.5)
    assert hit(exported, 4e-3)[1][1] == pytest.approx(predicted.object_twist[1], rel=0.03)


def test_a_ball_meets_a_quarter_of_the_pad_in_the_words_of_the_export() -> None:
    """zeta = (C / 4) / (2 sqrt(K / 4 m)). Kills the restitution of the whole face, half as large."""
    exported = ExportedScene.of(scene_of("hit_ball", "solid", "1"), NOMINAL, pads="compliant")
    arm, mass = exported.physics.arms["arm"], exported.impact_mass("arm")
    assert arm.pad_stiffness is not None
    expected = restitution_of(0.25 * arm.pad_damping / (2.0 * np.sqrt(0.25 * arm.pad_stiffness * mass)))
    assert exported.restitution_of_pad("arm") == pytest.approx(expected)


@pytest.mark.parametrize("loss", [1e-3, 1e-5, 5e-7, 1e-12])
def test_little_loss_has_a_dissipation_in_proportion(loss: float) -> None:
    """Kills an error of the root search where rounding hides its bracket."""
    assert dissipation_of(1.0 - loss, 0.5) == pytest.approx(1.5 * loss / (1.0 - loss) / 0.5, rel=1e-3)


def test_compliant_pad_has_its_stiffness_in_newtons_per_metre() -> None:
    """An object held against the pad by a force sinks in by F / K."""
    scene = scene_of("push", "cat_food", "2")
    exported = ExportedScene.of(scene, NOMINAL, pads="compliant")
    model = mujoco.MjModel.from_xml_string(FORMATS["mjcf"].write(exported).text)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    data.qvel[:] = 0.0
    model.opt.gravity[:] = 0.0
    force = 200.0  # N
    fixed = model.dof_armature
    fixed[:7] = 1e9  # the arm stands still
    start = data.qpos[8]
    for _ in range(4000):
        data.qfrc_applied[8] = force
        mujoco.mj_step(model, data)
    stiffness = exported.physics.arms["arm"].pad_stiffness
    assert stiffness is not None
    assert data.qpos[8] - start == pytest.approx(force / stiffness, rel=0.05)


def test_pinocchio_reads_the_same_bodies_from_the_urdf() -> None:
    exported = ExportedScene.of(scene_of("grab", "juice", "1"), with_effect("end_effector_payload"))
    model = pin.buildModelFromXML(FORMATS["urdf"].write(exported).text)
    own = sum(link.mass for arm in exported.physics.arms.values() for link in arm.facts.links) + sum(
        arm.end_effector.mass for arm in exported.physics.arms.values()
    )
    assert sum(inertia.mass for inertia in list(model.inertias)[1:]) == pytest.approx(
        own + exported.physics.object.mass
    )
    q = pin.neutral(model)
    for name, arm in exported.physics.arms.items():
        alone = exported.physics.robot_model(name)
        names = [f"{name}_joint{index + 1}" for index in range(arm.facts.joint_count)]
        for joint, value in zip(names, exported.arms[name].position, strict=True):
            q[model.joints[model.getJointId(joint)].idx_q] = value
        inertia = pin.crba(model, model.createData(), q)
        inertia = np.triu(inertia) + np.triu(inertia, 1).T
        rows = [model.joints[model.getJointId(joint)].idx_v for joint in names]
        wanted = alone.mass_matrix(exported.arms[name].position)
        np.testing.assert_allclose(inertia[np.ix_(rows, rows)], wanted, atol=1e-9)


def test_urdf_has_joint_friction_and_says_that_it_has_no_motor_inertia() -> None:
    exported = ExportedScene.of(scene_of("push", "cat_food", "2"), with_effect("joint_coulomb_friction"))
    written = FORMATS["urdf"].write(exported)
    model = pin.buildModelFromXML(written.text)
    assert model.existJointName("arm_joint3")
    dynamics = Xml.fromstring(written.text).find("joint[@name='arm_joint3']/dynamics")
    assert dynamics is not None
    assert float(dynamics.attrib["friction"]) == pytest.approx(exported.friction("arm")[0][2])
    assert any("motor inertia B" in one for one in written.left_out)


@pytest.mark.parametrize("kind", ["urdf", "usd_params", "mjcf"])
def test_a_format_without_hulls_says_that_the_shape_is_left_out(kind: str) -> None:
    """Kills: a pyramid that becomes the box of its extents without a word."""
    exported = ExportedScene.of(scene_of("push", "cat_food", "2"), NOMINAL)
    top, *base = (0.0, 0.0, 0.05), (0.05, 0.0, -0.05), (-0.05, 0.04, -0.05), (-0.05, -0.04, -0.05)
    thing = replace(exported.physics.object, shape=hull_of((top, *base)), size=np.array([0.1, 0.08, 0.1]))
    written = FORMATS[kind].write(replace(exported, physics=replace(exported.physics, object=thing)))
    assert ("shape of the object, a hull of 4 corners" in written.left_out) == (kind != "mjcf")
    assert any("box of its extents" in remark for remark in written.remarks) == (kind == "urdf")


def test_friction_without_torque_loop_is_that_of_the_motors() -> None:
    """tau_fric,m = B_rho B_theta^-1 tau_fric (paper, below eq. EOM_motor_mod)."""
    scene, model = scene_of("push", "cat_food", "2"), with_effect("joint_coulomb_friction")
    arm = scene.physics.arms["arm"]
    loop, none = (ExportedScene.of(scene, model, kind).friction("arm")[0] for kind in ("reduced", "rotor"))
    np.testing.assert_allclose(none, arm.motor_inertia_rotor / arm.motor_inertia_reduced * loop)


def test_drake_file_has_the_numbers_of_the_scene() -> None:
    """Read as XML: Drake itself is no requirement of the tests."""
    exported = ExportedScene.of(scene_of("push", "cat_food", "2"), with_effect("end_effector_payload"))
    root = Xml.fromstring(FORMATS["drake"].write(exported).text)
    drake = "{drake.mit.edu}"
    masses = [float(mass.text or "nan") for mass in root.iterfind("world/model[@name='arm']/link/inertial/mass")]
    arm = exported.physics.arms["arm"]
    assert masses[1:] == pytest.approx([*(link.mass for link in arm.facts.links), arm.end_effector.mass])
    rotors = [float(rotor.text or "nan") for rotor in root.iter(f"{drake}rotor_inertia")]
    assert rotors == pytest.approx(exported.motor_inertia["arm"])
    friction = {float(mu.text or "nan") for mu in root.iter(f"{drake}mu_dynamic")}
    assert friction == {exported.physics.pad_friction, exported.physics.support_friction}


# Scenes with neighbours are not exported, and in others effects on neighbours change nothing.
ON_OTHERS = [name for name, effect in sorted(library().items()) if effect.acts_on != "neighbour"]


@pytest.mark.parametrize("kind", list(FORMATS))
@pytest.mark.parametrize("effect", ON_OTHERS)
def test_no_effect_is_dropped_in_silence(effect: str, kind: str) -> None:
    """Every effect of the library changes the file, or is said to be left out."""
    scene = scene_of("push", "cat_food", "2")
    exported = ExportedScene.of(scene, with_effect(effect))
    plain = ExportedScene.of(scene, NOMINAL)
    with_it, without = (FORMATS[kind].write(one) for one in (exported, plain))
    body, same = FORMATS[kind].body(exported)[0], FORMATS[kind].body(plain)[0]
    assert body != same or set(with_it.left_out) != set(without.left_out)


@pytest.mark.parametrize("kind", list(FORMATS))
def test_head_of_a_file_says_what_is_left_out(kind: str) -> None:
    exported = ExportedScene.of(scene_of("push", "cat_food", "2"), with_effect("torque_offset"), pads="rigid")
    written = FORMATS[kind].write(exported)
    head = written.text.split("<mujoco")[0].split("<sdf")[0].split("<robot")[0].split("\nover")[0]
    for one in (*written.left_out, *written.remarks):
        assert one.replace("--", "") in head or one in head
    assert "torque_offset" in head
