# SPDX-License-Identifier: Apache-2.0
"""Who watches a step that takes long."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Protocol

from impact_rs_analysis.evidence.replay_cache import Progress

Report = Callable[[int, int], None]  # items done, and all items


class Observer(Protocol):
    """Shows progress; the terminal of the command line is one."""

    def progress(self, what: str) -> AbstractContextManager[Report]:
        """Progress of work of one kind."""
        ...

    def stages(self) -> AbstractContextManager[Progress]:
        """Progress of work in several stages, which each report names."""
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


SILENT = Silent()
