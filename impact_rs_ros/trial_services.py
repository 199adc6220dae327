# SPDX-License-Identifier: Apache-2.0
"""Services of plant, cell, controller and recorder: a trial is configured, and finished, once.

A request or its answer can be lost while a restarted node is being discovered. A caller therefore sends it again, with
the number of its attempt at the trial; the node acts on the first one, and gives the same answer to the others.
"""

from __future__ import annotations

from abc import abstractmethod

from impact_rs.srv import ConfigureTrial, FinishTrial

from impact_rs_ros.process import NodeProgram


class TrialServices(NodeProgram):
    """A managed node that serves ``~/configure_trial`` and ``~/finish_trial``."""

    managed = True

    def __init__(self) -> None:
        super().__init__()
        self._attempt = 0  # number of the last attempt that was to be configured
        self._answer = ConfigureTrial.Response()  # answer to that request
        self._finished: FinishTrial.Response | None = None  # answer on the end of the previous trial

    @property
    @abstractmethod
    def in_trial(self) -> bool:
        """Whether a trial is configured and not finished."""

    @abstractmethod
    def begin_trial(self, request: ConfigureTrial.Request, response: ConfigureTrial.Response) -> None:
        """Prepare a trial; a previous one that still runs is ended.

        Raises:
            InputError: The request is wrong, or another node is missing.
        """

    @abstractmethod
    def finish_trial(self, request: FinishTrial.Request, response: FinishTrial.Response) -> None:
        """End the trial and fill in the answer. If the trial must go on, the answer has the reason."""

    def offer(self) -> None:
        self.node.create_service(ConfigureTrial, self.role("configure_trial"), self._on_configure)
        self.node.create_service(FinishTrial, self.role("finish_trial"), self._on_finish)

    def _on_configure(
        self, request: ConfigureTrial.Request, response: ConfigureTrial.Response
    ) -> ConfigureTrial.Response:
        if self.active and request.attempt and request.attempt == self._attempt:
            return self._answer  # a repeated request, because the answer took long
        self._attempt, self._finished = 0, None
        with self.answering(response, "prepare the trial"):
            self.check_active()
            self._attempt, self._answer = request.attempt, response
            self.begin_trial(request, response)
            response.success = True
        return response

    def _on_finish(self, request: FinishTrial.Request, response: FinishTrial.Response) -> FinishTrial.Response:
        of_this_trial = request.attempt == 0 or (request.attempt == self._attempt and self._answer.success)
        if not (of_this_trial and self.in_trial):
            response.message = f"{self.kind}: there is no trial to finish"
            return (
                self._finished if of_this_trial and self._finished is not None else response
            )  # else its answer was lost
        self.finish_trial(request, response)
        if not self.in_trial:
            self._finished = response
        return response
