# SPDX-License-Identifier: Apache-2.0
"""A laboratory with its own controller: scenario, mappings and motion capture of its runs."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from impact_rs_sim.errors import InputError
from impact_rs_sim.physics import Physics
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_sim.scenarios.scenario import Scenario
from impact_rs_trials.recordings.checks.clock_offset import OBJECT_SIGNALS
from impact_rs_trials.recordings.checks.faults import without_faults
from impact_rs_trials.recordings.contact_frame import ContactFrame, PadOnFace, contact_frame
from impact_rs_trials.recordings.experiment import FRICTION_SIGMA_SHARE, Experiment, MotionCapture, RunRow
from impact_rs_trials.recordings.mapping import REQUIRED, SignalName
from impact_rs_trials.recordings.mapping import Mapping as SignalMapping
from impact_rs_trials.recordings.readers.series import Names, Series
from impact_rs_trials.recordings.readers.sources import read_series

ArmSeries = dict[SignalName, Series]


@dataclass(frozen=True)
class Laboratory:
    """Common properties of the runs of an experiment.

    Attributes:
        scenario: Robots, objects and support.
        mappings: Where the signals of each arm are.
        motion_capture: Placement of its world.
        estimated_frame: Its estimate from hits; None: it was given.
        friction_noise: Relative standard deviation of the friction of the scenario's support [-].
    """

    scenario: Scenario
    mappings: Mapping[str, SignalMapping]
    motion_capture: MotionCapture
    estimated_frame: ContactFrame | None = None
    friction_noise: float = FRICTION_SIGMA_SHARE

    @classmethod
    def of(cls, experiment: Experiment) -> Laboratory:
        """Scenario and mappings of an experiment, which must fit each other.

        Raises:
            InputError: They do not fit, or signals of two arms are the same.
        """

        def location(arm: str | None) -> dict[str, Any]:
            mapping = experiment.mapping
            if isinstance(mapping, str):
                return {"file": experiment.file, "key": "mapping", "value": mapping}
            if arm is None:
                return {"file": experiment.file, "key": "mapping"}
            return {"file": experiment.file, "key": f"mapping.{arm}", "value": mapping[arm]}

        scenario = experiment.load_scenario()
        mappings = experiment.load_mappings(scenario.robots)
        laboratory = cls.checked(scenario, mappings, experiment.motion_capture, location)
        return replace(laboratory, friction_noise=experiment.friction_noise)

    @classmethod
    def checked(
        cls,
        scenario: Scenario,
        mappings: Mapping[str, SignalMapping],
        motion_capture: MotionCapture,
        location: Callable[[str | None], Mapping[str, Any]],
    ) -> Laboratory:
        """Scenario and mappings, which must fit each other.

        Args:
            scenario: Robots, objects and support.
            mappings: Where the signals of each arm are.
            motion_capture: Placement of its world.
            location: File, key and value for errors about the mapping of an arm; None: about the mappings of all arms.

        Raises:
            InputError: They do not fit, or signals of two arms are the same.
        """
        for arm, mapping in mappings.items():
            robot = scenario.robots[arm]
            if robot.robot_facts != mapping.facts:
                raise InputError(
                    f"the mapping is for robot {mapping.robot!r}, arm {arm!r} of scenario {scenario.name!r} is "
                    f"{robot.facts_name!r}; expected the same",
                    **location(arm),
                )
            if mapping.torque_measured_at != "link":
                raise InputError(
                    "torque_measured_at is 'motor' in the mapping; runs with contact need the torque behind the gears "
                    "(link), the commanded torque of the motors is signals.command",
                    **location(arm),
                )
        for first, second in itertools.combinations(mappings, 2):
            common_signals = mappings[first].signals.keys() & mappings[second].signals.keys()
            for name in (name for name in REQUIRED if name in common_signals):
                if _where(mappings[first], first, name) == _where(mappings[second], second, name):
                    raise InputError(
                        f"{name} of arms {first!r} and {second!r} would be the same numbers; expected {{arm}} for the "
                        "name of an arm in a topic, a column or the joints, or a mapping for each arm, mapping: "
                        f"{{{first}: ..., {second}: ...}}",
                        **location(None),
                    )
        return cls(scenario, mappings, motion_capture)

    @functools.cached_property
    def models(self) -> dict[str, RobotModel]:
        """Nominal rigid-body models of the arms."""
        physics = Physics.nominal(self.scenario, next(iter(self.scenario.objects)))
        return {arm: physics.robot_model(arm) for arm in self.mappings}

    @property
    def tracker(self) -> str:
        """The arm whose mapping has the pose of the object; the first arm if no mapping has it."""
        tracking = (arm for arm, mapping in self.mappings.items() if set(OBJECT_SIGNALS) & set(mapping.signals))
        return next(tracking, next(iter(self.mappings)))

    def series(self, run: RunRow, wanted: Sequence[SignalName], needed: Sequence[SignalName]) -> dict[str, ArmSeries]:
        """Signals of every arm at the timestamps of the files; :attr:`tracker` has the object's signals.

        Args:
            run: The run.
            wanted: Signals to read, as far as a mapping has them.
            needed: Those of them that must be there.

        Raises:
            InputError: A needed signal is missing, or a signal cannot be used.
        """
        series = {}
        for arm, mapping in self.mappings.items():
            names = Names(object=run.object or "*", arm=arm, run=run.name)
            names_of_arm = [name for name in wanted if name not in OBJECT_SIGNALS or arm == self.tracker]
            with self.errors_of(arm):
                series[arm] = read_series(run.path, mapping, names_of_arm, set(needed) & set(names_of_arm), names)
        return series

    def without_faults(self, arm: str, series: ArmSeries, hit: bool) -> tuple[ArmSeries, list[str]]:
        """Signals of an arm without outliers and frozen samples, and warnings about them."""
        return without_faults(series, self.mappings[arm], self.models[arm], hit)

    @contextmanager
    def errors_of(self, arm: str) -> Iterator[None]:
        """Prefix errors raised inside with the arm's name if there are several arms."""
        try:
            yield
        except InputError as error:
            if len(self.mappings) == 1:
                raise
            message = f"{self.label(arm)}{error.message}"
            raise type(error)(message, file=error.file, key=error.key, value=error.value) from None

    def label(self, arm: str) -> str:
        """Prefix of a message about an arm; empty with a single arm."""
        return f"arm {arm!r}: " if len(self.mappings) > 1 else ""

    def with_frame_from(self, touches: Sequence[PadOnFace]) -> Laboratory:
        """The laboratory with the motion-capture frame estimated from hits.

        Raises:
            InputError: There is no hit.
        """
        given = self.motion_capture
        frame = contact_frame(touches, np.array(given.position), given.rpy[2])
        x, y, z = (float(number) for number in frame.position)
        update = {"position": (x, y, z), "rpy": (*given.rpy[:2], frame.yaw)}
        return replace(self, motion_capture=given.model_copy(update=update), estimated_frame=frame)


def _where(mapping: SignalMapping, arm: str, name: SignalName) -> tuple[str | None, ...]:
    """Topic, file and fields of a signal of an arm."""
    source, names = mapping.signals[name], Names(arm=arm)
    parts = (source.topic, source.field, source.file, source.column, source.array, *(source.columns or ()))
    joints = mapping.joints if source.names else ()
    return tuple(None if part is None else names.fill(part) for part in (*parts, *joints))
