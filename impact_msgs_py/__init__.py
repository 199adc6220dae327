# SPDX-License-Identifier: Apache-2.0
"""Typed ROS interfaces of ``impact_rs`` and their conversions to and from NumPy."""

from impact_rs.action import RunCampaign, RunTrial
from impact_rs.msg import (
    ContactPoint,
    ControllerState,
    ImpactEvent,
    ImpactResidual,
    ObjectDescription,
    RigidBodyTwist,
    RobotState,
    TrialInfo,
    TrialOutcome,
)
from impact_rs.srv import ComputeImpactMap, ConfigureTrial, FinishTrial

__all__ = [
    "ComputeImpactMap",
    "ConfigureTrial",
    "ContactPoint",
    "ControllerState",
    "FinishTrial",
    "ImpactEvent",
    "ImpactResidual",
    "ObjectDescription",
    "RigidBodyTwist",
    "RobotState",
    "RunCampaign",
    "RunTrial",
    "TrialInfo",
    "TrialOutcome",
]
