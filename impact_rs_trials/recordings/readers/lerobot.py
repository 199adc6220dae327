# SPDX-License-Identifier: Apache-2.0
"""Data sets of LeRobot (versions 2 and 3): Parquet files in ``data/``, described by ``meta/info.json``.

The description has the names of the numbers of every vector, in the order of the joints, and the frame rate f. Frame k
has the timestamp k / f.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

INFO = Path("meta/info.json")
MEASURED, DESIRED = "observation.state", "action"  # measured and commanded joint positions


@dataclass(frozen=True)
class DataSet:
    """Description of a data set by ``meta/info.json``.

    Attributes:
        root: Folder of the data set.
        fps: Frames per second; None: not a number.
        names: Names of the numbers of each vector, by column.
    """

    root: Path
    fps: float | None
    names: Mapping[str, tuple[str, ...]]


def data_set_of(path: Path) -> DataSet | None:
    """Data set to which a file or folder belongs; None: no data set, or a description that cannot be read."""
    for root in (path, *path.parents[:4]):  # data/chunk-000/episode_000000.parquet
        file = root / INFO
        if file.is_file():
            return _described(root, file)
    return None


def _described(root: Path, file: Path) -> DataSet | None:
    try:
        info = json.loads(file.read_text(encoding="utf-8"))
        features: dict[str, Any] = info["features"]
        names = {name: tuple(_flat(feature.get("names"))) for name, feature in features.items()}
    except (OSError, ValueError, TypeError, KeyError, AttributeError):
        return None
    fps = info.get("fps")
    return DataSet(root, float(fps) if isinstance(fps, int | float) and fps > 0 else None, names)


def _flat(names: Any) -> list[str]:
    """Names of the numbers of a vector: from a list of texts, a list of lists, or a dictionary of lists."""
    if isinstance(names, dict):
        names = list(names.values())
    if not isinstance(names, list):
        return []
    inner = [name for part in names for name in (part if isinstance(part, list) else [part])]
    return inner if all(isinstance(name, str) for name in inner) else []
