# SPDX-License-Identifier: Apache-2.0
"""Starts of fits of the tracker's frame and tracked point, from the impacts.

At an impact the surfaces of pad and object touch, so their signed distance is 0. The pose of the object at rest is its
reading y, corrected by an effect with parameters v. With the distance d_i at the impact of arm and run i,

    minimise  sum_i (d_i(y_i, v) / s_d)^2 + sum_k ((v_k - nominal_k) / (w s_k))^2

where s_k is the scale of parameter k. The second sum keeps what the impacts do not determine at its nominal value, as a
shift along the face (ridge regression).

Without such a start, a frame that is off by more than the pad moves before the impact puts object and pad into each
other at the start of a replay, and sensitivities there say nothing.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
import pinocchio as pin
import scipy

from impact_rs_analysis.evidence.replays.measured_runs import MeasuredRun
from impact_rs_sim.effects import Effect
from impact_rs_sim.impact_map.contacts import contact_pairs
from impact_rs_sim.physics import Physics
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.scene import BodyState

DISTANCE_SD_M = 0.002  # s_d: an impact is detected within some ms, at some 0.3 m/s
PRIOR_SCALES = 5.0  # w: 10 mm of a shift, 25 mrad of a yaw
ONE_JOINT = 1  # these effects have no parameter of a joint
SIMULTANEOUS_S = 0.02  # impacts of other arms later than that meet an object that has moved


def tracker_start(effect: Effect, runs: Iterable[MeasuredRun]) -> Array | None:
    """Parameters of an effect of the tracker with which pads and objects touch at the impacts, ``(p,)``.

    Args:
        effect: The frame of the tracker, or the tracked point.
        runs: Runs; those without an impact or without tracking say nothing.

    Returns:
        The parameters; None where pads and objects touch as the readings are, or where there is no impact.
    """
    impacts = [
        (run.setup.physics, run.setup.windows[-1].object, placements)
        for run in runs
        if run.hit and run.setup.bodies and run.signals.object_time.size and (placements := _placements(run))
    ]
    nominal = effect.nominal(ONE_JOINT)
    scales = PRIOR_SCALES * np.array([scalar.scale for scalar in effect.scalars(ONE_JOINT)])

    def distances(vector: Array) -> Array:
        return np.array([one for impact in impacts for one in _distances(effect, vector, *impact)])

    before = distances(nominal)
    if not before.size or np.mean(np.square(before)) < DISTANCE_SD_M**2:
        return None

    def residuals(change: Array) -> Array:
        return np.append(distances(nominal + scales * change) / DISTANCE_SD_M, change)

    found = scipy.optimize.least_squares(residuals, np.zeros_like(nominal))
    return np.asarray(nominal + scales * found.x)


def _placements(run: MeasuredRun) -> Mapping[str, pin.SE3]:
    """Frames E in A at the impacts of the arms, of those that meet the object where it was at rest."""
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
    """Signed distance of every pad from the object, whose pose was read with the effect [m]."""
    position, rotation = effect.apply_vector(physics, vector).tracker.pose_of(reading.position, reading.rotation)
    state = BodyState(position, rotation, np.zeros(6))
    return [pair.separation for pair in contact_pairs(physics, state, placements) if pair.partner in placements]
