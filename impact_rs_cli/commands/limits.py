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
from impact_rs_analysis.limits.speed import HOLD_PROBABILITY, SpeedLimit
from impact_rs_analysis.report.speed_limits import limits_document, write_limits
from impact_rs_cli.arguments import settings_of, started
from impact_rs_cli.terminal import Terminal, output_folder
from impact_rs_sim.errors import InputError
from impact_rs_sim.physics import Physics
from impact_rs_sim.scenarios.scenario import load_scenario


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
    found: list[SpeedLimit] = []
    places: list[PlacedLimit] = []
    with started(args) as map_tasks, terminal.progress("speed limits") as report:
        total = len(tasks) + args.places**2
        for one in map_tasks(limit_of, tasks):
            assert one.limit is not None
            found.append(one.limit)
            report(len(found), total)
        if args.places:
            least = min(found, key=lambda limit: limit.speed)
            steps = np.linspace(-args.span, args.span, args.places) if args.places > 1 else np.zeros(1)
            around = [
                LimitTask(scenario, least.object_name, least.case_name, float(x), float(z), thresholds, args.draws)
                for z in steps
                for x in steps
            ]
            for one in map_tasks(limit_of, around):
                places.append(one)
                report(len(found) + len(places), total)
    page = None
    if args.output is not None:
        with output_folder(args.output):
            page = write_limits(scenario, found, places, args.output)
    terminal.result(limits_document(scenario, found, places))
    terminal.say(_table(scenario.name, found))
    slow = sum(not one.allowed for one in found)
    terminal.say(
        f"{slow} of {len(found)} planned hits are too fast" if slow else "all planned hits are allowed",
        "half: a bound is exceeded in half of the draws; the other columns count the bounds of one kind alone",
    )
    for binding, count in Counter(one.binding for one in found).most_common():
        terminal.say(f"nearest bound of {count} of {len(found)}: {binding}")
    for kind in found[0].unknown:
        terminal.warn(
            f"no bound of the {KIND_WORDS[kind]} is known: it limits nothing here (robot facts, section reflexes)"
        )
    if note := Physics.nominal(scenario, objects[0]).assumed:
        terminal.say(f"note: {note}")
    if places:
        reached = [one.limit.speed for one in places if one.limit is not None]
        span = f"{min(reached):.3f} to {max(reached):.3f} m/s" if reached else "no speed: none can be reached"
        terminal.say(f"{len(reached)} of {len(places)} places can be reached; they allow {span}")
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


def _table(name: str, found: list[SpeedLimit]) -> Table:
    """The table for the terminal."""
    known = [kind for kind in KINDS if kind not in found[0].unknown]
    table = Table(
        title=escape(f"{name}: closing speed [m/s] up to which all bounds hold with {HOLD_PROBABILITY:.0%}"),
        pad_edge=False,
        collapse_padding=True,
    )
    for heading in ("object", "case"):
        table.add_column(heading, no_wrap=True)
    for heading in ("planned", "allowed", "half", *known):
        table.add_column(heading, justify="right", no_wrap=True)
    for one in found:
        table.add_row(
            one.object_name,
            one.case_name,
            f"{one.planned:.3f}",
            _speed(one.speed),
            _speed(one.middle),
            *(_speed(one.by_kind[kind]) for kind in known),
        )
    return table


def _speed(value: float) -> str:
    return f"{value:.3f}" if math.isfinite(value) else "any"
