# SPDX-License-Identifier: Apache-2.0
"""Verdicts on dependences on covariates, and on confounded covariates.

A covariate may be confounded with another or with the impact speed, as temperature with time if cold runs came first.
The measure is the largest canonical correlation (Hotelling 1936, *Relations between two sets of variates*, Biometrika
28), with an indicator variable for every level; it is 1 if one covariate determines the other.
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
    """Covariates of a source, each with the variables with which it is confounded."""
    documents, terms = [], terms_of(source.with_dependences(())) if source.covariates else {}
    for item in source.covariates:
        others = [other for other in (*source.covariates, *source.state) if other.name != item.name]
        correlations = {other.name: correlation_of(item, other) for other in others}
        numbers = [float(value) for value in _all_values(item)] if item.numeric else []
        documents.append(
            CovariateDocument(
                name=item.name,
                unit=item.unit,
                levels=() if item.numeric else tuple(sorted({str(value) for value in _all_values(item)})),
                mean=float(np.mean(numbers)) if numbers else None,
                range=(min(numbers), max(numbers)) if numbers else None,
                tried=bool(terms[item.name]),
                ways=_forms_in_words(terms[item.name]),
                why_not="" if terms[item.name] else _why_not(item, source),
                goes_with={name: value for name, value in correlations.items() if value > MIN_CANONICAL_CORRELATION},
            )
        )
    return tuple(documents)


def _forms_in_words(terms: Sequence[Terms]) -> tuple[str, ...]:
    """Forms of dependence that are tried for a covariate, in words."""
    ways = ["a value for each level"] if any(isinstance(form, Levels) for form in terms) else []
    ways += ["a straight line"] if any(isinstance(form, Slope) for form in terms) else []
    knots = [str(len(form.knots)) for form in terms if isinstance(form, Knots)]
    return (*ways, f"curves of {', '.join(knots)} values") if knots else tuple(ways)


def _why_not(item: Covariate, source: Source) -> str:
    """Why the conditions do not allow a test of a covariate; empty: it varies too little.

    Conditions are held out as a whole, so a level of a single condition has no training rows.
    """
    units: dict[float | str, set[str]] = {}
    for cluster, values in zip(source.clusters, item.values, strict=True):
        for value in values:
            units.setdefault(value, set()).add(cluster.unit)
    if not source.repeated or len(units) < 2 or sum(len(conditions) > 1 for conditions in units.values()) > 1:
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
        directions, sizes, _ = np.linalg.svd(columns - columns.mean(axis=0), full_matrices=False)
        bases.append(directions[:, sizes > 1e-9 * max(float(np.linalg.norm(columns)), 1e-300)])
    if not all(basis.shape[1] for basis in bases):
        return 0.0
    return float(min(np.linalg.svd(bases[0].T @ bases[1], compute_uv=False)[0], 1.0))


def _all_values(item: Covariate) -> list[float | str]:
    """Values of all rows."""
    return [value for rows in item.values for value in rows]


def _columns(item: Covariate) -> Array:
    """Design matrix of a covariate: its numbers, or an indicator of every level, ``(rows, k)``."""
    values = _all_values(item)
    if item.numeric:
        return np.array(values, dtype=float)[:, None]
    return np.array([[float(value == name) for name in dict.fromkeys(values)] for value in values])


def dependence_documents(dependences: Dependences) -> tuple[DependenceDocument, ...]:
    """Verdicts on all pairs of an effect and a covariate, accepted ones first."""
    accepted = [_accepted(dependences, pair) for pair in dependences.pairs]
    others = [_refused(dependences, pair) for pair in dependences.tried if pair not in dependences.pairs]
    likely = sorted(
        others, key=lambda document: (not document.rivals, 1.0 if document.p_value is None else document.p_value)
    )
    best = {
        (document.effect, document.covariate): document for document in reversed([*accepted, *likely])
    }  # of ways to depend on it
    return (*accepted, *(document for document in others if best[document.effect, document.covariate] is document))


def _accepted(dependences: Dependences, pair: Depending) -> DependenceDocument:
    fitted, rivals = dependences.fit, dependences.choice.rivals[pair.name]
    assert fitted is not None
    estimates = dict(_estimates(fitted, pair))
    verdict, reason = CONFIRMED, "predicts unseen data better than one value for all"
    if not _is_relevant(fitted, pair):
        verdict, reason = SMALL, "its changes of all signals are below the relevance limits"
    elif rivals:
        verdict, reason = DiagnosisVerdict(Kind.CONFUSABLE, rivals), "these predict unseen data as well in its place"
    per_unit: dict[str, EstimateDocument] = {}
    if isinstance(pair.terms, Slope):
        unit = next(item.unit for item in dependences.source.covariates if item.name == pair.covariate)
        per_unit = {
            name: _scaled(estimate, 1.0 / pair.terms.spread, unit or pair.covariate)
            for name, estimate in estimates[pair.terms.labels[1]].items()
        }
    return DependenceDocument(
        effect=pair.effect.name,
        covariate=pair.covariate,
        verdict=verdict,
        reason=reason,
        p_value=reported_p(dependences.choice.p_values[pair.name]),
        rivals=rivals,
        levels=estimates if isinstance(pair.terms, Levels) else {},
        curve=estimates if isinstance(pair.terms, Knots) else {},
        at_mean=estimates[pair.terms.labels[0]] if isinstance(pair.terms, Slope) else {},
        per_unit=per_unit,
        chosen_in_folds=sum(bool(forms_of(pair, dependences.tried) & set(names)) for names in dependences.folds),
        folds=len(dependences.folds),
        held_out_error_before=residual_size(fitted.evidence, dependences.before),
        held_out_error_after=residual_size(fitted.evidence, dependences.after),
    )


def _refused(dependences: Dependences, pair: Depending) -> DependenceDocument:
    p_value: float | None = reported_p(dependences.choice.p_values.get(pair.name, 1.0))
    significant = p_value is not None and p_value < SIGNIFICANCE_LEVEL
    verdict, reason = NO_IMPROVEMENT, "significant, but it hardly lowers the held-out error" if significant else ""
    if better := [other.covariate for other in dependences.pairs if other.effect.name == pair.effect.name]:
        p_value, reason = None, f"not tried in addition to {better[0]}, which predicts better"
    if pair in dependences.choice.pairs:
        reason = (
            "another effect explains it" if pair.name in dependences.replaced else "the hold-out does not support it"
        )
    rivals = tuple(other.name for other in dependences.pairs if pair.name in dependences.choice.rivals[other.name])
    if rivals:
        verdict, reason = DiagnosisVerdict(Kind.CONFUSABLE, rivals), "predicts unseen data as well in its place"
    return DependenceDocument(
        effect=pair.effect.name,
        covariate=pair.covariate,
        verdict=verdict,
        reason=reason,
        rivals=rivals,
        p_value=p_value,
    )


def with_estimates_of(
    pooled: DiagnosisDocument, document: DiagnosisDocument, pairs: Sequence[Depending]
) -> DiagnosisDocument:
    """A diagnosis in which effects that depend on a covariate have their pooled estimates.

    Args:
        pooled: Diagnosis with one value for all circumstances; source of the estimates.
        document: Diagnosis with the pairs in place of their effects.
        pairs: Effects that depend on a covariate.
    """
    depending = {pair.shown_name for pair in pairs}
    pooled_parameters = {effect.name: effect.parameters for effect in pooled.effects if effect.name in depending}
    effects = tuple(
        effect.model_copy(update={"parameters": pooled_parameters.get(effect.name, effect.parameters)})
        for effect in document.effects
    )
    return document.model_copy(update={"effects": effects})


def _estimates(fitted: Fit, pair: Depending) -> Iterator[tuple[str, dict[str, EstimateDocument]]]:
    """Estimates by term and parameter."""
    candidate = fitted.candidate
    [(low, high)] = intervals_of([(fitted, range(candidate.point.size))])
    part, scalars = candidate.part(pair.name), pair.effect.scalars(fitted.evidence.source.joints)
    index = part.start
    for label in pair.terms.labels:
        estimates = {}
        for scalar in (scalar for scalar in scalars if not scalar.shape):
            value = float(fitted.estimate[index])
            estimates[scalar.name] = EstimateDocument(
                estimate=value,
                ci95=(min(float(low[index]), value), max(float(high[index]), value)),
                unit=scalar.unit,
                meaning=scalar.meaning,
                nominal=candidate.scalars[index].nominal,
                range=(float(candidate.lower[index]), float(candidate.upper[index])),
                at_bound=bool(fitted.pushed_to_bound[index]),
            )
            index += 1
        yield label, estimates


def _scaled(estimate: EstimateDocument, factor: float, unit: str) -> EstimateDocument:
    """An estimate per unit of a covariate."""
    low, high = estimate.interval
    numerator = "1" if estimate.unit == "-" else estimate.unit
    return EstimateDocument(
        estimate=factor * estimate.estimate,
        ci95=(factor * low, factor * high),
        unit=f"{numerator}/{f'({unit})' if '/' in unit else unit}",
        meaning=f"change of the {estimate.meaning}" if estimate.meaning else "",
        nominal=0.0,
    )


def _is_relevant(fitted: Fit, pair: Depending) -> bool:
    """Whether a dependence changes a feature by more than its relevance limit, against the mean over its terms."""
    candidate, joints = fitted.candidate, fitted.evidence.source.joints
    part, scalars = candidate.part(pair.name), pair.effect.scalars(joints)
    shapes = np.array([scalar.shape for scalar in scalars], dtype=bool)
    values_of_part = fitted.estimate[part]
    ends = len(pair.terms.labels) * int((~shapes).sum())
    terms = values_of_part[:ends].reshape(len(pair.terms.labels), -1)
    values = np.empty(shapes.size)
    values[~shapes] = terms[0] if any(pair.terms.changes) else terms.mean(axis=0)
    values[shapes] = values_of_part[ends:]
    return exceeds_relevance_limit(fitted, part, (values_of_part - pair.at(values, joints)) / candidate.scale[part])
