# SPDX-License-Identifier: Apache-2.0
"""Files that an import writes: a mapping with the evidence for its values, the table of runs, an experiment."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Mapping as AbstractMapping
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import yaml

from impact_rs_trials.recordings.importing.file_groups import run_name
from impact_rs_trials.recordings.readers.series import Names

HEAD = """\
# Where the signals of these recordings are, as impact-rs import found it. Every value is followed by its evidence.
# ASSUMED: without evidence, or nearly as likely as the next reading, which is named: check it before you trust a
# verdict. All keys: docs/files.md
"""
ARM = """\
# Runs with impacts; impact-rs compare, diagnose and impacts read this file. All keys: docs/files.md
scenario: {scenario}
mapping: mapping.yaml
runs: runs.csv
# motion_capture: {{estimate: true}}   # if the tracker's world is not the scenario's
"""
BODY = """\
# An object without a robot hits a fixed plane; impact-rs impacts reads this file. Fill in mass and size [kg, m].
mapping: mapping.yaml
runs: runs.csv
body:
  # mass: 0.37
  # size: [0.1, 0.1, 0.1]     # of a box, or of shape: cylinder; or mesh: part.stl
  # radius: 0.02              # of a ball; shell: true if it is hollow
  # spin: [0, 0, 0]           # of a ball whose rotation was not tracked, before it first hits [rad/s]
  # place: {position: [0, 0, 0], rpy: [0, 0, 0]}   # its centre and axes in the tracked frame
plane: {height: 0.0, normal: [0, 0, 1]}   # ASSUMED: where the plane is in the tracker's world
"""


@dataclass(frozen=True)
class Line:
    """A guessed key.

    Attributes:
        key: Dotted path of the key.
        value: Its value in the file.
    """

    key: str
    value: str
    evidence: str
    sure: bool = True


@dataclass
class Notes:
    """Findings of an import about the files.

    Attributes:
        lines: Keys with their evidence.
    """

    lines: list[Line] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)

    def add(self, key: str, value: str, evidence: str, sure: bool = True) -> None:
        """Add a key with its evidence."""
        self.lines.append(Line(key, value, evidence, sure))


@dataclass(frozen=True)
class PossibleReading:
    """A possible reading of a signal.

    Attributes:
        stream: Name of the stream.
        source: Its keys in a mapping, without unit.
        unit: Unit of its numbers, or the units of all joints.
        behind: Log posterior odds of the chosen reading against it; below log(100) it is nearly as likely.
    """

    stream: str
    source: dict[str, Any]
    unit: Any
    behind: float
    evidence: str


@dataclass(frozen=True)
class FoundRun:
    """A run of the table of runs.

    Attributes:
        run: Its name relative to the folder of the recordings.
        object: Name of its object; empty: unknown.
        session: Its session; empty: none.
        hit: Whether something is hit.
    """

    run: str
    object: str = ""
    session: str = ""
    hit: bool = False

    @property
    def names(self) -> Names:
        """Values of the placeholders of the mapping."""
        return Names(object=self.object or "*", run=run_name(self.run))


def flow(value: Any) -> str:
    """A value in one line of YAML."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key}: {flow(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(flow(item) for item in value) + "]"
    if isinstance(value, str):
        return value if _plain(value) else yaml.safe_dump(value, default_style='"', width=float("inf")).strip()
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        text = f"{value:.6g}"  # YAML 1.1 reads a power of ten without a decimal point as text
        return text.replace("e", ".0e", 1) if "e" in text and "." not in text else text
    return str(value)


def _plain(text: str) -> bool:
    """Whether YAML reads a text without quotation marks as text, not as a boolean, a number or null."""
    if not re.fullmatch(r"[A-Za-z_][\w/. ]*", text) or text.lower() in ("y", "n"):  # booleans of YAML 1.1
        return False
    return bool(yaml.safe_load(text) == text)


def mapping_text(content: AbstractMapping[str, Any], lines: Sequence[Line]) -> str:
    """A mapping file with the evidence for its values.

    Args:
        content: Values by key.
        lines: Evidence by key.
    """
    comments: dict[str, str] = {}
    for line in lines:
        comments[line.key] = line.evidence if line.sure else f"ASSUMED: {line.evidence}"
    text = [HEAD.rstrip()]
    for key, value in content.items():
        if key == "signals":
            text.append("signals:")
            for name, section in value.items():
                text.append(f"  {name}:{_remark(comments.get(f'signals.{name}'))}")
                for inner_key, inner_value in section.items():
                    comment = _remark(comments.get(f"signals.{name}.{inner_key}"))
                    text.append(f"    {inner_key}: {flow(inner_value)}{comment}")
        else:
            text.append(f"{key}: {flow(value)}{_remark(comments.get(key) or comments.get(f'{key}.rate'))}")
    return "\n".join(text) + "\n"


def _remark(comments: str | None) -> str:
    return "" if comments is None else f"   # {' '.join(comments.split())}"


def runs_text(rows: Sequence[FoundRun], without_robot: bool) -> str:
    """The table of runs.

    Args:
        rows: Its runs, at least one.
        without_robot: Whether the runs have an object and no robot.
    """
    sessions = any(row.session for row in rows)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["bag", "object", "kind", *(["session"] if sessions else [])])
    for row in rows:
        name = "body" if without_robot else row.object if row.hit else "none"
        writer.writerow([row.run, name, "hit" if row.hit else "free motion", *([row.session] if sessions else [])])
    return text.getvalue()
