# SPDX-License-Identifier: Apache-2.0
"""Streams of a recording: raw numbers over time, with their source and the prior by their names."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

from impact_rs_trials.recordings.importing.candidates import COMMANDED, SignalCandidate, guess_of, in_order
from impact_rs_trials.recordings.importing.hypotheses import FORMAT_LOG_ODDS, NAME_LOG_ODDS, Role
from impact_rs_trials.recordings.readers.series import Series

# Properties suggested by a name, in addition to the signal (candidates.guess_of) and to COMMANDED.
MEASURED = re.compile(r"meas|actual|(^|_)act(_|\d|$)", re.IGNORECASE)
OF_MOTOR = re.compile(r"motor|rotor|(^|_)theta", re.IGNORECASE)
EXTERNAL = re.compile(r"(^|[^a-z])ext([^a-z]|$)|external|(^|[^a-z])hat([^a-z]|$)|disturb", re.IGNORECASE)
CURRENT = re.compile(r"curr|amp|(^|[^a-z])i([^a-z]|$)", re.IGNORECASE)


@dataclass(frozen=True)
class JointStream:
    """Raw samples with as many numbers as a robot has joints.

    Attributes:
        file: Pattern of its file; empty: a run is one file.
        candidate: Its source.
        series: Its raw numbers at its timestamps.
    """

    file: str
    candidate: SignalCandidate
    series: Series

    @property
    def label(self) -> str:
        """Its name, with the file if a run has several."""
        return f"{self.file}: {self.candidate.label}" if self.file else self.candidate.label

    @property
    def column_text(self) -> str:
        """Names of its columns, or else its label."""
        return " ".join(self.candidate.source.get("columns") or [self.candidate.label])

    @property
    def is_cut(self) -> bool:
        """Whether it is a part of a wider signal."""
        return self.candidate.first is not None

    def overlaps(self, other: JointStream) -> bool:
        """Whether both have a column in common."""
        return self.file == other.file and bool(self._numbers & other._numbers)

    def stands_apart(self, other: JointStream) -> bool:
        """Whether both cannot belong to the same joints: they share a column, or are parts at different offsets."""
        if self.is_cut and other.is_cut and self.candidate.first != other.candidate.first:
            return True
        return self.overlaps(other)

    def log_prior(self, role: Role) -> float:
        """Log odds of a role by the file format, the names of the columns, or else the name of the file."""
        guess = self.candidate.guess or guess_of(self.file)
        text = f"{self.file} {self.column_text}"
        hinted = {"torque": "current" if CURRENT.search(text) else "torque"}.get(guess, guess)
        contradicts = bool(hinted) and (hinted, role) != ("torque", "current")
        size = FORMAT_LOG_ODDS if self.candidate.defined else NAME_LOG_ODDS
        odds = size if hinted == role else -size if contradicts else 0.0
        return odds - NAME_LOG_ODDS * bool(COMMANDED.search(text)) + NAME_LOG_ODDS * bool(MEASURED.search(text))

    @property
    def is_of_motors(self) -> bool:
        """Whether its name suggests a measurement at the motors."""
        return bool(OF_MOTOR.search(self.column_text)) and not COMMANDED.search(self.column_text)

    @property
    def is_external(self) -> bool:
        """Whether its name suggests an external torque."""
        return bool(EXTERNAL.search(self.column_text))

    def in_order(self, order: tuple[int, ...]) -> JointStream:
        """The stream with reordered joints."""
        values = self.series.values[:, list(order)]
        return replace(self, candidate=in_order(self.candidate, order), series=replace(self.series, values=values))

    @property
    def _numbers(self) -> set[tuple[str, int]]:
        """Columns, and entries of vectors, of its numbers."""
        source, count = self.candidate.source, range(1, self.candidate.width + 1)
        if "columns" in source:
            return {(column, 0) for column in source["columns"]}
        whole = str(source.get("column") or source.get("array") or (source.get("topic"), source.get("field")))
        if "{joint}" in whole:
            return {(whole.replace("{joint}", str(number)), 0) for number in count}
        return {(whole, entry) for entry in source.get("entries") or count}
