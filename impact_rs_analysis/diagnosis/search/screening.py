# SPDX-License-Identifier: Apache-2.0
"""Screening of effects: sensitivities and score tests of every effect, alone and in the presence of chosen effects.

Sensitivities are derivatives at nominal or at starts suggested by the measurements, and secants if an effect changes
nothing at nominal. An effect that free motion rules out is not fitted.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import reduce
from itertools import product

import numpy as np

from impact_rs_analysis.diagnosis.search.candidate import Candidate, linearise, required_predictions
from impact_rs_analysis.diagnosis.search.fit import Evidence, Fit, has_shape_parameter
from impact_rs_analysis.diagnosis.search.null_distribution import benjamini_hochberg
from impact_rs_analysis.diagnosis.thresholds import MIN_P_IN_FREE_MOTION
from impact_rs_analysis.evidence.cluster import Added
from impact_rs_sim.effects import Effect
from impact_rs_sim.robots.robot import Array

MIN_SECANT_RATIO = 1.5  # number of features changed by a secant over features changed at nominal: another contact mode
MIN_FEATURE_CHANGE = 1e-6  # scaled features per parameter scale; the solver's rounding


class Screening:
    """Every effect by its sensitivities.

    Args:
        effects: Effects to consider; several with one name are one effect with several starts of its shape. The best
            start is kept.
        evidence: Residuals of the model.

    Attributes:
        singles: Every measurable effect, linearised at nominal or at its best start, or by secants if it changes
            nothing there; in the presence of chosen effects if it changes nothing alone.
        not_simulated: Effects that cannot be simulated at their start.
        ruled_out: Effects that free motion rules out.
    """

    def __init__(self, effects: Sequence[Effect], evidence: Evidence) -> None:
        self.evidence, self.source = evidence, evidence.source
        self.singles: dict[str, Candidate] = {}
        self.ruled_out: set[str] = set()
        self.not_simulated: set[str] = set()
        self._starts_tried = Counter(effect.name for effect in effects)
        self._starts: dict[str, list[Candidate]] = {}
        self._insensitive: dict[str, Candidate] = {}
        self._insensitive_alone: dict[str, Candidate] = {}  # visible in the presence of chosen effects
        self._given_chosen: dict[tuple[str, Added], Candidate] = {}
        self._screen(effects)

    def _screen(self, effects: Sequence[Effect]) -> None:
        """Sensitivities of all effects at nominal and at starts by the measurements, in one parallel batch."""
        candidates = [Candidate.of((effect,), self.source) for effect in effects]
        for effect in effects:
            starts = self.source.starts(effect.name)
            candidates += [Candidate.of((effect,), self.source, start) for start in starts]
            self._starts_tried[effect.name] += len(starts)
        self._rule_out(candidates)
        candidates = [candidate for candidate in candidates if candidate.names[0] not in self.ruled_out]
        batch = [
            item
            for candidate in candidates
            for item in required_predictions(candidate, self.evidence.numbers, self.source)
        ]
        self.source.predict(batch, "sensitivities of all effects")
        for candidate in candidates:
            name, linearised = candidate.names[0], self.linearised(candidate)
            if linearised is None:
                self.not_simulated.add(name)
                continue
            linearised, previous = self._with_secants(linearised), self.singles.get(name)
            if not linearised.has_sensitivity:
                self._insensitive[name] = linearised
            elif previous is None or self._misfit(linearised) < self._misfit(previous):
                self.singles[name] = linearised
        for name in self.singles:
            self._insensitive.pop(name, None)
        self.not_simulated -= {*self.singles, *self._insensitive}

    def _misfit(self, candidate: Candidate) -> float:
        return Fit.of(candidate, self.evidence).misfit

    def _with_secants(self, candidate: Candidate, base: Added = ()) -> Candidate:
        """The candidate with secants as sensitivities of parameters that change more features far from nominal.

        A sticking contact does not depend on its friction until it slips, and a frictionless contact has no tangential
        restitution until the model has friction; ``base`` holds such other effects. If a few impacts slip and most
        stick, friction changes hardly any feature at nominal. Predictions of impacts are cheap: every parameter is
        probed, and the secant to the point with the most changed features is taken. In motions only parameters without
        sensitivity are probed, up to the nearest point at which a feature changes.
        """
        if not any(effect.seen_in(item.contact) for effect in candidate.effects for item in self.evidence.clusters):
            return candidate
        features = sum(item.sigma.size for item in self.evidence.clusters)
        for index, scalar in enumerate(candidate.scalars):
            changed_at_point = _changed([jacobian[:, index] for jacobian in candidate.jacobians])
            if (
                scalar.shape
                or (changed_at_point and self.source.of_motion)
                or MIN_SECANT_RATIO * changed_at_point >= features
            ):
                continue
            best_columns, most_changed = None, MIN_SECANT_RATIO * changed_at_point
            for point in candidate.probes(index):
                columns = self._secant(candidate, index, point[index], base)
                if columns is not None and (changed := _changed(columns)) > most_changed:
                    best_columns, most_changed = columns, changed
                    if self.source.of_motion:
                        break
            if best_columns is not None:
                candidate = candidate.with_sensitivity(index, best_columns)
        return candidate

    def _secant(self, candidate: Candidate, index: int, value: float, base: Added) -> list[Array] | None:
        """Secant of one parameter from the point to a value: scaled change per parameter scale, ``(F,)`` by cluster."""
        point = candidate.point.copy()
        point[index] = value
        before, after = ((*base, *candidate.effects_at(vector)) for vector in (candidate.point, point))
        changes = self.source.differences(self.evidence.numbers, before, after, "probes of effects")
        steps = (value - candidate.point[index]) / candidate.scale[index]
        pairs = list(zip(changes, self.evidence.clusters, strict=True))
        columns = [change / (item.sigma * steps) for change, item in pairs if change is not None]
        return columns if len(columns) == len(pairs) else None

    def with_sensitivities_given(self, single: Candidate, chosen: Fit | None) -> Candidate:
        """An effect with its sensitivities in the presence of the chosen effects.

        Effects in impacts do not superpose: rolling resistance acts differently on a slipping and on a sticking body.
        Predictions of motions are expensive, so superposition is assumed.
        """
        name = single.names[0]
        if chosen is None:
            return self._insensitive_alone.get(name, single)
        if self.source.of_motion:
            return single
        base = chosen.candidate.effects_at(chosen.estimate)
        if (name, base) not in self._given_chosen:
            for index, step in enumerate(single.steps(self.source.joints)):
                columns = self._secant(single, index, single.point[index] + step, base)
                if columns is not None:
                    single = single.with_sensitivity(index, columns)
            self._given_chosen[name, base] = self._with_secants(single, base)
        return self._given_chosen[name, base]

    def add_visible_with(self, chosen: Fit) -> None:
        """Add effects that change some feature only in the presence of the chosen ones."""
        base = chosen.candidate.effects_at(chosen.estimate)
        for name in sorted(self._insensitive):
            candidate = self._with_secants(self._insensitive[name], base)
            if candidate.has_sensitivity:
                self.singles[name] = candidate
                self._insensitive_alone[name] = self._insensitive.pop(name)

    def keep(self, names: Collection[str]) -> None:
        """Drop all effects but these."""
        self.singles = {name: candidate for name, candidate in self.singles.items() if name in names}
        self._insensitive = {name: candidate for name, candidate in self._insensitive.items() if name in names}

    @property
    def unmeasured(self) -> set[str]:
        """Effects without sensitivity in any measured feature."""
        return set(self._insensitive)

    def linearised(self, candidate: Candidate, evidence: Evidence | None = None) -> Candidate | None:
        evidence = evidence or self.evidence
        return linearise(candidate, evidence.clusters, evidence.numbers, self.source)

    def _rule_out(self, candidates: Sequence[Candidate]) -> None:
        """Rule out effects with several parameters by their p-value in free motion.

        Simulators agree in free motion and differ in contact; there an effect with one parameter per joint explains a
        part of any difference. Such an effect is tested in free motion only and not simulated in contact.
        """
        free_motion, source = self.evidence.free_motion_part, self.source.free_motion_part
        if free_motion is None or source is None or free_motion.null.shortage is not None:
            return
        several = [candidate for candidate in candidates if np.count_nonzero(~candidate.shapes) > 1]
        source.predict(
            [
                prediction
                for candidate in several
                for prediction in required_predictions(candidate, free_motion.numbers, source)
            ],
            "sensitivities in free motion",
        )
        linearised = [linearise(candidate, free_motion.clusters, free_motion.numbers, source) for candidate in several]
        sensitive = [candidate for candidate in linearised if candidate is not None and candidate.has_sensitivity]
        p_values = dict[str, float]()
        for candidate, p_value in zip(
            sensitive, free_motion.null.p_values([candidate.jacobians for candidate in sensitive]), strict=True
        ):
            p_values[candidate.names[0]] = min(
                p_value, p_values.get(candidate.names[0], 1.0)
            )  # of several starts of its shape
        self.ruled_out = {name for name, p_value in p_values.items() if p_value > MIN_P_IN_FREE_MOTION}
        for candidate in sensitive:
            if candidate.names[0] in self.ruled_out:
                extended, previous = (
                    self.evidence.extended_beyond_free_motion(candidate),
                    self.singles.get(candidate.names[0]),
                )
                if previous is None or self._misfit(extended) < self._misfit(previous):
                    self.singles[candidate.names[0]] = extended

    def starts(self, name: str) -> list[Candidate]:
        """Possible starts of the fit of an effect; several for effects of :meth:`find_shapes`."""
        return self._starts.get(name, [self.singles[name]])

    def find_shapes(self, names: Iterable[str]) -> None:
        """Linearise some effects at the grid points of their shapes, as further starts of their fits."""
        self._starts |= {name: self._linearised_at_shapes(name) for name in names if name not in self._starts}

    def _linearised_at_shapes(self, name: str) -> list[Candidate]:
        """An effect at its start, and at the grid points of its shape parameters.

        A shape without sensitivity at nominal, such as the centre of a payload of mass 0, is linearised again at the
        fit of the other parameters. In recordings only: their torque is linear in mass and first moment.
        """
        candidate = self.singles[name]
        shapes = [index for index, scalar in enumerate(candidate.scalars) if scalar.grid]
        candidates = [candidate]
        for values in product(*(candidate.scalars[index].grid for index in shapes)) if shapes else ():
            point = candidate.point.copy()
            point[shapes] = values
            if (linearised := self.linearised(replace(candidate, point=point))) is not None:
                candidates.append(linearised)
        if candidate.insensitive and self.source.recording is not None:
            point = Fit.of(candidate, self.evidence).estimate
            if (linearised := self.linearised(replace(candidate, point=point))) is not None:
                candidates.append(linearised)
        return candidates

    def best_start(self, name: str, chosen: Fit | None) -> Candidate:
        """The start of an effect with the lowest misfit of the linear fit with the chosen effects.

        The best shape depends on the other effects: alone, friction that fades at high speed imitates Coulomb friction.
        """

        def misfit(start: Candidate) -> float:
            if chosen is None:
                return Fit.of(start, self.evidence).misfit
            return Fit.of(chosen.candidate.joined_with(start), chosen.evidence).misfit

        starts = self.starts(name)
        return starts[0] if len(starts) == 1 else min(starts, key=misfit)

    def p_values(self, chosen: Fit | None) -> dict[str, float]:
        """Adjusted p-value of each effect given the chosen effects, and of each law at all joints (:meth:`groups`)."""
        return self.adjusted(self.raw_p_values(chosen))

    def adjusted(self, p_values: Mapping[str, float]) -> dict[str, float]:
        """Benjamini-Hochberg adjusted p-values; every start of a shape is one test."""
        return benjamini_hochberg(p_values, sum(max(1, self._starts_tried[name]) for name in p_values))

    def raw_p_values(self, chosen: Fit | None) -> dict[str, float]:
        """:meth:`p_values` without adjustment for multiple testing, at the best start of every effect."""
        return self.p_values_of(self.groups(chosen), chosen)

    def groups(self, chosen: Fit | None, laws: bool = True) -> list[str]:
        """Candidates of one selection step: effects, and laws at several joints, joined by ``+``.

        Args:
            chosen: The chosen effects.
            laws: Whether laws are considered in addition to the effects of the library.
        """
        present = () if chosen is None else chosen.candidate.names
        family_of = {name: single.effects[0].family for name, single in self.singles.items() if name not in present}
        singles = [name for name, family in family_of.items() if laws or not family]
        families: dict[str, list[str]] = {}
        for name in singles:
            families.setdefault(family_of[name], []).append(name)
        return singles + ["+".join(members) for family, members in families.items() if family and len(members) > 1]

    def joined(self, group: str, chosen: Fit | None) -> Candidate:
        """A group at the best starts of its fits, in the presence of the chosen effects."""
        starts = [self.best_start(name, chosen) for name in group.split("+")]
        return reduce(
            Candidate.joined_with,
            (s if has_shape_parameter(s) else self.with_sensitivities_given(s, chosen) for s in starts),
        )

    def p_values_of(self, groups: Sequence[str], chosen: Fit | None) -> dict[str, float]:
        """:meth:`raw_p_values` of some groups, by their sensitivities in the presence of the chosen effects."""
        joined = {}
        for group in groups:
            group_candidate = reduce(
                Candidate.joined_with,
                (self.with_sensitivities_given(self.singles[name], chosen) for name in group.split("+")),
            )
            joined[group] = group_candidate if chosen is None else chosen.candidate.joined_with(group_candidate)
        null = (self.evidence if chosen is None else chosen.residual_evidence).null
        first = 0 if chosen is None else chosen.candidate.point.size
        tested = [[jacobian[:, first:] for jacobian in fitted.jacobians] for fitted in joined.values()]
        fitted = () if chosen is None else chosen.candidate.jacobians
        return dict(zip(joined, null.p_values(tested, fitted), strict=True))

    def with_shapes(self, linear: Sequence[Fit]) -> list[Fit]:
        """Linear fits, best first; insensitive shapes are linearised again at the fitted amplitudes.

        The length of a cable changes nothing while the cable is slack. At the start of its fit it may pull in a few
        conditions only, and then predict all conditions worse than another effect.
        """
        fits = {entry.candidate.names: entry for entry in linear}
        insensitive = [entry for entry in linear if entry.candidate.insensitive_shapes]
        for entry in insensitive:
            linearised = self.linearised(replace(entry.candidate, point=entry.estimate), entry.evidence)
            if linearised is not None and (refitted := Fit.of(linearised, entry.evidence)).score < entry.score:
                fits[entry.candidate.names] = refitted
        return sorted(fits.values(), key=lambda entry: entry.score)

    def linear_fit_with(self, chosen: Fit | None, group: str) -> Fit:
        """Linear fit of one more effect or group; with a shape parameter it is linearised with the chosen effects.

        Alone such an effect imitates others: friction that decreases with speed imitates an offset.
        """
        start = self.joined(group, chosen)
        if chosen is None:
            return Fit.of(start, self.evidence)
        joined = Fit.of(chosen.candidate.joined_with(start), chosen.evidence)
        if not has_shape_parameter(start):
            return joined
        linearised = self.linearised(replace(joined.candidate, point=joined.estimate), chosen.evidence)
        return joined if linearised is None else Fit.of(linearised, chosen.evidence)


def _changed(columns: Sequence[Array]) -> int:
    """Number of features with nonzero sensitivity, over all clusters."""
    return int(np.count_nonzero(np.abs(np.concatenate(columns)) > MIN_FEATURE_CHANGE)) if columns else 0
