# SPDX-License-Identifier: Apache-2.0
"""A verdict must not depend on the unit of mass: the same motion of a robot whose masses and torques are larger."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from impact_rs_analysis.diagnosis.candidate import Candidate, linearise
from impact_rs_analysis.evidence.measured_runs import MeasuredRun, Runs
from impact_rs_analysis.evidence.replay_cache import ReplayCache
from impact_rs_analysis.evidence.replays import ReplaySource
from impact_rs_analysis.evidence.simulated_trials import simulated
from impact_rs_sim.effects import library
from impact_rs_sim.model import load_model
from impact_rs_sim.physics import ArmPhysics, Physics
from impact_rs_sim.proportion import Proportion
from impact_rs_trials.runs import Run

from .conftest import HIT, with_arms, with_friction, with_signals

HEAVIER = 1.3


def heavier_arm(arm: ArmPhysics) -> ArmPhysics:
    links = tuple(
        link.model_copy(
            update={"mass": HEAVIER * link.mass, "inertia": tuple(HEAVIER * value for value in link.inertia)}
        )
        for link in arm.facts.links
    )
    tool = arm.end_effector
    assert arm.pad_stiffness is not None
    return replace(
        arm,
        facts=arm.facts.model_copy(update={"links": links}),
        end_effector=replace(tool, mass=HEAVIER * tool.mass, inertia=HEAVIER * tool.inertia),
        motor_inertia_rotor=HEAVIER * arm.motor_inertia_rotor,
        motor_inertia_reduced=HEAVIER * arm.motor_inertia_reduced,
        stiffness=HEAVIER * arm.stiffness,
        damping=HEAVIER * arm.damping,
        pad_stiffness=HEAVIER * arm.pad_stiffness,
        pad_damping=HEAVIER * arm.pad_damping,
    )


def heavier_scene(physics: Physics) -> Physics:
    box = physics.object
    return replace(
        with_arms(physics, heavier_arm), object=replace(box, mass=HEAVIER * box.mass, inertia=HEAVIER * box.inertia)
    )


def heavier(run: Run) -> Run:
    """The run in a unit of mass that is smaller."""
    moved = with_signals(run, lambda arm: replace(arm, torque=HEAVIER * arm.torque, command=HEAVIER * arm.command))
    return replace(moved, physics=heavier_scene(run.physics))


def source_of(run: Run) -> ReplaySource:
    return ReplaySource.of(Runs.of(Path("here"), [MeasuredRun.of(run)]), load_model("nominal"), ReplayCache(map))


@pytest.fixture(scope="module")
def sources() -> tuple[ReplaySource, ReplaySource]:
    run = simulated(HIT, with_friction(HIT.scene.physics))
    return source_of(run), source_of(heavier(run))


def test_scaled_residuals_are_the_same(sources: tuple[ReplaySource, ReplaySource]) -> None:
    (light,), (heavy,) = (source.clusters for source in sources)
    np.testing.assert_allclose(heavy.residuals, light.residuals, atol=1e-3 * np.abs(light.residuals).max())
    np.testing.assert_allclose(heavy.discrepancy, light.discrepancy, rtol=1e-6)
    assert np.abs(light.residuals).max() > 10.0


@pytest.mark.parametrize("name", ["joint_coulomb_friction", "object_mass", "torque_offset", "pad_compliance"])
def test_sensitivities_to_a_noticeable_change_are_the_same(
    sources: tuple[ReplaySource, ReplaySource], name: str
) -> None:
    found = []
    for source in sources:
        effect = library()[name].in_proportion(Proportion.of(source.physics))
        candidate = linearise(Candidate.of((effect,), source), source.clusters, (0,), source)
        assert candidate is not None
        found.append(candidate.jacobians[0])
    np.testing.assert_allclose(found[1], found[0], atol=1e-3 * np.abs(found[0]).max())
