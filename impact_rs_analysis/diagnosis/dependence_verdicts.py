# SPDX-License-Identifier: Apache-2.0
"""Verdicts on dependences on covariates, and on confounded covariates.

A covariate may be confounded with another, or with the impact speed: what was cold was also measured first. The measure
is the largest canonical correlation (Hotelling 1936, *Relations between two sets of variates*, Biometrika 28), with an
indicator variable for every level: 1 if one follows from the other.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from impact_rs_analysis.diagnosis.dependence import Dependences, forms_of, terms_of
from impact_rs_analysis.diagnosis.document import (
    CovariateDocument,
    DependenceDocument,
    DiagnosisDocument,
    EstimateDocument,
)
from impact_rs_analysis.diagnosis.search.fit import Fit
from impact_rs_analysis.diagnosis.search.intervals import intervals_of
from impact_rs_analysis.diagnosis.search.relevance import exceeds_relevance_limit
from impact_rs_analysis.diagnosis.thresholds import MIN_CANONICAL_CORRELATION, SIGNIFICANCE_LEVEL
from impact_rs_analysis.diagnosis.verdict import CONFIRMED, NO_IMPROVEMENT, SMALL, DiagnosisVerdict, Kind
from impact_rs_analysis.diagnosis.verdicts.model_verdict import reported_p
from impact_rs_analysis.diagnosis.verdicts.residuals import residual_size
from impact_rs_analysis.evidence.source import Covariate, Source
from impact_rs_sim.effects.depending import Depending, Knots, Levels, Slope, Terms
from impact_rs_sim.robots.robot import Array


def covariate_documents(source: Source) -> tuple[CovariateDocument, ...]:
    """Covariates of a source, each with the variables that it is confounded with."""
    found, terms = [], terms_of(source.with_dependences(())) if source.covariates else {}
    for item in source.covariates:
        others = [other for other in (*source.covariates, *source.state) if other.name != item.name]
        correlations = {other.name: correlation_of(item, other) for other in others}
        numbers = [float(value) for value in _every(item)] if item.numeric else []
        found.append(
            CovariateDocument(
                name=item.name,
                unit=item.unit,
                levels=() if item.numeric else tuple(sorted({str(value) for value in _every(item)})),
                mean=float(np.mean(numbers)) if numbers else None,
                range=(min(numbers), max(numbers)) if numbers else None,
                tried=bool(terms[item.name]),
                ways=_ways(terms[item.name]),
                why_not="" if terms[item.name] else _why_not(item, source),
                goes_with={name: value for name, value in correlations.items() if value > MIN_CANONICAL_CORRELATION},
            )
        )
    return tuple(found)


def _ways(terms: Sequence[Terms]) -> tuple[str, ...]:
    """Forms of dependence that are tried for a covariate, in words."""
    found = ["a value for each level"] if any(isinstance(one, Levels) for one in terms) else []
    found += ["a straight line"] if any(isinstance(one, Slope) for one in terms) else []
    knots = [str(len(one.knots)) for one in terms if isinstance(one, Knots)]
    return (*found, f"curves of {', '.join(knots)} values") if knots else tuple(found)


def _why_not(item: Covariate, source: Source) -> str:
    """Why the conditions do not allow a test of a covariate; empty: it varies too little.

    A condition is held out as a whole: a level of a single condition has no training rows.
    """
    units: dict[float | str, set[str]] = {}
    for cluster, values in zip(source.clusters, item.values, strict=True):
        for value in values:
            units.setdefault(value, set()).add(cluster.unit)
    if not source.repeated or len(units) < 2 or sum(len(own) > 1 for own in units.values()) > 1:
        return ""
    return (
        f"each level of {item.name} was measured in one condition only, and conditions are held out as a whole: "
        f"measure a condition at several levels of {item.name}, or leave out column 'condition'"
    )


def correlation_of(first: Covariate, second: Covariate) -> float:
    """Largest canonical correlation of two covariates over the rows [-]; 0 if one is constant."""
    bases = []
    for item in (first, second):
        columns = _columns(item)
        left, sizes, _ = np.linalg.svd(columns - columns.mean(axis=0), full_matrices=False)
        bases.append(left[:, sizes > 1e-9 * max(float(np.linalg.norm(columns)), 1e-300)])
    if not all(basis.shape[1] for basis in bases):
        return 0.0
    return float(min(np.linalg.svd(bases[0].T @ bases[1], compute_uv=False)[0], 1.0))


def _every(item: Covariate) -> list[float | str]:
    """Values of all rows."""
    return [value for rows in item.values for value in rows]


def _columns(item: Covariate) -> Array:
    """Design matrix of a covariate: its numbers, or an indicator of every level, ``(rows, k)``."""
    values = _every(item)
    if item.numeric:
        return np.array(values, dtype=float)[:, None]
    return np.array([[float(value == name) for name in dict.fromkeys(values)] for value in values])


def dependence_documents(found: Dependences) -> tuple[DependenceDocument, ...]:
    """Verdicts on all pairs of an effect and a covariate, accepted ones first."""
    accepted = [_accepted(found, pair) for pair in found.pairs]
    others = [_refused(found, pair) for pair in found.tried if pair not in found.pairs]
    likely = sorted(others, key=lambda one: (not one.rivals, 1.0 if one.p_value is None else one.p_value))
    best = {(one.effect, one.covariate): one for one in reversed([*accepted, *likely])}  # of ways to depend on it
    return (*accepted, *(one for one in others if best[one.effect, one.covariate] is one))


def _accepted(found: Dependences, pair: Depending) -> DependenceDocument:
    fitted, rivals = found.fit, found.choice.rivals[pair.name]
    assert fitted is not None
    estimates = dict(_estimates(fitted, pair))
    verdict, reason = CONFIRMED, "predicts unseen data better than one value for all"
    if not _is_relevant(fitted, pair):
        verdict, reason = SMALL, "its changes of all signals are below the relevance limits"
    elif rivals:
        verdict, reason = DiagnosisVerdict(Kind.CONFUSABLE, rivals), "these predict unseen data as well in its place"
    per_unit: dict[str, EstimateDocument] = {}
    if isinstance(pair.terms, Slope):
        unit = next(item.unit for item in found.source.covariates if item.name == pair.covariate)
        per_unit = {
            name: _scaled(own, 1.0 / pair.terms.spread, unit or pair.covariate)
            for name, own in estimates[pair.terms.labels[1]].items()
        }
    return DependenceDocument(
        effect=pair.effect.name,
        covariate=pair.covariate,
        verdict=verdict,
        reason=reason,
        p_value=reported_p(found.choice.p_values[pair.name]),
        rivals=rivals,
        levels=estimates if isinstance(pair.terms, Levels) else {},
        curve=estimates if isinstance(pair.terms, Knots) else {},
        at_mean=estimates[pair.terms.labels[0]] if isinstance(pair.terms, Slope) else {},
        per_unit=per_unit,
        chosen_in_folds=sum(bool(forms_of(pair, found.tried) & set(names)) for names in found.folds),
        folds=len(found.folds),
        held_out_error_before=residual_size(fitted.evidence, found.before),
        held_out_error_after=residual_size(fitted.evidence, found.after),
    )


def _refused(found: Dependences, pair: Depending) -> DependenceDocument:
    p: float | None = reported_p(found.choice.p_values.get(pair.name, 1.0))
    significant = p is not None and p < SIGNIFICANCE_LEVEL
    verdict, reason = NO_IMPROVEMENT, "significant, but it hardly lowers the held-out error" if significant else ""
    if better := [one.covariate for one in found.pairs if one.effect.name == pair.effect.name]:
        p, reason = None, f"not tried beside {better[0]}, which predicts better"
    if pair in found.choice.pairs:
        reason = "another effect explains it" if pair.name in found.replaced else "the hold-out does not support it"
    rivals = tuple(one.name for one in found.pairs if pair.name in found.choice.rivals[one.name])
    if rivals:
        verdict, reason = DiagnosisVerdict(Kind.CONFUSABLE, rivals), "predicts unseen data as well in its place"
    return DependenceDocument(
        effect=pair.effect.name,
        covariate=pair.covariate,
        verdict=verdict,
        reason=reason,
        rivals=rivals,
        p_value=p,
    )


def with_estimates_of(
    pooled: DiagnosisDocument, document: DiagnosisDocument, pairs: Sequence[Depending]
) -> DiagnosisDocument:
    """A diagnosis in which effects that depend on a covariate have their pooled estimates.

    Args:
        pooled: Diagnosis with one value for all circumstances, whose estimates are taken.
        document: Diagnosis with the pairs in place of their effects.
        pairs: Effects that depend on a covariate.
    """
    depending = {pair.shown_name for pair in pairs}
    one = {effect.name: effect.parameters for effect in pooled.effects if effect.name in depending}
    effects = tuple(
        effect.model_copy(update={"parameters": one.get(effect.name, effect.parameters)}) for effect in document.effects
    )
    return document.model_copy(update={"effects": effects})


def _estimates(fitted: Fit, pair: Depending) -> Iterator[tuple[str, dict[str, EstimateDocument]]]:
    """Estimates by term and parameter."""
    candidate = fitted.candidate
    [(low, high)] = intervals_of([(fitted, range(candidate.point.size))])
    part, own = candidate.part(pair.name), pair.effect.scalars(fitted.evidence.source.joints)
    index = part.start
    for label in pair.terms.labels:
        found = {}
        for scalar in (scalar for scalar in own if not scalar.shape):
            value = float(fitted.estimate[index])
            found[scalar.name] = EstimateDocument(
                estimate=value,
                ci95=(min(float(low[index]), value), max(float(high[index]), value)),
                unit=scalar.unit,
                meaning=scalar.meaning,
                nominal=candidate.scalars[index].nominal,
                range=(float(candidate.lower[index]), float(candidate.upper[index])),
                at_bound=bool(fitted.held_at_bound[index]),
            )
            index += 1
        yield label, found


def _scaled(of: EstimateDocument, factor: float, unit: str) -> EstimateDocument:
    """An estimate per unit of a covariate."""
    low, high = of.interval
    numerator = "1" if of.unit == "-" else of.unit
    return EstimateDocument(
        estimate=factor * of.estimate,
        ci95=(factor * low, factor * high),
        unit=f"{numerator}/{unit}",
        meaning=f"change of the {of.meaning}" if of.meaning else "",
        nominal=0.0,
    )


def _is_relevant(fitted: Fit, pair: Depending) -> bool:
    """Whether a dependence changes a feature by more than its relevance limit, against the mean over its terms."""
    candidate, joints = fitted.candidate, fitted.evidence.source.joints
    part, scalars = candidate.part(pair.name), pair.effect.scalars(joints)
    shapes = np.array([scalar.shape for scalar in scalars], dtype=bool)
    own = fitted.estimate[part]
    ends = len(pair.terms.labels) * int((~shapes).sum())
    terms = own[:ends].reshape(len(pair.terms.labels), -1)
    values = np.empty(shapes.size)
    values[~shapes] = terms[0] if any(pair.terms.changes) else terms.mean(axis=0)
    values[shapes] = own[ends:]
    return exceeds_relevance_limit(fitted, part, (own - pair.at(values, joints)) / candidate.scale[part])
