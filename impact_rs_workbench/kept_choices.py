# SPDX-License-Identifier: Apache-2.0
"""Choices and pins of the overlay, kept in the folder of the workbench: ``.workbench/overlay.json``.

The address of a page, and with it the memory of the browser, changes with every start.
"""

from __future__ import annotations

import threading
from typing import Annotated, Literal

from pydantic import Field

from impact_rs_sim.errors import InputError
from impact_rs_sim.files import write_whole
from impact_rs_sim.schema import Schema, validate
from impact_rs_workbench.workspace import HIDDEN, Workspace, read_json

FILE = "overlay.json"
_WRITING = threading.Lock()  # one list after the other, in the order of the posts
Keys = Annotated[tuple[Annotated[str, Field(max_length=1000)], ...], Field(max_length=1000)]


class Chosen(Schema):
    """Entries of one list of the overlay."""

    chosen: Keys = Field((), description="entries that are drawn")
    pinned: Keys = Field((), description="entries that stay on top and drawn")


class Choices(Schema):
    """``overlay.json``; a list that was not changed is absent."""

    runs: Chosen | None = Field(None, description="recorded trials")
    models: Chosen | None = Field(None, description="comparisons")


class ListChoice(Chosen):
    """One list, as the page sends it."""

    name: Literal["runs", "models"] = Field(description="which list")


def choices(workspace: Workspace) -> Choices:
    """The choices; empty where the file is missing or damaged, for it holds no result."""
    path = workspace.root / HIDDEN / FILE
    try:
        return validate(Choices, read_json(path) or {}, path)
    except InputError:
        return Choices()


def keep(workspace: Workspace, choice: ListChoice) -> Choices:
    """Keep what was chosen in one list."""
    chosen = Chosen(chosen=choice.chosen, pinned=choice.pinned)
    with _WRITING:
        updated = choices(workspace).model_copy(update={choice.name: chosen})
        (workspace.root / HIDDEN).mkdir(exist_ok=True)
        write_whole(workspace.root / HIDDEN / FILE, updated.model_dump_json(indent=2) + "\n")
    return updated
