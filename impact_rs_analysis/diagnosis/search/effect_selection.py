# SPDX-License-Identifier: Apache-2.0
"""Selection of effects: forward selection, backward elimination and exchange, by cross-validated error.

All effects are screened by score tests with a false discovery rate (Benjamini and Hochberg 1995), the likeliest effects
are fitted by simulation, and an effect is accepted if it lowers the leave-one-out error. The search uses only the
clusters of its evidence: the hold-out (:mod:`impact_rs_analysis.diagnosis.search.hold_out`) repeats it without the
clusters that it predicts.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
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
from impact_rs_analysis.diagnosis.search.model_comparison import Rival, encompasses, is_degenerate, simplest, tied
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

NO_OPTIMA: Mapping[tuple[str, ...], Candidate] = MappingProxyType({})

ProgressCallback = Callable[[str, float], None]


class Search:
    """Search over effects.

    Args:
        effects: Effects to consider; several with one name are one effect with several starts of its shape. The best
            start is kept.
        evidence: Residuals of the model in the clusters of the search.
        progress: Called after every fit with the effects joined by ``+`` and their leave-one-out error, on the scale of
            :meth:`Evidence.size`.
        full_data_optima: Starts of fits by the names of their effects: the estimates from all clusters of the source.
            Fits end at the optimum of this evidence.
        earlier: Estimates of an earlier search or model: a further start for chosen effects whose residuals exceed
            noise.

    Attributes:
        screening: Every effect by its sensitivities.
        optima: Results of fits by simulation, by the names of their effects.
    """

    def __init__(
        self,
        effects: Sequence[Effect],
        evidence: Evidence,
        progress: ProgressCallback = lambda *_: None,
        full_data_optima: Mapping[tuple[str, ...], Candidate] = NO_OPTIMA,
        earlier: Added = (),
    ) -> None:
        self.evidence, self.source, self._progress, self._full_data_optima = (
            evidence,
            evidence.source,
            progress,
            full_data_optima,
        )
        self._budget = evidence.budget
        self._earlier = earlier
        self.screening = Screening(effects, evidence)
        self.optima: dict[tuple[str, ...], Candidate] = {}

    def p_value_of_chosen(self, chosen: Fit, name: str) -> float:
        """p-value of a chosen effect given the other chosen effects, not adjusted for multiple testing.

        The score test uses sensitivities at the estimate: at nominal they may be zero, as for a restitution, which
        changes features only if a contact opens. They may vanish at the estimate as well, so they are corrected to
        reproduce the change of the features by the fit (:func:`secant_update`). The statistic T is then at least the
        decrease of the squared residual, twice the log likelihood ratio of the fit under normal noise.
        """
        others = self.without(chosen, name) if len(chosen.candidate.effects) > 1 else None
        candidate, part = chosen.candidate, chosen.candidate.part(name)
        residuals = self.evidence if others is None else others.residual_evidence
        fitted = () if others is None else others.candidate.jacobians
        changes = [first - second for first, second in zip(residuals.means, chosen.residuals, strict=True)]
        return residuals.null.p_value(
            secant_update(
                [jacobian[:, part] for jacobian in candidate.jacobians], changes, chosen.distance_from_nominal[part]
            ),
            fitted,
        )

    def first(self) -> Fit | None:
        """The single effect or law with the best linear fit or the smallest p-value; None if neither is accepted."""
        return self._next(None, self.screening.groups(None), size=1)

    def forward_selection(self) -> Fit | None:
        """The selected effects; None if none is accepted."""
        # Without repeats library effects come first: every recording has friction, and laws describe the remainder.
        chosen = self._extend(None, laws=self.source.repeated)
        if not self.source.repeated and any(single.effects[0].family for single in self.screening.singles.values()):
            chosen = self._extend(chosen)
        if chosen is None:
            return None
        return self._out_of_local_minima(self._backward_elimination(chosen))

    def _out_of_local_minima(self, chosen: Fit) -> Fit:
        """The chosen effects, after a global search if trials have a lack of fit that no effect explains."""
        lack_of_fit = chosen.lack_of_fit() if self.source.of_motion else None
        if (
            lack_of_fit is None
            or lack_of_fit > SIGNIFICANCE_LEVEL
            or self._budget.leaves_out("other minima of the error")
        ):
            return chosen
        earlier = self._from_earlier_estimates(chosen)
        if earlier is not None and not self._hardly_better(earlier, chosen):
            return self._extend(earlier) or chosen
        if self._full_data_optima:  # a hold-out: the search of all clusters has looked
            return chosen
        refitted = nelder_mead(chosen)
        if self._hardly_better(refitted, chosen):
            return chosen
        return self._extend(self._final_fit(refitted)) or chosen

    def _hardly_better(self, refitted: Fit, chosen: Fit) -> bool:
        return refitted.misfit > (1.0 - MIN_GAIN_SHARE) * chosen.misfit

    def _from_earlier_estimates(self, chosen: Fit) -> Fit | None:
        """The chosen effects fitted from earlier estimates; None: some effect has no earlier estimate.

        Every run is replayed: with sticking joints, one run per condition has another optimum than all runs.
        """
        candidate, estimates = chosen.candidate, dict(self._earlier)
        if not estimates.keys() >= set(candidate.names):
            return None
        point = np.concatenate([estimates[name] for name in candidate.names])
        start = self.screening.linearised(replace(candidate, point=point, origin=()))
        if start is None:
            return None
        return self._final_fit(Fit.of(start, self.evidence).at_point)

    def _extend(self, chosen: Fit | None, laws: bool = True) -> Fit | None:
        """Add effects, including laws if ``laws``, until no further one is accepted."""
        while chosen is None or len({e.family or e.name for e in chosen.candidate.effects}) < MAX_EFFECTS:
            if chosen is not None and (p_value := chosen.lack_of_fit()) is not None and p_value > SIGNIFICANCE_LEVEL:
                break
            if chosen is not None and self._budget.leaves_out("effects in addition to " + _named(chosen)):
                break  # the first effect is searched for in any case: without it nothing would seem to be missing
            best = self._next(chosen, self.screening.groups(chosen, laws))
            if best is None and not self.source.of_motion:
                best = self._pair_at_once(chosen)
            if best is None:
                break
            chosen = self._final_fit(best)
            self.screening.add_visible_with(chosen)
        return chosen

    def _next(
        self,
        chosen: Fit | None,
        groups: Sequence[str],
        p_values: Mapping[str, float] | None = None,
        size: int | None = None,
    ) -> Fit | None:
        """The best effect or group to add to the chosen effects, fitted by simulation; None: no one is accepted.

        Args:
            chosen: The chosen effects.
            groups: Effects or groups that may be added at once.
            p_values: Adjusted p-values of the groups; None: p-values of all effects and groups are computed.
            size: Number of candidates that are fitted by simulation; None: ``SHORTLIST_SIZE``.
        """
        p_values = self.screening.p_values(chosen) if p_values is None else p_values
        allowed = [group for group in groups if self.screening.ruled_out.isdisjoint(group.split("+"))]
        likely = [group for group in allowed if p_values[group] < SIGNIFICANCE_LEVEL]
        # Sensitivities at nominal may miss an effect that acts far from nominal: then fits and hold-out decide.
        if not likely and chosen is None and self.has_lack_of_fit and self.source.repeated:
            likely = sorted(allowed, key=lambda group: p_values[group])[:SHORTLIST_SIZE]
        names = {name for group in likely for name in group.split("+")}
        self.screening.find_shapes(names)
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

        Each must be significant given the other. Used for tables of impacts only: their predictions are cheap.
        """
        singles = self.screening.groups(chosen, laws=False)
        pairs = ["+".join(pair) for pair in combinations(singles, 2)]
        p_values = benjamini_hochberg(self.screening.p_values_of(pairs, chosen), len(singles) + len(pairs))
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
        """Some effects fitted together; None if one changes no feature, even in the presence of the others."""
        measurable = [name for name in names if name in self.screening.singles]
        if not measurable:
            return None
        self.screening.find_shapes(measurable)
        linear: Fit | None = None
        for name in measurable:
            start = self.screening.best_start(name, linear)
            linear = Fit.of(start if linear is None else linear.candidate.joined_with(start), self.evidence)
        assert linear is not None
        fit = restart_from_afar(gauss_newton(self._refined(linear.candidate, self.evidence)))
        if len(measurable) == len(names):
            return fit
        self.screening.add_visible_with(fit)
        return self.fitted(names) if all(name in self.screening.singles for name in names) else None

    def _refined(self, start: Candidate, evidence: Evidence, give_up: float = np.inf) -> Fit:
        """The fit by :func:`chord_method`, from the optimum of the same effects in all clusters if there is one.

        Parameters to which the clusters of this search are insensitive stay at their start.
        """
        optimum = self._full_data_optima.get(start.names)
        if optimum is not None:
            point = optimum.point.copy()
            point[start.insensitive] = start.point[start.insensitive]
            at_optimum = replace(optimum.only(evidence.numbers), origin=start.origin, point=point)
            start = evaluate_at(at_optimum, at_optimum.point, evidence) or start
        return self._store(chord_method(start, evidence, give_up))

    def _final_fit(self, fitted: Fit) -> Fit:
        """Final fit, continued by a downhill simplex if it stalls; not again in folds, which start at the result."""
        at_optimum = fitted.candidate.names in self._full_data_optima
        refitted = replay_and_refit(fitted, at_optimum)
        if self.source.repeated and not at_optimum and refitted.stalled and not refitted.out_of_time:
            refitted = replay_and_refit(nelder_mead(refitted))
        return self._store(refitted)

    def finished(self, fitted: Fit) -> Fit:
        """A reported fit, continued to convergence if the processor time had ended it.

        Intervals need the optimum: away from it the error does not rise towards both ends.
        """
        if fitted.converged:
            return fitted
        evidence = replace(fitted.evidence, budget=self._budget.without_limit())
        return self._store(gauss_newton(replace(fitted, evidence=evidence)))

    def _store(self, fitted: Fit) -> Fit:
        self.optima[fitted.candidate.names] = fitted.candidate
        return fitted

    def _report_progress(self, fitted: Fit) -> None:
        self._progress("+".join(fitted.candidate.names), self.evidence.size(fitted.leave_one_out_errors))

    @property
    def has_lack_of_fit(self) -> bool:
        """Whether the lack-of-fit test is significant or impossible; if not, only relevant effects are added."""
        p_value = self.evidence.lack_of_fit
        return p_value is None or p_value < SIGNIFICANCE_LEVEL

    def fit_alone(self, name: str) -> Fit:
        """Fit of one effect alone: the linear fit or the simulated optimum, whichever has the lower score."""
        fits = [self.screening.linear_fit_with(None, name)]
        optimum = self.optima.get((name,))
        evaluated = None if optimum is None else evaluate_at(replace(optimum, origin=()), optimum.point, self.evidence)
        if evaluated is not None:
            fits.append(Fit.of(evaluated, self.evidence))
        return min(fits, key=lambda fitted: fitted.score)

    def _best(self, shortlist: Sequence[Fit], chosen: Fit | None) -> Fit | None:
        """The shortlist fitted by simulation: the best, or among ties the one with the fewest parameters."""
        proposals: list[Fit] = []
        for entry in shortlist:
            if proposals and self._budget.leaves_out(_named(entry)):  # the best linear fit is tried in any case
                continue
            lowest = min((proposal.score for proposal in proposals), default=np.inf)
            proposals.append(self._refined(entry.candidate, entry.evidence, MAX_ERROR_RATIO * lowest))
            self._report_progress(proposals[-1])
        if not proposals:
            return None
        proposals.sort(key=lambda proposal: proposal.score)
        lowest = proposals[0].score
        for number, proposal in enumerate(proposals):
            if proposal.out_of_time:
                break
            if proposal.score <= MAX_ERROR_RATIO * lowest and proposal.candidate.names not in self._full_data_optima:
                proposals[number] = self._store(restart_from_afar(gauss_newton(proposal)))
        first_new = 0 if chosen is None else chosen.change.size
        before = self.leave_one_out_residuals(chosen)
        proposals = [
            entry for entry in proposals if entry.evidence.lowers_excess(before, entry.problem.leave_one_out_residuals)
        ]
        if not self.source.repeated:
            proposals = [proposal for proposal in proposals if noticeable(proposal, first_new)]
        return simplest(proposals) if proposals else None

    def _backward_elimination(self, chosen: Fit, max_log_ratio: float = 0.0) -> Fit:
        """Backward elimination: the fit without redundant effects.

        Args:
            chosen: The fit.
            max_log_ratio: Largest log ratio of scores at which an effect is redundant.
        """
        for name in chosen.candidate.names:
            if len(chosen.candidate.effects) == 1:
                break
            fitted = self.without(chosen, name)
            if fitted is not None and fitted.score <= chosen.score * math.exp(max_log_ratio):
                return self._backward_elimination(fitted, max_log_ratio)
        return chosen

    def without(self, chosen: Fit, name: str) -> Fit | None:
        """The other chosen effects, fitted again; None if they cannot be simulated."""
        others = self._remaining_effects(chosen, name)
        reduced = evaluate_at(others, others.point, chosen.evidence)
        return None if reduced is None else self._refined(reduced, chosen.evidence)

    @staticmethod
    def _remaining_effects(chosen: Fit, name: str) -> Candidate:
        """The chosen effects except one, at their estimates, with unchanged sensitivities."""
        return replace(chosen.candidate, point=chosen.estimate).without(name)

    def joint_alternatives(self, fitted: Fit, index: int) -> list[tuple[str, Candidate]]:
        """Rivals at one joint: its parameter is replaced by the parameters of another effect at the same joint."""
        chosen, scalar = fitted.candidate, fitted.candidate.scalars[index]
        others = chosen.fixed(index)
        alternatives = []
        for name in self.screening.singles:
            if name in chosen.names or name in self.screening.ruled_out:
                continue
            starts = self.screening.starts(name)
            single = starts[0]
            at_joint = [
                number
                for number, parameter in enumerate(single.scalars)
                if (parameter.arm, parameter.joint) == (scalar.arm, scalar.joint)
            ]
            elsewhere = [number for number in range(single.point.size) if number not in at_joint]
            if at_joint and len(at_joint) < single.point.size:
                replaced = [others.joined_with(start.fixed(*elsewhere)) for start in starts]
                alternatives.append((name, min(replaced, key=lambda entry: Fit.of(entry, fitted.evidence).misfit)))
        return alternatives

    def exchange(self, chosen: Fit) -> tuple[Fit, list[Rival]]:
        """Exchange effects for better ones, or for tied ones with fewer parameters; list the remaining rivals.

        A constant vertical force is attributed to a payload rather than to a spring or to gains of all joints. Forward
        selection is greedy: together with later effects, another effect may predict far better than the first.
        """
        rivals, visited = self.rivals(chosen), {frozenset(chosen.candidate.names)}
        for _ in range(MAX_EFFECTS):
            alternatives = [rival.fit for rival in rivals if rival.tied]
            if len(chosen.candidate.names) > 1:  # a rival of one effect may explain the other effects as well
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
            extended = self._extend(self._final_fit(best)) or chosen
            if (names := frozenset(extended.candidate.names)) in visited:
                break
            visited.add(names)
            chosen, rivals = extended, self.rivals(extended)
        return chosen, rivals

    def explained_by_links(self, chosen: Fit, name: str) -> bool:
        """Whether errors of the links within their uncertainty predict as well in place of a chosen load (linear fit).

        A load on the last link and errors of the links change the same inertial parameters, and no single link effect
        has as many parameters as a body. For recordings: their torque is linear in inertial parameters.
        """
        effect = next(item for item in chosen.candidate.effects if item.name == name)
        if self.source.recording is None or effect.acts_on != LINK_ERRORS.acts_on or not effect.may_change:
            return False
        swapped = None if self._links is None else self._exchanged(chosen, name, [self._links])
        return swapped is not None and tied(chosen, swapped)

    @cached_property
    def _links(self) -> Candidate | None:
        """Errors of the links, linearised; None if they cannot be simulated."""
        return self.screening.linearised(Candidate.of((LINK_ERRORS,), self.source))

    def _exchanged(self, chosen: Fit, name: str, starts: Sequence[Candidate]) -> Fit | None:
        """Best linear fit of another effect in the place of a chosen one; None if it cannot be simulated."""
        others = self._remaining_effects(chosen, name)
        swapped = [others.joined_with(start) for start in starts]
        evaluated = [evaluate_at(candidate, candidate.point, chosen.evidence) for candidate in swapped]
        fits = [Fit.of(candidate, chosen.evidence) for candidate in evaluated if candidate is not None]
        return min(fits, key=lambda entry: entry.misfit, default=None)

    def rivals(self, chosen: Fit, count: int = 3, max_score_ratio: float = MAX_ERROR_RATIO) -> list[Rival]:
        """Alternatives to every chosen effect, fitted together with the other chosen effects.

        Without processor time an alternative in a recording, whose torque is nearly linear, is its linear fit.

        Args:
            chosen: The chosen effects.
            count: Number of alternatives fitted in place of each effect.
            max_score_ratio: Largest score of a linear fit over the score of the chosen effects.
        """
        rivals = []
        for name in chosen.candidate.names:
            proposals = [
                swapped
                for other in self.screening.singles
                if other not in chosen.candidate.names
                and other not in self.screening.ruled_out
                and (swapped := self._exchanged(chosen, name, self.screening.starts(other))) is not None
            ]
            if self.source.recording is not None:  # predictions are cheap
                proposals = self.screening.with_shapes(proposals)
            for linear in sorted(proposals, key=lambda entry: entry.score)[:count]:
                other = linear.candidate.names[-1]
                if linear.score > max_score_ratio * chosen.score:
                    continue
                if not self._budget.leaves_out(f"{other} in the place of {name}"):
                    limit = max_score_ratio * chosen.score
                    fitted = gauss_newton(self._refined(linear.candidate, chosen.evidence, limit))
                elif self.source.recording is not None:
                    fitted = linear
                else:
                    continue
                is_tied = tied(chosen, fitted) and not is_degenerate(fitted, other)
                rivals.append(Rival(other, name, fitted, is_tied and not encompasses(chosen, name, fitted, other)))
        return rivals


def _named(fitted: Fit) -> str:
    """Names of the effects of a fit, for messages."""
    return " and ".join(fitted.candidate.names)


def secant_update(jacobians: Sequence[Array], changes: Sequence[Array], displacement: Array) -> list[Array]:
    """Broyden's rank-one update (1965): the closest sensitivities that reproduce a change of the features.

        J + (y - J x) x^T / (x^T x)

    Args:
        jacobians: Sensitivities J per cluster, ``(F, p)`` per parameter scale.
        changes: Change y of the features, ``(F,)`` per cluster.
        displacement: Change x of the parameters that made it, ``(p,)`` in scales; zero: J is returned.
    """
    squared_length = float(displacement @ displacement)
    if squared_length == 0.0:
        return list(jacobians)
    return [
        jacobian + np.outer(change - jacobian @ displacement, displacement) / squared_length
        for jacobian, change in zip(jacobians, changes, strict=True)
    ]
