# SPDX-License-Identifier: Apache-2.0
"""Payloads that exist are found with what they resist being turned; those that cannot exist are at a bound, at most."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from analytic_world import AnalyticSource
from impact_table_cases import arm_table, write_csv
from joint_recordings import swinging, write_npz

from impact_rs_analysis.diagnosis.diagnose import diagnose, effects_for
from impact_rs_analysis.diagnosis.document import EffectDocument
from impact_rs_analysis.diagnosis.search.candidate import Candidate, linearise
from impact_rs_analysis.diagnosis.search.effect_selection import Search
from impact_rs_analysis.diagnosis.search.fit import Evidence, Fit, replay_and_refit
from impact_rs_analysis.evidence.sources.recording_source import RecordingSource
from impact_rs_analysis.evidence.sources.table_source import ImpactTableSource
from impact_rs_analysis.evidence.tables.map_discrepancy import NO_MAP_DISCREPANCY
from impact_rs_sim.effects.depending import Depending, Slope
from impact_rs_sim.errors import InputError
from impact_rs_sim.model import Model
from impact_rs_sim.robots.robot import EndEffector
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_trials.recordings.impacts.impact_table import read_impact_table
from impact_rs_trials.recordings.mapping import Mapping, MountedEndEffector, load_mapping
from impact_rs_trials.recordings.recording import read_recordings

BARE = load_mapping("joint_state")
TOOL = MountedEndEffector(mass=0.6, com=(0.0, 0.0, -0.04), inertia=(1e-3, 0.0, 0.0, 1e-3, 0.0, 5e-4), length=0.1)
WITH_TOOL = BARE.model_copy(update={"end_effector": TOOL})
CENTRE = np.array([0.0, -0.3, 0.0, -2.0, 0.0, 1.8, 0.5])  # rad
NOISE = 0.02  # N m
HAND = 0.73, np.array([-0.01, 0.0, 0.03]), np.diag([0.001, 0.0025, 0.0017])  # Franka hand: kg, m, kg m^2
PAYLOAD = "end_effector_payload"


def mounted(mapping: Mapping, mass: float, place: np.ndarray, inertia: np.ndarray | float = 0.0) -> EndEffector:
    """The end effector with something added, or taken away where mass and inertia are negative."""

    def about(offset: np.ndarray) -> np.ndarray:
        return offset @ offset * np.eye(3) - np.outer(offset, offset)

    tool = mapping.end_effector.build()
    com = (tool.mass * tool.com + mass * place) / (tool.mass + mass)
    moments = tool.inertia + tool.mass * about(tool.com - com) + inertia + mass * about(place - com)
    return replace(tool, mass=tool.mass + mass, com=com, inertia=moments)


def source_of(
    folder: Path, mapping: Mapping, end: EndEffector, fast: float = 1.0, noise: float = NOISE
) -> RecordingSource:
    """24 s of free motion of an arm with another end effector than the mapping says."""
    frequencies = fast * (0.11 + 0.017 * np.arange(7)), fast * (0.31 - 0.013 * np.arange(7))
    columns = swinging(RobotModel(mapping.facts, end), np.arange(0.0, 24.0, 0.02), CENTRE, frequencies, (0.45, 0.12))
    columns["effort"] += np.random.default_rng(1).normal(0.0, noise, columns["effort"].shape)
    recordings = read_recordings(write_npz(folder / "a.npz", columns), mapping)
    return RecordingSource.of(recordings, mapping, Model(name="nominal"))


def found_in(source: RecordingSource, effects: list[str]) -> dict[str, EffectDocument]:
    document = diagnose(source, source.model, effects)
    return {name: entry for name in effects if (entry := document.effect(name)) is not None}


def exists(source: RecordingSource, entry: EffectDocument) -> bool:
    """Whether the estimate leaves bodies."""
    candidate = Candidate.of((source.known_effects[entry.name],), source)
    return candidate.physically_consistent(np.array([value.estimate for value in entry.parameters.values()]))


def assert_holds(entry: EffectDocument, name: str, true: float, widest: float) -> None:
    """The interval holds the truth and is no wider than stated."""
    low, high = entry.parameters[name].interval
    assert low <= true <= high and high - low < widest


@pytest.mark.parametrize("place", [(0.25, 0.0, 0.0), pytest.param((0.0, -0.3, 0.0), marks=pytest.mark.slow)])
def test_a_payload_that_no_body_can_lose_is_at_a_bound(place: tuple[float, float, float], tmp_path: Path) -> None:
    """Planted is what only an impossible body explains; the estimate is the nearest one that can exist."""
    source = source_of(tmp_path, WITH_TOOL, mounted(WITH_TOOL, -0.2, np.array(place)))
    entry = found_in(source, [PAYLOAD])[PAYLOAD]
    assert str(entry.verdict) == "AT-BOUND" and exists(source, entry)
    assert all(value.at_bound for value in entry.parameters.values())
    assert np.linalg.norm([entry.parameters[f"com_{axis}"].estimate for axis in "xyz"]) < 0.5 * np.linalg.norm(place)


@pytest.mark.parametrize(
    ("mapping", "mass", "place", "verdict"),
    [
        pytest.param(BARE, 0.5, (0.02, 0.01, 0.05), "CONFIRMED", marks=pytest.mark.slow),
        (BARE, -0.3, (0.01, 0.0, -0.03), "CONFUSABLE-WITH"),  # near the wrist: as links of another 9 %
        (WITH_TOOL, -0.3, (0.01, 0.0, -0.03), "CONFIRMED"),
    ],
)
def test_what_can_be_added_or_taken_away_is_found(
    mapping: Mapping, mass: float, place: tuple[float, float, float], verdict: str, tmp_path: Path
) -> None:
    source = source_of(tmp_path, mapping, mounted(mapping, mass, np.array(place)))
    entry = found_in(source, [PAYLOAD])[PAYLOAD]
    assert entry.verdict.kind == verdict and exists(source, entry)
    assert_holds(entry, "mass", mass, 0.2 * 0.735)
    assert entry.parameters["mass"].estimate == pytest.approx(mass, abs=0.03)
    for axis, true, widest in zip("xyz", place, (0.02, 0.02, 0.08), strict=True):
        assert_holds(entry, f"com_{axis}", true, widest)


def test_slow_motion_beside_noise_leaves_the_radius_of_gyration_at_its_prior(tmp_path: Path) -> None:
    """0.0017 kg m^2 at 1 rad/s^2 are a hundredth of the noise; what nothing shows is no reason to doubt the mass."""
    source = source_of(tmp_path, BARE, mounted(BARE, *HAND), noise=0.2)
    entry = found_in(source, [PAYLOAD])[PAYLOAD]
    assert str(entry.verdict) == "CONFIRMED"
    assert_holds(entry, "mass", HAND[0], 0.3)
    gyration = entry.parameters["gyration"]
    assert not gyration.at_bound
    assert gyration.interval[0] == 0.0 and 0.05 < gyration.interval[1] < 0.25  # the prior: 0.05 m about 0


def test_an_extended_gripper_is_named_with_its_radius_of_gyration(tmp_path: Path) -> None:
    """A Franka hand resists being turned about joint 7 like a ring of 48 mm; a point mass leaves that to the links."""
    source = source_of(tmp_path, BARE, mounted(BARE, *HAND), fast=4.0)
    entries = found_in(source, [PAYLOAD, "link_mass", "link_inertia"])
    payload = entries[PAYLOAD]
    assert payload.verdict.kind in ("CONFIRMED", "CONFUSABLE-WITH")
    assert {str(entry.verdict) for name, entry in entries.items() if name != PAYLOAD} != {"CONFIRMED"}
    assert_holds(payload, "mass", HAND[0], 0.1)
    assert_holds(payload, "gyration", np.sqrt(0.0017 / HAND[0]), 0.02)


def test_a_payload_that_predicts_as_well_as_another_density_of_the_last_link_is_tied_with_it(tmp_path: Path) -> None:
    """A hand about the centre of link 7: its place is not seen before it has a mass, and it is a rival all the same."""
    source = source_of(tmp_path, BARE, mounted(BARE, HAND[0], np.array([0.0105, -0.0043, -0.0454]), HAND[2]))
    search = Search(effects_for(source, [PAYLOAD, "link_mass"]), Evidence.of(source))
    links = search.fitted(["link_mass"])
    assert links is not None
    (rival,) = search.rivals(replay_and_refit(links))
    assert (rival.name, rival.tied) == (PAYLOAD, True)
    assert rival.fit.estimate[0] == pytest.approx(HAND[0], abs=0.03)


def test_a_fit_does_not_step_to_an_object_whose_mass_is_negative_under_some_circumstances(tmp_path: Path) -> None:
    """Mass along a covariate: a slope within its range leads below zero at the ends; no row then has a solution."""
    header, rows = arm_table({"object_mass": [1.1]}, 2)
    table = read_impact_table(
        write_csv(tmp_path / "a.csv", [*header, "fill"], [[*row, float(n)] for n, row in enumerate(rows)]),
        load_scenario("push"),
        covariates=["fill"],
    )
    nominal = Model(name="nominal")
    source = ImpactTableSource(table, nominal, discrepancy=NO_MAP_DISCREPANCY)
    values = np.arange(float(len(rows)))
    mass = Depending(source.known_effects["object_mass"], "fill", Slope(float(values.mean()), float(values.std())))
    knowing = source.with_dependences([mass])
    assert knowing.predict([(0, ((mass.name, (1.1, -0.9)),))], "test") == [None]
    candidate = Candidate.of((mass,), knowing)
    assert candidate.physically_consistent(np.array([1.1, 0.1])) and not candidate.physically_consistent(
        np.array([1.1, -0.9])
    )
    clusters, numbers = knowing.clusters, range(len(knowing.clusters))
    seen = linearise(candidate, clusters, numbers, knowing)
    assert seen is not None
    wild = [
        replace(item, residuals=item.residuals - 30.0 * jacobian[:, 1])
        for item, jacobian in zip(clusters, seen.jacobians, strict=True)
    ]
    fitted = Fit.of(seen, Evidence(knowing, tuple(numbers), tuple(wild)))
    assert candidate.physically_consistent(fitted.estimate) and fitted.at_bound.any()


def test_the_place_of_a_payload_is_unsure_only_while_there_is_no_payload(tmp_path: Path) -> None:
    """A radius of gyration that no torque feels although there is a mass stays unfelt."""
    source = source_of(tmp_path, WITH_TOOL, mounted(WITH_TOOL, 0.5, np.zeros(3)))
    none = linearise(Candidate.of((source.known_effects[PAYLOAD],), source), source.clusters, range(24), source)
    assert none is not None and none.insensitive_shapes == none.insensitive == [1, 2, 3, 4]
    some = replace(none, point=np.array([0.5, 0.0, 0.0, 0.0, 0.0]))
    assert some.insensitive == [1, 2, 3, 4] and some.insensitive_shapes == []


def test_an_unknown_effect_is_an_input_error() -> None:
    """Kills: a bare KeyError of a misspelt effect."""
    with pytest.raises(InputError, match="no effect 'joint_coulomb_frictoin'; did you mean 'joint_coulomb_friction'"):
        effects_for(AnalyticSource(0), ["joint_coulomb_frictoin"])
