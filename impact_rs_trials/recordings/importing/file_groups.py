# SPDX-License-Identifier: Apache-2.0
"""Groups of files by the words and numbers of their names: files of one run, and files of one kind in many runs.

    hit_1.csv, hit_2.csv                                       a file per run
    IIWA_7_hit_{run}.csv, object_1_hit_{run}.csv               a file per signal and run in one folder
    object_{object}_hit_{run}.csv                              also with different names of the object
    q_loaded.csv, tau_loaded.csv, q_empty.csv, tau_empty.csv   also with words instead of numbers for the runs
    run_1/joints.csv, run_1/pose.csv, run_2/joints.csv, ...    a folder per run
    run_1/joints.csv, run_1/object_2.csv, run_2/object_1.csv   also with numbers for the objects
    monday/hit_1.csv, tuesday/hit_1.csv, ...                   any of these in a folder per session
    calm.csv, fast.csv, with the same columns                  a file per run, whatever the names (whole_runs)

Names that differ in numbers alone are of one kind. The last number that differs is the run, or the last several
numbers if files of all kinds have them. Folder and number identify a run: two sessions may count from 1.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from impact_rs_sim.errors import InputError
from impact_rs_trials.recordings.importing.candidates import COMMANDED, guess_of
from impact_rs_trials.recordings.readers.run_finder import name_of, natural_key

NUMBER = re.compile(r"\d+")
WORD = re.compile(r"[^\W_]+")  # of a name
SEPARATORS = "_-. "
RUN = "{run}"
OBJECT = "{object}"


@dataclass(frozen=True)
class FileGroups:
    """Files by kind and run.

    Attributes:
        folder: Folder to which the names of runs are relative.
        kinds: Files by run, by name of the kind with ``{run}`` for the run and ``{object}`` for its object.
        runs: Names of the runs relative to the folder, in natural order.
        several_files: Whether a run has several files, so that every signal needs its ``file``.
        objects: Objects by run, if the names of files contain them.
        left_out: Files whose names contain no run, while names of other files do.
    """

    folder: Path
    kinds: dict[str, dict[str, Path]]
    runs: tuple[str, ...]
    several_files: bool
    objects: Mapping[str, str] = field(default_factory=dict)
    left_out: tuple[Path, ...] = ()

    @property
    def sessions(self) -> dict[str, str]:
        """Folder of every run relative to :attr:`folder`; empty if no folder holds several runs."""
        folders = {run: os.path.dirname(run) for run in self.runs}
        several = 1 < len(set(folders.values())) < len(self.runs)
        return {run: session or "." for run, session in folders.items()} if several else {}


def group_files(files: Sequence[Path]) -> FileGroups:
    """Files by kind and run.

    Args:
        files: Files and folders of bags, at least one.

    Raises:
        InputError: Two files have the same kind and run.
    """
    if any(file.is_absolute() for file in files):
        files = [file.absolute() for file in files]
    files = sorted(dict.fromkeys(files), key=natural_key)
    root = Path(os.path.commonpath([file.parent for file in files]))
    by_folder: dict[Path, list[str]] = {}
    for file in files:
        by_folder.setdefault(file.parent, []).append(file.name)
    if _are_runs(by_folder):
        return _grouped(root, {file: (file.name, "") for file in files})
    if numbered := _numbered_objects(files):
        groups = _grouped(root, {file: (kind, "") for file, (kind, _) in numbered.items()})
        runs = ((run, numbered[file][1]) for by_run in groups.kinds.values() for run, file in by_run.items())
        return replace(groups, objects={run: number for run, number in runs if number})
    shapes: dict[str, list[Path]] = {}
    for file in files:
        shapes.setdefault(_shape(file.name), []).append(file)
    if len(shapes) == 1:
        by_run = {str(file.relative_to(root)): file for file in files}
        return FileGroups(root, {"": by_run}, tuple(by_run), False)
    if by_words := _named_by_words(files):
        return _grouped(root, by_words)
    return _grouped(root, dict(_with_runs(list(shapes.values()))))


def whole_runs(groups: FileGroups, columns: Callable[[Path], frozenset[str]], bodies: bool) -> FileGroups | None:
    """A run per file, if all kinds of files have the same column names, so that each file is a whole run.

    Every kind has positions and another signal of joints, or no signal of joints if a body may move alone. Files named
    after signals, such as q.csv and tau.csv, stay one run, as do files of which some are named after targets, such as
    measured_1.csv and desired_1.csv.

    Args:
        groups: Files by name.
        columns: Names of the columns of a file, called for the first file of each kind; empty: columns without names.
        bodies: Whether the recordings may be of a body without a robot.

    Returns:
        The files as runs; None: kinds of files of one run.
    """
    kinds = [Path(kind).stem for kind in groups.kinds]
    targets = sum(COMMANDED.search(kind) is not None for kind in kinds)
    if not groups.several_files or len(kinds) < 2 or _are_signals(kinds) or 0 < targets < len(kinds):
        return None
    column_sets = {columns(next(iter(by_run.values()))) for by_run in groups.kinds.values()}
    if len(column_sets) > 1 or not (columns_of_all := column_sets.pop()):
        return None
    hints = {guess_of(name) for name in columns_of_all} - {""}
    if not ({"position"} < hints or (bodies and not hints)):
        return None
    files = sorted((file for by_run in groups.kinds.values() for file in by_run.values()), key=natural_key)
    root = Path(os.path.commonpath([file.parent for file in files]))
    by_run = {str(file.relative_to(root)): file for file in files}
    return FileGroups(root, {"": by_run}, tuple(by_run), False, left_out=groups.left_out)


def _shape(name: str) -> str:
    return NUMBER.sub("0", name)


def _named_by_words(files: Sequence[Path]) -> dict[Path, tuple[str, str]]:
    """Kind and run of files whose names suggest a signal and end or begin with a run; empty: other names."""
    stems, ending = [file.stem for file in files], files[0].suffix
    if len({file.parent for file in files}) > 1 or {file.suffix for file in files} != {ending}:
        return {}
    for word in WORD.finditer(stems[0]):
        first_head, first_tail = stems[0][: word.start()], stems[0][word.start() :]
        tails = [stem[len(first_head) :] for stem in stems if stem.startswith(first_head)]
        heads = [stem[: -len(first_tail)] for stem in stems if stem.endswith(first_tail)]
        if min(len(heads), len(tails)) < 2 or {head + tail for head in heads for tail in tails} != set(stems):
            continue
        if _are_signals(heads):
            parted = {head + tail: (f"{head}{RUN}{ending}", tail) for head in heads for tail in tails}
        elif _are_signals(tails):
            run_of_head = {head: head.rstrip(SEPARATORS) for head in heads}
            parted = {
                head + tail: (f"{RUN}{head.removeprefix(run)}{tail}{ending}", run)
                for head, run in run_of_head.items()
                for tail in tails
            }
        else:
            continue
        return {file: parted[file.stem] for file in files}
    return {}


def _are_signals(parts: Sequence[str]) -> bool:
    """Whether parts of names suggest signals, each a different one."""
    hints = [guess_of(part) for part in parts]
    return all(hints) and len(set(hints)) == len(hints)


def _are_runs(by_folder: dict[Path, list[str]]) -> bool:
    """Whether every folder holds the files of one run: the same names in all folders, some of a unique shape."""
    if len(by_folder) < 2 or len({frozenset(names) for names in by_folder.values()}) > 1:
        return False
    names = next(iter(by_folder.values()))
    shapes = [_shape(name) for name in names]
    return len(names) > 1 and any(shapes.count(shape) == 1 for shape in shapes)


def _numbered_objects(files: Sequence[Path]) -> dict[Path, tuple[str, str]]:
    """Kind and object of every file if folders are runs with a file of each kind; else empty.

    One kind has the same name in all folders. Another kind has a number, which is the object if it returns in other
    folders, or is not the number of its folder.
    """
    folders = {file.parent for file in files}
    shapes: dict[str, list[Path]] = {}
    for file in files:
        shapes.setdefault(_shape(file.name), []).append(file)
    one_per_folder = all(
        len({file.parent for file in group}) == len(group) == len(folders) for group in shapes.values()
    )
    if len(folders) < 2 or len(shapes) < 2 or not one_per_folder:
        return {}
    differing = {shape: _differing(group) for shape, group in shapes.items()}
    counts = {len(indices) for indices in differing.values()}
    if counts != {0, 1}:
        return {}
    kind_and_object: dict[Path, tuple[str, str]] = {}
    for shape, group in shapes.items():
        if not differing[shape]:
            kind_and_object |= {file: (file.name, "") for file in group}
            continue
        (index,) = differing[shape]
        numbers = [NUMBER.findall(file.name)[index] for file in group]
        of_run = all(number in NUMBER.findall(file.parent.name) for file, number in zip(group, numbers, strict=True))
        if of_run and len(set(numbers)) == len(numbers):
            return {}
        kinds = [_split(file.name, index, index)[0].replace(RUN, OBJECT) for file in group]
        kind_and_object |= {file: (kind, number) for file, kind, number in zip(group, kinds, numbers, strict=True)}
    return kind_and_object


def _with_runs(shapes: Sequence[Sequence[Path]]) -> Iterator[tuple[Path, tuple[str, str]]]:
    """Kind and run of every file, from files grouped by the shape of their names; no run in the name: empty."""
    differing = [_differing(group) for group in shapes]
    runs: set[str] = set()
    for count in range(min((len(indices) for indices in differing if indices), default=0), 0, -1):
        # A run has as many numbers at the end of the name as files of all kinds have in common.
        runs_of_kinds = [
            {_split(file.name, indices[-count], indices[-1])[1] for file in group}
            for group, indices in zip(shapes, differing, strict=True)
            if indices
        ]
        runs = set().union(*runs_of_kinds)
        if set.intersection(*runs_of_kinds):
            break
    else:
        count = 1
    for group, indices in zip(shapes, differing, strict=True):
        run_numbers = runs or _shared(shapes, group)
        for file in group:
            first, last = (indices[-count], indices[-1]) if indices else (-1, -1)
            if not indices:
                in_name = [index for index, number in enumerate(NUMBER.findall(file.name)) if number in run_numbers]
                first = last = in_name[-1] if in_name else -1
            yield file, _split(file.name, first, last) if last >= 0 else (file.name, "")


def _differing(files: Sequence[Path]) -> list[int]:
    """Indices of the numbers that differ between names of one shape."""
    columns = zip(*(NUMBER.findall(file.name) for file in files), strict=True)
    return [index for index, column in enumerate(columns) if len(set(column)) > 1]


def _split(name: str, first: int, last: int) -> tuple[str, str]:
    """Kind and run of a file; the run extends from the number ``first`` to the number ``last`` of the name."""
    numbers = list(NUMBER.finditer(name))
    start, end = numbers[first].start(), numbers[last].end()
    return f"{name[:start]}{RUN}{name[end:]}", name[start:end]


def _shared(shapes: Sequence[Sequence[Path]], files: Sequence[Path]) -> set[str]:
    """Numbers that the names of all other shapes share, for files whose own numbers show no run."""
    numbers_of_others = [
        {number for file in shape for number in NUMBER.findall(file.name)} for shape in shapes if shape is not files
    ]
    return set.intersection(*numbers_of_others) if numbers_of_others else set()


def _grouped(root: Path, named: Mapping[Path, tuple[str, str]]) -> FileGroups:
    """Files by kind and run, from the kind and run of every file; if no name contains a run, folders are runs."""
    numbered = any(run for _, run in named.values())
    left_out = tuple(file for file, (_, run) in named.items() if numbered and not run)
    if not numbered and any(file.parent == root for file in named):
        root = root.parent
    kinds: dict[str, dict[str, Path]] = {}
    for file, (kind, run) in named.items():
        if file not in left_out:
            key = str((file.parent / run if run else file.parent).relative_to(root))
            existing = kinds.setdefault(kind, {}).setdefault(key, file)
            if existing != file:
                raise InputError(f"run {key} has {existing} already; import them one after the other", file=file)
    kinds, objects = _with_objects(kinds)
    runs = sorted({run for by_run in kinds.values() for run in by_run}, key=natural_key)
    return FileGroups(root, kinds, tuple(runs), True, objects, left_out)


def _with_objects(kinds: dict[str, dict[str, Path]]) -> tuple[dict[str, dict[str, Path]], dict[str, str]]:
    """Merge kinds that differ in one word, the name of the object, and have no run in common."""
    families: dict[tuple[str, str], dict[str, str]] = {}
    for kind in kinds:
        for word in WORD.finditer(kind) if RUN in kind else ():
            if word[0] not in (RUN.strip("{}"), Path(kind).suffix[1:]):
                families.setdefault((kind[: word.start()], kind[word.end() :]), {})[word[0]] = kind
    for (before, after), family in families.items():
        # A kind with all runs of another kind complements it, as a file of the robot does, and is no other object.
        by_object = {word: kind for word, kind in family.items() if not _complements(kinds, kind, family.values())}
        runs = [run for kind in by_object.values() for run in kinds[kind]]
        other_kinds = {kind: by_run for kind, by_run in kinds.items() if kind not in by_object.values()}
        if (
            len(by_object) > 1
            and len(set(runs)) == len(runs)
            and any(set(runs) <= set(by_run) for by_run in other_kinds.values())
        ):
            merged = {run: file for kind in by_object.values() for run, file in kinds[kind].items()}
            objects = {run: word for word, kind in by_object.items() for run in kinds[kind]}
            return {**other_kinds, f"{before}{OBJECT}{after}": merged}, objects
    return kinds, {}


def _complements(kinds: Mapping[str, Mapping[str, Path]], kind: str, family: Iterable[str]) -> bool:
    """Whether a kind has all runs of another kind of its family."""
    return any(set(kinds[kind]) >= set(kinds[other]) for other in family if other != kind)


def run_name(run: str) -> str:
    """Name of a run in the table of runs."""
    return name_of(Path(run))
