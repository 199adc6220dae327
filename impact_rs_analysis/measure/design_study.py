# SPDX-License-Identifier: Apache-2.0
"""Design study over robots, poses, motor inertias and pads (outlook of the paper).

Every design is one impact problem: an arm in a random pose hits a free box squarely with its pad, at the same
ante-impact speed along the pad's normal n, with the least-norm joint velocity. The impact map gives

    impulse        n^T m (v_c^+ - v_c^-)                        of the object, v_c of its centre of mass [N s]
    joint jump     max_i |dq_i^+ - dq_i^-| / dq_i,max           over the limit of the joint's velocity [-]
    sensitivity    (v^+(1.05 B) - v^+(0.95 B)) / (0.1 v^+)     of the object's velocity v^+ to motor inertia [-]

Intervals follow from draws from the uncertainties of a scenario (:mod:`impact_rs_sim.impact_map.uncertainty`): the
value of the nominal design, and Student's t times the deviation of the draws' logarithms. A motor inertia that is
assumed, for example scaled from another arm, is drawn from zero to three times the number. Every draw ranks all designs
once, with the same object and the same setup errors, which are common to all designs; the interval of a rank is the
spread of these ranks.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from impact_rs_sim.assumed_drive import assumed_drive, assumed_numbers
from impact_rs_sim.errors import InputError
from impact_rs_sim.impact_map import DEFAULT_ENGINE, ENGINES, Engine, ImpactMapError, ImpactProblem
from impact_rs_sim.impact_map.derivatives import change
from impact_rs_sim.impact_map.uncertainty import answer_of, draw, sources_of, touching_pads
from impact_rs_sim.numbers import CONFIDENCE_LEVEL
from impact_rs_sim.physics import JointFriction, Physics
from impact_rs_sim.robots.robot import Array, EndEffector, load_facts
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_sim.scenarios.robot_spec import DriveSettings
from impact_rs_sim.scenarios.scenario import Scenario
from impact_rs_sim.scenarios.trial_settings import ASSUMED_MOTOR_INERTIA, Uncertainties
from impact_rs_sim.scene import ArmState, BodyState
from impact_rs_trials.scenario_draft import NORMAL, upright_poses
from impact_rs_trials.workers import Map

ROBOTS = ("franka_fer", "franka_fr3", "kinova_gen3", "kuka_iiwa7", "ur5e", "ur10e")
MOTOR_INERTIAS = ("reduced", "rotor")
MOTOR_INERTIA_STEP = 0.05  # of B, relative
ARM_NAME = "arm"
MAX_TRIES_PER_POSE = 60  # random positions


@dataclass(frozen=True)
class PadDesign:
    """A pad.

    Attributes:
        size: Width, height and thickness [m].
        friction: Coulomb coefficient between pad and object [-].
        restitution: Restitution of the impact [-].
    """

    size: tuple[float, float, float]
    friction: float
    restitution: float


PADS = {
    "wide": PadDesign((0.10, 0.10, 0.02), 0.5, 0.0),
    "narrow": PadDesign((0.05, 0.10, 0.02), 0.5, 0.0),
    "bouncy": PadDesign((0.10, 0.10, 0.02), 0.5, 0.3),
}


@dataclass(frozen=True)
class Measure:
    """A measure by which designs are ranked.

    Attributes:
        label: Its name in words.
        unit: Its unit.
    """

    label: str
    unit: str


MEASURES = {
    "impulse": Measure("impulse on the object", "N s"),
    "joint_jump": Measure("largest joint jump over the joint's velocity limit", "-"),
    "sensitivity": Measure("sensitivity of the object's velocity to motor inertia", "-"),
}


@dataclass(frozen=True)
class Estimate:
    """A value with its interval.

    Attributes:
        value: Value of the nominal design.
        low: Lower end at ``CONFIDENCE_LEVEL``.
        high: Upper end.
        draws: Values of the draws; nan for a draw without an answer.
    """

    value: float
    low: float
    high: float
    draws: tuple[float, ...]


@dataclass(frozen=True)
class Design:
    """One design with its answers.

    Attributes:
        robot: Name of the robot.
        pose: Number of the pose of this robot.
        position: Joint positions, base to tip [rad], prismatic [m].
        motor_inertia: ``reduced`` or ``rotor``; an arm without torque loop has ``rotor`` alone.
        pad: Name of the pad.
        measures: By name, as in :data:`MEASURES`.
    """

    robot: str
    pose: int
    position: tuple[float, ...]
    motor_inertia: str
    pad: str
    measures: Mapping[str, Estimate]

    @property
    def name(self) -> str:
        """Short name."""
        return f"{self.robot}/{self.pose}/{self.motor_inertia}/{self.pad}"


@dataclass(frozen=True)
class DesignConditions:
    """Conditions common to all designs.

    Attributes:
        scenario: Its end effector, object and uncertainties.
        object_name: Object that is hit.
        speed: Ante-impact speed of the pad [m/s].
        motor_inertias: Names of motor inertias.
        pads: Names of pads.
        draws: Number of draws from the uncertainties.
        seed: Seed of poses and draws.
    """

    scenario: Scenario
    object_name: str
    speed: float = 0.5
    motor_inertias: tuple[str, ...] = MOTOR_INERTIAS
    pads: tuple[str, ...] = tuple(PADS)
    draws: int = 20
    seed: int = 0


@dataclass(frozen=True)
class RobotPose:
    """A pose of a robot.

    Attributes:
        robot: Its name.
        number: Number of the pose.
        position: q, ``(n,)`` [rad].
    """

    robot: str
    number: int
    position: Array


@dataclass(frozen=True)
class DesignStudy:
    """All designs.

    Attributes:
        conditions: The common conditions.
        designs: With answers, in the order of robots and poses.
        failed: Reason by name of the design, where the map has no answer.
        tries: Number of random positions that were tried, by robot.
    """

    conditions: DesignConditions
    designs: tuple[Design, ...]
    failed: Mapping[str, str]
    tries: Mapping[str, int]

    def ranked(self, measure: str) -> list[tuple[Design, int, int]]:
        """Designs by falling value, with best and worst rank: the interval over the draws at ``CONFIDENCE_LEVEL``."""
        estimates = [design.measures[measure] for design in self.designs]
        values = np.array([estimate.value for estimate in estimates])
        draws = np.array([estimate.draws for estimate in estimates])
        drawn_values = np.where(np.isnan(draws), values[:, None], draws)
        ranks = scipy.stats.rankdata(-drawn_values, method="min", axis=0)
        levels = ((1.0 - CONFIDENCE_LEVEL) / 2.0, (1.0 + CONFIDENCE_LEVEL) / 2.0)
        best, worst = np.quantile(ranks, levels, axis=1, method="nearest").astype(int)
        order = np.argsort(-values, kind="stable")
        return [(self.designs[index], int(best[index]), int(worst[index])) for index in order]


def study_designs(
    conditions: DesignConditions,
    robots: Sequence[str] = ROBOTS,
    poses: int = 100,
    map_tasks: Map = map,
    report: Callable[[str, int, int], None] = lambda *_: None,
) -> DesignStudy:
    """Evaluate every robot in every pose.

    Args:
        conditions: The common conditions.
        robots: Names of robots, or paths of their facts.
        poses: Random poses per robot.
        map_tasks: Parallel map.
        report: Called with (what, done, total).

    Raises:
        InputError: No such robot or object, too few poses that the robot reaches fast enough, or no design with an
            answer.
    """
    conditions.scenario.object(conditions.object_name)
    all_robot_poses: list[RobotPose] = []
    tries = {}
    pose_tasks = [(robot, conditions, poses) for robot in robots]
    for number, (robot, (robot_poses, tried)) in enumerate(
        zip(robots, map_tasks(_random_poses_of, pose_tasks), strict=True), start=1
    ):
        tries[robot] = tried
        all_robot_poses += robot_poses
        report("poses", number, len(robots))
    designs: list[Design] = []
    failed: dict[str, str] = {}
    tasks = [(conditions, robot_pose) for robot_pose in all_robot_poses]
    for done, (answers, robot_failed) in enumerate(map_tasks(evaluate, tasks), start=1):
        designs += answers
        failed |= robot_failed
        report("designs", done * len(conditions.pads), len(tasks) * len(conditions.pads))
    if not designs:
        without_loop = "no joint torque loop, so no reduced motor inertia; give --motor-inertia rotor"
        name, reason = next(iter(failed.items()), (", ".join(robots), without_loop))
        raise InputError(f"no design has an answer; {name}: {reason}")
    return DesignStudy(conditions, tuple(designs), failed, tries)


def random_poses(robot: str, conditions: DesignConditions, poses: int) -> tuple[list[RobotPose], int]:
    """Random poses in which a robot reaches the speed, and the number of positions that were tried.

    Raises:
        InputError: No such robot, it has fewer than six joints, or too few of its poses are fast enough.
    """
    facts = load_facts(robot)
    if facts.joint_count < 6:
        raise InputError(f"{robot} has {facts.joint_count} joints; a pad that is held upright needs six")
    model = RobotModel(facts, replace(_effector(conditions, "wide"), mount_yaw=0.0))
    fast_poses: list[RobotPose] = []
    for tries, pose in enumerate(upright_poses(model, conditions.seed), start=1):
        if pose is not None and np.all(np.abs(_velocity(model, pose.q, conditions.speed)) <= model.velocity_max):
            fast_poses.append(RobotPose(robot, len(fast_poses) + 1, pose.q))
        if len(fast_poses) == poses:
            return fast_poses, tries
        if tries >= MAX_TRIES_PER_POSE * poses:
            break
    raise InputError(
        f"{robot} reaches {conditions.speed:g} m/s in {len(fast_poses)} of {tries} random positions, expected {poses}; "
        "give a lower --speed or fewer --poses"
    )


def _random_poses_of(task: tuple[str, DesignConditions, int]) -> tuple[list[RobotPose], int]:
    """:func:`random_poses`, for a parallel map."""
    return random_poses(*task)


def evaluate(task: tuple[DesignConditions, RobotPose]) -> tuple[list[Design], dict[str, str]]:
    """All designs of one robot in one pose, and the reasons for designs without an answer, by name."""
    conditions, robot_pose = task
    designs, failed = [], {}
    for motor_inertia, pad, problem in problems_of(conditions, robot_pose):
        name = f"{robot_pose.robot}/{robot_pose.number}/{motor_inertia}/{pad}"
        try:
            measures = _measured(problem, conditions, uncertainties_of(conditions, robot_pose.robot, motor_inertia))
        except (InputError, ImpactMapError) as error:
            failed[name] = str(error)
            continue
        position = tuple(robot_pose.position.tolist())
        designs.append(Design(robot_pose.robot, robot_pose.number, position, motor_inertia, pad, measures))
    return designs, failed


def problems_of(conditions: DesignConditions, robot_pose: RobotPose) -> Iterator[tuple[str, str, ImpactProblem]]:
    """Motor inertia, pad and impact problem of every design of one robot in one pose."""
    facts = load_facts(robot_pose.robot)
    template = Physics.nominal(conditions.scenario, conditions.object_name)
    template_arm = next(iter(template.arms.values()))
    for pad_name in conditions.pads:
        pad, effector = PADS[pad_name], replace(_effector(conditions, pad_name), mount_yaw=0.0)
        drive = _drive(conditions, robot_pose.robot, effector)
        rotor = np.array(drive["motor_inertia_rotor"])
        reduced = np.array(drive.get("motor_inertia_reduced", drive["motor_inertia_rotor"]))
        model = RobotModel(facts, effector)
        placement = model.placement(robot_pose.position)
        arm_design = replace(
            template_arm,
            facts=facts,
            base=model.base,
            end_effector=effector,
            motor_inertia_rotor=rotor,
            motor_inertia_reduced=reduced,
            stiffness=np.array(drive["stiffness"]),
            damping=np.array(drive["damping"]),
            friction=JointFriction.none(facts.joint_types),
            torque_offset=np.zeros(facts.joint_count),
            torque_gain=np.ones(facts.joint_count),
            impact_position=placement.translation,
        )
        physics = replace(
            template,
            arms={ARM_NAME: arm_design},
            support_height=None,
            pad_friction=pad.friction,
            restitution=pad.restitution,
        )
        object_centre = placement.translation + NORMAL * (0.5 * float(np.abs(NORMAL) @ template.object.size))
        state = ArmState(robot_pose.position, _velocity(model, robot_pose.position, conditions.speed))
        for motor_inertia in conditions.motor_inertias:
            if motor_inertia == "reduced" and not facts.joint_torque_loop:
                continue
            yield (
                motor_inertia,
                pad_name,
                ImpactProblem(
                    physics=physics,
                    arms={ARM_NAME: state},
                    object=BodyState(object_centre, np.eye(3), np.zeros(6)),
                    motor_inertia={ARM_NAME: arm_design.motor_inertia(motor_inertia)},
                    restitution=pad.restitution,
                ),
            )


def values_by(engine_name: str, problem: ImpactProblem) -> dict[str, float]:
    """The measures of one problem without uncertainties, by an engine of the impact map.

    Args:
        engine_name: ``exact`` or ``bullet``.
        problem: The problem.

    Raises:
        InputError: The problem is refused.
        ImpactMapError: It has no answer.
    """
    engine: Engine = ENGINES[engine_name](problem.physics)

    def solve(scale: float) -> Array:
        motors = {name: scale * values for name, values in problem.motor_inertia.items()}
        answer = engine.solve(replace(problem, motor_inertia=motors))
        return np.concatenate((*answer.joint_velocity.values(), answer.object_twist))

    try:
        return _values(problem, *(solve(scale) for scale in (1.0, 1.0 + MOTOR_INERTIA_STEP, 1.0 - MOTOR_INERTIA_STEP)))
    finally:
        engine.close()


def uncertainties_of(conditions: DesignConditions, robot: str, motor_inertia: str) -> Uncertainties:
    """Uncertainties of a scenario; an assumed motor inertia is uncertain from zero to three times the number.

    Args:
        conditions: The common conditions.
        robot: Name of the robot, or path of its facts.
        motor_inertia: ``reduced`` or ``rotor``.
    """
    stated, scenario_drive = conditions.scenario.uncertainty, _in_scenario(conditions, robot)
    assumed = assumed_numbers(load_facts(robot)) if scenario_drive is None else scenario_drive.assumed
    if f"motor_inertia_{motor_inertia}" not in assumed:
        return stated
    return stated.model_copy(update={"motor_inertia": max(stated.motor_inertia, ASSUMED_MOTOR_INERTIA)})


def _measured(
    problem: ImpactProblem, conditions: DesignConditions, uncertainties: Uncertainties
) -> dict[str, Estimate]:
    """The measures of a problem with their intervals."""
    models = problem.physics.robot_models()
    nominal = values_by(DEFAULT_ENGINE, problem)
    sources, pads = sources_of(problem, uncertainties), touching_pads(problem, models)
    drawn_values = np.full((conditions.draws, len(nominal)), np.nan)
    for number in range(conditions.draws):
        changes: dict[str, float] = {}
        # A random generator per source, so that designs with more joints draw the same object.
        for index, source in enumerate(sources):
            for name, amount in draw((source,), np.random.default_rng((conditions.seed, number, index))).items():
                changes[name] = changes.get(name, 0.0) + amount
        try:
            drawn_values[number] = list(_drawn(problem, models, pads, changes).values())
        except ImpactMapError:
            continue
    valid = drawn_values[~np.isnan(drawn_values[:, 0])]
    if len(valid) < 2:
        raise ImpactMapError(f"{len(valid)} of {conditions.draws} draws have an answer, expected two or more")
    return {
        name: _estimate(value, valid_draws, tuple(column))
        for (name, value), valid_draws, column in zip(nominal.items(), valid.T, drawn_values.T.tolist(), strict=True)
    }


def _estimate(value: float, valid_draws: Array, draws: tuple[float, ...]) -> Estimate:
    """Interval by Student's t times the standard deviation of the draws, or of their logarithms if all are > 0."""
    quantile = float(scipy.stats.t.ppf(0.5 + CONFIDENCE_LEVEL / 2.0, valid_draws.size - 1))
    if value > 0.0 and np.all(valid_draws > 0.0):
        factor = float(np.exp(quantile * np.std(np.log(valid_draws), ddof=1)))
        return Estimate(value, value / factor, value * factor, draws)
    half_width = quantile * float(np.std(valid_draws, ddof=1))
    return Estimate(value, value - half_width, value + half_width, draws)


def _drawn(
    problem: ImpactProblem, models: Mapping[str, RobotModel], pads: frozenset[str], changes: dict[str, float]
) -> dict[str, float]:
    """The measures with parameters changed."""
    motors = problem.motor_inertia[ARM_NAME]
    names = [f"{ARM_NAME}.motor_inertia.{joint + 1}" for joint in range(motors.size)]

    def solve(step: float) -> Array:
        scaled = {
            name: changes.get(name, 0.0) + step * (float(value) + changes.get(name, 0.0))
            for name, value in zip(names, motors, strict=True)
        }
        velocities, _ = answer_of(problem, models, {**changes, **scaled}, pads)
        return np.concatenate((velocities[: motors.size], velocities[-6:]))

    more, less = solve(MOTOR_INERTIA_STEP), solve(-MOTOR_INERTIA_STEP)
    return _values(change(problem, changes).problem, 0.5 * (more + less), more, less)


def _values(problem: ImpactProblem, nominal: Array, increased: Array, decreased: Array) -> dict[str, float]:
    """The measures from velocities of joints and object, ``(n + 6,)``, with B, with increased and with decreased B."""
    state, body = problem.arms[ARM_NAME], problem.physics.object
    com_offset = problem.object.rotation @ body.com_offset

    def speed(velocities: Array) -> float:
        return float(NORMAL @ (velocities[-6:-3] + np.cross(velocities[-3:], com_offset)))

    limits = np.array(problem.physics.arms[ARM_NAME].facts.limits.velocity_rad_s)
    return {
        "impulse": body.mass * speed(nominal),
        "joint_jump": float(np.max(np.abs(nominal[:-6] - state.velocity) / limits)),
        "sensitivity": (speed(increased) - speed(decreased)) / (2.0 * MOTOR_INERTIA_STEP * speed(nominal)),
    }


def _in_scenario(conditions: DesignConditions, robot: str) -> DriveSettings | None:
    """Drive of a robot in the scenario; None if the scenario does not have the robot."""
    return next(
        (candidate.drive for candidate in conditions.scenario.robots.values() if candidate.facts == robot), None
    )


def _drive(conditions: DesignConditions, robot: str, effector: EndEffector) -> dict[str, list[float]]:
    """The drive of a robot: from the scenario, as published, or scaled from another robot."""
    scenario_drive = _in_scenario(conditions, robot)
    if scenario_drive is None:
        return _scaled_drive(robot, effector, conditions.scenario.timing.drive_period)
    parameters = {
        "motor_inertia_rotor": scenario_drive.motor_inertia_rotor,
        "motor_inertia_reduced": scenario_drive.motor_inertia_reduced or scenario_drive.motor_inertia_rotor,
        "stiffness": scenario_drive.stiffness,
        "damping": scenario_drive.damping,
    }
    return {name: list(values) for name, values in parameters.items()}


@functools.lru_cache(maxsize=64)
def _scaled_drive(robot: str, effector: EndEffector, period: float) -> dict[str, list[float]]:
    """The drive of a robot as published, or scaled from another robot."""
    return assumed_drive(load_facts(robot), effector, period)


def _velocity(model: RobotModel, q: Array, speed: float) -> Array:
    """Least-norm joint velocity for a pad velocity along its normal without rotation, ``(n,)`` [rad/s]."""
    return np.asarray(np.linalg.pinv(model.jacobian(q)) @ np.append(speed * NORMAL, np.zeros(3)))


def _effector(conditions: DesignConditions, pad: str) -> EndEffector:
    """The end effector of the scenario's first arm with another pad."""
    robot = next(iter(conditions.scenario.robots.values()))
    return replace(robot.end_effector.build(), pad_size=PADS[pad].size)
