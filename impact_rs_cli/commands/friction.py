# SPDX-License-Identifier: Apache-2.0
"""``impact-rs friction``: feedforward of the controller against joint friction."""

from __future__ import annotations

import argparse

import numpy as np

from impact_rs_cli.arguments import started_workers
from impact_rs_cli.parser import command_line
from impact_rs_cli.terminal import Terminal, output_folder
from impact_rs_sim.model import load_model
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_trials import friction_files


def identify(args: argparse.Namespace, terminal: Terminal) -> int:
    """Identify and write."""
    scenario = load_scenario(args.scenario)
    effects = None if args.effects is None else load_model(args.effects)
    with output_folder(args.output.parent):
        friction_files.prepare_output(args.scenario, args.output)
        with started_workers(args) as map_tasks, terminal.progress("arms") as report_progress:
            compensation = friction_files.identify(
                scenario, args.objects, args.cases, args.runs, args.seed, effects, map_tasks, report_progress
            )
        copy = friction_files.write_compensation(compensation, args.scenario, args.output)
    largest = [
        {
            "object": name,
            "case": case,
            "arm": arm,
            "largest_ante_m_s2": float(np.linalg.norm(entry.ante.rows[:, :3], axis=1).max()),
            "largest_post_m_s2": float(np.linalg.norm(entry.post.rows[:, :3], axis=1).max()),
        }
        for name, cases in compensation.sets.items()
        for case, arms in cases.items()
        for arm, entry in arms.items()
    ]
    terminal.result({"file": str(args.output), "scenario": str(copy), "runs": compensation.runs, "sets": largest})
    for row in largest:
        terminal.say(
            f"{row['object']} {row['case']} {row['arm']}: up to {row['largest_ante_m_s2']:.2f} m/s^2 before and "
            f"{row['largest_post_m_s2']:.2f} m/s^2 after the impact"
        )
    terminal.say(
        f"{args.output}: averages of {compensation.runs} runs",
        f"next: {command_line('campaign', {'scenario': copy, 'output': 'campaigns/compensated'})}",
    )
    return 0
