# SPDX-License-Identifier: Apache-2.0
"""``impact-rs``: reads the command line, runs the command, and makes one line and an exit code of its errors.

Commands are declared in :mod:`impact_rs_commands`; each is run by a module of :mod:`impact_rs_cli.commands`. Steps
that several commands share (measurements, benches of investigations, hits that are followed) stand in modules next to
this one.
"""

from __future__ import annotations

import argparse
import logging
import os
import signal
import sys
from collections.abc import Sequence
from contextlib import suppress
from importlib import import_module

from impact_rs_cli.parser import CommandParser, Parser, spelled
from impact_rs_commands import COMMANDS
from impact_rs_sim.errors import InputError, MissingPackage, full_traceback, shortened
from impact_rs_sim.progress import VARIABLE as PROGRESS_FILE

MAX_ERROR_CHARACTERS = 2000  # of an error; some repeat what they were given

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
    """The argument parser with all subcommands, without importing them."""
    main_parser = Parser(prog="impact-rs", description=spelled(TEXT))
    main_parser.add_argument("--version", action=_Version, nargs=0, help="show the version and exit")
    subparsers = main_parser.add_subparsers(
        title="commands", metavar="COMMAND", required=True, parser_class=CommandParser
    )
    for command in COMMANDS.values():
        subparsers.add_parser(command.name, help=command.summary, command=command)
    return main_parser


class _Version(argparse.Action):
    """``--version``, looked up only when the option is given."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        version = import_module("impact_rs_sim.version").package_version()
        print(f"impact-rs {version or 'from a source tree'}")
        parser.exit()


def _let_a_page_stop_its_job() -> None:
    """Take SIGINT again, which a job ignores where a script has started its page in the background."""
    if PROGRESS_FILE in os.environ and signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command.

    Args:
        argv: Arguments; None: the process's.

    Returns:
        0 if the job was done, 1 if it was not, 2 for a mistake in the input, 130 after Ctrl-C.
    """
    _let_a_page_stop_its_job()
    os.environ.setdefault("OMP_NUM_THREADS", "1")  # the matrices are small; more threads of BLAS cost time
    args = argparse.Namespace(debug=False, json=False, resumable=False)
    try:
        if not (sys.argv[1:] if argv is None else argv):
            parser().print_help(sys.stderr)
            return 2
        parser().parse_args(argv, args)
        if args.debug:
            _show_log()
        code = _run(args)
        sys.stdout.flush()  # raises here if the disk is full; when Python ends it would be too late
        return code
    except SystemExit as stop:  # --help, or a mistake in the arguments that has been reported
        return int(stop.code or 0)
    except MissingPackage as error:
        code = _fail(error, str(error), 2, args.debug)
        offered = not args.json and import_module("impact_rs_cli.installing").offer()
        return main(argv) if offered else code
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


def _run(args: argparse.Namespace) -> int:
    """Run the command in its module, imported only now: ``--help`` waits for no library."""
    module = import_module(f"impact_rs_cli.commands.{args.command.file}")
    code: int = import_module("impact_rs_cli.terminal").run(getattr(module, args.command.function), args)
    return code


def _os_words(error: OSError) -> str:
    """Message of a system error: the file, and the reason."""
    name = error.filename if isinstance(error.filename, (str, bytes)) else None
    return f"{'' if name is None else f'{os.fsdecode(name)}: '}{error.strerror or error}"


def _show_log() -> None:
    """Show the log of the packages on standard error."""
    logging.basicConfig(format="%(name)s: %(message)s")
    for package in PACKAGES:
        logging.getLogger(package).setLevel(logging.DEBUG)


def _fail(error: BaseException, message: str, code: int, debug: bool) -> int:
    if debug:
        print(full_traceback(error), file=sys.stderr)
    with suppress(OSError):  # a full disk may hold standard error, too
        print(f"impact-rs: {shortened(message, MAX_ERROR_CHARACTERS)}", file=sys.stderr)
    return code


if __name__ == "__main__":
    sys.exit(main())
