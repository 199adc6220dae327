# SPDX-License-Identifier: Apache-2.0
"""Sections of a mapping for the pose of an object, with their evidence."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from impact_rs_sim.errors import InputError
from impact_rs_trials.recordings.importing.candidates import vector_width, width_of
from impact_rs_trials.recordings.importing.file_groups import OBJECT
from impact_rs_trials.recordings.importing.flange_path import MAX_RMS_RATIO, MAX_RMS_RATIO_OF_TARGET, FlangePath
from impact_rs_trials.recordings.importing.import_texts import flow
from impact_rs_trials.recordings.importing.joint_streams import COMMANDED
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
        self._parts, self.groups, self._rate, self._notes = files.parts, files.groups, files.rate, files.notes
        self.not_falling: list[str] = []

    def describe(
        self, joints: RecordedFile, with_robot: bool, signals: dict[str, dict[str, Any]]
    ) -> RecordedFile | None:
        """Pose of an object, if there is one; it is added to the signals."""
        for part in sorted(self._parts, key=lambda one: one is joints and with_robot):
            for place, quaternion, named in poses_in(part, with_robot):
                found = self._pose_sections(part, place, quaternion, named)
                if found is None or self._is_of_the_tool(part, found):
                    continue
                if with_robot and self.groups.spread:
                    self._choose_objects(part, found)
                self._say_other_poses(part, place)
                if with_robot:
                    for section in found.values():
                        section |= part.own_layout(joints)
                signals |= found
                return part
        return None if with_robot else self._ball(signals)

    def _is_of_the_tool(self, part: RecordedFile, sections: dict[str, dict[str, Any]]) -> bool:
        """Whether a pose is fixed on the flange of the robot, so that it is no object's; a note names it."""
        if self._flange is None:
            return False
        name: SignalName = "object_pose" if "object_pose" in sections else "object_position"
        own = {key: one for key, one in sections[name].items() if key != "file"}  # the file of a run, opened here
        source = SignalSource.model_validate(own)
        raw = part.raw_mapping(NO_ROBOT, (), self._rate).model_copy(update={"signals": {name: source}})
        series = open_file(part.path, raw, part.names, (name,)).series(name, source)
        label = source.column or source.array or source.topic or ", ".join(source.columns or ())
        most = MAX_RMS_RATIO_OF_TARGET if COMMANDED.search(label) else MAX_RMS_RATIO
        carried = self._flange.carries(series.at(self._flange.time)[:, :3], most)
        if carried is None:
            return False
        where, left = carried
        self._notes.remarks.append(
            f"{label} is no object's: it moves with the tip of the robot, {1e3 * where:.3g} mm from it, to "
            f"{1e3 * left:.2g} mm (rms)"
        )
        return True

    def _say_other_poses(self, part: RecordedFile, taken: dict[str, Any]) -> None:
        """Note further arrays and topics that may be poses and are not used."""
        others = [one.label for one in part.candidates if one.pose and one.source != taken]
        if others:
            self._notes.remarks.append(
                f"{part.path.name} holds other poses, which are not used: {', '.join(others[:MAX_SHOWN_POSES])}"
                + (f" and {len(others) - MAX_SHOWN_POSES} more" if len(others) > MAX_SHOWN_POSES else "")
            )

    def _choose_objects(self, part: RecordedFile, sections: dict[str, dict[str, Any]]) -> None:
        """If every run has a file of each of several objects, take the file of the moving object."""
        sources = {name: SignalSource.model_validate(section) for name, section in sections.items()}
        mapping = part.raw_mapping(NO_ROBOT, (), self._rate).model_copy(update={"signals": sources})
        found = moving_objects(self.groups, part.pattern, mapping)
        if found is None:
            return
        self.groups, pattern, objects = found
        for section in sections.values():
            section["file"] = pattern
        self._notes.add(f"{OBJECT} of {pattern}", flow(objects), "in every run the object that moves most")

    def _ball(self, signals: dict[str, dict[str, Any]]) -> RecordedFile | None:
        """Add positions of an object without tracked orientation, such as a ball, to the signals."""
        for part in self._parts:
            names = [name for name, cells in part.columns.items() if vector_width(cells) == 1]
            places, _, planes = axes_of(names)
            heights = [] if places or planes else [[name] for name in names if name not in part.clock_columns]
            for columns in (*places, *planes, *heights):
                file = open_file(
                    part.path, part.raw_mapping(NO_ROBOT, (), self._rate), part.names, ("object_position",)
                )
                track = file.series("object_position", SignalSource(unit="m", columns=tuple(columns)))
                if len(columns) in (IN_A_PLANE, HEIGHT_ALONE):
                    falling = fall_in(track.time, track.values[:, [0, 2] if len(columns) == IN_A_PLANE else [2]])
                    # One column of many may bend like a fall in some unit; only a fall by g in a known one is a height.
                    if falling is None or (len(columns) == HEIGHT_ALONE and not falling[1].sure):
                        self.not_falling += [", ".join(columns)] if len(columns) == IN_A_PLANE else []
                        continue
                    up, length = falling
                    columns = [*columns[:up], *columns[up + 1 :], columns[up]]
                else:
                    length = unit_of_flight(track.time, track.values)
                self._notes.add("signals.object_position", ", ".join(columns), length.evidence, length.sure)
                self._notes.remarks.append(
                    "no column is its orientation: enough for a ball only, with its spin (body.spin)"
                )
                signals["object_position"] = {
                    **source_in(part, {"columns": columns}, self.groups),
                    "unit": length.value,
                    **length.further,
                }
                return part
        return None

    def _length(self, track: Series) -> Guess:
        """Unit of a body's positions; one near a robot slides, and its friction may resemble g in another unit."""
        place = track.values[:, :3]
        return unit_of_flight(track.time, place) if self._flange is None else unit_of_length(place)

    def _pose_sections(
        self, part: RecordedFile, place: dict[str, Any], quaternion: dict[str, Any] | None, named: bool
    ) -> dict[str, dict[str, Any]] | None:
        source = place if quaternion is None else None
        file = open_file(part.path, part.raw_mapping(NO_ROBOT, (), self._rate, source), part.names, ("object_pose",))

        def track(name: SignalName, source: dict[str, Any]) -> Series | None:
            unit = "-" if name == "object_quaternion" else "m"
            try:
                return file.series(name, SignalSource.model_validate({"unit": unit, **source}))
            except InputError:
                return None

        label = place.get("column") or place.get("array") or place.get("topic") or ", ".join(place.get("columns", ()))
        if quaternion is None:
            pose = track("object_pose", place)
            order = None if pose is None else quaternion_order(pose.values[:, 3:])
            if order is None or pose is None:
                return None
            length = self._length(pose)
            matrices = are_transforms(np.shape(part.columns.get(place.get("array", ""), ())))
            if matrices:
                order = Guess("xyzw", "")
            evidence = "holds homogeneous matrices" if matrices else "holds a position and a unit quaternion"
            self._notes.add("signals.object_pose", label, evidence)
            evidence = "; ".join(filter(None, (length.evidence, order.evidence)))
            self._notes.add("signals.object_pose.unit", length.value, evidence, length.sure and order.sure)
            further = {} if order.value == "xyzw" else {"quaternion_order": order.value}
            return {"object_pose": {**source_in(part, place, self.groups), "unit": length.value, **further}}
        where, turned = track("object_position", place), track("object_quaternion", quaternion)
        order = None if turned is None else quaternion_order(turned.values)
        if where is None or order is None:
            return None
        length = self._length(where)
        if names := quaternion.get("columns"):
            order = Guess("wxyz" if names[0].lower().endswith("w") else "xyzw", "the names of its columns")
        further = {} if order.value == "xyzw" else {"quaternion_order": order.value}
        turned_label = quaternion.get("column") or quaternion.get("array") or ", ".join(names or ())
        how = "by their names" if named else "by order alone"
        evidence = f"taken for the position of the body with the orientation {turned_label}, {how}"
        self._notes.add("signals.object_position", label, evidence, named)
        self._notes.add("signals.object_position.unit", length.value, length.evidence, length.sure)
        self._notes.add("signals.object_quaternion", order.value, order.evidence, order.sure and named)
        return {
            "object_position": {**source_in(part, place, self.groups), "unit": length.value},
            "object_quaternion": {**source_in(part, quaternion, self.groups), "unit": "-", **further},
        }


def poses_in(part: RecordedFile, with_robot: bool) -> list[tuple[dict[str, Any], dict[str, Any] | None, bool]]:
    """Sources of a pose: seven numbers, or position and quaternion, and whether these are paired by name."""
    whole = [(one.source, None, True) for one in part.candidates if one.pose or one.width == 7 and not with_robot]
    vectors = {name: vector_width(cells) for name, cells in part.columns.items()}
    sources = {name: {"column": name} for name in vectors}
    for name, column in part.columns.items():  # arrays of an array file are no columns
        if isinstance(column, np.ndarray) and column.ndim == 2:
            vectors[name], sources[name] = width_of(column.shape), {"array": name}
    names = [name for name in vectors if not (with_robot and OF_THE_ROBOT.search(name))]
    groups = axes_of(names)
    places = [sources[name] for name in names if vectors[name] == 3] + [{"columns": own} for own in groups[0]]
    turns = [sources[name] for name in names if vectors[name] == 4] + [{"columns": own} for own in groups[1]]
    return [*whole, *_paired(places, turns)]


def _paired(
    places: Sequence[dict[str, Any]], turns: Sequence[dict[str, Any]]
) -> Iterator[tuple[dict[str, Any], dict[str, Any], bool]]:
    """Pairs of positions and quaternions, by name, then by order; and whether by name."""
    free = list(turns)
    left = []
    for place in places:
        own = next((turn for turn in free if _body_of(turn) == _body_of(place)), None)
        if own is None:
            left.append(place)
        else:
            free.remove(own)
            yield place, own, True
    alone = len(places) == len(turns) == 1
    yield from ((place, turn, alone) for place, turn in zip(left, free, strict=False))


def _body_of(source: dict[str, Any]) -> tuple[str, ...]:
    """Name of the body, from a name without the words for position and quaternion."""
    columns = source.get("columns") or [source.get("column") or source.get("array") or ""]
    words = [re.findall(r"[A-Z]?[a-z]+|[A-Z]+|\d+", name) for name in columns]
    common = [word.lower() for word in words[0] if all(word in other for other in words)]
    return tuple(word for word in common if not OF_A_POSE.fullmatch(word))
