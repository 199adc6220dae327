# SPDX-License-Identifier: Apache-2.0
"""Progress for programs: with ``IMPACT_RS_PROGRESS=FILE`` a command keeps in that file how far it is.

The file holds one JSON document, replaced as a whole: ``what`` is under way, how much of it is ``done`` of which
``total``, and when this stage began and was last heard of (``since``, ``at``, seconds of the wall clock); what an
earlier run of the command had done is ``first``. Where explanations are weighed, ``ranking`` holds them with the error
that they leave, the smallest first.
"""

from __future__ import annotations

import json
import os
import time
from contextlib import suppress
from pathlib import Path

from impact_rs_sim.errors import InputError
from impact_rs_sim.files import write_whole

VARIABLE = "IMPACT_RS_PROGRESS"
PERIOD = 0.1  # s, between two writes of one stage


class ProgressFile:
    """The file that the environment names; nothing is written where it names none."""

    def __init__(self) -> None:
        name = os.environ.get(VARIABLE)
        self._path = None if not name else Path(name)
        self._what: str | None = None
        self._since = self._at = 0.0
        self._first = 0
        self._ranking: dict[str, float] = {}

    def rank(self, name: str, error: float) -> None:
        """Keep what is thought of an explanation so far; it is written with the next stage or step."""
        self._ranking[name] = error

    def tell(self, what: str, done: int, total: int | None) -> None:
        """Keep how far a stage is.

        Args:
            what: The stage.
            done: Of it.
            total: Of the whole stage; None: not known.
        """
        if self._path is None:
            return
        now = time.time()
        if what != self._what:
            self._what, self._since, self._first = what, now, done
        elif done != total and now - self._at < PERIOD:
            return
        self._at = now
        ranking = sorted(self._ranking.items(), key=lambda entry: entry[1])
        document = {"what": what, "done": done, "total": total, "first": self._first, "since": self._since, "at": now}
        document["ranking"] = ranking
        with suppress(InputError):  # a full disk stops no command that only wants to say how far it is
            write_whole(self._path, json.dumps(document))
