# SPDX-License-Identifier: Apache-2.0
"""The plant as a node: publishes measured states and, below ``/truth``, the true ones; receives torques.

Its trials are :class:`~impact_rs_trials.lockstep.plant_trial.PlantTrial`.
"""

from __future__ import annotations

from collections.abc import Sequence

from std_msgs.msg import String

from impact_rs_control.closed_loop import make_plant
from impact_rs_control.plan import TrialPlan
from impact_rs_ros.names import frame_prefix
from impact_rs_ros.process import run
from impact_rs_ros.trial_node import LeadingNode
from impact_rs_sim.model import parse_model
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.messages import MessageMaker
from impact_rs_trials.bags.record import FrameSource
from impact_rs_trials.bags.streams import Stream, StreamMaker
from impact_rs_trials.bags.trial_info import TrialInfo
from impact_rs_trials.lockstep.plant_trial import Pace, PlantTrial


class PlantNode(LeadingNode[PlantTrial]):
    """Steps a :class:`~impact_rs_sim.plant.plant.Plant`."""

    kind = "plant"

    def received(self, arms: list[str]) -> dict[str, str]:
        return {topics.joint_command(arm): topics.JOINT_STATE for arm in arms}

    def published(self, arms: list[str]) -> dict[str, str]:
        names = [topics.CLOCK, topics.TF, topics.TF_STATIC, topics.OBJECT_POSE]
        names += [topics.TRUTH_MODEL, topics.TRUTH_OBJECT_POSE, topics.TRUTH_OBJECT_TWIST]
        for arm in arms:
            names += [topics.joint_states(arm), topics.motor_states(arm)]
            names += [topics.truth_joint_states(arm), topics.truth_contact_wrench(arm)]
        kinds = topics.recorded(arms)
        return {name: kinds[name] for name in names}

    def published_of(self, neighbours: Sequence[str]) -> dict[str, str]:
        return topics.of_neighbours(neighbours)

    def streams(self, maker: StreamMaker) -> dict[str, Stream]:
        return maker.of_plant()

    def prepare(self, plan: TrialPlan, maker: MessageMaker, info: TrialInfo, ros_time: bool) -> PlantTrial:
        del ros_time
        physics = plan.scene.physics
        if info.model_yaml:
            physics = parse_model(info.model_yaml, "TrialInfo.model_yaml").apply(physics)
            self.outbox.later(topics.TRUTH_MODEL, String(data=info.model_yaml))
        pace = Pace(
            realtime=self.parameter("realtime"),
            missed_limit=self.parameter("missed_ticks_limit"),
            repeat_after=self.parameter("repeat_after"),
            answer_timeout=self.parameter("answer_timeout"),
        )
        prefix = frame_prefix(self.node.get_namespace())
        frames = FrameSource(plan.scene, prefix, links=self.parameter("link_transforms"))
        self.outbox.later(topics.TF_STATIC, maker.transforms(0, frames.static))
        plant = make_plant(plan, info.seed, physics)
        return PlantTrial(plan, maker, plant, pace, self.inbox, self.outbox, frames)


def main() -> None:
    """Run the node."""
    run(PlantNode)


if __name__ == "__main__":
    main()
