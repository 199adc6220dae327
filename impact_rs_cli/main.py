"""``impact-rs``: the command line. Holds no logic; every subcommand lies in :mod:`impact_rs_cli.commands`."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence

from impact_rs_cli.commands import (
    add_effect,
    analyze,
    blind,
    campaign,
    compare,
    demo,
    diagnose,
    effects,
    export,
    friction,
    history,
    map,
    paper,
    study,
    trial,
    up,
)
from impact_rs_cli.terminal import Parser, Terminal
from impact_rs_sim.errors import InputError

LOOP = (compare, diagnose, add_effect, history, effects, blind)
COMMANDS = (demo, map, trial, campaign, analyze, study, export, *LOOP, friction, paper, up)

TEXT = """\
Predict, measure and explain simultaneous robot impacts.

  impact-rs demo                              everything once, in some minutes
  impact-rs map push cat_food case_2          one prediction
  impact-rs campaign push -o campaigns/push   the experiment that tests it
  impact-rs analyze campaigns/push            the comparison, as a table and a report

  impact-rs compare RUNS --model MODEL        where the model fails
  impact-rs diagnose RUNS -o diagnosis.json   which physical effect it lacks
  impact-rs add EFFECT --from diagnosis.json -o model_2.yaml
  impact-rs history model_2.yaml --runs RUNS  how the error fell"""


def parser() -> Parser:
    """The argument parser with all subcommands."""
    main_parser = Parser(prog="impact-rs", description=TEXT, formatter_class=argparse.RawDescriptionHelpFormatter)
    main_parser.add_argument("--version", action=_Version, nargs=0, help="show the version and exit")
    subparsers = main_parser.add_subparsers(title="commands", metavar="COMMAND", required=True, parser_class=Parser)
    for command in COMMANDS:
        command.add(subparsers)
    return main_parser


class _Version(argparse.Action):
    """``--version``, looked up only when it is asked for."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        from impact_rs_trials.bags.trial_info import package_version

        print(f"impact-rs {package_version() or 'from a source tree'}")
        parser.exit()


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command.

    Args:
        argv: Arguments; None: those of the process.

    Returns:
        0 if the job was done, 1 if it was not, 2 for a mistake in the input, 130 after Ctrl-C.
    """
    try:
        args = parser().parse_args(argv)
    except SystemExit as stop:  # --help, or a mistake that has been told
        return int(stop.code or 0)
    terminal = Terminal(args.json)
    try:
        with terminal.owned_output():
            code: int = args.run(args, terminal)
        terminal.finish()
        return code
    except InputError as error:
        return _fail(str(error), 2)
    except KeyboardInterrupt:
        hint = "; the same command goes on where it stopped" if args.run is campaign.run else ""
        return _fail(f"interrupted{hint}", 130)
    except BrokenPipeError:  # the reader of our output has left
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except RuntimeError as error:  # an impact map without an answer, nodes that do not start
        return _fail(str(error), 1)


def _fail(message: str, code: int) -> int:
    print(f"impact-rs: {' '.join(message.split())}", file=sys.stderr)
    return code


if __name__ == "__main__":
    sys.exit(main())
