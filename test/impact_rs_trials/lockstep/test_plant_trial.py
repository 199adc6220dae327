# SPDX-License-Identifier: Apache-2.0
"""In real time a torque that comes late acts from the next tick on, and a trial of too many misses is no trial.

The clock is the test's: nothing here depends on how fast the machine is.
"""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace

import numpy as np
import pytest
from robot_bench import MAKER, PERIOD, PUSH, Wires, torque_message

from impact_rs_sim.plant.plant import Plant
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.record import FrameSource
from impact_rs_trials.lockstep import plant_trial
from impact_rs_trials.lockstep.plant_trial import Pace, PlantTrial

COMMAND = topics.joint_command("arm")


class Bench(Wires):
    """A push of five ticks; a plant that only notes its torques, and a controller that answers what the test says."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, realtime: bool = True, limit: float = 1.0) -> None:
        super().__init__()
        self.time = 100.0  # s
        self.used: list[float] = []  # torque of joint 1 [N m], by tick
        self.coming: list[tuple[float, bytes]] = []  # when it comes, and what
        clock = SimpleNamespace(monotonic=lambda: self.time, sleep=self.sleep)
        monkeypatch.setattr(plant_trial, "time", clock)
        monkeypatch.setattr(plant_trial, "ran_away", lambda *_: False)
        plant: Plant = SimpleNamespace(  # type: ignore[assignment]
            measure=lambda: SimpleNamespace(arms={"arm": None}),
            truth=lambda: SimpleNamespace(arms={}),
            step=lambda torques: self.used.append(float(torques["arm"][0])),
            close=lambda: None,
        )
        monkeypatch.setattr(PlantTrial, "_publish_others", lambda trial: None)
        pace = Pace(realtime, limit, 0.25, 1.5)
        self.trial = PlantTrial(PUSH, MAKER, plant, pace, self, self, FrameSource(PUSH.scene))
        self.trial._last = 5
        self.trial.begin()

    def sleep(self, duration: float) -> None:
        self.time += duration

    def wait(self, timeout: float) -> None:
        """Until the next message, or for so long."""
        self.time += min([timeout, *(when - self.time for when, _ in self.coming if when > self.time)])

    def take(self) -> Iterator[tuple[str, bytes]]:
        here = [one for one in self.coming if one[0] <= self.time + 1e-9]
        self.coming = [one for one in self.coming if one not in here]
        yield from ((COMMAND, data) for _, data in here)

    def answer(self, tick: int, at: float, torque: float | None = None) -> None:
        """An answer to a tick, that comes ``at`` [s] after the trial's begin; its torque is the tick's number."""
        values = np.full(7, float(tick) if torque is None else torque)
        self.coming.append((100.0 + at, torque_message(tick, values)))

    def run(self) -> PlantTrial:
        while not self.trial.over:
            self.trial.work(self.time + 1.0)
        return self.trial


def test_a_late_torque_acts_from_the_next_tick_on(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(monkeypatch)
    for tick in range(5):  # each in the middle of the tick after its own
        bench.answer(tick, (tick + 0.5) * PERIOD if tick else 0.0)
    bench.answer(5, 0.02)
    trial = bench.run()
    assert bench.asked == [0, 1, 2, 3, 4, 5]
    assert bench.used == [0.0, 0.0, 1.0, 2.0, 3.0]  # of tick 0 it is in time, then it is one tick old
    assert trial.failure == ""
    assert trial.note() == "4 of 5 ticks without a torque in time"
    assert trial.status()[1]["missed_ticks"] == 4


def test_an_older_torque_never_replaces_a_newer_one(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(monkeypatch)
    bench.answer(0, 0.0)
    bench.answer(2, 2.5 * PERIOD)
    bench.answer(1, 2.6 * PERIOD)
    bench.answer(5, 0.02)
    bench.run()
    assert bench.used == [0.0, 0.0, 0.0, 2.0, 2.0]


def test_in_lockstep_only_the_torque_of_the_tick_acts(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(monkeypatch, realtime=False)
    for tick in range(6):
        bench.answer(tick - 1, 0.1 * tick - 0.01, torque=-1.0)
        bench.answer(tick, 0.1 * tick)
    trial = bench.run()
    assert bench.used == [0.0, 1.0, 2.0, 3.0, 4.0]
    assert (trial.failure, trial.note()) == ("", "")


@pytest.mark.parametrize(("limit", "aborted"), [(0.59, True), (0.6, False)])
def test_more_misses_than_the_limit_abort_the_trial_and_say_how_many(
    monkeypatch: pytest.MonkeyPatch, limit: float, aborted: bool
) -> None:
    bench = Bench(monkeypatch, limit=limit)
    for tick in (0, 1, 5):
        bench.answer(tick, tick * PERIOD - 1e-4)
    trial = bench.run()
    assert bench.asked[-1] == 5
    assert bool(trial.failure) == aborted
    if aborted:
        assert trial.failure.startswith("3 of 5 ticks without a torque in time, 60.0%, and missed_ticks_limit is 59.0%")


def test_the_last_state_has_its_answer_also_when_it_comes_late(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(monkeypatch)
    for tick in range(5):
        bench.answer(tick, tick * PERIOD - 1e-4)
    bench.answer(5, 0.6)
    trial = bench.run()
    assert (trial.failure, trial.note()) == ("", "")
    assert bench.time == pytest.approx(100.6)


@pytest.mark.parametrize("data", [b"", b"\0\1\0\0abc", b"\0\1\0\0" + b"\xff" * 200])
def test_bytes_that_are_no_torque_are_silence_and_counted(monkeypatch: pytest.MonkeyPatch, data: bytes) -> None:
    bench = Bench(monkeypatch, realtime=False)
    for tick in range(6):
        bench.coming.append((100.0, data))
        bench.answer(tick, 0.1 * tick)
    trial = bench.run()
    assert bench.used == [0.0, 1.0, 2.0, 3.0, 4.0]
    assert trial.failure == ""
    assert (trial.unreadable, trial.note()) == (6, "6 messages could not be read")
