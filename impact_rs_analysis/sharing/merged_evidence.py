# SPDX-License-Identifier: Apache-2.0
"""Meta-analysis of several evidence packages, parameter by parameter.

Packages of the same measurements are one piece of evidence, whichever laboratory they name: digests of the files reveal
them, and they are refused. Packages that share less than half of their measurements are listed.

A parameter of an effect is pooled over all packages that estimate it (:mod:`impact_rs_analysis.sharing.meta_analysis`);
a standard error is the width of the 95 % interval over 2 x 1.96, also for an interval that is not symmetric.

Outlier laboratories come first. An outlier has a studentised residual from all other laboratories whose p-value, times
the number of tested residuals (Bonferroni), is below ``ODD_SIGNIFICANCE``, and other laboratories have measured the
same robot and the same object. It is excluded from that parameter, and the test is repeated while more than three
packages remain.

Then the remaining heterogeneity Q is divided by robot, object and laboratory. A parameter *belongs* to a factor if Q
between the groups of the factor is significant and Q within the groups is not. If one laboratory alone has measured a
robot or object, either the robot or the laboratory may be different, and both are named. If Q is not significant, the
parameter is shared.
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
# Share of its measurements from which a package repeats another one; a few other files may be equal
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
        description="studentised residual [-]; null: fewer than two packages of other laboratories"
    )
    odd: bool = Field(False, description="whether it is an outlier and was left out")


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
    """Estimate of a parameter in one package."""

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
        InputError: There are fewer than two packages, a package was changed or is given twice, two hold the same
            measurements, or they diagnosed different models.
    """
    in_common = _check_mergeable(packages)
    named = {name for package in packages for name in package.diagnosis.named}
    studies, left_out = _studies(packages, named)
    consistent, outliers = _without_outliers(studies)
    dispersions = {package.laboratory: _dispersion(studies, consistent, package.laboratory)[0] for package in packages}
    parameters, outlier_laboratories = [], defaultdict(list)
    for key, group in studies.items():
        parameters.append(_merged(group, consistent[key], outliers.get(key, {}), dispersions))
        for study in outliers.get(key, {}):
            outlier_laboratories[group[study].package.laboratory].append(".".join(key))
    return MergedEvidence(
        packages=tuple(package.name for package in packages),
        seals=tuple(package.seal for package in packages),
        model=packages[0].model.digest,
        parameters=tuple(parameters),
        odd={
            laboratory: tuple(dict.fromkeys(parameter_names))
            for laboratory, parameter_names in sorted(outlier_laboratories.items())
        },
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
    for first, second in combinations(packages, 2):
        share = first.repeats(second)
        if share >= MIN_REPEATED_SHARE:
            raise InputError(
                f"the packages of {first.name} and of {second.name} hold the same measurements ({share:.0%} of their "
                "bytes, by SHA-256): they are one piece of evidence, not two; give one of them"
            )
        if share > 0.0:
            in_common.append(f"{first.name}, and {second.name}: {share:.1%} of the bytes of their measurements")
    return tuple(in_common)


def _studies(
    packages: Sequence[EvidencePackage], named: set[str]
) -> tuple[dict[tuple[str, str], list[_Study]], list[str]]:
    """Estimates by effect and parameter, for effects that some package names; and estimates that cannot be merged."""
    by_parameter: dict[tuple[str, str], list[_Study]] = defaultdict(list)
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
                by_parameter[effect.name, name].append(study)
    mergeable = {}
    for key, studies in by_parameter.items():
        if len(studies) < 2:
            left_out.append(f"{studies[0].package.name}: {'.'.join(key)}: no other package estimates it")
        elif len({study.unit for study in studies}) > 1:
            left_out.append(f"{'.'.join(key)}: its units differ ({', '.join(sorted({s.unit for s in studies}))})")
        else:
            mergeable[key] = studies
    return mergeable, left_out


def _without_outliers(
    studies: Mapping[tuple[str, str], list[_Study]],
) -> tuple[dict[tuple[str, str], list[int]], dict[tuple[str, str], dict[int, float]]]:
    """Indices of consistent studies, and of outliers with their studentised residuals, by parameter."""
    consistent = {key: list(range(len(group))) for key, group in studies.items()}
    tested_count = sum(len(group) for group in studies.values() if len(group) > MIN_STUDIES)
    outliers: dict[tuple[str, str], dict[int, float]] = defaultdict(dict)
    laboratories = sorted({study.package.laboratory for group in studies.values() for study in group})
    while True:
        tests = []
        for laboratory in laboratories:
            dispersion, degrees_of_freedom = _dispersion(studies, consistent, laboratory)
            for key, group in studies.items():
                if len(consistent[key]) <= MIN_STUDIES:
                    continue
                for index in consistent[key]:
                    if group[index].package.laboratory == laboratory and _comparable(group, consistent[key], index):
                        studentised = _residual(group, consistent[key], index, dispersion)
                        p_value = (
                            2.0 * float(scipy.stats.t.sf(abs(studentised), max(degrees_of_freedom, 1))) * tested_count
                        )
                        tests.append((p_value, key, index, studentised))
        if not tests or (worst := min(tests, key=lambda test: (test[0], -abs(test[3]))))[0] >= ODD_SIGNIFICANCE:
            return consistent, outliers
        _, key, index, studentised = worst
        consistent[key].remove(index)
        outliers[key][index] = studentised


def _dispersion(
    studies: Mapping[tuple[str, str], list[_Study]], consistent: Mapping[tuple[str, str], list[int]], laboratory: str
) -> tuple[float, int]:
    """Dispersion h^2 of the other laboratories, with its degrees of freedom.

    Parameters in which they differ are left out.
    """
    total, degrees_of_freedom = 0.0, 0
    for key, group in studies.items():
        other_indices = [index for index in consistent[key] if group[index].package.laboratory != laboratory]
        if len(other_indices) < 2:
            continue
        q, _, _ = heterogeneity(*_numbers(group, other_indices))
        if float(scipy.stats.chi2.sf(q, len(other_indices) - 1)) > HETEROGENEITY_SIGNIFICANCE:
            total, degrees_of_freedom = total + q, degrees_of_freedom + len(other_indices) - 1
    return (total / degrees_of_freedom if degrees_of_freedom else 1.0), degrees_of_freedom


def _residual(studies: Sequence[_Study], consistent: Sequence[int], index: int, dispersion: float) -> float:
    """Studentised residual of a study from the studies of other laboratories; nan with fewer than two."""
    study = studies[index]
    other_indices = [
        other_index for other_index in consistent if studies[other_index].package.laboratory != study.package.laboratory
    ]
    return residual(study.value, study.error, *_numbers(studies, other_indices), dispersion)


def _comparable(studies: Sequence[_Study], consistent: Sequence[int], index_of_study: int) -> bool:
    """Whether other laboratories have two studies or more, of the robot and of the object of a study among them."""
    study = studies[index_of_study]
    others = [studies[index] for index in consistent if studies[index].package.laboratory != study.package.laboratory]
    return len(others) > 1 and all(
        any(other.label(factor) == study.label(factor) for other in others) for factor in ("robot", "object")
    )


def _numbers(studies: Sequence[_Study], indices: Sequence[int]) -> tuple[list[float], list[float]]:
    return [studies[index].value for index in indices], [studies[index].error for index in indices]


def _merged(
    studies: Sequence[_Study],
    consistent: Sequence[int],
    outliers: Mapping[int, float],
    dispersions: Mapping[str, float],
) -> MergedParameter:
    """One parameter, with the dispersion h^2 of the other laboratories by laboratory."""
    values, errors = _numbers(studies, consistent)
    pooled = pool(values, errors)
    belongs_to: tuple[str, ...] = (SHARED_PARAMETER,)
    groups: dict[str, MergedEstimate] = {}
    if pooled.p_value < HETEROGENEITY_SIGNIFICANCE:
        belongs_to = _belongs_to(studies, consistent, pooled.q) or (UNCLEAR_PARAMETER,)
        if belongs_to != (UNCLEAR_PARAMETER,):
            groups = _groups(studies, consistent, belongs_to[0])
    residuals = {
        index: _residual(studies, consistent, index, dispersions[studies[index].package.laboratory])
        for index in consistent
    }
    contributions = [
        Contribution(
            laboratory=study.package.laboratory,
            robot=study.package.robot,
            object=study.package.object,
            estimate=study.value,
            ci95=study.ci95,
            verdict=study.verdict,
            residual=None if np.isnan(value := outliers.get(index, residuals.get(index, np.nan))) else value,
            odd=index in outliers,
        )
        for index, study in enumerate(studies)
    ]
    return MergedParameter(
        effect=studies[0].effect,
        parameter=studies[0].parameter,
        unit=studies[0].unit,
        belongs_to=belongs_to,
        pooled=MergedEstimate(estimate=pooled.mean, ci95=(pooled.low, pooled.high), packages=pooled.studies),
        between=pooled.tau,
        inconsistency=pooled.inconsistency,
        p_value=pooled.p_value,
        groups=groups,
        contributions=tuple(contributions),
    )


def _belongs_to(studies: Sequence[_Study], consistent: Sequence[int], q: float) -> tuple[str, ...]:
    """Factors that explain the heterogeneity of the packages."""
    values, errors = _numbers(studies, consistent)
    factors = []
    for factor in FACTORS:
        labels = [studies[index].label(factor) for index in consistent]
        count = len(set(labels))
        if count < 2:
            continue
        within, degrees_of_freedom = within_groups(values, errors, labels)
        p_between = float(scipy.stats.chi2.sf(q - within, count - 1))
        p_within = float(scipy.stats.chi2.sf(within, degrees_of_freedom)) if degrees_of_freedom else 1.0
        if p_between < HETEROGENEITY_SIGNIFICANCE <= p_within:
            factors.append(factor)
    robot_or_object = [factor for factor in factors if factor != "laboratory"]
    decided = [factor for factor in robot_or_object if _apart_from_laboratories(studies, consistent, factor)]
    return tuple(decided or factors)


def _apart_from_laboratories(studies: Sequence[_Study], consistent: Sequence[int], factor: str) -> bool:
    """Whether robots, or objects, differ among those that two laboratories or more have measured."""
    laboratories: dict[str, set[str]] = defaultdict(set)
    for index in consistent:
        laboratories[studies[index].label(factor)].add(studies[index].label("laboratory"))
    shared = [index for index in consistent if len(laboratories[studies[index].label(factor)]) > 1]
    labels = [studies[index].label(factor) for index in shared]
    if len(set(labels)) < 2:
        return False
    values, errors = _numbers(studies, shared)
    within, _ = within_groups(values, errors, labels)
    between = pool(values, errors).q - within
    return float(scipy.stats.chi2.sf(between, len(set(labels)) - 1)) < HETEROGENEITY_SIGNIFICANCE


def _groups(studies: Sequence[_Study], consistent: Sequence[int], factor: str) -> dict[str, MergedEstimate]:
    by_label: dict[str, list[int]] = defaultdict(list)
    for index in consistent:
        by_label[studies[index].label(factor)].append(index)
    estimates = {}
    for label, indices in sorted(by_label.items()):
        pooled = pool(*_numbers(studies, indices))
        estimates[label] = MergedEstimate(estimate=pooled.mean, ci95=(pooled.low, pooled.high), packages=pooled.studies)
    return estimates
