# SPDX-License-Identifier: Apache-2.0
"""Input of the impact map for a measured run: its state just before the impact."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from impact_rs_analysis.evidence.replays.features import JUMP_BEFORE_S
from impact_rs_analysis.evidence.replays.measured_runs import MeasuredRun
from impact_rs_sim.impact_map import ImpactProblem
from impact_rs_sim.impact_map.contacts import SUPPORT, contact_pairs
from impact_rs_sim.physics import Physics
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_sim.scene import ArmState, BodyState, pad_placements, pad_twists

MAX_ALIGNING_TILT_RAD = 0.2  # a pad tilted further is meant to hit with an edge
WRIST_CORRECTIONS = 3  # Newton iterations; each squares the remaining angle


def ante_impact_state(run: MeasuredRun) -> dict[str, ArmState]:
    """Joint states at the begin of the impact, by arm.

    By linear extrapolation of the last milliseconds before it; their mean would lag behind an accelerating arm.
    """
    window, states = run.windowed[-1], {}
    for name, arm in run.windowed[-1].arms.items():
        onset = run.impacts[name]
        rows = (window.time >= onset + JUMP_BEFORE_S[0]) & (window.time <= onset + JUMP_BEFORE_S[1])
        time = window.time[rows] - onset
        states[name] = ArmState(_extrapolated(time, arm.position[rows]), _extrapolated(time, arm.velocity[rows]))
    return states


def obliqueness(run: MeasuredRun) -> float:
    """Obliqueness of a hit: largest angle of pad normal or velocity to the contact normal [rad]."""
    return obliqueness_of(run.setup.physics, ante_impact_state(run), run.setup.windows[-1].object)


def obliqueness_of(physics: Physics, states: Mapping[str, ArmState], box: BodyState) -> float:
    """As :func:`obliqueness`, for pads in a given ante-impact state."""
    models = physics.robot_models()
    placements, twists = pad_placements(physics, models, states), pad_twists(physics, models, states)
    angles = []
    for meeting in contact_pairs(physics, box, placements):
        if meeting.partner == SUPPORT:
            continue
        pad = placements[meeting.partner] * physics.pads[meeting.partner].end_effector.pad_placement
        face = _nearest_face(box, meeting.normal)
        for direction in (pad.rotation[:, 2], twists[meeting.partner][:3]):  # at rest the second angle is 0
            angles.append(float(np.arctan2(np.linalg.norm(np.cross(direction, face)), direction @ face)))
    return max(angles)


def _nearest_face(box: BodyState, direction: Array) -> Array:
    """Outward axis of the object nearest to a direction, in A, ``(3,)``."""
    along = box.rotation.T @ direction
    axis = int(np.argmax(np.abs(along)))
    return np.asarray(box.rotation[:, axis] * np.sign(along[axis]))


def _extrapolated(time: Array, values: Array) -> Array:
    """Value at time 0 of a least-squares line through samples."""
    design = np.column_stack((np.ones_like(time), time))
    return np.asarray(np.linalg.lstsq(design, values, rcond=None)[0][0])


def problem_of(run: MeasuredRun, physics: Physics, motor_inertia: str = "reduced") -> ImpactProblem:
    """Impact problem of a measured run.

    A tilted soft pad hits with an edge and aligns with the face within milliseconds. The velocity is measured after
    that, and corresponds to a rigid impact of parallel faces. So the wrist is rotated until the faces are parallel;
    joint velocities stay as measured.

    Args:
        run: Run with an impact.
        physics: Physics of the model.
        motor_inertia: Motor-inertia model: ``reduced``, ``rotor`` or ``zero``.
    """
    box = run.setup.windows[-1].object
    models = physics.robot_models()
    arms = {name: _face_on_face(state, models[name], box) for name, state in ante_impact_state(run).items()}
    placements = pad_placements(physics, models, arms)
    shifts = [
        -meeting.separation * meeting.normal
        for meeting in contact_pairs(physics, box, placements)
        if meeting.partner != SUPPORT
    ]
    # Trackers err by millimetres and the pad is soft: the object is shifted until pad and object touch.
    touching = replace(box, position=box.position + np.mean(shifts, axis=0))
    return ImpactProblem(
        physics=physics,
        arms=arms,
        object=touching,
        motor_inertia={name: arm.motor_inertia(motor_inertia) for name, arm in physics.arms.items()},
        restitution=physics.restitution,
        restitution_law=physics.restitution_law,
        measured=True,
    )


def _face_on_face(state: ArmState, model: RobotModel, box: BodyState) -> ArmState:
    """The arm with its pad rotated parallel to the nearest face of the object, if the tilt is small."""
    q, facing = state.position.copy(), model.end_effector.pad_placement.rotation[:, 2]
    for _ in range(WRIST_CORRECTIONS):
        normal = model.placement(q).rotation @ facing
        turn = np.cross(normal, _nearest_face(box, normal))
        if np.linalg.norm(turn) > np.sin(MAX_ALIGNING_TILT_RAD):
            return state
        q = q + np.linalg.pinv(model.jacobian(q)) @ np.concatenate((np.zeros(3), turn))
    return ArmState(q, state.velocity)
