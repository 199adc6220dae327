# SPDX-License-Identifier: Apache-2.0
"""Separation of object and pad after the hit; predictions of a trial assume lasting contact.

With the pose of the object (p_o, R) and of frame E (p_E, normal n out of the pad), a box with the sides s has the
distances c of its centre and d of its nearest corner from the plane of the pad [m]:

    c(t) = n . (p_o - p_E),        d(t) = c(t) - sum_i |n . R_i| s_i / 2

d is 0 at the hit: its value there is subtracted, so that motion capture and robot need no common origin. A compliant
pad throws a box back: the initial rate of c is the separation speed, and its ratio to the closing speed is the
restitution of the hit. If a box turns on the pad without leaving it, c grows and d stays 0. The nearest corner of a
door may be its hinge: for an object on a hinge or slide, both distances refer to the contact point r of the hit,

    c(t) = d(t) = n . (p_o + R r - p_E)
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from impact_rs_sim.robots.robot import Array
from impact_rs_sim.scenarios.object_spec import ObjectSpec
from impact_rs_sim.scenarios.scenario import Scenario
from impact_rs_trials.bags.reader import ControllerColumns, PoseColumns, TrialBag
from impact_rs_trials.bags.topics import OBJECT_POSE
from impact_rs_trials.spec import recorded_scenario

# After the impact: the pad has released the object, and the controller has hardly changed its speed
SEPARATION_WINDOW_S = (0.005, 0.025)
# A box on a compliant pad oscillates by 2 mm, and motion capture resolves 1 mm
MAX_CONTACT_DISTANCE_M = 0.005


@dataclass(frozen=True)
class Departure:
    """Separation of an object and a pad after the hit.

    Attributes:
        arm: The arm with the pad.
        distance: Largest distance from the hit until the net feedback ends [m].
        speed: Initial separation speed of the centre of the object [m/s].
        restitution: Separation speed over closing speed [-].
        predicted: Restitution of the prediction [-].
    """

    arm: str
    distance: float
    speed: float
    restitution: float
    predicted: float


@dataclass(frozen=True)
class ObjectDeparture:
    """Trials of a set whose object separated from a pad.

    Attributes:
        scenario: Name of the scenario.
        object: Name of the object.
        case: Full name of the case.
        arm: The arm with the pad.
        trials: Number of trials with a separation.
        of: Number of trials of the set.
        distance_m: Largest distance in these trials [m].
        speed_m_s: Median of the separation speeds [m/s].
        restitution: Median of the restitutions of the hits [-].
        predicted: Restitution of the prediction [-].
    """

    scenario: str
    object: str
    case: str
    arm: str
    trials: int
    of: int
    distance_m: float
    speed_m_s: float
    restitution: float
    predicted: float

    @property
    def words(self) -> str:
        """Text of the observation and of the assumption of the prediction."""
        assumed = "lasting contact" if self.predicted == 0.0 else f"a restitution of {self.predicted:g}"
        return (
            f"the object leaves the pad of {self.arm} in {self.trials} of {self.of} trials: up to "
            f"{1e3 * self.distance_m:.0f} mm until the net feedback ends, at {self.speed_m_s:.2f} m/s at first, "
            f"as with a restitution of {self.restitution:.2f}; the prediction assumes {assumed}. Net feedback measures "
            "the error of a prediction only while the contact lasts"
        )

    def to_json(self) -> dict[str, Any]:
        """One entry of ``object_left``."""
        return asdict(self)


def departures(bag: TrialBag, columns: Mapping[str, ControllerColumns]) -> tuple[Departure, ...]:
    """Separation of object and pads after the hit; empty without an object, or a hit before the net feedback ends.

    Args:
        bag: The trial.
        columns: Controller states by arm.
    """
    if not bag.counts.get(OBJECT_POSE):
        return ()
    scenario, pose = recorded_scenario(bag.info.scenario_json, bag.path), bag.poses(OBJECT_POSE)
    by_arm = (_departure(scenario, bag, arm, controller, pose) for arm, controller in columns.items())
    return tuple(departure for departure in by_arm if departure is not None)


def _departure(
    scenario: Scenario, bag: TrialBag, arm: str, controller: ControllerColumns, pose: PoseColumns
) -> Departure | None:
    """Separation of object and pad of one arm; None without a hit (nan s), or without poses around it."""
    hit = bag.impact_time(arm)
    after = pose.time - hit
    in_window = (after >= SEPARATION_WINDOW_S[0]) & (after <= SEPARATION_WINDOW_S[1])
    until_end = (after >= 0.0) & (pose.time <= bag.info.window_end)
    if pose.time[0] > hit or np.count_nonzero(in_window) < 3 or not until_end.any():
        return None
    normal = scenario.robots[arm].impact_placement.rotation[:, 2]
    centre_distance, nearest_distance = _distances(normal, scenario.object(bag.info.object), pose, controller, hit)
    nearest_distance = nearest_distance - np.interp(hit, pose.time, nearest_distance)
    closing = abs(
        float(normal @ [np.interp(hit, controller.time, controller.ante_velocity[:, axis]) for axis in range(3)])
    )
    speed = float(np.polyfit(after[in_window], centre_distance[in_window], 1)[0])
    return Departure(
        arm=arm,
        distance=float(nearest_distance[until_end].max()),
        speed=speed,
        restitution=speed / closing,
        predicted=scenario.contact.restitution,
    )


def _distances(
    normal: Array, spec: ObjectSpec, pose: PoseColumns, controller: ControllerColumns, hit: float
) -> tuple[Array, Array]:
    """Distances of centre and nearest point of an object from the plane of a pad, ``(k,)`` [m]."""
    tool_position = np.column_stack(
        [np.interp(pose.time, controller.time, controller.position[:, axis]) for axis in range(3)]
    )
    rotations = np.array([pin.Quaternion(row / np.linalg.norm(row)).matrix() for row in pose.quaternion])
    if spec.freedom is not None:
        row = int(np.searchsorted(pose.time, hit, side="right")) - 1
        contact_point = rotations[row].T @ (tool_position[row] - pose.position[row])
        at_pad = (pose.position + rotations @ contact_point - tool_position) @ normal
        return at_pad, at_pad
    half_extent = spec.form.support(np.array(spec.size), -np.einsum("i,kij->kj", normal, rotations))
    centre_distance = (pose.position - tool_position) @ normal
    return centre_distance, centre_distance - half_extent


def object_departures(
    trials: Mapping[tuple[str, str, str], Sequence[Sequence[Departure]]],
) -> Iterator[ObjectDeparture]:
    """Sets whose object left a pad.

    Args:
        trials: Departures in every trial, by scenario, object and case.
    """
    for (scenario, object_name, case), by_trial in trials.items():
        for arm in dict.fromkeys(departure.arm for in_trial in by_trial for departure in in_trial):
            of_arm = [departure for in_trial in by_trial for departure in in_trial if departure.arm == arm]
            departed = [departure for departure in of_arm if departure.distance > MAX_CONTACT_DISTANCE_M]
            if departed:
                yield ObjectDeparture(
                    scenario,
                    object_name,
                    case,
                    arm,
                    trials=len(departed),
                    of=len(of_arm),
                    distance_m=max(departure.distance for departure in departed),
                    speed_m_s=float(np.median([departure.speed for departure in departed])),
                    restitution=float(np.median([departure.restitution for departure in departed])),
                    predicted=departed[0].predicted,
                )
