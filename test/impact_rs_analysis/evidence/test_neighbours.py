# SPDX-License-Identifier: Apache-2.0
"""Neighbours of the object as evidence: their velocities are features, they are shown, and their mass is named."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from impact_rs_analysis.diagnosis.diagnose import diagnose
from impact_rs_analysis.evidence.replays.measured_runs import MeasuredRun, read_runs
from impact_rs_analysis.evidence.replays.replay_cache import ReplayCache
from impact_rs_analysis.evidence.replays.simulated_trials import simulated
from impact_rs_analysis.evidence.source import Source
from impact_rs_analysis.evidence.sources.run_source import ReplaySource
from impact_rs_analysis.evidence.tracks import track_of_recording, track_of_run
from impact_rs_analysis.report.animation import animation_data
from impact_rs_analysis.report.scene_3d import scene_data
from impact_rs_sim.effects import library
from impact_rs_sim.model import load_model
from impact_rs_sim.physics import Physics
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_trials.bags.record import record_trial
from impact_rs_trials.bags.trial_info import VIA, TrialInfo, TrialKey
from impact_rs_trials.runs import Run
from impact_rs_trials.spec import TrialSpec

SCENARIO = load_scenario("push_two_boxes")
PUSH = TrialSpec.of(SCENARIO, "box", "case_1")
NOMINAL = load_model(Path("nominal"))


@pytest.fixture(scope="module")
def pushed() -> Run:
    """A push of two boxes in Bullet, without noise."""
    return simulated(PUSH, PUSH.scene.physics, "bullet")


def test_velocities_of_a_neighbour_are_features_that_the_replay_has_too(pushed: Run) -> None:
    run = MeasuredRun.of(pushed)
    assert run.setup.bodies == ("object", "behind")
    replayed = run.setup.features_of(run.setup.replayed(run.setup.physics))
    assert replayed is not None
    heavier = library()["neighbour_mass"].apply_vector(run.setup.physics, np.array([2.0]))
    slower = run.setup.features_of(run.setup.replayed(heavier))
    assert slower is not None
    rows = [n for n, feature in enumerate(run.features) if feature.signal == "behind velocity" and feature.index == "y"]
    assert len(rows) == 2 + (run.setup.pushes or 0)
    seen = pushed.signals.neighbours["behind"]
    after = (seen.time > min(run.impacts.values()) + 0.006) & (seen.time < min(run.impacts.values()) + 0.04)
    slope = np.polyfit(seen.time[after], seen.position[after, 1], 1)[0]
    assert run.measured[rows[0]] == pytest.approx(slope, abs=0.01)
    np.testing.assert_allclose(replayed[rows], run.measured[rows], atol=0.01)
    half = replace(seen, position=0.5 * seen.position)  # both move alike here: one that does not is not the object
    other = MeasuredRun.of(replace(pushed, signals=replace(pushed.signals, neighbours={"behind": half})))
    np.testing.assert_allclose(other.measured[rows], 0.5 * run.measured[rows], atol=1e-9)
    assert np.all(np.abs(slower[rows[:2]]) < np.abs(replayed[rows[:2]]) - 0.01)


def test_a_neighbour_that_was_not_tracked_has_no_features_and_is_not_shown(pushed: Run) -> None:
    unseen = replace(pushed, signals=replace(pushed.signals, neighbours={}))
    run = MeasuredRun.of(unseen)
    assert run.setup.bodies == ("object",)
    assert not [feature for feature in run.features if feature.signal.startswith("behind")]
    track = track_of_run(run, NOMINAL)
    assert track.measured is not None and np.isnan(track.measured.neighbours["behind"]).all()
    assert track_of_recording(unseen).measured.neighbours == {}  # type: ignore[union-attr]


def test_a_neighbour_is_shown_where_it_was_measured_beside_its_replay(pushed: Run) -> None:
    track = track_of_run(MeasuredRun.of(pushed), NOMINAL)
    assert track.measured is not None and track.predicted is not None
    seen = pushed.signals.neighbours["behind"]
    rows = np.flatnonzero(track.time > seen.time[-1] - 0.5)[:-5:40]
    expected = np.array([np.interp(track.time[rows], seen.time, column) for column in seen.position.T]).T
    np.testing.assert_allclose(track.measured.neighbours["behind"][rows, :3], expected, atol=1e-4)
    np.testing.assert_allclose(track.predicted.neighbours["behind"][rows, :3], expected, atol=5e-3)
    at_rest = seen.position[seen.time < 0.5].mean(axis=0)
    np.testing.assert_allclose(track.measured.neighbours["behind"][0, :3], at_rest, atol=1e-3)
    assert {"behind velocity y", "behind yaw"} <= {curve.name for curve in track.curves}
    scene = scene_data(PUSH.scene.physics)
    assert scene["neighbours"] == [{"object": list(SCENARIO.neighbours["behind"].size)}]
    (shown,) = animation_data([track])["runs"]
    assert len(shown["measured"]["neighbours"]) == len(shown["model"]["neighbours"]) == 1


@pytest.mark.parametrize(("name", "item", "offered"), [("push_two_boxes", "box", True), ("push", "juice", False)])
def test_effects_on_neighbours_are_looked_for_where_there_are_some(name: str, item: str, offered: bool) -> None:
    source = SimpleNamespace(worlds=[Physics.nominal(load_scenario(name), item)])
    for effect in ("neighbour_mass", "object_friction"):
        assert Source.offers(source, library()[effect]) == offered  # type: ignore[arg-type]
    assert Source.offers(source, library()["object_mass"])  # type: ignore[arg-type]


def record(folder: Path, spec: TrialSpec, repeat: int, scale: float | None) -> None:
    """A trial in Bullet, in which the neighbour may be heavier than the model says."""
    hidden = None if scale is None else library()["neighbour_mass"].apply_vector(spec.scene.physics, np.array([scale]))
    info = TrialInfo.of(spec.plan, TrialKey(spec.object, spec.case, 1.0, repeat), 10 * repeat + 1, VIA["bullet"])
    assert record_trial(spec.plan, info, folder / info.key.name, hidden)[0].outcome == "OK"


@pytest.mark.slow
def test_a_neighbour_that_is_heavier_is_named_and_not_the_object(tmp_path: Path) -> None:
    """Both push on as one; the object leaves the pad and hits its neighbour, and what both do at first differs."""
    scale = 1.4
    for case in SCENARIO.cases:
        for repeat in range(2):
            record(tmp_path, TrialSpec.of(SCENARIO, "box", case), repeat, scale)
    source = ReplaySource.of(read_runs(tmp_path, map), NOMINAL, ReplayCache(map))
    document = diagnose(source, NOMINAL, ["neighbour_mass", "object_mass", "support_friction"])
    assert document.named == ("neighbour_mass",)
    low, high = document.effect("neighbour_mass").parameters["scale"].interval
    assert low <= scale <= high and 0.01 < high - low < 0.12
