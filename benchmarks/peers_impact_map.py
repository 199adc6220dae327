# SPDX-License-Identifier: Apache-2.0
"""The impact map beside MuJoCo and Drake: time per call, and distance from the exact solution.

    ./run python benchmarks/peers_impact_map.py [--calls 100] [--scenes corner push]

MuJoCo and Drake are optional: ``./run python -m pip install mujoco drake`` (or the extra ``peers``); what is not
installed is skipped.

Every solver gets the same robot (our URDF), motor inertia, state and contact points: a sphere
of 1 mm on pad or support for every point, against a plate on the object. Only ``bullet`` finds its points itself, as
always. The exact solution is computed here, by Newton's method on the laws, and is accepted only if it breaks none of
them by more than 1e-9 m/s. A call sets the state, steps until the velocity is settled, and reads
it. Times are CPU times, which other programs blur least: run it with ``OMP_NUM_THREADS=1``.
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
from rich.console import Console
from rich.table import Table
from scipy.optimize import approx_fprime, nnls

from impact_rs_sim.impact_map import BulletEngine, Engine, ExactEngine, ImpactMapError, ImpactProblem
from impact_rs_sim.impact_map.cones import solve_cones
from impact_rs_sim.impact_map.contacts import SUPPORT, ContactPoint, contact_frame, find_contacts, meetings
from impact_rs_sim.impact_map.laws import ContactTerms, System, build_system
from impact_rs_sim.physics import Physics
from impact_rs_sim.robot import Array
from impact_rs_sim.robot_model import RobotModel
from impact_rs_sim.rotations import quaternion_of
from impact_rs_sim.scenario import load_scenario
from impact_rs_sim.scene import BodyState, Scene

SCENES = ("corner", "edge", "face", "push", "grab", "grid")
FRICTIONS = {"none": (0.0, 0.0), "sticking": (2.0, 0.0), "nominal": (0.5, 0.3)}  # of pad and support [-]
EXACT = 1e-9  # m/s, largest accepted residual of the exact solution
NEWTON_STEPS = 10
GUESS = 1e-11  # m/s, accuracy of the answer that it starts from
SLOWEST_SLIDING = (1e-6, 1e-5, 1e-7, 1e-4, 1e-8)  # m/s, tried in turn: what divides sliding from sticking
NEGLIGIBLE = 1e-4  # of the ante-impact speed: what the goal asks for, and separates touching from leaving
FAR = 2e-3  # of the ante-impact speed: an answer as far off is wrong, or another solution
SETTLED = 1e-5  # rad/s, m/s; a peer steps until nothing changes by more
MOST_STEPS = 10
RADIUS = 1e-3  # m, of the spheres that stand for contact points
PLATE = (0.6, 0.6, 0.02)  # m, of the plates on the object; no sphere touches an edge
DIRECTIONS = 360  # of friction, where a sticking point is tried

console = Console(width=190)


class OtherPoints(Exception):
    """A solver sees other contact points than it is asked about."""


class PinocchioOnGivenPoints(ExactEngine):
    """Our engine on other contact points than the corners of the contact polygon."""

    def __init__(self, physics: Physics, contacts: Sequence[ContactPoint]) -> None:
        super().__init__(physics)
        self.contacts = contacts

    def _points(self) -> Sequence[ContactPoint]:
        return self.contacts


@dataclass(frozen=True)
class Case:
    """One question, with its exact answer ``u^+`` ``(nv,)``."""

    name: str
    problem: ImpactProblem
    models: dict[str, RobotModel]
    contacts: Sequence[ContactPoint]
    system: System
    exact: Array

    @staticmethod
    def make(name: str, friction: str) -> Case:
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
        placements = {arm: models[arm].placement(state.position) for arm, state in problem.arms.items()}
        contacts = find_contacts(physics, meetings(physics, problem.object, placements))
        if name == "grid":
            contacts = grid(contacts, 4)
        system = build_system(problem, models)
        return Case(name, problem, models, contacts, system, _exact(system, contacts))

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

    def is_lawful(self, velocity: Array) -> bool:
        """Whether some impulses explain ``velocity`` under all laws: redundant contacts may have several solutions.

        Impulses that each point may have at this velocity span a cone; the momentum must lie in it.
        """
        touching, cone = NEGLIGIBLE * self.speed, []
        for row, contact in zip(
            self.system.jacobian(self.contacts).reshape(len(self.contacts), 3, -1), self.contacts, strict=True
        ):
            leaving = contact.normal @ row @ velocity
            sliding = row @ velocity - leaving * contact.normal
            if leaving < -touching:
                return False
            if leaving > touching:
                continue
            across = contact_frame(contact.normal)[:2]
            angles = np.linspace(0.0, 2.0 * np.pi, DIRECTIONS, endpoint=False)
            directions = np.column_stack((np.cos(angles), np.sin(angles))) @ across
            if np.linalg.norm(sliding) > touching:
                directions = -sliding[None] / np.linalg.norm(sliding)
            cone.append((contact.normal + contact.friction * directions) @ row)
        if not cone:
            return False
        factor = np.linalg.cholesky(self.system.inertia)
        momentum = factor.T @ (velocity - self.system.velocity)
        _, missing = nnls(np.linalg.solve(factor, np.vstack(cone).T), momentum)
        return bool(missing < 10.0 * NEGLIGIBLE * np.linalg.norm(factor.T @ self.system.velocity))


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


def _exact(system: System, contacts: Sequence[ContactPoint]) -> Array:
    """u^+ by Newton's method on the laws, with the contact modes of a first answer by our solver."""
    terms = ContactTerms.of(system, contacts, 0.0)
    guess, _ = solve_cones(terms, GUESS)
    residuals = []
    for slowest in SLOWEST_SLIDING:
        impulses = _newton(system, terms, guess, slowest)
        velocity = system.velocity + terms.response @ impulses.ravel()
        residuals.append(terms.residual(impulses, velocity))
        if residuals[-1].largest <= EXACT:
            return np.asarray(velocity)
    law, amount = min((residual.worst for residual in residuals), key=lambda worst: worst[1])
    raise ArithmeticError(f"no exact solution: {law} is broken by {amount:.1e} m/s")


def _newton(system: System, terms: ContactTerms, guess: Array, slowest: float) -> Array:
    """Impulses ``(m, 3)``; points of ``guess`` that slide slower than ``slowest`` [m/s] stick."""
    velocity = system.velocity + terms.response @ guess.ravel()
    pressed = terms.split(guess)[0] > 1e-6 * np.max(guess)
    slides = np.linalg.norm(terms.split((terms.jacobian @ velocity).reshape(-1, 3))[1], axis=1) > slowest

    def laws(unknown: Array) -> Array:
        impulse = unknown.reshape(-1, 3)
        moving = (terms.jacobian @ (system.velocity + terms.response @ unknown)).reshape(-1, 3)
        along, sliding = terms.split(moving)
        pressing, tangential = terms.split(impulse)
        speed = np.linalg.norm(sliding, axis=1)
        opposed = tangential * speed[:, None] + (terms.friction * pressing)[:, None] * sliding
        opposed = np.where((terms.friction > 0.0)[:, None], opposed, tangential)
        slipping = along[:, None] * terms.normals + opposed
        held = np.where((slides | (terms.friction == 0.0))[:, None], slipping, moving)
        return np.asarray(np.where(pressed[:, None], held, impulse).ravel())

    unknown = guess.ravel()
    for _ in range(NEWTON_STEPS):  # least norm: redundant contacts share an impulse in many ways
        unknown = unknown - np.linalg.lstsq(approx_fprime(unknown, laws), laws(unknown), rcond=1e-6)[0]
    return np.asarray(unknown.reshape(-1, 3))


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

    def __init__(self, case: Case) -> None:
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

    def __init__(self, case: Case, solver: str, stiffness: float, relaxation_time: float | None) -> None:
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
            where = transform(case.plate(contacts))
            plates[name] = plant.RegisterCollisionGeometry(body, where, Box(*PLATE), name, material)
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
            others = [ball for other, group in balls.items() if other != name for ball in group]
            if others:
                declaration.ExcludeBetween(GeometrySet([plate]), GeometrySet(others))
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


def competitors(case: Case) -> dict[str, Callable[[], Callable[[], Array]]]:
    """What makes a solver ready for ``case`` and returns its call, by name."""

    def ours(engine: Engine) -> Callable[[], Array]:
        def solve() -> Array:
            result = engine.solve(case.problem)
            if len(result.contacts) != len(case.contacts):
                raise OtherPoints(f"{len(result.contacts)} points")
            return np.concatenate((*result.joint_velocity.values(), result.object_twist))

        return solve

    physics = case.problem.physics
    makers: dict[str, Callable[[], Callable[[], Array]]] = {
        "ours: exact": lambda: ours(
            PinocchioOnGivenPoints(physics, case.contacts) if case.name == "grid" else ExactEngine(physics)
        ),
        "ours: bullet": lambda: ours(BulletEngine(physics)),
    }
    if find_spec("mujoco") is not None:
        makers["MuJoCo"] = lambda: MujocoPeer(case).solve
    if find_spec("pydrake") is not None:
        makers["Drake SAP"] = lambda: DrakePeer(case, "Sap", stiffness=1e14, relaxation_time=1.0).solve
        makers["Drake TAMSI"] = lambda: DrakePeer(case, "Tamsi", stiffness=1e18, relaxation_time=None).solve
    return makers


@dataclass(frozen=True)
class Cell:
    """Time per call, 10, 50 and 90 % [ms]; distance from the exact solution [-]; whether it is another solution."""

    times: Array
    distance: float
    lawful: bool

    def __str__(self) -> str:
        low, middle, high = self.times
        return f"{middle:.3f} ({low:.3f}..{high:.3f}) {self.distance:.0e}{'*' if self.lawful else ''}"


def measure(case: Case, make: Callable[[], Callable[[], Array]], calls: int) -> Cell | str:
    """One cell of the table, or why there is none."""
    try:
        solve = make()
        velocity = solve()
        times = []
        for _ in range(calls):
            start = time.process_time()
            velocity = solve()
            times.append(1e3 * (time.process_time() - start))
    except OtherPoints as error:
        return str(error)
    except (ImpactMapError, RuntimeError):
        return "no answer"
    distance = case.distance(velocity)
    return Cell(np.percentile(times, [10, 50, 90]), distance, distance > FAR and case.is_lawful(velocity))


def summary(rows: Sequence[dict[str, Cell | str]]) -> str:
    """How often each solver is accurate, and how often it is the fastest of those."""
    good = [
        {name: cell for name, cell in row.items() if isinstance(cell, Cell) and cell.distance <= NEGLIGIBLE}
        for row in rows
    ]
    fastest = [min(row, key=lambda name: row[name].times[1]) for row in good if row]
    counts = [
        f"{name} {sum(name in row for row in good)} of {len(rows)}, fastest of those in {fastest.count(name)}"
        for name in rows[0]
    ]
    return f"distance <= {NEGLIGIBLE:.0e}: " + "; ".join(counts) + "."


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--calls", type=int, default=100, help="timed calls of every solver in every case")
    parser.add_argument("--scenes", nargs="+", default=SCENES, choices=SCENES, help="which scenes")
    parser.add_argument("--friction", nargs="+", default=list(FRICTIONS), choices=FRICTIONS, help="which frictions")
    options = parser.parse_args()
    for module, package in (("mujoco", "mujoco"), ("pydrake", "drake")):
        if find_spec(module) is None:
            console.print(f"{package} is not installed and skipped: ./run python -m pip install {package}")
    table = Table(title="CPU milliseconds per call, median (10 to 90 %), and distance from the exact solution")
    rows: list[dict[str, Cell | str]] = []
    for scene in options.scenes:
        for friction in options.friction:
            case = Case.make(scene, friction)
            rows.append({name: measure(case, make, options.calls) for name, make in competitors(case).items()})
            if not table.columns:
                for column in ("scene", "points", "friction", *rows[0]):
                    table.add_column(column, no_wrap=True)
            table.add_row(scene, str(len(case.contacts)), friction, *map(str, rows[-1].values()))
    console.print(table)
    console.print(summary(rows))
    console.print(
        "distance: largest error of a joint velocity over the largest before the impact, or of the object's velocity "
        "over the end effector's.\n"
        "*: far off, but it obeys all laws, too (to 0.1 %): where redundant points slide, several answers may.\n"
        "friction: pad and support: none 0, 0; sticking 2, 0; nominal 0.5, 0.3 (the object slides on its support).\n"
        "Set on purpose: no gravity, steps of 0.1 us (MuJoCo) and 1 us (Drake), velocities set directly, steps until "
        "settled. MuJoCo: elliptic cones,\nimpedance 0.9999, damper alone. Drake: point contact, gear ratio 1; SAP: "
        "1e14 N/m, relaxation time 1 s, near-rigid threshold 1e-6; TAMSI: 1e18 N/m;\n"
        "stiction tolerance 1e-5 m/s. MuJoCo and SAP solve a convex relaxation: a point that slides at v leaves its "
        "partner at mu v."
    )


if __name__ == "__main__":
    main()
