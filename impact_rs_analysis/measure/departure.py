# SPDX-License-Identifier: Apache-2.0
"""Separation of object and pad after the hit; predictions of a trial assume lasting contact.

With the pose of the object (p_o, R) and of frame E (p_E, normal n out of the pad), the middle of a box of the sides s
is c from the plane of the pad, and its nearest corner d:

    c(t) = n . (p_o - p_E),        d(t) = c(t) - sum_i |n . R_i| s_i / 2

d is 0 at the hit: its value there is subtracted, so that motion capture and robot need no common origin. A pad that
yields throws a box back at the rate that c grows with at first, as the middle of its face does; over the closing speed
that is the restitution of the hit. Where a box turns on the pad without leaving it, c grows, and d is 0. The nearest
corner of a door may be its hinge: on a hinge or slide both distances are those of the point r that the pad has met,

    c(t) = d(t) = n . (p_o + R r - p_E)
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from impact_rs_sim.robots.robot import Array
from impact_rs_sim.scenarios.scenario import ObjectSpec, Scenario
from impact_rs_trials.bags.reader import ControllerColumns, PoseColumns, TrialBag
from impact_rs_trials.bags.topics import OBJECT_POSE
from impact_rs_trials.spec import recorded_scenario

# After the impact: the pad has released the object, and the controller has hardly changed its speed
SEPARATION_WINDOW_S = (0.005, 0.025)
# A box on a compliant pad moves 2 mm to and fro, and motion capture resolves a millimetre
MAX_CONTACT_DISTANCE_M = 0.005


@dataclass(frozen=True)
class Departure:
    """An object and a pad after the hit.

    Attributes:
        arm: The arm whose pad it is.
        distance: Largest distance from the hit until the net feedback ends [m].
        speed: Rate at which the middle of the object goes away from the pad at first [m/s].
        restitution: The same over the speed with which the pad came [-].
        predicted: Restitution of the prediction [-].
    """

    arm: str
    distance: float
    speed: float
    restitution: float
    predicted: float


@dataclass(frozen=True)
class ObjectLeft:
    """Trials of a set whose object separated from a pad.

    Attributes:
        scenario: Name of the scenario.
        object: Name of the object.
        case: Full name of the case.
        arm: The arm whose pad it left.
        trials: Number of these trials.
        of: Number of trials of the set.
        distance_m: Largest distance of all [m].
        speed_m_s: Median of the speeds at which they part [m/s].
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
        assumed = "that they stay together" if self.predicted == 0.0 else f"a restitution of {self.predicted:g}"
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
    """Separation of object and pads after the hit; empty without a recorded hit or object.

    Args:
        bag: The trial.
        columns: Controller states by arm.
    """
    if not bag.counts.get(OBJECT_POSE):
        return ()
    scenario, pose = recorded_scenario(bag.info.scenario_json, bag.path), bag.poses(OBJECT_POSE)
    found = (_departure(scenario, bag, arm, state, pose) for arm, state in columns.items())
    return tuple(item for item in found if item is not None)


def _departure(
    scenario: Scenario, bag: TrialBag, arm: str, state: ControllerColumns, pose: PoseColumns
) -> Departure | None:
    """Separation of object and pad of one arm."""
    hit = bag.impact_time(arm)
    after = pose.time - hit
    first = (after >= SEPARATION_WINDOW_S[0]) & (after <= SEPARATION_WINDOW_S[1])
    if not math.isfinite(hit) or pose.time[0] > hit or np.count_nonzero(first) < 3:
        return None
    normal = scenario.robots[arm].impact_placement.rotation[:, 2]
    middle, distance = _distances(normal, scenario.object(bag.info.object), pose, state, hit)
    distance = distance - np.interp(hit, pose.time, distance)
    closing = abs(float(normal @ [np.interp(hit, state.time, state.ante_velocity[:, axis]) for axis in range(3)]))
    speed = float(np.polyfit(after[first], middle[first], 1)[0])
    return Departure(
        arm=arm,
        distance=float(distance[(after >= 0.0) & (pose.time <= bag.info.window_end)].max()),
        speed=speed,
        restitution=speed / closing,
        predicted=scenario.contact.restitution,
    )


def _distances(
    normal: Array, spec: ObjectSpec, pose: PoseColumns, state: ControllerColumns, hit: float
) -> tuple[Array, Array]:
    """Distances of the middle and of the nearest point of an object from the plane of a pad, ``(k,)`` [m]."""
    place = np.column_stack([np.interp(pose.time, state.time, state.position[:, axis]) for axis in range(3)])
    rotations = np.array([pin.Quaternion(row / np.linalg.norm(row)).matrix() for row in pose.quaternion])
    if spec.freedom is not None:
        row = int(np.searchsorted(pose.time, hit, side="right")) - 1
        met = rotations[row].T @ (place[row] - pose.position[row])
        at_pad = (pose.position + rotations @ met - place) @ normal
        return at_pad, at_pad
    half = spec.form.support(np.array(spec.size), -np.einsum("i,kij->kj", normal, rotations))
    middle = (pose.position - place) @ normal
    return middle, middle - half


def objects_left(trials: Mapping[tuple[str, str, str], Sequence[Sequence[Departure]]]) -> Iterator[ObjectLeft]:
    """Sets whose object left a pad.

    Args:
        trials: Departures in every trial, by scenario, object and case.
    """
    for (scenario, object_name, case), found in trials.items():
        for arm in dict.fromkeys(item.arm for items in found for item in items):
            own = [item for items in found for item in items if item.arm == arm]
            left = [item for item in own if item.distance > MAX_CONTACT_DISTANCE_M]
            if left:
                yield ObjectLeft(
                    scenario,
                    object_name,
                    case,
                    arm,
                    trials=len(left),
                    of=len(own),
                    distance_m=max(item.distance for item in left),
                    speed_m_s=float(np.median([item.speed for item in left])),
                    restitution=float(np.median([item.restitution for item in left])),
                    predicted=left[0].predicted,
                )
