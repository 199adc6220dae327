# SPDX-License-Identifier: Apache-2.0
"""Damaged raw files against their readers: ``./run python -m benchmarks.attacks --count 500 --seed 1``.

Clean files of joints, of a bouncing ball, of impacts in a table and of a robot are made, one attack is made on each of
many copies, and ``import``, ``compare``, ``impacts`` and ``robot import`` run on them in this process:

    refused   exit code 2, and no file is left
    same      exit code 0, and the same numbers as from the clean file
    said      exit code 0, other numbers, and a note, an assumption or a count that the clean file does not have
    silent    exit code 0, other numbers, and not a word: a defect
    broken    an exception, a warning of a library, another exit code, or a file left by a refusal: a defect

Attacks that leave a valid file with other numbers, as a changed digit does, are not made: no reader can see them.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.attacks.campaign import COMMANDS, Case, campaign, cases


def main() -> int:
    """Make the attacks and print the counts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=500)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", type=int, nargs="+", metavar="NUMBER", help="these attacks alone")
    parser.add_argument("--verbose", action="store_true", help="also what was said of every file")
    args = parser.parse_args()
    start = time.monotonic()

    def report(case: Case) -> None:
        if args.verbose or case.verdict in ("silent", "broken"):
            print(f"{case.verdict:8} {case.name}: {case.why[:300]}", file=sys.stderr, flush=True)

    with tempfile.TemporaryDirectory() as folder:
        chosen = [case for case in cases(args.count) if args.only is None or case.number in args.only]
        judged = campaign(chosen, args.seed, Path(folder), report)
    verdicts = ("refused", "same", "said", "silent", "broken")
    print(f"| Command | Files | {' | '.join(verdicts)} |")
    print("|---" * (len(verdicts) + 2) + "|")
    for command in (*COMMANDS, "all"):
        chosen_verdicts = [case.verdict for case in judged if command in (case.command, "all")]
        counts = [str(chosen_verdicts.count(verdict)) for verdict in verdicts]
        print(f"| {command} | {len(chosen_verdicts)} | {' | '.join(counts)} |")
    print(f"{time.monotonic() - start:.0f} s, seed {args.seed}")
    return int(any(case.verdict in ("silent", "broken") for case in judged))


if __name__ == "__main__":
    sys.exit(main())
