# SPDX-License-Identifier: Apache-2.0
"""``impact-rs import``: a description of raw files."""

from __future__ import annotations

import argparse
from dataclasses import asdict

from rich.table import Table

from impact_rs_analysis.application.described_folder import described_folder
from impact_rs_cli.parser import command_line
from impact_rs_cli.terminal import Terminal
from impact_rs_sim.errors import InputError
from impact_rs_trials.file_names import EXPERIMENT_FILE, MAPPING_FILE
from impact_rs_trials.recordings.importing.import_recordings import ImportDraft, ImportOptions, draft_import


def run(args: argparse.Namespace, terminal: Terminal) -> int:
    """Guess, show the evidence, and write."""
    if args.rate is not None and not args.rate > 0.0:
        raise InputError("expected a sampling rate > 0 Hz", key="--rate", value=args.rate)
    options = ImportOptions(args.robot, args.scenario, args.rate, args.dedupe)
    draft = draft_import(args.files, args.output, options)
    with described_folder(args.output, draft.texts):
        pass  # nothing to try: the draft was made from what is there
    terminal.result(
        {
            "folder": str(args.output), "files": list(draft.texts), "runs": draft.runs, "hits": draft.hits,
            "guesses": [asdict(line) for line in draft.lines], "remarks": list(draft.remarks),
        }
    )  # fmt: skip
    _show(draft, terminal)
    for remark in draft.remarks:
        terminal.say(f"note: {remark}")
    terminal.say(f"{args.output}: {', '.join(draft.texts)}; {draft.runs} runs, {draft.hits} of them hits")
    if EXPERIMENT_FILE in draft.texts:
        described = {"experiment": args.output / EXPERIMENT_FILE, "output": "impacts.csv"}
        further = command_line("impacts", {"directory": draft.folder, **described})
    else:
        folders = {file.parent for file in args.files}
        target = args.files[0] if len(args.files) == 1 else folders.pop() if len(folders) == 1 else draft.folder
        further = command_line("compare", {"runs": target, "mapping": args.output / MAPPING_FILE})
    terminal.say(f"next: check the lines marked ASSUMED, then {further}")
    return 0


def _show(draft: ImportDraft, terminal: Terminal) -> None:
    table = Table(title="Contents of the files")
    for heading in ("key", "value", "evidence"):
        table.add_column(heading)
    for line in draft.lines:
        evidence = line.evidence if line.sure else f"ASSUMED: {line.evidence}"
        table.add_row(line.key, line.value, evidence)
    terminal.say(table)
