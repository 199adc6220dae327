# SPDX-License-Identifier: Apache-2.0
"""Doors, flaps and drawers as evidence: replays, digests, the point that the pad has met, and a mass that is named."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from impact_rs_analysis.diagnosis.diagnose import diagnose
from impact_rs_analysis.evidence.replays.measured_runs import MeasuredRun, read_runs
from impact_rs_analysis.evidence.replays.replay_cache import ReplayCache
from impact_rs_analysis.evidence.replays.simulated_trials import simulated
from impact_rs_analysis.evidence.sources.run_source import ReplaySource
from impact_rs_analysis.measure.departure import MAX_CONTACT_DISTANCE_M, departures
from impact_rs_sim.effects import library
from impact_rs_sim.model import load_model
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_trials.bags.reader import TrialBag
from impact_rs_trials.bags.record import record_trial
from impact_rs_trials.bags.trial_info import VIA, TrialInfo, TrialKey
from impact_rs_trials.spec import TrialSpec

SCENARIO = load_scenario("push_door")
NOMINAL = load_model(Path("nominal"))


@pytest.mark.parametrize("name", SCENARIO.objects)
def test_a_replay_in_the_twin_moves_a_door_as_it_was_measured_in_bullet(name: str) -> None:
    """Kills a replay of a free body, and a digest that does not know the hinge."""
    spec = TrialSpec.of(SCENARIO, name, "case_1")
    run = MeasuredRun.of(simulated(spec, spec.scene.physics, "bullet"))
    physics = run.setup.physics
    replayed = run.setup.features_of(run.setup.replayed(physics))
    assert replayed is not None
    rows = [n for n, one in enumerate(run.features) if one.signal == "object velocity" and one.index == "y"]
    assert rows
    assert np.abs(run.measured[rows]).min() > 0.05
    np.testing.assert_allclose(replayed[rows], run.measured[rows], atol=5e-3)
    guide = physics.object.freedom
    assert guide is not None
    free, other = (
        replace(run.setup, physics=replace(physics, object=replace(physics.object, freedom=own)))
        for own in (None, 1.01 * guide)
    )
    assert len({run.setup.digest, free.digest, other.digest}) == 3


def record(folder: Path, name: str, case: str, repeat: int, scale: float) -> TrialBag:
    """A trial in Bullet with an object of another mass than the model has."""
    spec = TrialSpec.of(SCENARIO, name, case)
    hidden = library()["object_mass"].apply_vector(spec.scene.physics, np.array([scale]))
    info = TrialInfo.of(spec.plan, TrialKey(name, spec.case, 1.0, repeat), 10 * repeat + 1, VIA["bullet"])
    assert record_trial(spec.plan, info, folder / info.key.name, hidden)[0].outcome == "OK"
    return TrialBag.open(folder / info.key.name)


@pytest.mark.parametrize("name", ["door", "drawer"])
def test_a_door_that_leaves_the_pad_is_seen_to_do_so(name: str, tmp_path: Path) -> None:
    """Kills the nearest corner of the door, which is its hinge and stays at the pad."""
    bag = record(tmp_path, name, "case_1", 0, 1.0)
    (parted,) = departures(bag, {"arm": bag.controller("arm")})
    assert 5.0 * MAX_CONTACT_DISTANCE_M < parted.distance < 0.06


@pytest.mark.slow
@pytest.mark.parametrize("name", ["flap", "drawer"])
def test_a_hidden_mass_is_named(name: str, tmp_path: Path) -> None:
    scale = 1.4
    for case in SCENARIO.cases:
        for repeat in range(2):
            record(tmp_path, name, case, repeat, scale)
    source = ReplaySource.of(read_runs(tmp_path, map), NOMINAL, ReplayCache(map))
    document = diagnose(source, NOMINAL, ["object_mass", "motor_inertia_scale", "restitution", "pad_friction"])
    assert document.named == ("object_mass",)
    low, high = document.effect("object_mass").parameters["scale"].interval
    assert low <= scale <= high and 0.01 < high - low < 0.08


@pytest.mark.slow
def test_a_door_cannot_tell_its_mass_from_where_the_mass_is(tmp_path: Path) -> None:
    """All that it shows on an upright hinge is I_h = I + m d^2."""
    for case in SCENARIO.cases:
        for repeat in range(2):
            record(tmp_path, "door", case, repeat, 1.4)
    source = ReplaySource.of(read_runs(tmp_path, map), NOMINAL, ReplayCache(map))
    document = diagnose(source, NOMINAL, ["object_mass", "object_com_offset"])
    assert document.effect("object_mass").verdict.names == ("object_com_offset",)
    low, high = document.effect("object_mass").parameters["scale"].interval
    assert low <= 1.4 <= high
