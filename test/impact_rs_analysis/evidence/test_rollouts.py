"""Runs of the twin are kept, and told apart by everything that they depend on."""

from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from impact_rs_analysis.evidence.rollouts import Rollout, RolloutStore, run_rollout
from impact_rs_analysis.evidence.runs import Condition
from impact_rs_analysis.evidence.twin import Start
from impact_rs_sim.errors import InputError
from impact_rs_sim.model import Model, ModelEffect, ParameterValue
from impact_rs_sim.scenario import load_scenario
from impact_rs_trials.spec import TrialSpec


@pytest.fixture
def counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[Callable[..., list], list[Rollout]]:
    """A map that counts, with a cache of its own; features are made from the digest."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    run: list[Rollout] = []

    def map_tasks(function: Callable, tasks: Iterable[Rollout]) -> list:
        assert function is run_rollout
        tasks = list(tasks)
        run.extend(tasks)
        return [np.array([len(run), float(len(task.added))]) for task in tasks]

    return map_tasks, run


def condition() -> Condition:
    return Condition(TrialSpec.of(load_scenario("push"), "juice", "case_2"))


def test_a_rollout_runs_once_for_all_stores(counted: tuple[Callable[..., list], list[Rollout]]) -> None:
    map_tasks, run = counted
    rollout = Rollout(condition(), Model(name="nominal"), (("restitution", (0.1,)),))
    first = RolloutStore(map_tasks)([rollout, rollout])
    second = RolloutStore(map_tasks)([rollout])
    assert len(run) == 1
    np.testing.assert_array_equal(first[1], second[0])


def test_a_start_counts_to_the_last_bit(counted: tuple[Callable[..., list], list[Rollout]]) -> None:
    map_tasks, run = counted
    start = Start.nominal(condition().plan)
    joints = {name: np.nextafter(q, np.inf) for name, q in start.joints.items()}
    starts = [None, start, replace(start, joints=joints), replace(start, object_yaw=1e-300)]
    RolloutStore(map_tasks)([Rollout(condition(), Model(name="nominal"), start=at) for at in starts])
    assert len(run) == len(starts)


def test_a_twin_that_hits_nothing_is_kept_as_well(
    counted: tuple[Callable[..., list], list[Rollout]], tmp_path: Path
) -> None:
    calls = []

    def nothing(function: Callable, tasks: Iterable[Rollout]) -> list:
        calls.extend(tasks)
        return [None for _ in tasks]

    rollout = Rollout(condition(), Model(name="nominal"))
    assert RolloutStore(nothing)([rollout]) == [None]
    assert RolloutStore(nothing)([rollout]) == [None]
    assert len(calls) == 1
    assert list(tmp_path.rglob("*.npy"))
    assert not list(tmp_path.rglob("*.tmp"))


def test_a_fit_that_takes_away_more_than_there_is_gets_no_twin_and_a_model_that_does_is_refused() -> None:
    """A negative mass far outside leaves negative moments of inertia, which Bullet would silently set to zero."""
    values = (-0.4, 0.2, 0.0, 0.2)
    assert run_rollout(Rollout(condition(), Model(name="nominal"), (("end_effector_payload", values),))) is None
    names = ("mass", "com_x", "com_y", "com_z")
    believed = {
        name: ParameterValue(estimate=value, unit="kg" if name == "mass" else "m")
        for name, value in zip(names, values, strict=True)
    }
    model = Model(name="hollow", effects=(ModelEffect(name="end_effector_payload", parameters=believed),))
    with pytest.raises(InputError, match="end effector of arm 'arm': mass .* kg .* is no rigid body"):
        run_rollout(Rollout(condition(), model))
