# SPDX-License-Identifier: Apache-2.0
"""A rehearsal: the cell runs a whole trial with a simulated driver, and the margins to all limits are measured.

The code of the cell is the code that runs on a robot: :class:`~impact_rs_trials.cell.arming.Arming`,
:class:`~impact_rs_trials.cell.cell_trial.CellTrial`, :class:`~impact_rs_trials.cell.effort_arms.EffortArms`,
:class:`~impact_rs_trials.cell.watchdog.Watchdog` and the controller, with serialized messages between them. Driver,
wires and time are simulated: time passes event by event, so that a rehearsal is the same on a slow machine, and a state
or a torque is late by exactly the latency of the driver's profile. The middleware, ros2_control and a real-time kernel
are not part of it.

A robot whose external torque or force passes a threshold of its reflexes stops itself: it brakes, takes no more
torques, and publishes no more states if its driver does so (``states_end``).

The watchdog stands between cell and driver, as on the robot. In a second run the cell falls silent just before the hit,
as after ``kill -9``, and the watchdog brakes the arms.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pinocchio as pin

from impact_rs_control.controller import Controller
from impact_rs_control.fallback import holding_torque
from impact_rs_control.plan import TrialPlan
from impact_rs_sim.errors import InputError
from impact_rs_sim.plant.plant import Plant
from impact_rs_sim.plant.sensors import ArmMeasurement
from impact_rs_sim.robots.robot import Array, Reflexes
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.messages import MessageMaker, RosbagsTypes
from impact_rs_trials.bags.streams import StreamMaker
from impact_rs_trials.bags.types import typestore
from impact_rs_trials.cell.arming import Arming, ArmingLimits
from impact_rs_trials.cell.cell_trial import CellTrial, TrialLimits
from impact_rs_trials.cell.driver_profiles import DriverProfile
from impact_rs_trials.cell.effort_arms import MAX_REST_SPEED, EffortArms, arms_of, rest_until
from impact_rs_trials.cell.robot_states import STATES, joint_names
from impact_rs_trials.cell.watchdog import Watchdog
from impact_rs_trials.checked_bound import CheckedBound

DRIVER_CLOCK_START_S = 1_700_000_000  # time of the driver's clock at the start, since 1970
TIME = "builtin_interfaces/msg/Time"
NOISE_DURATION_S = 8.0  # of simulated time, for which the plant draws its noise
CONTROLLER_TIME_S = 0.0003  # computing time for one torque; assumed
WATCHDOG_POLL_S = 0.002
WATCHDOG_HOP_S = 0.0003  # added to the path of a torque; measured by benchmarks/timing/watchdog_hop.py
SILENT_BEFORE_IMPACT_S = 0.02  # from the cell's last torque to the nominal impact
MAX_STOPPING_S = 1.5  # from that silence until the arms rest; as in the test of the watchdog node
MAX_SETTLING_S = 1.0  # until the arms rest after a trial


@dataclass
class Checklist:
    """Result of a rehearsal.

    Attributes:
        driver: Name of the driver's profile.
        log: Lines that the cell would log, and events.
        margins: The checklist.
        unknown: Omitted checks, with reasons.
        blocking: Reasons why the cell cannot run with the released version of this driver.
        stopped: Reason why the robot stopped itself in the trial; empty: it did not.
        failure: Reason why the trial was not armed or ended early; empty: it ran to its end.
    """

    driver: str
    log: list[str] = field(default_factory=list)
    margins: list[CheckedBound] = field(default_factory=list)
    unknown: list[str] = field(default_factory=list)
    blocking: tuple[str, ...] = ()
    stopped: str = ""
    failure: str = ""

    @property
    def objections(self) -> list[str]:
        """Reasons why the trial must not run on the robot."""
        beyond = [bound.name for bound in self.margins if not bound.holds]
        return [
            *self.blocking,
            *([f"the robot stopped itself: {self.stopped}"] if self.stopped else []),
            *([f"the trial failed: {self.failure}"] if self.failure else []),
            *([f"beyond its bound: {', '.join(beyond)}"] if beyond else []),
        ]

    @property
    def passed(self) -> bool:
        """Whether the cell can run with the driver, the trial ran without a stop, and no margin is negative."""
        return not self.objections

    @property
    def verdict(self) -> str:
        """Result of the rehearsal in one line."""
        if not self.passed:
            return f"rehearsal not passed: {'; '.join(self.objections)}. Do not run this on the robot"
        if self.unknown:
            return f"rehearsal passed, but for what was not checked: {'; '.join(self.unknown)}"
        return "rehearsal passed"

    def to_json(self) -> dict[str, object]:
        """The result as JSON."""
        return {
            "driver": self.driver,
            "passed": self.passed,
            "verdict": self.verdict,
            "blocking": list(self.blocking),
            "stopped": self.stopped,
            "failure": self.failure,
            "log": self.log,
            "margins": [bound.to_json() for bound in self.margins],
            "not_checked": self.unknown,
        }


class VirtualTime:
    """Simulated time that advances from event to event; also the clock of the robot's timestamps."""

    known = True

    def __init__(self) -> None:
        self.time = 0.0
        self._events: list[tuple[float, int, Callable[[], None]]] = []
        self._count = 0

    def __call__(self) -> float:
        return self.time

    def now(self) -> int:
        """Time of timestamps [ns]."""
        return DRIVER_CLOCK_START_S * 10**9 + round(1e9 * self.time)

    def steady(self) -> float:
        """Monotonic time for differences [s]."""
        return self.time

    def saw(self, stamp: int) -> None:
        """Nothing to learn: this clock is the driver's."""

    def at(self, when: float, event: Callable[[], None]) -> None:
        """Schedule an event at ``when`` [s]; simultaneous events happen in the order of scheduling."""
        self._count += 1
        heapq.heappush(self._events, (when, self._count, event))

    def pass_until(self, until: float, stop: Callable[[], bool]) -> None:
        """Let events happen until ``until`` [s], or until one of them makes ``stop`` true."""
        while self._events and self._events[0][0] <= until:
            self.time, _, event = heapq.heappop(self._events)
            event()
            if stop():
                return
        self.time = max(self.time, until)


class VirtualInbox:
    """Inbox of the cell: time passes while it waits."""

    def __init__(self, clock: VirtualTime) -> None:
        self._clock = clock
        self.waiting: list[tuple[str, bytes]] = []

    def wait(self, timeout: float) -> None:
        """Wait for a message, ``timeout`` [s] at most."""
        if not self.waiting:
            self._clock.pass_until(self._clock.time + timeout, lambda: bool(self.waiting))

    def take(self) -> Iterator[tuple[str, bytes]]:
        """The messages that have come."""
        while self.waiting:
            yield self.waiting.pop(0)


class VirtualOutbox:
    """Outbox of the cell: the controller behind it answers the states of all arms after ``CONTROLLER_TIME_S``."""

    due = False

    def __init__(self, plan: TrialPlan, clock: VirtualTime, inbox: VirtualInbox) -> None:
        self._controller = Controller(plan)
        self._clock, self._inbox = clock, inbox
        self._streams = {arm: StreamMaker(plan).joint_command(arm) for arm in plan.arms}
        self._arm_of = {topics.joint_states(arm): arm for arm in plan.arms}
        self._gathered: dict[str, ArmMeasurement] = {}
        self.failed = 0

    def begin(self, origin_ns: int) -> None:
        """Tick 0 has this stamp [ns]."""
        for stream in self._streams.values():
            stream.origin_ns = origin_ns

    def now(self, topic: str, tick: int, sample: Any) -> bytes:
        """A state goes to the controller."""
        self._gathered[self._arm_of[topic]] = sample
        if len(self._gathered) == len(self._arm_of):
            gathered, self._gathered = self._gathered, {}
            self._clock.at(self._clock.time + CONTROLLER_TIME_S, lambda: self._answer(tick, gathered))
        return b""

    def _answer(self, tick: int, measured: Mapping[str, ArmMeasurement]) -> None:
        for arm, command in self._controller.update(tick, dict(measured)).items():
            self._inbox.waiting.append((topics.joint_command(arm), self._streams[arm].serialized(tick, command)))

    def repeat(self, topic: str, data: bytes) -> None:
        """Nothing gets lost here."""

    def keep(self, topic: str, tick: int, sample: Any) -> None:
        """No one listens."""

    def later(self, topic: str, message: Any) -> None:
        """No one listens."""

    def flush(self) -> None:
        """Nothing waits."""


class ExternalTorque:
    """External joint torque as a robot estimates it: a momentum observer, as in :mod:`impact_rs_control.detection`.

    Args:
        model: Model of the robot's controller.
        gain: Rate of the filter [1/s].
        period: Between two measurements [s].
    """

    def __init__(self, model: RobotModel, gain: float, period: float) -> None:
        self._model, self._gain, self._period = model, gain, period
        self._passed: Array | None = None
        self.torque = np.zeros(model.joint_count)
        self.force = 0.0

    def update(self, measured: ArmMeasurement) -> None:
        """Take a measurement; ``torque`` ``(n,)`` [N m] and ``force`` [N] are the estimates then."""
        model, q, dq = self._model, measured.position, measured.velocity
        terms = model.terms(q, dq)
        momentum = terms.mass_matrix @ dq
        if self._passed is None:
            self._passed = momentum.copy()
        self.torque = self._gain * (momentum - self._passed)
        coriolis = pin.computeCoriolisMatrix(model.pinocchio, model.data, q, dq)
        drift = measured.torque + coriolis.T @ dq - model.gravity_torque(q) + self.torque
        self._passed = self._passed + self._period * drift
        jacobian = model.jacobian(q)[:3]
        self.force = float(np.linalg.norm(np.linalg.lstsq(jacobian.T, self.torque, rcond=None)[0]))


class StandIn:
    """A driver with effort controllers, and the robot behind it, which Bullet moves.

    The brakes are on until the first torques come; then the robot steps once a period, with the newest torque. If an
    estimate passes a threshold of the reflexes, the robot stops itself: all arms brake with :func:`holding_torque` (the
    robot's own brake is not published), further torques are ignored, and states end if the driver's do.

    Args:
        plan: The trial; the arms begin at its start.
        profile: The driver.
        reflexes: Thresholds of the robot's own reflexes, by arm.
        clock: Its clock.
        seed: Seed of noise and scatter.

    Attributes:
        error: Report of the driver after the robot has stopped itself; empty: it has not.
    """

    def __init__(
        self, plan: TrialPlan, profile: DriverProfile, reflexes: Mapping[str, Reflexes], clock: VirtualTime, seed: int
    ) -> None:
        scene, self.profile, self.clock = plan.scene, profile, clock
        self.models, timing = scene.models, scene.scenario.timing
        self.period = timing.control_period if profile.period is None else profile.period
        long_scenario = scene.scenario.model_copy(
            update={"timing": timing.model_copy(update={"duration": NOISE_DURATION_S, "control_period": self.period})}
        )
        initial = {name: arm.initial for name, arm in plan.arms.items()}
        self.plant = Plant.for_trial(long_scenario, scene.physics, initial, scene.object, seed)
        self.joints = joint_names(
            profile.joints_of(plan.arms), {arm: model.joint_count for arm, model in scene.models.items()}
        )
        self.listeners: list[Callable[[bytes], None]] = []
        self.observers: list[Callable[[], None]] = []
        self.commands: dict[str, Array] = {}
        self.error = ""
        self.reflexes = reflexes
        self._motor_inertia = {arm: physics.motor_inertia_reduced for arm, physics in scene.physics.arms.items()}
        self.external = {
            arm: ExternalTorque(model, reflexes[arm].observer_gain, self.period) for arm, model in self.models.items()
        }
        types = RosbagsTypes().type
        self._joint_state, self._header, self._time = map(types, (topics.JOINT_STATE, "std_msgs/msg/Header", TIME))
        self._applied: dict[str, Array] = {}
        self._next = 0.0
        self.measured: dict[str, ArmMeasurement] = self.plant.measure().arms
        self.rates: dict[str, Array] = {arm: np.zeros(model.joint_count) for arm, model in self.models.items()}
        clock.at(0.0, self._tick)

    @property
    def at_rest(self) -> bool:
        """Whether all joints are slower than ``MAX_REST_SPEED``."""
        return all(np.abs(measured.velocity).max() <= MAX_REST_SPEED for measured in self.measured.values())

    def command(self, arm: str, torque: Array) -> None:
        """Send a torque to the effort controller of an arm; it arrives after the latency."""
        sent = torque.copy()

        def arrives() -> None:
            self.commands[arm] = sent

        self.clock.at(self.clock.time + self.profile.command_latency, arrives)

    def _tick(self) -> None:
        """End a period: the robot has moved with the previous torque, and its state is published."""
        if self.error or len(self._applied) == len(self.models):
            self.plant.step({arm: self._torque(arm) for arm in self.models})
        for arm, torque in self.commands.items() if not self.error else ():
            if arm in self._applied:
                self.rates[arm] = np.abs(torque - self._applied[arm]) / self.period
            self._applied[arm] = torque
        self.measured = self.plant.measure().arms
        for arm, observer in self.external.items():
            observer.update(self.measured[arm])
            self.error = self.error or self._reflex(arm)
        for observe in self.observers:
            observe()
        if not (self.error and self.profile.states_end):
            self._publish()
        self._next += self.period
        self.clock.at(self._next, self._tick)

    def _torque(self, arm: str) -> Array:
        """Torque on an arm ``(n,)`` [N m]: of the driver, or of the robot's own brake."""
        model, measured = self.models[arm], self.measured[arm]
        if self.error:
            return holding_torque(model, self._motor_inertia[arm], measured.position, measured.velocity)
        gravity = model.gravity_torque(measured.position) if self.profile.adds_gravity else 0.0
        return np.asarray(self._applied[arm] + gravity)

    def _reflex(self, arm: str) -> str:
        """Reason why an arm stops itself now; empty: it does not."""
        reflexes, observer, when = self.reflexes[arm], self.external[arm], f"at {self.clock.time:.3f} s"
        if reflexes.external_torque_Nm is not None:
            for joint in np.flatnonzero(np.abs(observer.torque) > np.array(reflexes.external_torque_Nm)):
                unit = self.models[arm].facts.units[joint].effort
                torque, limit = abs(observer.torque[joint]), reflexes.external_torque_Nm[joint]
                return f"{arm}, external torque of joint {joint + 1}: {torque:.4g} {unit}, threshold {limit:g}, {when}"
        if reflexes.external_force_N is not None and observer.force > reflexes.external_force_N:
            return f"{arm}, external force: {observer.force:.4g} N, threshold {reflexes.external_force_N:g}, {when}"
        return ""

    def _publish(self) -> None:
        """Send the states of all joints."""
        measured = [self.measured[arm] for arm in self.joints]
        message = self._joint_state(
            header=self._header(stamp=self._time(*divmod(self.clock.now(), 10**9)), frame_id=""),
            name=[name for names in self.joints.values() for name in names],
            position=np.concatenate([state.position for state in measured]),
            velocity=np.concatenate([state.velocity for state in measured]),
            effort=np.concatenate([state.torque for state in measured]),
        )
        data = bytes(typestore().serialize_cdr(message, topics.JOINT_STATE))
        for listener in self.listeners:
            self.clock.at(self.clock.time + self.profile.state_latency, lambda listener=listener: listener(data))  # type: ignore[misc]


class _Extremes:
    """Largest and smallest values of the stand-in."""

    def __init__(self, stand_in: StandIn) -> None:
        self._robot = stand_in
        self.largest: dict[tuple[str, str], tuple[Array, Array]] = {}
        stand_in.observers.append(self._observe)

    def _observe(self) -> None:
        for arm, measured in self._robot.measured.items():
            model, observer = self._robot.models[arm], self._robot.external[arm]
            distance = np.minimum(measured.position - model.position_min, model.position_max - measured.position)
            for quantity, values in (
                ("torque", np.abs(measured.torque)),
                ("velocity", np.abs(measured.velocity)),
                ("rate", self._robot.rates[arm]),
                ("distance", -distance),
                ("external", np.abs(observer.torque)),
                ("force", np.array([observer.force])),
            ):
                values_so_far, when = self.largest.setdefault(
                    (arm, quantity), (np.full(values.size, -np.inf), np.zeros(values.size))
                )
                higher = values > values_so_far
                values_so_far[higher], when[higher] = values[higher], self._robot.clock.time


def rehearse(
    plan: TrialPlan,
    profile: DriverProfile,
    reflexes: Mapping[str, Reflexes],
    parameters: Mapping[str, Mapping[str, Any]],
    seed: int = 0,
    report: Callable[[str], None] = lambda line: None,
) -> Checklist:
    """Rehearse a trial; a failure of the trial is part of the result.

    Args:
        plan: The trial.
        profile: The driver.
        reflexes: Thresholds of the robot's own reflexes, by arm.
        parameters: Values of all parameters of ``cell`` and ``watchdog``.
        seed: Seed of noise and scatter.
        report: Called with a line about the current step.
    """
    checklist = Checklist(profile.name, blocking=profile.blocking)
    if parameters["cell"]["mocap"]:
        checklist.unknown.append("mocap is true: poses of the object from motion capture are not rehearsed")
    for name, arm in plan.arms.items():
        checklist.log.append(f"{name} starts at [{', '.join(f'{value:.4f}' for value in arm.initial)}]")
    report("arming and trial")
    _rehearse_trial(_Cell(plan, profile, reflexes, seed, parameters), checklist)
    if not parameters["cell"]["watchdog"]:
        checklist.unknown.append("watchdog is false: nothing brakes the arms when the cell dies")
    elif checklist.stopped or not checklist.failure:
        report("the cell dies before the hit")
        _rehearse_death(_Cell(plan, profile, reflexes, seed, parameters), checklist)
    return checklist


class _Cell:
    """Cell and watchdog connected to a stand-in."""

    def __init__(
        self,
        plan: TrialPlan,
        profile: DriverProfile,
        reflexes: Mapping[str, Reflexes],
        seed: int,
        parameters: Mapping[str, Mapping[str, Any]],
    ) -> None:
        self.plan, self.clock = plan, VirtualTime()
        self.robot = StandIn(plan, profile, reflexes, self.clock, seed)
        self.inbox = VirtualInbox(self.clock)
        self.outbox = VirtualOutbox(plan, self.clock, self.inbox)
        self.parameters = parameters["cell"]
        self.arms = self._arms(self._send, self.parameters)
        self.robot.listeners.append(lambda data: self.inbox.waiting.append((STATES, data)))
        self.watchdog = self._watch(parameters["watchdog"]) if self.parameters["watchdog"] else None
        self.alive = True

    def _arms(self, send: Callable[[str, Array], None], parameters: Mapping[str, Any]) -> EffortArms:
        return arms_of(self.plan, parameters.__getitem__, self.clock, send)

    def _send(self, arm: str, torque: Array) -> None:
        if not self.alive:
            return
        if (watchdog := self.watchdog) is None:
            self.robot.command(arm, torque)
            return
        sent = torque.copy()
        self.clock.at(self.clock.time + WATCHDOG_HOP_S, lambda: watchdog.heard(arm, sent, self.clock.steady()))

    def _watch(self, parameters: Mapping[str, Any]) -> Watchdog:
        """A watchdog between the cell and the robot."""
        watchdog = Watchdog(self._arms(self.robot.command, parameters), parameters["command_timeout"])
        self.robot.listeners.append(lambda data: _read(watchdog, data))

        def poll() -> None:
            watchdog.look(self.clock.steady())
            if watchdog.braking:
                watchdog.arms.rest()
            self.clock.at(self.clock.time + WATCHDOG_POLL_S, poll)

        self.clock.at(0.0, poll)
        return watchdog

    def arm(self) -> str:
        """Arm like the node; returns the result in one line.

        Raises:
            InputError: The robot cannot be armed.
        """
        limits = ArmingLimits(self.parameters["start_tolerance"], self.parameters["arm_jitter_limit"])
        arming = Arming(self.plan, self.arms, None, self.inbox, limits, None, self.clock)
        return arming.look() + arming.hold()

    def trial(self) -> CellTrial:
        """A new trial, begun."""
        names = ("state_timeout", "answer_timeout", "late_torque_share", "start_tolerance", "start_delay")
        limits = TrialLimits(**{name: self.parameters[name] for name in names})
        maker = MessageMaker(RosbagsTypes(), self.plan)
        trial = CellTrial(self.plan, maker, self.arms, limits, None, self.inbox, self.outbox, self.clock)
        trial.begin()
        return trial


def _read(watchdog: Watchdog, data: bytes) -> None:
    watchdog.arms.states.read(data)


def _rehearse_trial(cell: _Cell, checklist: Checklist) -> None:
    """Arm, run the trial to its end, and leave it."""
    extremes = _Extremes(cell.robot)
    try:
        checklist.log.append(f"armed: {cell.arm()}")
        trial = cell.trial()
        while not trial.over:
            trial.work(cell.clock.time + 0.1)
        checklist.failure = trial.failure
        if cell.robot.error:
            checklist.log.append(_stopped_words(cell.robot, trial))
        ended = cell.clock.time
        while not cell.arms.held and cell.clock.time < ended + MAX_SETTLING_S:
            rest_until(cell.arms, cell.inbox, cell.clock.time + cell.robot.period, cell.clock)
        if cell.arms.held:
            rest_words = f"the arms rest {cell.clock.time - ended:.2f} s later"
        elif cell.robot.error and cell.robot.at_rest:
            rest_words = "the robot brought the arms to rest, which the cell did not see"
        else:
            rest_words = "the arms did not come to rest"
        checklist.log.append(f"trial over: {trial.failure or trial.end()}; {rest_words}")
        checklist.log.append(f"{cell.arms.limited} torques were spread over several periods, as torque_rate_limit asks")
        _, status = trial.status()
        checklist.margins += [
            CheckedBound("age of a state", cell.arms.states.oldest, cell.parameters["state_timeout"], "s", ""),
            CheckedBound(
                "answer of the controller", float(str(status["slowest_answer [s]"])),
                cell.parameters["answer_timeout"], "s", f"{CONTROLLER_TIME_S:g} s of it assumed for computing",
            ),
        ]  # fmt: skip
        if not cell.robot.error:
            checklist.margins.append(
                CheckedBound("rest after the trial", cell.clock.time - ended, MAX_SETTLING_S, "s", "")
            )
    except InputError as error:
        checklist.failure = str(error)
        checklist.log.append(f"refused: {error}")
    finally:
        checklist.stopped = cell.robot.error
        cell.robot.plant.close()
    _margins(cell.robot, extremes, cell.robot.reflexes, checklist)


def _margins(robot: StandIn, extremes: _Extremes, reflexes: Mapping[str, Reflexes], checklist: Checklist) -> None:
    """Add the margins of all extreme values of the stand-in."""
    for arm, model in robot.models.items():
        units, count = model.facts.units, model.joint_count
        thresholds = reflexes[arm]
        rows: list[tuple[str, str, Array | None, list[str]]] = [
            ("joint torque", "torque", model.torque_max, [unit.effort for unit in units]),
            ("torque rate", "rate", np.full(count, robot.profile.torque_rate), [f"{unit.effort}/s" for unit in units]),
            ("joint velocity", "velocity", model.velocity_max, [unit.velocity for unit in units]),
            (
                "external joint torque", "external",
                None if thresholds.external_torque_Nm is None else np.array(thresholds.external_torque_Nm),
                [unit.effort for unit in units],
            ),
            (
                "external force",
                "force",
                None if thresholds.external_force_N is None else np.array([thresholds.external_force_N]),
                ["N"],
            ),
        ]  # fmt: skip
        for name, quantity, bound, unit in rows:
            if (arm, quantity) not in extremes.largest:
                continue
            values, when = extremes.largest[arm, quantity]
            if bound is None:
                worst = int(np.argmax(values))
                checklist.unknown.append(
                    f"{arm} {name}: up to {values[worst]:.4g} {unit[worst]}, no threshold is known"
                )
                continue
            worst = int(np.argmax(values / bound))
            joint = "" if quantity == "force" else f"joint {worst + 1}, "
            where = f"{joint}at {when[worst]:.3f} s"
            checklist.margins.append(
                CheckedBound(f"{arm} {name}", float(values[worst]), float(bound[worst]), unit[worst], where)
            )
        values, when = extremes.largest.get((arm, "distance"), (np.zeros(0), np.zeros(0)))
        if values.size:
            worst = int(np.argmax(values))
            where = f"joint {worst + 1}, at {when[worst]:.3f} s"
            margin = CheckedBound(
                f"{arm} distance to joint limits", -float(values[worst]), 0.0, units[worst].position, where, True
            )
            checklist.margins.append(margin)


def _stopped_words(robot: StandIn, trial: CellTrial) -> str:
    """Response of the cell to a robot that stopped itself."""
    states = "its states ended" if robot.profile.states_end else "its states went on"
    noticed = "the cell ended the trial" if trial.failure else "the cell did not notice, and led it to the end"
    return f"the robot stopped itself ({robot.error}); {states}; {noticed}"


def _rehearse_death(cell: _Cell, checklist: Checklist) -> None:
    """The cell falls silent before the hit; the watchdog brakes the arms."""
    plan = cell.plan
    try:
        cell.arm()
        trial = cell.trial()
        silent_from = round(1e9 * (plan.scene.scenario.timing.nominal_impact - SILENT_BEFORE_IMPACT_S))
        while not trial.over and trial.now < silent_from:
            trial.work(cell.clock.time + cell.robot.period)
        cell.alive = False
        died = cell.clock.time
        fastest = max(float(np.abs(state.velocity).max()) for state in cell.robot.measured.values())
        rested = died
        while cell.clock.time < died + MAX_STOPPING_S + 0.5:
            cell.inbox.wait(cell.robot.period)
            cell.inbox.waiting.clear()
            if not cell.robot.at_rest:
                rested = cell.clock.time
        reaction = "brakes" if cell.watchdog is not None and cell.watchdog.braking else "does nothing"
        checklist.log.append(
            f"cell silent at {fastest:.2f} rad/s: the watchdog {reaction}; the arms rest after {rested - died:.2f} s"
            + (f"; the robot stopped itself ({cell.robot.error})" if cell.robot.error else "")
        )
        checklist.margins.append(
            CheckedBound("time to stop when the cell dies", rested - died, MAX_STOPPING_S, "s", "by the watchdog")
        )
    except InputError as error:  # a robot that stops itself while it is armed
        checklist.log.append(f"with a watchdog: refused: {error}")
    finally:
        cell.robot.plant.close()
