# SPDX-License-Identifier: Apache-2.0
"""Pages of the manual for the browser; where only the package is installed, the manual is not there."""

from __future__ import annotations

import functools
import re
from pathlib import Path

from markdown_it import MarkdownIt
from markdown_it.token import Token

from impact_rs_sim.errors import InputError, did_you_mean, shortened

FOLDER = Path(__file__).resolve().parent.parent / "docs"


def pages() -> list[str]:
    """Names of all pages; empty: there is no manual here."""
    return sorted(path.name for path in FOLDER.glob("*.md"))


@functools.cache
def page(name: str) -> str:
    """A page as HTML, its headings with the names that links to them use.

    Raises:
        InputError: There is no such page.
    """
    if name not in pages():
        raise InputError(f"the manual has no page {shortened(name)!r}{did_you_mean(name, pages())}")
    reader = MarkdownIt("commonmark", {"html": False}).enable("table")
    tokens = reader.parse((FOLDER / name).read_text(encoding="utf-8"))
    for token, inner in zip(tokens, tokens[1:], strict=False):
        if token.type == "heading_open":
            token.attrSet("id", _anchor(inner))
    return str(reader.renderer.render(tokens, reader.options, {}))


def picture(name: str) -> Path:
    """A picture of the manual.

    Raises:
        InputError: There is no such picture.
    """
    pictures = {path.name: path for path in (FOLDER / "images").glob("*.png")}
    if name not in pictures:
        raise InputError(f"the manual has no picture {shortened(name)!r}")
    return pictures[name]


def _anchor(heading: Token) -> str:
    return re.sub(r"[^\w -]", "", heading.content.lower()).replace(" ", "-")
