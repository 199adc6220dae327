# SPDX-License-Identifier: Apache-2.0
"""Diagnosis of any source of evidence: search for missing effects, cross-validation, verdicts."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from impact_rs_analysis.diagnosis.dependence import Dependences, dependences_of
from impact_rs_analysis.diagnosis.dependence_verdicts import (
    covariate_documents,
    dependence_documents,
    with_estimates_of,
)
from impact_rs_analysis.diagnosis.document import (
    BudgetDocument,
    CorrelatedPair,
    DesignDocument,
    DiagnosisDocument,
    HoldOutDocument,
    Identifiability,
    JointError,
    LimitDocument,
    ModelIdentity,
    ProportionDocument,
    RunsIdentity,
    UnexplainedDocument,
    ViewDocument,
    tied_with_best,
)
from impact_rs_analysis.diagnosis.drift import drift_in_words, drift_of, low_confidence_sentence
from impact_rs_analysis.diagnosis.search.bounds import NO_BOUNDS, Bounds, check_bounds, with_bounds
from impact_rs_analysis.diagnosis.search.budget import SEARCH_TIME_SHARE, UNLIMITED, Budget
from impact_rs_analysis.diagnosis.search.effect_selection import NO_OPTIMA, ProgressCallback, Search
from impact_rs_analysis.diagnosis.search.fit import Evidence, Fit
from impact_rs_analysis.diagnosis.search.hold_out import HoldOut, hold_out, holds_out_units
from impact_rs_analysis.diagnosis.search.model_comparison import Rival
from impact_rs_analysis.diagnosis.thresholds import (
    MIN_CLUSTERS,
    MIN_REPORTED_CORRELATION,
    MIN_REPORTED_P,
    SIGNIFICANCE_LEVEL,
)
from impact_rs_analysis.diagnosis.verdict import IMPOSSIBLE, TOO_FEW
from impact_rs_analysis.diagnosis.verdicts.effect_verdicts import effect_documents
from impact_rs_analysis.diagnosis.verdicts.held_out_rollouts import held_out_rollouts
from impact_rs_analysis.diagnosis.verdicts.measurement import experiments_of, measurement_of, with_readings
from impact_rs_analysis.diagnosis.verdicts.model_verdict import (
    Findings,
    change_interval,
    headline,
    lowers_held_out_error,
    supported_by_hold_out,
    unsupported_words,
    within_discrepancy,
    without_uncertain_effects,
)
from impact_rs_analysis.diagnosis.verdicts.next_experiment import next_experiment
from impact_rs_analysis.diagnosis.verdicts.required import with_likelier_model, with_required
from impact_rs_analysis.diagnosis.verdicts.residuals import (
    MAX_RESIDUALS,
    noise_size,
    residual_unit,
    residuals_by_signal,
)
from impact_rs_analysis.diagnosis.verdicts.words import not_tried, summary_of
from impact_rs_analysis.evidence.cluster import Added
from impact_rs_analysis.evidence.source import Source, View
from impact_rs_analysis.evidence.visited import extrapolations
from impact_rs_analysis.measure.arms import arms_of, assumptions
from impact_rs_sim.effects import Effect
from impact_rs_sim.errors import InputError, did_you_mean
from impact_rs_sim.model import Model
from impact_rs_sim.progress import HOLD_OUT, SEARCH
from impact_rs_sim.robots.robot import Array


def diagnose(
    source: Source,
    model: Model | None = None,
    only: Sequence[str] | None = None,
    progress: ProgressCallback = lambda *_: None,
    bounds: Bounds = NO_BOUNDS,
    earlier: Model | None = None,
    budget: Budget = UNLIMITED,
) -> DiagnosisDocument:
    """Find the effects that a model lacks.

    Args:
        source: Measurements with the model's predictions.
        model: The model of the file, if the model of the source has further user-defined effects; None: the declared
            model of the source.
        only: Names of the effects to consider; None: all that the model does not contain, for trials and tables without
            effects that recordings calibrate.
        progress: Called with effects and their leave-one-out error during the search (:class:`Search`).
        bounds: Ranges of parameters by the user.
        earlier: A model with effects that this one may lack; its estimates are further starts of fits.
        budget: Processor time of the diagnosis; the document lists the steps that were not tried.

    Raises:
        InputError: Too few conditions for a hold-out, or bounds of a parameter that does not exist.
    """
    check_bounds(bounds, source.known_effects)
    model = source.declared_model if model is None else model
    source = with_likelier_model(source, effects_for(source, only, bounds), budget.part(SEARCH_TIME_SHARE))
    all_rows, source = source, source.searched()
    effects = effects_for(source, only, bounds)
    known_estimates = () if earlier is None else _estimates_of(earlier, source)
    findings = findings_of(source, effects, progress, known_estimates, budget)
    present = [effect.name for effect in source.model.effects]
    present_effects = [
        with_bounds(source.known_effects[name].in_proportion(source.proportion), bounds) for name in present
    ]
    covariates = [item.name for item in source.covariates]
    no_time = bool(covariates) and budget.leaves_out(f"dependences on {' and '.join(covariates)}")
    dependences = None if no_time else dependences_of(findings, present_effects, progress)
    document = document_of(findings, source, model)
    if dependences is not None and dependences.pairs and not {p.effect.name for p in dependences.pairs} & set(present):
        # To the first search, variation with a covariate was scatter, which hides effects or imitates them.
        second_findings = findings_of(dependences.source, dependences.in_place_of(effects), progress, budget=budget)
        if dependences.confirmed_by(findings, second_findings) and second_findings.chosen is not None:
            dependences, pairs = dependences.selected_by(second_findings.chosen), dependences.pairs
            document = with_estimates_of(document, document_of(second_findings, dependences.source, model), pairs)
    views = [
        _whole_view(view, model, effects_for(view.source, only, bounds), dependences, budget)
        for view in (() if document.verdict in (TOO_FEW, IMPOSSIBLE) else source.views())
    ]
    documents = () if dependences is None else dependence_documents(dependences)
    update = {"covariates": covariate_documents(source), "dependences": documents, "views": tuple(filter(None, views))}
    document = _over_ranges(document.model_copy(update=update))
    unseen = all_rows.unseen(source, added_of(document, source))
    limit = None if math.isinf(budget.limit) else budget.limit
    left_out = tuple(budget.left_out)
    spent = BudgetDocument(limit=limit, left_out=left_out, stopped=bool(left_out) and budget.stop())
    remarks = (*filter(None, [not_tried(spent)]), *document.remarks, *unseen)
    rollouts = held_out_rollouts(source, findings.hold_out)
    document = document.model_copy(
        update={"runs": _runs(all_rows), "budget": spent, "remarks": remarks, "rollouts": rollouts}
    )
    document = with_required(document, source)
    disagree = "" if rollouts is None else rollouts.disagreement(document.held_out_change_ci95)
    summary = " ".join(filter(None, [summary_of(document), disagree, low_confidence_sentence(document.drift)]))
    sentences = {"measurement": measurement_of(document), "calibrate": experiments_of(document), "summary": summary}
    return document.model_copy(update=sentences)


def added_of(document: DiagnosisDocument, source: Source) -> Added:
    """The named effects with their estimates, as input of a source.

    Args:
        document: A diagnosis.
        source: The measurements. An effect that depends on a covariate has no single estimate and is left out.
    """
    added = []
    for name in document.named:
        effect = document.effect(name)
        values = {} if effect is None else effect.parameters
        scalars = source.known_effects[name].scalars(source.joints)
        if all(scalar.name in values for scalar in scalars):
            added.append((name, tuple(values[scalar.name].estimate for scalar in scalars)))
    return tuple(added)


def _whole_view(
    view: View, model: Model, effects: Sequence[Effect], dependences: Dependences | None, budget: Budget
) -> ViewDocument | None:
    """The verdict on a view; None if the processor time ended its search: an unfinished search may name others."""
    view_budget = Budget(budget.remaining, budget.clock, budget.stop)
    document = None if view_budget.spent else _view(view, model, effects, dependences, view_budget)
    if document is None or view_budget.left_out:
        budget.add(f"the verdict on {view.name}")
        return None
    return document


def _view(
    view: View, model: Model, effects: Sequence[Effect], dependences: Dependences | None, budget: Budget
) -> ViewDocument:
    """The verdict on a view of the measurements, with the dependences."""
    source, pairs = view.source, () if dependences is None else dependences.pairs
    if dependences is not None and pairs:
        source, effects = source.with_dependences(pairs), dependences.in_place_of(effects)
    findings = findings_of(source, effects, budget=budget)
    document = document_of(findings, source, model)
    return ViewDocument(
        name=view.name,
        option=view.option,
        verdict=document.verdict,
        named=document.named,
        held_out_error_before=document.held_out_error_before,
        held_out_error_after=document.held_out_error_after,
        of=view.of,
        value=view.value if view.of else None,
        unit=view.unit,
        parameters={effect.name: effect.parameters for effect in document.effects if effect.name in document.named},
    )


def _over_ranges(document: DiagnosisDocument) -> DiagnosisDocument:
    """The document with intervals widened over the allowed range of each uncertain quantity."""
    views = []
    for view in document.views:
        others = [other.held_out_error_after for other in document.views if other.of == view.of]
        best = min([document.held_out_error_after, *others])
        allowed = tied_with_best(view.held_out_error_after, best)
        views.append(view.model_copy(update={"allowed": allowed}) if view.of else view)
    effects = []
    for effect in document.effects:
        views_with_effect = [view for view in views if view.of and view.allowed and effect.name in view.parameters]
        parameters_in_views = [
            view.parameters[effect.name] for view in views_with_effect if effect.name in document.named
        ]
        widened = {}
        for name, value in effect.parameters.items():
            intervals = [
                value.interval,
                *(parameters[name].interval for parameters in parameters_in_views if name in parameters),
            ]
            span = (min(low for low, _ in intervals), max(high for _, high in intervals))
            widened[name] = value.model_copy(update={"ci95": span}) if parameters_in_views else value
        effects.append(effect.model_copy(update={"parameters": widened}))
    return document.model_copy(update={"effects": tuple(effects), "views": tuple(views)})


def effects_for(source: Source, only: Sequence[str] | None = None, bounds: Bounds = NO_BOUNDS) -> list[Effect]:
    """Effects to consider, with ranges in proportion to the robot.

    Args:
        source: Measurements with the model's predictions.
        only: Names of the effects; None: all that the source offers and the model does not contain.
        bounds: Ranges of parameters by the user.

    Raises:
        InputError: An unknown effect.
    """
    effects_by_name, present = source.model.known_effects, {item.name for item in source.model.effects}
    for name in only or ():
        if name not in effects_by_name:
            suggestion = did_you_mean(name, effects_by_name)
            raise InputError(f"no effect {name!r}{suggestion}; known effects: {', '.join(sorted(effects_by_name))}")
    offered = [name for name, effect in effects_by_name.items() if source.offers(effect)]
    return [
        with_bounds(effects_by_name[name].in_proportion(source.proportion), bounds)
        for name in only or offered
        if name not in present
    ]


def _estimates_of(model: Model, source: Source) -> Added:
    """Estimates of the effects of a model that a source knows."""
    effects, joints = source.known_effects, source.joints
    items = [(item, effects[item.name].scalars(joints)) for item in model.effects if item.name in effects]
    return tuple((item.name, tuple(item.vector(scalars).tolist())) for item, scalars in items)


def findings_of(
    source: Source,
    effects: Sequence[Effect],
    progress: ProgressCallback = lambda *_: None,
    earlier: Added = (),
    budget: Budget = UNLIMITED,
) -> Findings:
    """Search for missing effects, and cross-validate the search.

    Args:
        source: Measurements with the model's predictions.
        effects: Effects to consider.
        progress: Called with effects and their held-out error during the search (:class:`Search`).
        earlier: Estimates of an earlier model: further starts of fits.
        budget: Processor time, half of it for the hold-out; it lists the steps that were not tried.

    Raises:
        InputError: Too few conditions for a hold-out.
    """
    if source.repeated and len(source.clusters) < MIN_CLUSTERS:
        names = ", ".join(item.name for item in source.clusters)
        raise InputError(
            f"{len(source.clusters)} condition(s) measured ({names}): at least {MIN_CLUSTERS} are needed to hold one "
            "out; `impact-rs compare` still shows where the model fails"
        )
    search_budget = budget.part(SEARCH_TIME_SHARE)
    evidence = Evidence.of(source, budget=search_budget)
    if (p_value := evidence.lack_of_fit) is not None and p_value > SIGNIFICANCE_LEVEL:  # then usually nothing is found
        source.report(SEARCH)
        source.report(HOLD_OUT)
    search = Search(effects, evidence, progress, earlier=earlier)
    undecidable = search.evidence.null.shortage is not None or bool(source.impossible)
    chosen = None if undecidable else search.forward_selection()
    if chosen is None:
        source.report(HOLD_OUT)
    rivals: Sequence[Rival] = ()
    held_out, unsupported = None, ""
    suspected: tuple[str, ...] = ()
    if chosen is not None:
        chosen, rivals = search.exchange(chosen)
        if (certain_fit := without_uncertain_effects(search, chosen)) is not chosen:
            chosen, rivals = certain_fit, () if certain_fit is None else search.rivals(certain_fit)
    # Folds of motions start at the estimates of all data; impacts are cheap, and nonlinear in slip.
    fold_starts = search.optima if source.of_motion else NO_OPTIMA
    if (
        chosen is not None
        and (held_out := hold_out(source, effects, chosen.candidate, fold_starts, budget)) is not None
    ):
        supported = supported_by_hold_out(search, chosen, held_out)
        if supported is not chosen:
            supported_names = () if supported is None else supported.candidate.names
            dropped = tuple(name for name in chosen.candidate.names if name not in supported_names)
            unsupported = unsupported_words(search, dropped, held_out)
            suspected = dropped if lowers_held_out_error(search, held_out) and not held_out.failed else ()
            chosen, rivals = supported, () if supported is None else search.rivals(supported)
        if chosen is None:
            held_out = None
    chosen = None if chosen is None else search.finished(chosen)
    decided = chosen is not None or suspected or undecidable
    return Findings(
        search=search,
        chosen=chosen,
        rivals=tuple(rivals),
        hold_out=held_out,
        p_values=_p_values(search, chosen),
        suspected=suspected,
        within_discrepancy=() if decided else within_discrepancy(search),
        unsupported=unsupported,
    )


def _p_values(search: Search, chosen: Fit | None) -> dict[str, float]:
    """Unadjusted p-values: unchosen effects given the chosen ones, chosen effects given the other chosen ones."""
    chosen_names = () if chosen is None else chosen.candidate.names
    others = search.screening.raw_p_values(chosen)
    return others | {name: search.p_value_of_chosen(chosen, name) for name in chosen_names if chosen}


def document_of(findings: Findings, source: Source, model: Model) -> DiagnosisDocument:
    """The diagnosis as a document.

    Args:
        findings: Result of the search.
        source: The searched measurements.
        model: The model of the file; the model of the source may have further user-defined effects.
    """
    evidence, effects_by_name = findings.evidence, source.known_effects
    verdict, lack_of_fit = headline(findings)
    before = evidence.means
    after: Sequence[Array] = before if findings.hold_out is None else findings.hold_out.residuals
    effects = tuple(with_readings(effect_documents(findings, effects_by_name), effects_by_name))
    rivals = {effect.name: effect.rivals for effect in effects}
    drift = drift_of(source.clusters)
    remarks = [*filter(None, [drift_in_words(drift)]), *_remarks(findings, source)]
    return DiagnosisDocument(
        source=source.kind,
        verdict=verdict,
        impossible=source.impossible,
        named=findings.shown(findings.names),
        suspected=findings.shown(findings.suspected),
        within_discrepancy=findings.shown(findings.within_discrepancy),
        effects=effects,
        confusable=tuple((name, *rivals[name]) for name in findings.shown(findings.names) if rivals[name]),
        unexplained=UnexplainedDocument(
            share_of_excess=findings.remaining_share,
            where=tuple(residuals_by_signal(evidence, findings.unexplained)[:MAX_RESIDUALS]),
        ),
        next_experiment=next_experiment(findings, effects_by_name),
        model=ModelIdentity.of(model),
        runs=_runs(source),
        error_unit=residual_unit(evidence),
        noise_floor=noise_size(evidence),
        held_out_error_before=findings.held_out_sizes[0],
        held_out_error_after=findings.held_out_sizes[1],
        held_out_change_ci95=change_interval(before, after, evidence) if findings.hold_out is not None else None,
        hold_out=_hold_out(findings.hold_out, source),
        lack_of_fit=lack_of_fit,
        design=DesignDocument(
            clusters=len(evidence.clusters),
            freedom=evidence.null.freedom,
            least_p=MIN_REPORTED_P,
            shortage=evidence.null.shortage,
        ),
        discrepancy=source.discrepancy_document,
        identifiability=_identifiability(findings.chosen),
        joints=_joints(source, before, after),
        recording=source.recording,
        drift=drift,
        proportion=ProportionDocument(**vars(source.proportion)),
        limits=_limits(source),
        remarks=tuple(remarks),
        formulas=source.model.formulas,
        arms=source.model.arms,
    )


def _limits(source: Source) -> tuple[LimitDocument, ...]:
    """Relevance limits of all signals, each once."""
    limits = {
        (feature.phase, feature.signal, feature.unit): LimitDocument(
            phase=feature.phase, signal=feature.signal, limit=feature.relevance_limit, unit=feature.unit
        )
        for item in source.clusters
        for feature in item.features
        if feature.relevance_limit > 0.0
    }
    return tuple(limits.values())


def _runs(source: Source) -> RunsIdentity:
    identity = source.identity
    return RunsIdentity(
        digest=identity.digest, trials=identity.count, conditions=identity.conditions, recorded=identity.recorded
    )


def _hold_out(result: HoldOut | None, source: Source) -> HoldOutDocument:
    if result is None:
        return HoldOutDocument(what="no hold-out, because no effect was found", folds=0)
    count = len(result.folds)
    if source.repeated:
        data = f"conditions with all their repeats, in {count} folds"
    elif holds_out_units(source):
        data = f"whole recordings, in {count} folds"
    else:
        one_each = not source.whole_units and len({item.unit for item in source.clusters}) > 1
        of_every = " in every recording, because a joint moves in one recording alone" if one_each else ""
        division = f"of neighbours{of_every}; every fold is predicted from the others without those that touch it"
        if source.interleaved:
            division = f"that take one of every {count} neighbours"
        data = f"{len(source.clusters)} {source.pieces} in {count} folds {division}"
    procedure = "the whole search is repeated without the held-out data"
    if fitted := count - sum(result.searched):
        procedure += f", in {fitted} folds the fit alone, because a search lacks conditions, repeats or time"
    return HoldOutDocument(what=f"{data}; {procedure}", folds=count, searched=sum(result.searched))


def _joints(source: Source, before: Sequence[Array], after: Sequence[Array]) -> tuple[JointError, ...]:
    return tuple(
        JointError(joint=joint, before=first, after=second, noise=noise, unit=unit)
        for (joint, first, noise, unit), (_, second, _, _) in zip(
            source.joint_sizes(before), source.joint_sizes(after), strict=True
        )
    )


def _remarks(findings: Findings, source: Source) -> list[str]:
    remarks = [*source.remarks, *extrapolations(source), *assumptions(arms_of(source.worlds))]
    null = findings.evidence.null
    if null.shortage is not None:
        remarks.append(f"too few data for a verdict: {null.shortage}")
    if source.repeated and source.of_motion and all(item.contact for item in source.clusters):
        remarks.append(
            "no free motion there and back was measured: a push alone cannot distinguish friction, torque offset and "
            "torque gain"
        )
    together = max((tuple(world.arms) for world in source.worlds), key=len, default=())
    if not source.model.arms and len(together) > 1:
        remarks.append(
            f"arms {', '.join(together)} are of one kind and share the parameters of every effect; --each-arm gives "
            "each arm its own"
        )
    if findings.unsupported:
        remarks.append(findings.unsupported)
    if findings.search.screening.not_simulated:
        names = ", ".join(sorted(findings.shown(findings.search.screening.not_simulated)))
        remarks.append(f"these cannot be simulated near nominal, so they were not tried: {names}")
    if findings.search.screening.ruled_out:
        names = ", ".join(sorted(findings.shown(findings.search.screening.ruled_out)))
        remarks.append(f"free motion shows no sign of these, so they were not fitted in contact: {names}")
    return remarks


def _identifiability(chosen: Fit | None) -> Identifiability:
    if chosen is None:
        return Identifiability()
    singular = np.linalg.svd(np.vstack(chosen.candidate.jacobians), compute_uv=False)
    inverse = np.linalg.inv(chosen.problem.total)
    covariance = chosen.evidence.null.covariance(chosen.candidate.jacobians, chosen.residuals, inverse)
    spread = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    correlation = covariance / np.outer(spread, spread)
    names = [scalar.name for scalar in chosen.candidate.scalars]
    return Identifiability(
        singular_values=tuple(singular.tolist()),
        condition_number=float(singular[0] / max(singular[-1], 1e-12)),
        correlated=tuple(
            CorrelatedPair(first=names[i], second=names[j], correlation=float(correlation[i, j]))
            for i in range(len(names))
            for j in range(i)
            if abs(correlation[i, j]) > MIN_REPORTED_CORRELATION
        ),
    )
