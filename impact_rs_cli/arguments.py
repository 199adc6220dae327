# SPDX-License-Identifier: Apache-2.0
"""Shared arguments of the commands of the loop: RUNS, settings and worker processes."""

from __future__ import annotations

import argparse
import functools
import os
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

from impact_rs_cli.terminal import Action, Terminal
from impact_rs_commands.shared import RUNS_TEXT
from impact_rs_control.plan import check_joint_counts
from impact_rs_sim.errors import InputError, shortened
from impact_rs_sim.robot_check import failures_of
from impact_rs_sim.scenarios.scenario import Scenario
from impact_rs_sim.schema import parse_value
from impact_rs_trials.store import is_url, local_copy
from impact_rs_trials.workers import Map, Workforce, workers


def on_local_runs(run: Action) -> Action:
    """A command that reads ``args.runs`` from a local folder; bags at a URL are copied into a temporary one.

    Raises:
        InputError: The URL cannot be read, or ``--scheduler`` is given, whose workers would not see the copy.
    """

    @functools.wraps(run)
    def command(args: argparse.Namespace, terminal: Terminal) -> int:
        impacts = getattr(args, "impacts", None)  # not every command knows tables of impacts
        if impacts is not None:
            if args.runs is not None:
                raise InputError(f"--impacts {impacts} takes the place of RUNS; leave {args.runs} out")
            return run(args, terminal)
        if args.runs is None:
            raise InputError(f"nothing to read; expected RUNS, a {RUNS_TEXT}, or --impacts TABLE")
        if is_url(args.runs) and args.scheduler is not None:
            raise InputError(
                "with --scheduler RUNS must be a folder that all workers can read; copy the bags into one",
                file=args.runs,
            )
        with ExitStack() as copy_lifetime:
            with terminal.progress("copying bags") as report_progress:
                directory = copy_lifetime.enter_context(local_copy(args.runs, progress=report_progress))
            return run(argparse.Namespace(**vars(args) | {"runs": directory}), terminal)

    return command


def settings_of(args: argparse.Namespace) -> dict[str, Any]:
    """Values of ``--set`` by dotted key.

    Raises:
        InputError: There is no key, or the value is no YAML.
    """
    settings = {}
    for text in args.settings:
        key, equals, value = text.partition("=")
        read = parse_value(value, shortened(key))
        if not (key and equals and value):
            raise InputError(f"argument --set: expected KEY=VALUE, for example control.clamp_force=90, got {text!r}")
        settings[key] = read
    return settings


def workforce_of(args: argparse.Namespace) -> Workforce:
    """Worker processes by ``--jobs`` or ``--scheduler``; by default one per core that this process may use.

    Raises:
        InputError: Fewer than one process, or both options.
    """
    if args.scheduler is not None and args.jobs is not None:
        raise InputError(
            "--jobs counts processes of this machine; leave it out with --scheduler, which brings its own workers"
        )
    if args.scheduler is not None:
        return Workforce(scheduler=args.scheduler)
    return Workforce(len(os.sched_getaffinity(0)) if args.jobs is None else args.jobs)


@contextmanager
def started_workers(args: argparse.Namespace) -> Iterator[Map]:
    """The workers of ``--jobs`` or ``--scheduler``.

    Raises:
        InputError: Fewer than one process, both options, or a scheduler that cannot be used.
    """
    with workers(workforce_of(args)) as map_tasks:
        yield map_tasks


def check_robots(scenario: Scenario, terminal: Terminal) -> None:
    """Warn of arms that fail the robot check, before they move.

    Raises:
        InputError: The controller cannot control one of the arms.
    """
    check_joint_counts(scenario)
    for check in failures_of(scenario):
        terminal.warn(f"robot check failed, trials may diverge: {check.name}: {check.found}")


def three_digits(value: float) -> str:
    """Three significant digits."""
    return f"{value:.3g}"
