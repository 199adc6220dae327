# SPDX-License-Identifier: Apache-2.0
"""``impact-rs study-design``: robots, poses, motor inertias and pads, ranked by the effect of an impact."""

from __future__ import annotations

import argparse

from rich.table import Table

from impact_rs_analysis.measure.design_study import (
    MEASURES,
    DesignConditions,
    DesignStudy,
    study_designs,
)
from impact_rs_analysis.report.design_page import write_design_study
from impact_rs_analysis.report.page_names import DESIGNS_TABLE
from impact_rs_cli.arguments import started_workers
from impact_rs_cli.terminal import Terminal, output_folder
from impact_rs_sim.numbers import CONFIDENCE_LEVEL
from impact_rs_sim.scenarios.scenario_files import load_scenario

MAX_SHOWN_DESIGNS = 8  # all are in the file


def run(args: argparse.Namespace, terminal: Terminal) -> int:
    """Run the command."""
    scenario = load_scenario(args.scenario)
    conditions = DesignConditions(
        scenario,
        args.object or next(iter(scenario.objects)),
        args.speed,
        tuple(dict.fromkeys(args.motor_inertia)),
        tuple(dict.fromkeys(args.pads)),
        args.draws,
        args.seed,
    )
    with output_folder(args.output), started_workers(args) as map_tasks, terminal.stages() as report_progress:
        study = study_designs(conditions, tuple(dict.fromkeys(args.robots)), args.poses, map_tasks, report_progress)
        page = write_design_study(study, args.output)
    _show(study, args.rank_by, terminal)
    terminal.result(_document(study))
    for name, reason in list(study.failed.items())[:MAX_SHOWN_DESIGNS]:
        terminal.warn(f"no answer for {name}: {reason}")
    terminal.say(f"report: {page.resolve()}", f"table: {(args.output / DESIGNS_TABLE).resolve()}")
    return 0


def _show(study: DesignStudy, measure: str, terminal: Terminal) -> None:
    """The first designs by one measure."""
    info = MEASURES[measure]
    table = Table(title=f"Most {info.label} of {len(study.designs)} designs")
    for heading in (
        "robot/pose/motor inertia/pad",
        f"[{info.unit}]",
        f"{CONFIDENCE_LEVEL:.0%} interval",
        "rank",
    ):
        table.add_column(heading, no_wrap=True)
    for design, best, worst in study.ranked(measure)[:MAX_SHOWN_DESIGNS]:
        value = design.measures[measure]
        interval = f"{value.low:.3g} ... {value.high:.3g}"
        table.add_row(design.name, f"{value.value:.3g}", interval, f"{best} to {worst}")
    terminal.say(table)


def _document(study: DesignStudy) -> dict[str, object]:
    """The study as JSON: the three orders, each with values and intervals."""
    return {
        "scenario": study.conditions.scenario.name,
        "object": study.conditions.object_name,
        "speed_m_s": study.conditions.speed,
        "draws": study.conditions.draws,
        "seed": study.conditions.seed,
        "places": dict(study.tries),
        "failed": dict(study.failed),
        "ranked": {
            name: [
                {
                    "design": design.name,
                    "value": design.measures[name].value,
                    "low": design.measures[name].low,
                    "high": design.measures[name].high,
                    "best_rank": best,
                    "worst_rank": worst,
                }
                for design, best, worst in study.ranked(name)
            ]
            for name in MEASURES
        },
    }
