# SPDX-License-Identifier: Apache-2.0
"""``impact-rs blind``: campaigns with a hidden effect, and the score of a diagnosis."""

from __future__ import annotations

import argparse
from pathlib import Path

from impact_rs_analysis.diagnosis.document import read_document
from impact_rs_analysis.diagnosis.scoring import score as score_diagnosis
from impact_rs_cli.arguments import add_jobs, started
from impact_rs_cli.parser import Parser
from impact_rs_cli.terminal import PROGRAM, Terminal, add_json, declare, output_folder
from impact_rs_sim.errors import InputError
from impact_rs_trials import blind

TEXT = f"""\
Make a campaign whose plant has a hidden effect, or score a diagnosis of one.

make draws effect and size from SEED, records pushes and free motions into DIR/runs, and writes DIR/truth.json, which
only score reads. Kinds: single, pair, null (no hidden effect), outside (an effect that is not in the library).

example:
  {PROGRAM} blind make 7 -o blind_7 --size small
  {PROGRAM} diagnose blind_7/runs -o diagnosis.json
  {PROGRAM} blind score blind_7 --diagnosis diagnosis.json
  {PROGRAM} blind make 8 -o blind_8 --scenarios my_push.yaml my_excite.yaml      # for your own robot

Units: truth.json names those of the hidden parameters."""


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the command."""
    declare(parser, make, TEXT)
    actions = parser.add_subparsers(title="actions", metavar="ACTION", required=True, parser_class=Parser)
    maker = actions.add_parser("make", help="make a campaign with a hidden effect")
    declare(maker, make, TEXT)
    maker.add_argument("seed", type=int, metavar="SEED", help="whole number; the same seed hides the same effect")
    maker.add_argument("-o", dest="output", type=Path, required=True, metavar="DIR", help="folder of the campaign")
    maker.add_argument("--kind", choices=("single", "pair", "null", "outside"), default="single", help="%(default)s")
    maker.add_argument(
        "--effect", metavar="NAME", help="effect to hide, FIRST+SECOND for a pair; default: drawn from SEED"
    )
    maker.add_argument(
        "--scenarios",
        nargs="+",
        metavar="SCENARIO",
        default=list(blind.SCENARIOS),
        help="scenarios of one arm to record: pushes and free motions; default: push excite",
    )
    maker.add_argument("--size", choices=("small", "full"), default="small", help="default: %(default)s")
    add_jobs(maker)
    add_json(maker)
    scorer = actions.add_parser("score", help="score a diagnosis against the truth")
    declare(scorer, score, TEXT)
    scorer.add_argument("directory", type=Path, metavar="DIR", help="folder of the campaign")
    scorer.add_argument(
        "--diagnosis", type=Path, required=True, metavar="FILE.json", help="diagnosis of its folder runs"
    )
    add_json(scorer)


def make(args: argparse.Namespace, terminal: Terminal) -> int:
    """Make a blind campaign."""
    if args.seed < 0:
        raise InputError(f"seed = {args.seed}: expected a whole number >= 0")
    done = 0
    with output_folder(args.output), started(args) as map_tasks, terminal.progress("trials") as report_progress:
        wanted = (args.kind, args.effect, args.size)
        for done, total in blind.make(args.output, args.seed, map_tasks, *wanted, scenarios=args.scenarios):
            report_progress(done, total)
    runs = args.output / blind.RUNS
    terminal.result({"directory": str(args.output), "runs": str(runs), "trials": done, "kind": args.kind})
    terminal.say(f"{done} trials in {runs}", f"next: {PROGRAM} diagnose {runs} -o diagnosis.json")
    return 0


def score(args: argparse.Namespace, terminal: Terminal) -> int:
    """Score a diagnosis."""
    found = score_diagnosis(args.directory, read_document(args.diagnosis), args.diagnosis)
    terminal.result({**vars(found), "truth": list(found.truth), "named": list(found.named)})
    cover = "" if found.intervals_cover is None else "; {} of {} intervals contain the truth".format(*found.covered)
    terminal.say(
        f"{'right' if found.correct else 'wrong'}: {found.kind}, hidden {', '.join(found.truth) or 'nothing'}, "
        f"named {', '.join(found.named) or 'nothing'}{cover}"
    )
    return 0
