# SPDX-License-Identifier: Apache-2.0
"""Calibration of the p values of a diagnosis: shares below 1 and 5 % where nothing is hidden, and power.

Nothing is hidden in a campaign of conditions x repeats. Features have the covariance that they have along a trial, in
which few directions carry most of the noise; the relevance limit is 0.1 or 10 times the noise. Residuals are

* normal,
* heavy: Student's t with 3 degrees of freedom, direction by direction,
* heavy trials: the same factor for all features of a trial,
* drift: normal, and every feature drifts by two standard deviations over the campaign, whose conditions are
  interleaved in random order.

With ``--discrepancy`` they are normal, and the simulator is off by 0.3 or 1.0 of the noise in every feature, alike in
all conditions, as its discrepancy says: along the measured patterns of the discrepancy, or, as a simulator that it was
not measured on, along none of them.

Every draw is treated as in a diagnosis: runs become clusters, scaled by the pure error of their repeats. They give the
p values of effects with 1 and with 7 parameters, the smallest adjusted p of six effects, lack of fit, and, after a fit
of 7 parameters, the p value of 1 more parameter and lack of fit. A calibrated test rejects 1 % of nulls at 1 %, and 5 %
at 5 %. ``--power`` hides an effect of 2 or 4 standard errors instead. The last row is a recording with correlated
noise, in 24 stretches.
"""

from __future__ import annotations

import argparse

import numpy as np
from analytic_world import EFFECTS, FEATURES, AnalyticSource, correlated, features

from benchmarks.closed_form import EXACT, Campaign, Simulator
from benchmarks.harness import Case, Row, Work, draw_options, map_draws
from benchmarks.results import Table
from impact_rs_analysis.diagnosis.search import null_distribution
from impact_rs_analysis.diagnosis.search.candidate import Candidate, Problem, linearise
from impact_rs_analysis.diagnosis.search.fit import Evidence, Fit
from impact_rs_analysis.diagnosis.search.null_distribution import benjamini_hochberg
from impact_rs_sim.robots.robot import Array

DESIGNS = ((3, 2), (6, 2), (4, 4), (6, 3), (9, 5))  # conditions, repeats
NOISES = ("normal", "heavy", "heavy trials", "drift")
SIMULATORS = {
    f"{words}, {size:g}": Simulator(size, kind)
    for size in (0.3, 1.0)
    for kind, words in (("measured", "measured patterns"), ("new", "new simulator"))
}
RECORDING = "recording, 24 stretches"
STRETCHES, MEMORY = 24, 4.0  # of a recording; memory in samples
LEVELS = (0.01, 0.05)
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


def remembering() -> Array:
    """Root of the covariance of samples whose correlation falls to 1/e in ``MEMORY`` samples."""
    distance = np.abs(np.subtract.outer(np.arange(FEATURES), np.arange(FEATURES)))
    return np.asarray(np.linalg.cholesky(np.exp(-distance / MEMORY)).T)


def standard_error(design: tuple[int, int], limit: float) -> float:
    """Standard error of the estimate of the effect ``straight`` with the true scales."""
    conditions, repeats = design
    weight = 1.0 / (np.square(SPREAD) * (1.0 + (limit / 2.0) ** 2))
    scores = [weight * features(number, (("straight", (1.0,)),)) for number in range(conditions)]
    information = sum(float(np.sum(np.square(score) / weight)) for score in scores)
    noise = sum(float(np.sum(np.square(ROOT @ score))) for score in scores)
    return float(np.sqrt(noise / repeats) / information)


def p_values(source: AnalyticSource) -> tuple[float, ...]:
    """p values of ``COLUMNS``."""
    evidence = Evidence.of(source)
    p_by_effect, problems = {}, {}
    for name, effect in EFFECTS.items():
        if name == "one_sided":
            continue
        candidate = linearise(Candidate.of((effect,), source), source.clusters, evidence.numbers, source)
        assert candidate is not None
        problems[name] = Problem(candidate, source.clusters, evidence.neighbours)
        p_by_effect[name] = problems[name].p_value(evidence.null, slice(None))
    fitted = Fit.of(problems["of_motors"].candidate, evidence)
    extended = evidence.problem(fitted.candidate.joined_with(problems["straight"].candidate))
    return (
        p_by_effect["straight"],
        p_by_effect["of_joints"],
        min(benjamini_hochberg(p_by_effect).values()),
        np.nan if evidence.lack_of_fit is None else evidence.lack_of_fit,
        extended.p_value(fitted.residual_evidence.null, slice(fitted.change.size, None)),
        np.nan if (lack_of_fit := fitted.lack_of_fit()) is None else lack_of_fit,
    )


def add_options(parser: argparse.ArgumentParser) -> None:
    """How many draws."""
    draw_options(parser, 1000)
    parser.add_argument(
        "--null-draws", type=int, default=999, help="draws of each null distribution, 999 or more; a diagnosis: 4999"
    )
    parser.add_argument("--power", action="store_true", help="effects of 2 and 4 standard errors in place of none")
    parser.add_argument("--discrepancy", action="store_true", help="simulators that are off in place of the noises")
    parser.add_argument("--limits", type=float, nargs="+", default=[0.1], help="relevance limits over the noise")


def cases(options: argparse.Namespace) -> list[Case]:
    """Designs, noises or simulators, relevance limits and sizes of what is hidden."""
    worlds = [(noise, noise, EXACT) for noise in NOISES]
    if options.discrepancy:
        worlds = [(words, NOISES[0], simulator) for words, simulator in SIMULATORS.items()]
    campaigns = [
        Case(
            f"{design[0]} × {design[1]}, {words}"
            + (f", limit {limit:g}" if len(options.limits) > 1 else "")
            + (f", effect {size:g}" if size else ""),
            (design, noise, simulator, limit, size),
        )
        for design in DESIGNS
        for words, noise, simulator in worlds
        for limit in options.limits
        for size in ((2.0, 4.0) if options.power else (0.0,))
    ]
    return campaigns if options.power or options.discrepancy else [*campaigns, Case(RECORDING)]


def draw_case(case: Case, options: argparse.Namespace, seed: int) -> tuple[float, ...]:
    """p values of one draw."""
    null_distribution.NULL_DRAWS = options.null_draws  # type: ignore[attr-defined]
    if case.inputs is None:
        return p_values(AnalyticSource(seed, design=(1,) * STRETCHES, correlation=remembering(), repeated=False))
    design, noise, simulator, limit, size = case.inputs
    truth = (("straight", (size * standard_error(design, limit),)),) if size else ()
    return p_values(Campaign(seed, design, truth, limit, ROOT, noise, simulator))


def run(case: Case, work: Work) -> Row:
    """Shares below the levels [%], ``columns x levels``."""
    p_values_of_draws = np.array(map_draws(draw_case, case, work.options, work.map_tasks))
    shares = [
        None if np.isnan(column).all() else 100.0 * float(np.mean(column < level))
        for column in p_values_of_draws.T
        for level in LEVELS
    ]
    return {"shares": shares}


def table(rows: list[Row], options: argparse.Namespace) -> Table:
    """A row for each design and noise."""
    del options
    head = [f"{name}: {level:.0%}" for name in COLUMNS for level in LEVELS]
    lines = [
        (row["name"], *("–" if percent is None else f"{percent:.1f}" for percent in row["shares"])) for row in rows
    ]
    return Table(("design, noise", *head), tuple(lines))
