# SPDX-License-Identifier: Apache-2.0
"""``impact-rs demo``: the whole loop in one command."""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from pydantic import Field

from impact_rs_analysis.application.loop_steps import report_comparison, report_diagnosis
from impact_rs_analysis.application.measurements import measurements_of_trials, read_trials
from impact_rs_analysis.diagnosis.add import add_effects
from impact_rs_analysis.diagnosis.document import write_document
from impact_rs_analysis.diagnosis.history import history
from impact_rs_analysis.report.comparison import write_comparison
from impact_rs_analysis.report.page_names import COMPARISON_PAGE, DIAGNOSIS_PAGE
from impact_rs_cli.arguments import three_digits
from impact_rs_cli.commands.analyze import report_on
from impact_rs_cli.commands.campaign import warn_wrong
from impact_rs_cli.commands.compare import comparison_of
from impact_rs_cli.commands.diagnose import diagnosis_of
from impact_rs_cli.commands.history import show_history
from impact_rs_cli.parser import command_line
from impact_rs_cli.terminal import Terminal, output_folder
from impact_rs_ros.graph import Graph, run_trial
from impact_rs_sim.model import Model, load_model, save_model
from impact_rs_sim.numbers import estimate_in_line
from impact_rs_sim.paths import config_directory
from impact_rs_sim.schema import Schema, load
from impact_rs_trials.bags.trial_info import TrialKey
from impact_rs_trials.campaign import Manifest, TrialReport, make_manifest, open_campaign
from impact_rs_trials.workers import Workforce, workers

SCENARIO, OBJECT, CASE = "push", "cat_food", "case_2"
COMPANION = "excite"
OBJECTS, CASES = ["parcel", "juice"], ["case_1", "case_2"]
REPEATS = 2  # of every trial
MODEL = "nominal"


class Demonstration(Schema):
    """``config/demo.yaml``."""

    hidden: Model = Field(description="effect of the plant that the model does not know")
    considered: tuple[str, ...] = Field(min_length=1, description="effects that the diagnosis considers")


def run(args: argparse.Namespace, terminal: Terminal) -> int:
    """Run the command."""
    jump, runs = args.output / ("experiment" if args.quick else "jump"), args.output / "runs"
    manifests = _manifests(jump, runs)
    demonstration = load(Demonstration, config_directory() / "demo.yaml")
    hidden = None if args.quick else demonstration.hidden
    with output_folder(args.output):
        failures = _record(manifests[:1] if args.quick else manifests, hidden, terminal)
    if failures:
        terminal.warn(f"{failures} trials failed; run the same command again to repeat them")
        return 1
    step = "" if args.quick else "1. "
    terminal.say("", f"{step}The measured jump, as in the paper: the zero crossing of net feedback.")
    code, report = report_on(jump, None, terminal)
    if code:
        return code
    if args.quick:
        terminal.result({"report": str(report)})
        return 0
    document = walk_the_loop(demonstration, args.output, runs, terminal)
    terminal.result({"report": str(report), **document})
    return 0 if document["correct"] else 1


def _manifests(jump: Path, runs: Path) -> list[tuple[Path, Manifest]]:
    return [
        (jump, make_manifest(SCENARIO, [OBJECT], [CASE], trials=1)),
        (runs / SCENARIO, make_manifest(SCENARIO, OBJECTS, CASES, [1.0], REPEATS)),
        (runs / COMPANION, make_manifest(COMPANION, None, None, [1.0], REPEATS)),
    ]


def _record(manifests: list[tuple[Path, Manifest]], hidden: Model | None, terminal: Terminal) -> int:
    """Record the missing trials through one set of nodes; returns how many failed."""
    todo: list[tuple[Path, Manifest, TrialKey]] = []
    for directory, manifest in manifests:
        todo += [(directory, manifest, key) for key in open_campaign(directory, manifest)]
    if not todo:
        terminal.say("All trials have been recorded already.")
        return 0
    secret = "" if hidden is None else "; the plant has one hidden physical effect"
    terminal.say(f"Running {len(todo)} trials through the ROS 2 nodes{secret}.")
    reports = []
    with terminal.progress("trials") as report_progress:
        report_progress(0, len(todo))
        for count, report in enumerate(_through_nodes(todo, hidden), start=1):
            reports.append(report)
            if report.outcome == "ABORTED":
                terminal.warn(f"{report.key.name}: {report.message or 'aborted'}")
                terminal.trace(report.trace)
            report_progress(count, len(todo))
    warn_wrong(reports, terminal)
    return sum(report.outcome == "ABORTED" for report in reports)


def _through_nodes(todo: list[tuple[Path, Manifest, TrialKey]], hidden: Model | None) -> Iterator[TrialReport]:
    with Graph.running(SCENARIO, root=todo[0][0].parent) as graph:
        for directory, manifest, key in todo:
            yield run_trial(graph, directory, manifest, key, hidden)


def walk_the_loop(
    demonstration: Demonstration, output: Path, runs_directory: Path, terminal: Terminal
) -> dict[str, Any]:
    """Compare, diagnose, add, compare, history.

    Args:
        demonstration: Hidden effect, and considered effects.
        output: Folder of diagnosis, model and reports.
        runs_directory: Folder of the trials.
        terminal: Shows every step.

    Returns:
        Hidden and named effects; if the diagnosis named an effect, also errors, estimate and pages.
    """
    diagnosis_file, model_file, reports = output / "diagnosis.json", output / "model_2.yaml", output / "report"
    before_reports = reports / MODEL
    model, considered = load_model(MODEL), list(demonstration.considered)
    (hidden,) = demonstration.hidden.effects
    with workers(Workforce(min(2, os.cpu_count() or 1))) as map_tasks:
        measurements = measurements_of_trials(read_trials(runs_directory, map_tasks, terminal), map_tasks, terminal)
        terminal.say("", "2. Where does the model fail?")
        before = comparison_of(measurements, model, terminal)
        links = {f"../{DIAGNOSIS_PAGE}": "what it lacks", f"../{COMPARISON_PAGE}": "the better model"}
        report_comparison(before, measurements, Path(MODEL), model, before_reports, links)
        terminal.say("", f"3. Which effect is missing? Considered here: {', '.join(considered)}.")
        options = {"runs": str(runs_directory.absolute()), "effects": considered}
        document = diagnosis_of(measurements, model, model, considered, terminal, options=options)
        write_document(document, diagnosis_file)
        report_diagnosis(document, measurements, Path(MODEL), model, reports)
        correct = hidden.name in document.named or any(hidden.name in group for group in document.confusable)
        story: dict[str, Any] = {"hidden": hidden.name, "named": list(document.named), "correct": correct}
        if not document.named:
            terminal.warn("the diagnosis named nothing; its report says why")
            return story
        name = document.named[0]
        terminal.say("", f"4. Add it: {model_file}")
        model_file.unlink(missing_ok=True)  # of an earlier run of the demonstration
        save_model(add_effects(model, Path(MODEL), document, diagnosis_file, [name], model_file, False), model_file)
        child = load_model(model_file)
        after = comparison_of(measurements, child, terminal)
        with measurements.progress():
            versions = history(model_file, measurements.against)
        show_history(versions, terminal)
        links = {f"{MODEL}/{COMPARISON_PAGE}": f"model '{MODEL}'", DIAGNOSIS_PAGE: "what it lacks"}
        write_comparison(after, measurements.tracks(child), versions, reports, links)
    effect = document.effect(name)
    assert effect is not None
    truth, estimate = next(iter(hidden.parameters.values())), next(iter(effect.parameters.values()))
    terminal.say(
        "",
        f"The plant hid {hidden.name} = {truth.estimate:g}. The diagnosis named {' and '.join(document.named)} = "
        f"{estimate_in_line(estimate.estimate, estimate.ci95)}, "
        f"and the error of the model fell from {three_digits(before.score)} to {three_digits(after.score)} times "
        "repeatability.",
        "Reports:",
        f"  where the model fails   {(before_reports / COMPARISON_PAGE).resolve()}",
        f"  what it lacks           {(reports / DIAGNOSIS_PAGE).resolve()}",
        f"  the better model        {(reports / COMPARISON_PAGE).resolve()}",
        "Type next:",
        f"  {command_line('diagnose', {'runs': runs_directory, 'output': 'diagnosis.json'})}",
        f"  {command_line('effects', {})}",
        f"  {command_line('blind make', {'seed': 7, 'output': 'blind_7'})}",
        "to search the whole library, to list it, and to make a campaign whose hidden effect you do not know.",
    )
    return story | {
        "score_before": before.score,
        "score_after": after.score,
        "noise_floor": after.noise_floor,
        "estimate": estimate.model_dump(mode="json"),
        "history": [entry.to_json() for entry in versions],
        "reports": [
            str(reports / DIAGNOSIS_PAGE),
            str(reports / COMPARISON_PAGE),
            str(before_reports / COMPARISON_PAGE),
        ],
    }
