# SPDX-License-Identifier: Apache-2.0
"""Results of comparisons and diagnoses, as the page draws them, with the figures of the reports."""

from __future__ import annotations

import functools
import json
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

from impact_rs_analysis.application.shown_runs import laboratory_run, page_of_trial
from impact_rs_analysis.diagnosis.compare import ComparisonDocument
from impact_rs_analysis.diagnosis.document import DiagnosisDocument, read_document
from impact_rs_analysis.diagnosis.laws.discovery_document import is_discovery
from impact_rs_analysis.diagnosis.scoring import score
from impact_rs_analysis.evidence.levels import Cell
from impact_rs_analysis.evidence.replays.measured_runs import runs_digest
from impact_rs_analysis.investigation.endings import ending_of
from impact_rs_analysis.investigation.rounds import planned_trials, read_rounds
from impact_rs_analysis.investigation.settings import read_settings
from impact_rs_analysis.report.comparison import (
    comparison_in_words,
    on_scale,
    residuals_part,
    yardstick_of_unexplained,
)
from impact_rs_analysis.report.labels import location_text, phase_text, tag_of
from impact_rs_analysis.report.page import number_text, p_text, quantity_text
from impact_rs_analysis.report.page_names import COMPARISON_DATA, DIAGNOSIS_PAGE, DISCOVERY_PAGE
from impact_rs_analysis.report.plots import effects_plot
from impact_rs_analysis.report.trial import TrialPage, run_page
from impact_rs_commands.explaining import DISCOVER
from impact_rs_commands.measuring import BLIND
from impact_rs_sim.errors import InputError
from impact_rs_sim.numbers import estimate_text
from impact_rs_sim.schema import validate
from impact_rs_trials.blind import RUNS, TRUTH
from impact_rs_trials.experiment_plan import MAX_SHOWN_PAIRS, read_plan
from impact_rs_trials.store import trials_below
from impact_rs_workbench.forms import terminal_path, values_of
from impact_rs_workbench.workspace import Workspace, read_json

if TYPE_CHECKING:
    import plotly.graph_objects as go

MAX_SHOWN_RESIDUALS = 5  # residuals that a diagnosis leaves


def comparison(folder: Path) -> dict[str, Any]:
    """Heat maps of a comparison, and which signal over time belongs to each of their cells.

    Raises:
        InputError: There is no comparison in the folder.
    """
    path = folder / COMPARISON_DATA
    data = read_json(path)
    if data is None:
        raise InputError(f"no comparison here; expected {COMPARISON_DATA}", file=folder)
    document = validate(ComparisonDocument, data, path)
    several = len({cell.scenario for cell in document.where}) > 1
    part, by_phase = residuals_part(document), not on_scale(document)
    return {
        "headline": comparison_in_words(document),
        "score": document.score,
        "floor": document.noise_floor,
        "model": document.model.name,
        "yardstick": part.yardstick,
        "figures": [
            {"title": plot.title, "caption": plot.caption, "figure": _drawn(plot.figure)} for plot in part.plots
        ],
        "cells": [
            {
                "row": f"{cell.signal} {cell.index}",
                "column": phase_text(cell.phase) if by_phase else location_text(cell, several),
                "map": "" if by_phase else phase_text(cell.phase),
                "set": ", ".join(filter(None, (cell.object, cell.case))),
                "signal": nearest_signal(cell),
                "error": quantity_text(cell.error, cell.unit),
                "times": number_text(cell.size),
                "matters": cell.matters,
            }
            for cell in document.where
        ],
        "remarks": [*(relation.in_words for relation in document.agreement.in_common), *document.remarks],
    }


def trial(path: Path) -> dict[str, Any]:
    """A recorded trial in 3D and over time.

    Raises:
        InputError: It is no trial, or it cannot be read.
    """
    return _shown(page_of_trial(path))


def run(folder: Path, name: str) -> dict[str, Any]:
    """A run of a described laboratory in 3D and over time, as a comparison reads it.

    Raises:
        InputError: See :func:`laboratory_run`.
    """
    return _shown(run_page(laboratory_run(folder, None, name)))


def _drawn(figure: go.Figure) -> Any:
    """A figure as plain data."""
    return json.loads(str(figure.to_json()))


def _shown(page: TrialPage) -> dict[str, Any]:
    """A page of a run as the workbench draws it."""
    return {
        "title": page.title,
        "facts": [*(f"{term}: {text}" for term, text in page.facts), *(f"Note: {note}" for note in page.notes)],
        "replay": page.replay.data,
        "plots": [{"title": plot.title, "figure": _drawn(plot.figure)} for plot in page.plots],
    }


def plan(path: Path) -> dict[str, Any]:
    """A plan of trials: the gain of each condition, and the explanations that all of them distinguish.

    Raises:
        InputError: It is not a plan, or a scenario in it does not exist.
    """
    experiment_plan = read_plan(path)
    planned = [condition for campaign in experiment_plan.campaigns for condition in campaign.conditions]
    return {
        "summary": experiment_plan.summary,
        "trials": experiment_plan.trials,
        "conditions": [
            {
                "trials": condition.trials,
                "what": condition.what,
                "adds": condition.buys.removeprefix(f"{condition.trials} x {condition.what} "),
            }
            for condition in planned
        ],
        "pairs": [pair.model_dump() for pair in experiment_plan.pairs[:MAX_SHOWN_PAIRS]],
    }


def investigation(folder: Path) -> dict[str, Any]:
    """How an investigation ended, or how far it is.

    Raises:
        InputError: There is no investigation in the folder.
    """
    settings = read_settings(folder)
    rounds = read_rounds(folder, settings)
    over = bool(rounds) and rounds[-1].decision is not None and rounds[-1].decision.action == "end"
    return {
        "ending": ending_of(settings, rounds).model_dump(mode="json") if over else None,
        "rounds": len(rounds),
        "trials": planned_trials(rounds),
    }


def reveal(workspace: Workspace, path: str) -> dict[str, Any]:
    """Hidden effects of a campaign, beside the diagnosis of its runs.

    Args:
        workspace: The folder.
        path: A campaign, which is scored by its newest diagnosis; or a diagnosis.

    Raises:
        InputError: There is no such pair.
    """
    target, contents = workspace.existing(path), workspace.contents()
    if target.is_dir() and path not in contents.blinds:
        raise InputError(f"no practice campaign: there is no {TRUTH} beside {RUNS}", file=target)
    stamps = contents.stamps
    newest_first = sorted((diagnosis.path for diagnosis in contents.diagnoses), key=lambda name: -stamps.get(name, 0.0))
    campaigns = [target] if target.is_dir() else [workspace.existing(name) for name in contents.blinds]
    files = [workspace.existing(name) for name in newest_first] if target.is_dir() else [target]
    for campaign in campaigns:
        digest = _digest(campaign / RUNS)
        for file in files:
            document = read_document(file)
            if document.runs.digest == digest:
                return _revealed(campaign, file, document)
    if target.is_dir():
        raise InputError("its runs have no diagnosis yet; diagnose them first", file=target)
    raise InputError("not the diagnosis of a practice campaign; nothing is hidden in its runs", file=target)


def _revealed(campaign: Path, file: Path, document: DiagnosisDocument) -> dict[str, Any]:
    result = score(campaign, document, file)
    truth = json.loads((campaign / TRUTH).read_text(encoding="utf-8"))
    rows = []
    for effect in truth["effects"]:
        effect_document = document.effect(effect["name"])
        for name, hidden in effect["parameters"].items():
            estimate = None if effect_document is None else effect_document.parameters.get(name)
            low, high = (estimate and estimate.ci95) or (None, None)
            value = None if estimate is None else estimate.estimate
            row = {"name": name, "unit": hidden["unit"], "hidden": hidden["value"]}
            rows.append(row | {"estimate": value, "low": low, "high": high})
    arguments = BLIND.actions[1].words({"directory": terminal_path(campaign), "diagnosis": terminal_path(file)})
    return {
        "correct": result.correct,
        "truth": result.truth,
        "named": result.named,
        "parameters": rows,
        "words": arguments,
    }


def estimates(workspace: Workspace) -> list[dict[str, Any]]:
    """Every estimate of a parameter in the diagnoses of the folder, in the order of measurement.

    ``low`` and ``high`` are the ends of the 95 % interval, null where it is not known. ``when`` is when the last of the
    diagnosed trials was recorded [s of the wall clock], where the diagnosis says it (``measured``), else when the
    diagnosis was written.
    """
    contents = workspace.contents()
    rows = []
    for diagnosis in contents.diagnoses:
        document = read_document(workspace.existing(diagnosis.path))
        last = document.runs.recorded
        for effect in document.effects:
            for name, value in effect.parameters.items():
                low, high = value.ci95 or (None, None)
                rows.append(
                    {
                        "parameter": f"{effect.name}: {name}",
                        "unit": value.unit,
                        "estimate": value.estimate,
                        "low": low,
                        "high": high,
                        "diagnosis": diagnosis.path,
                        "model": diagnosis.model,
                        "verdict": str(effect.verdict),
                        "named": effect.name in document.named,
                        "when": contents.stamps.get(diagnosis.path, 0.0) if last is None else last,
                        "measured": last is not None,
                    }
                )
    return sorted(rows, key=lambda entry: entry["when"])


def nearest_signal(cell: Cell) -> str:
    """Name of the signal over time (:mod:`impact_rs_analysis.evidence.tracks`) that shows best what a cell is about.

    Forces and balances are computed from signals: a force shows in the velocity along its
    axis, a balance in the torque of its joint.
    """
    arm, _, index = cell.index.rpartition(".")
    prefix = f"{arm}: " if arm else ""
    if (joint := re.fullmatch(r"joint(\d+)", index)) is not None:
        quantity = "velocity" if "velocity" in cell.signal else "torque"
        return f"{prefix}{quantity} of joint {joint[1]}"
    body, _, quantity = cell.signal.rpartition(" ")
    if quantity in ("velocity", "rotation") and not body.startswith(("end-effector", "joint")):
        return f"{body} yaw rate" if quantity == "rotation" else f"{body} velocity {index}"
    return f"{prefix}end-effector velocity {index}"


def _form_values(workspace: Workspace, document: DiagnosisDocument) -> dict[str, Any]:
    """Form values of ``discover`` for the same measurements; empty: unknown, or outside of the folder."""
    formulas = {spec.name for spec in document.formulas}
    effects = [name for name in document.options.get("effects", ()) if name not in formulas]
    try:
        return values_of(workspace, DISCOVER, document.options | {"effects": effects or None})
    except InputError:
        return {}


def practice_of(workspace: Workspace, document: DiagnosisDocument) -> str | None:
    """The practice campaign whose runs were diagnosed, as it is seen from the folder; None: unknown."""
    for name in workspace.contents().blinds:
        if _digest(workspace.existing(name) / RUNS) == document.runs.digest:
            return name
    return None


def _digest(folder: Path) -> str:
    """Digest of the trials in a folder."""
    return _digest_of(folder, tuple((path, path.stat().st_mtime_ns) for path in trials_below(folder)))


@functools.lru_cache(maxsize=200)
def _digest_of(folder: Path, bags: tuple[tuple[Path, int], ...]) -> str:
    """Digest of a folder, read once while its bags stay as they are."""
    return runs_digest(folder)


def diagnosis(workspace: Workspace, name: str) -> dict[str, Any]:
    """A diagnosis in words and numbers.

    Args:
        workspace: The folder.
        name: The diagnosis, as it is seen from there.

    Raises:
        InputError: There is no diagnosis.
    """
    path = workspace.existing(name)
    document, discovered = read_document(path), is_discovery(path)
    figure = effects_plot(document)
    experiment = document.next_experiment
    form_values = _form_values(workspace, document)
    return {
        "verdict": str(document.verdict),
        "summary": document.summary,
        "calibrate": [calibration.model_dump() for calibration in document.calibrate],
        "model": document.model.name,
        "digest": document.model.digest,
        "named": list(document.named),
        "runs": form_values.get("runs"),
        "calls_for_a_law": document.verdict.leaves_residuals and not discovered,
        "law": form_values,
        "report": DISCOVERY_PAGE if discovered else DIAGNOSIS_PAGE,
        "unit": document.error_unit,
        "yardstick": yardstick_of_unexplained(document),
        "figure": None if figure is None else _drawn(figure),
        "left": [
            {
                "what": f"{residual.signal} {residual.index}".strip(),
                "phase": residual.phase,
                "value": quantity_text(residual.value, residual.unit),
                "floor": quantity_text(residual.floor, residual.unit),
                "times": number_text(residual.times_noise),
            }
            for residual in [residual for residual in document.unexplained.where if residual.matters][
                :MAX_SHOWN_RESIDUALS
            ]
        ],
        "effects": [
            {
                "name": effect.name,
                "sentence": effect.sentence,
                "of_measurement": effect.of_measurement,
                "verdict": str(effect.verdict),
                "tag": tag_of(effect.verdict).value,
                "reason": effect.reason,
                "without": effect.held_out_error_without,
                "with": effect.held_out_error_after,
                "p": p_text(effect.p_value),
                "parameters": [
                    {
                        "name": name,
                        "estimate": value.estimate,
                        "ci95": value.ci95,
                        "text": estimate_text(value.estimate, value.ci95),
                        "unit": value.unit,
                    }
                    for name, value in effect.parameters.items()
                ],
            }
            for effect in document.effects
            if effect.measured
        ],
        "practice": practice_of(workspace, document),
        "next": None if experiment is None else experiment.model_dump(),
        "remarks": list(document.remarks),
    }
