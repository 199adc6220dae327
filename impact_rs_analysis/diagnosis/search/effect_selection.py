# SPDX-License-Identifier: Apache-2.0
"""Selection of effects: forward selection, backward elimination and exchange, by cross-validated error.

All effects are screened by score tests with a false discovery rate (Benjamini and Hochberg 1995), the most likely ones
are fitted by simulation, and an effect is accepted if it lowers the leave-one-out error. The search uses only the
clusters it is given: the hold-out (:mod:`impact_rs_analysis.diagnosis.search.hold_out`) repeats it without those that
it predicts.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property, reduce
from itertools import combinations
from types import MappingProxyType

import numpy as np

from impact_rs_analysis.diagnosis.search.candidate import Candidate
from impact_rs_analysis.diagnosis.search.fit import (
    Evidence,
    Fit,
    chord_method,
    evaluate_at,
    gauss_newton,
    nelder_mead,
    replay_and_refit,
    restart_from_afar,
)
from impact_rs_analysis.diagnosis.search.model_comparison import Rival, encompasses, in_the_limit, simplest, tied
from impact_rs_analysis.diagnosis.search.null_distribution import benjamini_hochberg
from impact_rs_analysis.diagnosis.search.relevance import exceeds_relevance_limit, noticeable
from impact_rs_analysis.diagnosis.search.screening import Screening
from impact_rs_analysis.diagnosis.thresholds import (
    MAX_EFFECTS,
    MAX_ERROR_RATIO,
    MIN_GAIN_SHARE,
    SHORTLIST_SIZE,
    SIGNIFICANCE_LEVEL,
    TIE_LOG_RATIO,
)
from impact_rs_analysis.evidence.cluster import Added
from impact_rs_sim.effects import Effect
from impact_rs_sim.effects.link import LINK_ERRORS
from impact_rs_sim.robots.robot import Array

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
        screening: Every effect by its sensitivities.
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
        self.screening = Screening(effects, evidence)
        self.ended: dict[tuple[str, ...], Candidate] = {}

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

    def first(self) -> Fit | None:
        """A single effect or law, the best by its linear fit or the likeliest; None if neither is accepted."""
        return self._next(None, self.screening.groups(None), size=1)

    def forward_selection(self) -> Fit | None:
        """The selected effects; None if none is accepted."""
        # In recordings library effects come first: friction is in all of them, and laws describe the remainder.
        chosen = self._extend(None, laws=self.source.repeated)
        if not self.source.repeated and any(single.effects[0].family for single in self.screening.singles.values()):
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
        start = self.screening.linearised(replace(candidate, point=point, origin=()))
        if start is None:
            return None
        return self._measured_again(Fit.of(start, self.evidence).at_point)

    def _extend(self, chosen: Fit | None, laws: bool = True) -> Fit | None:
        """Add effects, and ``laws`` too or not, until none is accepted."""
        while chosen is None or len({e.family or e.name for e in chosen.candidate.effects}) < MAX_EFFECTS:
            if chosen is not None and (left := chosen.lack_of_fit()) is not None and left > SIGNIFICANCE_LEVEL:
                break
            if chosen is not None and self._budget.leaves_out("further effects beside " + _named(chosen)):
                break  # the first effect is looked for in any case: without it nothing would seem to be missing
            best = self._next(chosen, self.screening.groups(chosen, laws))
            if best is None and not self.source.of_motion:
                best = self._pair_at_once(chosen)
            if best is None:
                break
            chosen = self._measured_again(best)
            self.screening.add_visible_with(chosen)
        return chosen

    def _next(
        self,
        chosen: Fit | None,
        groups: Sequence[str],
        p_values: Mapping[str, float] | None = None,
        size: int | None = None,
    ) -> Fit | None:
        """The best of some effects or groups beside the chosen ones, fitted by simulation; None: none is accepted.

        Args:
            chosen: The chosen effects.
            groups: Effects or groups that may be added at once.
            p_values: Adjusted, of the groups; None: those of all effects and groups that may be accepted.
            size: Candidates that are fitted by simulation; None: ``SHORTLIST_SIZE``.
        """
        p_values = self.screening.p_values(chosen) if p_values is None else p_values
        possible = [group for group in groups if self.screening.ruled_out.isdisjoint(group.split("+"))]
        likely = [group for group in possible if p_values[group] < SIGNIFICANCE_LEVEL]
        # Sensitivities at nominal may miss an effect that acts far from there: then fits and hold-out decide.
        if not likely and chosen is None and self.has_lack_of_fit and self.source.repeated:
            likely = sorted(possible, key=lambda group: p_values[group])[:SHORTLIST_SIZE]
        apart = {name for group in likely for name in group.split("+")}
        self.screening.find_shapes(apart)
        linear = self.screening.with_shapes([self.screening.linear_fit_with(chosen, group) for group in likely])
        for entry in linear:
            self._report_progress(entry)
        if chosen is None and not self.has_lack_of_fit:  # then only effects beyond a relevance limit are accepted
            linear = list(filter(exceeds_relevance_limit, linear))
        size = SHORTLIST_SIZE if size is None else size
        shortlist, others = linear[:size], linear[size:]
        if chosen is None and others:  # the first effect may act far from nominal, where linear fits mislead
            shortlist.append(min(others, key=lambda entry: p_values["+".join(entry.candidate.names)]))
        return self._best(shortlist, chosen)

    def _pair_at_once(self, chosen: Fit | None) -> Fit | None:
        """Two effects that lower the error only together, as restitution and its decrease with speed; None: no pair.

        Each must be significant given the other. For tables of impacts alone, whose predictions are cheap.
        """
        alone = self.screening.groups(chosen, laws=False)
        pairs = ["+".join(pair) for pair in combinations(alone, 2)]
        p_values = benjamini_hochberg(self.screening.p_values_of(pairs, chosen), len(alone) + len(pairs))
        pairs = [pair for pair in pairs if p_values[pair] < SIGNIFICANCE_LEVEL]
        best = self._next(chosen, pairs, p_values) if pairs else None
        added = () if best is None else best.candidate.names[-2:]
        if best is None or any(self.p_value_of_chosen(best, name) >= SIGNIFICANCE_LEVEL for name in added):
            return None
        return best

    def leave_one_out_residuals(self, chosen: Fit | None) -> list[Array]:
        """Leave-one-out residuals with the chosen effects, ``(F,)`` per cluster [-]."""
        return self.evidence.means if chosen is None else chosen.problem.leave_one_out_residuals

    def fitted(self, names: Sequence[str]) -> Fit | None:
        """Some effects fitted together; None if one of them changes no feature, also in the presence of the others."""
        seen = [name for name in names if name in self.screening.singles]
        if not seen:
            return None
        joined = reduce(Candidate.beside, (self.screening.best_shape(self.screening.singles[name]) for name in seen))
        found = restart_from_afar(gauss_newton(self._refined(joined, self.evidence)))
        if len(seen) == len(names):
            return found
        self.screening.add_visible_with(found)
        return self.fitted(names) if all(name in self.screening.singles for name in names) else None

    def _refined(self, start: Candidate, evidence: Evidence, give_up: float = np.inf) -> Fit:
        """The fit by :func:`chord_method`, from the known optimum of the same effects if there is one.

        The optimum comes from all clusters, so parameters that these clusters do not show stay at their start.
        """
        known = self._known.get(start.names)
        if known is not None:
            point = known.point.copy()
            point[start.unseen] = start.point[start.unseen]
            there = replace(known.only(evidence.numbers), origin=start.origin, point=point)
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
        fits = [self.screening.linear_fit_with(None, name)]
        ended = self.ended.get((name,))
        moved = None if ended is None else evaluate_at(replace(ended, origin=()), ended.point, self.evidence)
        if moved is not None:
            fits.append(Fit.of(moved, self.evidence))
        return min(fits, key=lambda fitted: fitted.score)

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
        before = self.leave_one_out_residuals(chosen)
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
        for name in self.screening.singles:
            if name in chosen.names or name in self.screening.ruled_out:
                continue
            single = self.screening.start(name)
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
        return self.screening.linearised(Candidate.of((LINK_ERRORS,), self.source))

    def _in_place_of(self, chosen: Fit, name: str, start: Candidate) -> Fit | None:
        """Linear fit of another effect in the place of a chosen one; None if it cannot be simulated."""
        swapped = self._others(chosen, name).beside(start)
        moved = evaluate_at(swapped, swapped.point, chosen.evidence)
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
                for other in self.screening.singles
                if other not in chosen.candidate.names
                and other not in self.screening.ruled_out
                and (swapped := self._in_place_of(chosen, name, self.screening.start(other))) is not None
            ]
            if self.source.recording is not None:  # whose predictions are cheap
                proposals = self.screening.with_shapes(proposals)
            for linear in sorted(proposals, key=lambda entry: entry.score)[:count]:
                other = linear.candidate.names[-1]
                if linear.score > hopeless * chosen.score:
                    continue
                if self._budget.leaves_out(f"{other} in the place of {name}"):
                    continue
                fitted = gauss_newton(self._refined(linear.candidate, chosen.evidence, hopeless * chosen.score))
                equal = tied(chosen, fitted) and not in_the_limit(fitted, other)
                found.append(Rival(other, name, fitted, equal and not encompasses(chosen, name, fitted, other)))
        return found


def _named(fitted: Fit) -> str:
    """Names of the effects of a fit, for messages."""
    return " and ".join(fitted.candidate.names)


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
