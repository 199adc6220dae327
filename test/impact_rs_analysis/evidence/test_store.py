# SPDX-License-Identifier: Apache-2.0
"""Replays are kept, and told apart by everything that they depend on."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from impact_rs_analysis.evidence.measured import MeasuredRun, Setup
from impact_rs_analysis.evidence.run import Run
from impact_rs_analysis.evidence.store import BATCHES, Replay, ReplayStore, run_batch, run_replay
from impact_rs_sim.errors import InputError
from impact_rs_sim.model import Model, ModelEffect, ParameterValue
from impact_rs_sim.scene import ArmState


@pytest.fixture(scope="module")
def setup(hit: Run) -> Setup:
    return MeasuredRun.of(hit).setup


@pytest.fixture
def counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[Callable[..., list], list[Replay]]:
    """A map that counts, with a cache of its own; features are made from the number of the call."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    run: list[Replay] = []

    def map_tasks(function: Callable, batches: Iterable[Sequence[Replay]]) -> list:
        assert function is run_batch
        batches = list(batches)
        run.extend(task for batch in batches for task in batch)
        return [[np.array([len(run), float(len(task.added))]) for task in batch] for batch in batches]

    return map_tasks, run


def test_a_replay_runs_once_for_all_stores(setup: Setup, counted: tuple[Callable[..., list], list[Replay]]) -> None:
    map_tasks, run = counted
    task = Replay(setup, Model(name="nominal"), (("restitution", (0.1,)),))
    first = ReplayStore(map_tasks)([task, task])
    second = ReplayStore(map_tasks)([task])
    assert len(run) == 1
    np.testing.assert_array_equal(first[1], second[0])


def test_start_torque_and_object_count_to_the_last_bit(
    setup: Setup, counted: tuple[Callable[..., list], list[Replay]]
) -> None:
    map_tasks, run = counted
    first, *others = setup.windows
    arm = first.arms["arm"]
    moved = replace(first, arms={"arm": ArmState(np.nextafter(arm.position, np.inf), arm.velocity)})
    pulled = replace(first, torque={"arm": np.nextafter(first.torque["arm"], np.inf)})
    elsewhere = replace(first, object=replace(first.object, position=np.nextafter(first.object.position, np.inf)))
    setups = [setup, *(replace(setup, windows=(window, *others)) for window in (moved, pulled, elsewhere))]
    setups.append(replace(setup, drive="joint torque"))
    ReplayStore(map_tasks)([Replay(one, Model(name="nominal")) for one in setups])
    assert len(run) == len(setups)


def test_a_replay_that_hits_nothing_is_kept_as_well(
    setup: Setup, counted: tuple[Callable[..., list], list[Replay]], tmp_path: Path
) -> None:
    calls = []

    def nothing(function: Callable, batches: Iterable[Sequence[Replay]]) -> list:
        batches = list(batches)
        calls.extend(batches)
        return [[None for _ in batch] for batch in batches]

    task = Replay(setup, Model(name="nominal"))
    assert ReplayStore(nothing)([task]) == [None]
    assert ReplayStore(nothing)([task]) == [None]
    assert len(calls) == 1
    assert list(tmp_path.rglob("*.npy"))
    assert not list(tmp_path.rglob("*.tmp"))


def test_a_fit_that_takes_away_more_than_there_is_gets_no_replay_and_a_model_that_does_is_refused(
    setup: Setup,
) -> None:
    """A negative mass far outside leaves negative moments of inertia, which Bullet would silently set to zero."""
    values = (-0.4, 0.2, 0.0, 0.2)
    assert run_replay(Replay(setup, Model(name="nominal"), (("end_effector_payload", values),))) is None
    names = ("mass", "com_x", "com_y", "com_z")
    believed = {
        name: ParameterValue(estimate=value, unit="kg" if name == "mass" else "m")
        for name, value in zip(names, values, strict=True)
    }
    model = Model(name="hollow", effects=(ModelEffect(name="end_effector_payload", parameters=believed),))
    with pytest.raises(InputError, match="end effector of arm 'arm': mass .* kg .* is no rigid body"):
        run_replay(Replay(setup, model))


def test_replays_of_one_run_travel_side_by_side_in_batches_of_like_effort_and_come_back_in_order(
    setup: Setup, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    free = tuple(replace(window, contact=False) for window in setup.windows)
    other = replace(setup, windows=free)
    sent: list[list[bool]] = []

    def map_tasks(function: Callable, batches: Iterable[Sequence[Replay]]) -> list:
        batches = list(batches)
        sent.extend([any(window.contact for window in task.setup.windows) for task in batch] for batch in batches)
        return [[np.array([task.added[0][1][0]]) for task in batch] for batch in batches]

    values = [0.001 * number for number in range(4 * BATCHES)]
    tasks = [
        Replay(one, Model(name="nominal"), (("restitution", (value,)),)) for value in values for one in (setup, other)
    ]
    found = ReplayStore(map_tasks)(tasks)
    assert [float(item[0]) for item in found] == [value for value in values for _ in range(2)]
    kinds = [kind for batch in sent for kind in batch]
    assert kinds == sorted(kinds, reverse=True)  # all of one run, then all of the other
    hits = [len(batch) for batch in sent if all(batch)]
    motions = [len(batch) for batch in sent if not any(batch)]
    assert len(hits) > len(motions)
    assert max(motions) > 4 * max(hits)
