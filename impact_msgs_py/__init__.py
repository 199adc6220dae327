# SPDX-License-Identifier: Apache-2.0
"""Typed ROS interfaces of ``impact_rs`` and their conversions to and from NumPy."""

from impact_rs.action import (
    RunCampaign,
    RunTrial,
)
from impact_rs.msg import (
    CellChange,
    ChangeCause,
    ChangeDiagnosis,
    ContactPoint,
    ControllerState,
    HitPrediction,
    ImpactEvent,
    ImpactObject,
    ImpactProblem,
    ImpactResidual,
    ObjectDescription,
    ParameterEstimate,
    PredictedValue,
    RefusedHit,
    RigidBodyTwist,
    RobotState,
    TrialInfo,
    TrialOutcome,
)
from impact_rs.srv import (
    ComputeImpactMap,
    ConfigureTrial,
    FinishTrial,
    ImpactDerivatives,
    ImpactIntervals,
    PredictImpact,
)

__all__ = [
    "CellChange",
    "ChangeCause",
    "ChangeDiagnosis",
    "ComputeImpactMap",
    "ConfigureTrial",
    "ContactPoint",
    "ControllerState",
    "FinishTrial",
    "HitPrediction",
    "ImpactDerivatives",
    "ImpactEvent",
    "ImpactIntervals",
    "ImpactObject",
    "ImpactProblem",
    "ImpactResidual",
    "ObjectDescription",
    "ParameterEstimate",
    "PredictImpact",
    "PredictedValue",
    "RefusedHit",
    "RigidBodyTwist",
    "RobotState",
    "RunCampaign",
    "RunTrial",
    "TrialInfo",
    "TrialOutcome",
]
