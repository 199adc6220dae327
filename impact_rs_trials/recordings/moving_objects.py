# SPDX-License-Identifier: Apache-2.0
"""Which of several tracked objects a run is about: the one that moves most, where every run has a file of each."""

from __future__ import annotations

from dataclasses import dataclass, replace

from impact_rs_sim.errors import InputError
from impact_rs_trials.recordings.file_groups import OBJECT, RUN, WORD, FileGroups, run_name
from impact_rs_trials.recordings.import_checks import MIN_OBJECT_DISPLACEMENT_M, travel_of
from impact_rs_trials.recordings.mapping import Mapping
from impact_rs_trials.recordings.series import Names


@dataclass(frozen=True)
class MovingObjects:
    """Files of several objects as those of one, in every run that of the object which moves.

    Attributes:
        pattern: Name of their kind, with ``{object}`` for the object.
        groups: All files, with that kind in place of theirs.
        objects: Names of the objects, as far as one of them moves in some run.
    """

    pattern: str
    groups: FileGroups
    objects: tuple[str, ...]


def moving_objects(groups: FileGroups, kind: str, mapping: Mapping) -> MovingObjects | None:
    """The object of every run.

    Args:
        groups: Files by kind and run.
        kind: Kind of the files of one object.
        mapping: Says where the place is in them.

    Returns:
        None: no other kind differs from this one in a word alone and holds a place in every run.
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
        return MovingObjects(pattern, merged, tuple(dict.fromkeys(moved)))
    return None


def _travels(groups: FileGroups, kind: str, mapping: Mapping) -> dict[str, float] | None:
    """How far an object moves in every run [m]; None: the place is not in its files, or not of all runs."""
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
