# SPDX-License-Identifier: Apache-2.0
"""The experiment as a node: actions that run one trial, or a campaign, with the other nodes."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

from impact_rs.action import RunCampaign, RunTrial
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import Executor, MultiThreadedExecutor

from impact_rs_control.plan import TrialPlan
from impact_rs_ros.process import IDLE_WAIT_S, NodeProgram, close_goal, run
from impact_rs_ros.trial_session import Progress, TrialResult, TrialSession
from impact_rs_sim.errors import InputError, full_traceback
from impact_rs_sim.model import parse_model
from impact_rs_sim.physics import MOTOR_INERTIA_MODELS
from impact_rs_sim.scenarios.scenario import Scenario
from impact_rs_trials.bags.trial_info import TrialKey
from impact_rs_trials.campaign import Manifest, TrialReport, make_manifest, open_campaign, wrong_outcomes
from impact_rs_trials.spec import TrialSpec
from impact_rs_trials.store import open_store, owned

FAILED = ("ABORTED", "DIVERGED", "LIMIT")  # outcomes that are no success, and errors on /diagnostics


class ExperimentNode(NodeProgram):
    """Serves ``/run_trial`` and ``/run_campaign``, one goal at a time."""

    kind = "experiment"

    def __init__(self) -> None:
        super().__init__()
        self._session = TrialSession(self.node)
        self._busy = threading.Lock()
        self._cancelling = threading.Event()
        self._trials = 0
        self._aborted = 0
        self._last: TrialResult | None = None
        self._servers: list[ActionServer] = []

    def rehearse(self, spec: TrialSpec) -> None:
        self._session.describe(spec.plan)  # so that viewers show the robots before the first trial

    def offer(self) -> None:
        group = ReentrantCallbackGroup()
        self._servers = [
            ActionServer(
                self.node,
                kind,
                name,
                execute_callback=execute,
                goal_callback=self._on_goal,
                cancel_callback=lambda _: CancelResponse.ACCEPT,
                callback_group=group,
            )
            for kind, name, execute in (
                (RunTrial, "run_trial", self._run_trial),
                (RunCampaign, "run_campaign", self._run_campaign),
            )
        ]

    def served(self) -> list[str]:
        return [self.node.resolve_service_name(name) for name in ("run_trial", "run_campaign")]

    def connect(self, arms: list[str], neighbours: Sequence[str] = ()) -> None:
        del neighbours
        self._session.watch(arms)

    def make_executor(self) -> Executor:
        return MultiThreadedExecutor(num_threads=4)

    def status(self) -> tuple[str, dict[str, object]]:
        last = self._last
        line = "ok" if last is None or last.outcome == "OK" else f"last trial {last.outcome}: {last.message}"
        return line, {"trials": self._trials, "aborted": self._aborted}

    def failure(self) -> str:
        failed = self._last is not None and self._last.outcome in FAILED
        return self.status()[0] if failed else ""

    def close(self) -> None:
        self._cancelling.set()
        while self._busy.locked():  # the running trial still needs answers of nodes to close its bag
            self.serve(IDLE_WAIT_S)
        with self._busy:
            for server in self._servers:
                server.destroy()
        self._session.close()

    def _on_goal(self, goal: Any) -> GoalResponse:
        if self._busy.locked() or self._cancelling.is_set():
            self.log.warning("goal rejected: another trial or campaign is running; wait for its end, or cancel it")
            return GoalResponse.REJECT
        try:
            self._check(goal)
        except InputError as error:
            self.log.error(f"goal rejected: {error}")
            return GoalResponse.REJECT
        return GoalResponse.ACCEPT

    def _cancelled(self, handle: Any) -> bool:
        """Whether a goal is to end now."""
        return bool(handle.is_cancel_requested or self._cancelling.is_set())

    def _check(self, goal: Any) -> None:
        """Raise ``InputError`` if a goal names something that does not exist."""
        self.output(goal.output_directory, "output_directory")
        if isinstance(goal, RunCampaign.Goal):
            self._manifest(goal)
            return
        _planned(goal, self.scenario(goal.scenario))
        if goal.plant_model:
            parse_model(goal.plant_model, "plant_model")

    def _manifest(self, goal: RunCampaign.Goal) -> Manifest:
        """The campaign of a goal; empty fields take the values of the scenario."""
        inertia = goal.motor_inertia or "reduced"
        if inertia not in MOTOR_INERTIA_MODELS:
            expected = f"expected one of {', '.join(MOTOR_INERTIA_MODELS)}"
            raise InputError(f"no motor-inertia model {inertia!r}; {expected}", key="motor_inertia")
        return make_manifest(
            self.scenario_name(goal.scenario),
            list(goal.objects) or None,
            list(goal.cases) or None,
            list(goal.velocity_scales) or None,
            goal.trials or None,
            goal.seed,
        ).model_copy(update={"motor_inertia": inertia})

    def _execute(
        self,
        plan: TrialPlan,
        key: TrialKey,
        seed: int,
        directory: Path,
        handle: Any,
        feedback: Callable[[Progress], None] = lambda progress: None,
        plant_model: str = "",
    ) -> TrialResult:
        name = f"{plan.scene.scenario.name}/{key.name}"
        self.log.debug(f"running {name}")
        started = time.monotonic()
        result = self._session.run(plan, key, seed, directory, feedback, partial(self._cancelled, handle), plant_model)
        self._trials += 1
        self._last = result
        if result.outcome == "ABORTED" and not self._cancelled(handle):
            self._aborted += 1
        text = f"{name}: {result.outcome} after {time.monotonic() - started:.1f} s of wall time"
        if result.outcome == "OK" and not result.message:
            self.log.info(text)
        else:
            self.log.warning(f"{text}: {result.message}")
        return result

    def _run_trial(self, handle: Any) -> RunTrial.Result:
        goal = handle.request
        answer = RunTrial.Result(outcome="ABORTED", detected_time=float("nan"))
        with self._busy:
            try:
                plan, key = _planned(goal, self.scenario(goal.scenario))
                directory = self.output(goal.output_directory, "output_directory")

                def feedback(progress: Progress) -> None:
                    handle.publish_feedback(
                        RunTrial.Feedback(time=progress.time, mode=progress.mode, net_feedback=progress.net_feedback)
                    )

                result = self._execute(plan, key, goal.seed, directory, handle, feedback, goal.plant_model)
            except Exception as error:  # no trial ends a node
                return self._failed(handle, answer, error)
        answer.success = result.outcome not in FAILED
        answer.message = result.message
        answer.outcome = result.outcome
        answer.bag_path = str(result.bag_path)
        answer.net_feedback = result.progress.net_feedback
        answer.detected_time = result.progress.detected_time
        close_goal(handle, answer.success)
        return answer

    def _run_campaign(self, handle: Any) -> RunCampaign.Result:
        goal = handle.request
        answer = RunCampaign.Result()
        reports = []
        with self._busy, ExitStack() as campaign_lock:
            try:
                manifest = self._manifest(goal)
                directory = self.output(goal.output_directory, "output_directory")
                campaign_lock.enter_context(owned(open_store(directory)))
                todo = open_campaign(directory, manifest)
                answer.skipped = len(manifest.keys) - len(todo)
                self.log.info(f"campaign {directory}: {len(todo)} of {len(manifest.keys)} trials are to be run")
                for number, key in enumerate(todo):
                    if self._cancelled(handle):
                        answer.message = "cancelled"
                        break
                    handle.publish_feedback(RunCampaign.Feedback(finished=number, total=len(todo), current=key.name))
                    trial = manifest.trial(key)
                    result = self._execute(trial.spec.plan, key, trial.seed, directory, handle)
                    if result.outcome == "ABORTED" and self._cancelled(handle):
                        answer.message = "cancelled"  # not a failure of that trial
                        break
                    reports.append(TrialReport(key, result.outcome, result.message))
                    if result.outcome == "ABORTED":
                        answer.failed += 1
                        answer.message = f"{key.name}: {result.message}"
                    else:
                        answer.finished += 1
            except Exception as error:  # no campaign ends a node
                return self._failed(handle, answer, error)
        self.log.info(f"campaign {directory}: {answer.finished} trials finished, {answer.failed} failed")
        answer.success = answer.failed == 0 and not answer.message
        answer.message = "; ".join(filter(None, (answer.message, *wrong_outcomes(reports))))
        close_goal(handle, answer.success)
        return answer

    def _failed(self, handle: Any, answer: Any, error: Exception) -> Any:
        expected = isinstance(error, InputError)
        answer.message = str(error) if expected else f"{type(error).__name__}: {error}"
        self.log.error(answer.message if expected else full_traceback(error))
        close_goal(handle, False)
        return answer


def _planned(goal: Any, scenario: Scenario) -> tuple[TrialPlan, TrialKey]:
    inertia = goal.motor_inertia or "reduced"
    spec = TrialSpec.of(scenario, goal.object_name, goal.case_name, goal.velocity_scale, inertia)
    return spec.plan, TrialKey(spec.object, spec.case, spec.scale, goal.repeat)


def main() -> None:
    """Run the node."""
    run(ExperimentNode)


if __name__ == "__main__":
    main()
