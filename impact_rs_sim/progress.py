# SPDX-License-Identifier: Apache-2.0
"""Progress for other programs: with ``IMPACT_RS_PROGRESS=FILE`` a command writes its progress to that file.

The file holds one JSON document, replaced as a whole: the stage (``what``), the steps ``done`` of ``total``, start and
last update of the stage (``since``, ``at``, seconds of the wall clock), and the steps done by an earlier run of the
command (``first``). ``stages`` holds the duration of all stages so far, by name [s]; ``empty`` names the stages without
expected steps. While explanations are compared, ``ranking`` lists them with their remaining errors, smallest first.
"""

from __future__ import annotations

import json
import os
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

from impact_rs_sim.errors import InputError
from impact_rs_sim.files import write_whole

VARIABLE = "IMPACT_RS_PROGRESS"
MIN_WRITE_PERIOD_S = 0.1  # between two writes of one stage
SEARCH, HOLD_OUT, ENDS = "fit of the shortlist", "hold-out", "ends of intervals"  # stages of a diagnosis


class ProgressFile:
    """The progress file; without the environment variable nothing is written.

    Attributes:
        document: Its content; empty before the first stage.
    """

    def __init__(self) -> None:
        name = os.environ.get(VARIABLE)
        self._path = None if not name else Path(name)
        self.document: dict[str, Any] = {}
        self._stage: str | None = None
        self._since = self._at = 0.0
        self._first = 0
        self._stages: dict[str, float] = {}
        self._empty: set[str] = set()
        self._ranking: dict[str, float] = {}

    def rank(self, name: str, error: float) -> None:
        """Set the error of an explanation; it is written with the next stage or step."""
        self._ranking[name] = error

    def update(self, stage: str, done: int, total: int | None) -> None:
        """Set the progress of a stage.

        Args:
            stage: The stage.
            done: Steps done.
            total: Steps of the stage; None: unknown; 0: the stage has no steps.
        """
        if total == 0:
            self._empty.add(stage)
            return
        self._empty.discard(stage)
        now = time.time()
        if stage != self._stage:
            if self._stage is not None:
                self._stages[self._stage] = self._seconds(now)
            self._stage, self._since, self._first = stage, now, done
        elif done != total and now - self._at < MIN_WRITE_PERIOD_S:
            return
        self._at = now
        self.document = {
            "what": stage, "done": done, "total": total, "first": self._first, "since": self._since, "at": now,
            "stages": self._stages | {stage: self._seconds(now)}, "empty": sorted(self._empty),
            "ranking": sorted(self._ranking.items(), key=lambda entry: entry[1]),
        }  # fmt: skip
        if self._path is not None:
            with suppress(InputError):  # a full disk must not stop a command because of its progress
                write_whole(self._path, json.dumps(self.document))

    def _seconds(self, now: float) -> float:
        """Duration of the stage, earlier visits included [s]."""
        return self._stages.get(self._stage or "", 0.0) + now - self._since
