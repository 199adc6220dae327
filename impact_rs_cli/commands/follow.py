# SPDX-License-Identifier: Apache-2.0
"""``impact-rs follow``: update a model with every impact, and detect changes."""

from __future__ import annotations

import argparse
import time

from rich.markup import escape
from rich.table import Table

from impact_rs_analysis.application.followed_hits import (
    FollowedHits,
    diagnose_options,
    folder_of_diagnoses,
    hit_source_of,
    hits_options,
)
from impact_rs_analysis.evidence.calibration import calibration_of
from impact_rs_analysis.following.documents import ChangeDiagnosis, FollowDocument, HitDocument, NextHit
from impact_rs_analysis.following.follow import Follower
from impact_rs_analysis.following.hits import HitSource
from impact_rs_cli.arguments import on_local_runs, three_digits
from impact_rs_cli.full_diagnosis import FullDiagnosis
from impact_rs_cli.parser import PROGRAM
from impact_rs_cli.terminal import Terminal
from impact_rs_sim.errors import InputError
from impact_rs_sim.model import load_model, save_model
from impact_rs_sim.numbers import estimate_text

POLL_S = 0.5  # between two checks for new hits
MAX_SHOWN_NUMBERS = 13  # of a prediction


@on_local_runs
def run(args: argparse.Namespace, terminal: Terminal) -> int:
    """Run the command."""
    if args.live and args.json:
        raise InputError("--live goes on until Ctrl-C and has no JSON document; leave --json out")
    if not args.mean_time >= 1.0:
        raise InputError("expected a number of hits >= 1", key="--mean-time", value=args.mean_time)
    if args.output is not None and args.output.exists():
        raise InputError("this file exists already; model files are never overwritten", file=args.output)
    hits = hits_options(
        args.runs, args.impacts, scenario=args.scenario, contact_tolerance=args.contact_tolerance,
        exact=args.no_discrepancy, calibration=args.calibration,
    )  # fmt: skip
    model, calibration = load_model(args.model), calibration_of(hits.data, hits.calibration)
    calibrated_model = calibration.of(model)
    if calibration:
        terminal.say(f"calibration of the readings: {calibration.text}")
    hit_source = hit_source_of(hits, calibrated_model)
    follower = Follower(hit_source, calibrated_model, args.effects, args.learn, args.mean_time)
    options = diagnose_options(hits, str(args.model), args.effects)
    diagnosis = FullDiagnosis(options, folder_of_diagnoses(args.diagnoses, args.state))
    followed = FollowedHits(hits, follower, args.state, None if args.no_diagnosis else diagnosis)
    if count := followed.restore():
        terminal.say(f"state: goes on after {count} hits")
    documents: list[HitDocument] = []
    with terminal.progress("following hits") as report:
        for document in followed.arrived():
            documents.append(document)
            _say(document, diagnosis, terminal)
            report(len(documents), len(documents) + hit_source.waiting)
            _warn_of_refused(hit_source, terminal)
    _warn_of_refused(hit_source, terminal)
    followed.save()
    full_diagnosis = None
    try:
        _say_more(followed, terminal)
        if args.live:
            documents += _live(followed, diagnosis, terminal)
        else:
            full_diagnosis = _awaited(diagnosis, terminal)
    finally:
        diagnosis.stop()
    _warn_of_refused(hit_source, terminal)
    result = FollowDocument(
        model=model.name,
        hits=tuple(documents),
        followed=follower.followed(),
        prediction=follower.prediction(),
        diagnosis=full_diagnosis,
        skipped=hit_source.skipped,
    )
    _show(result, follower, terminal)
    if args.output is not None:
        updated_model = calibration.removed_from(follower.model_now(args.output.stem, str(args.model)))
        save_model(updated_model.model_copy(update={"parent_digest": model.digest}), args.output)
        terminal.say(f"followed model: {args.output}")
    terminal.result(result.model_dump(mode="json"))
    return 0


def _warn_of_refused(hit_source: HitSource, terminal: Terminal) -> None:
    """Warn of refused trials, once for each."""
    for name, reason in hit_source.newly_skipped().items():
        terminal.warn(f"left out: {name}: {reason}")


def _live(followed: FollowedHits, diagnosis: FullDiagnosis, terminal: Terminal) -> list[HitDocument]:
    """Wait for further hits until Ctrl-C."""
    terminal.say(f"waiting for hits in {followed.hits.data}; Ctrl-C ends")
    documents: list[HitDocument] = []
    try:
        while True:
            for document in followed.arrived():
                documents.append(document)
                _say(document, diagnosis, terminal, every=True)
            _warn_of_refused(followed.follower.hit_source, terminal)
            _say_more(followed, terminal)
            _say_diagnosis(diagnosis.ended(), terminal)
            time.sleep(POLL_S)
    except KeyboardInterrupt:
        return documents


def _awaited(diagnosis: FullDiagnosis, terminal: Terminal) -> ChangeDiagnosis | None:
    """Result of the started full diagnosis; None: not started, or ended by Ctrl-C."""
    try:
        return _say_diagnosis(diagnosis.ended(wait=True), terminal)
    except KeyboardInterrupt:
        terminal.say("full diagnosis: stopped")
        return None


def _say_more(followed: FollowedHits, terminal: Terminal) -> None:
    """Start the full diagnosis that is due, and say so."""
    if text := followed.diagnose():
        terminal.say(f"{text}, in a process of its own")


def _say_diagnosis(result: ChangeDiagnosis | None, terminal: Terminal) -> ChangeDiagnosis | None:
    """Say how a full diagnosis has ended."""
    if result is not None:
        terminal.say(f"full diagnosis: {result.words}", f"  {result.file}")
    return result


def _say(document: HitDocument, diagnosis: FullDiagnosis, terminal: Terminal, every: bool = False) -> None:
    """Print the result of a hit: changes and outliers, or every hit."""
    if every and document.error is not None:
        terminal.say(
            f"{document.name}: prediction off by {three_digits(document.error)} standard deviations, "
            f"{document.milliseconds:.1f} ms"
        )
    if document.odd and document.change is None and document.error is not None:
        terminal.say(f"{document.name}: odd, {three_digits(document.error)} standard deviations off; it weighs less")
    if document.resolved:
        terminal.say(f"{document.name}: {document.resolved}")
    if (change := document.change) is not None:
        again = "drifts on" if change.again else "CHANGE"
        terminal.say(
            escape(
                f"{again} at {change.hit}: {change.words}. Likelihood ratio 10^{change.log10_ratio:.1f} after "
                f"{change.hits} hits"
            )
        )
        terminal.say(f"  full diagnosis of the hits since then: {diagnosis.command(change.since)}")


def _show(document: FollowDocument, follower: Follower, terminal: Terminal) -> None:
    predicted_hits = [hit for hit in document.hits if hit.error is not None]
    changes = sum(hit.change is not None for hit in predicted_hits)
    terminal.say(
        f"Model {document.model!r} through {len(document.hits)} hits: {changes} change{'' if changes == 1 else 's'}"
    )
    if not follower.watching:
        terminal.say("the scatter is not known yet: more hits, or fewer with --learn")
        return
    if document.followed:
        table = Table(title="Believed parameters", title_justify="left")
        for heading in ("parameter", "estimate", "95 % interval", "unit"):
            table.add_column(heading, no_wrap=True)
        for parameter in document.followed:
            estimate, low, high = estimate_text(parameter.estimate, parameter.ci95)
            table.add_row(parameter.parameter, estimate, f"{low} ... {high}", parameter.unit.strip("-"))
        terminal.say(table)
    if document.prediction is not None:
        _show_prediction(document.prediction, terminal)


def _show_prediction(prediction: NextHit, terminal: Terminal) -> None:
    condition = f" of {prediction.condition}" if prediction.condition else ""
    table = Table(title=escape(f"Next hit{condition}, if it starts as {prediction.like}"), title_justify="left")
    for heading in ("signal", "", "prediction", "95 % interval", "unit"):
        table.add_column(heading, no_wrap=True)
    shown = [value for value in prediction.values if value.phase != "free"] or list(prediction.values)
    for value in shown[:MAX_SHOWN_NUMBERS]:
        estimate, low, high = estimate_text(value.value, value.ci95)
        table.add_row(value.signal, value.index, estimate, f"{low} ... {high}", value.unit)
    terminal.say(table)
    if len(shown) > MAX_SHOWN_NUMBERS:
        terminal.say(f"and {len(shown) - MAX_SHOWN_NUMBERS} more numbers ({PROGRAM} follow --json)")
