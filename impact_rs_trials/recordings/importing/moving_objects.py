# SPDX-License-Identifier: Apache-2.0
"""The hit object of a run among several tracked objects: the object that moves most, if every run has all files."""

from __future__ import annotations

from dataclasses import replace

from impact_rs_sim.errors import InputError
from impact_rs_trials.recordings.importing.file_groups import OBJECT, RUN, WORD, FileGroups, run_name
from impact_rs_trials.recordings.importing.import_checks import MIN_OBJECT_DISPLACEMENT_M, travel_of
from impact_rs_trials.recordings.mapping import Mapping
from impact_rs_trials.recordings.readers.series import Names


def moving_objects(groups: FileGroups, kind: str, mapping: Mapping) -> tuple[FileGroups, str, list[str]] | None:
    """Merge the files of several objects to one kind, which has in every run the file of the object that moves.

    Args:
        groups: Files by kind and run.
        kind: Kind of the files of one object.
        mapping: Locates the position in them.

    Returns:
        All files with the merged kind; its name, with ``{object}`` for the object; and the objects that move in some
        run. None: no other kind differs from this one in one word and holds a position in every run.
    """
    for word in WORD.finditer(kind):
        if word[0] in (RUN.strip("{}"), OBJECT.strip("{}"), kind.rpartition(".")[2]):
            continue
        before, after = kind[: word.start()], kind[word.end() :]
        kind_of = {
            member[len(before) : len(member) - len(after)]: member
            for member in groups.kinds
            if member.startswith(before) and member.endswith(after) and len(member) > len(before) + len(after)
        }
        travels = {
            name: travel
            for name, member in kind_of.items()
            if WORD.fullmatch(name) and (travel := _travels(groups, member, mapping)) is not None
        }
        if len(travels) < 2:
            continue
        pattern = f"{before}{OBJECT}{after}"
        chosen = {run: max(travels, key=lambda name: travels[name][run]) for run in groups.runs}  # noqa: B023
        merged_kinds = {kind_of[name] for name in travels}
        kinds = {member: by_run for member, by_run in groups.kinds.items() if member not in merged_kinds}
        kinds[pattern] = {run: groups.kinds[kind_of[name]][run] for run, name in chosen.items()}
        moved = [name for run, name in chosen.items() if travels[name][run] > MIN_OBJECT_DISPLACEMENT_M]
        merged = replace(groups, kinds=kinds, objects={**groups.objects, **chosen})
        return merged, pattern, list(dict.fromkeys(moved))
    return None


def _travels(groups: FileGroups, kind: str, mapping: Mapping) -> dict[str, float] | None:
    """Largest displacement of an object in every run [m]; None: a run has no position of the object."""
    signals = {name: source.model_copy(update={"file": kind}) for name, source in mapping.signals.items()}
    mapping_of_kind = mapping.model_copy(update={"signals": signals})
    displacements: dict[str, float] = {}
    for run in groups.runs:
        try:
            travel = travel_of(groups.folder / run, mapping_of_kind, Names(run=run_name(run)))
        except InputError:
            return None
        if travel is None:
            return None
        displacements[run] = travel
    return displacements
