# SPDX-License-Identifier: Apache-2.0
"""Screening of effects: sensitivities and score tests of every effect, alone and in the presence of chosen ones.

Sensitivities are taken at nominal, at starts by the measurements, and where an effect changes nothing at nominal along
secants. An effect that free motion rules out is not fitted.
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

MIN_SECANT_RATIO = 1.5  # features that a secant changes over those of the slope at nominal: another contact mode
MIN_FEATURE_CHANGE = 1e-6  # scaled features per parameter scale; the solver's rounding


class Screening:
    """Every effect by its sensitivities.

    Args:
        effects: Effects to consider; several of one name are one effect with several starts of its shape, of which the
            best is kept.
        evidence: Residuals of the model.

    Attributes:
        singles: Every measurable effect, linearised at nominal or at its best start, by secants where it changes
            nothing there; or in the presence of chosen effects, if it changes nothing alone.
        not_simulated: Effects that cannot be simulated at their start.
        ruled_out: Effects that free motion rules out.
    """

    def __init__(self, effects: Sequence[Effect], evidence: Evidence) -> None:
        self.evidence, self.source = evidence, evidence.source
        self.singles: dict[str, Candidate] = {}
        self.ruled_out: set[str] = set()
        self.not_simulated: set[str] = set()
        self._looks = Counter(effect.name for effect in effects)
        self._starts: dict[str, Candidate] = {}
        self._unseen: dict[str, Candidate] = {}
        self._unseen_alone: dict[str, Candidate] = {}  # visible in the presence of chosen effects
        self._beside: dict[tuple[str, Added], Candidate] = {}
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
            name, found = candidate.names[0], self.linearised(candidate)
            if found is None:
                self.not_simulated.add(name)
                continue
            found, known = self._with_secants(found), self.singles.get(name)
            if not found.seen:
                self._unseen[name] = found
            elif known is None or self._misfit(found) < self._misfit(known):
                self.singles[name] = found
        for name in self.singles:
            self._unseen.pop(name, None)
        self.not_simulated -= {*self.singles, *self._unseen}

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

    def with_sensitivities_beside(self, single: Candidate, chosen: Fit | None) -> Candidate:
        """An effect with its sensitivities in the presence of the chosen ones: impacts do not superpose.

        Rolling resistance acts differently on a body that slips than on one that sticks. For motions, whose predictions
        are expensive, superposition is assumed.
        """
        name = single.names[0]
        if chosen is None:
            return self._unseen_alone.get(name, single)
        if self.source.of_motion:
            return single
        base = chosen.candidate.split(chosen.estimate)
        if (name, base) not in self._beside:
            for index, step in enumerate(single.steps(self.source.joints)):
                columns = self._secant(single, index, single.point[index] + step, base)
                if columns is not None:
                    single = single.with_sensitivity(index, columns)
            self._beside[name, base] = self._with_secants(single, base)
        return self._beside[name, base]

    def add_visible_with(self, chosen: Fit) -> None:
        """Add effects that change some feature only in the presence of the chosen ones."""
        base = chosen.candidate.split(chosen.estimate)
        for name in sorted(self._unseen):
            found = self._with_secants(self._unseen[name], base)
            if found.seen:
                self.singles[name] = found
                self._unseen_alone[name] = self._unseen.pop(name)

    def keep(self, names: Collection[str]) -> None:
        """Forget all other effects."""
        self.singles = {name: candidate for name, candidate in self.singles.items() if name in names}
        self._unseen = {name: candidate for name, candidate in self._unseen.items() if name in names}

    @property
    def unmeasured(self) -> set[str]:
        """Effects without sensitivity in any measured feature."""
        return set(self._unseen)

    def linearised(self, candidate: Candidate, evidence: Evidence | None = None) -> Candidate | None:
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
                extended, known = self.evidence.extended_beyond_free_motion(one), self.singles.get(one.names[0])
                if known is None or self._misfit(extended) < self._misfit(known):
                    self.singles[one.names[0]] = extended

    def start(self, name: str) -> Candidate:
        """Start of the fit of a single effect."""
        return self._starts.get(name, self.singles[name])

    def find_shapes(self, names: Iterable[str]) -> None:
        """Best grid points of the shapes of some effects, from which fits start."""
        self._starts |= {name: self.best_shape(self.singles[name]) for name in names if name not in self._starts}

    def best_shape(self, candidate: Candidate) -> Candidate:
        """The candidate at the best grid point of its shape parameters, by the misfit of the linear fit.

        A shape without sensitivity at nominal, as the centre of a payload of mass 0, is linearised again at the fit of
        the other parameters: in recordings, whose torque is linear in mass and first moment; contacts are not.
        """
        shapes = [index for index, scalar in enumerate(candidate.scalars) if scalar.grid]
        tried = [candidate]
        for values in product(*(candidate.scalars[index].grid for index in shapes)) if shapes else ():
            point = candidate.point.copy()
            point[shapes] = values
            if (moved := self.linearised(replace(candidate, point=point))) is not None:
                tried.append(moved)
        if candidate.unseen and self.source.recording is not None:
            point = Fit.of(candidate, self.evidence).estimate
            if (moved := self.linearised(replace(candidate, point=point))) is not None:
                tried.append(moved)
        return min(tried, key=lambda entry: Fit.of(entry, self.evidence).misfit)

    def p_values(self, chosen: Fit | None) -> dict[str, float]:
        """Adjusted p-value of each effect given the chosen ones, and of each law at all joints (:meth:`groups`)."""
        return self.adjusted(self.raw_p_values(chosen))

    def adjusted(self, p_values: Mapping[str, float]) -> dict[str, float]:
        """Benjamini-Hochberg adjusted p-values, for tests of all of these at every start of their shapes."""
        return benjamini_hochberg(p_values, sum(max(1, self._looks[name]) for name in p_values))

    def raw_p_values(self, chosen: Fit | None) -> dict[str, float]:
        """:meth:`p_values` without adjustment for multiple testing, each at its best start."""
        return self.p_values_of(self.groups(chosen), chosen)

    def groups(self, chosen: Fit | None, laws: bool = True) -> list[str]:
        """Candidates of one selection step: an effect, or one law at several joints, joined by ``+``.

        Args:
            chosen: The chosen effects.
            laws: Whether laws are considered beside the effects of the library.
        """
        present = () if chosen is None else chosen.candidate.names
        family_of = {name: single.effects[0].family for name, single in self.singles.items() if name not in present}
        alone = [name for name, family in family_of.items() if laws or not family]
        families: dict[str, list[str]] = {}
        for name in alone:
            families.setdefault(family_of[name], []).append(name)
        return alone + ["+".join(members) for family, members in families.items() if family and len(members) > 1]

    def joined(self, group: str, chosen: Fit | None) -> Candidate:
        """A group at the starts of its fits, in the presence of the chosen effects."""
        starts = [self.start(name) for name in group.split("+")]
        return reduce(
            Candidate.beside,
            (s if has_shape_parameter(s) else self.with_sensitivities_beside(s, chosen) for s in starts),
        )

    def p_values_of(self, groups: Sequence[str], chosen: Fit | None) -> dict[str, float]:
        """:meth:`raw_p_values` of some groups, by their sensitivities in the presence of the chosen effects."""
        beside = {}
        for group in groups:
            own = reduce(
                Candidate.beside,
                (self.with_sensitivities_beside(self.singles[name], chosen) for name in group.split("+")),
            )
            beside[group] = own if chosen is None else chosen.candidate.beside(own)
        null = (self.evidence if chosen is None else chosen.left).null
        first = 0 if chosen is None else chosen.candidate.point.size
        own_part = [[jacobian[:, first:] for jacobian in fitted.jacobians] for fitted in beside.values()]
        fitted = () if chosen is None else chosen.candidate.jacobians
        return dict(zip(beside, null.p_values(own_part, fitted), strict=True))

    def with_shapes(self, linear: Sequence[Fit]) -> list[Fit]:
        """Linear fits, best first; unseen shapes are linearised again where the fit puts amplitudes.

        The length of a cable changes nothing while it does not pull. At a length from which a fit starts it pulls in
        few conditions, and predicts the others worse than what is wrong everywhere.
        """
        found = {entry.candidate.names: entry for entry in linear}
        unsure = [entry for entry in linear if entry.candidate.unseen_shapes]
        for entry in unsure:
            there = self.linearised(replace(entry.candidate, point=entry.estimate), entry.evidence)
            if there is not None and (seen := Fit.of(there, entry.evidence)).score < entry.score:
                found[entry.candidate.names] = seen
        return sorted(found.values(), key=lambda entry: entry.score)

    def linear_fit_with(self, chosen: Fit | None, group: str) -> Fit:
        """Linear fit of one more effect or group; one with a shape parameter is linearised with the chosen ones.

        Alone such an effect imitates others: friction that decreases with speed imitates an offset.
        """
        start = self.joined(group, chosen)
        if chosen is None:
            return Fit.of(start, self.evidence)
        joined = Fit.of(chosen.candidate.beside(start), chosen.evidence)
        if not has_shape_parameter(start):
            return joined
        there = self.linearised(replace(joined.candidate, point=joined.estimate), chosen.evidence)
        return joined if there is None else Fit.of(there, chosen.evidence)


def _changed(columns: Sequence[Array]) -> int:
    """Number of features with nonzero sensitivity, over all clusters."""
    return int(np.count_nonzero(np.abs(np.concatenate(columns)) > MIN_FEATURE_CHANGE)) if columns else 0
