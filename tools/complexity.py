# SPDX-License-Identifier: Apache-2.0
"""Functions above the complexity limits of Ruff, by rule and file, and the baseline that may only shrink.

``complexity.json`` beside this file has their numbers. ``./run python -m tools.complexity`` writes it anew after a
function was split, and refuses a file that has more of them than before.

    C901     cyclomatic complexity above 10 (McCabe 1976)
    PLR0911  more than 6 returns
    PLR0912  more than 12 branches
    PLR0913  more than 5 arguments
    PLR0915  more than 50 statements
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections import Counter
from pathlib import Path

from impact_rs_sim.files import write_whole

ROOT = Path(__file__).resolve().parents[1]
BASELINE = Path(__file__).with_name("complexity.json")
RULES = ("C901", "PLR0911", "PLR0912", "PLR0913", "PLR0915")

Counts = dict[str, dict[str, int]]  # by rule and file


def present_counts() -> Counts:
    """Functions above the limits in the sources, by Ruff."""
    arguments = [
        "ruff",
        "check",
        str(ROOT),
        "--select",
        ",".join(RULES),
        "--output-format",
        "json",
        "--no-cache",
        "--exit-zero",
    ]
    output = subprocess.run([sys.executable, "-m", *arguments], capture_output=True, text=True, check=True, cwd=ROOT)
    counts_by_rule: dict[str, Counter[str]] = {rule: Counter() for rule in RULES}
    for violation in json.loads(output.stdout):
        counts_by_rule[violation["code"]][Path(violation["filename"]).relative_to(ROOT).as_posix()] += 1
    return {rule: dict(sorted(counts.items())) for rule, counts in counts_by_rule.items()}


def baseline() -> Counts:
    """Numbers of the baseline."""
    counts: Counts = json.loads(BASELINE.read_text(encoding="utf-8"))
    return counts


def grown(now: Counts, before: Counts) -> list[str]:
    """Files with more functions above a limit than before, one line each."""
    return [
        f"{file}: {count} functions above the limit of {rule}, {before[rule].get(file, 0)} in the baseline"
        for rule, counts in now.items()
        for file, count in counts.items()
        if count > before[rule].get(file, 0)
    ]


if __name__ == "__main__":
    current = present_counts()
    if BASELINE.exists() and (lines := grown(current, baseline())):
        sys.exit("\n".join([*lines, "split them: the baseline only shrinks"]))
    write_whole(BASELINE, json.dumps(current, indent=1) + "\n")
