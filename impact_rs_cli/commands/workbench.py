# SPDX-License-Identifier: Apache-2.0
"""``impact-rs workbench``: the loop as a page in the browser."""

from __future__ import annotations

import argparse
from pathlib import Path

from impact_rs_cli.terminal import PROGRAM, Terminal, declare
from impact_rs_sim.errors import InputError
from impact_rs_workbench.server import serve

TEXT = f"""\
Run the loop on one page in the browser: predict, measure, compare, diagnose, add, history.

The page is served to this machine alone, until Ctrl-C; the printed address contains the access key. Every action is a
command of this command line, which the page shows, and every result is a file in DIR: closing the page loses nothing.

example:
  {PROGRAM} workbench
  {PROGRAM} workbench campaigns --no-browser

Units: beside every number on the page."""


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the command."""
    declare(parser, run, TEXT)
    parser.add_argument(
        "directory", metavar="DIR", nargs="?", type=Path, default=Path("workbench"),
        help="folder of campaigns, recordings and models; default: %(default)s",
    )  # fmt: skip
    parser.add_argument("--no-browser", action="store_true", help="only print the address")
    parser.add_argument("--port", type=int, default=0, metavar="N", help="port to listen on; default: a free one")


def run(args: argparse.Namespace, terminal: Terminal) -> int:
    """Run the command."""
    if args.directory.exists() and not args.directory.is_dir():
        raise InputError("is a file; expected a folder for the workbench", file=args.directory)

    def announce(address: str) -> None:
        terminal.say(f"workbench of {args.directory}: {address}", "Ctrl-C ends it and stops running jobs")

    serve(args.directory, PROGRAM, args.port, not args.no_browser, announce)
    return 0
