"""Features: a trial's signals boiled down to numbers that one effect or another would move.

The same features are taken from the measurement and from the twin; their difference is what diagnosis explains. Torque
enters as a balance that the nominal rigid model would close, so that small differences of the path cancel:

    motor side   b_m = tau_d - tau_J - B_theta ddtheta               friction, offset, gain, delay, motor inertia
    link side    b_l = tau_J - M ddq - h                             payload, tilt, pulling cables, contact
    elasticity   b_e = (theta - q) - tau_J / K                       joint stiffness

each as mean over a time bin, its acceleration part from the change of momentum over the bin. In contact b_l is turned
into the wrench at E.
"""

from __future__ import annotations

import functools
import math

import numpy as np
import pinocchio as pin

from impact_rs_analysis.evidence.cluster import Feature
from impact_rs_analysis.evidence.signals import ArmSignals, Signals
from impact_rs_control.plan import TrialPlan
from impact_rs_sim.physics import ArmPhysics
from impact_rs_sim.robot import Array
from impact_rs_sim.robot_model import RobotModel

EDGE = 6  # ticks averaged at each end of a bin for its momentum change
FREE_BINS, EXCURSION_BINS, PUSH_BINS, ELASTIC_BINS = 6, 16, 4, 4
BEFORE_IMPACT = 0.02  # s, free motion ends this long before the detected impact
ONSET = 0.1  # share of the ante-impact speed that is lost when an impact is said to have begun
JUMP_BEFORE = (-0.020, -0.002)  # s from the detected impact
JUMP_WINDOWS = ((0.0, 0.004), (0.004, 0.010), (0.010, 0.020), (0.020, 0.040), (0.040, 0.080))  # s
OBJECT_WINDOWS = ((0.006, 0.040), (0.040, 0.100))  # s
PUSH_AFTER = 0.15  # s, both bodies move together again
AXES = ("x", "y", "z")


@functools.cache
def layout(arms: tuple[str, ...], joint_count: int, hit: bool) -> tuple[Feature, ...]:
    """What the entries of a feature vector are.

    Args:
        arms: Names of the arms.
        joint_count: Joints per arm.
        hit: Whether the trial hits the object.
    """
    result: list[Feature] = []
    for arm in arms:
        label = f"{arm}." if len(arms) > 1 else ""
        joints = [f"{label}joint{index + 1}" for index in range(joint_count)]
        axes = [f"{label}{axis}" for axis in AXES]

        def add(phase: str, signal: str, names: list[str], bins: int, unit: str, floor: float) -> None:
            result.extend(Feature(phase, signal, name, b, unit, floor) for b in range(bins) for name in names)

        bins = FREE_BINS if hit else EXCURSION_BINS
        add("free", "motor torque balance", joints, bins, "N m", 0.01)
        add("free", "link torque balance", joints, bins, "N m", 0.02)
        add("free", "elastic deflection", joints, ELASTIC_BINS, "rad", 4e-6)
        if not hit:
            continue
        add("impact", "joint velocity jump", joints, 1, "rad/s", 0.004)
        add("impact", "end-effector velocity", axes, len(JUMP_WINDOWS), "m/s", 0.003)
        add("impact", "contact force", axes, len(JUMP_WINDOWS), "N", 1.0)
        add("impact", "end-effector rotation", axes, len(JUMP_WINDOWS), "rad/s", 0.02)
        add("push", "motor torque balance", joints, PUSH_BINS, "N m", 0.01)
        add("push", "contact force", axes, PUSH_BINS, "N", 0.05)
        add("push", "contact moment", axes, PUSH_BINS, "N m", 0.02)
        add("push", "velocity error", axes, PUSH_BINS, "m/s", 0.001)
        add("push", "feedback", axes, PUSH_BINS, "m/s^2", 0.02)
    if hit:
        for number in range(len(OBJECT_WINDOWS)):
            result.extend(Feature("impact", "object velocity", axis, number, "m/s", 0.003) for axis in AXES[:2])
            result.append(Feature("impact", "object rotation", "z", number, "rad/s", 0.05))
        for number in range(PUSH_BINS):
            result.extend(Feature("push", "object velocity", axis, number, "m/s", 0.001) for axis in AXES[:2])
    return tuple(result)


def extract(signals: Signals, plan: TrialPlan, models: dict[str, RobotModel] | None = None) -> Array | None:
    """Feature vector of a trial, as :func:`layout` describes it; None if nothing was hit where something should be.

    Args:
        signals: Measured or simulated.
        plan: Its references.
        models: Nominal rigid models, to reuse.
    """
    scene = plan.scene
    models = models or scene.models
    hit = plan.expects_impact
    parts: list[Array] = []
    impacts = [arm.impact_time for arm in signals.arms.values()]
    if hit and not all(math.isfinite(time) for time in impacts):
        return None
    onsets: list[float] = []
    for name, arm in signals.arms.items():
        parts.append(_arm_features(signals.time, arm, plan, name, models[name], onsets))
    if hit:
        first = min(onsets)
        for window in OBJECT_WINDOWS:
            parts.append(_object_velocity(signals, first + window[0], first + window[1]))
        edges = _push_edges(plan, first)
        for start, end in zip(edges[:-1], edges[1:], strict=True):
            parts.append(_object_velocity(signals, start, end)[:2])
    return np.concatenate(parts)


def _push_edges(plan: TrialPlan, impact: float) -> Array:
    return np.linspace(impact + PUSH_AFTER, plan.scene.scenario.timing.window[1], PUSH_BINS + 1)


def _arm_features(
    time: Array, arm: ArmSignals, plan: TrialPlan, name: str, model: RobotModel, onsets: list[float]
) -> Array:
    """Features of one arm; adds the begin of its impact to ``onsets``."""
    physics = plan.scene.physics.arms[name]
    timing = plan.scene.scenario.timing
    scenario = plan.scene.scenario
    if not plan.expects_impact:
        assert scenario.excursion is not None
        robot = scenario.cases[plan.scene.case_name].robots[name]
        edges = np.linspace(scenario.excursion.begin, scenario.excursion_end(robot), EXCURSION_BINS + 1)
    else:
        start = timing.nominal_impact - timing.approach
        edges = np.linspace(start, arm.impact_time - BEFORE_IMPACT, FREE_BINS + 1)
    dynamics = _Dynamics(time, arm, physics, model)
    motor, link = dynamics.balances(edges)
    parts = [motor.ravel(), link.ravel()]
    deflection = arm.motor_position - arm.position - arm.torque / physics.stiffness
    parts.append(_means(time, deflection, np.linspace(edges[0], edges[-1], ELASTIC_BINS + 1)).ravel())
    if not plan.expects_impact:
        return np.concatenate(parts)
    path = plan.arms[name].post_position
    onset = _onset(time, dynamics.twists[:, :3] @ plan.arms[name].approach_direction, arm.impact_time)
    onsets.append(onset)
    parts += _impact_features(time, onset, arm, dynamics)
    edges = _push_edges(plan, onset)
    motor, link = dynamics.balances(edges)
    wrench = np.array(
        [dynamics.wrench_at(0.5 * (a + b), row) for a, b, row in zip(edges, edges[1:], link, strict=False)]
    )
    velocity = dynamics.twists[:, :3]
    parts += [motor.ravel(), wrench[:, :3].ravel(), wrench[:, 3:].ravel()]
    parts.append(_means(time, velocity - path.velocity[: time.size], edges).ravel())
    parts.append(_means(time, arm.feedback, edges).ravel())
    return np.concatenate(parts)


def _impact_features(time: Array, onset: float, arm: ArmSignals, dynamics: _Dynamics) -> list[Array]:
    """Jump and first 80 ms; windows begin between two ticks, so that an impact a little later changes nothing much."""
    velocity, twist = _Integral(time, arm.velocity), _Integral(time, dynamics.twists)
    before = (onset + JUMP_BEFORE[0], onset + JUMP_BEFORE[1])
    settled = (onset + JUMP_WINDOWS[3][0], onset + JUMP_WINDOWS[3][1])
    jump = velocity.mean(*settled) - velocity.mean(*before)
    baseline = twist.mean(*before)
    linear, force, rotation = [], [], []
    for start, end in JUMP_WINDOWS:
        change = twist.mean(onset + start, onset + end) - baseline
        linear.append(change[:3])
        rotation.append(change[3:])
        edges = (onset + start - 0.003, onset + end)
        force.append(dynamics.wrench_at(0.5 * (edges[0] + edges[1]), dynamics.link_balance(*edges))[:3])
    return [jump, np.concatenate(linear), np.concatenate(force), np.concatenate(rotation)]


def _onset(time: Array, speed: Array, detected: float) -> float:
    """When the end effector had lost ``ONSET`` of its ante-impact speed, between two ticks [s].

    Args:
        time: Ticks, ``(k,)`` [s].
        speed: Velocity along the ante-impact direction, ``(k,)`` [m/s].
        detected: Detected impact [s], taken where no such loss is near.
    """
    level = (1.0 - ONSET) * float(speed[_window(time, detected + JUMP_BEFORE[0], detected - 0.005)].mean())
    rows = _window(time, detected - 0.01, detected + 0.01)
    below = np.nonzero((speed[rows][:-1] >= level) & (speed[rows][1:] < level))[0]
    if below.size == 0:
        return detected
    row = rows.start + int(below[0])
    share = (speed[row] - level) / (speed[row] - speed[row + 1])
    return float(time[row] + share * (time[row + 1] - time[row]))


class _Integral:
    """Means of sampled signals over windows that begin and end between samples.

    Args:
        time: Samples, ``(k,)`` [s].
        values: ``(k, m)``.
    """

    def __init__(self, time: Array, values: Array) -> None:
        self._time, self._values = time, values
        steps = 0.5 * (values[1:] + values[:-1]) * np.diff(time)[:, None]
        self._sums = np.vstack((np.zeros(values.shape[1]), np.cumsum(steps, axis=0)))

    def at(self, moment: float) -> Array:
        """The signal at a moment, ``(m,)``."""
        return _between(self._time, self._values, moment)

    def mean(self, start: float, end: float) -> Array:
        """Mean over a window, ``(m,)``."""
        total = _between(self._time, self._sums, end) - _between(self._time, self._sums, start)
        return np.asarray(total / (end - start))


def _between(time: Array, values: Array, moment: float) -> Array:
    row = int(np.clip(np.searchsorted(time, moment) - 1, 0, time.size - 2))
    share = (moment - time[row]) / (time[row + 1] - time[row])
    return np.asarray((1.0 - share) * values[row] + share * values[row + 1])


class _Dynamics:
    """Rigid-body terms of the nominal model along a measured motion."""

    def __init__(self, time: Array, arm: ArmSignals, physics: ArmPhysics, model: RobotModel) -> None:
        self.time, self.arm, self.physics, self.model = time, arm, physics, model
        count = time.size
        self.momentum = np.zeros_like(arm.position)
        self.known = np.zeros_like(arm.position)
        self.twists = np.zeros((count, 6))
        pinocchio, data = model.pinocchio, model.data
        for row in range(count):
            q, dq = arm.position[row], arm.velocity[row]
            terms = model.terms(q, dq)
            coriolis = pin.computeCoriolisMatrix(pinocchio, data, q, dq)
            self.momentum[row] = terms.mass_matrix @ dq
            self.known[row] = coriolis.T @ dq - (terms.bias - coriolis @ dq)
            self.twists[row] = terms.twist

    def balances(self, edges: Array, edge: int = EDGE) -> tuple[Array, Array]:
        """Motor-side and link-side balance per bin, ``(bins, n)`` each [N m]."""
        time, arm = self.time, self.arm
        motor, link = [], []
        damped = arm.torque + self.physics.damping * (arm.motor_velocity - arm.velocity)
        for start, end in zip(edges[:-1], edges[1:], strict=True):
            first = int(np.searchsorted(time, start - 1e-9))
            last = min(max(int(np.searchsorted(time, end - 1e-9)), first + 2 * edge + 1), time.size - edge - 1)
            head, tail = slice(first, first + edge), slice(last - edge, last)
            # Means over the ends stand at their middles; the torque is averaged between exactly these.
            span = time[tail].mean() - time[head].mean()
            middle = slice(first + edge // 2, last - edge + edge // 2)
            ramp = arm.motor_velocity[tail].mean(axis=0) - arm.motor_velocity[head].mean(axis=0)
            torque = arm.command[middle].mean(axis=0) - damped[middle].mean(axis=0)
            motor.append(torque - self.physics.motor_inertia_reduced * ramp / span)
            change = self.momentum[tail].mean(axis=0) - self.momentum[head].mean(axis=0)
            link.append(damped[middle].mean(axis=0) + self.known[middle].mean(axis=0) - change / span)
        return np.array(motor), np.array(link)

    def link_balance(self, start: float, end: float) -> Array:
        """Link-side balance over a short window that begins and ends between ticks, ``(n,)`` [N m]."""
        arm = self.arm
        damped = arm.torque + self.physics.damping * (arm.motor_velocity - arm.velocity)
        momentum = _Integral(self.time, self.momentum)
        change = (momentum.at(end) - momentum.at(start)) / (end - start)
        return _Integral(self.time, damped + self.known).mean(start, end) - change

    def wrench_at(self, moment: float, balance: Array) -> Array:
        """Wrench of the arm on what it touches that explains a link-side balance, at E in E[A], ``(6,)`` [N, N m]."""
        row = min(int(np.searchsorted(self.time, moment)), self.time.size - 1)
        q = self.arm.position[row]
        jacobian = self.model.jacobian(q)
        mobility = np.linalg.solve(self.model.mass_matrix(q), np.column_stack((jacobian.T, balance)))
        return np.asarray(np.linalg.solve(jacobian @ mobility[:, :6], jacobian @ mobility[:, 6]))


def _window(time: Array, start: float, end: float) -> slice:
    first = int(np.searchsorted(time, start - 1e-9))
    return slice(first, max(first + 1, int(np.searchsorted(time, end - 1e-9))))


def _means(time: Array, values: Array, edges: Array) -> Array:
    return np.array([values[_window(time, a, b)].mean(axis=0) for a, b in zip(edges[:-1], edges[1:], strict=True)])


def _object_velocity(signals: Signals, start: float, end: float) -> Array:
    """Slope of position (x, y) and yaw over a window, ``(3,)`` [m/s, m/s, rad/s]; zero where it is not tracked.

    Between the means over the first and the last third: nearly as sure as a least-squares line, and it does not jump
    when a sample enters the window.
    """
    time = signals.object_time
    if time.size < 2 or np.count_nonzero((time >= start) & (time <= end)) < 2:
        return np.zeros(3)
    pose = _Integral(time, np.column_stack((signals.object_position[:, :2], signals.object_yaw)))
    third = (end - start) / 3.0
    return np.asarray((pose.mean(end - third, end) - pose.mean(start, start + third)) / (2.0 * third))
