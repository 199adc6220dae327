# SPDX-License-Identifier: Apache-2.0
"""The impact map beside MuJoCo and Drake: processor time per call, and distance from the exact solution.

MuJoCo and Drake are optional: ``./run python -m pip install mujoco drake``; what is not installed is left out.

Every solver gets the same robot (our URDF), motor inertia, state and contact points: a sphere of 1 mm on pad or
support for every point, against a plate on the object. Only ``bullet`` finds its points itself, as always. The exact
solution is the answer of ``exact`` on the same points, accepted only if it breaks no law by more than 1e-9 m/s; beside
its own time stands its residual. A call sets the state, steps until the velocity is settled, and reads it.

Set on purpose: no gravity, steps of 0.1 us (MuJoCo) and 1 us (Drake), velocities set directly. MuJoCo: elliptic cones,
impedance 0.9999, damper alone. Drake: point contact, gear ratio 1; SAP: 1e14 N/m, relaxation time 1 s, near-rigid
threshold 1e-6; TAMSI: 1e18 N/m, stiction tolerance 1e-5 m/s.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from importlib.util import find_spec
from xml.etree import ElementTree as Xml

import numpy as np
import pinocchio as pin

from benchmarks.harness import Case, Row, Work
from benchmarks.results import Table
from impact_rs_sim.impact_map import BulletEngine, ExactEngine, ImpactMapError, ImpactProblem, ImpactResult
from impact_rs_sim.impact_map.contacts import SUPPORT, ContactPoint, contact_frame, contact_pairs, find_contacts
from impact_rs_sim.impact_map.laws import System, build_system
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_sim.rotations import quaternion_of
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_sim.scene import BodyState, Scene, pad_placements

SCENES = ("corner", "edge", "face", "push", "grab", "grid")
FRICTIONS = {"none": (0.0, 0.0), "sticking": (2.0, 0.0), "nominal": (0.5, 0.3)}  # of pad and support [-]
EXACT = 1e-9  # m/s, largest accepted residual of the exact solution
NEGLIGIBLE = 1e-4  # of the ante-impact speed: what the goal asks for
SETTLED = 1e-5  # rad/s, m/s; a peer steps until nothing changes by more
MOST_STEPS = 10
RADIUS = 1e-3  # m, of the spheres that stand for contact points
PLATE = (0.6, 0.6, 0.02)  # m, of the plates on the object; no sphere touches an edge


class OtherPoints(Exception):
    """A solver sees other contact points than it is asked about."""


@dataclass(frozen=True)
class Question:
    """One question, with its exact answer ``u^+`` ``(nv,)`` and by how much that breaks the laws [m/s]."""

    name: str
    problem: ImpactProblem
    models: dict[str, RobotModel]
    contacts: Sequence[ContactPoint]
    system: System
    exact: Array
    residual: float

    @staticmethod
    def make(name: str, friction: str) -> Question:
        """One of ``SCENES`` with one of ``FRICTIONS``."""
        scene = Scene.resolve(load_scenario("grab" if name == "grab" else "push"), "cat_food", "case_2")
        problem = ImpactProblem.at_nominal_impact(scene)
        pad, support = FRICTIONS[friction]
        physics = replace(problem.physics, pad_friction=pad, support_friction=support)
        if name not in ("push", "grab"):
            physics = replace(physics, support_height=None)
        problem = replace(problem, physics=physics)
        models = {arm: physics.robot_model(arm) for arm in physics.arms}
        if name in ("corner", "edge"):
            problem = _tilted(problem, models["arm"], roll=0.035 if name == "corner" else 0.0, yaw=0.03)
        placements = pad_placements(physics, models, problem.arms)
        contacts = find_contacts(physics, contact_pairs(physics, problem.object, placements))
        if name == "grid":
            contacts = grid(contacts, 4)
        system = build_system(problem, models)
        solution = ExactEngine(physics).solve(problem, contacts)
        if solution.residual.largest > EXACT:
            raise ArithmeticError(f"no exact solution: a law is broken by {solution.residual.largest:.1e} m/s")
        exact = np.concatenate((*solution.joint_velocity.values(), solution.object_twist))
        return Question(name, problem, models, contacts, system, exact, solution.residual.largest)

    def points(self) -> dict[str, list[ContactPoint]]:
        """Contact points by partner of the object."""
        partners = dict.fromkeys(contact.partner for contact in self.contacts)
        return {name: [contact for contact in self.contacts if contact.partner == name] for name in partners}

    def ball(self, contact: ContactPoint, overlap: float = 0.0) -> Array:
        """Centre of the sphere that stands for a contact point, in frame E of its arm, or in A ``(3,)`` [m]."""
        centre = contact.partner_position - (RADIUS - overlap) * contact.normal
        if contact.partner == SUPPORT:
            return centre
        return self.models[contact.partner].placement(self.problem.arms[contact.partner].position).actInv(centre)

    def plate(self, contacts: Sequence[ContactPoint]) -> pin.SE3:
        """Placement in the object of the plate that meets the spheres of ``contacts``."""
        rotation = contact_frame(contacts[0].normal).T
        centre = np.mean([contact.position for contact in contacts], axis=0) + rotation[:, 2] * PLATE[2] / 2.0
        body = self.problem.object
        return pin.SE3(body.rotation, body.position).actInv(pin.SE3(rotation, centre))

    def distance(self, velocity: Array) -> float:
        """Largest error of joint velocities and object velocity over their ante-impact scale [-]."""
        error, before = velocity - self.exact, self.system.velocity
        joints = slice(0, self.system.columns["object"].start)
        speed = self.speed
        linear = np.linalg.norm(error[self.system.columns["object"]][:3])
        return float(max(np.max(np.abs(error[joints])) / np.max(np.abs(before[joints])), linear / speed))

    @property
    def speed(self) -> float:
        """Ante-impact speed of the fastest end effector [m/s]."""
        _, twists, _ = self.system.split(self.system.velocity)
        return max(float(np.linalg.norm(twist[:3])) for twist in twists.values())


def _tilted(problem: ImpactProblem, model: RobotModel, roll: float, yaw: float) -> ImpactProblem:
    """The object turned so that it meets one corner or one edge of the pad."""
    tilt = pin.rpy.rpyToMatrix(roll, 0.0, yaw)
    placement = model.placement(problem.arms["arm"].position)
    width, height, _ = problem.physics.arms["arm"].end_effector.pad_size
    corners = [placement.act(np.array([x * width, y * height, 0.0]) / 2.0) for x in (-1, 1) for y in (-1, 1)]
    face = -tilt[:, 1]
    reach = np.max(np.array(corners) @ face)
    body = problem.object.position
    centre = body + face * (reach + problem.physics.object.size[1] / 2.0 - body @ face)
    return replace(problem, object=BodyState(centre, tilt, np.zeros(6)))


def grid(corners: Sequence[ContactPoint], count: int) -> list[ContactPoint]:
    """``count`` x ``count`` points between the four corners of a face contact."""
    first, second, third, fourth = (corner.position for corner in corners)
    shares = np.linspace(0.0, 1.0, count) if count > 1 else np.array([0.5])
    return [
        replace(corners[0], position=(1 - v) * ((1 - u) * first + u * second) + v * ((1 - u) * fourth + u * third))
        for u in shares
        for v in shares
    ]


def _bare(model: RobotModel, name: str) -> Xml.Element:
    """Our URDF without shapes: contact points are added by hand."""
    robot = Xml.fromstring(model.urdf)
    robot.set("name", name)
    for link in robot.iter("link"):
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            link.remove(shape)
    return robot


def _quaternion(rotation: Array) -> Array:
    """w, x, y, z of a rotation matrix, ``(4,)``."""
    return np.roll(quaternion_of(rotation), 1)


class MujocoPeer:
    """MuJoCo: elliptic cones, Newton's solver, the stiffest impedance that it accepts."""

    name = "MuJoCo"
    STEP = 1e-7  # s, so short that Coriolis forces and motion drop out
    IMPEDANCE = 0.9999  # the largest that MuJoCo takes

    def __init__(self, case: Question) -> None:
        import mujoco

        self._library = mujoco
        self._case = case
        spec = mujoco.MjSpec()
        spec.option.timestep = self.STEP
        spec.option.gravity = np.zeros(3)
        spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
        spec.option.solver = mujoco.mjtSolver.mjSOL_NEWTON
        spec.option.iterations, spec.option.tolerance = 200, 1e-15
        problem = case.problem
        for name, arm in problem.physics.arms.items():
            robot = _bare(case.models[name], name)
            Xml.SubElement(Xml.SubElement(robot, "mujoco"), "compiler", fusestatic="false", balanceinertia="false")
            child = mujoco.MjSpec.from_string(Xml.tostring(robot, encoding="unicode"))
            for joint, inertia in zip(child.joints, problem.motor_inertia[name], strict=True):
                joint.armature = inertia
            base = spec.worldbody.add_frame(pos=arm.base.translation, quat=_quaternion(arm.base.rotation))
            spec.attach(child, prefix=f"{name}_", frame=base)
        object_ = problem.physics.object
        body = spec.worldbody.add_body(
            name="object", mass=object_.mass, ipos=object_.com_offset, inertia=object_.inertia, explicitinertial=True
        )
        body.add_freejoint()
        for number, (name, contacts) in enumerate(case.points().items()):
            common = {
                "contype": 1 << number,
                "conaffinity": 1 << number,
                "condim": 3,
                "friction": [contacts[0].friction, 0.0, 0.0],
                "solref": [-1e-30, -1.0 / self.STEP],  # no spring; a damper that stops a point within one step
                "solimp": [self.IMPEDANCE, self.IMPEDANCE, 1.0, 0.5, 2.0],
                "margin": 1e-4,
                "mass": 0.0,
            }
            plate = case.plate(contacts)
            body.add_geom(
                type=mujoco.mjtGeom.mjGEOM_BOX,
                size=np.array(PLATE) / 2.0,
                pos=plate.translation,
                quat=_quaternion(plate.rotation),
                **common,
            )
            owner = spec.worldbody if name == SUPPORT else spec.body(f"{name}_end_effector")
            for contact in contacts:
                owner.add_geom(
                    type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[RADIUS, 0.0, 0.0], pos=case.ball(contact), **common
                )
        self._model = spec.compile()
        self._data = mujoco.MjData(self._model)
        self.steps = 1
        self.steps = _settle(self)
        assert self._data.ncon == len(case.contacts), "MuJoCo sees other contact points"

    def solve(self) -> Array:
        """u^+, ``(nv,)``."""
        library, model, data, problem = self._library, self._model, self._data, self._case.problem
        library.mj_resetData(model, data)
        object_ = problem.object
        joints = [state.position for state in problem.arms.values()]
        data.qpos[:] = np.concatenate((*joints, object_.position, _quaternion(object_.rotation)))
        data.qvel[:] = self._case.system.velocity
        data.qvel[-3:] = object_.rotation.T @ object_.twist[3:]
        library.mj_step(model, data, self.steps)
        velocity = data.qvel.copy()
        velocity[-3:] = object_.rotation @ velocity[-3:]
        return np.asarray(velocity)


class DrakePeer:
    """Drake with one of its discrete solvers and near-rigid point contact."""

    STEP = 1e-6  # s
    OVERLAP = 1e-12  # m; Drake sees overlapping shapes only, and would turn much of it into velocity

    def __init__(self, case: Question, solver: str, stiffness: float, relaxation_time: float | None) -> None:
        from pydrake.geometry import (
            AddContactMaterial,
            Box,
            CollisionFilterDeclaration,
            GeometrySet,
            ProximityProperties,
            Sphere,
        )
        from pydrake.math import RigidTransform, RotationMatrix
        from pydrake.multibody.parsing import Parser
        from pydrake.multibody.plant import (
            AddMultibodyPlantSceneGraph,
            ContactModel,
            CoulombFriction,
            DiscreteContactApproximation,
        )
        from pydrake.multibody.tree import RotationalInertia, SpatialInertia
        from pydrake.systems.framework import DiagramBuilder

        def transform(placement: pin.SE3) -> RigidTransform:
            return RigidTransform(RotationMatrix(placement.rotation), placement.translation)

        self.name = f"Drake {solver}"
        self._case = case
        builder = DiagramBuilder()
        plant, shapes = AddMultibodyPlantSceneGraph(builder, self.STEP)
        plant.SetUseSampledOutputPorts(False)
        plant.mutable_gravity_field().set_gravity_vector(np.zeros(3))
        plant.set_contact_model(ContactModel.kPoint)
        plant.set_discrete_contact_approximation(getattr(DiscreteContactApproximation, f"k{solver}"))
        plant.set_sap_near_rigid_threshold(1e-6)
        plant.set_stiction_tolerance(1e-5)
        problem = case.problem
        for name, arm in problem.physics.arms.items():
            text = Xml.tostring(_bare(case.models[name], name), encoding="unicode")
            (instance,) = Parser(plant).AddModelsFromString(text, "urdf")
            plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("base", instance), transform(arm.base))
            for index, inertia in enumerate(problem.motor_inertia[name], start=1):
                actuator = plant.AddJointActuator(f"{name}_{index}", plant.GetJointByName(f"joint{index}", instance))
                actuator.set_default_rotor_inertia(inertia)
                actuator.set_default_gear_ratio(1.0)
        object_ = problem.physics.object
        inertia = SpatialInertia.MakeFromCentralInertia(
            object_.mass, object_.com_offset, RotationalInertia(*object_.inertia)
        )
        body = plant.AddRigidBody("object", plant.AddModelInstance("object"), inertia)
        plates, balls = {}, {}
        for name, contacts in case.points().items():
            material = ProximityProperties()
            friction = CoulombFriction(contacts[0].friction, contacts[0].friction)
            AddContactMaterial(material, point_stiffness=stiffness, friction=friction)
            if relaxation_time is not None:
                material.AddProperty("material", "relaxation_time", relaxation_time)
            plate_placement = transform(case.plate(contacts))
            plates[name] = plant.RegisterCollisionGeometry(body, plate_placement, Box(*PLATE), name, material)
            owner = plant.world_body()
            if name != SUPPORT:
                owner = plant.GetBodyByName("end_effector", plant.GetModelInstanceByName(name))
            balls[name] = [
                plant.RegisterCollisionGeometry(
                    owner,
                    RigidTransform(case.ball(contact, self.OVERLAP)),
                    Sphere(RADIUS),
                    f"{name}{index}",
                    material,
                )
                for index, contact in enumerate(contacts)
            ]
        plant.Finalize()
        declaration = CollisionFilterDeclaration()
        declaration.ExcludeWithin(GeometrySet([ball for group in balls.values() for ball in group]))
        for name, plate in plates.items():
            other_balls = [ball for other, group in balls.items() if other != name for ball in group]
            if other_balls:
                declaration.ExcludeBetween(GeometrySet([plate]), GeometrySet(other_balls))
        shapes.collision_filter_manager().Apply(declaration)
        self._plant = plant
        self._diagram = builder.Build()
        self._context = self._diagram.CreateDefaultContext()
        self._state = plant.GetMyMutableContextFromRoot(self._context)
        self.steps = 1
        self.steps = _settle(self)

    def solve(self) -> Array:
        """u^+, ``(nv,)``."""
        plant, state, problem = self._plant, self._state, self._case.problem
        object_, before = problem.object, self._case.system.velocity
        joints = [arm.position for arm in problem.arms.values()]
        plant.SetPositions(state, np.concatenate((*joints, _quaternion(object_.rotation), object_.position)))
        plant.SetVelocities(state, np.concatenate((before[:-6], before[-3:], before[-6:-3])))
        for _ in range(self.steps):
            state.SetDiscreteState(plant.EvalUniquePeriodicDiscreteUpdate(state))
        velocity = plant.GetVelocities(state)
        return np.concatenate((velocity[:-6], velocity[-3:], velocity[-6:-3]))


def _settle(peer: MujocoPeer | DrakePeer) -> int:
    """Steps after which one more changes nothing."""
    last = peer.solve()
    for steps in range(2, MOST_STEPS + 1):
        peer.steps = steps
        velocity = peer.solve()
        if np.max(np.abs(velocity - last)) < SETTLED:
            return steps - 1
        last = velocity
    return MOST_STEPS


def competitors(case: Question) -> dict[str, Callable[[], Callable[[], Array]]]:
    """What makes a solver ready for ``case`` and returns its call, by name."""

    def ours(call: Callable[[ImpactProblem], ImpactResult]) -> Callable[[], Array]:
        def solve() -> Array:
            result = call(case.problem)
            if len(result.contacts) != len(case.contacts):
                raise OtherPoints(f"{len(result.contacts)} points")
            return np.concatenate((*result.joint_velocity.values(), result.object_twist))

        return solve

    physics = case.problem.physics

    def exact() -> Callable[[], Array]:
        engine = ExactEngine(physics)
        contacts = case.contacts if case.name == "grid" else None
        return ours(lambda problem: engine.solve(problem, contacts))

    makers: dict[str, Callable[[], Callable[[], Array]]] = {
        "ours: exact": exact,
        "ours: bullet": lambda: ours(BulletEngine(physics).solve),
    }
    if find_spec("mujoco") is not None:
        makers["MuJoCo"] = lambda: MujocoPeer(case).solve
    if find_spec("pydrake") is not None:
        makers["Drake SAP"] = lambda: DrakePeer(case, "Sap", stiffness=1e14, relaxation_time=1.0).solve
        makers["Drake TAMSI"] = lambda: DrakePeer(case, "Tamsi", stiffness=1e18, relaxation_time=None).solve
    return makers


def add_options(parser: argparse.ArgumentParser) -> None:
    """Which questions, and how often."""
    parser.add_argument("--calls", type=int, default=100, help="timed calls of every solver in every case")
    parser.add_argument("--frictions", nargs="+", default=list(FRICTIONS), choices=FRICTIONS, help="of pad and support")


def cases(options: argparse.Namespace) -> list[Case]:
    """Scenes with each friction."""
    return [Case(f"{scene}, {friction}", (scene, friction)) for friction in options.frictions for scene in SCENES]


def run(case: Case, work: Work) -> Row:
    """Every solver: time of a call [ms], distance from the exact solution [-]; of that itself its residual [-]."""
    question = Question.make(*case.inputs)
    results: dict[str, object] = {}
    for name, make in competitors(question).items():
        try:
            solve, times = make(), []
            for _ in range(work.options.calls + 1):
                began = time.process_time()
                velocity = solve()
                times.append(1e3 * (time.process_time() - began))
        except OtherPoints as error:
            results[name] = str(error)
        except (ImpactMapError, RuntimeError):
            results[name] = "no answer"
        else:
            is_reference = name == "ours: exact"
            distance = question.residual / question.speed if is_reference else question.distance(velocity)
            results[name] = float(np.median(times[1:])), distance
    return {"points": len(question.contacts), "found": results}


def table(rows: list[Row], options: argparse.Namespace) -> Table:
    """A row for each question; a distance beyond ``NEGLIGIBLE`` is bold."""
    del options
    names = list(rows[0]["found"])

    def cell(result: str | tuple[float, float]) -> str:
        if isinstance(result, str):
            return result
        milliseconds, distance = result
        bold = "**" if distance > NEGLIGIBLE else ""
        return f"{milliseconds:.3f}, {bold}{distance:.0e}{bold}"

    lines = [(f"{row['name']}, {row['points']}", *(cell(row["found"][name]) for name in names)) for row in rows]
    within_count = (
        sum(not isinstance(row["found"][name], str) and row["found"][name][1] <= NEGLIGIBLE for row in rows)
        for name in names
    )
    within = (f"within {NEGLIGIBLE:.0e}", *(f"{count} of {len(rows)}" for count in within_count))
    return Table(("Scene, friction, contact points", *names), (*lines, within))
