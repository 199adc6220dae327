# SPDX-License-Identifier: Apache-2.0
"""Topic names and types; the only place they are spelled.

Per arm: ``/ARM/...``. Everything below ``/truth`` comes from the plant and is never read by the analysis.
"""

from __future__ import annotations

CLOCK = "/clock"
TRIAL_INFO = "/trial_info"
ROBOT_DESCRIPTION = "/robot_description"
TF = "/tf"
DIAGNOSTICS = "/diagnostics"
OBJECT_POSE = "/object/pose"
TRUTH = "/truth"
TRUTH_MODEL = "/truth/model"
TRUTH_OBJECT_POSE = "/truth/object/pose"
TRUTH_OBJECT_TWIST = "/truth/object/twist"


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


def recorded(arms: list[str], truth: bool = True) -> dict[str, str]:
    """Every recorded topic of a trial with its type; those below ``/truth`` only where there is somebody to tell it."""
    topics = {
        CLOCK: CLOCK_TYPE,
        TRIAL_INFO: TRIAL_INFO_TYPE,
        ROBOT_DESCRIPTION: STRING,
        TF: TF_MESSAGE,
        DIAGNOSTICS: DIAGNOSTIC_ARRAY,
        OBJECT_POSE: POSE,
        TRUTH_MODEL: STRING,
        TRUTH_OBJECT_POSE: POSE,
        TRUTH_OBJECT_TWIST: TWIST,
    }
    for arm in arms:
        topics |= {
            joint_states(arm): JOINT_STATE,
            motor_states(arm): JOINT_STATE,
            joint_command(arm): JOINT_STATE,
            controller_state(arm): CONTROLLER_STATE,
            impact_event(arm): IMPACT_EVENT,
            truth_joint_states(arm): JOINT_STATE,
            truth_contact_wrench(arm): WRENCH,
        }
    return {topic: kind for topic, kind in topics.items() if truth or not topic.startswith(f"{TRUTH}/")}
