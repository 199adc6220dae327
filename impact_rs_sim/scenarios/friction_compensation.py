# SPDX-License-Identifier: Apache-2.0
"""Friction compensation files: feedforward of the control tasks against joint friction (paper Appendix A).

``impact-rs friction identify`` writes such a file for one scenario, which then names it. A recorded scenario holds its
content, so that a bag is complete.
"""

from __future__ import annotations

import numpy as np
from pydantic import Field

from impact_rs_sim.errors import InputError, did_you_mean
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.schema import Schema, Vector


class AccelerationSamples(Schema):
    """Acceleration of the control tasks over the trial, one entry per period from the start on, in frame A."""

    x: Vector = Field(description="of E along x [m/s^2]")
    y: Vector = Field(description="of E along y [m/s^2]")
    z: Vector = Field(description="of E along z [m/s^2]")
    rotation_x: Vector = Field(description="of E about x [rad/s^2]")
    rotation_y: Vector = Field(description="of E about y [rad/s^2]")
    rotation_z: Vector = Field(description="of E about z [rad/s^2]")
    joint_1: Vector = Field(description="of the first joint [rad/s^2]")

    @staticmethod
    def of(rows: Array) -> AccelerationSamples:
        """From samples ``(k, 7)`` in the order of :data:`TASKS`."""
        return AccelerationSamples(**dict(zip(TASKS, rows.T.tolist(), strict=True)))

    @property
    def rows(self) -> Array:
        """Samples, ``(k, 7)``, in the order of :data:`TASKS`."""
        return np.column_stack([getattr(self, task) for task in TASKS])

    def at(self, times: Array, period: float) -> Array:
        """Interpolated at ``times`` ``(k,)`` [s], ``(k, 7)``; one sample per ``period`` [s]."""
        sample_times = np.arange(len(self.x)) * period
        return np.column_stack([np.interp(times, sample_times, getattr(self, task)) for task in TASKS])


TASKS = tuple(AccelerationSamples.model_fields)
"""Rows of the control tasks: position and orientation of E in A, posture."""


class ArmFriction(Schema):
    """Feedforward of one arm for one object and case."""

    ante: AccelerationSamples = Field(description="a^a_fric, of the ante-impact mode")
    post: AccelerationSamples = Field(description="a^p_fric, of interim and post-impact mode")


class FrictionCompensation(Schema):
    """Feedforward against joint friction, identified for one scenario."""

    scenario: str = Field(description="name of the scenario that it was identified on")
    scenario_digest: str = Field(description="digest of that scenario; another scenario is refused")
    runs: int = Field(ge=1, description="identification runs behind every average, in each turn")
    seed: int = Field(ge=0, description="seed of their scatter and noise")
    period: float = Field(gt=0.0, description="time between two samples [s]")
    sets: dict[str, dict[str, dict[str, ArmFriction]]] = Field(
        min_length=1, description="feedforward by object, full name of the case, and arm"
    )

    def arms(self, object_name: str, case_name: str) -> dict[str, ArmFriction]:
        """Feedforward by arm of one set.

        Raises:
            InputError: It was not identified for this object and case.
        """
        cases = self.sets.get(object_name, {})
        if case_name not in cases:
            sets = ", ".join(f"{name} {case}" for name, entry in self.sets.items() for case in entry)
            raise InputError(
                f"the friction compensation was not identified for {object_name} {case_name}; it has: {sets}"
            )
        return cases[case_name]

    def check(self, name: str, digest: str, sets: dict[str, dict[str, set[str]]], duration: float) -> None:
        """Check it against its scenario.

        Args:
            name: Name of the scenario.
            digest: Digest of the scenario.
            sets: Arms of the scenario by object and case.
            duration: Length of a trial [s].

        Raises:
            InputError: An object, case or arm is unknown, an arm has no entry, a number of samples is wrong, or the
                scenario differs from the one of the identification. The key is that of this file.
        """
        count = int(duration / self.period + 1e-9) + 1
        for object_name, cases in self.sets.items():
            self._known(f"sets.{object_name}", object_name, "object", set(sets))
            for case_name, arms in cases.items():
                key_path = f"sets.{object_name}.{case_name}"
                self._known(key_path, case_name, "case", set(sets[object_name]))
                expected = sets[object_name][case_name]
                for arm in arms:
                    self._known(f"{key_path}.{arm}", arm, "arm", expected)
                if missing := expected - set(arms):
                    raise InputError(f"arm {min(missing)!r} is missing", key=key_path)
                for arm, friction in arms.items():
                    self._count(f"{key_path}.{arm}", friction, count, duration)
        if self.scenario_digest != digest:
            raise InputError(
                f"identified on another version of scenario {self.scenario!r} than this {name!r} (digest {digest}); "
                "identify it again",
                key="scenario_digest",
                value=self.scenario_digest,
            )

    @staticmethod
    def _known(key_path: str, name: str, kind: str, names: set[str]) -> None:
        if name not in names:
            raise InputError(
                f"the scenario has no such {kind}; it has: {', '.join(sorted(names))}{did_you_mean(name, names)}",
                key=key_path,
            )

    def _count(self, key_path: str, friction: ArmFriction, count: int, duration: float) -> None:
        for phase in ("ante", "post"):
            for task in TASKS:
                length = len(getattr(getattr(friction, phase), task))
                if length != count:
                    raise InputError(
                        f"{length} samples, expected {count}: one per {self.period:g} s of the trial's {duration:g} s",
                        key=f"{key_path}.{phase}.{task}",
                    )
