# SPDX-License-Identifier: Apache-2.0
"""Tables of the terminal in a narrow window."""

from __future__ import annotations

import io

from rich.console import Console
from rich.table import Table

from impact_rs_cli.terminal import add_word_column


def test_a_verdict_in_a_narrow_window_is_broken_between_words_only() -> None:
    """Kills a column as narrow as the word of another verdict: "CONFUSABLE-WITH {contact_stiffn" and "ess}"."""
    cell, output = "CONFUSABLE-WITH {contact_stiffness_of_the_support, object_mass}", io.StringIO()
    table = Table()
    table.add_column("effect", no_wrap=True)
    add_word_column(table, "verdict", ["CONFIRMED", cell])
    table.add_column("error", no_wrap=True)
    table.add_row("surface_friction", cell, "115 → 1.05")
    Console(file=output, width=72).print(table)
    printed = output.getvalue()
    assert all(word in printed for word in (*cell.split(), "surface_friction", "115 → 1.05"))
