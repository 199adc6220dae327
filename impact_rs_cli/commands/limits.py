# SPDX-License-Identifier: Apache-2.0
"""``impact-rs limits``: how fast the arms of a scenario may hit."""

from __future__ import annotations

import argparse
import math
from collections import Counter

import numpy as np
from rich.markup import escape
from rich.table import Table

from impact_rs_analysis.limits.hit_bounds import KIND_WORDS, KINDS, Thresholds
from impact_rs_analysis.limits.poses import LimitTask, PlacedLimit, limit_of
from impact_rs_analysis.limits.speed import HOLD_PROBABILITY, SpeedLimit, speed_words
from impact_rs_analysis.report.speed_limits import limits_document, write_limits
from impact_rs_cli.arguments import settings_of, started_workers
from impact_rs_cli.terminal import Terminal, output_folder
from impact_rs_sim.errors import InputError
from impact_rs_sim.physics import Physics
from impact_rs_sim.scenarios.scenario_files import load_scenario


def run(args: argparse.Namespace, terminal: Terminal) -> int:
    """Run the command."""
    scenario = load_scenario(args.scenario).with_settings(settings_of(args))
    _check(args)
    if scenario.object_gap > 0.0:
        raise InputError("the pads of this scenario touch nothing; expected 0 [m]", key="object_gap")
    objects = list(scenario.objects) if args.objects is None else args.objects
    cases = [scenario.case_name(name) for name in (scenario.cases if args.cases is None else args.cases)]
    for name in objects:
        scenario.object(name)
    thresholds = Thresholds(args.jump, args.reflex_torque, args.reflex_force)
    tasks = [
        LimitTask(scenario, item, case, thresholds=thresholds, draws=args.draws) for item in objects for case in cases
    ]
    limits: list[SpeedLimit] = []
    placed_limits: list[PlacedLimit] = []
    with started_workers(args) as map_tasks, terminal.progress("speed limits") as report:
        total = len(tasks) + args.places**2
        for result in map_tasks(limit_of, tasks):
            assert result.limit is not None
            limits.append(result.limit)
            report(len(limits), total)
        if args.places:
            slowest = min(limits, key=lambda limit: limit.speed)
            steps = np.linspace(-args.span, args.span, args.places) if args.places > 1 else np.zeros(1)
            grid_tasks = [
                LimitTask(scenario, slowest.object_name, slowest.case_name, float(x), float(z), thresholds, args.draws)
                for z in steps
                for x in steps
            ]
            for result in map_tasks(limit_of, grid_tasks):
                placed_limits.append(result)
                report(len(limits) + len(placed_limits), total)
    page = None
    if args.output is not None:
        with output_folder(args.output):
            page = write_limits(scenario, limits, placed_limits, args.output)
    terminal.result(limits_document(scenario, limits, placed_limits))
    terminal.say(_table(scenario.name, limits))
    slow = sum(not result.allowed for result in limits)
    terminal.say(
        f"{slow} of {len(limits)} planned hits are too fast" if slow else "all planned hits are allowed",
        "half: a bound is exceeded in half of the draws; the other columns count the bounds of one kind alone",
    )
    for binding, count in Counter(result.binding for result in limits).most_common():
        terminal.say(f"nearest bound of {count} of {len(limits)}: {binding}")
    for kind in limits[0].unknown:
        terminal.warn(
            f"no bound of the {KIND_WORDS[kind]} is known: it limits nothing here (robot facts, section reflexes)"
        )
    if note := Physics.nominal(scenario, objects[0]).assumed:
        terminal.say(f"note: {note}")
    if placed_limits:
        reachable_speeds = [result.limit.speed for result in placed_limits if result.limit is not None]
        span = (
            f"{speed_words(min(reachable_speeds))} to {speed_words(max(reachable_speeds))}"
            if reachable_speeds
            else "no speed: none can be reached"
        )
        terminal.say(f"{len(reachable_speeds)} of {len(placed_limits)} places can be reached; they allow {span}")
    if page is not None:
        terminal.say(f"page: {page.resolve()}")
    return 0


def _check(args: argparse.Namespace) -> None:
    """Refuse numbers that mean nothing.

    Raises:
        InputError: There is one.
    """
    for name in ("jump", "reflex_torque", "reflex_force"):
        value = getattr(args, name)
        if value is not None and not 0.0 < value < math.inf:
            raise InputError(f"argument --{name.replace('_', '-')}: expected a number above 0, got {value:g}")
    if not 0.0 < args.span < math.inf:
        raise InputError(f"argument --span: expected a number above 0 [m], got {args.span:g}")
    if not 0 <= args.places <= 25:
        raise InputError(f"argument --places: expected 0 to 25, got {args.places}")


def _table(name: str, limits: list[SpeedLimit]) -> Table:
    """The table for the terminal."""
    kinds = [kind for kind in KINDS if kind not in limits[0].unknown]
    table = Table(
        title=escape(f"{name}: closing speed [m/s] up to which all bounds hold with {HOLD_PROBABILITY:.0%}"),
        pad_edge=False,
        collapse_padding=True,
    )
    for heading in ("object", "case"):
        table.add_column(heading, no_wrap=True)
    for heading in ("planned", "allowed", "half", *kinds):
        table.add_column(heading, justify="right", no_wrap=True)
    for limit in limits:
        table.add_row(
            limit.object_name,
            limit.case_name,
            f"{limit.planned:.3f}",
            _speed(limit.speed),
            _speed(limit.median),
            *(_speed(limit.by_kind[kind]) for kind in kinds),
        )
    return table


def _speed(value: float) -> str:
    return f"{value:.3f}" if math.isfinite(value) else "any"
