# SPDX-License-Identifier: Apache-2.0
"""``impact-rs evidence``: packages of evidence that laboratories exchange, their check, and their meta-analysis."""

from __future__ import annotations

import argparse
import json

from rich.table import Table

from impact_rs_analysis.diagnosis.document import read_document
from impact_rs_analysis.sharing.evidence_package import check_package, make_package, read_package, write_package
from impact_rs_analysis.sharing.merged_evidence import MergedEvidence, merge_packages
from impact_rs_cli.parser import command_line
from impact_rs_cli.terminal import Terminal, output_folder
from impact_rs_sim.errors import InputError
from impact_rs_sim.files import write_whole
from impact_rs_sim.model import load_model
from impact_rs_sim.numbers import estimate_in_line

MAX_SHOWN_LEFT_OUT = 8  # all are in the JSON document


def pack(args: argparse.Namespace, terminal: Terminal) -> int:
    """Pack a diagnosis with its model and the digests of its measurements."""
    diagnosis, model = read_document(args.diagnosis), load_model(args.model)
    with output_folder(args.output.parent), terminal.progress("digests") as report_progress:
        package = make_package(
            diagnosis, model, args.data, args.laboratory, args.robot, args.object, args.note, report_progress
        )
        write_package(package, args.output)
    terminal.result({"file": str(args.output), "seal": package.seal, "files": len(package.data)})
    terminal.say(
        f"{args.output}: {package.name}; {diagnosis.verdict}; {len(package.data)} files of measurements, "
        f"seal {package.seal[:16]}",
        "next, in another laboratory: "
        + command_line("evidence check", {"package": args.output.name, "data": "FOLDER"}),
    )
    return 0


def check(args: argparse.Namespace, terminal: Terminal) -> int:
    """Check a package; exit code 1 if a check fails."""
    package = read_package(args.package)
    with terminal.progress("digests") as report_progress:
        checks = check_package(package, args.data, report_progress)
    terminal.say(f"{package.name}: {package.diagnosis.verdict}", package.diagnosis.summary)
    for result in checks:
        terminal.say(f"  {'passed' if result.passed else 'FAILED'}  {result.what}: {result.found}")
    if args.data is None:
        terminal.say(f"  the {len(package.data)} files of measurements were not checked; --data does")
    versions = ", ".join(f"{name} {value}" for name, value in package.versions.items() if value)
    terminal.say(f"  packed with {versions}")
    passed = all(result.passed for result in checks)
    terminal.result({"package": package.name, "passed": passed, "checks": [vars(result) for result in checks]})
    return 0 if passed else 1


def merge(args: argparse.Namespace, terminal: Terminal) -> int:
    """Merge packages."""
    merged = merge_packages([read_package(path) for path in args.packages])
    document = merged.model_dump(mode="json")
    if args.output is not None:
        if args.output.is_dir():
            raise InputError("this is a folder; name a file, for example merged.json", file=args.output)
        with output_folder(args.output.parent):
            write_whole(args.output, json.dumps(document, indent=2, allow_nan=False) + "\n")
    _show(merged, terminal)
    terminal.result(document)
    if args.output is not None:
        terminal.say(f"merged: {args.output}")
    return 0


def _show(merged: MergedEvidence, terminal: Terminal) -> None:
    table = Table(title=f"{len(merged.packages)} packages of evidence")
    for heading in ("parameter", "together, 95 % interval", "packages", "I^2", "belongs to"):
        table.add_column(heading, overflow="fold")
    for parameter in merged.parameters:
        pooled = f"{estimate_in_line(parameter.pooled.estimate, parameter.pooled.ci95)} {parameter.unit}"
        groups = "".join(
            f"\n{label}: {estimate_in_line(group_estimate.estimate, group_estimate.ci95)}"
            for label, group_estimate in parameter.groups.items()
        )
        owners = " or ".join(parameter.belongs_to)
        count = f"{parameter.pooled.packages} of {len(parameter.contributions)}"
        table.add_row(
            f"{parameter.effect}.{parameter.parameter}",
            pooled,
            count,
            f"{parameter.inconsistency:.0%}",
            owners + groups,
        )
    terminal.say(table)
    for laboratory, where in merged.odd.items():
        terminal.say(f"ODD: {laboratory} does not agree with the others in {', '.join(where)}; left out there")
    for text in merged.in_common:
        terminal.warn(f"in common: {text}; where these are measurements, their estimates depend on each other")
    for text in merged.left_out[:MAX_SHOWN_LEFT_OUT]:
        terminal.say(f"left out: {text}")
    if len(merged.left_out) > MAX_SHOWN_LEFT_OUT:
        terminal.say(f"left out: {len(merged.left_out) - MAX_SHOWN_LEFT_OUT} more; --json lists all")
