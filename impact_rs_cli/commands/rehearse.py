# SPDX-License-Identifier: Apache-2.0
"""``impact-rs rehearse``: the cell against a stand-in of a robot's driver."""

from __future__ import annotations

import argparse
import math

from rich.table import Table

from impact_rs_analysis.report.rehearsal import write_rehearsal
from impact_rs_cli.arguments import check_robots, settings_of
from impact_rs_cli.terminal import Terminal, output_folder
from impact_rs_ros.node_parameters import values_for, values_of
from impact_rs_sim.errors import InputError
from impact_rs_sim.robots.robot import Reflexes, RobotFacts
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_trials.cell.cell_rehearsal import Checklist, rehearse
from impact_rs_trials.cell.driver_profiles import profile_of
from impact_rs_trials.spec import TrialSpec

PHASES = 2  # of the progress: planning, then the rehearsal


def run(args: argparse.Namespace, terminal: Terminal) -> int:
    """Run the command; 1 if the rehearsal was not passed."""
    for name in ("reflex_torque", "reflex_force"):
        value = getattr(args, name)
        if value is not None and not 0.0 < value < math.inf:
            raise InputError(f"argument --{name.replace('_', '-')}: expected a number above 0, got {value:g}")
    scenario = load_scenario(args.scenario).with_settings(settings_of(args))
    check_robots(scenario, terminal)
    profile = profile_of(scenario, args.driver)
    item = next(iter(scenario.objects)) if args.object is None else args.object
    case = next(iter(scenario.cases)) if args.case is None else args.case
    plan = TrialSpec.of(scenario, item, case).plan
    reflexes = {
        name: _reflexes(arm.facts, args.reflex_torque, args.reflex_force)
        for name, arm in plan.scene.physics.arms.items()
    }
    file = args.parameters
    file_parameters = None if file is None else {kind: values_of(file, kind) for kind in ("cell", "watchdog")}
    done = 0
    with terminal.stages() as report:

        def say(stage: str) -> None:
            nonlocal done
            report(stage, done, PHASES)
            done += 1

        checklist = rehearse(plan, profile, reflexes, file_parameters or values_for(profile, plan.arms), args.seed, say)
    document = {"scenario": scenario.name, "object": item, "case": plan.scene.case_name, "parameters": file_parameters}
    document |= checklist.to_json()
    page = None
    if args.output is not None:
        title = f"{scenario.name}, {item}, {plan.scene.case_name}"
        with output_folder(args.output):
            page = write_rehearsal(
                title, f"{profile.name} ({profile.source})", checklist.margins, document, args.output
            )
    terminal.result(document)
    terminal.say(
        f"{scenario.name}, {item}, {plan.scene.case_name}, against a stand-in of {profile.name} ({profile.source})",
        f"driver: joints {profile.joints_of(plan.arms)}, states on {profile.states}, torques on {profile.commands}",
        *(() if file is None else (f"cell and watchdog: with the parameters of {file}",)),
        *checklist.log,
        _table(checklist),
    )
    terminal.say(checklist.verdict)
    if page is not None:
        terminal.say(f"page: {page.resolve()}")
    return 0 if checklist.passed else 1


def _reflexes(facts: RobotFacts, torque: float | None, force: float | None) -> Reflexes:
    """Thresholds of the robot facts, or of the command line."""
    reflexes = facts.reflexes or Reflexes()
    update: dict[str, object] = {}
    if torque is not None:
        update["external_torque_Nm"] = (torque,) * facts.joint_count
    if force is not None:
        update["external_force_N"] = force
    return reflexes.model_copy(update=update)


def _table(checklist: Checklist) -> Table:
    """The checklist for the terminal."""
    table = Table(title="checklist; times count from the start of the rehearsal")
    table.add_column("measured")
    for heading in ("value", "bound", "margin"):
        table.add_column(heading, justify="right")
    table.add_column("unit")
    table.add_column("where")
    table.add_column("")
    for margin in checklist.margins:
        sign = "≥" if margin.at_least else "≤"
        verdict = "ok" if margin.holds else "BEYOND"
        table.add_row(
            margin.name,
            f"{margin.value:.4g}",
            f"{sign} {margin.bound:.4g}",
            f"{margin.margin:.4g}",
            margin.unit,
            margin.where,
            verdict,
        )
    return table
