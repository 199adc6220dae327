# SPDX-License-Identifier: Apache-2.0
"""Are p values what they say? ``./run python benchmarks/calibration.py --draws 1000 -o docs/calibration_table.md``.

Nothing is hidden in a campaign of conditions x repeats. Features have the covariance that they have along a trial, in
which few directions carry most of the noise; the relevance limit is 0.1 or 10 times the noise. Residuals are

* normal,
* heavy: Student's t with 3 degrees of freedom, direction by direction,
* heavy trials: the same factor for all features of a trial,
* drifting: normal, and every feature drifts by two standard deviations over the campaign, whose conditions are
  interleaved in random order.

Every draw goes the way of a diagnosis: runs become clusters, scaled by the pure error that their repeats give, and
these the p values of effects with 1 and with 7 parameters, the smallest adjusted p of six effects, lack of fit, and,
beside 7 parameters that were fitted, the p value of 1 parameter and lack of fit. A right test calls 1 % of nulls
significant at 1 %, and 5 % at 5 %. ``--power`` hides an effect of 2 or 4 standard errors instead. The last row is a
recording, with noise that remembers some samples, in 24 stretches.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from impact_rs_analysis.diagnosis import null_distribution
from impact_rs_analysis.diagnosis.candidate import Candidate, Problem, linearise
from impact_rs_analysis.diagnosis.fit import Evidence, Fit
from impact_rs_analysis.diagnosis.search import adjusted
from impact_rs_analysis.evidence.cluster import Feature
from impact_rs_analysis.evidence.discrepancy import NO_DISCREPANCY
from impact_rs_analysis.evidence.measured_runs import MeasuredRun, Runs, Setup
from impact_rs_analysis.evidence.replays import clusters_of
from impact_rs_sim.robot import Array
from impact_rs_trials.runs import NONE, Signals

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "test" / "impact_rs_analysis" / "diagnosis"))

from analytic_world import EFFECTS, FEATURES, PHYSICS, AnalyticSource, correlated, features  # noqa: E402

DESIGNS = ((3, 2), (6, 2), (4, 4), (6, 3), (9, 5))  # conditions, repeats
NOISES = ("normal", "heavy", "heavy trials", "drifting")
LIMITS = (0.1, 10.0)  # relevance limit over noise
DRIFT = 2.0  # standard deviations over a campaign
STRETCHES, MEMORY = 24, 4.0  # of a recording; memory in samples
LEVELS = (0.01, 0.05)
TOLERANCE = (0.005, 0.015)
COLUMNS = (
    "1 parameter",
    "7 parameters",
    "any of 6, adjusted",
    "lack of fit",
    "1 beside 7 fitted",
    "lack of fit, 7 fitted",
)
ROOT = correlated()
SPREAD = np.sqrt(np.sum(np.square(ROOT), axis=0))


class Campaign(AnalyticSource):
    """Runs of a campaign, made clusters by the code of a diagnosis.

    Args:
        seed: Of the noise.
        design: Conditions and repeats.
        noise: One of ``NOISES``.
        limit: Relevance limit, in multiples of the noise.
        size: Of the effect ``straight`` that is hidden.
    """

    def __init__(self, seed: int, design: tuple[int, int], noise: str, limit: float, size: float = 0.0) -> None:
        conditions, repeats = design
        super().__init__(seed, design=(repeats,) * conditions)
        labels = tuple(
            Feature("free", f"signal {f % 4}", "x", f // 4, "m/s", limit * float(SPREAD[f])) for f in range(FEATURES)
        )
        truth = (("straight", (size,)),)
        measured = [features(number // repeats, truth) for number in range(conditions * repeats)]
        measured = list(np.array(measured) + draw(np.random.default_rng(seed), len(measured), noise))
        runs = [_run(f"{number // repeats}", labels, values) for number, values in enumerate(measured)]
        self.clusters, _ = clusters_of(Runs(Path(), tuple(runs), ()), measured, NO_DISCREPANCY)


def draw(rng: np.random.Generator, count: int, noise: str) -> Array:
    """Noise of some runs, ``(count, F)``."""
    if noise == "heavy":
        return np.asarray(rng.standard_t(3, (count, FEATURES)) / np.sqrt(3.0) @ ROOT)
    values = rng.standard_normal((count, FEATURES)) @ ROOT
    if noise == "heavy trials":
        values /= np.sqrt(rng.chisquare(3, (count, 1)))
    if noise == "drifting":
        order = rng.permutation(count) / (count - 1.0) - 0.5
        values += DRIFT * order[:, None] * SPREAD * rng.choice([-1.0, 1.0], FEATURES)
    return np.asarray(values)


def _run(condition: str, labels: tuple[Feature, ...], measured: Array) -> MeasuredRun:
    setup = Setup((), PHYSICS, 0.0, "command", False, False, None, tuple(range(len(labels))), {})
    return MeasuredRun(
        path=Path(condition), name=condition, condition=condition, place=("world", "object", condition), hit=False,
        physics=PHYSICS, signals=Signals(NONE, {}), setup=setup, features=labels, measured=measured, impacts={}, free=0,
    )  # fmt: skip


def remembering() -> Array:
    """Root of the covariance of samples whose correlation falls to 1/e in ``MEMORY`` samples."""
    distance = np.abs(np.subtract.outer(np.arange(FEATURES), np.arange(FEATURES)))
    return np.asarray(np.linalg.cholesky(np.exp(-distance / MEMORY)).T)


def standard_error(design: tuple[int, int], limit: float) -> float:
    """Of the estimate of the effect ``straight`` with the true scales."""
    conditions, repeats = design
    weight = 1.0 / (np.square(SPREAD) * (1.0 + (limit / 2.0) ** 2))
    scores = [weight * features(number, (("straight", (1.0,)),)) for number in range(conditions)]
    information = sum(float(np.sum(np.square(score) / weight)) for score in scores)
    noise = sum(float(np.sum(np.square(ROOT @ score))) for score in scores)
    return float(np.sqrt(noise / repeats) / information)


def p_values(source: AnalyticSource) -> tuple[float, ...]:
    """p values of ``COLUMNS``."""
    evidence = Evidence.of(source)
    found, problems = {}, {}
    for name, effect in EFFECTS.items():
        if name == "one_sided":
            continue
        candidate = linearise(Candidate.of((effect,), source), source.clusters, evidence.numbers, source)
        assert candidate is not None
        problems[name] = Problem(candidate, source.clusters, evidence.neighbours)
        found[name] = problems[name].p_value(evidence.null, slice(None))
    fitted = Fit.of(problems["of_motors"].candidate, evidence)
    beside = evidence.problem(fitted.candidate.beside(problems["straight"].candidate))
    return (
        found["straight"],
        found["of_joints"],
        min(adjusted(found).values()),
        np.nan if evidence.lack_of_fit is None else evidence.lack_of_fit,
        beside.p_value(fitted.left.null, slice(fitted.change.size, None)),
        np.nan if (left := fitted.lack_of_fit()) is None else left,
    )


def rows(draws: int, sizes: tuple[float, ...]) -> Iterator[tuple[str, list[AnalyticSource]]]:
    """Names of the rows of the table, and their draws."""
    for conditions, repeats in DESIGNS:
        for noise in NOISES:
            for limit in LIMITS:
                for size in sizes:
                    design = conditions, repeats
                    shift = size * standard_error(design, limit)
                    name = f"{conditions} x {repeats} | {noise} | {limit:g}" + (f" | {size:g}" if size else "")
                    yield name, (Campaign(seed, design, noise, limit, shift) for seed in range(draws))
    if sizes == (0.0,):
        root = remembering()
        yield (
            "24 stretches | normal | –",
            (AnalyticSource(seed, design=(1,) * STRETCHES, correlation=root, repeated=False) for seed in range(draws)),
        )


def main() -> None:
    """Count and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draws", type=int, default=1000, help="campaigns of every row")
    parser.add_argument(
        "--null-draws", type=int, default=999, help="draws of each null distribution; a diagnosis: 4999"
    )
    parser.add_argument("--power", action="store_true", help="effects of 2 and 4 standard errors in place of none")
    parser.add_argument("--only", default="", help="rows whose name holds this text")
    parser.add_argument("-o", "--output", type=Path, help="Markdown file")
    arguments = parser.parse_args()
    null_distribution.DRAWS = arguments.null_draws  # type: ignore[attr-defined]
    first = "design | noise | limit" + (" | effect" if arguments.power else "")
    head = " | ".join(f"{name}: {level:.0%}" for name in COLUMNS for level in LEVELS)
    lines = [f"| {first} | {head} |", "|---" * (first.count("|") + 1 + len(COLUMNS) * len(LEVELS)) + "|"]
    print("\n".join(lines), flush=True)
    for name, sources in rows(arguments.draws, (2.0, 4.0) if arguments.power else (0.0,)):
        if arguments.only not in name:
            continue
        began = time.monotonic()
        cells = []
        for column in np.array([p_values(source) for source in sources]).T:
            for level, tolerance in zip(LEVELS, TOLERANCE, strict=True):
                share = float(np.mean(column < level))
                chance = 3.0 * float(np.sqrt(level * (1.0 - level) / arguments.draws))
                mark = "" if arguments.power or share <= level + tolerance + chance else " (!)"
                cells.append("–" if np.isnan(column).all() else f"{100.0 * share:.1f}{mark}")
        lines.append(f"| {name} | {' | '.join(cells)} |")
        print(f"{lines[-1]}  ({time.monotonic() - began:.0f} s)", flush=True)
    if arguments.output is not None:
        arguments.output.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
