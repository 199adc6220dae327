# SPDX-License-Identifier: Apache-2.0
"""Sections of a mapping for the pose of an object, with their evidence."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from impact_rs_sim.errors import InputError
from impact_rs_trials.recordings.importing.candidates import COMMANDED, vector_width, width_of
from impact_rs_trials.recordings.importing.file_groups import OBJECT
from impact_rs_trials.recordings.importing.flange_path import MAX_RMS_RATIO, MAX_RMS_RATIO_OF_TARGET, FlangePath
from impact_rs_trials.recordings.importing.import_texts import flow
from impact_rs_trials.recordings.importing.moving_objects import moving_objects
from impact_rs_trials.recordings.importing.recorded_files import ImportedFiles, RecordedFile, axes_of, source_in
from impact_rs_trials.recordings.mapping import HEIGHT_ALONE, IN_A_PLANE, NO_ROBOT, SignalName, SignalSource
from impact_rs_trials.recordings.readers.guesses import (
    Guess,
    fall_in,
    quaternion_order,
    unit_of_flight,
    unit_of_length,
)
from impact_rs_trials.recordings.readers.series import Series
from impact_rs_trials.recordings.readers.sources import open_file
from impact_rs_trials.recordings.readers.transforms import are_transforms

MAX_SHOWN_POSES = 10  # in a message
OF_THE_ROBOT = re.compile(r"eef|(^|_)ee(_|$)|tcp|tool|flange|hand", re.IGNORECASE)
OF_A_POSE = re.compile(
    r"pos(ition)?|place|trans(lation)?|rot(ation)?|quat(ernion)?|ori(entation)?|[pqrtwxyz]|xyz|xyzw|wxyz"
)


class ObjectSections:
    """Describes the object of a recording.

    Args:
        files: Its files; findings are appended to their notes.
        flange: Path of the robot's flange; None: there is no robot.

    Attributes:
        groups: Files by kind and run; per-object files are merged to the object that moves.
        not_falling: Pairs of coordinates in a plane without free fall.
    """

    def __init__(self, files: ImportedFiles, flange: FlangePath | None = None) -> None:
        self._flange = flange
        self._files, self.groups, self._rate, self._notes = files.files, files.groups, files.rate, files.notes
        self.not_falling: list[str] = []

    def describe(
        self, joints: RecordedFile, with_robot: bool, signals: dict[str, dict[str, Any]]
    ) -> RecordedFile | None:
        """Pose of an object, if there is one; it is added to the signals."""
        for recorded in sorted(self._files, key=lambda recorded_file: recorded_file is joints and with_robot):
            for position, quaternion, by_name in poses_in(recorded, with_robot):
                sections = self._pose_sections(recorded, position, quaternion, by_name)
                if sections is None or self._is_of_the_tool(recorded, sections):
                    continue
                if with_robot and self.groups.several_files:
                    self._choose_objects(recorded, sections)
                self._note_other_poses(recorded, position)
                if with_robot:
                    for section in sections.values():
                        section |= recorded.own_layout(joints)
                signals |= sections
                return recorded
        return None if with_robot else self._ball(signals)

    def _is_of_the_tool(self, recorded: RecordedFile, sections: dict[str, dict[str, Any]]) -> bool:
        """Whether a pose is fixed on the flange of the robot, so that it is no object; if so it is noted."""
        if self._flange is None:
            return False
        name: SignalName = "object_pose" if "object_pose" in sections else "object_position"
        keys = {key: value for key, value in sections[name].items() if key != "file"}  # the file of a run, opened here
        source = SignalSource.model_validate(keys)
        raw = recorded.raw_mapping(NO_ROBOT, (), self._rate).model_copy(update={"signals": {name: source}})
        series = open_file(recorded.path, raw, recorded.names, (name,)).series(name, source)
        label = source.column or source.array or source.topic or ", ".join(source.columns or ())
        max_rms_ratio = MAX_RMS_RATIO_OF_TARGET if COMMANDED.search(label) else MAX_RMS_RATIO
        fixed_point = self._flange.carries(series.at(self._flange.time)[:, :3], max_rms_ratio)
        if fixed_point is None:
            return False
        distance, residual_rms = fixed_point
        self._notes.remarks.append(
            f"{label} is the pose of no object: it moves with the tip of the robot, {1e3 * distance:.3g} mm from it, "
            f"to {1e3 * residual_rms:.2g} mm (rms)"
        )
        return True

    def _note_other_poses(self, recorded: RecordedFile, used: dict[str, Any]) -> None:
        """Note further arrays and topics that may be poses and are not used."""
        unused = [candidate.label for candidate in recorded.candidates if candidate.pose and candidate.source != used]
        if unused:
            self._notes.remarks.append(
                f"{recorded.path.name} holds other poses, which are not used: {', '.join(unused[:MAX_SHOWN_POSES])}"
                + (f" and {len(unused) - MAX_SHOWN_POSES} more" if len(unused) > MAX_SHOWN_POSES else "")
            )

    def _choose_objects(self, recorded: RecordedFile, sections: dict[str, dict[str, Any]]) -> None:
        """If every run has a file of each of several objects, take the file of the moving object."""
        sources = {name: SignalSource.model_validate(section) for name, section in sections.items()}
        mapping = recorded.raw_mapping(NO_ROBOT, (), self._rate).model_copy(update={"signals": sources})
        merged = moving_objects(self.groups, recorded.pattern, mapping)
        if merged is None:
            return
        self.groups, pattern, objects = merged
        for section in sections.values():
            section["file"] = pattern
        self._notes.add(f"{OBJECT} of {pattern}", flow(objects), "in every run the object that moves most")

    def _ball(self, signals: dict[str, dict[str, Any]]) -> RecordedFile | None:
        """Add positions of an object without tracked orientation, such as a ball, to the signals."""
        for recorded in self._files:
            names = [name for name, cells in recorded.columns.items() if vector_width(cells) == 1]
            positions, _, planes = axes_of(names)
            heights = [] if positions or planes else [[name] for name in names if name not in recorded.clock_columns]
            for columns in (*positions, *planes, *heights):
                file = open_file(
                    recorded.path, recorded.raw_mapping(NO_ROBOT, (), self._rate), recorded.names, ("object_position",)
                )
                track = file.series("object_position", SignalSource(unit="m", columns=tuple(columns)))
                if len(columns) in (IN_A_PLANE, HEIGHT_ALONE):
                    falling = fall_in(track.time, track.values[:, [0, 2] if len(columns) == IN_A_PLANE else [2]])
                    # A column of many may resemble a fall in some unit; only a fall by g in a known unit is a height.
                    if falling is None or (len(columns) == HEIGHT_ALONE and not falling[1].sure):
                        self.not_falling += [", ".join(columns)] if len(columns) == IN_A_PLANE else []
                        continue
                    up, unit = falling
                    columns = [*columns[:up], *columns[up + 1 :], columns[up]]
                else:
                    unit = unit_of_flight(track.time, track.values)
                self._notes.add("signals.object_position", ", ".join(columns), unit.evidence, unit.sure)
                self._notes.remarks.append(
                    "no column is its orientation: enough for a ball only, with its spin (body.spin)"
                )
                signals["object_position"] = {
                    **source_in(recorded, {"columns": columns}, self.groups),
                    "unit": unit.value,
                    **unit.further,
                }
                return recorded
        return None

    def _length(self, track: Series) -> Guess:
        """Unit of the positions of a body; near a robot it slides, and friction may resemble g in another unit."""
        position = track.values[:, :3]
        return unit_of_flight(track.time, position) if self._flange is None else unit_of_length(position)

    def _pose_sections(
        self, recorded: RecordedFile, position: dict[str, Any], quaternion: dict[str, Any] | None, by_name: bool
    ) -> dict[str, dict[str, Any]] | None:
        source = position if quaternion is None else None
        file = open_file(
            recorded.path, recorded.raw_mapping(NO_ROBOT, (), self._rate, source), recorded.names, ("object_pose",)
        )

        def track(name: SignalName, source: dict[str, Any]) -> Series | None:
            unit = "-" if name == "object_quaternion" else "m"
            try:
                return file.series(name, SignalSource.model_validate({"unit": unit, **source}))
            except InputError:
                return None

        label = (
            position.get("column")
            or position.get("array")
            or position.get("topic")
            or ", ".join(position.get("columns", ()))
        )
        if quaternion is None:
            pose = track("object_pose", position)
            order = None if pose is None else quaternion_order(pose.values[:, 3:])
            if order is None or pose is None:
                return None
            length = self._length(pose)
            matrices = are_transforms(np.shape(recorded.columns.get(position.get("array", ""), ())))
            if matrices:
                order = Guess("xyzw", "")
            evidence = "holds homogeneous matrices" if matrices else "holds a position and a unit quaternion"
            self._notes.add("signals.object_pose", label, evidence)
            evidence = "; ".join(filter(None, (length.evidence, order.evidence)))
            self._notes.add("signals.object_pose.unit", length.value, evidence, length.sure and order.sure)
            further = {} if order.value == "xyzw" else {"quaternion_order": order.value}
            return {"object_pose": {**source_in(recorded, position, self.groups), "unit": length.value, **further}}
        positions, quaternions = track("object_position", position), track("object_quaternion", quaternion)
        order = None if quaternions is None else quaternion_order(quaternions.values)
        if positions is None or order is None:
            return None
        length = self._length(positions)
        if names := quaternion.get("columns"):
            order = Guess("wxyz" if names[0].lower().endswith("w") else "xyzw", "the names of its columns")
        further = {} if order.value == "xyzw" else {"quaternion_order": order.value}
        turned_label = quaternion.get("column") or quaternion.get("array") or ", ".join(names or ())
        pairing = "by their names" if by_name else "by order alone"
        evidence = f"taken for the position of the body with the orientation {turned_label}, {pairing}"
        self._notes.add("signals.object_position", label, evidence, by_name)
        self._notes.add("signals.object_position.unit", length.value, length.evidence, length.sure)
        self._notes.add("signals.object_quaternion", order.value, order.evidence, order.sure and by_name)
        return {
            "object_position": {**source_in(recorded, position, self.groups), "unit": length.value},
            "object_quaternion": {**source_in(recorded, quaternion, self.groups), "unit": "-", **further},
        }


def poses_in(recorded: RecordedFile, with_robot: bool) -> list[tuple[dict[str, Any], dict[str, Any] | None, bool]]:
    """Sources of a pose: seven numbers, or position and quaternion, and whether these are paired by name."""
    poses = [
        (candidate.source, None, True)
        for candidate in recorded.candidates
        if candidate.pose or candidate.width == 7 and not with_robot
    ]
    vectors = {name: vector_width(cells) for name, cells in recorded.columns.items()}
    sources = {name: {"column": name} for name in vectors}
    for name, column in recorded.columns.items():  # arrays of an array file are no columns
        if isinstance(column, np.ndarray) and column.ndim == 2:
            vectors[name], sources[name] = width_of(column.shape), {"array": name}
    names = [name for name in vectors if not (with_robot and OF_THE_ROBOT.search(name))]
    groups = axes_of(names)
    positions: list[dict[str, Any]] = [sources[name] for name in names if vectors[name] == 3]
    positions += [{"columns": columns} for columns in groups[0]]
    quaternions: list[dict[str, Any]] = [sources[name] for name in names if vectors[name] == 4]
    quaternions += [{"columns": columns} for columns in groups[1]]
    return [*poses, *_paired(positions, quaternions)]


def _paired(
    positions: Sequence[dict[str, Any]], quaternions: Sequence[dict[str, Any]]
) -> Iterator[tuple[dict[str, Any], dict[str, Any], bool]]:
    """Pairs of positions and quaternions, by name, then by order; and whether by name."""
    unpaired = list(quaternions)
    positions_alone = []
    for position in positions:
        partner = next((quaternion for quaternion in unpaired if _body_of(quaternion) == _body_of(position)), None)
        if partner is None:
            positions_alone.append(position)
        else:
            unpaired.remove(partner)
            yield position, partner, True
    single_pair = len(positions) == len(quaternions) == 1
    yield from (
        (position, quaternion, single_pair) for position, quaternion in zip(positions_alone, unpaired, strict=False)
    )


def _body_of(source: dict[str, Any]) -> tuple[str, ...]:
    """Words of a source that name the body: the common words of its columns except those for a pose."""
    columns = source.get("columns") or [source.get("column") or source.get("array") or ""]
    words = [re.findall(r"[A-Z]?[a-z]+|[A-Z]+|\d+", name) for name in columns]
    common = [word.lower() for word in words[0] if all(word in other_words for other_words in words)]
    return tuple(word for word in common if not OF_A_POSE.fullmatch(word))
