# SPDX-License-Identifier: Apache-2.0
"""Packages of evidence reveal changes, and merging them finds what was planted."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import scipy
from evidence_packages import diagnosis_of, file_of, package_of
from intervals import assert_covers

from impact_rs_analysis.evidence.replays.measured_runs import runs_digest
from impact_rs_analysis.sharing.evidence_package import (
    EvidencePackage,
    check_package,
    make_package,
    read_package,
    write_package,
)
from impact_rs_analysis.sharing.merged_evidence import MergedEvidence, MergedParameter, merge_packages
from impact_rs_sim.errors import InputError
from impact_rs_sim.model import load_model

LABORATORIES = ("north", "south", "west", "east", "centre")
ERROR = 0.1


@pytest.fixture
def runs(tmp_path: Path) -> Path:
    folder = tmp_path / "runs"
    (folder / "a").mkdir(parents=True)
    (folder / "a" / "one.csv").write_text("1,2\n", encoding="utf-8")
    (folder / "two.csv").write_text("3,4\n", encoding="utf-8")
    return folder


def packed(runs: Path) -> EvidencePackage:
    return make_package(diagnosis_of({"law": (1.0, ERROR)}), load_model("nominal"), runs, "north", "arm", "box")


def failed(package: EvidencePackage, data: Path | None = None) -> list[str]:
    return [one.what for one in check_package(package, data) if not one.passed]


def test_a_package_is_read_back_as_it_was_written(runs: Path, tmp_path: Path) -> None:
    package = packed(runs)
    write_package(package, tmp_path / "north.json")
    assert read_package(tmp_path / "north.json") == package
    assert failed(package, runs) == []


def test_a_changed_number_breaks_the_seal(runs: Path, tmp_path: Path) -> None:
    file = tmp_path / "north.json"
    write_package(packed(runs), file)
    file.write_text(file.read_text(encoding="utf-8").replace('"estimate": 1.0', '"estimate": 1.5'), encoding="utf-8")
    assert failed(read_package(file)) == ["seal"]
    with pytest.raises(InputError, match="was changed"):
        merge_packages([read_package(file), package_of("south", {"law": (1.0, ERROR)})])


@pytest.mark.parametrize("what", ["changed", "missing", "further"])
def test_other_measurements_are_noticed(runs: Path, what: str) -> None:
    package = packed(runs)
    if what == "changed":
        (runs / "two.csv").write_text("3,5\n", encoding="utf-8")
    elif what == "missing":
        (runs / "two.csv").unlink()
    else:
        (runs / "three.csv").write_text("", encoding="utf-8")
    assert failed(package, runs) == ["measurements"]


def test_a_package_holds_no_paths_of_the_machine_that_made_it(runs: Path) -> None:
    diagnosis = diagnosis_of({"law": (1.0, ERROR)}, options={"runs": "/home/someone/runs"})
    package = make_package(diagnosis, load_model("nominal"), runs, "north", "arm", "box")
    assert package.diagnosis.options == {}


def test_a_diagnosis_of_another_model_is_refused(runs: Path) -> None:
    other = diagnosis_of({"law": (1.0, ERROR)}, model={"name": "other", "digest": "abc"})
    with pytest.raises(InputError, match="give the model that was diagnosed"):
        make_package(other, load_model("nominal"), runs, "north", "arm", "box")


def test_models_that_differ_and_packages_given_twice_are_refused() -> None:
    package = package_of("north", {"law": (1.0, ERROR)})
    with pytest.raises(InputError, match="given twice"):
        merge_packages([package, package])
    with pytest.raises(InputError, match="expected two or more"):
        merge_packages([package])


def test_the_same_measurements_under_three_names_are_one_piece_of_evidence() -> None:
    """Whatever their files are called, and whatever a laboratory found in them."""
    same = file_of("hits of north")
    copies = [same, same.model_copy(update={"path": "copy.mcap"}), same.model_copy(update={"path": "b.mcap"})]
    packages = [
        package_of(name, {"law": (1.0 + shift, ERROR)}, data=(copy,))
        for name, shift, copy in zip(LABORATORIES[:3], (0.0, 0.0, 0.01), copies, strict=True)
    ]
    with pytest.raises(InputError, match="of north: arm, box and of south: arm, box hold the same measurements"):
        merge_packages(packages)


def test_one_bag_added_to_measurements_of_others_makes_no_measurements_of_ones_own() -> None:
    theirs = tuple(file_of(f"bag {number}") for number in range(5))
    packages = [
        package_of("north", {"law": (1.0, ERROR)}, data=theirs),
        package_of("south", {"law": (1.1, ERROR)}, data=(*theirs, file_of("bag of south"))),
    ]
    with pytest.raises(InputError, match="one piece of evidence, not two; give one of them"):
        merge_packages(packages)


def test_a_table_of_runs_that_two_laboratories_have_alike_is_named_and_merged() -> None:
    table = file_of("bag,object,kind", size=10)
    packages = [
        package_of(name, {"law": (1.0, ERROR)}, data=(table, file_of(f"bag of {name}"))) for name in ("north", "south")
    ]
    merged = merge_packages(packages)
    assert of(merged, "law").pooled.packages == 2
    assert list(merged.in_common) == ["north: arm, box, and south: arm, box: 1.0% of the bytes of their measurements"]


def test_packages_that_agree_exactly_are_not_sure_of_everything() -> None:
    """Three alike: the interval is that of their errors, 1.96 s / sqrt(3)."""
    half = scipy.stats.norm.ppf(0.975) * ERROR / np.sqrt(3)
    merged = merge_packages([package_of(name, {"law": (6.08, ERROR)}) for name in LABORATORIES[:3]])
    assert of(merged, "law").pooled.ci95 == pytest.approx((6.08 - half, 6.08 + half), rel=1e-5)


def of(merged: MergedEvidence, effect: str) -> MergedParameter:
    return next(one for one in merged.parameters if one.effect == effect)


def test_what_all_measure_alike_is_shared_and_surer_than_each() -> None:
    rng = np.random.default_rng(0)
    packages = [package_of(name, {"law": (1.0 + ERROR * rng.standard_normal(), ERROR)}) for name in LABORATORIES]
    found = of(merge_packages(packages), "law")
    assert found.belongs_to == ("shared",)
    assert_covers(found.pooled.ci95, 1.0, 1.96 * ERROR / np.sqrt(len(LABORATORIES)), within=1.2)


def test_an_odd_laboratory_is_named_and_left_out() -> None:
    values = dict(zip(LABORATORIES, (1.0, 1.05, 0.95, 1.02, 1.8), strict=True))
    merged = merge_packages([package_of(name, {"law": (value, ERROR)}) for name, value in values.items()])
    assert dict(merged.odd) == {"centre": ("law.size",)}
    found = of(merged, "law")
    assert found.belongs_to == ("shared",)
    assert found.pooled.packages == 4
    assert found.pooled.estimate == pytest.approx(1.005)
    assert [one.laboratory for one in found.contributions if one.odd] == ["centre"]


def test_a_package_without_two_of_other_laboratories_is_not_tested() -> None:
    """Kills: a residual of nan as the least p-value, which excluded a sound package if its laboratory sorted first."""
    for often, once in (("north", "south"), ("south", "north")):
        values = ((often, 1.0), (often, 1.01), (often, 0.99), (once, 1.0))
        packages = [
            package_of(name, {"law": (value, ERROR)}, data=(file_of(f"{value} {name}"),)) for name, value in values
        ]
        merged = merge_packages(packages)
        found = of(merged, "law")
        assert merged.odd == {} and found.pooled.packages == 4
        assert [one.residual is None for one in found.contributions] == [True, True, True, False]


def test_the_residual_of_a_package_is_the_one_that_was_tested() -> None:
    """Kills: residuals of the packages that stay without the dispersion h^2 of the others, here 4 * 1.2^2 / 3."""
    values = dict(zip(LABORATORIES, (1.3, 0.88, 1.12, 0.88, 1.12), strict=True))
    found = of(merge_packages([package_of(name, {"law": (value, ERROR)}) for name, value in values.items()]), "law")
    assert found.contributions[0].residual == pytest.approx(0.3 / (ERROR * np.sqrt(4.0 * 1.2**2 / 3.0 * 1.25)))


def test_a_parameter_of_the_robot_differs_by_robot_in_several_laboratories() -> None:
    values = {"north": 1.0, "south": 1.05, "west": 2.0, "east": 1.95}
    robots = {"north": "first", "south": "first", "west": "second", "east": "second"}
    merged = merge_packages(
        [package_of(name, {"law": (value, ERROR)}, robot=robots[name]) for name, value in values.items()]
    )
    found = of(merged, "law")
    assert found.belongs_to == ("robot",)
    assert merged.odd == {}
    assert found.groups["second"].estimate == pytest.approx(1.975)


def test_a_parameter_of_the_object_differs_by_object_in_each_laboratory() -> None:
    packages = [
        package_of(name, {"law": (value, ERROR)}, object_name=thing)
        for name in ("north", "south", "west")
        for thing, value in (("box", 1.0), ("can", 1.9))
    ]
    found = of(merge_packages(packages), "law")
    assert found.belongs_to == ("object",)
    assert set(found.groups) == {"box", "can"}


def test_a_bias_of_a_laboratory_shows_over_its_objects() -> None:
    packages = [
        package_of(name, {"law": (value + shift, ERROR)}, object_name=thing)
        for name, value in (("north", 1.0), ("south", 1.6), ("west", 2.2))
        for thing, shift in (("box", 0.0), ("can", 0.03))
    ]
    assert of(merge_packages(packages), "law").belongs_to == ("laboratory",)


def test_one_robot_for_each_laboratory_decides_nothing() -> None:
    packages = [
        package_of(name, {"law": (value, ERROR)}, robot=f"arm of {name}")
        for name, value in (("north", 1.0), ("south", 1.6), ("west", 2.2))
    ]
    merged = merge_packages(packages)
    assert of(merged, "law").belongs_to == ("robot", "laboratory")
    assert merged.odd == {}


def test_estimates_without_interval_or_company_are_listed() -> None:
    packages = [
        package_of("north", {"law": (1.0, ERROR), "alone": (1.0, ERROR)}),
        package_of("south", {"law": (1.1, ERROR)}),
        package_of("west", {"law": (1.0, 0.0)}),
    ]
    merged = merge_packages(packages)
    assert len(merged.left_out) == 2
    assert any("no other package estimates it" in text for text in merged.left_out)
    assert any("no interval" in text for text in merged.left_out)
    assert [one.effect for one in merged.parameters] == ["law"]


def test_the_merged_file_shows_the_interval_of_each_package() -> None:
    """Kills an interval that is mirrored about the estimate, with masses below zero."""
    skew = {"north": (0.05, (0.0, 0.4)), "south": (0.06, (0.01, 0.45))}
    packages = []
    for laboratory, (value, ends) in skew.items():
        diagnosis = diagnosis_of({"law": (value, ERROR)})
        (effect,) = diagnosis.effects
        size = effect.parameters["size"].model_copy(update={"ci95": ends})
        effects = (effect.model_copy(update={"parameters": {"size": size}}),)
        package = package_of(laboratory, {"law": (value, ERROR)})
        packages.append(
            package.model_copy(update={"diagnosis": diagnosis.model_copy(update={"effects": effects})}).sealed()
        )
    (merged,) = merge_packages(packages).parameters
    assert [one.ci95 for one in merged.contributions] == [ends for _, ends in skew.values()]


def test_a_diagnosis_is_packed_with_its_own_trials(runs: Path) -> None:
    """Kills a seal over whatever folder is given, and a digest asked of the runs of another controller."""
    of_trials = diagnosis_of(
        {"law": (1.0, ERROR)},
        runs={"digest": "0" * 16, "trials": 9, "conditions": ("a",)},
        options={"runs": "/home/someone/runs"},
    )
    who = ("north", "arm", "box")
    with pytest.raises(InputError, match="not the trials of the diagnosis .*; give the folder that was diagnosed"):
        make_package(of_trials, load_model("nominal"), runs, *who)
    own = of_trials.model_copy(update={"runs": of_trials.runs.model_copy(update={"digest": runs_digest(runs)})})
    assert len(make_package(own, load_model("nominal"), runs, *who).data) == 2
    (runs / "experiment.yaml").write_text("")
    assert len(make_package(of_trials, load_model("nominal"), runs, *who).data) == 3
