# SPDX-License-Identifier: Apache-2.0
"""``impact-rs blind``: campaigns with a hidden effect, and the score of a diagnosis."""

from __future__ import annotations

import argparse

from impact_rs_analysis.diagnosis.document import read_document
from impact_rs_analysis.diagnosis.scoring import score as score_diagnosis
from impact_rs_analysis.diagnosis.scoring import truth_of
from impact_rs_analysis.evidence.minimum_data import MIN_CLUSTERS
from impact_rs_analysis.investigation.endings import judged, read_ending
from impact_rs_cli.arguments import started_workers
from impact_rs_cli.parser import command_line
from impact_rs_cli.terminal import Terminal, output_folder
from impact_rs_sim.errors import InputError
from impact_rs_trials import blind


def make(args: argparse.Namespace, terminal: Terminal) -> int:
    """Make a blind campaign."""
    if args.seed < 0:
        raise InputError(f"seed = {args.seed}: expected a whole number >= 0")
    if (conditions := len(blind.specs(args.size, args.scenarios))) < MIN_CLUSTERS:
        raise InputError(
            f"scenarios = {', '.join(args.scenarios)}: {conditions} condition(s), expected at least {MIN_CLUSTERS}, "
            "because a diagnosis holds one out; add a motion there and back (--scenarios ... excite), or --size full"
        )
    done = 0
    with output_folder(args.output), started_workers(args) as map_tasks, terminal.progress("trials") as report_progress:
        choices = (args.kind, args.effect, args.size)
        for done, total in blind.make(args.output, args.seed, map_tasks, *choices, scenarios=args.scenarios):
            report_progress(done, total)
    runs = args.output / blind.RUNS
    terminal.result({"directory": str(args.output), "runs": str(runs), "trials": done, "kind": args.kind})
    terminal.say(
        f"{done} trials in {runs}", f"next: {command_line('diagnose', {'runs': runs, 'output': 'diagnosis.json'})}"
    )
    return 0


def score(args: argparse.Namespace, terminal: Terminal) -> int:
    """Score a diagnosis, or the end of an investigation."""
    if args.diagnosis is None:
        return _score_investigation(args, terminal)
    result = score_diagnosis(args.directory, read_document(args.diagnosis), args.diagnosis)
    terminal.result({**vars(result), "truth": list(result.truth), "named": list(result.named)})
    coverage = (
        "" if result.intervals_cover is None else "; {} of {} intervals contain the truth".format(*result.covered)
    )
    terminal.say(
        f"{'right' if result.correct else 'wrong'}: {result.kind}, hidden {', '.join(result.truth) or 'nothing'}, "
        f"named {', '.join(result.named) or 'nothing'}{coverage}"
    )
    return 0


def _score_investigation(args: argparse.Namespace, terminal: Terminal) -> int:
    """Score the end of an investigation."""
    ending = read_ending(args.directory)
    kind, hidden = truth_of(args.directory)
    right, wrong = judged(ending, kind, hidden)
    named = ending.effects if ending.certain else ending.candidates
    if right or wrong:
        judgement = "right" if right else "wrong"
    else:
        undecided = "undecided, and not every hidden effect is a candidate" if hidden else "undecided"
        judgement = "right in part, the rest not excluded" if ending.certain else undecided
    terminal.result(
        {
            "kind": kind,
            "truth": list(hidden),
            "verdict": ending.verdict,
            "named": list(named),
            "not_excluded": list(ending.not_excluded),
            "correct": right,
            "surely_wrong": wrong,
            "trials": ending.trials,
        }
    )
    terminal.say(
        f"{judgement}: {kind}, hidden {', '.join(hidden) or 'nothing'}; {ending.verdict}, "
        f"{'named' if ending.certain else 'possible'} {', '.join(named) or 'nothing'}, after {ending.trials} trials"
    )
    return 0
