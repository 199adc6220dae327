# SPDX-License-Identifier: Apache-2.0
"""Discovery of a law (symbolic regression over a grammar), where no effect of the library explains the measurements.

A law is an effect made of a formula. So a discovery is a diagnosis with the laws of the grammar
(:mod:`impact_rs_analysis.diagnosis.laws.grammar`) in addition to the library. It runs only if the library leaves
residuals beyond noise, with the laws that act where free motion or contact has a residual. A law that sets in outside
the range of free motion, such as a stop or a slack cable, is tried if contact has a residual. In a table of impacts
laws are coefficients of a single contact over closing and sliding speed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from impact_rs_analysis.diagnosis.diagnose import document_of, effects_for, findings_of
from impact_rs_analysis.diagnosis.document import DiagnosisDocument
from impact_rs_analysis.diagnosis.laws.discovery_document import (
    DESCRIBED,
    FOUND,
    LIBRARY,
    NO_LAW,
    CurveDocument,
    DiscoveryDocument,
    DomainDocument,
    LawDocument,
    NumberDocument,
    PointDocument,
)
from impact_rs_analysis.diagnosis.laws.grammar import FREE_CURVE_KNOTS, MIN_SPAN_SHARE, Grammar, Law, curve_of, laws_of
from impact_rs_analysis.diagnosis.search.candidate import Candidate, linearise
from impact_rs_analysis.diagnosis.search.effect_selection import ProgressCallback, Search
from impact_rs_analysis.diagnosis.search.fit import Evidence, Fit, chord_method
from impact_rs_analysis.diagnosis.search.model_comparison import Rival, j_test_p_value
from impact_rs_analysis.diagnosis.thresholds import (
    MAX_ERROR_RATIO,
    MIN_GAIN_SHARE,
    MIN_RESIDUAL_RATIO_OF_LAW,
    MIN_SHARE_OF_LARGEST_RESIDUAL,
    SIGNIFICANCE_LEVEL,
)
from impact_rs_analysis.diagnosis.verdict import IMPOSSIBLE, NOTHING, SMALL, TOO_FEW
from impact_rs_analysis.diagnosis.verdicts.model_verdict import Findings, headline
from impact_rs_analysis.diagnosis.verdicts.residuals import residual_unit, residuals_by_signal
from impact_rs_analysis.evidence.source import Source
from impact_rs_analysis.evidence.visited import Range, measured_ranges
from impact_rs_sim.effects import Effect
from impact_rs_sim.impact_map.contact_laws import laws_of as laws_at
from impact_rs_sim.model import Model
from impact_rs_sim.physics import Physics
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.rotations import AXES

LAW_POINTS = 41  # of a law, over the range of its quantity
MIN_LAW_DIFFERENCE = 0.3  # of two distinguishable laws, over the largest force in the range
MAX_EXTRAPOLATION = 3.0  # times the end of the range, in the search for such a difference
MAX_RIVAL_LAWS = 8  # fitted in place of a law
MAX_OTHER_LAWS = 8  # listed without being proposed


def discover(
    source_of: Callable[[Model], Source],
    model: Model,
    grammar: Grammar,
    only: Sequence[str] | None = None,
    progress: ProgressCallback = lambda *_: None,
) -> DiscoveryDocument:
    """Search for a law that a model lacks.

    Args:
        source_of: Source of the measurements for a model.
        model: The model.
        grammar: Grammar of the laws.
        only: Names of library effects to consider as well; None: all that the model does not contain.
        progress: Called with laws and their leave-one-out error during the search.

    Raises:
        InputError: Too few conditions for a hold-out.
    """
    source = source_of(model)
    library = effects_for(source, only)
    library_findings = _library_search(source, library, progress)
    verdict = _settled(library_findings)
    if verdict is not None:
        return DiscoveryDocument(
            verdict=verdict, summary=_reason_without_search(verdict), error_unit=residual_unit(Evidence.of(source))
        )
    ranges = measured_ranges(source)
    joints = min((len(kinds) for world in source.worlds for _, kinds in world.arm_joints), default=0)
    of_impacts = bool(source.contact_speeds)
    laws = {law.spec.name: law for law in laws_of(grammar, ranges, joints) if bool(law.coefficient) == of_impacts}
    names = set(_acting_laws(library_findings, laws.values()))
    laws = {name: law for name, law in laws.items() if name in names and name not in model.known_effects}
    domains = measured_ranges(
        source, {law.symbol for law in laws.values() if not law.quantity.of_place and not law.quantity.shapes}
    )
    laws = {name: law for name, law in laws.items() if not law.coefficient or _varies(law, domains)}
    searched = _searched(source_of, model, library, laws, progress)
    document = _document(searched, model, laws, domains)
    if document.verdict == LIBRARY:
        return document
    if document.verdict == NO_LAW or _settled(searched.findings) is None:
        curves = {curve.spec.name: curve for curve in _curves(laws.values(), ranges, source, library)}

        def search_among(among: Mapping[str, Law]) -> DiscoveryDocument:
            return _document(_searched(source_of, model, library, among, progress), model, among, ranges)

        described = _described(search_among, curves, laws, document)
        if described is not None:
            return described
    return _with_curve(source_of, model, searched, laws, domains, document) if document.verdict == FOUND else document


def _described(
    search: Callable[[Mapping[str, Law]], DiscoveryDocument],
    curves: Mapping[str, Law],
    laws: Mapping[str, Law],
    document: DiscoveryDocument,
) -> DiscoveryDocument | None:
    """The discovery with free curves in place of laws; None if they predict no better.

    Args:
        search: Search among some laws.
        curves: Free curves.
        laws: Searched laws.
        document: The discovery among the searched laws.
    """
    curve_keys = {(curve.place, curve.where, curve.symbol) for curve in curves.values()}  # such a curve contains a law
    chosen_laws = [laws[law.name] for law in document.laws]
    kept_laws = {law.spec.name: law for law in chosen_laws if (law.place, law.where, law.symbol) not in curve_keys}
    described = search({**kept_laws, **curves})
    if described.verdict != DESCRIBED or not _predicts_better(described, document):
        return None
    best = described.laws[0]
    return _with_first(described, _as_curve(curves[best.name], best)) if best.name in curves else described


def _varies(law: Law, domains: Mapping[str, Range]) -> bool:
    """Whether the quantity of a law varies in the measurements; else the law is a constant of the library."""
    low, high = domains.get(law.symbol, (0.0, 0.0))
    return high - low > MIN_SPAN_SHARE * law.quantity.typical


def _predicts_better(curves: DiscoveryDocument, laws: DiscoveryDocument) -> bool:
    """Whether curves have a clearly lower held-out error than laws, which have fewer parameters."""
    assert curves.diagnosis is not None and laws.diagnosis is not None
    after, before = curves.diagnosis.held_out_error_after, laws.diagnosis.held_out_error_after
    return after**2 <= (1.0 - MIN_GAIN_SHARE) * before**2


@dataclass(frozen=True)
class _LawSearch:
    """A search with laws.

    Attributes:
        source: The searched measurements.
        findings: Result of the search.
        counts: Number of laws and effects, and number of starts.
    """

    source: Source
    findings: Findings
    counts: tuple[int, int]


def _searched(
    source_of: Callable[[Model], Source],
    model: Model,
    library: Sequence[Effect],
    laws: Mapping[str, Law],
    progress: ProgressCallback,
) -> _LawSearch:
    """Search for laws and library effects together."""
    source = source_of(model.model_copy(update={"formulas": (*model.formulas, *(law.spec for law in laws.values()))}))
    starts = [effect for law in laws.values() for effect in law.effects]
    findings = findings_of(source, [*library, *starts], progress)
    findings = replace(findings, rivals=_rivals(findings))
    return _LawSearch(source, findings, (len(library) + len(laws), len(library) + len(starts)))


def _with_curve(
    source_of: Callable[[Model], Source],
    model: Model,
    searched: _LawSearch,
    laws: Mapping[str, Law],
    ranges: Mapping[str, Range],
    document: DiscoveryDocument,
) -> DiscoveryDocument:
    """The discovery with a free curve fitted in place of its best law, together with all other chosen effects."""
    best, chosen = laws[document.laws[0].name], searched.findings.chosen
    if best.symbol not in ranges or chosen is None or best.spec.name not in chosen.candidate.names:
        return document
    curve = curve_of(best, ranges[best.symbol])
    others = [(effect, part) for effect, part in chosen.candidate.parts if effect.name != best.spec.name]
    other_laws = [laws[effect.name] for effect, _ in others if effect.name in laws]
    if any((law.place, law.where, law.symbol) == (best.place, best.where, best.symbol) for law in other_laws):
        return document  # a law and a curve over the same quantity are confounded
    specs = [laws[effect.name].spec for effect, _ in others if effect.name in laws]
    source = source_of(model.model_copy(update={"formulas": (*model.formulas, *specs, curve.spec)}))
    evidence, effect = Evidence.of(source), curve.effects[0]
    start, _ = _band(best, document.laws[0], np.array(curve.knots))
    start = np.clip(start, *effect.bounds(source.physics))
    point = np.concatenate([*(chosen.estimate[part] for _, part in others), start])
    candidate = Candidate.of((*(other for other, _ in others), effect), source, point)
    linearised = linearise(candidate, evidence.clusters, evidence.numbers, source)
    if linearised is None:
        return document
    fitted = chord_method(linearised, evidence)
    part = fitted.candidate.part(effect.name)
    forces, half = fitted.estimate[part], (fitted.half_widths * fitted.candidate.scale)[part]
    at = np.linspace(min(curve.knots), max(curve.knots), LAW_POINTS)
    values, band = _band(best, document.laws[0], at)
    points = []
    for knot, force, half_width in zip(curve.knots, forces.tolist(), half.tolist(), strict=True):
        if half_width <= float(np.max(np.abs(values))):  # at other knots the data do not even determine the sign
            law_force = float(np.interp(knot, at, values))
            points.append(
                PointDocument(at=knot, force=force, ci95=(force - half_width, force + half_width), law=law_force)
            )
    return _with_first(document, _drawn(at, values, band, points, best.unit))


def _as_curve(curve: Law, document: LawDocument) -> CurveDocument:
    """A discovered free curve, with its knots."""
    at = np.linspace(min(curve.knots), max(curve.knots), LAW_POINTS)
    values, band = _band(curve, document, at)
    points = [
        PointDocument(at=knot, force=value.estimate, ci95=value.ci95, law=value.estimate)
        for knot, value in zip(curve.knots, document.parameters.values(), strict=True)
        if value.ci95 is not None
    ]
    return _drawn(at, values, band, points, curve.unit)


def _drawn(at: Array, values: Array, band: Array, points: Sequence[PointDocument], unit: str) -> CurveDocument:
    return CurveDocument(
        at=tuple(at.tolist()),
        law=tuple(values.tolist()),
        law_ci95=tuple(zip((values - band).tolist(), (values + band).tolist(), strict=True)),
        points=tuple(points),
        unit=unit,
    )


def _with_first(document: DiscoveryDocument, curve: CurveDocument) -> DiscoveryDocument:
    """The document with the force of its first law."""
    law = document.laws[0].model_copy(update={"curve": curve})
    return document.model_copy(update={"laws": (law, *document.laws[1:])})


def _band(law: Law, document: LawDocument, at: Array) -> tuple[Array, Array]:
    """Force of a law and half width of its 95 % band, ``(k,)`` each: changes by interval ends in quadrature."""
    numbers = {name: value.estimate for name, value in document.parameters.items()}
    values, squares = law.signed_force(at, numbers), np.zeros_like(at)
    for name, value in document.parameters.items():
        if value.ci95 is not None:
            low, high = (law.force(at, {**numbers, name: end}) for end in value.ci95)
            squares += np.square((high - low) / 2.0)
    return values, np.sqrt(squares)


def _curves(
    laws: Iterable[Law], ranges: Mapping[str, Range], source: Source, library: Sequence[Effect]
) -> Iterator[Law]:
    """The free curves of some laws, by place and measured quantity.

    If the library has a constant offset of joints or of a contact coefficient, their curves contain no constant: the
    two would be confounded.
    """
    offset = _has_offset(source, library)
    distinct = {(law.place, law.where, law.symbol): law for law in laws if law.symbol in ranges}
    for law in distinct.values():
        for count in FREE_CURVE_KNOTS:
            absolute = not (offset and law.joints) and not _shifts(source, library, law.coefficient)
            yield curve_of(law, ranges[law.symbol], count, absolute)


def _has_offset(source: Source, library: Sequence[Effect]) -> bool:
    """Whether an effect of the library is a constant joint torque."""
    for effect in library:
        start = effect.nominal(source.joints)
        physics = effect.apply_vector(source.physics, start + effect.steps(source.joints, start))
        pairs = ((arm, source.physics.arms[name]) for name, arm in physics.arms.items())
        if any(not np.array_equal(arm.torque_offset, before.torque_offset) for arm, before in pairs):
            return True
    return False


def _shifts(source: Source, library: Sequence[Effect], coefficient: str) -> bool:
    """Whether an effect of the library changes a contact coefficient by a constant, at any closing speed."""
    if not coefficient:
        return False
    speeds = np.linspace(0.1, 1.0, LAW_POINTS)  # m/s; any range would do
    on_support = np.ones(LAW_POINTS, dtype=bool)

    def values(physics: Physics) -> Array:
        return np.asarray(getattr(laws_at(physics, speeds, speeds[::-1], on_support), coefficient))

    before = values(source.physics)
    for effect in library:
        start = effect.nominal(source.joints)
        change = values(effect.apply_vector(source.physics, start + effect.steps(source.joints, start))) - before
        if np.any(change) and np.ptp(change) <= 1e-9 * np.max(np.abs(change)):
            return True
    return False


def _rivals(findings: Findings) -> tuple[Rival, ...]:
    """More rivals of the chosen effects, tied if a chosen effect is not significant given its rival.

    Two laws that predict to within the noise are tied, whatever their errors.
    """
    if findings.chosen is None:
        return ()
    return tuple(
        replace(rival, tied=rival.tied or _adds_nothing(findings.chosen, rival))
        for rival in findings.search.rivals(
            findings.chosen, max(1, MAX_RIVAL_LAWS // len(findings.names)), max_score_ratio=np.inf
        )
    )


def _adds_nothing(chosen: Fit, rival: Rival) -> bool:
    """Whether the chosen effect is not significant given the rival in its place (J test)."""
    comparable = rival.fit.score <= max(MAX_ERROR_RATIO * chosen.score, float(rival.fit.evidence.expected.mean()))
    return comparable and j_test_p_value(chosen, rival.instead_of, rival.fit) > SIGNIFICANCE_LEVEL


def _library_search(source: Source, library: Sequence[Effect], progress: ProgressCallback) -> Findings:
    """Result of a search with effects of the library alone."""
    search = Search(library, Evidence.of(source), progress)
    decidable = search.evidence.null.shortage is None and search.has_lack_of_fit
    return Findings(search, search.forward_selection() if decidable else None, (), None, {})


def _settled(findings: Findings) -> str | None:
    """Verdict if effects of the library leave nothing to discover; else None."""
    (verdict, _), source = headline(findings), findings.evidence.source
    if verdict == IMPOSSIBLE:
        return str(verdict)
    if source.contact_speeds and source.noise_size() is None and verdict != TOO_FEW:
        return None  # unknown noise: the hold-out decides on laws
    if not source.contact_speeds and not source.repeated and verdict not in (TOO_FEW, NOTHING):
        largest = max(residual.times_noise for residual in residuals_by_signal(findings.evidence, findings.unexplained))
        return None if largest > MIN_RESIDUAL_RATIO_OF_LAW else LIBRARY
    if verdict.leaves_residuals:
        return None
    return str(verdict) if verdict in (TOO_FEW, NOTHING, SMALL) else LIBRARY


def _reason_without_search(verdict: str) -> str:
    """Why no search for laws was made."""
    return {
        str(NOTHING): "These measurements show nothing missing in the model: there is no law to discover.",
        str(SMALL): "Residuals beyond noise are below the relevance limits: no law is proposed.",
        str(TOO_FEW): "These measurements have too few repeats to decide what the model lacks.",
        str(IMPOSSIBLE): "These measurements break a law of every impact, which no law of a contact explains: "
        "`impact-rs diagnose` says which.",
    }.get(verdict, "Effects of the library explain these measurements up to noise: `impact-rs diagnose` names them.")


def _acting_laws(findings: Findings, laws: Iterable[Law]) -> list[str]:
    """Names of the laws that act where the model has a residual; in recordings, where the library leaves a residual.

    Every contact law acts in every impact of a table.
    """
    evidence = findings.evidence
    if evidence.source.contact_speeds:
        return [law.spec.name for law in laws]
    if not evidence.source.repeated:
        return _acting_laws_in_recordings(findings, laws)
    sizes: dict[str, dict[str, dict[str, float]]] = {"free": {}, "push": {}}
    in_contact = 0.0
    for residual in residuals_by_signal(evidence, evidence.means):
        joint = residual.index.rpartition(".")[2]
        if residual.phase in ("impact", "push"):
            in_contact = max(in_contact, residual.times_noise)
        if residual.phase in sizes:
            by_joint = sizes[residual.phase].setdefault(residual.signal, {})
            by_joint[joint] = max(by_joint.get(joint, 0.0), residual.times_noise)
    free_ranges = measured_ranges(evidence.source, after=0.0)

    def shown(law: Law, phase: str) -> bool:
        signal = sizes[phase].get(law.needs, {})
        largest = max(signal.values(), default=0.0)
        return _stands_out(max((signal.get(joint, 0.0) for joint in law.joints), default=largest), largest)

    def possible(law: Law) -> bool:
        if not law.needs:
            return in_contact > MIN_RESIDUAL_RATIO_OF_LAW
        beyond = in_contact > MIN_RESIDUAL_RATIO_OF_LAW and _begins_beyond(law, free_ranges)
        return shown(law, "free") or (beyond and (law.needs not in sizes["push"] or shown(law, "push")))

    return [law.spec.name for law in laws if possible(law)]


def _stands_out(size: float, largest: float) -> bool:
    """Whether a residual indicates a law, given the largest one of its kind, both in multiples of repeatability."""
    return size > max(MIN_RESIDUAL_RATIO_OF_LAW, MIN_SHARE_OF_LARGEST_RESIDUAL * largest)


def _acting_laws_in_recordings(findings: Findings, laws: Iterable[Law]) -> list[str]:
    """Names of the laws at joints with unexplained torque, and of forces if several joints have one."""
    rows = findings.evidence.source.joint_sizes(findings.unexplained)
    ratios = {joint: size / noise for joint, size, noise, _ in rows if noise > 0.0}
    joints = {joint for joint, size in ratios.items() if _stands_out(size, max(ratios.values()))}
    chosen: dict[tuple[str, ...], str] = {}  # one each: torques on a motor and on its link are confounded
    for law in laws:
        if joints & set(law.joints):
            chosen.setdefault((law.where, law.symbol, law.form), law.spec.name)
        elif law.needs and not law.joints and len(joints) > 1:
            chosen[law.spec.name,] = law.spec.name
    return list(chosen.values())


def _begins_beyond(law: Law, ranges: Mapping[str, Range]) -> bool:
    """Whether a law at one of its starts is zero in the measured range, so that it sets in beyond."""
    if law.symbol not in ranges or not any(parameter.shape for parameter in law.spec.parameters.values()):
        return False
    at = np.linspace(*ranges[law.symbol], LAW_POINTS)
    amplitudes = {name: 1.0 for name, parameter in law.spec.parameters.items() if not parameter.shape}
    return any(not np.any(law.force(at, amplitudes | dict(start))) for start in law.starts)


def _document(
    searched: _LawSearch, model: Model, laws: Mapping[str, Law], ranges: Mapping[str, Range]
) -> DiscoveryDocument:
    findings = searched.findings
    best = sorted(
        (name for name in findings.search.screening.singles if name in laws and name not in findings.names),
        key=lambda name: findings.search.screening.linear_fit_with(findings.chosen, name).score,
    )
    rivals = [rival.name for rival in findings.rivals]
    shown = [name for name in dict.fromkeys([*findings.names, *rivals, *best[:MAX_OTHER_LAWS]]) if name in laws]
    findings.search.screening.keep({*shown, *(name for name in findings.search.screening.singles if name not in laws)})
    diagnosis = document_of(findings, searched.source, model)
    diagnosis = diagnosis.model_copy(update={"formulas": tuple(laws[name].spec for name in shown)})
    chosen = [name for name in diagnosis.named if name in laws]
    documents = {
        effect.name: _law(diagnosis, laws[effect.name], ranges, laws)
        for effect in diagnosis.effects
        if effect.name in laws and effect.measured
    }
    tied = {group[0]: [name for name in group[1:] if name in documents] for group in diagnosis.confusable}
    listed = {name for law in chosen for name in (law, *tied.get(law, ()))}
    groups = [
        sorted((documents[tie] for tie in (name, *tied.get(name, ()))), key=lambda law: law.held_out_error_after)
        for name in sorted(
            chosen, key=lambda name: -documents[name].held_out_error_before
        )  # largest contribution first
    ]
    listed_laws = {law.name: law for group in groups for law in group}
    instead = (law for name, law in documents.items() if name not in listed and (name in rivals or not chosen))
    others = tuple(sorted(instead, key=lambda law: law.held_out_error_after))
    if chosen:
        verdict = DESCRIBED if any(laws[name].knots for name in chosen) else FOUND
    else:
        verdict = LIBRARY if diagnosis.named and not diagnosis.verdict.leaves_residuals else NO_LAW
    return DiscoveryDocument(
        verdict=verdict,
        summary=_summary(verdict, [group[0] for group in groups], diagnosis, searched.counts[0]),
        laws=tuple(listed_laws.values()),
        others=others,
        looked_at=searched.counts[0],
        starts=searched.counts[1],
        error_unit=diagnosis.error_unit,
        diagnosis=diagnosis,
    )


def _summary(verdict: str, laws: Sequence[LawDocument], diagnosis: DiagnosisDocument, count: int) -> str:
    if verdict == NO_LAW and diagnosis.named:
        s = "s" if len(diagnosis.named) == 1 else ""
        return (
            f"None of {count} laws and effects holds in addition to {' and '.join(diagnosis.named)} of the library, "
            f"which explain{s} a part: at least one more cause is missing."
        )
    if verdict == NO_LAW:
        return f"None of {count} laws and effects holds: held-out conditions do not support the best of them."
    if verdict == LIBRARY:
        return f"Among {count} laws and effects, {' and '.join(diagnosis.named)} of the library explains most."
    before, after = diagnosis.held_out_error_before, diagnosis.held_out_error_after
    named = {law.name for law in laws} | {name for law in laws for name in law.tied_with}
    library_effects = [name for name in diagnosis.named if name not in named]
    sentences = [
        "No law of the grammar explains all of it; a curve describes the rest." if verdict == DESCRIBED else "",
        *(law.sentence if law.curved else f"{law.sentence} {law.formula}." for law in laws),
        f"Held-out error: {before:.3g} → {after:.3g} {diagnosis.error_unit}.",
        *(law.tie for law in laws),
        f"Fitted together with {' and '.join(library_effects)} of the library: add them together."
        if library_effects
        else "",
    ]
    return " ".join(filter(None, sentences))


def _law(diagnosis: DiagnosisDocument, law: Law, ranges: Mapping[str, Range], laws: Mapping[str, Law]) -> LawDocument:
    effect = diagnosis.effect(law.spec.name)
    assert effect is not None
    key, table = law.formula
    rows = table if isinstance(table, dict) else {"": table}
    place = PLACES_OF[key] + ("s" if len(law.joints) > 1 else "")
    names = [law.coefficient.replace("_", " ")] if law.coefficient else law.where.removeprefix("joint").split("_")
    where = f" {' and '.join(names)}" if law.where else ""
    domain = ranges.get(law.symbol)
    return LawDocument(
        name=law.spec.name,
        sentence=law.spec.sentence,
        place=f"{place}{where}",
        formula=_in_one_line(rows, law),
        parameters={
            name: NumberDocument(estimate=value.estimate, ci95=value.ci95, unit=value.unit)
            for name, value in effect.parameters.items()
        },
        curved=bool(law.knots),
        verdict=effect.verdict,
        held_out_error_before=effect.held_out_error_without or 0.0,
        held_out_error_after=effect.held_out_error_after or 0.0,
        p_value=1.0 if effect.p_value is None else effect.p_value,
        tied_with=effect.rivals,
        tie=_tie(diagnosis, law, effect.rivals, ranges, laws),
        valid=None
        if domain is None
        else DomainDocument(quantity=law.symbol, low=domain[0], high=domain[1], unit=law.quantity.unit),
    )


def _in_one_line(rows: Mapping[str, str], law: Law) -> str:
    """Formulas by joint or axis in one line; equal formulas and components of a vector are merged."""
    vector, of_place = law.quantity.vector, law.quantity.of_place
    if not vector(AXES[0]) or len(rows) != len(AXES):
        return "; ".join(dict.fromkeys(rows.values()))
    if not of_place:
        return rows[AXES[0]].replace(vector(AXES[0]), f"({', '.join(map(vector, AXES))})")
    factor = rows[AXES[0]].removesuffix(f" * {vector(AXES[0])}").replace(f"({law.symbol})", law.symbol)
    place = ", ".join(of_place.format(axis=axis) for axis in AXES)
    return f"{factor} * (({place}) - anchor)".replace(law.symbol, f"|({place}) - anchor|")


PLACES_OF = {
    "joint_torque": "torque on link",
    "motor_torque": "torque on motor",
    "end_effector_force": "force on the end effector",
    "object_force": "force on the object",
    "object_moment": "moment on the object",
    "contact_normal": "normal force between pad and object",
    "contact_tangential": "friction between pad and object",
    "support_normal": "normal force between support and object",
    "support_tangential": "friction between support and object",
    "contact": "coefficient of the contact:",
}


def _tie(
    diagnosis: DiagnosisDocument, law: Law, rivals: Sequence[str], ranges: Mapping[str, Range], laws: Mapping[str, Law]
) -> str:
    """Sentence on the range in which a law and its rivals are alike, and on a measurement that separates them."""
    if not rivals:
        return ""
    text = f"{law.spec.name} and {', '.join(rivals)} cannot be distinguished"
    domain = ranges.get(law.symbol)
    fitted = [laws[name] for name in rivals if name in laws and diagnosis.effect(name) is not None]
    same_quantity = [other for other in fitted if other.symbol == law.symbol]
    if domain is None or not same_quantity or law.knots:  # a curve does not extrapolate
        return f"{text}: in these measurements they are nearly the same."
    low, high = domain
    unit = law.quantity.unit
    text += f" between {low:.2g} and {high:.2g} {unit} of {law.symbol}"
    separating = [
        where for other in same_quantity if (where := _separating_value(law, other, diagnosis, domain)) is not None
    ]
    return f"{text}: measure at {max(separating, key=abs):.2g} {unit}." if separating else f"{text}."


def _separating_value(law: Law, other: Law, diagnosis: DiagnosisDocument, domain: Range) -> float | None:
    """Nearest value beyond the range at which two laws differ by ``MIN_LAW_DIFFERENCE`` of their size, or None."""
    low, high = domain
    forces = []
    reach = np.linspace(1.0, MAX_EXTRAPOLATION, 50)
    inside = np.linspace(low, high, 50)
    outside = (high if abs(high) >= abs(low) else low) * reach
    for compared in (law, other):
        effect = diagnosis.effect(compared.spec.name)
        assert effect is not None
        numbers = {name: value.estimate for name, value in effect.parameters.items()}
        forces.append((compared.signed_force(inside, numbers), compared.signed_force(outside, numbers)))
    size = float(np.max(np.abs(forces[0][0])))
    different = np.flatnonzero(np.abs(forces[0][1] - forces[1][1]) > MIN_LAW_DIFFERENCE * size)
    return float(outside[different[0]]) if different.size else None
