# SPDX-License-Identifier: Apache-2.0
"""Names and types of topics in bags and in the root namespace; defined here only.

Per arm: ``/ARM/...``. Everything below ``/truth`` comes from the plant and is never read by the analysis.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

CLOCK = "/clock"
TRIAL_INFO = "/trial_info"
ROBOT_DESCRIPTION = "/robot_description"
TF = "/tf"
TF_STATIC = "/tf_static"
DIAGNOSTICS = "/diagnostics"
OBJECT_POSE = "/object/pose"  # topics of a neighbour have its name in place of object
OBJECT_DESCRIPTION = "/object/robot_description"
TRUTH = "/truth"
TRUTH_MODEL = "/truth/model"
TRUTH_OBJECT_POSE = "/truth/object/pose"
TRUTH_OBJECT_TWIST = "/truth/object/twist"


def robot_description(body: str) -> str:
    """URDF of an arm, or of a neighbour of the object, alone."""
    return f"/{body}/robot_description"


def pose(neighbour: str) -> str:
    """Tracked pose of a neighbour of the object."""
    return f"/{neighbour}/pose"


def truth_pose(neighbour: str) -> str:
    """True pose of a neighbour of the object."""
    return f"/truth/{neighbour}/pose"


def truth_twist(neighbour: str) -> str:
    """True twist of a neighbour of the object."""
    return f"/truth/{neighbour}/twist"


def joint_states(arm: str) -> str:
    """Measured q, dq, tau_J."""
    return f"/{arm}/joint_states"


def motor_states(arm: str) -> str:
    """Measured theta, dtheta."""
    return f"/{arm}/motor_states"


def joint_command(arm: str) -> str:
    """Desired torque tau_d."""
    return f"/{arm}/joint_command"


def controller_state(arm: str) -> str:
    """References, feedback and QP of the controller."""
    return f"/{arm}/controller_state"


def impact_event(arm: str) -> str:
    """The detected impact."""
    return f"/{arm}/impact_event"


def truth_joint_states(arm: str) -> str:
    """True q, dq, tau_J."""
    return f"/truth/{arm}/joint_states"


def truth_contact_wrench(arm: str) -> str:
    """True force of the object on the pad."""
    return f"/truth/{arm}/contact_wrench"


JOINT_STATE = "sensor_msgs/msg/JointState"
POSE = "geometry_msgs/msg/PoseStamped"
TWIST = "geometry_msgs/msg/TwistStamped"
WRENCH = "geometry_msgs/msg/WrenchStamped"
STRING = "std_msgs/msg/String"
TF_MESSAGE = "tf2_msgs/msg/TFMessage"
CLOCK_TYPE = "rosgraph_msgs/msg/Clock"
DIAGNOSTIC_ARRAY = "diagnostic_msgs/msg/DiagnosticArray"
CONTROLLER_STATE = "impact_rs/msg/ControllerState"
IMPACT_EVENT = "impact_rs/msg/ImpactEvent"
TRIAL_INFO_TYPE = "impact_rs/msg/TrialInfo"


def latched(arms: Sequence[str], neighbours: Sequence[str] = ()) -> list[str]:
    """Topics with one message per trial, which late subscribers receive as well."""
    return [TRIAL_INFO, ROBOT_DESCRIPTION, OBJECT_DESCRIPTION, *map(robot_description, (*arms, *neighbours))]


@dataclass(frozen=True)
class Offer:
    """Quality of service that the publisher of a topic offers; all are reliable and keep the last samples.

    Attributes:
        depth: How many samples are kept.
        latched: Whether a late subscriber receives the last one (durability transient local).
    """

    depth: int
    latched: bool = False


SIGNAL = Offer(4000)
"""A signal of every tick or every camera frame: four seconds at 1 kHz, so that a recorder that is late by some seconds
still receives every sample. It is bounded because a publisher with unbounded history blocks when a subscriber has died,
until the middleware notices that (20 s)."""

SPORADIC = Offer(10)
"""Rare messages (an impact, diagnostics), and topics whose newest message is enough (the clock)."""

TRANSFORMS = Offer(100)
"""``/tf``, as tf2 offers it."""

LATCHED = Offer(1, latched=True)
"""Topics with one message per trial."""


def offer(topic: str) -> Offer:
    """Quality of service that the publisher of a topic offers, on the network and in the metadata of bags."""
    if topic in (TRIAL_INFO, TF_STATIC) or topic.endswith(ROBOT_DESCRIPTION):
        return LATCHED
    if topic in (CLOCK, DIAGNOSTICS, TRUTH_MODEL) or topic.endswith("/impact_event"):
        return SPORADIC
    return TRANSFORMS if topic == TF else SIGNAL


def of_neighbours(neighbours: Sequence[str]) -> dict[str, str]:
    """Topics of the plant about the neighbours of the object, with their types."""
    names = ((pose, POSE), (truth_pose, POSE), (truth_twist, TWIST))
    return {name(neighbour): kind for neighbour in neighbours for name, kind in names}


def recorded(arms: Sequence[str], truth: bool = True, neighbours: Sequence[str] = ()) -> dict[str, str]:
    """Every recorded topic of a trial with its type; those below ``/truth`` only if the plant publishes the truth."""
    topics = {
        CLOCK: CLOCK_TYPE,
        TRIAL_INFO: TRIAL_INFO_TYPE,
        ROBOT_DESCRIPTION: STRING,
        OBJECT_DESCRIPTION: STRING,
        TF: TF_MESSAGE,
        TF_STATIC: TF_MESSAGE,
        DIAGNOSTICS: DIAGNOSTIC_ARRAY,
        OBJECT_POSE: POSE,
        TRUTH_MODEL: STRING,
        TRUTH_OBJECT_POSE: POSE,
        TRUTH_OBJECT_TWIST: TWIST,
    }
    for arm in arms:
        topics |= {
            robot_description(arm): STRING,
            joint_states(arm): JOINT_STATE,
            motor_states(arm): JOINT_STATE,
            joint_command(arm): JOINT_STATE,
            controller_state(arm): CONTROLLER_STATE,
            impact_event(arm): IMPACT_EVENT,
            truth_joint_states(arm): JOINT_STATE,
            truth_contact_wrench(arm): WRENCH,
        }
    topics |= dict.fromkeys(map(robot_description, neighbours), STRING) | of_neighbours(neighbours)
    return {topic: kind for topic, kind in topics.items() if truth or not _is_truth(topic)}


def needed(arms: Sequence[str]) -> list[str]:
    """Topics needed to analyse a trial; a plant that publishes only these gives a complete bag."""
    return [name(arm) for arm in arms for name in (joint_states, joint_command, controller_state, impact_event)]


def lacking(arms: Sequence[str], present: Collection[str], neighbours: Sequence[str] = ()) -> list[str]:
    """Topics of a trial without messages; ``/truth`` means all topics below it.

    Args:
        arms: Names of the arms.
        present: Topics with messages.
        neighbours: Names of the neighbours of the object.
    """
    # Up to version 0.1.0 all frames are on /tf.
    occasional = {TF_STATIC, DIAGNOSTICS, TRUTH_MODEL, *(impact_event(arm) for arm in arms)}
    absent = [
        topic for topic in recorded(arms, neighbours=neighbours) if topic not in present and topic not in occasional
    ]
    if any(_is_truth(topic) for topic in present):
        return absent
    return [topic for topic in absent if not _is_truth(topic)] + [TRUTH]


def _is_truth(topic: str) -> bool:
    return topic.startswith(f"{TRUTH}/")
