# SPDX-License-Identifier: Apache-2.0
"""What tests of recordings make again and again: a mapping, the positions that it reads, and what an import wrote."""

from __future__ import annotations

from pathlib import Path

from impact_rs_trials.recordings.importing.import_recordings import ImportDraft
from impact_rs_trials.recordings.mapping import Mapping, load_mapping
from impact_rs_trials.recordings.readers.series import Series
from impact_rs_trials.recordings.readers.sources import read_series


def mapping_of(
    time: dict | None = None, table: dict | None = None, further: dict | None = None, **position: object
) -> Mapping:
    """The mapping ``joint_state`` with another way to the joint positions, and ``further`` keys."""
    shipped = load_mapping("joint_state")
    source = {"unit": "rad", **position}
    signals = {name: source if name == "position" else one.model_dump() for name, one in shipped.signals.items()}
    signals |= {name: {**signals[name], "file": position["file"]} for name in signals if "file" in position}
    content = {"time": time or {}, "table": table or {}, "signals": signals, **(further or {})}
    return Mapping.model_validate(shipped.model_dump() | content)


def read_positions(path: Path, mapping: Mapping | None = None) -> Series:
    return read_series(path, mapping or load_mapping("joint_state"), ["position"], ["position"])["position"]


def described(draft: ImportDraft, folder: Path) -> Path:
    """The mapping file among those that an import proposes, all written to a folder."""
    folder.mkdir(exist_ok=True)
    for name, text in draft.texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    return folder / "mapping.yaml"


def mapping_in(draft: ImportDraft, folder: Path) -> Mapping:
    return load_mapping(described(draft, folder))
