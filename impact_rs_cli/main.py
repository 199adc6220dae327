# SPDX-License-Identifier: Apache-2.0
"""``impact-rs``: the command line. Holds no logic; every subcommand is a module of :mod:`impact_rs_cli.commands`."""

from __future__ import annotations

import argparse
import logging
import os
import sys
from collections.abc import Sequence
from contextlib import suppress

from impact_rs_cli.parser import CommandParser, Parser
from impact_rs_sim.errors import InputError, full_traceback, shortened
from impact_rs_sim.version import package_version

COMMANDS = {  # name: module of impact_rs_cli.commands, imported when the command is used, and what it does
    "demo": ("demo", "run the whole loop once: trials, analysis, diagnosis, better model"),
    "map": ("map", "predict the velocities just after an impact"),
    "trial": ("trial", "run one trial and record it"),
    "campaign": ("campaign", "run many trials, or continue a campaign"),
    "analyze": ("analyze", "compare predictions with recorded trials"),
    "study": ("study", "run and analyse all 450 trials of the published study"),
    "show": ("show", "show a trial in 3D"),
    "export": ("export", "write a campaign into one Parquet or HDF5 file"),
    "compare": ("compare", "show where a model fails against trials"),
    "diagnose": ("diagnose", "name the physical effect that a model lacks"),
    "add": ("add_effect", "add a diagnosed effect to a model"),
    "history": ("history", "show how the error fell from model to model"),
    "effects": ("effects", "list the library of physical effects"),
    "blind": ("blind", "make a campaign with a hidden effect, or score a diagnosis"),
    "friction": ("friction", "identify the friction compensation of a scenario"),
    "robot": ("robot", "import the URDF of your own robot, and check it"),
    "scenario": ("scenario", "write a scenario to start from, for any robot"),
    "paper": ("paper", "fit a motor-inertia scale to the published results"),
    "up": ("up", "start the ROS 2 nodes"),
    "workbench": ("workbench", "run the loop on a page in the browser"),
}

LONGEST_MESSAGE = 2000  # characters of an error; some repeat what they were given

PACKAGES = (  # whose log --debug shows
    "impact_rs_sim",
    "impact_rs_control",
    "impact_rs_trials",
    "impact_rs_analysis",
    "impact_rs_ros",
    "impact_rs_workbench",
    "impact_rs_cli",
)

TEXT = """\
Predict, measure and explain simultaneous robot impacts.

  impact-rs demo                              the whole loop once, in some minutes
  impact-rs map push cat_food case_2          one prediction
  impact-rs campaign push -o campaigns/push   the experiment that tests it
  impact-rs analyze campaigns/push            the comparison, as a table and a report

  impact-rs compare RUNS --model MODEL        where the model fails
  impact-rs diagnose RUNS -o diagnosis.json   which physical effect it lacks
  impact-rs add EFFECT --from diagnosis.json -o model_2.yaml
  impact-rs history model_2.yaml --runs RUNS  how the error fell"""


def parser() -> Parser:
    """The argument parser with all subcommands, none of them imported."""
    main_parser = Parser(prog="impact-rs", description=TEXT)
    main_parser.add_argument("--version", action=_Version, nargs=0, help="show the version and exit")
    subparsers = main_parser.add_subparsers(
        title="commands", metavar="COMMAND", required=True, parser_class=CommandParser
    )
    for name, (module, summary) in COMMANDS.items():
        subparsers.add_parser(name, help=summary, module=f"impact_rs_cli.commands.{module}")
    return main_parser


class _Version(argparse.Action):
    """``--version``, looked up only when the option is given."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        print(f"impact-rs {package_version() or 'from a source tree'}")
        parser.exit()


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command.

    Args:
        argv: Arguments; None: those of the process.

    Returns:
        0 if the job was done, 1 if it was not, 2 for a mistake in the input, 130 after Ctrl-C.
    """
    args = argparse.Namespace(debug=False, json=False, resumable=False)
    try:
        if not (sys.argv[1:] if argv is None else argv):
            parser().print_help(sys.stderr)
            return 2
        parser().parse_args(argv, args)
        if args.debug:
            _show_log()
        code: int = args.run(args)
        sys.stdout.flush()  # raises here if the disk is full; when Python ends it would be too late
        return code
    except SystemExit as stop:  # --help, or a mistake in the arguments that has been reported
        return int(stop.code or 0)
    except InputError as error:
        return _fail(error, str(error), 2, args.debug)
    except KeyboardInterrupt as error:
        hint = "; the same command goes on where it stopped" if args.resumable else ""
        return _fail(error, f"interrupted{hint}", 130, args.debug)
    except BrokenPipeError:  # the reader of our output has closed the pipe
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except RecursionError as error:
        return _fail(error, "something in the input is nested too deeply", 2, args.debug)
    except MemoryError as error:
        return _fail(error, "not enough memory on this machine", 2, args.debug)
    except OSError as error:
        return _fail(error, _os_words(error), 2, args.debug)
    except UnicodeError as error:
        return _fail(error, f"a text is not as it should be: {shortened(str(error))}", 2, args.debug)
    except RuntimeError as error:  # an impact map without an answer, nodes that do not start
        return _fail(error, str(error), 1, args.debug)


def _os_words(error: OSError) -> str:
    """Message of a system error: the file, and the reason."""
    name = error.filename if isinstance(error.filename, (str, bytes)) else None
    return f"{'' if name is None else f'{os.fsdecode(name)}: '}{error.strerror or error}"


def _show_log() -> None:
    """Show on standard error what the packages log."""
    logging.basicConfig(format="%(name)s: %(message)s")
    for package in PACKAGES:
        logging.getLogger(package).setLevel(logging.DEBUG)


def _fail(error: BaseException, message: str, code: int, debug: bool) -> int:
    if debug:
        print(full_traceback(error), file=sys.stderr)
    with suppress(OSError):  # a full disk may hold standard error, too
        print(f"impact-rs: {shortened(message, LONGEST_MESSAGE)}", file=sys.stderr)
    return code


if __name__ == "__main__":
    sys.exit(main())
