# SPDX-License-Identifier: Apache-2.0
"""The controller as a node; its trials are :class:`~impact_rs_trials.lockstep.controller_trial.ControllerTrial`."""

from __future__ import annotations

from impact_rs_control.plan import TrialPlan
from impact_rs_ros.process import run
from impact_rs_ros.trial_node import TrialNode
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.messages import MessageMaker
from impact_rs_trials.bags.streams import Stream, StreamMaker
from impact_rs_trials.bags.trial_info import TrialInfo
from impact_rs_trials.lockstep.controller_trial import ControllerTrial


class ControllerNode(TrialNode[ControllerTrial]):
    """Runs a :class:`~impact_rs_control.controller.Controller`."""

    kind = "controller"

    def received(self, arms: list[str]) -> dict[str, str]:
        return {topics.joint_states(arm): topics.JOINT_STATE for arm in arms}

    def published(self, arms: list[str]) -> dict[str, str]:
        kinds = topics.recorded(arms)
        return {
            name: kinds[name]
            for arm in arms
            for name in (topics.joint_command(arm), topics.controller_state(arm), topics.impact_event(arm))
        }

    def streams(self, maker: StreamMaker) -> dict[str, Stream]:
        return maker.of_controller()

    def prepare(self, plan: TrialPlan, maker: MessageMaker, info: TrialInfo, ros_time: bool) -> ControllerTrial:
        del info
        return ControllerTrial(plan, maker, self.inbox, self.outbox, ros_time)


def main() -> None:
    """Run the node."""
    run(ControllerNode)


if __name__ == "__main__":
    main()
