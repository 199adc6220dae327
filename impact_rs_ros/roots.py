# SPDX-License-Identifier: Apache-2.0
"""What a request from the network may name: files below the folders that the node's owner has chosen."""

from __future__ import annotations

import re
from pathlib import Path

from impact_rs_sim.errors import InputError

NAME = re.compile(r"[A-Za-z0-9_-]+")


def below(path: str, root: str, key: str, parameter: str) -> Path:
    """A path that a request names, absolute; a relative one is seen from the root.

    Args:
        path: What was asked for; empty: the root.
        root: Folder that it must lie in; empty: the working directory.
        key: What the request calls it.
        parameter: The node's parameter that holds the root.

    Raises:
        InputError: It lies elsewhere, links followed.
    """
    folder = Path(root or ".").resolve()
    try:
        found = (folder / path).resolve()
    except (OSError, ValueError, RuntimeError) as error:  # a byte that no name has, a link to itself, too long
        raise InputError(f"{error}; expected a path", key=key, value=path[:200]) from None
    if not found.is_relative_to(folder):
        raise InputError(f"expected a path below {folder} (parameter {parameter})", key=key, value=path[:200])
    return found


def scenario_below(name: str, own: str, root: str) -> str:
    """A scenario that a request names: a shipped one, the node's own, or a file below a root.

    Args:
        name: What was asked for; empty: the node's own.
        own: Name or path of the node's own.
        root: As for :func:`below`.

    Raises:
        InputError: It is none of these.
    """
    if not name or name == own or NAME.fullmatch(name):
        return name or own
    if own.endswith((".yaml", ".yml")) and Path(name).resolve() == Path(own).resolve():
        return own
    return str(below(name, root, "scenario", "config_root"))
