# SPDX-License-Identifier: Apache-2.0
"""Observer of a long step: shows its progress and warnings."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Protocol

from impact_rs_analysis.evidence.replays.replay_cache import Progress

MAX_SHOWN_FILES = 5  # in warnings about bags or runs

Report = Callable[[int, int], None]  # number of items done, number of all items


class Observer(Protocol):
    """Shows progress and warnings; the terminal of the command line is one."""

    def progress(self, what: str) -> AbstractContextManager[Report]:
        """Progress of work of one kind."""
        ...

    def stages(self) -> AbstractContextManager[Progress]:
        """Progress of work in several stages; every report names its stage."""
        ...

    def rank(self, name: str, error: float) -> None:
        """Error of one candidate explanation, while a search runs."""
        ...

    def warn(self, text: str) -> None:
        """A warning of one line."""
        ...


class Silent:
    """An observer that shows nothing."""

    @contextmanager
    def progress(self, what: str) -> Iterator[Report]:
        """See :meth:`Observer.progress`."""
        del what
        yield lambda *_: None

    @contextmanager
    def stages(self) -> Iterator[Progress]:
        """See :meth:`Observer.stages`."""
        yield lambda *_: None

    def rank(self, name: str, error: float) -> None:
        """See :meth:`Observer.rank`."""

    def warn(self, text: str) -> None:
        """See :meth:`Observer.warn`."""


SILENT = Silent()


def warn_skipped(skipped: Sequence[tuple[str, str]], observer: Observer) -> None:
    """Warn of bags that were left out, by path and reason."""
    for path, reason in skipped[:MAX_SHOWN_FILES]:
        observer.warn(f"left out {Path(path).name}: {reason.removeprefix(f'{path}: ')}")
    if len(skipped) > MAX_SHOWN_FILES:
        observer.warn(f"left out {len(skipped) - MAX_SHOWN_FILES} more bags; --json lists all")
