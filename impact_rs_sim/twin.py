# SPDX-License-Identifier: Apache-2.0
"""The twin: arms with drives, object and support from a measured state under recorded torque, compiled.

It is the second simulator of :class:`~impact_rs_sim.physics.Physics`, besides Bullet
(:mod:`impact_rs_sim.plant.bullet_mechanics`): in free motion both are equal to rounding, in contact they differ by
their step methods (``docs/physics.md``, "The twin"). Many jobs run in one call, on several threads, with results that
do not depend on the number of threads; :mod:`impact_rs_sim.plant.twin_mechanics` runs one job tick by tick.

Loads of formulas and springs are compiled. A load that is a Python class works as well, but needs a call into Python at
every tick, by one thread at a time; between pad and object only formulas act.

Pads touch the object, not each other; links touch nothing.
"""

from __future__ import annotations

import ast
import functools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pinocchio as pin
import scipy
from numpy.typing import NDArray

from impact_rs_sim import _kernel
from impact_rs_sim.drive import Drive, DriveStart
from impact_rs_sim.effects.formula import JOINT_SYMBOL, LAG, Formula, FormulaLoad, FormulaObjectLoad
from impact_rs_sim.effects.surroundings import Spring
from impact_rs_sim.errors import InputError
from impact_rs_sim.physics import ArmPhysics, Load, Physics
from impact_rs_sim.robots.robot import Array, Flange, JointOrigin
from impact_rs_sim.scene import ArmMotion, ArmState, BodyState, standing

# Points of action of formulas beyond joints and end effector: `Acts` in src/twin_formula.hpp.
ON_PAD, ALONG_PAD, ON_OBJECT, TURNING_OBJECT, ON_SUPPORT, ALONG_SUPPORT = range(3, 9)
LAG_WITH_START = "lag_from"  # its name in `Formula::NAMES` of src/twin_formula.hpp
BOX_COLUMNS = 13  # of an object in a state of the kernel: pose and twist
CONTACT_REFINEMENT = 2  # time steps per period of the torque loop during pad contact
DISTANT_PAST_S = -1e9  # start of a command without a start time


@dataclass(frozen=True)
class TwinJob:
    """One simulation.

    Attributes:
        physics: Parameters of the scene.
        arms: Joint states at the start, by arm.
        drives: State of the drives at the start.
        torque: By arm, driving torques in the order in which they act, ``(m, n)`` [N m].
        acting: By arm, row of ``torque`` in every period of the torque loop, ``((k - 1) s,)``.
        time: Ticks, ``(k,)`` [s].
        period: Period of the torque loop [s].
        object: State of the object at the start, with its neighbours at rest beside it; None: arms without object.
        joint_torque: Whether the torques are measured joint torques, without motors and torque loop: each is tau_J at
            the end of its period, and the links receive tau_J + D K^-1 dtau_J (paper eq. EOM_link).
        refinement: Steps in a period of the torque loop in which a pad meets the object.
        before: By arm, samples before the start for formulas with memory: time, q, dq and tau_J, ``(m, 1 + 3 n)``; if
            empty, a steady state is assumed.
    """

    physics: Physics
    arms: Mapping[str, ArmState]
    drives: Mapping[str, DriveStart]
    torque: Mapping[str, Array]
    acting: Mapping[str, NDArray[np.int32]]
    time: Array
    period: float
    object: BodyState | None = None
    joint_torque: bool = False
    refinement: int = CONTACT_REFINEMENT
    before: Mapping[str, Array] = field(default_factory=dict)


@dataclass(frozen=True)
class Result:
    """Result of one simulation.

    Attributes:
        arms: Motion of the arms.
        poses: Centre [m] and orientation x y z w of the object in A, without changes of sign, ``(k, 7)``; without an
            object ``(k, 0)``.
        twists: Velocity of its centre and angular velocity in A, ``(k, 6)`` [m/s, rad/s]; without an object ``(k, 0)``.
        neighbours: Poses and twists of its neighbours by name, ``(k, 7)`` and ``(k, 6)``.
        residual: Largest residual of a step's equations, as a velocity of the object [m/s].
        steps: Number of steps.
        contact_steps: Number of steps with a contact.
        iterations: Newton iterations in the steps with a contact.
        fallbacks: Steps with a contact in which Newton's method alone did not converge.
        failed: Times of the steps whose equations were not solved [s]; after the first state that is not finite, all
            states are NaN.
        failure: Reason for an early end of the job; empty: it ran to its end.
    """

    arms: dict[str, ArmMotion]
    poses: Array
    twists: Array
    neighbours: dict[str, tuple[Array, Array]]
    residual: float
    steps: int
    contact_steps: int
    iterations: int
    fallbacks: int
    failed: tuple[float, ...]
    failure: str


def simulate(jobs: Sequence[TwinJob], threads: int = 1) -> list[Result]:
    """Run jobs, each from its start to its last tick.

    Args:
        jobs: The jobs; jobs with the same ``physics`` object share its preparation.
        threads: Largest number of threads.

    Raises:
        InputError: A load of a Python class raises it, or acts between pad and object.
    """
    models: dict[tuple[int, float, bool, int], _kernel.Twin] = {}
    prepared = []
    for job in jobs:
        key = (id(job.physics), job.period, job.joint_torque, job.refinement)
        if key not in models:
            models[key] = kernel_twin(job.physics, job.period, job.joint_torque, job.refinement)
        prepared.append(_prepared(models[key], job))
    return [
        _result(job, *task_result) for job, task_result in zip(jobs, _kernel.run_twins(prepared, threads), strict=True)
    ]


def rests(physics: Physics, state: BodyState) -> bool:
    """Whether the object, and each neighbour beside it, is in stable static equilibrium on its support.

    Conditions: its velocity is zero, gravity lies in the friction cone, and the line of gravity through the centre of
    mass meets the support polygon. Corners within 2 mm of the surface belong to the polygon.
    """
    alone = kernel_twin(replace(physics, arms={}, object_loads=()), period=1.0, joint_torque=False, refinement=1)
    return _kernel.TwinRun(alone, [], box_starts(physics, state)).asleep


def _prepared(model: _kernel.Twin, job: TwinJob) -> _kernel.TwinTask:
    """A job in the form of the kernel."""
    arms = [arm_start(job.arms[name], job.drives[name], job.before.get(name)) for name in job.physics.arms]
    driving = [(job.torque[name], job.acting[name]) for name in job.physics.arms]
    ticks = len(job.time) - 1
    substeps = len(driving[0][1]) // ticks if ticks else 1
    boxes = [] if job.object is None else box_starts(job.physics, job.object)
    return model, arms, boxes, job.time, substeps, driving


def arm_start(state: ArmState, drive: DriveStart, before: Array | None = None) -> _kernel.TwinArmStart:
    """Initial state of an arm in the form of the kernel; ``before`` as in :attr:`TwinJob.before`."""
    earlier = drive.earlier or ((DISTANT_PAST_S, drive.torque),)
    times, values = np.array([time for time, _ in earlier]), np.array([torque for _, torque in earlier])
    samples = np.zeros((0, 1 + 3 * state.position.size)) if before is None else before
    return state.position, state.velocity, drive.torque, drive.torque_rate, times, values, samples


def box_starts(physics: Physics, object_: BodyState) -> list[_kernel.TwinBoxStart]:
    """Initial states of the object and the neighbours that stand beside it, in the form of the kernel."""
    return [(state.position, state.rotation, state.twist) for state in (object_, *standing(physics, object_))]


def motions(physics: Physics, rows: Array) -> tuple[dict[str, ArmMotion], Array]:
    """Split states of the kernel, ``(row,)`` or ``(k, row)``: motion of the arms, and columns of the objects."""
    arms, start = {}, 0
    for name, arm in physics.arms.items():
        n = arm.facts.joint_count
        arms[name] = ArmMotion(*(rows[..., start + i * n : start + (i + 1) * n] for i in range(5)))
        start += 5 * n
    return arms, rows[..., start:]


def _result(
    job: TwinJob,
    rows: Array,
    steps: int,
    contact_steps: int,
    iterations: int,
    fallbacks: int,
    residual: float,
    failed: Sequence[float],
    failure: str,
) -> Result:
    arms, bodies = motions(job.physics, rows)
    (poses, twists), *neighbour_bodies = [(body[:, :7], body[:, 7:]) for body in _bodies(bodies)]
    neighbours = dict(zip((neighbour.name for neighbour in job.physics.neighbours), neighbour_bodies, strict=False))
    return Result(
        arms, poses, twists, neighbours, residual, steps, contact_steps, iterations, fallbacks, tuple(failed), failure
    )


def _bodies(columns: Array) -> list[Array]:
    """Columns of every object; for an absent object, an array without columns."""
    return np.split(columns, range(BOX_COLUMNS, columns.shape[-1], BOX_COLUMNS), axis=-1)


def kernel_twin(physics: Physics, period: float, joint_torque: bool, refinement: int) -> _kernel.Twin:
    """A scene in the form of the kernel; arguments as the attributes of :class:`TwinJob`."""
    arms = [_arm(physics, name, period, joint_torque) for name in physics.arms]
    boxes = (physics.object, *(neighbour.body for neighbour in physics.neighbours))
    support = None
    if physics.support_height is not None:
        half_x, half_y = (extent / 2.0 for extent in physics.support_size)
        support = (physics.support_height, half_x, half_y, physics.support_friction, physics.support_compliance)
    return _kernel.Twin(
        arms,
        [(box.mass, box.size / 2.0, box.inertia, box.com_offset, box.shape.kernel, box.guide) for box in boxes],
        support,
        physics.pad_friction,
        physics.object_friction,
        physics.rolling_arm,
        physics.gravity,
        period,
        refinement,
        _object_formulas(physics),
    )


def _arm(physics: Physics, name: str, period: float, joint_torque: bool) -> _kernel.TwinArm:
    arm = physics.arms[name]
    arm.facts.check_chain("the twin", f"robots.{name}")
    links, tip = _links(arm, physics.gravity)
    pad = arm.end_effector.pad_placement
    springs = [load for load in arm.loads if isinstance(load, Spring)]
    pull, n = None, arm.facts.joint_count
    if springs:
        force = np.sum([spring.pull for spring in springs], axis=0)
        pull = (force, sum(spring.stiffness for spring in springs), arm.impact_position)
    formulas = [formula for load in arm.loads if isinstance(load, FormulaLoad) for formula in _arm_formulas(load, n)]
    python_loads = tuple(load for load in arm.loads if not isinstance(load, (Spring, FormulaLoad)))
    return _kernel.TwinArm(
        links,
        Drive(arm, period),
        arm.motor_inertia_rotor / arm.motor_inertia_reduced,
        arm.torque_gain,
        arm.torque_offset,
        arm.stiffness,
        arm.damping,
        arm.actuation_delay,
        joint_torque,
        (
            tip @ pad.translation,
            tip @ pad.rotation,
            np.array(arm.end_effector.pad_size) / 2.0,
            arm.pad_stiffness,
            arm.pad_damping,
            arm.pad_shear_compliance,
            arm.pad_creep,
            arm.end_effector.shape.kernel,
        ),
        None if arm.tool_spring is None else (arm.tool_spring.motions @ _turned_twists(tip).T, arm.tool_spring.lag),
        pull,
        formulas,
        _call(physics, name, python_loads) if python_loads else None,
    )


def _links(arm: ArmPhysics, gravity: Array) -> tuple[_kernel.Chain, Array]:
    """Links of an arm, with the end effector in the last one; and axes of frame E in axes of the last joint."""
    facts, end_effector = arm.facts, arm.end_effector
    rotations, origins, flange = _kinematics(facts.joints, facts.flange)
    rotations, origins = rotations.copy(), origins.copy()
    origins[0] = arm.base.rotation @ origins[0] + arm.base.translation
    rotations[0] = arm.base.rotation @ rotations[0]
    mass = np.array([link.mass for link in facts.links])
    com = np.array([link.com for link in facts.links])
    inertia = np.array([link.inertia_matrix for link in facts.links])
    tip = flange @ end_effector.mount.rotation
    tip_position = np.array(facts.flange.xyz) + flange @ end_effector.mount.translation
    tool_com = tip_position + tip @ end_effector.com
    total = mass[-1] + end_effector.mass
    com_total = (mass[-1] * com[-1] + end_effector.mass * tool_com) / total
    inertia[-1] += tip @ end_effector.inertia @ tip.T
    inertia[-1] += mass[-1] * _steiner(com[-1] - com_total) + end_effector.mass * _steiner(tool_com - com_total)
    mass[-1], com[-1] = total, com_total
    slides = [joint.type == "prismatic" for joint in facts.joints]
    return _kernel.Chain(rotations, origins, slides, mass, com, inertia, gravity, tip_position), tip


def _turned_twists(rotation: Array) -> Array:
    """Twists about the same point in axes turned by ``rotation``, ``(6, 6)``."""
    return scipy.linalg.block_diag(rotation, rotation)


@functools.lru_cache(maxsize=64)
def _kinematics(joints: tuple[JointOrigin, ...], flange: Flange) -> tuple[Array, Array, Array]:
    """Axes ``(n, 3, 3)`` and origins ``(n, 3)`` of the joints in the link before, and axes of the flange."""
    rotations = np.array([pin.rpy.rpyToMatrix(*joint.rpy) for joint in joints])
    return rotations, np.array([joint.xyz for joint in joints]), flange.rotation


def _steiner(offset: Array) -> Array:
    """Steiner term (parallel-axis theorem) of a unit mass at ``offset``, ``(3, 3)`` [m^2]."""
    return np.asarray(offset @ offset * np.eye(3) - np.outer(offset, offset))


def _call(physics: Physics, name: str, loads: tuple[Load, ...]) -> _kernel.TwinLoad:
    """Torques on links and motors of an arm's loads of Python classes, from the scene's symbols, q, dq and tau_J."""
    for load in loads:
        if load.touches:
            raise InputError(
                f"robots.{name}: the twin has no load between pad and object from a Python class, got "
                f"{type(load).__name__}; expected formulas, contact_normal or contact_tangential"
            )
    physics_with_loads = replace(physics, arms={name: replace(physics.arms[name], loads=loads)})
    model = physics_with_loads.robot_model(name)

    def call(symbols: Array, position: Array, velocity: Array, torque: Array) -> tuple[Array, Array]:
        scene = dict(zip(_kernel.SYMBOLS, symbols.tolist(), strict=True))
        return physics_with_loads.load_torques(name, model, scene["t"], position, velocity, torque, scene)

    return call


def _arm_formulas(load: FormulaLoad, joints: int) -> list[_kernel.TwinFormula]:
    """Formulas of a load on an arm in the form of the kernel."""
    tables: dict[int, Mapping[int, Formula | None]] = dict(enumerate((load.torque, load.motor, load.force)))
    tables |= {ON_PAD: {0: load.pad.get(0)}, ALONG_PAD: {0: load.pad.get(1)}}
    return [
        formula for acts, table in tables.items() for formula in _formulas(load.name, acts, table, load.numbers, joints)
    ]


def _object_formulas(physics: Physics) -> list[_kernel.TwinFormula]:
    """Formulas of the loads on the object in the form of the kernel."""
    formulas: list[_kernel.TwinFormula] = []
    for load in physics.object_loads:
        if not isinstance(load, FormulaObjectLoad):
            raise InputError(f"a load on the object that is no formula is unknown to the twin: {type(load).__name__}")
        tables = {
            ON_OBJECT: {index: load.free.get(index) for index in range(3)},
            TURNING_OBJECT: {index: load.free.get(3 + index) for index in range(3)},
            ON_SUPPORT: {0: load.support.get(0)},
            ALONG_SUPPORT: {0: load.support.get(1)},
        }
        for acts, table in tables.items():
            formulas += _formulas(load.name, acts, table, load.numbers, 0)
    return formulas


def _formulas(
    effect: str, acts: int, table: Mapping[int, Formula | None], numbers: Mapping[str, float], joints: int
) -> list[_kernel.TwinFormula]:
    """Formulas by joint or axis in the form of the kernel: effect, point of action, joint or axis, code, constants."""
    compiled: list[_kernel.TwinFormula] = []
    for index, formula in table.items():
        if formula is not None:
            code, constants = _postfix(formula.text, joints)
            values = [numbers[value] if isinstance(value, str) else value for value in constants]
            compiled.append((effect, acts, index, code, values))
    return compiled


@functools.lru_cache(maxsize=4096)
def _postfix(text: str, joints: int) -> tuple[list[int], list[float | str]]:
    """Code of a formula in postfix order, and its constants: numbers, and names of parameters.

    Args:
        text: The formula.
        joints: Joints of the arm whose symbols it may use.
    """
    code: list[int] = []
    constants: list[float | str] = []

    def put(operation: str, index: int | None = None) -> None:
        code.append(_kernel.OPERATIONS.index(operation))
        if index is not None:
            code.append(index)

    def constant(value: float | str) -> None:
        put("constant", len(constants))
        constants.append(value)

    def visit(node: ast.AST) -> None:
        if isinstance(node, ast.Constant) and isinstance(node.value, (int, float)):
            constant(float(node.value))
        elif isinstance(node, ast.Name):
            symbol(node.id)
        elif isinstance(node, ast.UnaryOp):
            visit(node.operand)
            if isinstance(node.op, ast.USub):
                put("USub")
        elif isinstance(node, ast.BinOp):
            visit(node.left)
            visit(node.right)
            put(type(node.op).__name__)
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            for argument in node.args:
                visit(argument)
            put(LAG_WITH_START if node.func.id == LAG and len(node.args) > 2 else node.func.id)

    def symbol(name: str) -> None:
        joint = JOINT_SYMBOL.fullmatch(name)
        if name == "pi":
            constant(math.pi)
        elif name in _kernel.SYMBOLS:
            put("symbol", _kernel.SYMBOLS.index(name))
        elif joint is not None:
            kind = ("q", "dq", "tau").index(joint[1])
            put("symbol", len(_kernel.SYMBOLS) + kind * joints + int(joint[2]) - 1)
        else:
            constant(name)

    visit(ast.parse(text.strip(), mode="eval").body)
    return code, constants
