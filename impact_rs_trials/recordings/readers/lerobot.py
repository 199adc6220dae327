# SPDX-License-Identifier: Apache-2.0
"""Data sets of LeRobot (versions 2 and 3): ``meta/info.json`` beside the Parquet files of ``data/``.

It names the numbers of every vector, in the order of the joints, and the frame rate; the timestamp of a frame is its
number over that rate.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

INFO = Path("meta/info.json")
MEASURED, DESIRED = "observation.state", "action"  # positions of the joints, and those that were commanded


@dataclass(frozen=True)
class DataSet:
    """What ``meta/info.json`` says of a data set.

    Attributes:
        root: Its folder.
        fps: Frames per second; None: not a number.
        names: Names of the numbers of each vector, by column.
    """

    root: Path
    fps: float | None
    names: Mapping[str, tuple[str, ...]]


def data_set_of(path: Path) -> DataSet | None:
    """The data set that a file or folder belongs to; None: it belongs to none, or its description cannot be read."""
    for root in (path, *path.parents[:4]):  # data/chunk-000/episode_000000.parquet
        file = root / INFO
        if file.is_file():
            return _described(root, file)
    return None


def _described(root: Path, file: Path) -> DataSet | None:
    try:
        info = json.loads(file.read_text(encoding="utf-8"))
        features: dict[str, Any] = info["features"]
        names = {name: tuple(_flat(one.get("names"))) for name, one in features.items()}
    except (OSError, ValueError, TypeError, KeyError, AttributeError):
        return None
    fps = info.get("fps")
    return DataSet(root, float(fps) if isinstance(fps, int | float) and fps > 0 else None, names)


def _flat(names: Any) -> list[str]:
    """Names of a vector: a list of texts, one in another list, or in a dictionary (``{"motors": [...]}``)."""
    if isinstance(names, dict):
        names = list(names.values())
    if not isinstance(names, list):
        return []
    inner = [one for part in names for one in (part if isinstance(part, list) else [part])]
    return inner if all(isinstance(one, str) for one in inner) else []
