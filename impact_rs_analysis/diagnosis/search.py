# SPDX-License-Identifier: Apache-2.0
"""Choosing effects: screen all, fit a shortlist by simulation, accept those that lower the held-out error.

The search uses only the clusters it is given. The hold-out (:mod:`impact_rs_analysis.diagnosis.hold_out`) repeats it
without the clusters to predict.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product

import numpy as np
import scipy

from impact_rs_analysis.diagnosis.candidate import Candidate, Where, concerns, in_free_motion, linearise, wanted
from impact_rs_analysis.diagnosis.fit import (
    HOPELESS,
    STEPS,
    Evidence,
    Fit,
    evaluate_at,
    look_elsewhere,
    measure_again,
    refine,
    see_all,
)
from impact_rs_analysis.diagnosis.thresholds import (
    LEAST_FREEDOM,
    LEAST_GAIN,
    LEAST_GAIN_OF_FIRST,
    LEAST_TO_DISAGREE,
    MOST_EFFECTS,
    NOTHING,
    SHORTLIST,
    SIGNIFICANT,
    TIE,
    WIDE_TIE,
)
from impact_rs_sim.effects import Effect
from impact_rs_sim.robot import Array

STEPS_OF_FOLD = 2  # of Gauss-Newton in the folds of the hold-out; a third changes only the last digits
ROUNDS = 4  # of fits with new sensitivities, where predictions are cheap
PAIRS = 2  # fitted jointly after effects were found one by one
AMONG = 10  # effects from which pairs are formed


@dataclass(frozen=True)
class Rival:
    """An effect in place of a chosen one.

    Attributes:
        name: The effect.
        instead_of: The chosen one.
        fit: All other chosen effects and this one, fitted together.
        tied: Whether it predicts unseen clusters as well.
    """

    name: str
    instead_of: str
    fit: Fit
    tied: bool


ProgressCallback = Callable[[str, float], None]


class Search:
    """Search over effects.

    Args:
        effects: Effects to consider.
        evidence: Residuals of the model in the clusters of the search.
        shortlist: Number of candidates that are fitted by simulation in every round.
        progress: Called after every fit with the effects joined by ``+`` and their held-out error, on the scale of
            :meth:`Evidence.size`.
        known: Results of the search over all clusters of the source, see ``ended``; fits may start there.

    Attributes:
        singles: Every measurable effect alone, linearised at nominal.
        unmeasured: Effects that change no measured feature.
        ruled_out: Effects ruled out by free motion, and not searched in contact.
        ended: Results of fits by simulation, by the names of their effects.
    """

    def __init__(
        self,
        effects: Sequence[Effect],
        evidence: Evidence,
        shortlist: int = SHORTLIST,
        progress: ProgressCallback = lambda *_: None,
        known: Mapping[tuple[str, ...], Candidate] | None = None,
    ) -> None:
        self.evidence, self._shortlist, self._progress = evidence, shortlist, progress
        self.source = evidence.source
        self._effects = tuple(effects)
        self.singles: dict[str, Candidate] = {}
        self._starts: dict[str, Candidate] = {}
        self._fitted_before_contact: dict[str, Fit] = {}
        self.unmeasured: set[str] = set()
        self.ruled_out: set[str] = set()
        self.ended: dict[tuple[str, ...], Candidate] = {}
        self._known = {names: candidate.only(evidence.numbers) for names, candidate in (known or {}).items()}

    @classmethod
    def screened(
        cls,
        effects: Sequence[Effect],
        evidence: Evidence,
        shortlist: int = SHORTLIST,
        progress: ProgressCallback = lambda *_: None,
        known: Mapping[tuple[str, ...], Candidate] | None = None,
    ) -> Search:
        """A search with the sensitivities of all effects; arguments as for the class."""
        search = cls(effects, evidence, shortlist, progress, known)
        search._screen()
        return search

    def _screen(self) -> None:
        absent = self._absent(self._effects)
        self.ruled_out = set(absent)
        self._prefetch([effect for effect in self._effects if effect.name not in self.ruled_out], concerns)
        for effect in self._effects:
            known = absent.get(effect.name)
            candidate = self._linearised((effect,), self.evidence) if known is None else known
            if candidate is None:
                continue
            if all(np.all(jacobian == 0.0) for jacobian in candidate.jacobians):
                self.unmeasured.add(effect.name)
            else:
                self.singles[effect.name] = candidate
                self._starts[effect.name] = self._start(candidate)

    def _linearised(
        self, effects: tuple[Effect, ...], evidence: Evidence, where: Where = concerns, point: Array | None = None
    ) -> Candidate | None:
        """Effects linearised together about a point; None: at nominal."""
        candidate = Candidate.of(effects, evidence.source, point)
        return linearise(candidate, evidence.clusters, evidence.numbers, evidence.source, where=where)

    def _start(self, candidate: Candidate) -> Candidate:
        """Start of a fit: the best of several values of the shape parameters.

        If contact is expensive to simulate, they are chosen by the motion before it.
        """
        if not has_shape_parameter(candidate):
            return candidate
        if (known := self._from_known(candidate, self.evidence)) is not None:
            return known
        if self.source.cheap:
            return self._best_shape(candidate, self.evidence)
        fits = self._fitted_before_contact
        before = fits.get(candidate.names[0])
        if before is None or before.misfit > HOPELESS * min(fitted.misfit for fitted in fits.values()):
            return candidate
        evidence, there = self.evidence, replace(candidate, point=before.estimate)
        return linearise(there, evidence.clusters, evidence.numbers, self.source, "starts of the fit") or candidate

    def _proposed(self, chosen: Fit | None, name: str) -> Fit:
        """Linear fit of one more effect; with a shape parameter, about its best fit to the motion before contact.

        The start of an effect was fitted as if it were alone, e.g. friction that decreases with speed in place of an
        offset. Together with the chosen effects it is fitted anew and linearised with them.
        """
        proposal = self.beside(chosen, name)
        if chosen is None or self.source.cheap or not has_shape_parameter(self._starts[name]):
            return proposal
        there = self._from_known(proposal.candidate, proposal.evidence) or self._bent_beside(chosen, name)
        return proposal if there is None else Fit.of(there, proposal.evidence)

    def _bent_beside(self, chosen: Fit, name: str) -> Candidate | None:
        """Chosen effects and one more, fitted to the motion before contact; None if that does not lower the error."""
        evidence, whole = self._before_contact(), chosen.evidence
        if evidence.null.freedom < LEAST_FREEDOM:
            return None
        effects, effect = chosen.candidate.effects, self.singles[name].effects[0]
        nominal = np.concatenate((chosen.estimate, effect.nominal(self.source.joints)))
        alone = self._linearised(effects, evidence, point=chosen.estimate)
        beside = self._linearised((*effects, effect), evidence, point=nominal)
        if alone is None or beside is None:
            return None
        fitted = see_all(self._fitted(beside, evidence))
        if fitted.misfit > (1.0 - LEAST_GAIN) * Fit.of(alone, evidence).misfit:
            return None
        there = Candidate.of((*effects, effect), self.source, fitted.estimate, chosen.candidate.origin)
        return linearise(there, whole.clusters, whole.numbers, self.source, "starts of the fit")

    def _fitted(self, candidate: Candidate, evidence: Evidence) -> Fit:
        """A fit with cheap predictions: shape parameters start at their best value, and rounds are repeated."""
        if not has_shape_parameter(candidate):
            return refine(candidate, evidence)
        fitted = refine(self._best_shape(candidate, evidence), evidence)
        for _ in range(ROUNDS):
            there = replace(candidate, point=fitted.estimate)
            moved = linearise(there, evidence.clusters, evidence.numbers, evidence.source, "sensitivities")
            again = None if moved is None else refine(moved, evidence)
            if again is None or again.misfit >= fitted.misfit:
                break
            done = again.misfit > (1.0 - LEAST_GAIN) * fitted.misfit
            fitted = again
            if done:
                break
        return fitted

    @staticmethod
    def _best_shape(candidate: Candidate, evidence: Evidence) -> Candidate:
        shapes = [index for index, scalar in enumerate(candidate.scalars) if scalar.grid]
        tried = [candidate]
        for values in product(*(candidate.scalars[index].grid for index in shapes)):
            point = candidate.point.copy()
            point[shapes] = values
            # At nominal the shape parameter has no influence, so the features are those of the nominal point.
            moved = linearise(replace(candidate, point=point), evidence.clusters, evidence.numbers, evidence.source)
            if moved is not None:
                tried.append(moved)
        return min(tried, key=lambda entry: Fit.of(entry, evidence).misfit)

    def _absent(self, effects: Sequence[Effect]) -> dict[str, Candidate]:
        """Effects ruled out by free motion there and back, with their sensitivities there.

        Effects with several parameters, up to two per joint, are expensive to simulate in every push. They are ruled
        out if they are not significant in free motion, or if they cannot explain it while another single effect does.
        """
        if self.source.cheap or not any(item.contact for item in self.evidence.clusters):
            return {}
        evidence = self._before_contact()
        if evidence.null.freedom < LEAST_FREEDOM:
            return {}
        seen = [effect for effect in effects if any(in_free_motion(effect, item) for item in evidence.clusters)]
        dear = {effect.name for effect in seen if len(effect.scalars(self.source.joints)) > 1}
        if not dear:
            return {}
        self._prefetch(seen, in_free_motion, evidence)
        alone: dict[str, Candidate] = {}
        for effect in seen:
            candidate = self._linearised((effect,), evidence, in_free_motion)
            if candidate is not None:
                alone[effect.name] = candidate
        absent = {
            name
            for name in dear & alone.keys()
            if evidence.problem(alone[name]).p_value(evidence.null, slice(None)) > NOTHING
        }
        rest = {name: alone[name] for name in alone.keys() - absent}
        if dear & rest.keys():
            absent |= dear & self._cannot_explain(rest, evidence)
        return {name: self._as_seen_in(alone[name], evidence) for name in absent}

    def _before_contact(self) -> Evidence:
        """The evidence of free motion: the time before contact in every cluster, or the clusters without contact."""
        free = self.source.free_motion
        if free is None:
            return self.evidence.only([n for n, item in enumerate(self.evidence.clusters) if not item.contact])
        return Evidence.of(free, self.evidence.numbers, self.evidence.thrifty)

    def _as_seen_in(self, candidate: Candidate, evidence: Evidence) -> Candidate:
        """A candidate evaluated in some clusters or features, extended to all with zero sensitivity."""
        known = dict(zip(evidence.numbers, zip(evidence.clusters, candidate.jacobians, strict=True), strict=True))
        jacobians = []
        for number, item in zip(self.evidence.numbers, self.evidence.clusters, strict=True):
            jacobian = np.zeros((len(item.features), candidate.point.size))
            if number in known:
                part, own = known[number]
                places = {feature: row for row, feature in enumerate(item.features)}
                jacobian[[places[feature] for feature in part.features]] = own
            jacobians.append(jacobian)
        nothing = tuple(np.zeros(len(item.features)) for item in self.evidence.clusters)
        return replace(candidate, offsets=nothing, jacobians=tuple(jacobians))

    def _cannot_explain(self, candidates: dict[str, Candidate], evidence: Evidence) -> set[str]:
        """Candidates that cannot explain the motion before contact, if another one can."""
        enough = 2.0 * float(evidence.expected.mean())
        explained = 2.0 * enough  # no simulator is exactly right
        if evidence.excess(evidence.errors) < enough:
            return set()
        fits = self._fitted_before_contact
        linear = {name: Fit.of(candidate, evidence) for name, candidate in candidates.items()}
        far, steps = HOPELESS**2 * enough, STEPS_OF_FOLD if evidence.thrifty else STEPS
        shaped = {name: has_shape_parameter(candidate) for name, candidate in candidates.items()}
        for name in sorted(candidates, key=lambda entry: (shaped[entry], linear[entry].misfit)):
            candidate = candidates[name]
            if min((fitted.misfit for fitted in fits.values()), default=np.inf) > explained:
                fits[name] = see_all(self._fitted(candidate, evidence))
                continue
            bent = linear[name].misfit <= far or shaped[name]
            fits[name] = refine(candidate, evidence, far, steps) if bent else linear[name]
            if fits[name].misfit <= far:
                fits[name] = see_all(fits[name])
        best = min((fitted.misfit for fitted in fits.values()), default=np.inf)
        if best > explained:
            return set()
        return {name for name, fitted in fits.items() if fitted.misfit > HOPELESS * max(best, enough)}

    def _prefetch(self, effects: Sequence[Effect], where: Where, evidence: Evidence | None = None) -> None:
        """Compute the predictions of the screening in one parallel batch."""
        evidence = evidence or self.evidence
        batch = [
            item
            for effect in effects
            for item in wanted(Candidate.of((effect,), evidence.source), evidence.numbers, evidence.source, where)
        ]
        evidence.source.predict(batch, "sensitivities of all effects")

    def p_values(self, chosen: Fit | None) -> dict[str, float]:
        """p-value per effect given the chosen ones, adjusted for testing all (Benjamini and Hochberg)."""
        return adjusted(self.raw_p_values(chosen))

    def raw_p_values(self, chosen: Fit | None) -> dict[str, float]:
        """p-value per effect given the chosen ones, not adjusted."""
        raw = {}
        for name, candidate in self.singles.items():
            if chosen is None:
                problem, tested, evidence = self.evidence.problem(candidate), slice(None), self.evidence
            elif name in chosen.candidate.names:
                continue
            else:
                joined = chosen.candidate.beside(candidate)
                count = chosen.candidate.point.size
                problem, tested = chosen.evidence.problem(joined), slice(count, joined.point.size)
                evidence = chosen.left
            raw[name] = problem.p_value(evidence.null, tested)
        return raw

    def choose(self, thrifty: bool = False) -> Fit | None:
        """Forward selection; None if no effect is accepted.

        Args:
            thrifty: Skip refinements of the last digits: residuals run by run, and pairs.
        """
        chosen = self._extend(None, thrifty)
        if chosen is not None:
            chosen = self._without_the_superfluous(chosen)
            if not thrifty and self.source.repeated and len(chosen.candidate.effects) >= 2:
                chosen = self._try_pairs(chosen)
        return chosen

    def _extend(self, chosen: Fit | None, thrifty: bool) -> Fit | None:
        """Add effects until none is accepted."""
        first = self.evidence.excess(self.evidence.errors)
        decidable = self.evidence.null.shortage is None
        while chosen is None or len(chosen.candidate.effects) < MOST_EFFECTS:
            if chosen is not None and (left := chosen.lack_of_fit()) is not None and left > SIGNIFICANT:
                break
            p_values = self.p_values(chosen)
            evidence = self.evidence if chosen is None else chosen.evidence
            errors = self.evidence.errors if chosen is None else chosen.held_out
            excess = evidence.excess(errors)
            needed = (
                LEAST_GAIN * excess if self.source.repeated else max(LEAST_GAIN * excess, LEAST_GAIN_OF_FIRST * first)
            )
            likely = [n for n, p in p_values.items() if n not in self.ruled_out and (p < SIGNIFICANT or not decidable)]
            linear = sorted((self._proposed(chosen, name) for name in likely), key=lambda entry: entry.score)
            for entry in linear:
                self._report_progress(entry)
            # Small effects are linear: a proposal without gain in the linear fit has none by simulation.
            if chosen is not None:
                linear = [entry for entry in linear if excess - evidence.excess(entry.held_out) > 0.5 * needed]
            if thrifty and linear:
                linear = [entry for entry in linear if entry.score <= HOPELESS * linear[0].score]
            best = self._best(linear[: self._shortlist], chosen, STEPS_OF_FOLD if thrifty else STEPS)
            if best is None or excess - evidence.excess(best.held_out) <= needed:
                break
            chosen = best if thrifty else measure_again(best)
            self._keep(chosen)
        return chosen

    def _keep(self, fitted: Fit) -> None:
        self.ended[fitted.candidate.names] = fitted.candidate

    def _from_known(self, candidate: Candidate, evidence: Evidence) -> Candidate | None:
        """The candidate at its result in the search over more clusters, whose replays are kept; None without one."""
        known = self._known.get(candidate.names)
        if known is None:
            return None
        return evaluate_at(replace(known, origin=candidate.origin), known.point, evidence)

    def _begin(self, entry: Fit) -> Candidate:
        """Start of a fit: the linearisation point or the known result, whichever fits better."""
        known = self._from_known(entry.candidate, entry.evidence)
        if known is None:
            return entry.candidate
        nothing = np.zeros(known.point.size)
        errors = [float(np.mean(entry.evidence.problem(one).errors(nothing))) for one in (entry.candidate, known)]
        return known if errors[1] < errors[0] else entry.candidate

    def _report_progress(self, fitted: Fit) -> None:
        self._progress("+".join(fitted.candidate.names), self.evidence.size(fitted.held_out))

    @property
    def lacking(self) -> bool:
        """Whether residuals exceed noise and discrepancy; if not, effects below the relevance limit are not added."""
        left = self.evidence.lack_of_fit
        return left is None or left < SIGNIFICANT

    def alone(self, name: str) -> Fit:
        """Fit of one effect alone: at its linearisation or at its known result, whichever fits better."""
        fits = [self.beside(None, name)]
        ended = self.ended.get((name,))
        moved = None if ended is None else evaluate_at(replace(ended, origin=()), ended.point, self.evidence)
        if moved is not None:
            fits.append(Fit.of(moved, self.evidence))
        return min(fits, key=lambda fitted: fitted.score)

    def beside(self, chosen: Fit | None, name: str) -> Fit:
        """Linear fit of one more effect."""
        if chosen is None:
            return Fit.of(self._starts[name], self.evidence)
        return Fit.of(chosen.candidate.beside(self._starts[name]), chosen.evidence)

    def _best(self, shortlist: Sequence[Fit], chosen: Fit | None, steps: int) -> Fit | None:
        """The shortlist fitted by simulation: the best, or among equals the one with the fewest parameters."""
        found: list[Fit] = []
        for entry in shortlist:
            beat = min((proposal.score for proposal in found), default=np.inf)
            found.append(refine(self._begin(entry), entry.evidence, HOPELESS * beat, steps))
            self._report_progress(found[-1])
        if not found:
            return None
        top = min(proposal.score for proposal in found)
        for number, proposal in enumerate(found):
            if proposal.score <= HOPELESS * top:
                seen = see_all(proposal)
                # The search over all clusters has already tried other starts.
                found[number] = seen if proposal.candidate.names in self._known else look_elsewhere(seen)
            self._keep(found[number])
        first = 0 if chosen is None else chosen.change.size
        sure = consistent if self.source.repeated else noticeable
        found = [proposal for proposal in found if sure(proposal, first)]
        if self.source.repeated and chosen is None:
            enough = [proposal for proposal in found if moves_enough(proposal)]
            if len(enough) < len(found) and not self.lacking:  # the lack-of-fit test is expensive
                found = enough
        if not found:
            return None
        best = min(found, key=lambda proposal: proposal.score)
        joints = self.source.joints
        alike = [entry for entry in found if entry.score <= best.score * math.exp(TIE)]
        return min(alike, key=lambda entry: (entry.candidate.effects[-1].complexity(joints), entry.score))

    def _without_the_superfluous(self, chosen: Fit) -> Fit:
        """The fit without effects that later ones made redundant."""
        for name in chosen.candidate.names:
            if len(chosen.candidate.effects) == 1:
                break
            fitted = self.without(chosen, name)
            if fitted is not None and fitted.score <= chosen.score:
                return self._without_the_superfluous(fitted)
        return chosen

    def without(self, chosen: Fit, name: str) -> Fit | None:
        """The other chosen effects, fitted again; None where they cannot be simulated."""
        others = self._others(chosen, name)
        reduced = evaluate_at(others, others.point, chosen.evidence)
        return None if reduced is None else refine(reduced, chosen.evidence)

    @staticmethod
    def _others(chosen: Fit, name: str) -> Candidate:
        """The chosen effects but one, at their estimates, with unchanged sensitivities."""
        return replace(chosen.candidate, point=chosen.estimate).without(name)

    @staticmethod
    def left_without(chosen: Fit, name: str) -> Evidence:
        """The evidence with the residuals of the other chosen effects, to test one effect."""
        part = chosen.candidate.part(name)
        evidence = chosen.evidence
        reduced = evidence.problem(chosen.candidate.fixed(*range(part.start, part.stop)))
        rest = reduced.rest(reduced.solve())
        return evidence.shifted([item.mean - left for item, left in zip(evidence.clusters, rest, strict=True)])

    def joint_alternatives(self, chosen: Candidate, index: int) -> list[tuple[str, Candidate]]:
        """The chosen effects with the parameter of one joint replaced by that joint's parameter of another effect."""
        scalar = chosen.scalars[index]
        found = []
        for name, single in self._starts.items():
            if name in chosen.names or name in self.ruled_out:
                continue
            own = [
                number
                for number, other in enumerate(single.scalars)
                if (other.arm, other.joint) == (scalar.arm, scalar.joint)
            ]
            others = [number for number in range(single.point.size) if number not in own]
            if own and len(own) < single.point.size:
                found.append((name, chosen.fixed(index).beside(single.fixed(*others))))
        return found

    def _try_pairs(self, chosen: Fit) -> Fit:
        """Fit pairs jointly: they may beat effects found one by one."""
        likely = [name for name in self.singles if name not in self.ruled_out]
        linear = {name: Fit.of(self._starts[name], self.evidence).score for name in likely}
        names = sorted(likely, key=lambda name: linear[name])[:AMONG]
        ranked = []
        for first, second in combinations(names, 2):
            if not {first, second} <= set(chosen.candidate.names):
                joined = self._starts[first].beside(self._starts[second])
                ranked.append((Fit.of(joined, self.evidence).score, joined))
        for _, joined in sorted(ranked, key=lambda entry: entry[0])[:PAIRS]:
            pair = refine(joined, self.evidence, HOPELESS * chosen.score)
            self._keep(pair)
            if pair.score < (1.0 - LEAST_GAIN) * chosen.score:
                chosen = measure_again(pair)
        return chosen

    def simplified(self, chosen: Fit) -> tuple[Fit, list[Rival]]:
        """Replace effects by equivalent ones with fewer parameters, and list the remaining alternatives.

        A constant vertical force is attributed to a payload rather than to a spring or to gains of all joints.
        """
        joints = self.source.joints
        known = {name: single.effects[0] for name, single in self.singles.items()}
        rivals = self.rivals(chosen)
        for _ in range(MOST_EFFECTS):
            simpler = [
                rival
                for rival in rivals
                if rival.tied
                and rival.fit.score <= chosen.score * math.exp(TIE)
                and known[rival.name].complexity(joints) < known[rival.instead_of].complexity(joints)
            ]
            if not simpler:
                break
            best = min(simpler, key=lambda rival: (known[rival.name].complexity(joints), rival.fit.score))
            # The replaced effect may have explained more, which is missing now.
            chosen = self._extend(measure_again(best.fit), thrifty=False) or chosen
            rivals = self.rivals(chosen)
        return chosen, rivals

    def rivals(self, chosen: Fit, count: int = 3) -> list[Rival]:
        """Alternatives to every chosen effect, fitted together with the other chosen ones."""
        found = []
        for name in chosen.candidate.names:
            others = self._others(chosen, name)
            proposals = []
            for other, single in self.singles.items():
                if other in chosen.candidate.names or other in self.ruled_out:
                    continue
                start = self._starts[other]
                swapped = replace(others, offsets=tuple(np.zeros(o.shape) for o in single.offsets)).beside(start)
                moved = evaluate_at(replace(swapped, origin=chosen.candidate.origin), swapped.point, chosen.evidence)
                if moved is not None:
                    proposals.append((other, Fit.of(moved, chosen.evidence)))
            proposals.sort(key=lambda entry: entry[1].score)
            for other, linear in proposals[:count]:
                if linear.score > HOPELESS * chosen.score:
                    continue
                fitted = see_all(refine(linear.candidate, chosen.evidence, HOPELESS * chosen.score))
                found.append(Rival(other, name, fitted, tied(chosen, fitted)))
        return found


def tied(chosen: Fit, rival: Fit) -> bool:
    """Whether a rival predicts unseen clusters as well: mean log ratio of errors within two standard errors of 0.

    Clusters in which both predict the same are ignored.
    """
    return tied_errors(chosen.held_out, rival.held_out, chosen.evidence.expected / 2.0 + 1e-12)


def tied_errors(own: Array, other: Array, floor: Array | float) -> bool:
    """Whether held-out errors by cluster ``(c,)`` of two explanations are the same, see :func:`tied`.

    Args:
        own: Of the one that was chosen.
        other: Of the one that could stand in its place.
        floor: Error added to both, so that ratios of negligible errors are near 1.
    """
    ratio = np.log((other + floor) / (own + floor))
    moved = np.abs(ratio) > 1e-3
    if not np.any(moved):
        return True
    ratio = ratio[moved]
    spread = float(ratio.std(ddof=1) / math.sqrt(ratio.size)) if ratio.size > 1 else math.inf
    return float(ratio.mean()) < max(TIE, min(2.0 * spread, WIDE_TIE))


def has_shape_parameter(candidate: Candidate) -> bool:
    """Whether a nonlinear shape parameter needs several starts of the fit."""
    return any(scalar.grid for scalar in candidate.scalars)


def consistent(fitted: Fit, first: int = 0) -> bool:
    """Whether all conditions agree that some parameter, from number ``first`` on, differs from nominal.

    A p-value accounts for noise only. Simulator errors give different estimates in different conditions, so an interval
    from the scatter between conditions, at the same level over all parameters, must exclude the nominal value as well.
    With too few conditions that scatter is unknown, and the test passes.
    """
    candidate = fitted.candidate
    if sum(bool(np.any(jacobian)) for jacobian in candidate.jacobians) < LEAST_TO_DISAGREE:
        return True
    own = np.array([number >= first and not scalar.shape for number, scalar in enumerate(candidate.scalars)])
    if fitted.evidence.null.shortage is not None or not np.any(own):
        return True
    confidence = 1.0 - SIGNIFICANT / float(np.count_nonzero(own))
    widths = fitted.widths(confidence)
    distance = np.abs(fitted.estimate - candidate.nominal) / candidate.scale
    return bool(np.any((distance > widths)[own]))


def moves_enough(fitted: Fit, part: slice = slice(None)) -> bool:
    """Whether some parameters of a fit change some feature by more than its relevance limit."""
    change = ((fitted.estimate - fitted.candidate.nominal) / fitted.candidate.scale)[part]
    for item, jacobian in zip(fitted.evidence.clusters, fitted.candidate.jacobians, strict=True):
        limits = [feature.relevance_limit for feature in item.features]
        if np.any(np.abs(jacobian[:, part] @ change) * item.sigma > limits):
            return True
    return False


def noticeable(fitted: Fit, first: int = 0) -> bool:
    """Whether the interval of some parameter, from number ``first`` on, lies beyond the least change of the source.

    Parameters at a bound do not count: their intervals are invalid.
    """
    candidate = fitted.candidate
    distance = np.abs(fitted.estimate - candidate.nominal) / candidate.scale - fitted.half_widths
    free = (fitted.estimate > candidate.lower) & (fitted.estimate < candidate.upper)
    own = np.array([not scalar.shape for scalar in candidate.scalars])
    return bool(np.any((distance > fitted.evidence.source.least_change)[first:] & free[first:] & own[first:]))


def adjusted(p_values: dict[str, float]) -> dict[str, float]:
    """Benjamini and Hochberg's adjustment."""
    if not p_values:
        return {}
    return dict(zip(p_values, scipy.stats.false_discovery_control(list(p_values.values())).tolist(), strict=True))
