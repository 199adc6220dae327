# SPDX-License-Identifier: Apache-2.0
"""``impact-rs campaign``: many trials."""

from __future__ import annotations

import argparse
import itertools
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import nullcontext

from impact_rs_cli.arguments import check_robots, settings_of, workforce_of
from impact_rs_cli.parser import command_line
from impact_rs_cli.terminal import Terminal, output_folder
from impact_rs_ros.names import full_namespace
from impact_rs_sim.errors import InputError
from impact_rs_sim.plant.mechanics import Simulator
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_trials.campaign import (
    FAILURES,
    Manifest,
    TrialReport,
    make_manifest,
    open_campaign,
    run_campaigns,
    still_to_run,
    wrong_outcomes,
)
from impact_rs_trials.experiment_plan import SCENARIO_FILE, ExperimentPlan, manifests_of, read_plan
from impact_rs_trials.store import Folder, Store, open_store, owned
from impact_rs_trials.varied_settings import with_sensitivity
from impact_rs_trials.workers import Workforce


def run(args: argparse.Namespace, terminal: Terminal) -> int:
    """Run the command."""
    _check_options(args)
    store = open_store(args.output)
    workforce = workforce_of(args)
    plan = plan_of(args)
    campaigns = {store: manifest_of(args)} if plan is None else {}
    for manifest in campaigns.values() if plan is None else manifests_of(plan).values():
        check_robots(load_scenario(manifest.scenario).with_settings(manifest.settings), terminal)
    if args.sensitivity and not isinstance(store, Folder):
        raise InputError("--sensitivity needs a folder of this machine; expected a path", file=args.output)
    with output_folder(store.path) if isinstance(store, Folder) else nullcontext():
        if plan is not None:
            campaigns = planned_campaigns(plan, store, args.plant)
        all_campaigns: Mapping[Store, Manifest] = campaigns
        if args.sensitivity and isinstance(store, Folder):
            all_campaigns = with_sensitivity(store, campaigns[store])
        reports: Iterator[tuple[Store, TrialReport]]
        if args.via == "nodes":
            reports = itertools.chain.from_iterable(
                through_nodes(target, manifest, args.namespace, args.without, terminal.warn)
                for target, manifest in campaigns.items()
            )
        else:
            reports = owned_campaigns(store, all_campaigns, workforce)
        finished = follow(reports, all_campaigns, terminal)
    outcomes = Counter(report.outcome for report in finished)
    wanted = sum(len(manifest.keys) for manifest in campaigns.values())
    done = sum(  # counts bags, independent of the reports
        len({key.name for key in manifest.keys} & target.names()) for target, manifest in campaigns.items()
    )
    terminal.result(
        {
            "directory": args.output,
            "trials": wanted,
            "present": done,
            "ran": len(finished),
            "outcomes": dict(outcomes),
            "wrong": [
                {"trial": report.key.name, "outcome": report.outcome, "message": report.message}
                for report in finished
                if report.outcome not in ("OK", "ABORTED")
            ],
            "failures": [
                {"trial": report.key.name, "message": report.message}
                for report in finished
                if report.outcome == "ABORTED"
            ],
        }
    )
    warn_wrong(finished, terminal)
    analyzed = args.plan is None
    further = (
        command_line("analyze", {"directory": args.output})
        if analyzed
        else command_line("diagnose", {"runs": args.output})
    )
    terminal.say(
        f"{done} of {wanted} trials are there ({counted(finished) or 'none had to be run'})",
        f"next: {further}",
    )
    none_is_ok = bool(finished) and not outcomes["OK"]
    return 1 if done < wanted or outcomes["ABORTED"] or none_is_ok else 0


def _check_options(args: argparse.Namespace) -> None:
    """Refuse options that the way of running the trials does not have."""
    if args.via == "nodes" and (args.settings or args.sensitivity):
        raise InputError(
            "--set and --sensitivity go with --via inprocess only: the nodes read the file of the scenario"
        )
    if args.via == "nodes" and (args.jobs not in (None, 1) or args.scheduler is not None):
        raise InputError("--jobs and --scheduler go with --via inprocess only: the nodes run one trial at a time")
    if args.via == "nodes" and args.plant != "bullet":
        raise InputError("--plant goes with --via inprocess only: the plant node runs Bullet")
    if args.without:
        check_without(args.without, args.via)
    if args.via != "nodes" and args.namespace:
        raise InputError("--namespace goes with --via nodes only: trials inside this program have no ROS names")


def manifest_of(args: argparse.Namespace) -> Manifest:
    """The campaign of a scenario.

    Raises:
        InputError: There is no scenario, or as :func:`make_manifest`.
    """
    if args.scenario is None:
        raise InputError("nothing to run; expected a SCENARIO, or --plan FILE.yaml")
    return make_manifest(
        args.scenario,
        args.objects,
        args.cases,
        args.scales,
        args.trials,
        args.seed,
        settings_of(args),
        args.plant,
        args.order,
    )


def plan_of(args: argparse.Namespace) -> ExperimentPlan | None:
    """The plan of ``--plan``; None without one.

    Raises:
        InputError: The plan cannot be used, or another option says what to run.
    """
    if args.plan is None:
        return None
    options = {
        "SCENARIO": args.scenario,
        "--objects": args.objects,
        "--cases": args.cases,
        "--scales": args.scales,
        "--trials": args.trials,
        "--seed": args.seed or None,
        "--order": None if args.order == "random" else args.order,
        "--set": args.settings or None,
        "--sensitivity": args.sensitivity or None,
    }
    if conflicting := [name for name, value in options.items() if value is not None]:
        raise InputError(f"{conflicting[0]} and --plan exclude each other: the plan says what to run")
    return read_plan(args.plan)


def planned_campaigns(plan: ExperimentPlan, store: Store, plant: Simulator) -> dict[Store, Manifest]:
    """The campaigns of a plan, each in a folder of the store.

    Raises:
        InputError: A scenario cannot be read, or its file cannot be written.
    """
    if not isinstance(store, Folder):
        manifests = manifests_of(plan, plant)
        return {open_store(f"{store}/{folder}"): manifest for folder, manifest in manifests.items()}
    manifests = manifests_of(plan, plant, lambda campaign: store.path / campaign.folder / SCENARIO_FILE)
    return {Folder(store.path / folder): manifest for folder, manifest in manifests.items()}


def counted(reports: Iterable[TrialReport]) -> str:
    """Outcomes with their numbers, in words."""
    return ", ".join(f"{count} {outcome}" for outcome, count in Counter(report.outcome for report in reports).items())


def warn_wrong(reports: Iterable[TrialReport], terminal: Terminal) -> None:
    """Warn of failed trials; no analysis uses them."""
    for line in wrong_outcomes(reports):
        terminal.warn(line)


def check_without(without: Sequence[str], via: str) -> None:
    """Check the names of ``--without``, and that trials run through nodes.

    Raises:
        InputError: A name is no node, or trials run in this program.
    """
    if via != "nodes":
        raise InputError("--without goes with --via nodes only: trials inside this program have no nodes")
    from impact_rs_ros.node_processes import nodes_to_start  # as below

    nodes_to_start(without)


def through_nodes(
    store: Store,
    manifest: Manifest,
    namespace: str,
    without: Sequence[str] = (),
    say: Callable[[str], None] = lambda line: None,
) -> Iterator[tuple[Store, TrialReport]]:
    """Run the missing trials through the ROS 2 nodes, without those that the user provides.

    Yields as :func:`owned_campaigns`; ``say`` prints the awaited nodes.

    Raises:
        InputError: The campaign does not lie in a folder, another process works on it, or ROS has no such namespace.
    """
    # Only --via nodes needs ROS 2: without it trials still run in this program.
    from impact_rs_ros.graph import run_trials_through_nodes

    if not isinstance(store, Folder):
        raise InputError("the nodes record in a folder of this machine; expected a path", file=str(store))
    namespace = full_namespace(namespace)
    with owned(store):
        todo = open_campaign(store, manifest)
        for report in run_trials_through_nodes(
            store.path, manifest, todo, namespace=namespace, without=without, notify=say
        ):
            yield store, report


def owned_campaigns(
    store: Store, campaigns: Mapping[Store, Manifest], workforce: Workforce
) -> Iterator[tuple[Store, TrialReport]]:
    """Run campaigns, while the folder is locked against other processes.

    Raises:
        InputError: As :func:`impact_rs_trials.campaign.run_campaigns`, or another process works on it.
    """
    with owned(store):
        yield from run_campaigns(campaigns, workforce)


def follow(
    reports: Iterator[tuple[Store, TrialReport]],
    campaigns: Mapping[Store, Manifest],
    terminal: Terminal,
    label: str = "trials",
) -> list[TrialReport]:
    """Show progress and failures while trials run; returns their reports."""
    finished = []
    total = sum(len(manifest.keys) for manifest in campaigns.values())
    present = total - sum(len(still_to_run(store, manifest)) for store, manifest in campaigns.items())
    with terminal.progress(label) as report_progress:
        report_progress(present, total)
        for number, (store, report) in enumerate(reports, start=present + 1):
            finished.append(report)
            if report.outcome == "ABORTED":
                terminal.warn(f"{report.key.name}: {report.message or 'aborted'}")
                terminal.warn(f"full error: {store}/{FAILURES}/{report.key.name}.txt")
                terminal.trace(report.trace)
            report_progress(number, total)
    return finished
