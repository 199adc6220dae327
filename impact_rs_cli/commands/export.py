# SPDX-License-Identifier: Apache-2.0
"""``impact-rs export``: a campaign as one file or growing data set, or a model as files of other simulators."""

from __future__ import annotations

import argparse
from contextlib import nullcontext
from pathlib import Path

from impact_rs_analysis.application.observer import warn_skipped
from impact_rs_analysis.measure.data_set import extend
from impact_rs_analysis.measure.export import check_target, export
from impact_rs_cli.arguments import started_workers
from impact_rs_cli.terminal import Terminal, output_folder
from impact_rs_sim.descriptions import FORMATS, ExportedScene
from impact_rs_sim.errors import InputError
from impact_rs_sim.files import write_whole
from impact_rs_sim.model import load_model
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_sim.scene import Scene
from impact_rs_trials.store import local_copy

EXAMPLE = {"scenario": "scenario push", "object": "object cat_food", "case": "case case_2"}


def run(args: argparse.Namespace, terminal: Terminal) -> int:
    """Run the command."""
    targets = {name: path for name in FORMATS if (path := getattr(args, name)) is not None}
    if targets:
        return _describe(args, targets, terminal)
    if args.campaign is None or args.output is None:
        flags = ", ".join(f"--{name.replace('_', '-')}" for name in FORMATS)
        raise InputError(f"nothing to write; expected CAMPAIGN -o FILE, or {flags} FILE with --scenario")
    if not args.output.suffix:
        return _extend(args, terminal)
    check_target(args.output)
    with (
        local_copy(args.campaign) as directory,
        # Signals are read in this process: they would be most of the work to pass on.
        started_workers(args) if args.output.suffix == ".parquet" else nullcontext(map) as map_tasks,
        output_folder(args.output.parent),
        terminal.progress("reading bags") as report_progress,
    ):
        exported = export(directory.absolute(), args.output, map_tasks, report_progress)
    warn_skipped([(bag.name, bag.reason) for bag in exported.skipped], terminal)
    skipped = [vars(bag) for bag in exported.skipped]
    terminal.result({"file": str(args.output), "trials": exported.trials, "skipped": skipped})
    terminal.say(f"{exported.trials} trials in {args.output}")
    return 0


def _describe(args: argparse.Namespace, targets: dict[str, Path], terminal: Terminal) -> int:
    """Write a scene and its model for other simulators."""
    if args.campaign is not None or args.output is not None:
        raise InputError("CAMPAIGN -o FILE and files of simulators are two exports; run the command twice")
    for name in ("scenario", "object", "case"):
        if getattr(args, name) is None:
            raise InputError(f"--{name} is missing; expected the scene of the model, for example --{EXAMPLE[name]}")
    for name, path in targets.items():
        if path.suffix not in FORMATS[name].suffixes:
            raise InputError(f"expected a name that ends with {' or '.join(FORMATS[name].suffixes)}", file=path)
        if path.is_dir():
            raise InputError("this is a folder; expected the name of a file", file=path)
    scene = Scene.resolve(load_scenario(args.scenario), args.object, args.case)
    exported = ExportedScene.of(scene, load_model(args.model), args.motor_inertia, args.pads)
    written = {name: FORMATS[name].write(exported) for name in targets}
    for name, path in targets.items():
        write_whole(path, written[name].text)
        terminal.say(f"{FORMATS[name].label}: {path}")
        for item in written[name].left_out:
            terminal.say(f"  not in it: {item}")
    terminal.result(
        {
            name: {"file": str(path), "remarks": written[name].remarks, "left_out": written[name].left_out}
            for name, path in targets.items()
        }
    )
    return 0


def _extend(args: argparse.Namespace, terminal: Terminal) -> int:
    """Bring a data set up to date with the campaign."""
    args.resumable = True
    with (
        started_workers(args) as map_tasks,
        output_folder(args.output),
        terminal.progress("reading new bags") as report_progress,
    ):
        data_set = extend(args.campaign, args.output, map_tasks, report_progress)
    warn_skipped([(bag.name, bag.reason) for bag in data_set.skipped], terminal)
    skipped = [vars(bag) for bag in data_set.skipped]
    terminal.result({"folder": str(args.output), "trials": data_set.trials, "read": data_set.read, "skipped": skipped})
    terminal.say(f"{data_set.trials} trials in {args.output}, {data_set.read} of them read now")
    return 0
