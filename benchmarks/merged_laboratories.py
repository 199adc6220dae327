# SPDX-License-Identifier: Apache-2.0
"""Five simulated laboratories, merged by the shipped code: coverage, width, and the odd laboratory.

    ./run python -m benchmarks.merged_laboratories [--runs 2000]

Every laboratory reports four parameters with their standard errors, drawn between half and one and a half of the usual
one. The truth is planted: all alike; each off by a small deviation of its own; one laboratory off in one parameter;
and, with six laboratories and two robots, a parameter that differs by robot. Estimates are normal. Packages go through
``merge_packages``, with all its checks.
"""

from __future__ import annotations

import argparse
import hashlib
from collections import Counter

import numpy as np
from rich.console import Console
from rich.table import Table

from impact_rs_analysis.diagnosis.document import DiagnosisDocument
from impact_rs_analysis.sharing.evidence_package import EvidencePackage, FileDigest
from impact_rs_analysis.sharing.merged_evidence import MergedEvidence, merge_packages
from impact_rs_sim.model import load_model
from impact_rs_sim.numbers import NORMAL_95

PARAMETERS = ("law_1", "law_2", "law_3", "law_4")
MODEL = load_model("nominal")
TRUTH = 1.0
USUAL = 0.1  # standard error

console = Console(width=140)


def package(laboratory: str, robot: str, values: list[float], errors: list[float]) -> EvidencePackage:
    """What one laboratory reports."""
    effects = [
        {
            "name": name,
            "verdict": "CONFIRMED",
            "parameters": {
                "size": {
                    "estimate": value,
                    "ci95": [value - NORMAL_95 * error, value + NORMAL_95 * error],
                    "unit": "N m",
                }
            },
            "held_out_error_before": 2.0,
            "held_out_error_after": 1.0,
            "p_value": 0.001,
        }
        for name, value, error in zip(PARAMETERS, values, errors, strict=True)
    ]
    diagnosis = DiagnosisDocument.model_validate(
        {
            "verdict": "+".join(PARAMETERS),
            "named": PARAMETERS,
            "effects": effects,
            "confusable": (),
            "model": {"name": MODEL.name, "digest": MODEL.digest},
            "runs": {"digest": "", "trials": 9, "conditions": ("a",)},
            "noise_floor": 1.0,
            "held_out_error_before": 2.0,
            "held_out_error_after": 1.0,
        }
    )
    measurements = FileDigest(path="runs", size=1, sha256=hashlib.sha256(repr(values).encode()).hexdigest())
    return EvidencePackage(
        laboratory=laboratory,
        robot=robot,
        object="box",
        versions={},
        model=MODEL,
        diagnosis=diagnosis,
        data=(measurements,),
    ).sealed()


def merged(
    rng: np.random.Generator, robots: list[str], tau: float, shift: float, wrong: int, by_robot: float
) -> MergedEvidence:
    """One merge; the last laboratory is off in some parameters, and the second robot in the second parameter.

    Args:
        rng: Draws everything.
        robots: Robot of every laboratory.
        tau: Deviation between laboratories, over the usual standard error.
        shift: Of the odd laboratory, over its standard error.
        wrong: In how many parameters.
        by_robot: Between robots, over the usual standard error.
    """
    packages = []
    for number, robot in enumerate(robots):
        errors = USUAL * rng.uniform(0.5, 1.5, len(PARAMETERS))
        values = TRUTH + tau * USUAL * rng.standard_normal(errors.size) + errors * rng.standard_normal(errors.size)
        if number == len(robots) - 1:
            values[:wrong] += shift * errors[:wrong]
        if robot != robots[0]:
            values[1] += by_robot * USUAL
        packages.append(package(f"laboratory {number + 1}", robot, values.tolist(), errors.tolist()))
    return merge_packages(packages)


def study(runs: int, robots: list[str], tau: float, shift: float, wrong: int, by_robot: float) -> list[str]:
    """Row of the table."""
    rng = np.random.default_rng(7)
    covered, narrower, shared, named, others, belongs = 0, 0, 0, 0, 0, Counter[str]()
    odd_name = f"laboratory {len(robots)}"
    for _ in range(runs):
        found = merged(rng, robots, tau, shift, wrong, by_robot)
        named += shift != 0.0 and odd_name in found.odd
        others += any(
            name != odd_name or shift == 0.0 or not set(where) <= {f"{one}.size" for one in PARAMETERS[:wrong]}
            for name, where in found.odd.items()
        )
        for one in found.parameters:
            if by_robot and one.effect == "law_2":
                belongs[" or ".join(one.belongs_to)] += 1
                continue
            low, high = one.pooled.ci95
            shared += 1
            covered += low <= TRUTH <= high
            alone = [each.ci95[1] - each.ci95[0] for each in one.contributions]
            narrower += high - low < float(np.median(alone))
    return [
        f"{100.0 * covered / shared:.1f}",
        f"{100.0 * narrower / shared:.1f}",
        f"{100.0 * named / runs:.1f}" if shift else "-",
        f"{100.0 * others / runs:.1f}",
        ", ".join(f"{name} {100.0 * count / runs:.1f}" for name, count in belongs.most_common()) or "-",
    ]


def main() -> None:
    """Simulate and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=2000, help="merges of each row")
    options = parser.parse_args()
    table = Table(title=f"{options.runs} merges each [%]")
    for heading in (
        "planted [standard errors]",
        "shared: truth in interval",
        "narrower than the median laboratory",
        "odd laboratory named",
        "merges that name another",
        "belongs to",
    ):
        table.add_column(heading)
    same, two = ["arm"] * 5, ["first", "second"] * 3
    rows = {
        "all alike": (same, 0.0, 0.0, 0, 0.0),
        "laboratories deviate by 0.5 standard errors": (same, 0.5, 0.0, 0, 0.0),
        "laboratories deviate by 1 standard error": (same, 1.0, 0.0, 0, 0.0),
        "one is off by 4 in one parameter": (same, 0.0, 4.0, 1, 0.0),
        "one is off by 6 in one parameter": (same, 0.0, 6.0, 1, 0.0),
        "one is off by 8 in one parameter": (same, 0.0, 8.0, 1, 0.0),
        "one is off by 5 in all four": (same, 0.0, 5.0, 4, 0.0),
        "robots differ by 6 (six laboratories)": (two, 0.0, 0.0, 0, 6.0),
    }
    for label, asked in rows.items():
        table.add_row(label, *study(options.runs, *asked))
    console.print(table)


if __name__ == "__main__":
    main()
