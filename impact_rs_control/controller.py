# SPDX-License-Identifier: Apache-2.0
"""Reference-spreading QP control of one or several arms (paper sec. Control approach).

Ante, interim and post mode differ in reference, in the weight gamma of velocity feedback, and in what is fed forward
against joint friction and for the wrench on the object:

    e_p = ddp - ddp_d - gamma 2 sqrt(k_p) (dp_d - dp) - k_p (p_d - p) - a_fric - a_f       (paper eqs. e_pos_*)

Everything here sees measured signals only.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
import pinocchio as pin
import scipy

from impact_rs_control.detection import ImpactDetector
from impact_rs_control.plan import ArmPlan, TrialPlan
from impact_rs_control.qp import AccelerationProblem, AccelerationQp, JointLimits, QpStatus
from impact_rs_sim.robot import Array
from impact_rs_sim.robot_model import RigidTerms, RobotModel
from impact_rs_sim.scenario import Scenario
from impact_rs_sim.sensors import ArmMeasurement

IDLE_WEIGHT = 1e-4  # of standing still, in joints that no task needs, against that of the tasks


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
        threshold: What it had to exceed [N].
        wrench: Estimated external wrench at E, in E[A], ``(6,)`` [N, N m].
        twist: Measured twist of E, in E[A], ``(6,)`` [m/s, rad/s].
    """

    time: float
    force: float
    threshold: float
    wrench: Array
    twist: Array


@dataclass(frozen=True)
class Watched:
    """What the first half of a control tick found.

    Attributes:
        terms: Rigid-body terms at the measured state; they hold until the next tick.
        detection: The impact, in the tick it is detected.
    """

    terms: RigidTerms
    detection: ImpactDetection | None


@dataclass(frozen=True)
class ArmCommand:
    """What the controller decided for one arm in one tick.

    Attributes:
        torque: Desired torque tau_d, ``(n,)`` [N m].
        mode: Control mode.
        gamma: Weight of velocity feedback [-].
        position: Measured position of E in A, ``(3,)`` [m].
        twist: Measured twist of E in E[A], ``(6,)`` [m/s, rad/s].
        task_feedback: Feedback of position and orientation of E and of the posture, ``(6 + k,)`` [m/s^2, rad/s^2].
        net_feedback: Its integral since t1, up to t2, ``(3,)`` [m/s].
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
        self._plan = plan
        self._period = timing.control_period
        self._last_tick = timing.ticks
        self._window = timing.window
        self._armed_from = timing.nominal_impact - control.detection.arm_before
        self._interim_ticks = control.interim_duration / timing.control_period
        self._interim_from: int | None = None
        self._position_gain = gains.position
        self._position_rate = 2.0 * math.sqrt(gains.position)
        self._orientation_gains = (gains.orientation, gains.orientation_post)
        self._posture_gain = gains.posture
        self._posture_rate = 2.0 * math.sqrt(gains.posture)
        held = len(plan.posture)
        # Where joints are left over, nothing but this keeps them from drifting.
        self._idle = model.joint_count if 6 + held < model.joint_count else 0
        weights = (gains.position_weight, gains.orientation_weight, gains.posture_weight, IDLE_WEIGHT)
        self._weights = np.repeat(weights, (3, 3, held, self._idle))
        self._motor_inertia = np.diag(motor_inertia)
        limits = JointLimits(model.position_min, model.position_max, model.velocity_max, model.torque_max)
        self._qp = AccelerationQp(limits, timing.control_period)
        self._detector = ImpactDetector(model, control.detection, plan.approach_direction, timing.control_period)
        self._posture = list(plan.posture)
        self._tasks = np.zeros((self._weights.size, model.joint_count))
        self._tasks[6:] = np.eye(model.joint_count)[[*self._posture, *range(self._idle)]]
        self._targets = np.zeros(self._weights.size)
        self._net = np.zeros(3)
        self.detection: ImpactDetection | None = None

    def watch(self, tick: int, measured: ArmMeasurement) -> Watched:
        """First half of a control tick: look for the impact of this arm.

        Args:
            tick: Number of the tick since the start of the trial.
            measured: Measured state of the arm.
        """
        terms = self._model.terms(measured.position, measured.velocity)
        return Watched(terms, self._detect(tick * self._period, measured, terms))

    def begin_interim(self, tick: int) -> None:
        """Leave the ante mode: some arm has hit; later calls change nothing."""
        if self._interim_from is None:
            self._interim_from = tick

    def command(self, tick: int, measured: ArmMeasurement, watched: Watched) -> ArmCommand:
        """Second half of a control tick: decide; arguments as for :meth:`watch`, and what it answered."""
        now = tick * self._period
        index = min(tick, self._last_tick)
        q, dq = measured.position, measured.velocity
        terms = watched.terms
        mode, gamma = self._mode(tick)
        after = mode is not Mode.ANTE
        plan = self._plan
        position_path = plan.post_position if after else plan.ante_position
        posture_path = plan.post_posture if after else plan.ante_posture
        friction = plan.post_friction if after else plan.ante_friction

        twist = terms.twist
        feedback = np.empty(6 + len(self._posture))
        feedback[:3] = self._position_rate * gamma * (position_path.velocity[index] - twist[:3])
        feedback[:3] += self._position_gain * (position_path.position[index] - terms.position)
        k_theta = self._orientation_gains[int(after)]
        tilt = terms.rotation @ pin.log3(terms.rotation.T @ plan.orientation[index])
        spin = plan.pad_normal * plan.rotation.velocity[index, 0]
        feedback[3:6] = k_theta * tilt + 2.0 * math.sqrt(k_theta) * gamma * (spin - twist[3:])
        held = self._posture
        feedback[6:] = self._posture_rate * gamma * (posture_path.velocity[index] - dq[held])
        feedback[6:] += self._posture_gain * (posture_path.position[index] - q[held])
        everything = self._targets
        targets = everything[: feedback.size]
        targets[:3] = position_path.acceleration[index]
        targets[3:6] = plan.pad_normal * plan.rotation.acceleration[index, 0]
        targets[6:] = posture_path.acceleration[index]
        targets += feedback
        targets += friction[index]
        inertia = terms.mass_matrix + self._motor_inertia
        jacobian = terms.jacobian
        if after:
            push = scipy.linalg.lapack.dposv(inertia, jacobian.T @ plan.wrench[index])[1]
            targets[:6] += jacobian @ push  # paper eq. a_p_f
            targets[6:] += push[held]  # the same torque moves these joints as well: no posture feedback shall fight it
        targets[:6] -= terms.drift
        self._tasks[:6] = jacobian
        if self._idle:
            everything[feedback.size :] = -self._posture_rate * dq
        solution = self._qp.solve(
            AccelerationProblem(self._tasks, everything, self._weights, inertia, terms.bias, q, dq)
        )
        torque = inertia @ solution.acceleration + terms.bias
        if solution.status is not QpStatus.SOLVED:
            torque = np.clip(torque, -self._model.torque_max, self._model.torque_max)
        if self._window[0] <= now < self._window[1]:
            self._net = self._net + self._period * feedback[:3]
        return ArmCommand(
            torque=torque,
            mode=mode,
            gamma=gamma,
            position=terms.position.copy(),
            twist=twist,
            task_feedback=feedback,
            net_feedback=self._net,
            wrench=self._detector.wrench,
            qp_status=solution.status,
            qp_iterations=solution.iterations,
            qp_solve_time=solution.solve_time,
            detection=watched.detection,
        )

    def _detect(self, now: float, measured: ArmMeasurement, terms: RigidTerms) -> ImpactDetection | None:
        hit = self._detector.update(measured.position, measured.velocity, measured.torque, terms)
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
        if self._interim_from is None:
            return Mode.ANTE, 1.0
        gamma = (tick - self._interim_from) / self._interim_ticks
        return (Mode.INTERIM, gamma) if gamma < 1.0 - 1e-9 else (Mode.POST, 1.0)


class Controller:
    """Controllers of all arms of a trial.

    Args:
        plan: What to do.
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
        watched = {name: controller.watch(tick, measured[name]) for name, controller in self.arms.items()}
        if any(one.detection is not None for one in watched.values()):
            for controller in self.arms.values():
                controller.begin_interim(tick)
        return {name: controller.command(tick, measured[name], watched[name]) for name, controller in self.arms.items()}
