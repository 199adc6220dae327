# SPDX-License-Identifier: Apache-2.0
"""Replays are kept, and distinguished by all that they depend on."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from impact_rs_analysis.evidence.measured_runs import MeasuredRun, Setup
from impact_rs_analysis.evidence.replay_cache import BATCHES, Replay, ReplayCache, run_batch, run_replay
from impact_rs_sim.errors import InputError
from impact_rs_sim.model import Model, ModelEffect, ParameterValue
from impact_rs_sim.scene import ArmState

NOMINAL = Model(name="nominal")


@pytest.fixture
def setup(measured_hit: MeasuredRun) -> Setup:
    return measured_hit.setup


class CountingMap:
    """A map that makes features up, and keeps the batches that it was asked for."""

    def __init__(self, make: Callable[[Replay], np.ndarray | None]) -> None:
        self.make = make
        self.batches: list[list[Replay]] = []

    def __call__(self, function: Callable, batches: Iterable[Sequence[Replay]]) -> list:
        assert function is run_batch
        asked = [list(batch) for batch in batches]
        self.batches += asked
        return [[self.make(task) for task in batch] for batch in asked]

    @property
    def count(self) -> int:
        return sum(map(len, self.batches))


@pytest.fixture(autouse=True)
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))


def test_a_replay_runs_once_for_all_stores(setup: Setup) -> None:
    tasks, rng = CountingMap(lambda task: rng.standard_normal(3)), np.random.default_rng(0)
    task = Replay(setup, NOMINAL, (("restitution", (0.1,)),))
    first, second = ReplayCache(tasks)([task, task]), ReplayCache(tasks)([task])
    assert tasks.count == 1
    np.testing.assert_array_equal(first[1], second[0])


def test_start_torque_and_object_count_to_the_last_bit(setup: Setup) -> None:
    first, *others = setup.windows
    arm, more = first.arms["arm"], np.inf
    changed = (
        replace(first, arms={"arm": ArmState(np.nextafter(arm.position, more), arm.velocity)}),
        replace(first, torque={"arm": np.nextafter(first.torque["arm"], more)}),
        replace(first, object=replace(first.object, position=np.nextafter(first.object.position, more))),
    )
    setups = [setup, *(replace(setup, windows=(window, *others)) for window in changed)]
    setups.append(replace(setup, drive="joint torque"))
    tasks = CountingMap(lambda task: np.zeros(1))
    ReplayCache(tasks)([Replay(one, NOMINAL) for one in setups])
    assert tasks.count == len(setups)


def test_a_replay_that_hits_nothing_is_kept_as_well(setup: Setup, tmp_path: Path) -> None:
    tasks = CountingMap(lambda task: None)
    for _ in range(2):
        assert ReplayCache(tasks)([Replay(setup, NOMINAL)]) == [None]
    assert tasks.count == 1
    assert list(tmp_path.rglob("*.npy")) and not list(tmp_path.rglob("*.tmp"))


def test_no_body_has_no_replay_in_a_fit_and_is_refused_in_a_model(setup: Setup) -> None:
    """A negative mass far outside leaves negative moments of inertia, which Bullet would silently set to zero."""
    values = {"mass": (-0.4, "kg"), "com_x": (0.2, "m"), "com_y": (0.0, "m"), "com_z": (0.2, "m")}
    added = (("end_effector_payload", tuple(value for value, _ in values.values())),)
    assert run_replay(Replay(setup, NOMINAL, added)) is None
    believed = {name: ParameterValue(estimate=value, unit=unit) for name, (value, unit) in values.items()}
    model = Model(name="hollow", effects=(ModelEffect(name="end_effector_payload", parameters=believed),))
    with pytest.raises(InputError, match="end effector of arm 'arm': mass .* kg .* is no rigid body"):
        run_replay(Replay(setup, model))


def test_replays_travel_in_batches_of_like_effort_and_come_back_in_order(setup: Setup) -> None:
    free = replace(setup, windows=tuple(replace(window, contact=False) for window in setup.windows))
    values = [0.001 * number for number in range(4 * BATCHES)]
    tasks = CountingMap(lambda task: np.array([task.added[0][1][0]]))
    asked = [Replay(one, NOMINAL, (("restitution", (value,)),)) for value in values for one in (setup, free)]
    assert [float(item[0]) for item in ReplayCache(tasks)(asked)] == [value for value in values for _ in range(2)]
    hits = [[any(window.contact for window in task.setup.windows) for task in batch] for batch in tasks.batches]
    kinds = [kind for batch in hits for kind in batch]
    assert kinds == sorted(kinds, reverse=True)  # all of one run, then all of the other
    of_hits = [len(batch) for batch in hits if all(batch)]
    of_motions = [len(batch) for batch in hits if not any(batch)]
    assert len(of_hits) > len(of_motions)
    assert max(of_motions) > 4 * max(of_hits)
