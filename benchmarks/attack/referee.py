# SPDX-License-Identifier: Apache-2.0
"""What the campaigns have in common: a time limit for each mutant, and the count of what became of them."""

from __future__ import annotations

import argparse
import json
import resource
import signal
import sys
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager


class Hang(BaseException):
    """A mutant took longer than it may; no ``except Exception`` on the way holds it."""


@contextmanager
def limited(seconds: float) -> Iterator[None]:
    """Raise :class:`Hang` where the context takes longer."""

    def ring(*_: object) -> None:
        raise Hang

    before = signal.signal(signal.SIGALRM, ring)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


class Referee:
    """Counts verdicts, and keeps the first example of each bad one.

    Args:
        good: Verdicts that a mutant may have.
    """

    def __init__(self, good: tuple[str, ...]) -> None:
        self.good = good
        self.counts: Counter[str] = Counter()
        self.examples: dict[str, str] = {}
        self._began = time.perf_counter()
        self._memory = memory()

    def judge(self, what: str, attack: Callable[[], str], seconds: float) -> None:
        """Run one mutant; ``attack`` returns its verdict, and whatever it raises is a traceback."""
        try:
            with limited(seconds):
                verdict = attack()
            detail = ""
        except Hang:
            verdict, detail = "hang", traceback.format_exc(limit=-4)
        except Exception:
            verdict, detail = "traceback", traceback.format_exc(limit=-4)
        self.counts[verdict] += 1
        if verdict not in self.good:
            self.examples.setdefault(verdict, f"{what}\n{detail}")

    def end(self) -> int:
        """Print the counts; exit code 1 where any mutant got through."""
        found = {
            "mutants": sum(self.counts.values()),
            **dict(sorted(self.counts.items())),
            "seconds": round(time.perf_counter() - self._began),
            "memory_MB": round(memory() - self._memory),
        }
        print(json.dumps(found))
        for verdict, example in self.examples.items():
            print(f"{verdict}, for example: {example}", file=sys.stderr)
        return int(bool(self.examples))


def memory() -> float:
    """Largest memory that this process had so far [MB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def arguments(text: str | None, count: int) -> argparse.ArgumentParser:
    """Number of mutants and seed, of every campaign."""
    parser = argparse.ArgumentParser(description=text)
    parser.add_argument("--count", type=int, default=count, help="number of mutants; default: %(default)s")
    parser.add_argument("--seed", type=int, default=0, help="seed; default: %(default)s")
    return parser
