# SPDX-License-Identifier: Apache-2.0
"""Boards: what they draw, which seeds they take, how they judge; nothing is diagnosed."""

from __future__ import annotations

import importlib
import json
from pathlib import Path
from types import SimpleNamespace

from benchmarks import harness  # isort: skip, for it puts the closed-form world on the path
import documents
import numpy as np
import pytest
from analytic_world import FEATURES, correlated, features

from benchmarks.boards import left_out, numbers, small
from benchmarks.closed_form import EXACT, Campaign, Simulator, standard_error
from benchmarks.hidden import Entry, by_probability, judged, stated_probabilities, table_of_diagnoses
from impact_rs_analysis.diagnosis.verdict import DiagnosisVerdict
from impact_rs_analysis.evidence.discrepancy import measured_discrepancy

HIDDEN = (("straight", (0.7,)), ("bent", (2.0,)))


def test_a_campaign_measures_what_its_clusters_show() -> None:
    """Kills: noise of a later replay that is not the noise of the clusters; an effect that is hidden in neither."""
    source = Campaign(5, (4, 3), HIDDEN, simulator=Simulator(0.3))
    assert [item.residuals.shape for item in source.clusters] == [(3, FEATURES)] * 4
    again = source.residuals_with((), source.clusters)
    left = source.residuals_with(HIDDEN, source.clusters)
    assert again is not None and left is not None
    for number, (item, same, rest) in enumerate(zip(source.clusters, again, left, strict=True)):
        assert same.residuals == pytest.approx(item.residuals)
        moved = (item.residuals - rest.residuals) * item.sigma
        assert moved == pytest.approx(np.tile(features(number, HIDDEN), (3, 1)))
        assert item.contact and item.discrepancy_key == source.clusters[0].discrepancy_key


def test_the_scale_of_a_small_campaign_comes_from_its_own_repeats() -> None:
    """Kills: the true noise as the pure error."""
    one, other = (Campaign(seed, (3, 2)).clusters[0] for seed in (1, 2))
    assert not np.allclose(one.pure_error * one.sigma, other.pure_error * other.sigma, rtol=0.1)
    many = Campaign(3, (3, 400)).clusters[0]
    assert many.pure_error * many.sigma == pytest.approx(np.ones(FEATURES), rel=0.1)


@pytest.mark.parametrize("kind", ["measured", "new"])
def test_a_simulator_is_off_by_what_its_discrepancy_says(kind: str) -> None:
    """Kills: patterns that are not as large as the discrepancy; a new simulator that moves along measured patterns."""
    root = correlated()
    spread = np.sqrt(np.sum(np.square(root), axis=0))
    simulator = Simulator(0.5, kind)
    (item, *_) = Campaign(1, (3, 2), root=root, simulator=simulator).clusters
    assert item.patterns is not None
    assert item.discrepancy * item.sigma == pytest.approx(0.5 * spread)
    assert np.sum(np.square(item.patterns), axis=0) == pytest.approx(np.square(item.discrepancy))
    errors = np.array([simulator.error(np.random.default_rng(seed), spread) for seed in range(4000)])
    assert np.sqrt(np.mean(np.square(errors), axis=0)) == pytest.approx(0.5 * spread, rel=0.1)
    inside = errors @ np.linalg.pinv(simulator.patterns(spread)) @ simulator.patterns(spread)
    assert (np.abs(inside - errors).max() < 1e-9) == (kind == "measured")


@pytest.mark.parametrize("simulator", [EXACT, Simulator(1.0)])
def test_the_standard_error_is_that_of_the_best_estimate(simulator: Simulator) -> None:
    """Kills: the simulator's error counted once for each condition, and noise that repeats do not average."""
    design, root = (3, 2), correlated()
    spread = np.sqrt(np.sum(np.square(root), axis=0))
    moved = np.concatenate([features(number, (("straight", (1.0,)),)) for number in range(3)])
    rng, draws = np.random.default_rng(0), []
    for _ in range(3000):
        noise = (rng.standard_normal((3, 2, FEATURES)) @ root).mean(axis=1)
        draws.append((noise + simulator.error(rng, spread)).ravel())
    weights = np.linalg.solve(np.cov(np.array(draws).T), moved)
    estimates = np.array(draws) @ weights / (moved @ weights)
    assert standard_error(design, "straight", root, simulator) == pytest.approx(float(np.std(estimates)), rel=0.06)
    assert standard_error((3, 2), "straight") == pytest.approx(1.0 / np.sqrt(2.0 * moved @ moved))


def test_a_small_campaign_hides_what_its_name_says() -> None:
    """Kills: a size in units of a feature in the place of standard errors, and an unknown number of conditions."""
    options = harness.parser_of("small").parse_args([])
    truths, sources = {}, {}
    for case in small.cases(options):
        sources[case.name], truths[case.name] = small.campaign(case, options, 3)
    assert truths["6x3, exact, nothing"] == () and len(truths) == 40
    (name, (size,)), error = truths["6x3, discrepancy, straight 8"][0], standard_error((6, 3), "straight")
    assert name == "straight" and 8.0 * error < size < 8.8 * error
    assert truths["3x2, discrepancy, outside 2"] == (("outside", (2.0,)),)
    clusters = sources["4x2, discrepancy, nothing"].clusters
    assert [item.count for item in clusters] == [2] * 4 and np.all(clusters[0].discrepancy > 0.0)
    assert not np.any(sources["4x2, exact, nothing"].clusters[0].discrepancy)


STRICT, BESIDE, WRONG, NO_NAME, SEEN = range(5)


@pytest.mark.parametrize(
    ("hidden", "named", "verdict", "holds"),
    [
        ("nothing", (), "NOTHING-MISSING", {STRICT, NO_NAME}),
        ("nothing", (), "PRESENT-BUT-SMALL", {NO_NAME, SEEN}),
        ("nothing", ("bent",), "bent", {WRONG, SEEN}),
        ("straight 5", ("straight",), "straight", {STRICT, SEEN}),
        ("straight 5", ("straight", "bent"), "straight+bent", {BESIDE, SEEN}),
        ("straight 5", ("bent",), "bent", {WRONG, SEEN}),
        ("straight 5", (), "NOTHING-MISSING", {NO_NAME}),
        ("outside 2", (), "NONE-EXPLAINS", {STRICT, NO_NAME, SEEN}),
        ("outside 2", (), "NOTHING-MISSING", {NO_NAME}),
        ("outside 2", ("bent",), "PARTLY{bent}", {WRONG, SEEN}),
    ],
)
def test_what_a_small_campaign_ends_with(hidden: str, named: tuple[str, ...], verdict: str, holds: set[int]) -> None:
    """Kills: a name beside the hidden effect, or a null that is called small, counted as right."""
    found = small.outcome(hidden, {"named": named, "verdict": verdict})
    assert {number for number, value in enumerate(found) if value} == holds


@pytest.mark.parametrize("name", numbers.NUMBERS)
def test_a_number_of_the_verdict_is_changed_for_as_long_as_it_is_asked_for(name: str) -> None:
    """Kills: a module keeps its own; the change stays."""
    from impact_rs_analysis.diagnosis.search import candidate, model_comparison, null_distribution, screening
    from impact_rs_analysis.diagnosis.search import effect_selection as search
    from impact_rs_analysis.diagnosis.verdicts import model_verdict as verdicts
    from impact_rs_analysis.evidence import cluster

    modules = (candidate, cluster, model_comparison, null_distribution, screening, search, verdicts)
    seen = [module for module in modules if hasattr(module, name)]
    before = [getattr(module, name) for module in seen]
    assert seen
    with numbers.multiplied(name, 2.0):
        assert [getattr(module, name) for module in seen] == [2 * value for value in before]
    assert [getattr(module, name) for module in seen] == before


def test_the_table_of_small_campaigns_shows_shares_and_probabilities() -> None:
    """Kills: an effect that is named with a probability and was not hidden, counted as right."""
    draw = {"named": ["straight"], "verdict": "straight", "covered": True, "seconds": 0.5}
    rows = [
        {"name": name, "hidden": hidden, "draws": [draw | {"probabilities": {"straight": 0.95}}] * count}
        for name, hidden, count in (("one", "straight 5", 3), ("none", "nothing", 1))
    ]
    lines = {row[0]: row[1:] for row in small.table(rows, None).rows}
    assert lines["one"][:2] == ("3", "100 ± 22") and lines["none"][:4] == ("1", "0 ± 50", "0 ± 50", "100 ± 50")
    assert lines["effects named with 90 to 100 %: hidden"][:2] == ("4", "75 ± 22")
    silent = [row | {"draws": [draw | {"probabilities": {}}]} for row in rows]
    assert len(small.table(silent, None).rows) == 2


def test_probabilities_are_put_into_bins_where_a_document_states_them() -> None:
    """Kills: 1 in no bin, and a bin's upper end in two."""
    found = dict(by_probability([(0.5, True), (0.9, True), (1.0, False), (0.89, True)]))
    assert [len(right) for right in found.values()] == [0, 1, 1, 2]
    assert list(found.values())[-1] == [True, False]
    assert by_probability([]) == []
    effects = [
        SimpleNamespace(name="a", probability=0.7),
        SimpleNamespace(name="b"),
        SimpleNamespace(name="c", probability=0.2),
    ]
    document = SimpleNamespace(effects=effects, named=("a", "b"))
    assert stated_probabilities(document) == {"a": 0.7}


@pytest.mark.parametrize(
    ("kind", "hidden", "named", "verdict", "right"),
    [
        ("single", ["bent"], ("bent",), "bent", True),
        ("single", ["bent"], ("bent", "straight"), "bent+straight", False),
        ("null", [], (), "NOTHING-MISSING", True),
        ("null", [], (), "PRESENT-BUT-SMALL", False),
        ("outside", [], (), "NONE-EXPLAINS", True),
        ("outside", [], ("bent",), "PARTLY{bent}", False),
        ("outside", [], (), "NOTHING-MISSING", False),
    ],
)
def test_strictly_right_is_what_was_hidden_and_no_more(
    tmp_path: Path, kind: str, hidden: list[str], named: tuple[str, ...], verdict: str, right: bool
) -> None:
    """Kills: no name at all counted as strictly right, whatever the verdict."""
    truth = {"kind": kind, "outside": None, "effects": [{"name": name, "parameters": {}} for name in hidden]}
    (tmp_path / "truth.json").write_text(json.dumps(truth))
    document = documents.diagnosis().model_copy(
        update={"named": named, "verdict": DiagnosisVerdict.parse(verdict), "confusable": ()}
    )
    row = judged(tmp_path, document)
    assert row["exact"] is right
    lines = dict(table_of_diagnoses([row | {"magnitude": 3.0}], "x").rows)
    assert lines["campaigns that ended right: exactly what is hidden named"] == f"{int(right)} of 1"


@pytest.mark.parametrize(
    ("board", "plant"),
    [
        (board, plant)
        for board in ("blind", "discovery", "investigate", "design", "left_out")
        for plant in ("plant", "")
    ],
)
def test_fresh_seeds_are_one_option_away(board: str, plant: str) -> None:
    """Kills: a board some of whose campaigns keep the seeds that have been looked at."""
    module, parser = importlib.import_module(f"benchmarks.boards.{board}"), harness.parser_of(board)
    words = ["--on", plant] if plant else []
    usual, fresh = (module.cases(parser.parse_args([*words, *more])) for more in ([], ["--first-seed", "90000"]))
    assert [(e.kind, e.effect, e.magnitude, e.seed + 90000) for e in usual] == [
        (e.kind, e.effect, e.magnitude, e.seed) for e in fresh
    ]
    assert all(isinstance(entry, Entry) for entry in usual) and not {e.name for e in usual} & {e.name for e in fresh}
    assert harness.parser_of("small").parse_args(["--first-seed", "7"]).first == 7


def test_the_discrepancy_is_made_anew_from_its_table() -> None:
    """Kills: a mean over variants, or rms over bins in the place of conditions; nothing left out: the shipped one."""
    shipped, again = (
        {(e.kind, e.phase, e.signal, e.index): e for e in found.entries}
        for found in (measured_discrepancy(), left_out.without("no simulator"))
    )
    assert shipped.keys() == again.keys()
    for key, entry in shipped.items():
        assert (again[key].value, again[key].largest) == (pytest.approx(entry.value, rel=0.01, abs=1e-6), entry.largest)
        assert again[key].by_bin == pytest.approx(entry.by_bin, rel=0.01, abs=1e-5)


def test_without_a_simulator_no_variant_of_it_is_left() -> None:
    """Kills: patterns of a simulator that was left out."""
    shipped, found = measured_discrepancy(), left_out.without("mujoco")
    assert not any(name.startswith("mujoco") for e in found.entries for name in (e.largest, *e.by_variant))
    assert [len(one.rows) for one in found.patterns] < [len(one.rows) for one in shipped.patterns]
    sizes = {(e.kind, e.phase, e.signal, e.index): e.value for e in shipped.entries}
    assert all(e.value <= 1.01 * sizes[e.kind, e.phase, e.signal, e.index] + 1e-6 for e in found.entries)
    assert found.document.used and "mujoco" not in found.document.provenance
