# SPDX-License-Identifier: Apache-2.0
"""Small campaigns of the closed-form world, diagnosed the whole way: what few conditions and repeats can decide.

Every draw is a campaign of conditions x repeats whose noise is known by its own repeats alone, and whose simulator is
exact, or off by 0.3 of the noise in every feature, along the measured patterns of its discrepancy. It hides

* nothing,
* the effect ``straight``, of 5, 6 or 8 standard errors of its best estimate,
* a cause outside the library, of 2 or 4 standard deviations of the noise in every feature, no two conditions alike.

Strictly right are NOTHING-MISSING where nothing is hidden, exactly the hidden effect, and a verdict other than
NOTHING-MISSING without any name where the cause is outside the library. Shares have a standard error.
The last rows are of all named effects by the probability that the diagnosis states, where it states one.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from analytic_world import EFFECTS, correlated, knowing

from benchmarks.closed_form import EXACT, WHITE, Campaign, Simulator, standard_error
from benchmarks.harness import Case, Row, Work, draw_options, map_draws
from benchmarks.hidden import by_probability, stated_probabilities
from benchmarks.results import Table
from impact_rs_analysis.diagnosis.diagnose import diagnose
from impact_rs_analysis.diagnosis.verdict import NOTHING
from impact_rs_analysis.evidence.cluster import Added

DESIGNS = ("3x2", "4x2", "6x2", "6x3")  # conditions x repeats
HIDDEN, SIZES = "straight", (5.0, 6.0, 8.0)  # standard errors
OUTSIDE, STRENGTHS = "outside", (2.0, 4.0)  # standard deviations of the noise
DISCREPANCY = 0.3  # of the noise
CONSIDERED = (
    "straight", "bent", "twin_of_straight", "payload", "of_joints", "of_motors", "one_sided", "inverse", "saturated",
    "local", "slight", "nearly_bent",
)  # fmt: skip


def add_options(parser: argparse.ArgumentParser) -> None:
    """How many draws, of what."""
    draw_options(parser, 60)
    parser.add_argument("--designs", nargs="+", default=list(DESIGNS), metavar="CxR", help="conditions x repeats")
    parser.add_argument("--correlated", action="store_true", help="few directions carry most of the noise")


def cases(options: argparse.Namespace) -> list[Case]:
    """What is missed or named in vain most easily comes first."""
    sizes = [f"{HIDDEN} {size:g}" for size in SIZES]
    rows = [(hidden, discrepancy) for discrepancy in (0.0, DISCREPANCY) for hidden in ("nothing", *sizes)]
    rows += [(f"{OUTSIDE} {strength:g}", DISCREPANCY) for strength in STRENGTHS]
    return [
        Case(f"{design}, {'discrepancy' if discrepancy else 'exact'}, {hidden}", (design, hidden, discrepancy))
        for hidden, discrepancy in rows
        for design in options.designs
    ]


def campaign(case: Case, options: argparse.Namespace, seed: int) -> tuple[Campaign, Added]:
    """One draw, and what it hides."""
    design, hidden, discrepancy = case.inputs
    conditions, repeats = (int(number) for number in design.split("x"))
    root = correlated() if options.correlated else WHITE
    simulator = Simulator(discrepancy) if discrepancy else EXACT
    name, _, size = hidden.partition(" ")
    unit = standard_error((conditions, repeats), HIDDEN, root, simulator) if name == HIDDEN else 1.0
    truth = ((name, (float(size) * unit,)),) if size else ()
    source = Campaign(seed, (conditions, repeats), truth, root=root, simulator=simulator)
    return knowing(source, *(EFFECTS[name] for name in CONSIDERED)), truth


def draw_case(case: Case, options: argparse.Namespace, seed: int) -> Row:
    """The diagnosis of one draw."""
    source, truth = campaign(case, options, seed)
    began = time.process_time()
    document = diagnose(source, source.model)
    seconds = time.process_time() - began
    effect = document.effect(HIDDEN)
    has_estimate = effect is not None and case.inputs[1].startswith(HIDDEN) and "a" in effect.parameters
    low, high = effect.parameters["a"].interval if has_estimate and effect is not None else (0.0, 0.0)
    return {
        "named": document.named,
        "verdict": str(document.verdict),
        "covered": low <= truth[0][1][0] <= high if has_estimate else None,
        "probabilities": stated_probabilities(document),
        "seconds": seconds,
    }


def run(case: Case, work: Work) -> Row:
    """All draws of a cell."""
    return {"hidden": case.inputs[1], "draws": map_draws(draw_case, case, work.options, work.map_tasks)}


def outcome(hidden: str, draw: Row) -> tuple[bool, ...]:
    """Whether it is strictly right, names more than is hidden, other than is hidden, or nothing; whether it is seen."""
    truth = {HIDDEN} if hidden.startswith(HIDDEN) else set()
    named, something_missing = set(draw["named"]), draw["verdict"] != str(NOTHING)
    with_others = bool(truth) and truth < named
    wrong_name = bool(named) and not (truth and truth <= named)
    return (
        named == truth and something_missing == (hidden != "nothing"),
        with_others,
        wrong_name,
        not named,
        something_missing,
    )


def with_error(values: list[bool]) -> str:
    """Share of true ones with its standard error [%]; of none or all, that of one in twice as many."""
    if not values:
        return "–"
    count, share = len(values), float(np.mean(values))
    clipped = min(max(share, 0.5 / count), 1.0 - 0.5 / count)
    return f"{100.0 * share:.0f} ± {100.0 * float(np.sqrt(clipped * (1.0 - clipped) / count)):.0f}"


def table(rows: list[Row], options: argparse.Namespace) -> Table:
    """A row for each cell, then one for each bin of probability."""
    del options
    head = (
        "design, simulator, hidden", "draws", "strictly right [%]", "beside others [%]", "wrong name [%]",
        "no name [%]", "not `NOTHING-MISSING` [%]", "interval covers [%]", "processor time, mean [s]",
    )  # fmt: skip
    lines = []
    for row in rows:
        draws, hidden = row["draws"], row["hidden"]
        outcomes = np.array([outcome(hidden, draw) for draw in draws])
        covered = [bool(draw["covered"]) for draw in draws if draw["covered"] is not None]
        lines.append(
            (
                row["name"],
                str(len(draws)),
                *(with_error(list(column)) for column in outcomes.T),
                with_error(covered),
                f"{np.mean([draw['seconds'] for draw in draws]):.1f}",
            )
        )
    stated = [
        (probability, name == HIDDEN and row["hidden"].startswith(HIDDEN))
        for row in rows
        for draw in row["draws"]
        for name, probability in draw["probabilities"].items()
    ]
    for words, right in by_probability(stated):
        lines.append((words, str(len(right)), with_error(right), *("–",) * (len(head) - 3)))
    return Table(head, tuple(lines))
