# SPDX-License-Identifier: Apache-2.0
"""Guard between an investigation and a real cell: envelope, questions to the operator, and stops.

``docs/safety.md`` has the argument. Nothing here moves a robot; the ``cell`` node has limits of its own.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from impact_rs_analysis.investigation.rounds import PlannedTrial
from impact_rs_sim.errors import InputError
from impact_rs_sim.files import write_whole
from impact_rs_trials.bags.trial_info import OUTCOMES
from impact_rs_trials.campaign import TrialReport
from impact_rs_trials.envelope import CellEnvelope, demand_of

STOPPED, APPROVED = "stopped.json", "approved.json"

Ask = Callable[[str], bool]


class SafetyStop(RuntimeError):
    """The investigation has stopped, and moves nothing until an operator has looked at the cell."""


class CellGuard:
    """Admits the trials of one investigation to a cell, one by one.

    Args:
        directory: Folder of the investigation.
        envelope: Which trials may run.
        ask: Asks the operator; False also without an operator.
        skip_questions: Whether new kinds of motion and the start of trials need no answer; a stop always does.
    """

    def __init__(self, directory: Path, envelope: CellEnvelope, ask: Ask, skip_questions: bool = False) -> None:
        self._directory, self._envelope, self._ask, self._skip_questions = directory, envelope, ask, skip_questions

    def begin(self) -> None:
        """Ask whether the cell is safe again, if the last trial ended with a stop, or not at all.

        Raises:
            SafetyStop: It is not, or no one answers.
        """
        if (stop := self._read(STOPPED)) is None:
            return
        reason = f"The last run stopped at {stop['trial']}: {stop['reason']}."
        if not self._ask(f"{reason} Is the cell safe, the arm at rest, and shall it go on?"):
            raise SafetyStop(f"{reason} Nothing was moved; answer yes to go on, or remove {self._directory / STOPPED}")
        (self._directory / STOPPED).unlink()

    def in_order(self, trials: Sequence[PlannedTrial]) -> list[PlannedTrial]:
        """Order of the admitted trials: approved kinds in the order of the plan, new kinds by speed.

        Raises:
            InputError: A trial is outside the envelope; then no trial runs.
        """
        for planned in trials:
            self._envelope.check(planned.trial.spec)
        approved = set(self._read(APPROVED) or {})
        new = sorted(
            (planned for planned in trials if _kind(planned) not in approved),
            key=lambda planned: demand_of(planned.trial.spec).speed,
        )
        return [*(planned for planned in trials if _kind(planned) in approved), *new]

    def admit(self, planned: PlannedTrial) -> None:
        """Let a trial run: inside the envelope, its kind of motion approved, the cell ready. Marks it as running.

        Raises:
            InputError: It is outside the envelope.
            SafetyStop: The operator did not agree.
        """
        spec, kind = planned.trial.spec, _kind(planned)
        self._envelope.check(spec)
        motion = demand_of(spec)
        approved = self._read(APPROVED) or {}
        demand_document = {"speed": motion.speed, "impulse": motion.impulse}
        if kind not in approved:
            question = (
                f"New kind of motion: {kind}, up to {motion.speed:.2f} m/s, predicted impulse "
                f"{motion.impulse:.2f} N s. May it run?"
            )
            if not self._skip_questions and not self._ask(question):
                raise SafetyStop(f"{kind} was not approved; nothing was moved. The same command asks again")
            write_whole(self._directory / APPROVED, json.dumps({**approved, kind: demand_document}, indent=2) + "\n")
        start = ", ".join(
            f"{name} at [{', '.join(f'{value:.4f}' for value in arm.initial)}]" for name, arm in spec.plan.arms.items()
        )
        if not self._skip_questions and not self._ask(f"{planned.path}: {start}, object {spec.object} in its place?"):
            raise SafetyStop(f"{planned.path} was not started; nothing was moved. The same command goes on")
        self._stop(planned, "the program ended while this trial ran")  # true unless it is taken back

    def after(self, planned: PlannedTrial, report: TrialReport) -> None:
        """Go on only after a trial that went as planned.

        Raises:
            SafetyStop: It did not.
        """
        if report.outcome != "OK":
            reason = f"{report.outcome}: {report.message or OUTCOMES[report.outcome]}"
            self._stop(planned, reason)
            raise SafetyStop(f"stopped at {planned.path}: {reason}. The same command asks before it goes on")
        (self._directory / STOPPED).unlink()

    def _stop(self, planned: PlannedTrial, reason: str) -> None:
        write_whole(self._directory / STOPPED, json.dumps({"trial": planned.path, "reason": reason}, indent=2) + "\n")

    def _read(self, name: str) -> dict[str, Any] | None:
        path = self._directory / name
        try:
            return dict(json.loads(path.read_text(encoding="utf-8"))) if path.exists() else None
        except (OSError, ValueError) as error:
            raise InputError(f"cannot be read: {error}; remove it when the cell is safe", file=path) from None


def _kind(planned: PlannedTrial) -> str:
    """Kind of motion: scenario with its settings, object, case and reference."""
    spec = planned.trial.spec
    changed = "".join(f", {key} = {value}" for key, value in sorted(planned.settings.items()))
    return f"{spec.scenario.name}/{spec.object}/{spec.case}, reference {spec.scale:g} of the prediction{changed}"
