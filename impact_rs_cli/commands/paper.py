# SPDX-License-Identifier: Apache-2.0
"""``impact-rs paper``: the published experiment as a measurement."""

from __future__ import annotations

import argparse

from rich.table import Table

from impact_rs_analysis.measure.paper import study_paper
from impact_rs_analysis.report.paper_figures import write_paper
from impact_rs_cli.terminal import Terminal, output_folder
from impact_rs_sim.numbers import estimate_text


def run(args: argparse.Namespace, terminal: Terminal) -> int:
    """Run the command."""
    study = study_paper()
    terminal.result(study.to_json())
    table = Table(title="Motor-inertia scale that suits the published rows best")
    for heading in ("rows", "scale", "95 % interval", "mismatch at 1 [%]", "fitted [%]", "rows not seen [%]"):
        table.add_column(heading, justify="left" if heading == "rows" else "right")
    fits = {"all": study.all_rows, **study.by_scenario, "all, hyperbolas": study.hyperbola_fit}
    for name, fit in fits.items():
        scale, *interval = estimate_text(fit.scale, fit.interval, least=2)
        table.add_row(
            name, scale, " ... ".join(interval), f"{fit.error_nominal:.2f}",
            f"{fit.error_fitted:.2f}", f"{fit.error_held_out:.2f}",
        )  # fmt: skip
    terminal.say(table)
    terminal.say(f"no motor inertia between 0 and B_rho explains: {', '.join(study.unexplained)}")
    terminal.say(f"{study.verdict}: {study.sentence}")
    if args.output is not None:
        with output_folder(args.output):
            written = write_paper(study, args.output)
        terminal.say(f"report: {written[0].resolve()}")
    return 0
