# SPDX-License-Identifier: Apache-2.0
"""Files that pages in the browser are made of: those in ``static/``, and libraries and colours of the reports."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from starlette.responses import FileResponse, PlainTextResponse, Response

from impact_rs_analysis.report.page import BUNDLE, PALETTE

STATIC = Path(__file__).with_name("static")
SCRIPTS: Mapping[str, Path] = {path.relative_to(STATIC).as_posix(): path for path in sorted(STATIC.rglob("*.js"))}
SHARED: Mapping[str, Path] = {**SCRIPTS, "palette.css": PALETTE}  # by the pages of workbench and show
KINDS = {".css": "text/css", ".js": "text/javascript"}
KEPT = {"cache-control": "max-age=86400"}  # libraries of others, which do not change


def static_file(files: Mapping[str, Path], name: str) -> Response:
    """A file of a page.

    Args:
        files: Files of the page by the names that it asks for.
        name: Name asked for.
    """
    path = files.get(name)
    if path is None:
        return PlainTextResponse("There is no such file.", 404)
    return FileResponse(path, media_type=KINDS[path.suffix], headers=KEPT if path.parent == BUNDLE else {})
