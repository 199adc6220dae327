# SPDX-License-Identifier: Apache-2.0
"""Replays are kept, and distinguished by all that they depend on."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np
import pytest

from impact_rs_analysis.evidence.replays.measured_runs import MeasuredRun, Setup
from impact_rs_analysis.evidence.replays.replay_cache import MIN_BATCHES, Replay, ReplayCache, run_batch, run_replay
from impact_rs_sim.errors import InputError
from impact_rs_sim.model import Model, ModelEffect, ParameterValue
from impact_rs_sim.physics import Physics
from impact_rs_sim.scene import ArmState
from impact_rs_sim.twin import Result, TwinJob, simulate
from impact_rs_trials.runs import Signals
from impact_rs_trials.workers import Workforce, workers

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


def test_a_replay_runs_once(setup: Setup) -> None:
    tasks, rng = CountingMap(lambda task: rng.standard_normal(len(task.setup.used))), np.random.default_rng(0)
    task, store = Replay(setup, NOMINAL, (("restitution", (0.1,)),)), ReplayCache(tasks)
    first, second = store([task, task]), store([task])
    assert tasks.count == 2  # free motion and contact
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
    setups.append(replace(setup, drive_period=np.nextafter(setup.drive_period, more)))
    tasks = CountingMap(lambda task: np.zeros(len(task.setup.used)))
    ReplayCache(tasks)([Replay(one, NOMINAL) for one in setups])
    assert tasks.count == len(setups) + 2  # contact as well, at first and with another period


def test_an_effect_of_contact_replays_no_free_motion_again(setup: Setup) -> None:
    """And the features are those of all windows replayed together, each in its place."""
    asked: list[Replay] = []

    def replayed(function: Callable, batches: Iterable[Sequence[Replay]]) -> list:
        found = [list(batch) for batch in batches]
        asked.extend(task for batch in found for task in batch)
        return [function(batch) for batch in found]

    store = ReplayCache(replayed)
    for added, contacts in (
        ((), [False, True]),
        ((("object_mass", (1.1,)),), [True]),
        ((("torque_gain", (0.9,) * 7),), [False, True]),
        ((("torque_gain", (0.9,) * 7), ("object_mass", (1.1,))), [True]),
        ((("restitution_fall", (0.1,)),), []),  # of tables of impacts alone
    ):
        asked.clear()
        whole = Replay(setup, NOMINAL, added)
        (apart,) = store([whole])
        assert [task.setup.contact for task in asked] == contacts
        if contacts:
            np.testing.assert_allclose(apart, run_replay(whole), rtol=1e-12, atol=1e-15)


def test_a_replay_that_hits_nothing_is_kept_as_well(setup: Setup) -> None:
    tasks = CountingMap(lambda task: None)
    store = ReplayCache(tasks)
    for _ in range(2):
        assert store([Replay(setup, NOMINAL)]) == [None]
    assert tasks.count == 2  # free motion and contact


def test_no_body_has_no_replay_in_a_fit_and_is_refused_in_a_model(setup: Setup) -> None:
    """Far outside of link and tool there is no mass that could be taken away."""
    values = {"mass": (-0.4, "kg"), "com_x": (0.2, "m"), "com_y": (0.0, "m"), "com_z": (0.2, "m")}
    added = (("end_effector_payload", tuple(value for value, _ in values.values())),)
    assert run_replay(Replay(setup, NOMINAL, added)) is None
    believed = {name: ParameterValue(estimate=value, unit=unit) for name, (value, unit) in values.items()}
    model = Model(name="hollow", effects=(ModelEffect(name="end_effector_payload", parameters=believed),))
    with pytest.raises(InputError, match="takes away mass that is not there"):
        run_replay(Replay(setup, model))


@pytest.mark.parametrize("motor", [True, False])
def test_a_replay_with_a_step_that_was_not_solved_is_passed_over_by_fits_and_refused_in_a_model(
    setup: Setup, motor: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Kills: without a reading of the motors the slope of a torque that is not a number, which SciPy refuses."""
    setup = replace(setup, motor=motor)

    def unsolved(jobs: Sequence[TwinJob], threads: int = 1) -> list[Result]:
        return [replace(result, failed=(0.1,)) for result in simulate(jobs, threads)]

    monkeypatch.setattr("impact_rs_analysis.evidence.replays.replay.simulate", unsolved)
    assert run_replay(Replay(setup, NOMINAL, (("restitution", (0.1,)),))) is None
    nominal = run_replay(Replay(setup, NOMINAL))
    assert nominal is None or not np.isfinite(nominal).all()


def test_replays_travel_in_batches_of_one_run_and_come_back_in_order(setup: Setup) -> None:
    other = replace(setup, drive_period=0.5 * setup.drive_period)
    values = [0.001 * number for number in range(4 * MIN_BATCHES)]
    tasks = CountingMap(lambda task: np.full(len(task.setup.used), task.added[0][1][0]))
    asked = [Replay(one, NOMINAL, (("actuation_delay", (value,)),)) for value in values for one in (setup, other)]
    assert [float(item[0]) for item in ReplayCache(tasks)(asked)] == [value for value in values for _ in range(2)]
    assert all(len({task.setup.digest for task in batch}) == 1 for batch in tasks.batches)
    assert len(tasks.batches) == MIN_BATCHES  # of free motion and of contact


def test_replays_in_one_batch_are_those_of_each_alone(setup: Setup) -> None:
    tasks = [Replay(setup, NOMINAL, added) for added in ((), (("object_mass", (1.1,)),), (("restitution", (0.2,)),))]
    for together, task in zip(run_batch(tasks), tasks, strict=True):
        np.testing.assert_allclose(together, run_replay(task), rtol=1e-9, atol=1e-12)


def test_replays_on_threads_are_to_the_bit_those_of_one(setup: Setup) -> None:
    setups = [replace(setup, drive_period=setup.drive_period / number) for number in (1, 2)]
    added = [(("object_mass", (1.0 + 0.01 * number,)),) for number in range(8)]
    tasks = [Replay(one, NOMINAL, effects) for effects in added for one in setups]
    with workers(Workforce(4)) as map_tasks:
        together = ReplayCache(map_tasks)(tasks)
    for several, alone in zip(together, ReplayCache(map)(tasks), strict=True):
        np.testing.assert_array_equal(several, alone)
    assert len({values.tobytes() for values in together if values is not None}) == len(tasks)


def test_threads_simulate_at_the_same_time_and_make_features_in_turn(
    setup: Setup, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Features share rigid-body models, whose results the next call overwrites."""
    both, making, most = threading.Barrier(2, timeout=60.0), [], []

    def simulated(_: Setup, physics: Sequence[Physics]) -> list[list[Signals]]:
        both.wait()
        return [[] for _ in physics]

    def features(own: Setup, simulations: Sequence[object]) -> list[np.ndarray]:
        making.append(1)
        threading.Event().wait(0.02)
        most.append(len(making))
        making.pop()
        return [np.zeros(len(own.used)) for _ in simulations]

    monkeypatch.setattr(Setup, "replayed_all", simulated)
    monkeypatch.setattr(Setup, "features_of_all", features)
    with workers(Workforce(2)) as map_tasks:
        ReplayCache(map_tasks)([Replay(setup, NOMINAL)])  # free motion and contact
    assert most == [1, 1]
