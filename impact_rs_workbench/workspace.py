# SPDX-License-Identifier: Apache-2.0
"""Contents of the folder of a workbench: campaigns, runs of laboratories, models, diagnoses and reports.

Every request reads the files again: closing the page loses nothing, and results of the command line appear, too.
"""

from __future__ import annotations

import functools
import json
import os
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

from impact_rs_analysis.diagnosis.document import DiagnosisDocument, read_document
from impact_rs_analysis.evidence.calibration import CALIBRATION
from impact_rs_analysis.report.page_names import COMPARISON_DATA, HISTORY_DATA, PAGES, TABLES
from impact_rs_sim.errors import InputError, did_you_mean, shortened
from impact_rs_sim.model import Model, load_model
from impact_rs_sim.paths import config_directory
from impact_rs_sim.schema import load_mapping, validate
from impact_rs_trials.bags.topics import TRIAL_INFO
from impact_rs_trials.blind import RUNS, TRUTH
from impact_rs_trials.campaign import MANIFEST, Manifest
from impact_rs_trials.file_names import BAG_METADATA, EXPERIMENT_FILES, RUN_TABLE
from impact_rs_trials.recordings.experiment import Experiment
from impact_rs_trials.recordings.readers.run_finder import FILE_SUFFIXES
from impact_rs_trials.store import is_bag

HIDDEN = ".workbench"
MAX_FOLDER_DEPTH = 5  # folders below the workbench's own that are looked into
MAX_DOCUMENT_BYTES = 20_000_000  # of a report's numbers
NOMINAL = "nominal"
RESULT_SUFFIX = ".json"  # of what commands write; a log in JSON is named in a command
MAX_HEADER_CHARACTERS = 10_000  # of the first line of a table


Read = TypeVar("Read")


def cached_until_change(read: Callable[[Path], Read]) -> Callable[[Path], Read]:
    """Cached reader of a file, until the file changes: the folder is read every other second."""

    @functools.lru_cache(maxsize=2000)
    def cached(path: Path, modified: int, size: int) -> Read:
        del modified, size
        return read(path)

    @functools.wraps(read)
    def reader(path: Path) -> Read:
        try:
            state = path.stat()
        except OSError:  # it has just gone, or leads nowhere
            return read(path)
        return cached(path, state.st_mtime_ns, state.st_size)

    return reader


@dataclass(frozen=True)
class Campaign:
    """A campaign.

    Attributes:
        path: Its folder, seen from the workspace.
        scenario: Scenario; empty: the folder has trials and no manifest.
        present: Trials that are there.
        trials: Trials that it is to have.
        error: Error of its manifest; empty: valid.
        loose: Names of its trials where there is no manifest.
    """

    path: str
    scenario: str
    present: int
    trials: int
    error: str = ""
    loose: tuple[str, ...] = ()


@dataclass(frozen=True)
class LabFolder:
    """Foreign recordings.

    Attributes:
        path: Their folder, seen from the workspace.
        experiment: The experiment file, seen from the workspace; empty: the recordings are not described yet.
        recordings: Names of recordings in it.
        error: Error of the experiment file; empty: valid.
        scenario: Scenario of the experiment, by name or by path seen from the workspace; empty: it has none here.
    """

    path: str
    experiment: str
    recordings: tuple[str, ...]
    error: str = ""
    scenario: str = ""


@dataclass(frozen=True)
class ModelNode:
    """One model of the family tree.

    Attributes:
        path: Its file, seen from the workspace, or ``nominal``.
        name: Its name.
        digest: Digest of its physics.
        parent: The parent's path, as ``path``; None: it has none here.
        effects: Names of its effects.
        note: Why it was made.
        scores: Errors of the model, and the repeatability, from the newest comparisons and histories.
        score: Score that may be compared with the scores of the other models; None: unknown.
        error: Error of the file; empty: valid.
    """

    path: str
    name: str
    digest: str
    parent: str | None
    effects: tuple[str, ...]
    note: str
    scores: tuple[dict[str, Any], ...] = ()
    score: dict[str, Any] | None = None
    error: str = ""


@dataclass(frozen=True)
class DiagnosisFile:
    """A diagnosis.

    Attributes:
        path: Its file, seen from the workspace.
        verdict: Its verdict.
        model: Name of the diagnosed model.
        digest: Digest of it.
        named: Effects that it named.
    """

    path: str
    verdict: str
    model: str
    digest: str
    named: tuple[str, ...]


@dataclass(frozen=True)
class Contents:
    """All that lies in a workspace.

    Attributes:
        campaigns: Folders of trials.
        runs: Folders for the argument RUNS: campaigns, and folders that hold several of them.
        laboratories: Folders of recordings that were not made here.
        models: Models, the nominal one first.
        diagnoses: Diagnoses.
        reports: Pages of reports.
        scenarios: Scenarios, those that come with impact_rs first.
        formulas: Files of effects as formulas.
        blinds: Campaigns with a hidden effect.
        plans: Plans of trials.
        robots: Robots, those that come with impact_rs first.
        tables: Tables of impacts.
        packages: Packages of evidence.
        calibrations: Faults of readings, beside measurements.
        stamps: When models, diagnoses and reports were written [s of the wall clock].
    """

    campaigns: tuple[Campaign, ...]
    runs: tuple[str, ...]
    laboratories: tuple[LabFolder, ...]
    models: tuple[ModelNode, ...]
    diagnoses: tuple[DiagnosisFile, ...]
    reports: tuple[str, ...]
    scenarios: tuple[str, ...]
    formulas: tuple[str, ...]
    blinds: tuple[str, ...]
    plans: tuple[str, ...]
    robots: tuple[str, ...]
    tables: tuple[str, ...]
    packages: tuple[str, ...]
    calibrations: tuple[str, ...]
    stamps: dict[str, float]


class Workspace:
    """The folder of a workbench.

    Args:
        root: The folder.
    """

    def __init__(self, root: Path) -> None:
        self.root = root.resolve()

    def inside(self, name: str) -> Path:
        """A path in the folder, whether anything is there or not.

        Raises:
            InputError: It leads out of the folder, or into what the workbench keeps for itself.
        """
        try:
            path = (self.root / name).resolve()
            path.exists()  # which fails where the system has no names of this length
        except (OSError, ValueError) as error:
            why = error.strerror if isinstance(error, OSError) else error
            raise InputError(f"{shortened(name)!r} is no path: {why}") from None
        if not name or not path.is_relative_to(self.root) or "\0" in name:
            raise InputError(f"{shortened(name)!r} is not in the folder of this workbench, {self.root}")
        if path.relative_to(self.root).parts[:1] == (HIDDEN,):
            raise InputError(f"{shortened(name)!r} is what the workbench keeps for itself")
        return path

    def existing(self, name: str) -> Path:
        """A path in the folder that leads to something.

        Raises:
            InputError: As :meth:`inside`, or there is nothing.
        """
        path = self.inside(name)
        if not path.exists():
            names = [item.name for item in path.parent.iterdir()] if path.parent.is_dir() else []
            raise InputError(f"there is nothing at {shortened(name)!r}{did_you_mean(path.name, names)}")
        return path

    def name(self, path: Path) -> str:
        """A path as it is seen from the folder."""
        return path.relative_to(self.root).as_posix()

    def scenario_path(self, name: str) -> str:
        """Argument SCENARIO of a command: name of a shipped scenario, or path of a file of the folder.

        Raises:
            InputError: As :meth:`existing`.
        """
        return str(self.existing(name)) if name.endswith((".yaml", ".yml")) else name

    def contents(self) -> Contents:
        """Present contents; foreign files are left out."""
        campaigns, laboratories, models, diagnoses, reports, scenarios, formulas = [], [], [], [], [], [], []
        scores: list[dict[str, Any]] = []
        blinds, plans, robots, tables, packages, calibrations = [], [], [], [], [], []
        for folder, files, bags in self._folders():
            own_trials = [name for name in bags if _is_own_trial(folder / name)]
            if MANIFEST in files:
                campaigns.append(self._campaign(folder))
            elif own_trials:
                campaigns.append(
                    Campaign(self.name(folder), "", len(own_trials), len(own_trials), loose=tuple(own_trials))
                )
            elif (laboratory := self._laboratory(folder, files, bags)) is not None:
                laboratories.append(laboratory)
            if TRUTH in files and (folder / RUNS).is_dir():
                blinds.append(self.name(folder))
            for file in files:
                path = folder / file
                if file.endswith((".yaml", ".yml")):
                    kind = _kind_of_yaml(path)
                    if file == CALIBRATION:
                        calibrations.append(self.name(path))
                    elif kind == "model":
                        models.append(self._model(path))
                    elif kind == "scenario":
                        scenarios.append(self.name(path))
                    elif kind == "formulas":
                        formulas.append(self.name(path))
                    elif kind == "plan":
                        plans.append(self.name(path))
                    elif kind == "robot":
                        robots.append(self.name(path))
                elif file in (COMPARISON_DATA, HISTORY_DATA):
                    scores += _scores(path)
                elif file.endswith(".json") and (diagnosis := self._diagnosis(path)) is not None:
                    diagnoses.append(diagnosis)
                elif file.endswith(".json") and _is_package(path):
                    packages.append(self.name(path))
                elif _is_table_of_impacts(path):
                    tables.append(self.name(path))
                elif file in PAGES:
                    reports.append(self.name(path))
        config = config_directory()
        return Contents(
            campaigns=tuple(campaigns),
            runs=tuple(sorted(_with_common_folders([item.path for item in campaigns]))),
            laboratories=tuple(laboratories),
            models=tuple(_with_scores([_nominal(), *models], scores)),
            diagnoses=tuple(diagnoses),
            reports=tuple(reports),
            scenarios=(*_names_in(config / "scenarios"), *scenarios),
            formulas=tuple(formulas),
            blinds=tuple(blinds),
            plans=tuple(plans),
            robots=(*_names_in(config / "robots"), *robots),
            tables=tuple(tables),
            packages=tuple(packages),
            calibrations=tuple(calibrations),
            stamps=self._stamps(
                [
                    *reports,
                    *plans,
                    *(item_with_path.path for item_with_path in diagnoses),
                    *(item_with_path.path for item_with_path in models),
                ]
            ),
        )

    def _stamps(self, names: list[str]) -> dict[str, float]:
        """When files were written; those that have just gone are left out."""
        stamps = {}
        for name in names:
            with suppress(OSError):
                stamps[name] = (self.root / name).stat().st_mtime
        return stamps

    def _folders(self) -> Iterator[tuple[Path, list[str], list[str]]]:
        """Folders with their files and bags, in order; hidden ones are left out, and bags not looked into."""
        for folder_path, folders, files in os.walk(self.root):
            folder = Path(folder_path)
            depth = len(folder.relative_to(self.root).parts)
            shown = sorted(name for name in folders if not name.startswith("."))
            bags = [name for name in shown if is_bag(folder / name)]
            folders[:] = [] if depth >= MAX_FOLDER_DEPTH else [name for name in shown if name not in bags]
            yield folder, sorted(files), bags

    def _campaign(self, folder: Path) -> Campaign:
        try:
            manifest = _manifest(folder / MANIFEST)
        except InputError as error:
            return Campaign(self.name(folder), "", 0, 0, str(error))
        keys = {key.name for key in manifest.keys}
        scenario = Path(manifest.scenario).stem
        return Campaign(self.name(folder), scenario, len(keys & set(os.listdir(folder))), len(keys))

    def _laboratory(self, folder: Path, files: list[str], bags: list[str]) -> LabFolder | None:
        experiment = next((name for name in EXPERIMENT_FILES if name in files), None)
        names = [*bags, *(name for name in files if _is_recording(folder / name))]
        if not names and experiment is None:
            return None
        error = scenario = ""
        if experiment is not None:
            try:
                experiment_file = validate(Experiment, load_mapping(folder / experiment), folder / experiment)
                scenario = self._named_from(folder, experiment_file.scenario or "")
            except InputError as invalid:
                error = str(invalid)
        file = "" if experiment is None else self.name(folder / experiment)
        return LabFolder(self.name(folder), file, tuple(names), error, scenario)

    def _named_from(self, folder: Path, scenario: str) -> str:
        """Scenario of an experiment file as a form names it; empty: it lies outside of the workspace."""
        if not scenario.endswith((".yaml", ".yml")):
            return scenario
        path = (folder / scenario).resolve()
        return self.name(path) if path.is_relative_to(self.root) else ""

    def _model(self, path: Path) -> ModelNode:
        try:
            model = load_model(path)
        except InputError as error:
            return ModelNode(self.name(path), path.stem, "", None, (), "", error=str(error))
        return _node(self.name(path), model, self._parent(path, model))

    def _parent(self, path: Path, model: Model) -> str | None:
        if model.parent is None:
            return None
        beside = (path.parent / model.parent).resolve()
        if beside.is_file() and beside.is_relative_to(self.root):
            return self.name(beside)
        return NOMINAL if Path(model.parent).stem == NOMINAL else None

    def _diagnosis(self, path: Path) -> DiagnosisFile | None:
        document = _document(path)
        if document is None:
            return None
        return DiagnosisFile(
            self.name(path), str(document.verdict), document.model.name, document.model.digest, document.named
        )


def _names_in(folder: Path) -> list[str]:
    """Names of the YAML files that come with impact_rs in a folder, in order."""
    return sorted(file.stem for file in folder.glob("*.yaml"))


def _is_recording(path: Path) -> bool:
    """Whether a file may be a recording, and is no table that a command has written."""
    listed = path.suffix in FILE_SUFFIXES and path.suffix != RESULT_SUFFIX
    return listed and path.name not in (RUN_TABLE, *TABLES) and not _is_table_of_impacts(path)


@cached_until_change
def _is_table_of_impacts(path: Path) -> bool:
    """Whether columns of a table are velocities before and after an impact."""
    try:
        if path.suffix == ".csv":
            with path.open(encoding="utf-8") as file:
                header = file.readline(MAX_HEADER_CHARACTERS)
        elif path.suffix == ".parquet":
            import pyarrow.parquet

            header = ",".join(pyarrow.parquet.read_schema(path).names)
        else:
            return False
    except Exception:  # gone, no text, no pyarrow; a damaged file can fail anywhere inside pyarrow
        return False
    return "_before" in header and "_after" in header


@cached_until_change
def _is_package(path: Path) -> bool:
    """Whether a JSON document is a package of evidence."""
    return {"seal", "laboratory", "diagnosis"} <= (read_json(path) or {}).keys()


@cached_until_change
def _manifest(path: Path) -> Manifest:
    return validate(Manifest, load_mapping(path), path)


@cached_until_change
def _document(path: Path) -> DiagnosisDocument | None:
    """A diagnosis; None: some other JSON."""
    try:
        return read_document(path)
    except InputError:
        return None


def _nominal() -> ModelNode:
    return _node(NOMINAL, load_model(NOMINAL), None)


def _node(path: str, model: Model, parent: str | None) -> ModelNode:
    return ModelNode(path, model.name, model.digest, parent, tuple(item.name for item in model.effects), model.note)


@cached_until_change
def _is_own_trial(bag: Path) -> bool:
    """Whether a bag is a trial of impact_rs: its metadata lists ``/trial_info``."""
    try:
        return TRIAL_INFO in (bag / BAG_METADATA).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        return False


@cached_until_change
def _kind_of_yaml(path: Path) -> str | None:
    """``model``, ``scenario``, ``formulas``, ``plan`` or ``robot`` by keys that nothing else has; None: another."""
    try:
        keys = load_mapping(path).keys()
    except InputError:
        return None
    if {"robots", "objects", "cases"} <= keys:
        return "scenario"
    if keys == {"effects"}:
        return "formulas"
    if {"aim", "budget", "campaigns"} <= keys:
        return "plan"
    if {"joints", "links", "flange"} <= keys:
        return "robot"
    if "name" in keys and keys & {"effects", "parent"} and keys <= set(Model.model_fields):
        return "model"
    return None


def _with_common_folders(paths: list[str]) -> set[str]:
    """Paths of campaigns, and the folders in which several of them come together."""
    inside: dict[str, set[str]] = defaultdict(set)
    for path in paths:
        for parent in Path(path).parents:
            inside[parent.as_posix()].add(path)
    deepest = {
        frozenset(campaigns): folder
        for folder, campaigns in sorted(inside.items())
        if len(campaigns) > 1 and folder != "."
    }
    return {*paths, *deepest.values()}


def read_json(path: Path) -> dict[str, Any] | None:
    """A JSON document of ours; None: not one."""
    try:
        if path.stat().st_size > MAX_DOCUMENT_BYTES:
            return None
        document = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return None
    return document if isinstance(document, dict) else None


@cached_until_change
def _scores(path: Path) -> list[dict[str, Any]]:
    """Errors of models that a comparison or a history has found, newest files last."""
    document = read_json(path)
    if document is None:
        return []
    entries = []
    when = path.stat().st_mtime
    try:
        if path.name == COMPARISON_DATA:
            entry = {"name": "", "digest": document["model"]["digest"], "fit": document["score"], "held_out": None}
            measured = [
                document["source"],
                *sorted((condition["name"], condition["repeats"]) for condition in document["conditions"]),
            ]
            data = document.get("runs_digest") or str(measured)
            entries.append(entry | {"floor": document["noise_floor"], "unit": document["score_unit"], "data": data})
        else:
            for item in document["history"]:
                entry = {"name": item["model"], "digest": item.get("digest"), "fit": item["error_fit"]}
                entry |= {
                    "held_out": item["error_held_out"],
                    "floor": item["noise_floor"],
                    "unit": "",
                    "data": item.get("runs_digest") or str(path),
                }
                entries.append(entry)
    except (KeyError, TypeError):
        return []
    return [item | {"report": path.parent.name, "when": when} for item in entries]


def _with_scores(models: list[ModelNode], scores: list[dict[str, Any]]) -> Iterator[ModelNode]:
    """Models with their scores, newest first; the fields ``score`` of all models come from the same measurements."""
    own_scores: dict[str, list[dict[str, Any]]] = {}
    latest: dict[str, float] = {}  # by measurements
    for model in models:
        of_model = [item for item in scores if _belongs_to(item, model)]
        newest = own_scores[model.path] = sorted(of_model, key=lambda item: -item["when"])
        for item in newest:
            latest[item["data"]] = max(item["when"], latest.get(item["data"], 0.0))
    model_counts = {
        data: sum(any(item["data"] == data for item in items) for items in own_scores.values()) for data in latest
    }
    common = max(
        latest, key=lambda data: (model_counts[data], latest[data]), default=None
    )  # of most models, then the newest
    for model in models:
        shown = [
            {key: item[key] for key in ("report", "fit", "held_out", "floor", "unit")}
            for item in own_scores[model.path]
        ]
        common_score = next(
            (
                shown_score
                for shown_score, item in zip(shown, own_scores[model.path], strict=True)
                if item["data"] == common
            ),
            None,
        )
        yield replace(model, scores=tuple(shown[:3]), score=common_score)


def _belongs_to(score: dict[str, Any], model: ModelNode) -> bool:
    """Whether a score belongs to a model: by its digest, or by its name where an older history has no digest."""
    digest = score["digest"]
    return bool(model.digest) and (score["name"] == model.name if digest is None else digest == model.digest)
