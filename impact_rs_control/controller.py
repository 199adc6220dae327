# SPDX-License-Identifier: Apache-2.0
"""Reference-spreading QP control of one or several arms (paper sec. Control approach).

The controller uses measured signals only: q, dq and tau_J of every joint. With M, h, J and dJ/dt dq of the rigid model,
position p, axes R and twist v = J dq of frame E in E[A], one control tick of an arm goes as follows.

**1. Impact** (:mod:`impact_rs_control.detection`). A momentum observer estimates the external wrench. The first arm
that detects an impact ends the ante mode of all arms, at T_imp.

**2. Mode** (paper sec. Interim mode). Weight of the velocity feedback:

    ante: gamma = 1,      interim: gamma = (t - T_imp) / dt_int,      post: gamma = 1

The references are those before the impact in the ante mode, those after it in interim and post mode.

**3. Tasks** (paper eqs. e_pos_ante, e_theta_ante, e_pos_int, e_pos_post). Position (3), orientation (3) and k posture
joints follow their references x_d by feedback and feedforward, with the gain k_p, k_theta or k_q of the task:

    a_fb = gamma 2 sqrt(k) (dx_d - dx) + k e                                           (paper eq. fb_error)
    e_p = p_d - p,      e_theta = R log(R^T R_d),      e_q = q_d - q
    a = ddx_d + a_fb + a_fric + a_f,      a_f = J (M + B_theta)^-1 J^T f_d             (paper eq. a_p_f)

a_fric compensates joint friction, a_f exerts the wrench f_d on the object after the impact; the same torque moves the
posture joints, so a_f has their rows as well. The paper's task error is J ddq + dJ/dt dq - a. Its eq. e_theta_ante has
another sign before k_theta, which would turn the pad away from R_d.

**4. Quadratic program** (:mod:`impact_rs_control.qp`). With S, which picks the posture joints,

    min_ddq ||A ddq - b||_W^2,      A = [J; S; 1],      b = [a_E - dJ/dt dq; a_q; -2 sqrt(k_q) dq]   (paper eq. QP_ante)
    W = diag(w_p, w_p, w_p, w_theta, w_theta, w_theta, w_q, ..., w_idle, ...)
    H = A^T W A + eps 1,      g = -A^T W b

within the limits of position, velocity and torque (paper eqs. const_q, const_dq, const_tau). The last rows of A and b
damp all joints; they exist only for a redundant arm, 6 + k < n.

**5. Torque** (paper eq. eom_ante): tau_d = (M + B_theta) ddq + h. If the QP has failed, because a number is not finite,
the arm is braked from its state (:mod:`impact_rs_control.fallback`); with a state that is not finite, the gravity
torque at the last finite position is commanded.

**6. Measure** (paper eq. a_fb_net): the net feedback is the integral of a_fb from t_1 to t_2.

Steps 1, 3 and 4 are compiled (``src/control.cpp``); ``test/impact_rs_control/test_controller.py`` has the tick in
NumPy and compares both.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from impact_rs_control.detection import ImpactDetector
from impact_rs_control.fallback import holding_torque
from impact_rs_control.plan import ArmPlan, TrialPlan
from impact_rs_control.qp import AccelerationProblem, AccelerationQp, JointLimits, QpStatus
from impact_rs_sim import _kernel
from impact_rs_sim.plant.sensors import ArmMeasurement
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.robots.robot_model import RigidTerms, RobotModel
from impact_rs_sim.scenarios.scenario import Scenario
from impact_rs_sim.scenarios.trial_settings import Gains

IDLE_TASK_WEIGHT = 1e-4  # of standing still over the weight of a task, for joints that no task needs [-]


class Mode(IntEnum):
    """Control modes; values as in ``ControllerState.mode``."""

    ANTE = 0
    INTERIM = 1
    POST = 2


@dataclass(frozen=True)
class ImpactDetection:
    """The moment an impact was detected.

    Attributes:
        time: T_imp [s].
        force: Sudden force against the motion [N].
        threshold: Threshold that it exceeded [N].
        wrench: Estimated external wrench at E, in E[A], ``(6,)`` [N, N m].
        twist: Measured twist of E, in E[A], ``(6,)`` [m/s, rad/s].
    """

    time: float
    force: float
    threshold: float
    wrench: Array
    twist: Array


@dataclass(frozen=True)
class TickObservation:
    """Result of the first half of a control tick.

    Attributes:
        terms: Rigid-body terms at the measured state; they hold until the next tick.
        detection: The impact, in the tick it is detected.
    """

    terms: RigidTerms
    detection: ImpactDetection | None


@dataclass(frozen=True)
class ArmCommand:
    """Command of the controller to one arm in one tick.

    Attributes:
        torque: Desired torque tau_d, ``(n,)`` [N m].
        mode: Control mode.
        gamma: Weight of velocity feedback [-].
        position: Measured position of E in A, ``(3,)`` [m].
        twist: Measured twist of E in E[A], ``(6,)`` [m/s, rad/s].
        task_feedback: Feedback of position and orientation of E and of the posture, ``(6 + k,)`` [m/s^2, rad/s^2].
        net_feedback: Integral of the position feedback from t1 to the present, at most to t2, ``(3,)`` [m/s].
        wrench: Estimated external wrench at E, in E[A], ``(6,)`` [N, N m].
        qp_status: How the QP was solved.
        qp_iterations: ProxQP iterations.
        qp_solve_time: Wall-clock time of the QP [s].
        detection: The impact, in the tick it is detected.
    """

    torque: Array
    mode: Mode
    gamma: float
    position: Array
    twist: Array
    task_feedback: Array
    net_feedback: Array
    wrench: Array
    qp_status: QpStatus
    qp_iterations: int
    qp_solve_time: float
    detection: ImpactDetection | None

    @property
    def feedback(self) -> Array:
        """a_fb of paper eq. fb_error, ``(3,)`` [m/s^2]."""
        return self.task_feedback[:3]


class ArmController:
    """Controller of one arm for one trial.

    Args:
        scenario: Gains, times and detection.
        model: Rigid model of the arm as the controller believes it.
        motor_inertia: Diagonal of B_theta as the controller believes it, ``(n,)`` [kg m^2].
        plan: References and feedforward.
    """

    def __init__(self, scenario: Scenario, model: RobotModel, motor_inertia: Array, plan: ArmPlan) -> None:
        timing, control = scenario.timing, scenario.control
        gains = control.gains
        self._model = model
        self._motor_inertia = motor_inertia
        self._last_finite_position = plan.initial
        self._period = timing.control_period
        self._last_tick = timing.ticks
        # First tick of the measurement window, and the first one after it; a time on a tick is off by rounding.
        self._window = [math.ceil(time / timing.control_period - 1e-6) for time in timing.window]
        self._armed_from = timing.nominal_impact - control.detection.arm_before
        self._interim_ticks = control.interim_duration / timing.control_period
        self._interim_start: int | None = None
        posture_count = len(plan.posture)
        # Without a task of their own redundant joints would drift.
        redundant = 6 + posture_count < model.joint_count
        sizes = (3, 3, posture_count, model.joint_count if redundant else 0)
        weights = (gains.position_weight, gains.orientation_weight, gains.posture_weight, IDLE_TASK_WEIGHT)
        self._weights = np.repeat(weights, sizes)
        self._law = _kernel.TaskLaw(
            motor_inertia,
            plan.posture,
            _phase(plan, gains, after=False),
            _phase(plan, gains, after=True),
            plan.orientation,
            plan.wrench,
            idle_rate=2.0 * math.sqrt(gains.posture),
            idle=redundant,
        )
        limits = JointLimits(model.position_min, model.position_max, model.velocity_max, model.torque_max)
        self._qp = AccelerationQp(limits, timing.control_period)
        self._detector = ImpactDetector(model, control.detection, plan.approach_direction, timing.control_period)
        self._net_feedback = self._last_feedback = np.zeros(3)  # integral, and the integrand at the last tick
        self._watched_tick = self._commanded_tick = -1  # the last ticks
        self.detection: ImpactDetection | None = None

    def watch(self, tick: int, measured: ArmMeasurement) -> TickObservation:
        """First half of a control tick: look for the impact of this arm.

        Args:
            tick: Number of the tick since the start of the trial.
            measured: Measured state of the arm.
        """
        terms = self._model.terms(measured.position, measured.velocity)
        steps = tick - self._watched_tick if self._watched_tick >= 0 else 1
        self._watched_tick = tick
        return TickObservation(terms, self._detect(tick * self._period, measured, terms, steps))

    def begin_interim(self, tick: int) -> None:
        """Leave the ante mode, because some arm has hit. Only the first call has an effect."""
        if self._interim_start is None:
            self._interim_start = tick

    def command(self, tick: int, measured: ArmMeasurement, observation: TickObservation) -> ArmCommand:
        """Second half of a control tick: compute the command.

        Args:
            tick: Number of the tick since the start of the trial.
            measured: Measured state of the arm.
            observation: Result of :meth:`watch` in this tick.
        """
        q, dq, terms = measured.position, measured.velocity, observation.terms
        mode, gamma = self._mode(tick)
        feedback, tasks, targets, inertia = self._law.decide(
            min(tick, self._last_tick), mode is not Mode.ANTE, gamma, q, dq, terms
        )
        solution = self._qp.solve(AccelerationProblem(tasks, targets, self._weights, inertia, terms.bias, q, dq))
        torque = inertia @ solution.acceleration + terms.bias
        if solution.status is QpStatus.FAILED:
            torque = self._brake(q, dq)
        else:
            self._last_finite_position = q
        if solution.status is QpStatus.RELAXED:
            torque = np.clip(torque, -self._model.torque_max, self._model.torque_max)
        self._integrate(tick, feedback[:3])
        return ArmCommand(
            torque=torque,
            mode=mode,
            gamma=gamma,
            position=terms.position.copy(),
            twist=terms.twist,
            task_feedback=feedback,
            net_feedback=self._net_feedback,
            wrench=self._detector.wrench,
            qp_status=solution.status,
            qp_iterations=solution.iterations,
            qp_solve_time=solution.solve_time,
            detection=observation.detection,
        )

    def _integrate(self, tick: int, feedback: Array) -> None:
        """Advance the net feedback to the end of this tick; in missed ticks the last feedback is assumed."""
        start, end = self._window
        missed = min(tick, end) - max(self._commanded_tick + 1, start)
        if missed > 0:
            self._net_feedback = self._net_feedback + missed * self._period * self._last_feedback
        if start <= tick < end:
            self._net_feedback = self._net_feedback + self._period * feedback
        self._commanded_tick, self._last_feedback = tick, feedback.copy()

    def _brake(self, q: Array, dq: Array) -> Array:
        """Fallback torque if the QP failed."""
        if np.isfinite(q).all() and np.isfinite(dq).all():
            return holding_torque(self._model, self._motor_inertia, q, dq)
        return self._model.gravity_torque(self._last_finite_position)

    def _detect(self, now: float, measured: ArmMeasurement, terms: RigidTerms, steps: int) -> ImpactDetection | None:
        hit = self._detector.update(measured.position, measured.velocity, measured.torque, terms, steps)
        if self.detection is not None or not hit or now < self._armed_from:
            return None
        self.detection = ImpactDetection(
            time=now,
            force=self._detector.force,
            threshold=self._detector.threshold,
            wrench=self._detector.wrench,
            twist=terms.twist,
        )
        return self.detection

    def _mode(self, tick: int) -> tuple[Mode, float]:
        if self._interim_start is None:
            return Mode.ANTE, 1.0
        gamma = (tick - self._interim_start) / self._interim_ticks
        return (Mode.INTERIM, gamma) if gamma < 1.0 - 1e-9 else (Mode.POST, 1.0)


def _phase(plan: ArmPlan, gains: Gains, after: bool) -> tuple[Array, Array, Array, Array]:
    """References and gains of one phase, ante or post-impact, as arguments of :class:`impact_rs_sim._kernel.TaskLaw`.

    Returns:
        Position, velocity and acceleration references of the tasks, ``(ticks + 1, 3 + k)``, ``(ticks + 1, 6 + k)`` and
        ``(ticks + 1, 6 + k)``, and their gains, ``(6 + k,)`` [1/s^2].
    """
    position = plan.post_position if after else plan.ante_position
    posture = plan.post_posture if after else plan.ante_posture
    friction = plan.post_friction if after else plan.ante_friction
    orientation = gains.orientation_post if after else gains.orientation
    return (
        np.hstack((position.position, posture.position)),
        np.hstack((position.velocity, plan.rotation.velocity * plan.pad_normal, posture.velocity)),
        np.hstack((position.acceleration, plan.rotation.acceleration * plan.pad_normal, posture.acceleration))
        + friction,
        np.repeat((gains.position, orientation, gains.posture), (3, 3, len(plan.posture))),
    )


class Controller:
    """Controllers of all arms of a trial.

    Args:
        plan: Plan of the trial.
    """

    def __init__(self, plan: TrialPlan) -> None:
        scene = plan.scene
        self.plan = plan
        self.arms = {
            name: ArmController(
                scene.scenario,
                scene.physics.robot_model(name),
                scene.physics.arms[name].motor_inertia_reduced,
                arm,
            )
            for name, arm in plan.arms.items()
        }

    def update(self, tick: int, measured: dict[str, ArmMeasurement]) -> dict[str, ArmCommand]:
        """One control tick; the first impact of any arm ends the ante mode of all (paper sec. Interim mode)."""
        observations = {name: controller.watch(tick, measured[name]) for name, controller in self.arms.items()}
        if any(observation.detection is not None for observation in observations.values()):
            for controller in self.arms.values():
                controller.begin_interim(tick)
        return {
            name: controller.command(tick, measured[name], observations[name]) for name, controller in self.arms.items()
        }


def fallback_command(
    model: RobotModel, motor_inertia: Array, position: Array, velocity: Array, tasks: int
) -> ArmCommand:
    """The holding torque as a command; its QP counts as failed.

    Args:
        model: The arm.
        motor_inertia: B that the torque loop leaves, ``(n,)`` [kg m^2].
        position: q, ``(n,)`` [rad].
        velocity: dq, ``(n,)`` [rad/s].
        tasks: Number of task accelerations that the arm's controller follows.
    """
    terms = model.terms(position, velocity)
    return ArmCommand(
        torque=holding_torque(model, motor_inertia, position, velocity),
        mode=Mode.ANTE,
        gamma=0.0,
        position=terms.position.copy(),
        twist=terms.twist,
        task_feedback=np.zeros(tasks),
        net_feedback=np.zeros(3),
        wrench=np.zeros(6),
        qp_status=QpStatus.FAILED,
        qp_iterations=0,
        qp_solve_time=0.0,
        detection=None,
    )
