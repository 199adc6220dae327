# SPDX-License-Identifier: Apache-2.0
"""``impact-rs show``: one run in 3D, or a graph while it runs."""

from __future__ import annotations

import argparse
import webbrowser
from itertools import islice
from pathlib import Path

from impact_rs_analysis.application.measurements import read_laboratory
from impact_rs_analysis.application.shown_runs import laboratory_run, write_page_of_trial
from impact_rs_analysis.evidence.tracks import Track, track_of_run
from impact_rs_analysis.report.trial import write_run
from impact_rs_cli.arguments import started_workers
from impact_rs_cli.reading import experiment_file
from impact_rs_cli.terminal import Terminal
from impact_rs_sim.errors import InputError
from impact_rs_sim.model import load_model
from impact_rs_trials.file_names import BAG_METADATA
from impact_rs_trials.runs import Run
from impact_rs_trials.store import is_bag
from impact_rs_trials.workers import Map

MAX_SEARCHED_FOLDERS = 1000  # for a trial to suggest
LIVE_ALONE = ("namespace", "port")  # options that only --live has
LABORATORY_ALONE = ("run_name", "model", "jobs", "scheduler")  # and options of --experiment
OF_PAGES = ("path", "output", "experiment", *LABORATORY_ALONE)  # and options that mean nothing with --live


def run(args: argparse.Namespace, terminal: Terminal) -> int:
    """Run the command."""
    if args.live:
        _none_of(args, OF_PAGES, "--live shows running nodes")
        if args.json:
            raise InputError("--live serves a page and has no JSON document; leave --json out")
        from impact_rs_cli.live_graph import show_live  # ROS 2 and a web server, which a page in a file does without

        return show_live(args.namespace or "", args.port or 0, not args.no_browser, terminal)
    _none_of(args, LIVE_ALONE, "without --live a page is written into a file")
    if args.path is None:
        raise InputError("expected BAG, the folder of a trial, or --live")
    args.experiment = experiment_file(args.experiment, args.path, terminal)
    if args.experiment is None:
        _none_of(args, LABORATORY_ALONE, "without an experiment file BAG is a trial of impact_rs")
        page = _trial_page(args)
    else:
        page = _laboratory_page(args, terminal)
    terminal.result({"page": str(page)})
    terminal.say(f"page: {page}")
    if not args.no_browser and not webbrowser.open(page.as_uri()):
        terminal.warn("no browser found; open the page yourself")
    return 0


def _none_of(args: argparse.Namespace, names: tuple[str, ...], why: str) -> None:
    """Check that no option is given that has no meaning here.

    Raises:
        InputError: One is.
    """
    spelled = {"path": "BAG", "output": "-o", "run_name": "--run"}
    flags = [spelled.get(name, f"--{name}") for name in names if getattr(args, name) is not None]
    if flags:
        raise InputError(f"{why}; leave {', '.join(flags)} out")


def _output(args: argparse.Namespace, name: str) -> Path:
    path: Path = args.output or args.path.absolute().parent / name
    if path.is_dir():
        raise InputError("this is a folder, expected a file for the page", file=path)
    return path


def check_trial(path: Path) -> None:
    """Check that a path is the folder of a trial, complete or damaged.

    Raises:
        InputError: It is not; the message describes it, and names a trial nearby.
    """
    if not path.exists():
        raise InputError("no such folder; expected the folder of a trial", file=path)
    if not path.is_dir():
        remedy = f"; the folder of its trial is {path.parent}" if is_bag(path.parent) else ""
        raise InputError(f"a file; expected the folder of a trial, which holds metadata.yaml{remedy}", file=path)
    if is_bag(path) or any(path.glob("*.mcap")):
        return
    trials = [
        str(file.parent) for file in islice(path.rglob(BAG_METADATA), MAX_SEARCHED_FOLDERS) if is_bag(file.parent)
    ]
    remedy = f"; there are trials below it, for example {min(trials)}" if trials else ", nor does a folder below it"
    raise InputError(f"not the folder of a trial: it holds neither metadata.yaml nor an .mcap file{remedy}", file=path)


def _trial_page(args: argparse.Namespace) -> Path:
    check_trial(args.path)
    path = _output(args, f"{args.path.absolute().name}.html")
    return write_page_of_trial(args.path, path).resolve()


def _laboratory_page(args: argparse.Namespace, terminal: Terminal) -> Path:
    if args.run_name is None:
        raise InputError("a folder of runs; select one with --run NAME")
    directory = args.path.absolute()
    with started_workers(args) as map_tasks:
        shown = laboratory_run(directory, args.experiment, args.run_name, map_tasks)
        path = _output(args, f"{directory.name}_{shown.name}.html")
        twin_track = None if args.model is None else _beside_model(args, shown, map_tasks, terminal)
    if shown.hit and shown.signals.object_time.size < 2:
        terminal.warn(f"{shown.name}: the pose of {shown.condition_key[1]} was not recorded, so it is not shown")
    return write_run(shown, path, twin_track, "" if args.model is None else str(args.model)).resolve()


def _beside_model(args: argparse.Namespace, shown: Run, map_tasks: Map, terminal: Terminal) -> Track:
    """The run and its twin; all runs are read, because their clocks are estimated together."""
    model = load_model(args.model)
    runs = read_laboratory(args.path, args.experiment, map_tasks, terminal)
    compared_run = next((run for run in runs.runs if run.path == shown.path), None)
    if compared_run is None:
        reason = dict(runs.skipped).get(str(shown.path), "it was left out")
        raise InputError(f"cannot be compared with a model: {reason}", file=shown.path)
    return track_of_run(compared_run, model)
