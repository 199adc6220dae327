# SPDX-License-Identifier: Apache-2.0
"""The hit object of a run among several tracked ones: the one that moves most, if every run has a file of each."""

from __future__ import annotations

from dataclasses import replace

from impact_rs_sim.errors import InputError
from impact_rs_trials.recordings.importing.file_groups import OBJECT, RUN, WORD, FileGroups, run_name
from impact_rs_trials.recordings.importing.import_checks import MIN_OBJECT_DISPLACEMENT_M, travel_of
from impact_rs_trials.recordings.mapping import Mapping
from impact_rs_trials.recordings.readers.series import Names


def moving_objects(groups: FileGroups, kind: str, mapping: Mapping) -> tuple[FileGroups, str, list[str]] | None:
    """Files of several objects as one kind, which has in every run the file of the object that moves.

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
        named = {
            other[len(before) : len(other) - len(after)]: other
            for other in groups.kinds
            if other.startswith(before) and other.endswith(after) and len(other) > len(before) + len(after)
        }
        named = {name: other for name, other in named.items() if WORD.fullmatch(name)}
        travels = {name: _travels(groups, other, mapping) for name, other in named.items()}
        usable = {name: own for name, own in travels.items() if own is not None}
        if len(usable) < 2:
            continue
        pattern = f"{before}{OBJECT}{after}"
        chosen = {run: max(usable, key=lambda name: usable[name][run]) for run in groups.runs}  # noqa: B023
        kinds = {other: by_run for other, by_run in groups.kinds.items() if other not in map(named.get, usable)}
        kinds[pattern] = {run: groups.kinds[named[name]][run] for run, name in chosen.items()}
        moved = [name for run, name in chosen.items() if usable[name][run] > MIN_OBJECT_DISPLACEMENT_M]
        merged = replace(groups, kinds=kinds, objects={**groups.objects, **chosen})
        return merged, pattern, list(dict.fromkeys(moved))
    return None


def _travels(groups: FileGroups, kind: str, mapping: Mapping) -> dict[str, float] | None:
    """Largest displacement of an object in every run [m]; None: some run has no position of it."""
    signals = {name: one.model_copy(update={"file": kind}) for name, one in mapping.signals.items()}
    own = mapping.model_copy(update={"signals": signals})
    found: dict[str, float] = {}
    for run in groups.runs:
        try:
            travel = travel_of(groups.folder / run, own, Names(run=run_name(run)))
        except InputError:
            return None
        if travel is None:
            return None
        found[run] = travel
    return found
