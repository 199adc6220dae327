# SPDX-License-Identifier: Apache-2.0
"""Stands for ``impact-rs`` in a job: does what FOLDER/told.json says, as the real command does it.

    python stub_job.py FOLDER ARGUMENTS...

It tells its progress, asks its questions, waits for FOLDER/go, copies prepared results to where the command would write
them, prints, and ends with an exit code. Ctrl-C interrupts it while it waits.
"""

from __future__ import annotations

import json
import shutil
import signal
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

from impact_rs_sim.progress import ProgressFile
from impact_rs_sim.questions import PageQuestions


@dataclass
class Stub:
    """What the jobs of a workbench do instead of ``impact-rs``.

    Args:
        folder: Where they are told.
    """

    folder: Path

    @property
    def command(self) -> tuple[str, ...]:
        """How a job calls it."""
        return sys.executable, __file__, str(self.folder)

    def tells(
        self,
        *,
        first: str = "it has begun",
        prints: str = "done",
        total: int = 0,
        done: int = 0,
        ranking: dict[str, float] | None = None,
        questions: tuple[str, ...] = (),
        waits: bool = False,
        results: dict[Path, Path] | None = None,
        code: int = 0,
    ) -> None:
        """What the next jobs do."""
        told = {key: value for key, value in locals().items() if key != "self"}
        told |= {"ranking": ranking or {}, "results": {str(a): str(b) for a, b in (results or {}).items()}}
        (self.folder / "go").unlink(missing_ok=True)
        (self.folder / "told.json").write_text(json.dumps(told))

    def go(self) -> None:
        """A job that waits goes on."""
        (self.folder / "go").touch()


def interrupted(number: int, frame: FrameType | None) -> None:
    """End as a command does."""
    print(f"impact-rs {sys.argv[2]}: interrupted; the same command goes on where it stopped", flush=True)
    sys.exit(130)


def main() -> int:
    """Do it; returns the exit code."""
    signal.signal(signal.SIGINT, interrupted)
    folder = Path(sys.argv[1])
    told = json.loads((folder / "told.json").read_text(encoding="utf-8"))
    progress, asking = ProgressFile(), PageQuestions.of_environment()
    print(told["first"], flush=True)
    for name, error in told["ranking"].items():
        progress.rank(name, error)
    if told["total"]:
        progress.update("trials", told["done"], told["total"])
    for text in told["questions"]:
        print(f"{text}: {asking is not None and asking.ask(text)}", flush=True)
    while told["waits"] and not (folder / "go").exists():
        time.sleep(0.02)
    for source, target in told["results"].items():
        Path(target).parent.mkdir(parents=True, exist_ok=True)
        if Path(source).is_dir():
            shutil.copytree(source, target, dirs_exist_ok=True)
        else:
            shutil.copy(source, target)
    print(told["prints"], flush=True)
    return int(told["code"])


if __name__ == "__main__":
    sys.exit(main())
