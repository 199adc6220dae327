# SPDX-License-Identifier: Apache-2.0
"""Meta-analysis of several evidence packages, parameter by parameter.

Packages of the same measurements are one piece of evidence, whatever laboratories they name: they are refused, by the
digests of their files. Packages that have less than half of their measurements in common are named.

A parameter of an effect is pooled over all packages that estimate it (:mod:`impact_rs_analysis.sharing.meta_analysis`);
a standard error is the width of the 95 % interval over 2 x 1.96, whatever its place about the estimate.

Outlier laboratories come first: their studentised residual from all other laboratories has a p-value that, times the
number of residuals tested (Bonferroni), is below ``ODD_SIGNIFICANCE``, and others have measured the same robot and
object. They are named, excluded from that parameter, and the test is repeated as long as three packages are left.

Then the heterogeneity Q that is left is divided by robot, object and laboratory. A parameter *belongs* to what leaves
none within its groups: Q within them is not significant, Q between them is. A robot or object that one laboratory alone
has measured does not show whether it or the laboratory is different, and both are named. Where Q is not significant,
the parameter is shared.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import scipy
from pydantic import Field

from impact_rs_analysis.diagnosis.verdict import UNIDENTIFIABLE, DiagnosisVerdict
from impact_rs_analysis.sharing.evidence_package import EvidencePackage
from impact_rs_analysis.sharing.meta_analysis import heterogeneity, pool, residual, within_groups
from impact_rs_sim.errors import InputError
from impact_rs_sim.numbers import NORMAL_95
from impact_rs_sim.schema import Schema

ODD_SIGNIFICANCE = 0.05  # family-wise, over all residuals of a merge
HETEROGENEITY_SIGNIFICANCE = 0.01  # p of Q below which packages differ
FACTORS = ("robot", "object", "laboratory")
SHARED_PARAMETER = "shared"
UNCLEAR_PARAMETER = "unclear"
# Of its measurements, from which a package repeats another one; files beside them may be equal
MIN_REPEATED_SHARE = 0.5
MIN_STUDIES = 3  # packages of a parameter, below which no package is called odd


class MergedEstimate(Schema):
    """A pooled value."""

    estimate: float = Field(description="value, in the unit")
    ci95: tuple[float, float] = Field(description="95 % interval, in the unit")
    packages: int = Field(description="packages that it was pooled from")


class Contribution(Schema):
    """Estimate of one package."""

    laboratory: str = Field(description="who measured")
    robot: str = Field(description="which robot")
    object: str = Field(description="which object")
    estimate: float = Field(description="estimate, in the unit")
    ci95: tuple[float, float] = Field(description="95 % interval, in the unit")
    verdict: DiagnosisVerdict = Field(description="verdict of the package on the effect")
    residual: float | None = Field(
        description="studentised leave-one-out residual [-]; null: fewer than three packages"
    )
    odd: bool = Field(False, description="whether it was left out because it does not agree with the others")


class MergedParameter(Schema):
    """One parameter."""

    effect: str = Field(description="effect")
    parameter: str = Field(description="its parameter")
    unit: str = Field(description="unit")
    belongs_to: tuple[str, ...] = Field(
        description="shared: packages agree; robot, object or laboratory: they differ by it, several: the packages "
        "cannot decide between these; unclear: by none of them alone"
    )
    pooled: MergedEstimate = Field(description="over all packages that agree")
    between: float = Field(description="standard deviation between packages, in the unit")
    inconsistency: float = Field(description="I^2, share of the variance that is due to differences [-]")
    p_value: float = Field(description="p value of no difference between packages")
    groups: dict[str, MergedEstimate] = Field({}, description="value by robot, object or laboratory, where they differ")
    contributions: tuple[Contribution, ...] = Field(description="packages, the odd ones included")


class MergedEvidence(Schema):
    """``merged.json``."""

    format: int = Field(1, description="version of this format")
    packages: tuple[str, ...] = Field(description="laboratory, robot and object of every package")
    seals: tuple[str, ...] = Field(description="seals of the packages")
    model: str = Field(description="digest of the model that all of them diagnosed")
    parameters: tuple[MergedParameter, ...] = Field(description="parameters that two packages or more estimate")
    odd: dict[str, tuple[str, ...]] = Field(description="odd laboratories, with the parameters where they are")
    left_out: tuple[str, ...] = Field(description="estimates that could not be merged, with the reason")
    in_common: tuple[str, ...] = Field(
        (), description="packages with some files of measurements in common, whose estimates may depend on each other"
    )


@dataclass(frozen=True)
class _Study:
    """One package's estimate of a parameter."""

    package: EvidencePackage
    effect: str
    parameter: str
    unit: str
    value: float
    ci95: tuple[float, float]
    verdict: DiagnosisVerdict

    @property
    def error(self) -> float:
        """Standard error of a normal distribution with an interval of this width."""
        return (self.ci95[1] - self.ci95[0]) / (2.0 * NORMAL_95)

    def label(self, factor: str) -> str:
        return str(getattr(self.package, factor))


def merge_packages(packages: Sequence[EvidencePackage]) -> MergedEvidence:
    """Merge packages of evidence.

    Args:
        packages: Two or more, of diagnoses of one model.

    Raises:
        InputError: There are fewer than two, one was changed or is given twice, two hold the same measurements, or they
            diagnosed different models.
    """
    in_common = _check_mergeable(packages)
    named = {name for package in packages for name in package.diagnosis.named}
    studies, left_out = _studies(packages, named)
    kept, odd = _without_odd(studies)
    parameters, odd_laboratories = [], defaultdict(list)
    for key, own in studies.items():
        parameters.append(_merged(own, kept[key], odd.get(key, {})))
        for study in odd.get(key, {}):
            odd_laboratories[own[study].package.laboratory].append(".".join(key))
    return MergedEvidence(
        packages=tuple(package.name for package in packages),
        seals=tuple(package.seal for package in packages),
        model=packages[0].model.digest,
        parameters=tuple(parameters),
        odd={laboratory: tuple(dict.fromkeys(where)) for laboratory, where in sorted(odd_laboratories.items())},
        left_out=tuple(left_out),
        in_common=in_common,
    )


def _check_mergeable(packages: Sequence[EvidencePackage]) -> tuple[str, ...]:
    """Check that packages can be merged; returns warnings about common files."""
    if len(packages) < 2:
        raise InputError(f"{len(packages)} package of evidence; expected two or more")
    for package in packages:
        if not package.intact:
            raise InputError(f"the package of {package.name} was changed after it was packed; ask for it again")
    seals = [package.seal for package in packages]
    for package in packages:
        if seals.count(package.seal) > 1:
            raise InputError(f"the package of {package.name} is given twice")
    digests = {package.model.digest: package.name for package in packages}
    if len(digests) > 1:
        listed = "; ".join(f"{name}: {digest}" for digest, name in digests.items())
        raise InputError(
            f"the packages diagnose different models, whose estimates cannot be compared ({listed}); diagnose one model"
        )
    in_common = []
    for one, other in combinations(packages, 2):
        share = one.repeats(other)
        if share >= MIN_REPEATED_SHARE:
            raise InputError(
                f"the packages of {one.name} and of {other.name} hold the same measurements ({share:.0%} of their "
                "bytes, by SHA-256): they are one piece of evidence, not two; give one of them"
            )
        if share > 0.0:
            in_common.append(f"{one.name}, and {other.name}: {share:.1%} of the bytes of their measurements")
    return tuple(in_common)


def _studies(
    packages: Sequence[EvidencePackage], named: set[str]
) -> tuple[dict[tuple[str, str], list[_Study]], list[str]]:
    """Estimates by effect and parameter, of effects that some package names; and what cannot be merged."""
    found: dict[tuple[str, str], list[_Study]] = defaultdict(list)
    left_out = []
    for package in packages:
        for effect in package.diagnosis.effects:
            if effect.name not in named:
                continue
            for name, value in effect.parameters.items():
                reason = ""
                if effect.verdict == UNIDENTIFIABLE or not effect.measured:
                    reason = f"the effect is {UNIDENTIFIABLE}"
                elif value.at_bound:
                    reason = "the estimate is at a bound"
                elif value.ci95 is None or not value.ci95[0] < value.ci95[1]:
                    reason = "it has no interval"
                if reason:
                    left_out.append(f"{package.name}: {effect.name}.{name}: {reason}")
                    continue
                assert value.ci95 is not None
                study = _Study(package, effect.name, name, value.unit, value.estimate, value.ci95, effect.verdict)
                found[effect.name, name].append(study)
    result = {}
    for key, own in found.items():
        if len(own) < 2:
            left_out.append(f"{own[0].package.name}: {'.'.join(key)}: no other package estimates it")
        elif len({study.unit for study in own}) > 1:
            left_out.append(f"{'.'.join(key)}: its units differ ({', '.join(sorted({s.unit for s in own}))})")
        else:
            result[key] = own
    return result, left_out


def _without_odd(
    studies: Mapping[tuple[str, str], list[_Study]],
) -> tuple[dict[tuple[str, str], list[int]], dict[tuple[str, str], dict[int, float]]]:
    """Indices of consistent studies, and of outliers with their studentised residuals, by parameter."""
    kept = {key: list(range(len(own))) for key, own in studies.items()}
    looked_at = sum(len(own) for own in studies.values() if len(own) > MIN_STUDIES)
    odd: dict[tuple[str, str], dict[int, float]] = defaultdict(dict)
    laboratories = sorted({study.package.laboratory for own in studies.values() for study in own})
    while True:
        found = []
        for laboratory in laboratories:
            dispersion, freedom = _dispersion(studies, kept, laboratory)
            for key, own in studies.items():
                if len(kept[key]) <= MIN_STUDIES:
                    continue
                for index in kept[key]:
                    if own[index].package.laboratory == laboratory and _alone(own, kept[key], index):
                        size = _residual(own, kept[key], index, dispersion)
                        p_value = 2.0 * float(scipy.stats.t.sf(abs(size), max(freedom, 1))) * looked_at
                        found.append((p_value, key, index, size))
        if not found or (worst := min(found, key=lambda one: (one[0], -abs(one[3]))))[0] >= ODD_SIGNIFICANCE:
            return kept, odd
        _, key, index, size = worst
        kept[key].remove(index)
        odd[key][index] = size


def _dispersion(
    studies: Mapping[tuple[str, str], list[_Study]], kept: Mapping[tuple[str, str], list[int]], laboratory: str
) -> tuple[float, int]:
    """Mean square deviation of the other laboratories over their errors, with its degrees of freedom.

    Parameters in which they differ are left out.
    """
    total, freedom = 0.0, 0
    for key, own in studies.items():
        others = [index for index in kept[key] if own[index].package.laboratory != laboratory]
        if len(others) < 2:
            continue
        q, _, _ = heterogeneity(*_numbers(own, others))
        if float(scipy.stats.chi2.sf(q, len(others) - 1)) > HETEROGENEITY_SIGNIFICANCE:
            total, freedom = total + q, freedom + len(others) - 1
    return (total / freedom if freedom else 1.0), freedom


def _residual(own: Sequence[_Study], kept: Sequence[int], index: int, dispersion: float = 1.0) -> float:
    """Studentised residual of a study from the studies of other laboratories; nan with fewer than two."""
    study = own[index]
    others = [other for other in kept if own[other].package.laboratory != study.package.laboratory]
    return residual(study.value, study.error, *_numbers(own, others), dispersion)


def _alone(own: Sequence[_Study], kept: Sequence[int], worst: int) -> bool:
    """Whether only the laboratory distinguishes a study: others share its robot and its object."""
    study = own[worst]
    others = [own[index] for index in kept if own[index].package.laboratory != study.package.laboratory]
    return all(any(other.label(factor) == study.label(factor) for other in others) for factor in ("robot", "object"))


def _numbers(own: Sequence[_Study], indices: Sequence[int]) -> tuple[list[float], list[float]]:
    return [own[index].value for index in indices], [own[index].error for index in indices]


def _merged(own: Sequence[_Study], kept: Sequence[int], odd: Mapping[int, float]) -> MergedParameter:
    """One parameter."""
    values, errors = _numbers(own, kept)
    pooled = pool(values, errors)
    belongs_to: tuple[str, ...] = (SHARED_PARAMETER,)
    groups: dict[str, MergedEstimate] = {}
    if pooled.p_value < HETEROGENEITY_SIGNIFICANCE:
        belongs_to = _belongs_to(own, kept, pooled.q) or (UNCLEAR_PARAMETER,)
        if belongs_to != (UNCLEAR_PARAMETER,):
            groups = _groups(own, kept, belongs_to[0])
    left = {index: _residual(own, kept, index) for index in kept}
    contributions = [
        Contribution(
            laboratory=study.package.laboratory,
            robot=study.package.robot,
            object=study.package.object,
            estimate=study.value,
            ci95=study.ci95,
            verdict=study.verdict,
            residual=None if np.isnan(r := odd.get(index, left.get(index, np.nan))) else r,
            odd=index in odd,
        )
        for index, study in enumerate(own)
    ]
    return MergedParameter(
        effect=own[0].effect,
        parameter=own[0].parameter,
        unit=own[0].unit,
        belongs_to=belongs_to,
        pooled=MergedEstimate(estimate=pooled.mean, ci95=(pooled.low, pooled.high), packages=pooled.studies),
        between=pooled.tau,
        inconsistency=pooled.inconsistency,
        p_value=pooled.p_value,
        groups=groups,
        contributions=tuple(contributions),
    )


def _belongs_to(own: Sequence[_Study], kept: Sequence[int], q: float) -> tuple[str, ...]:
    """Factors that explain the heterogeneity of the packages."""
    values, errors = _numbers(own, kept)
    found = []
    for factor in FACTORS:
        labels = [own[index].label(factor) for index in kept]
        count = len(set(labels))
        if count < 2:
            continue
        within, freedom = within_groups(values, errors, labels)
        between = float(scipy.stats.chi2.sf(q - within, count - 1))
        rest = float(scipy.stats.chi2.sf(within, freedom)) if freedom else 1.0
        if between < HETEROGENEITY_SIGNIFICANCE <= rest:
            found.append(factor)
    of_bodies = [factor for factor in found if factor != "laboratory"]
    decided = [factor for factor in of_bodies if _apart_from_laboratories(own, kept, factor)]
    return tuple(decided or found)


def _apart_from_laboratories(own: Sequence[_Study], kept: Sequence[int], factor: str) -> bool:
    """Whether robots, or objects, differ that two laboratories or more have measured."""
    laboratories: dict[str, set[str]] = defaultdict(set)
    for index in kept:
        laboratories[own[index].label(factor)].add(own[index].label("laboratory"))
    shared = [index for index in kept if len(laboratories[own[index].label(factor)]) > 1]
    labels = [own[index].label(factor) for index in shared]
    if len(set(labels)) < 2:
        return False
    values, errors = _numbers(own, shared)
    within, _ = within_groups(values, errors, labels)
    between = pool(values, errors).q - within
    return float(scipy.stats.chi2.sf(between, len(set(labels)) - 1)) < HETEROGENEITY_SIGNIFICANCE


def _groups(own: Sequence[_Study], kept: Sequence[int], factor: str) -> dict[str, MergedEstimate]:
    by_label: dict[str, list[int]] = defaultdict(list)
    for index in kept:
        by_label[own[index].label(factor)].append(index)
    found = {}
    for label, indices in sorted(by_label.items()):
        pooled = pool(*_numbers(own, indices))
        found[label] = MergedEstimate(estimate=pooled.mean, ci95=(pooled.low, pooled.high), packages=pooled.studies)
    return found
