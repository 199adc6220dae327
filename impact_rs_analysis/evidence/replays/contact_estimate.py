# SPDX-License-Identifier: Apache-2.0
"""Estimates of the tracker's frame, its tracked point and the pad's position from the impacts alone.

At an impact the surfaces of pad and object touch, so their signed distance is 0. The pose of the object at rest is its
reading y, corrected by an effect with parameters v. With the distance d_i at the impact of arm and run i,

    minimise  sum_i (d_i(y_i, v) / s_d)^2 + sum_k ((v_k - nominal_k) / (w s_k))^2

where s_k is the scale of parameter k. The second sum (ridge regression) keeps parameters that the impacts do not
determine, such as a shift along the face, at their nominal values. In units of w s_k the covariance is
(J^T J / f + I)^-1, with the sensitivity J of the first terms and f, their sum of squares over N - p for N impacts and p
parameters, at least 1.

Without such an estimate, a wrong frame may put the pad inside the object at the start of a replay, where sensitivities
are meaningless, or the replay misses the object.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
import scipy

from impact_rs_analysis.evidence.replays.measured_runs import MeasuredRun
from impact_rs_sim.effects import Effect
from impact_rs_sim.impact_map.contacts import contact_pairs
from impact_rs_sim.model import ModelEffect, ParameterValue
from impact_rs_sim.numbers import NORMAL_95
from impact_rs_sim.physics import Physics
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.scene import BodyState

DISTANCE_SD_M = 0.002  # s_d: an impact is detected within some ms, at some 0.3 m/s
PRIOR_SCALES = 5.0  # w: 10 mm of a shift, 25 mrad of a yaw
ONE_JOINT = 1  # these effects have no parameter by joint
SIMULTANEOUS_S = 0.02  # impacts of other arms later than that meet an object that has moved


@dataclass(frozen=True)
class ContactEstimate:
    """An effect with which pads and objects touch at the impacts.

    Attributes:
        effect: The effect.
        values: Its parameters, ``(p,)``.
        deviations: Their standard deviations, ``(p,)``.
    """

    effect: Effect
    values: Array
    deviations: Array

    @property
    def item(self) -> ModelEffect | None:
        """The effect as an entry of a model, with 95 % intervals; None: a parameter is out of its range."""
        parameters = {}
        for scalar, value, deviation in zip(
            self.effect.scalars(ONE_JOINT), self.values.tolist(), self.deviations.tolist(), strict=True
        ):
            if not scalar.lower <= value <= scalar.upper:
                return None
            ci95 = value - NORMAL_95 * deviation, value + NORMAL_95 * deviation
            parameters[scalar.name] = ParameterValue(estimate=value, unit=scalar.unit, ci95=ci95)
        return ModelEffect(name=self.effect.name, parameters=parameters)


def contact_starts(effect: Effect, runs: Sequence[MeasuredRun]) -> list[Array]:
    """Starts of a fit, ``(p,)`` each: parameters of one unit alone, as a shift or a turn, and all together.

    A shift and a turn of the frame move objects in one direction alike, and a descent from a mixture of both may miss
    the optimum.
    """
    units = [scalar.unit for scalar in effect.scalars(ONE_JOINT)]
    kinds = list(dict.fromkeys(units))
    masks = [[unit == kind for unit in units] for kind in kinds] if len(kinds) > 1 else []
    estimates = [contact_estimate(effect, runs, mask) for mask in (*masks, [True] * len(units))]
    return [estimate.values for estimate in estimates if estimate is not None]


def contact_estimate(
    effect: Effect, runs: Iterable[MeasuredRun], free: Sequence[bool] | None = None
) -> ContactEstimate | None:
    """Parameters of an effect with which pads and objects touch at the impacts.

    Args:
        effect: The frame of the tracker, the tracked point, or the position of the pad.
        runs: Runs; runs without an impact or without tracking are not used.
        free: Parameters that are estimated, by index; None: all. The others keep their nominal value.

    Returns:
        The estimate; None if pads and objects touch already with the nominal parameters, or without an impact.
    """
    impacts = [
        (run.setup.physics, run.setup.windows[-1].object, placements)
        for run in runs
        if run.hit and run.setup.bodies and run.signals.object_time.size and (placements := _placements(run))
    ]
    nominal = effect.nominal(ONE_JOINT)
    scales = PRIOR_SCALES * np.array([scalar.scale for scalar in effect.scalars(ONE_JOINT)])
    scales = scales if free is None else scales * np.array(free)

    def distances(vector: Array) -> Array:
        return np.array([distance for impact in impacts for distance in _distances(effect, vector, *impact)])

    before = distances(nominal)
    if not before.size or np.mean(np.square(before)) < DISTANCE_SD_M**2:
        return None

    def residuals(change: Array) -> Array:
        return np.append(distances(nominal + scales * change) / DISTANCE_SD_M, change)

    solution = scipy.optimize.least_squares(residuals, np.zeros_like(nominal))
    residual, jacobian = solution.fun[: before.size], solution.jac[: before.size]
    scatter = max(1.0, float(residual @ residual) / max(1, before.size - int(np.count_nonzero(scales))))
    covariance = np.linalg.inv(jacobian.T @ jacobian / scatter + np.eye(nominal.size))
    return ContactEstimate(effect, nominal + scales * solution.x, scales * np.sqrt(np.diag(covariance)))


def _placements(run: MeasuredRun) -> Mapping[str, pin.SE3]:
    """Frames E in A at the impacts of the arms that meet the object at rest, by arm."""
    first = min(run.impacts.values(), default=0.0)
    joints = run.signals.arms
    return {
        name: run.setup.physics.robot_model(name).placement(
            np.array([np.interp(time, run.signals.time, column) for column in joints[name].position.T])
        )
        for name, time in run.impacts.items()
        if time < first + SIMULTANEOUS_S
    }


def _distances(
    effect: Effect, vector: Array, physics: Physics, reading: BodyState, placements: Mapping[str, pin.SE3]
) -> list[float]:
    """Signed distance of every pad from the object, with the effect [m]."""
    physics = effect.apply_vector(physics, vector)
    position, rotation = physics.tracker.pose_of(reading.position, reading.rotation)
    state = BodyState(position, rotation, np.zeros(6))
    return [pair.separation for pair in contact_pairs(physics, state, placements) if pair.partner in placements]
