# SPDX-License-Identifier: Apache-2.0
"""The envelope of a real cell (``envelope.yaml``): which trials may run on it at all.

Speeds follow from the references, impulses from the impact map; the motion of the real arm is limited by the cell
(:mod:`impact_rs_control.arm_limits`). The file has the operator's limits, in physical units and in names.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pydantic import Field

from impact_rs_sim.errors import InputError
from impact_rs_sim.schema import Positive, Schema
from impact_rs_trials.spec import TrialSpec

LIMIT_ROUNDING_SHARE = 1e-9  # of a limit; a case may be designed to reach it exactly


@dataclass(frozen=True)
class Demand:
    """Demands of a trial on a cell.

    Attributes:
        speed: Largest reference speed of an end effector [m/s].
        joint_speed: Largest ante-impact speed of a joint over its limit [-].
        impulse: Predicted impulse on the object, sum over its contacts with arms [N s]; 0 without an impact.
    """

    speed: float
    joint_speed: float
    impulse: float


class CellEnvelope(Schema):
    """Trials that may run on a cell."""

    scenarios: tuple[str, ...] = Field(min_length=1, description="names of the scenarios")
    objects: tuple[str, ...] = Field((), description="names of the objects that may be hit; none: all of the scenarios")
    cases: tuple[str, ...] = Field((), description="full names of the cases; none: all of the scenarios")
    speed: Positive = Field(description="largest reference speed of an end effector [m/s]")
    joint_speed: Positive = Field(
        0.8, description="largest speed of a joint at the impact, over the limit of the robot [-]"
    )
    impulse: Positive = Field(description="largest predicted impulse on the object [N s]")

    def complaint(self, spec: TrialSpec) -> str:
        """Reason why a trial is outside of the envelope; empty: it is inside.

        Raises:
            InputError: The trial cannot be planned.
        """
        objects = self.objects if spec.scenario.excursion is None else ()  # a free motion touches none
        names = ((spec.scenario.name, self.scenarios), (spec.object, objects), (spec.case, self.cases))
        for name, allowed in names:
            if allowed and name not in allowed:
                return f"{name} is not in the envelope ({', '.join(allowed)})"
        motion = demand_of(spec)
        for quantity, value, limit, unit in (
            ("reference speed", motion.speed, self.speed, " m/s"),
            ("speed of a joint over its limit", motion.joint_speed, self.joint_speed, ""),
            ("predicted impulse", motion.impulse, self.impulse, " N s"),
        ):
            if not value <= limit * (1.0 + LIMIT_ROUNDING_SHARE):
                return f"{quantity} {value:.3g}{unit}, the envelope allows {limit:g}{unit}"
        return ""

    def check(self, spec: TrialSpec) -> None:
        """Refuse a trial that is outside.

        Raises:
            InputError: It is outside, or cannot be planned.
        """
        if complaint := self.complaint(spec):
            raise InputError(f"{spec.scenario.name}/{spec.object}/{spec.case} leaves the envelope: {complaint}")


def demand_of(spec: TrialSpec) -> Demand:
    """Demands of a trial on a cell, by its references and the impact map."""
    plan = spec.plan
    paths = [path for arm in plan.arms.values() for path in (arm.ante_position, arm.post_position)]
    speed = max(float(np.linalg.norm(path.velocity, axis=1).max()) for path in paths)
    share = 0.0
    for name, model in plan.scene.models.items():
        velocity = plan.scene.arms[name].velocity
        share = max(share, float(np.max(np.abs(velocity) / model.velocity_max)))
    contacts = () if plan.impact is None else plan.impact.contacts
    impulses = [contact.impulse for contact in contacts if contact.body_b in plan.arms]
    return Demand(speed, share, float(np.linalg.norm(np.sum(impulses, axis=0))) if impulses else 0.0)
