# SPDX-License-Identifier: Apache-2.0
"""Access of network requests to files: only below the folders that parameters of the node name."""

from __future__ import annotations

import re
from pathlib import Path

from impact_rs_sim.errors import InputError

NAME = re.compile(r"[A-Za-z0-9_-]+")


def below(path: str, root: str, key: str, parameter: str) -> Path:
    """Absolute path of a request; a relative one is relative to the root.

    Args:
        path: Path of the request; empty: the root.
        root: Folder that must contain it; empty: the working directory.
        key: Name of the field in the request.
        parameter: Name of the node parameter that holds the root.

    Raises:
        InputError: The path, with links resolved, is outside of the root.
    """
    folder = Path(root or ".").resolve()
    try:
        absolute_path = (folder / path).resolve()
    except (OSError, ValueError, RuntimeError) as error:  # a byte that no name has, a link to itself, too long
        raise InputError(f"{error}; expected a path", key=key, value=path[:200]) from None
    if not absolute_path.is_relative_to(folder):
        raise InputError(f"expected a path below {folder} (parameter {parameter})", key=key, value=path[:200])
    return absolute_path


def scenario_below(name: str, node_scenario: str, root: str) -> str:
    """Name or path of the scenario of a request: a shipped one, the node's own, or a file below a root.

    Args:
        name: Scenario of the request; empty: the node's own.
        node_scenario: Name or path of the node's own scenario.
        root: As for :func:`below`.

    Raises:
        InputError: Neither the own scenario, a shipped name, nor a path below the root.
    """
    if not name or name == node_scenario or NAME.fullmatch(name):
        return name or node_scenario
    if node_scenario.endswith((".yaml", ".yml")) and Path(name).resolve() == Path(node_scenario).resolve():
        return node_scenario
    return str(below(name, root, "scenario", "config_root"))
