# SPDX-License-Identifier: Apache-2.0
"""One trial on the side of one participant (plant, cell or controller), message by message."""

from __future__ import annotations

from abc import ABC, abstractmethod

from impact_rs_control.plan import TrialPlan
from impact_rs_trials.bags.messages import MessageMaker


class LockstepTrial(ABC):
    """One trial on the side of one node of the lockstep.

    Args:
        plan: The trial.
        maker: Fills its messages.

    Attributes:
        now: Trial time [ns].
        failure: Reason why the trial failed; empty: it did not.
        unreadable: Number of messages that could not be decoded; they are ignored.
    """

    def __init__(self, plan: TrialPlan, maker: MessageMaker) -> None:
        self.now = 0
        self.failure = ""
        self.unreadable = 0
        self._last = plan.scene.scenario.timing.ticks
        self._maker = maker
        self._tick_times: list[float] = []

    @abstractmethod
    def work(self, until: float) -> None:
        """Process messages until ``until`` on the monotonic clock [s], or a little longer."""

    def stop(self, failure: str) -> None:
        """End the trial early; ``failure`` says why."""
        self.failure = failure

    @abstractmethod
    def end(self) -> str:
        """End the trial; returns its outcome as this node sees it."""

    @abstractmethod
    def status(self) -> tuple[str, dict[str, object]]:
        """A line and numbers for ``/diagnostics``."""

    def note(self) -> str:
        """Warning about a successful trial, in one line; may be empty."""
        return f"{self.unreadable} messages could not be read" if self.unreadable else ""

    def tick_statistics(self) -> dict[str, object]:
        """Wall-clock time per tick since the last call."""
        times, self._tick_times = sorted(self._tick_times), []
        if not times:
            return {"ticks": 0}
        return {
            "ticks": len(times),
            "tick_time_median [s]": f"{times[len(times) // 2]:.6f}",
            "tick_time_largest [s]": f"{times[-1]:.6f}",
        }


class LeadingTrial(LockstepTrial):
    """One trial of the node that publishes measured states; this node begins and ends the trial.

    Attributes:
        begun: Whether the first state was published.
        over: Whether the trial has ended; ``failure`` says why, if it ended early.
    """

    def __init__(self, plan: TrialPlan, maker: MessageMaker) -> None:
        super().__init__(plan, maker)
        self.begun = False
        self.over = False

    @abstractmethod
    def begin(self) -> None:
        """Begin the trial; all its topics have subscribers."""

    def stop(self, failure: str) -> None:
        self.over = True
        super().stop(failure)
