# SPDX-License-Identifier: Apache-2.0
"""Selection of effects: forward selection, backward elimination and exchange, by cross-validated error.

All effects are screened by score tests with a false discovery rate (Benjamini and Hochberg 1995), the most likely ones
are fitted by simulation, and an effect is accepted if it lowers the leave-one-out error. The search uses only the
clusters it is given: the hold-out (:mod:`impact_rs_analysis.diagnosis.search.hold_out`) repeats it without those that
it predicts.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from itertools import combinations, product
from types import MappingProxyType

import numpy as np
import scipy
from numpy.typing import NDArray

from impact_rs_analysis.diagnosis.search.candidate import Candidate, linearise, required_predictions
from impact_rs_analysis.diagnosis.search.fit import (
    Evidence,
    Fit,
    chord_method,
    evaluate_at,
    gauss_newton,
    has_shape_parameter,
    nelder_mead,
    replay_and_refit,
    restart_from_afar,
)
from impact_rs_analysis.diagnosis.search.relevance import exceeds_relevance_limit, noticeable
from impact_rs_analysis.diagnosis.thresholds import (
    MAX_EFFECTS,
    MAX_ERROR_RATIO,
    MAX_TIE_LOG_RATIO,
    MIN_GAIN_SHARE,
    MIN_P_IN_FREE_MOTION,
    SHORTLIST_SIZE,
    SIGNIFICANCE_LEVEL,
    TIE_LOG_RATIO,
    UNADJUSTED_LEVEL,
)
from impact_rs_analysis.evidence.cluster import Added
from impact_rs_sim.effects import Effect
from impact_rs_sim.effects.link import LINK_ERRORS
from impact_rs_sim.robots.robot import Array

MIN_SECANT_RATIO = 1.5  # features that a secant changes over those of the slope at nominal: another contact mode
MIN_FEATURE_CHANGE = 1e-6  # scaled features per parameter scale; the solver's rounding


@dataclass(frozen=True)
class Rival:
    """An effect in place of a chosen one.

    Attributes:
        name: The effect.
        instead_of: The chosen one.
        fit: All other chosen effects and this one, fitted together.
        tied: Whether it predicts unseen clusters as well, and repeats do not decide between both.
    """

    name: str
    instead_of: str
    fit: Fit
    tied: bool


NOTHING_KNOWN: Mapping[tuple[str, ...], Candidate] = MappingProxyType({})

ProgressCallback = Callable[[str, float], None]


class Search:
    """Search over effects.

    Args:
        effects: Effects to consider; several of one name are one effect with several starts of its shape, of which the
            best is kept.
        evidence: Residuals of the model in the clusters of the search.
        progress: Called after every fit with the effects joined by ``+`` and their held-out error, on the scale of
            :meth:`Evidence.size`.
        known: Start of a fit by the names of its effects: the estimate from all clusters of the source. The fit ends
            at the optimum of this evidence.
        earlier: Estimates of an earlier search or model: a further start for chosen effects whose residuals exceed
            noise.

    Attributes:
        singles: Every measurable effect alone, linearised at nominal.
        ruled_out: Effects that free motion rules out; they are not fitted.
        ended: Results of fits by simulation, by the names of their effects.
    """

    def __init__(
        self,
        effects: Sequence[Effect],
        evidence: Evidence,
        progress: ProgressCallback = lambda *_: None,
        known: Mapping[tuple[str, ...], Candidate] = NOTHING_KNOWN,
        earlier: Added = (),
    ) -> None:
        self.evidence, self.source, self._progress, self._known = evidence, evidence.source, progress, known
        self._budget = evidence.budget
        self._earlier = earlier
        self.singles: dict[str, Candidate] = {}
        self.ended: dict[tuple[str, ...], Candidate] = {}
        self._looks = Counter(effect.name for effect in effects)
        self._starts: dict[str, Candidate] = {}
        self._unseen: dict[str, Candidate] = {}
        self._beside: dict[tuple[str, Added], Candidate] = {}
        self.ruled_out: set[str] = set()
        self._screen(effects)

    def _screen(self, effects: Sequence[Effect]) -> None:
        """Sensitivities of all effects at nominal and at starts by the measurements, in one parallel batch."""
        candidates = [Candidate.of((effect,), self.source) for effect in effects]
        for effect in effects:
            starts = self.source.starts(effect.name)
            candidates += [Candidate.of((effect,), self.source, start) for start in starts]
            self._looks[effect.name] += len(starts)
        self._rule_out(candidates)
        candidates = [candidate for candidate in candidates if candidate.names[0] not in self.ruled_out]
        batch = [
            item
            for candidate in candidates
            for item in required_predictions(candidate, self.evidence.numbers, self.source)
        ]
        self.source.predict(batch, "sensitivities of all effects")
        for candidate in candidates:
            found = self._linearised(candidate)
            if found is None:
                continue
            found = self._with_secants(found)
            name, known = found.names[0], self.singles.get(found.names[0])
            if not found.seen:
                self._unseen[name] = found
            elif known is None or self._misfit(found) < self._misfit(known):
                self.singles[name] = found
        for name in self.singles:
            self._unseen.pop(name, None)

    def _misfit(self, candidate: Candidate) -> float:
        return Fit.of(candidate, self.evidence).misfit

    def _with_secants(self, candidate: Candidate, base: Added = ()) -> Candidate:
        """The candidate with secants as sensitivities of parameters that change more features far from nominal.

        A sticking contact does not depend on its friction until it slips, and a frictionless one has no tangential
        restitution until the model has friction, so other effects may be the ``base``. Where a few impacts slip and
        most stick, friction changes hardly any feature at nominal. For impacts, whose predictions are cheap, every
        parameter is probed, and the secant to the point with the most changed features is taken; for motions only
        parameters without sensitivity, and the nearest point at which some feature changes.
        """
        if not any(effect.seen_in(item.contact) for effect in candidate.effects for item in self.evidence.clusters):
            return candidate
        features = sum(item.sigma.size for item in self.evidence.clusters)
        for index, scalar in enumerate(candidate.scalars):
            here = _changed([jacobian[:, index] for jacobian in candidate.jacobians])
            if scalar.shape or (here and self.source.of_motion) or MIN_SECANT_RATIO * here >= features:
                continue
            best, most = None, MIN_SECANT_RATIO * here
            for point in candidate.probes(index):
                columns = self._secant(candidate, index, point[index], base)
                if columns is not None and (seen := _changed(columns)) > most:
                    best, most = columns, seen
                    if self.source.of_motion:
                        break
            if best is not None:
                candidate = candidate.with_sensitivity(index, best)
        return candidate

    def _secant(self, candidate: Candidate, index: int, value: float, base: Added) -> list[Array] | None:
        """Secant of one parameter from its point to a value: scaled change per parameter scale, ``(F,)`` by cluster."""
        point = candidate.point.copy()
        point[index] = value
        before, after = ((*base, *candidate.split(vector)) for vector in (candidate.point, point))
        changes = self.source.differences(self.evidence.numbers, before, after, "probes of effects")
        steps = (value - candidate.point[index]) / candidate.scale[index]
        pairs = list(zip(changes, self.evidence.clusters, strict=True))
        columns = [change / (item.sigma * steps) for change, item in pairs if change is not None]
        return columns if len(columns) == len(pairs) else None

    def _with_sensitivities_beside(self, single: Candidate, chosen: Fit | None) -> Candidate:
        """An effect with its sensitivities in the presence of the chosen ones: impacts do not superpose.

        Rolling resistance acts differently on a body that slips than on one that sticks. For motions, whose predictions
        are expensive, superposition is assumed.
        """
        if chosen is None or self.source.of_motion:
            return single
        name, base = single.names[0], chosen.candidate.split(chosen.estimate)
        if (name, base) not in self._beside:
            for index, step in enumerate(single.steps(self.source.joints)):
                columns = self._secant(single, index, single.point[index] + step, base)
                if columns is not None:
                    single = single.with_sensitivity(index, columns)
            self._beside[name, base] = self._with_secants(single, base)
        return self._beside[name, base]

    def _look_beside(self, chosen: Fit) -> None:
        """Add effects that change some feature only in the presence of the chosen ones."""
        base = chosen.candidate.split(chosen.estimate)
        for name in sorted(self._unseen):
            found = self._with_secants(self._unseen[name], base)
            if found.seen:
                self.singles[name] = found
                del self._unseen[name]

    def keep(self, names: Collection[str]) -> None:
        """Forget all other effects."""
        self.singles = {name: candidate for name, candidate in self.singles.items() if name in names}
        self._unseen = {name: candidate for name, candidate in self._unseen.items() if name in names}

    @property
    def unmeasured(self) -> set[str]:
        """Effects without sensitivity in any measured feature."""
        return set(self._unseen)

    def _linearised(self, candidate: Candidate, evidence: Evidence | None = None) -> Candidate | None:
        evidence = evidence or self.evidence
        return linearise(candidate, evidence.clusters, evidence.numbers, self.source)

    def _rule_out(self, candidates: Sequence[Candidate]) -> None:
        """Rule out effects with several parameters that would change free motion, by their p-value there.

        Simulators agree in free motion and differ in contact, where one parameter per joint explains a part of any
        difference. Such an effect is judged by free motion alone and not simulated in contact.
        """
        free, source = self.evidence.free_motion_part, self.source.free_motion_part
        if free is None or source is None or free.null.shortage is not None:
            return
        several = [c for c in candidates if np.count_nonzero(~c.shapes) > 1]
        source.predict(
            [w for c in several for w in required_predictions(c, free.numbers, source)], "sensitivities in free motion"
        )
        found = [linearise(candidate, free.clusters, free.numbers, source) for candidate in several]
        seen = [one for one in found if one is not None and one.seen]
        p_values = dict[str, float]()
        for one, p_value in zip(seen, free.null.p_values([one.jacobians for one in seen]), strict=True):
            p_values[one.names[0]] = min(p_value, p_values.get(one.names[0], 1.0))  # of several starts of its shape
        self.ruled_out = {name for name, p_value in p_values.items() if p_value > MIN_P_IN_FREE_MOTION}
        for one in seen:
            if one.names[0] in self.ruled_out:
                self.singles[one.names[0]] = self.evidence.extended_beyond_free_motion(one)

    def _start(self, name: str) -> Candidate:
        """Start of the fit of a single effect."""
        return self._starts.get(name, self.singles[name])

    def _best_shape(self, candidate: Candidate) -> Candidate:
        """The candidate at the best grid point of its shape parameters, by the misfit of the linear fit.

        A shape without sensitivity at nominal, as the centre of a payload of mass 0, is linearised again at the fit of
        the other parameters: in recordings, whose torque is linear in mass and first moment; contacts are not.
        """
        shapes = [index for index, scalar in enumerate(candidate.scalars) if scalar.grid]
        tried = [candidate]
        for values in product(*(candidate.scalars[index].grid for index in shapes)) if shapes else ():
            point = candidate.point.copy()
            point[shapes] = values
            if (moved := self._linearised(replace(candidate, point=point))) is not None:
                tried.append(moved)
        if candidate.unseen and self.source.recording is not None:
            point = Fit.of(candidate, self.evidence).estimate
            if (moved := self._linearised(replace(candidate, point=point))) is not None:
                tried.append(moved)
        return min(tried, key=lambda entry: Fit.of(entry, self.evidence).misfit)

    def p_values(self, chosen: Fit | None) -> dict[str, float]:
        """Adjusted p-value of each effect given the chosen ones, and of each law at all joints (:meth:`_groups`)."""
        return self.adjusted(self.raw_p_values(chosen))

    def adjusted(self, p_values: Mapping[str, float]) -> dict[str, float]:
        """Benjamini-Hochberg adjusted p-values, for tests of all of these at every start of their shapes."""
        return benjamini_hochberg(p_values, sum(max(1, self._looks[name]) for name in p_values))

    def raw_p_values(self, chosen: Fit | None) -> dict[str, float]:
        """:meth:`p_values` without adjustment for multiple testing, each at its best start."""
        return self.p_values_of(self._groups(chosen), chosen)

    def _groups(self, chosen: Fit | None, names: Collection[str] | None = None) -> list[str]:
        """Candidates of one selection step: an effect, or one law at several joints, joined by ``+``.

        Args:
            chosen: The chosen effects.
            names: Effects to consider; None: all.
        """
        present = () if chosen is None else chosen.candidate.names
        alone = [name for name in self.singles if name not in present and (names is None or name in names)]
        families: dict[str, list[str]] = {}
        for name in alone:
            families.setdefault(self.singles[name].effects[0].family, []).append(name)
        return alone + ["+".join(members) for family, members in families.items() if family and len(members) > 1]

    def _joined(self, group: str, chosen: Fit | None) -> Candidate:
        """A group at the starts of its fits, in the presence of the chosen effects."""
        starts = [self._start(name) for name in group.split("+")]
        return reduce(
            Candidate.beside,
            (s if has_shape_parameter(s) else self._with_sensitivities_beside(s, chosen) for s in starts),
        )

    def p_values_of(self, groups: Sequence[str], chosen: Fit | None) -> dict[str, float]:
        """:meth:`raw_p_values` of some groups, by their sensitivities in the presence of the chosen effects."""
        beside = {}
        for group in groups:
            own = reduce(
                Candidate.beside,
                (self._with_sensitivities_beside(self.singles[name], chosen) for name in group.split("+")),
            )
            beside[group] = own if chosen is None else chosen.candidate.beside(own)
        null = (self.evidence if chosen is None else chosen.left).null
        first = 0 if chosen is None else chosen.candidate.point.size
        own_part = [[jacobian[:, first:] for jacobian in fitted.jacobians] for fitted in beside.values()]
        fitted = () if chosen is None else chosen.candidate.jacobians
        return dict(zip(beside, null.p_values(own_part, fitted), strict=True))

    def p_value_of_chosen(self, chosen: Fit, name: str) -> float:
        """p-value of a chosen effect given the other chosen ones, not adjusted for multiple testing.

        By its sensitivities at the estimate: at nominal they may be zero, as for a restitution that first changes a
        feature once a contact opens. Those at the estimate may vanish too, where the fit turns back, so they are
        corrected to the change of the features that the fit makes (:func:`secant_update`). The statistic T is then at
        least the decrease of the squared residual, twice the log likelihood ratio of the fit under normal noise.
        """
        others = self.without(chosen, name) if len(chosen.candidate.effects) > 1 else None
        candidate, own = chosen.candidate, chosen.candidate.part(name)
        left = self.evidence if others is None else others.left
        fitted = () if others is None else others.candidate.jacobians
        made = [first - second for first, second in zip(left.means, chosen.residuals, strict=True)]
        return left.null.p_value(
            secant_update([jacobian[:, own] for jacobian in candidate.jacobians], made, chosen.away[own]), fitted
        )

    def forward_selection(self) -> Fit | None:
        """The selected effects; None if none is accepted."""
        # In recordings library effects come first: friction is in all of them, and laws describe the remainder.
        named = [name for name, single in self.singles.items() if not single.effects[0].family]
        chosen = self._extend(None, None if self.source.repeated else named)
        if not self.source.repeated:
            chosen = self._extend(chosen)
        if chosen is None:
            return None
        return self._out_of_small_minima(self._backward_elimination(chosen))

    def _out_of_small_minima(self, chosen: Fit) -> Fit:
        """The chosen effects after global search, if trials have a lack of fit that no effect explains."""
        left = chosen.lack_of_fit() if self.source.of_motion else None
        if left is None or left > SIGNIFICANCE_LEVEL or self._budget.leaves_out("other minima of the error"):
            return chosen
        earlier = self._at_earlier(chosen)
        if earlier is not None and not self._hardly_better(earlier, chosen):
            return self._extend(earlier) or chosen
        if self._known:  # a hold-out: the search of all clusters has looked
            return chosen
        moved = nelder_mead(chosen)
        if self._hardly_better(moved, chosen):
            return chosen
        return self._extend(self._measured_again(moved)) or chosen

    def _hardly_better(self, moved: Fit, chosen: Fit) -> bool:
        return moved.misfit > (1.0 - MIN_GAIN_SHARE) * chosen.misfit

    def _at_earlier(self, chosen: Fit) -> Fit | None:
        """The chosen effects fitted from earlier estimates; None: some of them have none.

        Every run is replayed: where joints stick, the optimum of one run per condition is another one.
        """
        candidate, estimates = chosen.candidate, dict(self._earlier)
        if not estimates.keys() >= set(candidate.names):
            return None
        point = np.concatenate([estimates[name] for name in candidate.names])
        start = self._linearised(replace(candidate, point=point, origin=()))
        if start is None:
            return None
        return self._measured_again(Fit.of(start, self.evidence).at_point)

    def _extend(self, chosen: Fit | None, names: Collection[str] | None = None) -> Fit | None:
        """Add effects until none is accepted, from those of ``names`` or from all (None)."""
        while chosen is None or len({e.family or e.name for e in chosen.candidate.effects}) < MAX_EFFECTS:
            if chosen is not None and (left := chosen.lack_of_fit()) is not None and left > SIGNIFICANCE_LEVEL:
                break
            if chosen is not None and self._budget.leaves_out("further effects beside " + _named(chosen)):
                break  # the first effect is looked for in any case: without it nothing would seem to be missing
            best = self._next(chosen, self._groups(chosen, names))
            if best is None and not self.source.of_motion:
                best = self._pair_at_once(chosen)
            if best is None:
                break
            chosen = self._measured_again(best)
            self._look_beside(chosen)
        return chosen

    def _next(
        self, chosen: Fit | None, groups: Sequence[str], p_values: Mapping[str, float] | None = None
    ) -> Fit | None:
        """The best of some effects or groups beside the chosen ones, fitted by simulation; None: none is accepted.

        Args:
            chosen: The chosen effects.
            groups: Effects or groups that may be added at once.
            p_values: Adjusted, of the groups; None: those of all effects and groups that may be accepted.
        """
        p_values = self.p_values(chosen) if p_values is None else p_values
        possible = [group for group in groups if group not in self.ruled_out]
        likely = [group for group in possible if p_values[group] < SIGNIFICANCE_LEVEL]
        # Sensitivities at nominal may miss an effect that acts far from there: then fits and hold-out decide.
        if not likely and chosen is None and self.has_lack_of_fit and self.source.repeated:
            likely = sorted(possible, key=lambda group: p_values[group])[:SHORTLIST_SIZE]
        apart = {name for group in likely for name in group.split("+")}
        self._starts |= {n: self._best_shape(self.singles[n]) for n in apart if n not in self._starts}
        linear = self._with_shapes([self.beside(chosen, group) for group in likely])
        for entry in linear:
            self._report_progress(entry)
        if chosen is None and not self.has_lack_of_fit:  # then only effects beyond a relevance limit are accepted
            linear = list(filter(exceeds_relevance_limit, linear))
        shortlist, others = linear[:SHORTLIST_SIZE], linear[SHORTLIST_SIZE:]
        if chosen is None and others:  # the first effect may act far from nominal, where linear fits mislead
            shortlist.append(min(others, key=lambda entry: p_values["+".join(entry.candidate.names)]))
        return self._best(shortlist, chosen)

    def _pair_at_once(self, chosen: Fit | None) -> Fit | None:
        """Two effects that lower the error only together, as restitution and its decrease with speed; None: no pair.

        Each must be significant given the other. For tables of impacts alone, whose predictions are cheap.
        """
        alone = [name for name in self._groups(chosen) if "+" not in name and not self.singles[name].effects[0].family]
        pairs = ["+".join(pair) for pair in combinations(alone, 2)]
        p_values = benjamini_hochberg(self.p_values_of(pairs, chosen), len(alone) + len(pairs))
        pairs = [pair for pair in pairs if p_values[pair] < SIGNIFICANCE_LEVEL]
        best = self._next(chosen, pairs, p_values) if pairs else None
        added = () if best is None else best.candidate.names[-2:]
        if best is None or any(self.p_value_of_chosen(best, name) >= SIGNIFICANCE_LEVEL for name in added):
            return None
        return best

    def _with_shapes(self, linear: Sequence[Fit]) -> list[Fit]:
        """Linear fits, best first; unseen shapes are linearised again where the fit puts amplitudes.

        The length of a cable changes nothing while it does not pull. At a length from which a fit starts it pulls in
        few conditions, and predicts the others worse than what is wrong everywhere.
        """
        found = {entry.candidate.names: entry for entry in linear}
        unsure = [entry for entry in linear if entry.candidate.unseen_shapes]
        for entry in unsure:
            there = self._linearised(replace(entry.candidate, point=entry.estimate), entry.evidence)
            if there is not None and (seen := Fit.of(there, entry.evidence)).score < entry.score:
                found[entry.candidate.names] = seen
        return sorted(found.values(), key=lambda entry: entry.score)

    def unexplained(self, chosen: Fit | None) -> list[Array]:
        """Leave-one-out residuals with the chosen effects, ``(F,)`` per cluster [-]."""
        return self.evidence.means if chosen is None else chosen.problem.leave_one_out_residuals

    def fitted(self, names: Sequence[str]) -> Fit | None:
        """Some effects fitted together; None if one of them changes no feature."""
        if any(name not in self.singles for name in names):
            return None
        joined = reduce(Candidate.beside, (self._best_shape(self.singles[name]) for name in names))
        return restart_from_afar(gauss_newton(self._refined(joined, self.evidence)))

    def _refined(self, start: Candidate, evidence: Evidence, give_up: float = np.inf) -> Fit:
        """The fit by :func:`chord_method`, from the known optimum of the same effects if there is one."""
        known = self._known.get(start.names)
        if known is not None:
            there = replace(known.only(evidence.numbers), origin=start.origin)
            start = evaluate_at(there, there.point, evidence) or start
        return self._kept(chord_method(start, evidence, give_up))

    def _measured_again(self, fitted: Fit) -> Fit:
        """Final fit; where it stalls a downhill simplex goes on, once for all clusters: folds start from there."""
        near = fitted.candidate.names in self._known
        found = replay_and_refit(fitted, near)
        if self.source.repeated and not near and found.stalled and not found.out_of_time:
            found = replay_and_refit(nelder_mead(found))
        return self._kept(found)

    def finished(self, fitted: Fit) -> Fit:
        """A fit that is reported, continued where the processor time had ended it.

        Away from the optimum, the error does not rise towards the ends of an interval.
        """
        if fitted.converged:
            return fitted
        evidence = replace(fitted.evidence, budget=self._budget.without_limit())
        return self._kept(gauss_newton(replace(fitted, evidence=evidence)))

    def _kept(self, fitted: Fit) -> Fit:
        self.ended[fitted.candidate.names] = fitted.candidate
        return fitted

    def _report_progress(self, fitted: Fit) -> None:
        self._progress("+".join(fitted.candidate.names), self.evidence.size(fitted.held_out))

    @property
    def has_lack_of_fit(self) -> bool:
        """Whether the test of lack of fit is significant, or impossible; if not, only relevant effects are added."""
        left = self.evidence.lack_of_fit
        return left is None or left < SIGNIFICANCE_LEVEL

    def alone(self, name: str) -> Fit:
        """Fit of one effect alone: linear, or at its optimum by simulation, whichever has the lower score."""
        fits = [self.beside(None, name)]
        ended = self.ended.get((name,))
        moved = None if ended is None else evaluate_at(replace(ended, origin=()), ended.point, self.evidence)
        if moved is not None:
            fits.append(Fit.of(moved, self.evidence))
        return min(fits, key=lambda fitted: fitted.score)

    def beside(self, chosen: Fit | None, group: str) -> Fit:
        """Linear fit of one more effect or group; one with a shape parameter is linearised with the chosen ones.

        Alone such an effect imitates others: friction that decreases with speed imitates an offset.
        """
        start = self._joined(group, chosen)
        if chosen is None:
            return Fit.of(start, self.evidence)
        joined = Fit.of(chosen.candidate.beside(start), chosen.evidence)
        if not has_shape_parameter(start):
            return joined
        there = self._linearised(replace(joined.candidate, point=joined.estimate), chosen.evidence)
        return joined if there is None else Fit.of(there, chosen.evidence)

    def _best(self, shortlist: Sequence[Fit], chosen: Fit | None) -> Fit | None:
        """The shortlist fitted by simulation: the best, or among ties the one with the fewest parameters."""
        found: list[Fit] = []
        for entry in shortlist:
            if found and self._budget.leaves_out(_named(entry)):  # the best by its sensitivities is tried in any case
                continue
            beat = min((proposal.score for proposal in found), default=np.inf)
            found.append(self._refined(entry.candidate, entry.evidence, MAX_ERROR_RATIO * beat))
            self._report_progress(found[-1])
        if not found:
            return None
        found.sort(key=lambda proposal: proposal.score)
        top = found[0].score
        for number, proposal in enumerate(found):
            if proposal.out_of_time:
                break
            if proposal.score <= MAX_ERROR_RATIO * top and proposal.candidate.names not in self._known:
                found[number] = self._kept(restart_from_afar(gauss_newton(proposal)))
        first = 0 if chosen is None else chosen.change.size
        before = self.unexplained(chosen)
        found = [entry for entry in found if entry.evidence.gains(before, entry.problem.leave_one_out_residuals)]
        if not self.source.repeated:
            found = [proposal for proposal in found if noticeable(proposal, first)]
        return simplest(found) if found else None

    def _backward_elimination(self, chosen: Fit, within: float = 0.0) -> Fit:
        """Backward elimination: the fit without effects that the others make redundant.

        Args:
            chosen: The fit.
            within: Largest log ratio of scores at which an effect is redundant.
        """
        for name in chosen.candidate.names:
            if len(chosen.candidate.effects) == 1:
                break
            fitted = self.without(chosen, name)
            if fitted is not None and fitted.score <= chosen.score * math.exp(within):
                return self._backward_elimination(fitted, within)
        return chosen

    def without(self, chosen: Fit, name: str) -> Fit | None:
        """The other chosen effects, fitted again; None if they cannot be simulated."""
        others = self._others(chosen, name)
        reduced = evaluate_at(others, others.point, chosen.evidence)
        return None if reduced is None else self._refined(reduced, chosen.evidence)

    @staticmethod
    def _others(chosen: Fit, name: str) -> Candidate:
        """The chosen effects but one, at their estimates, with unchanged sensitivities."""
        return replace(chosen.candidate, point=chosen.estimate).without(name)

    def joint_alternatives(self, chosen: Candidate, index: int) -> list[tuple[str, Candidate]]:
        """Rivals joint by joint: the parameter of one joint replaced by that of another effect at the same joint."""
        scalar = chosen.scalars[index]
        found = []
        for name in self.singles:
            if name in chosen.names or name in self.ruled_out:
                continue
            single = self._start(name)
            own = [
                number
                for number, other in enumerate(single.scalars)
                if (other.arm, other.joint) == (scalar.arm, scalar.joint)
            ]
            others = [number for number in range(single.point.size) if number not in own]
            if own and len(own) < single.point.size:
                found.append((name, chosen.fixed(index).beside(single.fixed(*others))))
        return found

    def exchange(self, chosen: Fit) -> tuple[Fit, list[Rival]]:
        """Exchange effects for better ones, or for tied ones with fewer parameters; list the remaining rivals.

        A constant vertical force is attributed to a payload rather than to a spring or to gains of all joints. Forward
        selection is greedy: given the effects that were added later, another may predict far better than the first.
        """
        rivals, known = self.rivals(chosen), {frozenset(chosen.candidate.names)}
        for _ in range(MAX_EFFECTS):
            alternatives = [rival.fit for rival in rivals if rival.tied]
            if len(chosen.candidate.names) > 1:  # a rival of one may explain the others as well
                alternatives += [self._backward_elimination(fitted, TIE_LOG_RATIO) for fitted in alternatives]
            limit = chosen.score * math.exp(TIE_LOG_RATIO)
            simpler = [fit for fit in alternatives if fit.score <= limit and fit.cost < chosen.cost]
            better = [rival.fit for rival in rivals if rival.fit.score < (1.0 - MIN_GAIN_SHARE) * chosen.score]
            if self.source.repeated and better:
                best = min(better, key=lambda fit: fit.score)
            elif simpler:
                best = min(simpler, key=lambda fit: (fit.cost, fit.score))
            else:
                break
            # The replaced effect may have explained more than its rival does.
            extended = self._extend(self._measured_again(best)) or chosen
            if (names := frozenset(extended.candidate.names)) in known:
                break
            known.add(names)
            chosen, rivals = extended, self.rivals(extended)
        return chosen, rivals

    def explained_by_links(self, chosen: Fit, name: str) -> bool:
        """Whether errors of the links within their uncertainty predict as well in place of a chosen load (linear fit).

        A load on the last link changes the same inertial parameters as errors of the links do, and no single effect on
        these has as many numbers as a body. For recordings, whose torque is linear in them.
        """
        effect = next(one for one in chosen.candidate.effects if one.name == name)
        if self.source.recording is None or effect.acts_on != LINK_ERRORS.acts_on or not effect.may_change:
            return False
        swapped = None if self._links is None else self._in_place_of(chosen, name, self._links)
        return swapped is not None and tied(chosen, swapped)

    @cached_property
    def _links(self) -> Candidate | None:
        """Errors of the links, linearised; None if they cannot be simulated."""
        return self._linearised(Candidate.of((LINK_ERRORS,), self.source))

    def _in_place_of(self, chosen: Fit, name: str, start: Candidate) -> Fit | None:
        """Linear fit of another effect in the place of a chosen one; None if it cannot be simulated."""
        others = self._others(chosen, name)
        swapped = replace(others, offsets=tuple(np.zeros(o.shape) for o in start.offsets)).beside(start)
        moved = evaluate_at(replace(swapped, origin=chosen.candidate.origin), swapped.point, chosen.evidence)
        return None if moved is None else Fit.of(moved, chosen.evidence)

    def rivals(self, chosen: Fit, count: int = 3, hopeless: float = MAX_ERROR_RATIO) -> list[Rival]:
        """Alternatives to every chosen effect, fitted together with the other chosen ones.

        Args:
            chosen: The chosen effects.
            count: How many are fitted in the place of each.
            hopeless: Largest score of a linear fit over that of the chosen effects.
        """
        found = []
        for name in chosen.candidate.names:
            proposals = [
                swapped
                for other in self.singles
                if other not in chosen.candidate.names
                and other not in self.ruled_out
                and (swapped := self._in_place_of(chosen, name, self._start(other))) is not None
            ]
            if self.source.recording is not None:  # whose predictions are cheap
                proposals = self._with_shapes(proposals)
            for linear in sorted(proposals, key=lambda entry: entry.score)[:count]:
                other = linear.candidate.names[-1]
                if linear.score > hopeless * chosen.score:
                    continue
                if self._budget.leaves_out(f"{other} in the place of {name}"):
                    continue
                fitted = gauss_newton(self._refined(linear.candidate, chosen.evidence, hopeless * chosen.score))
                equal = tied(chosen, fitted) and not _in_the_limit(fitted, other)
                found.append(Rival(other, name, fitted, equal and not encompasses(chosen, name, fitted, other)))
        return found


def simplest(fits: Sequence[Fit]) -> Fit:
    """The fit with the fewest parameters among those within ``TIE_LOG_RATIO`` of the lowest score."""
    limit = min(fitted.score for fitted in fits) * math.exp(TIE_LOG_RATIO)
    return min((fitted for fitted in fits if fitted.score <= limit), key=lambda fitted: (fitted.cost, fitted.score))


def _named(fitted: Fit) -> str:
    """Names of the effects of a fit, for messages."""
    return " and ".join(fitted.candidate.names)


def _changed(columns: Sequence[Array]) -> int:
    """Number of features with nonzero sensitivity, over all clusters."""
    return int(np.count_nonzero(np.abs(np.concatenate(columns)) > MIN_FEATURE_CHANGE)) if columns else 0


def _in_the_limit(fitted: Fit, name: str) -> bool:
    """Whether a shape parameter is at a bound, where the effect degenerates to a simpler one."""
    part = fitted.candidate.part(name)
    shapes = np.array([bool(scalar.grid) for scalar in fitted.candidate.scalars[part]])
    return bool(np.any(fitted.at_bound[part] & shapes))


def secant_update(jacobians: Sequence[Array], made: Sequence[Array], away: Array) -> list[Array]:
    """Sensitivities closest to the given ones that reproduce a change of the features (Broyden 1965), rank one.

        J + (y - J x) x^T / (x^T x)

    Args:
        jacobians: Sensitivities J per cluster, ``(F, p)`` per parameter scale.
        made: Change y of the features, ``(F,)`` per cluster.
        away: Change x of the parameters that made it, ``(p,)`` in scales; zero: J is returned.
    """
    size = float(away @ away)
    if size == 0.0:
        return list(jacobians)
    return [
        jacobian + np.outer(change - jacobian @ away, away) / size
        for jacobian, change in zip(jacobians, made, strict=True)
    ]


def tied(chosen: Fit, rival: Fit) -> bool:
    """Whether a rival is tied: its leave-one-out errors are as low, in the features that one of both changes.

    The mean log ratio of squared errors is below 5 %, or below two standard errors of it but 25 % at most. Clusters in
    which both predict the same are ignored. The error of a signal that neither changes, such as that of a velocity
    against the derivative of positions, would make different errors alike.
    """
    changed = changed_features(chosen.candidate, rival.candidate)
    squares = [[np.square(rest) for rest in fit.problem.leave_one_out_residuals] for fit in (chosen, rival)]
    squares.append([item.expected_squares / 2.0 for item in chosen.evidence.clusters])
    own, other, noise = (
        np.array([np.mean(one[mask]) if np.any(mask) else 0.0 for one, mask in zip(each, changed, strict=True)])
        for each in squares
    )
    return tied_errors(own, other, noise + 1e-12)


def changed_features(*candidates: Candidate) -> list[NDArray[np.bool_]]:
    """Masks of the features that some candidate changes, by cluster, ``(F,)`` each."""
    return [
        np.any([np.any(jacobian != 0.0, axis=1) for jacobian in jacobians], axis=0)
        for jacobians in zip(*(candidate.jacobians for candidate in candidates), strict=True)
    ]


def j_test_p_value(chosen: Fit, name: str, rival: Fit) -> float:
    """p-value of the J test: an effect of one fit adds nothing to another, non-nested fit.

    The tested direction is the difference of both predictions (Davidson and MacKinnon 1981, Econometrica 49), which
    needs no linearity; for several parameters the sensitivities are tested as well, because the effect was fitted in
    all of these directions (encompassing test, Mizon and Richard 1986, Econometrica 54).

    Args:
        chosen: Some effects.
        name: One of them.
        rival: The others with another effect in its place, fitted to the same clusters.
    """
    part = chosen.candidate.part(name)
    tangent = [jacobian[:, part] for jacobian in chosen.candidate.jacobians]
    columns = [(other - own)[:, None] for own, other in zip(chosen.residuals, rival.residuals, strict=True)]
    if tangent[0].shape[1] > 1:
        columns = [np.hstack(both) for both in zip(columns, tangent, strict=True)]
    return rival.left.null.p_value(columns, rival.candidate.jacobians)


def encompasses(chosen: Fit, name: str, rival: Fit, other: str) -> bool:
    """Whether a chosen effect encompasses its rival: its J test is significant, and that of the rival is not.

    With repeats or the rows of a table alone: samples of a recording are not independent.

    Args:
        chosen: The chosen effects.
        name: One of them.
        rival: The others with its rival.
        other: The rival.
    """
    source = chosen.evidence.source
    if (source.of_motion and not source.repeated) or rival.score <= chosen.score:
        return False
    return (
        j_test_p_value(chosen, name, rival) < SIGNIFICANCE_LEVEL
        and j_test_p_value(rival, other, chosen) > UNADJUSTED_LEVEL
    )


def tied_errors(own: Array, other: Array, floor: Array | float) -> bool:
    """Whether leave-one-out errors of two explanations are tied, see :func:`tied`.

    Args:
        own: Squared error of the chosen one by cluster, ``(c,)`` [-].
        other: Squared error of its rival, ``(c,)`` [-].
        floor: Added to both, so that ratios of negligible errors are near 1 [-].
    """
    ratio = np.log((other + floor) / (own + floor))
    moved = np.abs(ratio) > 1e-3
    if not np.any(moved):
        return True
    ratio = ratio[moved]
    spread = float(ratio.std(ddof=1) / math.sqrt(ratio.size)) if ratio.size > 1 else math.inf
    return float(ratio.mean()) < max(TIE_LOG_RATIO, min(2.0 * spread, MAX_TIE_LOG_RATIO))


def benjamini_hochberg(p_values: Mapping[str, float], tests: int = 0) -> dict[str, float]:
    """p-values adjusted for the false discovery rate (Benjamini and Hochberg 1995).

    Args:
        p_values: By name.
        tests: Number of tests, including those with larger p-values; 0: these alone.
    """
    if not p_values:
        return {}
    every = [*p_values.values(), *[1.0] * (tests - len(p_values))]
    return dict(zip(p_values, scipy.stats.false_discovery_control(every).tolist(), strict=False))
