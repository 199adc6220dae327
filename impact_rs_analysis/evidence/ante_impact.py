"""The question to the impact map that a measured run asks: its state just before the impact."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from impact_rs_analysis.evidence.features import JUMP_BEFORE
from impact_rs_analysis.evidence.measured import MeasuredRun
from impact_rs_sim.impact_map import ImpactProblem
from impact_rs_sim.impact_map.contacts import SUPPORT, meetings
from impact_rs_sim.physics import Physics
from impact_rs_sim.robot import Array
from impact_rs_sim.scene import ArmState


def ante_impact_state(run: MeasuredRun) -> dict[str, ArmState]:
    """Joint states at the begin of the impact, by arm.

    Lines through the samples of the last milliseconds before it, for an arm that accelerates is slower in their middle.
    """
    window, states = run.signals[-1], {}
    for name, arm in run.signals[-1].arms.items():
        onset = run.impacts[name]
        rows = (window.time >= onset + JUMP_BEFORE[0]) & (window.time <= onset + JUMP_BEFORE[1])
        time = window.time[rows] - onset
        states[name] = ArmState(_extrapolated(time, arm.position[rows]), _extrapolated(time, arm.velocity[rows]))
    return states


def obliqueness(run: MeasuredRun) -> float:
    """How far a hit is from face on face along the normal: the largest angle of pad or velocity against it [rad]."""
    physics, thing = run.setup.physics, run.setup.windows[-1].object
    states = ante_impact_state(run)
    models = {name: physics.robot_model(name) for name in states}
    placements = {name: models[name].placement(state.position) for name, state in states.items()}
    angles = []
    for meeting in meetings(physics, thing, placements):
        if meeting.partner == SUPPORT:
            continue
        state, model = states[meeting.partner], models[meeting.partner]
        velocity = model.jacobian(state.position)[:3] @ state.velocity
        face = thing.rotation.T @ meeting.normal
        face = thing.rotation[:, int(np.argmax(np.abs(face)))] * np.sign(face[int(np.argmax(np.abs(face)))])
        for direction in (placements[meeting.partner].rotation[:, 2], velocity / np.linalg.norm(velocity)):
            angles.append(float(np.arctan2(np.linalg.norm(np.cross(direction, face)), direction @ face)))
    return max(angles)


def _extrapolated(time: Array, values: Array) -> Array:
    """A line through samples, at time 0."""
    design = np.column_stack((np.ones_like(time), time))
    return np.asarray(np.linalg.lstsq(design, values, rcond=None)[0][0])


def problem_of(run: MeasuredRun, physics: Physics, motor_inertia: str = "reduced") -> ImpactProblem:
    """What the impact map is asked about a measured run.

    Args:
        run: With an impact.
        physics: What is believed.
        motor_inertia: Motor-inertia model: ``reduced``, ``rotor`` or ``zero``.
    """
    arms = ante_impact_state(run)
    thing = run.setup.windows[-1].object
    placements = {name: physics.robot_model(name).placement(state.position) for name, state in arms.items()}
    shifts = [
        -meeting.separation * meeting.normal
        for meeting in meetings(physics, thing, placements)
        if meeting.partner != SUPPORT
    ]
    # A tracker is some millimetres off, and the pad gives way; at the impact the two touch, whatever it says.
    touching = replace(thing, position=thing.position + np.mean(shifts, axis=0))
    return ImpactProblem(
        physics=physics,
        arms=arms,
        object=touching,
        motor_inertia={name: arm.motor_inertia(motor_inertia) for name, arm in physics.arms.items()},
        restitution=physics.restitution,
    )
