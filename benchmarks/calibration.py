# SPDX-License-Identifier: Apache-2.0
"""Are p values what they say? ``./run python benchmarks/calibration.py --draws 2000 -o docs/calibration_table.md``.

Nothing is hidden: residuals are normal noise with the covariance of features along a trial, in which few directions
carry most of it, in designs of conditions x repeats; for recordings, noise that remembers some samples, in 24
stretches.
Every draw goes through the code of a diagnosis: effects with 1 and with 7 parameters, the smallest adjusted p of six
effects, and lack of fit. A right test calls 1 % of nulls significant at 1 %, and 5 % at 5 %.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np

from impact_rs_analysis.diagnosis import null_distribution
from impact_rs_analysis.diagnosis.candidate import Problem
from impact_rs_analysis.diagnosis.fit import Evidence
from impact_rs_analysis.diagnosis.search import adjusted

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "test" / "impact_rs_analysis" / "diagnosis"))

from analytic_world import EFFECTS, FEATURES, AnalyticSource, correlated  # noqa: E402

from impact_rs_analysis.diagnosis.candidate import Candidate, linearise  # noqa: E402

DESIGNS = {"3 x 2": (2,) * 3, "6 x 2": (2,) * 6, "6 x 3": (3,) * 6, "9 x 5": (5,) * 9}
STRETCHES, SAMPLES, MEMORY = 24, FEATURES, 4.0  # of a recording; memory in samples
LEVELS = (0.01, 0.05)
TOLERANCE = (0.005, 0.015)
COLUMNS = ("1 parameter", "7 parameters", "any of 6 effects, adjusted", "lack of fit")


def remembering() -> np.ndarray:
    """Root of the covariance of samples whose correlation falls to 1/e in ``MEMORY`` samples."""
    distance = np.abs(np.subtract.outer(np.arange(SAMPLES), np.arange(SAMPLES)))
    return np.linalg.cholesky(np.exp(-distance / MEMORY)).T


def p_values(source: AnalyticSource) -> tuple[float, ...]:
    """p of one effect with 1 and one with 7 parameters, the smallest adjusted p of six effects, and lack of fit."""
    evidence = Evidence.of(source)
    numbers = tuple(range(len(source.clusters)))
    found = {}
    for name, effect in EFFECTS.items():
        if name == "one_sided":
            continue
        candidate = linearise(Candidate.of((effect,), source), source.clusters, numbers, source)
        assert candidate is not None
        found[name] = Problem(candidate, source.clusters, evidence.neighbours).p_value(evidence.null, slice(None))
    left = evidence.null.lack_of_fit([item.mean for item in source.clusters])
    smallest = min(adjusted(found).values())
    return found["straight"], found["of_joints"], smallest, np.nan if left is None else left


def table(draws: int) -> list[str]:
    """The table, row by row as it is counted."""
    head = " | ".join(f"{name}: {level:.0%}" for name in COLUMNS for level in LEVELS)
    lines = [f"| design | draws | {head} |", "|---" * (2 + len(COLUMNS) * len(LEVELS)) + "|"]
    root = correlated()
    for name, design in [*DESIGNS.items(), ("recording, 24 stretches", None)]:
        began = time.monotonic()
        rows = []
        for seed in range(draws):
            if design is None:
                source = AnalyticSource(seed, design=(1,) * STRETCHES, correlation=remembering(), repeated=False)
            else:
                source = AnalyticSource(seed, design=design, correlation=root)
            rows.append(p_values(source))
        values = np.array(rows)
        cells = []
        for column in values.T:
            for level, tolerance in zip(LEVELS, TOLERANCE, strict=True):
                if np.isnan(column).all():
                    cells.append("–")
                    continue
                share = float(np.mean(column < level))
                mark = "" if abs(share - level) <= tolerance else " (!)"
                cells.append(f"{100.0 * share:.2f} %{mark}")
        lines.append(f"| {name} | {draws} | {' | '.join(cells)} |")
        print(f"{lines[-1]}  ({time.monotonic() - began:.0f} s)", flush=True)
    return lines


def main() -> None:
    """Count and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draws", type=int, default=2000, help="nulls for every design")
    parser.add_argument(
        "--null-draws", type=int, default=999, help="draws of each null distribution; a diagnosis: 4999"
    )
    parser.add_argument("-o", "--output", type=Path, help="Markdown file")
    arguments = parser.parse_args()
    null_distribution.DRAWS = arguments.null_draws  # type: ignore[attr-defined]
    lines = table(arguments.draws)
    print("\n".join(lines))
    if arguments.output is not None:
        arguments.output.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
