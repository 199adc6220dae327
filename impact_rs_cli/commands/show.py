# SPDX-License-Identifier: Apache-2.0
"""``impact-rs show``: one trial in 3D."""

from __future__ import annotations

import argparse
import webbrowser
from pathlib import Path

from impact_rs_analysis.report.trial import write_trial
from impact_rs_cli.terminal import PROGRAM, Terminal, add_json, declare
from impact_rs_sim.errors import InputError
from impact_rs_trials.bags.reader import BagError, TrialBag

TEXT = f"""\
Show one trial in 3D: arms, object and support as measured, contact forces, velocities before and after the impact.

Writes one HTML page that opens offline and on a phone, and opens it in the browser. A time slider moves the bodies and
the plots of joint positions, joint velocities and end-effector velocity together; the impact is played a hundred times
slower. Space plays, arrow keys step by 1 ms, with shift by 10 ms, I goes to the impact. Only measured signals are read.

example:
  {PROGRAM} show campaigns/push/cat_food__case_2__s1.000__r0
  {PROGRAM} show campaigns/push/cat_food__case_2__s1.000__r0 -o impact.html --no-browser

Units: s, m, m/s, N, joints in rad and rad/s (those that slide: m and m/s)."""


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the command."""
    declare(parser, run, TEXT)
    parser.add_argument(
        "path", type=Path, metavar="BAG", nargs="?", help="folder of a trial; with --experiment, of recordings"
    )
    parser.add_argument("--live", action="store_true", help="show the graph that runs now, until Ctrl-C")
    parser.add_argument("--namespace", metavar="NAME", help="with --live: ROS namespace of the nodes; default: none")
    parser.add_argument("--port", type=int, metavar="N", help="with --live: port of the page; default: a free one")
    parser.add_argument(
        "-o",
        dest="output",
        type=Path,
        metavar="FILE.html",
        help="the page; default: NAME_OF_THE_BAG.html beside the bag",
    )
    parser.add_argument("--no-browser", action="store_true", help="write the page, or serve it, and do not open it")
    add_json(parser)


def run(args: argparse.Namespace, terminal: Terminal) -> int:
    """Run the command."""
    if args.live:
        from impact_rs_cli.live import show_live  # ROS 2 and a web server, which a page in a file does without

        return show_live(args.namespace or "", args.port or 0, not args.no_browser, terminal)
    path = args.output or args.path.absolute().parent / f"{args.path.absolute().name}.html"
    if path.is_dir():
        raise InputError("this is a folder, expected a file for the page", file=path)
    try:
        page = write_trial(TrialBag.open(args.path), path).resolve()
    except BagError as error:
        raise InputError(error.reason, file=args.path) from None
    terminal.result({"page": str(page)})
    terminal.say(f"page: {page}")
    if not args.no_browser and not webbrowser.open(page.as_uri()):
        terminal.warn("no browser was found; open the page by hand")
    return 0
