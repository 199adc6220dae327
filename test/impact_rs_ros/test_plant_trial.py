# SPDX-License-Identifier: Apache-2.0
"""In real time a torque that comes late acts from the next tick on, and a trial of too many misses is no trial.

The clock is the test's: nothing here depends on how fast the machine is.
"""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace

import pytest
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState

from impact_rs_control.plan import TrialPlan
from impact_rs_ros import plant_node
from impact_rs_ros.plant_node import Pace, PlantTrial
from impact_rs_sim.plant import Plant
from impact_rs_sim.scenario import load_scenario
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.record import FrameSource
from impact_rs_trials.spec import TrialSpec

PERIOD = 0.001  # s
COMMAND = topics.joint_command("arm")


@pytest.fixture(scope="module")
def plan() -> TrialPlan:
    """A push of five ticks."""
    found = TrialSpec.of(load_scenario("push"), "juice", "case_1").plan
    timing = found.scene.scenario.timing.model_copy(update={"duration": 5 * PERIOD})
    scenario = found.scene.scenario.model_copy(update={"timing": timing})
    scene = SimpleNamespace(**{name: getattr(found.scene, name) for name in ("models", "physics")}, scenario=scenario)
    return SimpleNamespace(scene=scene, arms=found.arms, of=found)  # type: ignore[return-value]


class Bench:
    """A plant that only notes its torques, and a controller that answers what the test says."""

    due = False

    def __init__(self, plan: TrialPlan, monkeypatch: pytest.MonkeyPatch, realtime: bool = True, limit: float = 1.0):
        self.time = 100.0  # s
        self.used: list[float] = []  # torque of joint 1 [N m], by tick
        self.asked: list[int] = []
        self.waiting: list[tuple[float, bytes]] = []  # when it comes, and what
        clock = SimpleNamespace(monotonic=lambda: self.time, sleep=self.sleep)
        monkeypatch.setattr(plant_node, "time", clock)
        monkeypatch.setattr(plant_node, "ran_away", lambda *_: False)
        plant: Plant = SimpleNamespace(  # type: ignore[assignment]
            measure=lambda: SimpleNamespace(arms={"arm": None}),
            truth=lambda: SimpleNamespace(arms={}),
            step=lambda torques: self.used.append(float(torques["arm"][0])),
            close=lambda: None,
        )
        monkeypatch.setattr(PlantTrial, "_rest", lambda trial: None)
        pace = Pace(realtime, limit, 0.25, 1.5)
        frames = FrameSource(plan.of.scene)  # type: ignore[attr-defined]
        self.trial = PlantTrial(plan.of, plant, pace, self, self, frames)  # type: ignore[attr-defined, arg-type]
        self.trial._last = 5
        self.trial.begin()

    def sleep(self, duration: float) -> None:
        self.time += duration

    def wait(self, timeout: float) -> None:
        """Until the next message, or for so long."""
        coming = [when - self.time for when, _ in self.waiting if when > self.time]
        self.time += min([timeout, *coming])

    def take(self) -> Iterator[tuple[str, bytes]]:
        here = [one for one in self.waiting if one[0] <= self.time + 1e-9]
        self.waiting = [one for one in self.waiting if one not in here]
        yield from ((COMMAND, data) for _, data in here)

    def now(self, topic: str, tick: int, sample: object) -> bytes:
        self.asked.append(tick)
        return b""

    def repeat(self, topic: str, data: bytes) -> None:
        """Asked again."""

    def answer(self, tick: int, at: float, torque: float | None = None) -> None:
        """An answer to a tick, that comes ``at`` [s] after the trial's begin; its torque is the tick's number."""
        values = [float(tick) if torque is None else torque] * 7
        message = JointState(name=[f"arm_joint{n}" for n in range(1, 8)], effort=values)
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(tick * 1_000_000, 10**9)
        self.waiting.append((100.0 + at, bytes(serialize_message(message))))

    def run(self) -> PlantTrial:
        while not self.trial.over:
            self.trial.work(self.time + 1.0)
        return self.trial


def test_a_late_torque_acts_from_the_next_tick_on(plan: TrialPlan, monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(plan, monkeypatch)
    for tick in range(5):  # each in the middle of the tick after its own
        bench.answer(tick, (tick + 0.5) * PERIOD if tick else 0.0)
    bench.answer(5, 0.02)
    trial = bench.run()
    assert bench.asked == [0, 1, 2, 3, 4, 5]
    assert bench.used == [0.0, 0.0, 1.0, 2.0, 3.0]  # of tick 0 it is in time, then it is one tick old
    assert trial.failure == ""
    assert trial.note() == "4 of 5 ticks without a torque in time"
    assert trial.status()[1]["missed_ticks"] == 4


def test_an_older_torque_never_replaces_a_newer_one(plan: TrialPlan, monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(plan, monkeypatch)
    bench.answer(0, 0.0)
    bench.answer(2, 2.5 * PERIOD)
    bench.answer(1, 2.6 * PERIOD)
    bench.answer(5, 0.02)
    bench.run()
    assert bench.used == [0.0, 0.0, 0.0, 2.0, 2.0]


def test_in_lockstep_only_the_torque_of_the_tick_acts(plan: TrialPlan, monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(plan, monkeypatch, realtime=False)
    for tick in range(6):
        bench.answer(tick - 1, 0.1 * tick - 0.01, torque=-1.0)
        bench.answer(tick, 0.1 * tick)
    trial = bench.run()
    assert bench.used == [0.0, 1.0, 2.0, 3.0, 4.0]
    assert (trial.failure, trial.note()) == ("", "")


@pytest.mark.parametrize(("limit", "aborted"), [(0.59, True), (0.6, False)])
def test_more_misses_than_the_limit_abort_the_trial_and_say_how_many(
    plan: TrialPlan, monkeypatch: pytest.MonkeyPatch, limit: float, aborted: bool
) -> None:
    bench = Bench(plan, monkeypatch, limit=limit)
    for tick in (0, 1, 5):
        bench.answer(tick, tick * PERIOD - 1e-4)
    trial = bench.run()
    assert bench.asked[-1] == 5
    assert bool(trial.failure) == aborted
    if aborted:
        assert trial.failure.startswith("3 of 5 ticks without a torque in time, 60.0%, and missed_ticks_limit is 59.0%")


def test_the_last_state_has_its_answer_also_when_it_comes_late(
    plan: TrialPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench = Bench(plan, monkeypatch)
    for tick in range(5):
        bench.answer(tick, tick * PERIOD - 1e-4)
    bench.answer(5, 0.6)
    trial = bench.run()
    assert (trial.failure, trial.note()) == ("", "")
    assert bench.time == pytest.approx(100.6)


@pytest.mark.parametrize("data", [b"", b"\0\1\0\0abc", b"\0\1\0\0" + b"\xff" * 200])
def test_bytes_that_are_no_torque_are_silence_and_counted(
    plan: TrialPlan, monkeypatch: pytest.MonkeyPatch, data: bytes
) -> None:
    bench = Bench(plan, monkeypatch, realtime=False)
    for tick in range(6):
        bench.waiting.append((100.0, data))
        bench.answer(tick, 0.1 * tick)
    trial = bench.run()
    assert bench.used == [0.0, 1.0, 2.0, 3.0, 4.0]
    assert trial.failure == ""
    assert (trial.unreadable, trial.note()) == (6, "6 messages could not be read")
