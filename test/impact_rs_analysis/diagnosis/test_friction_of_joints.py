# SPDX-License-Identifier: Apache-2.0
"""Friction by load, direction, breakaway and common shaft: planted in recordings in closed form, and found.

The recordings are inverse dynamics of Pinocchio plus friction with a sharp sign, written out here: not the smoothed law
of the library. Neighbours compete: Coulomb, viscous and Stribeck friction, its width at reversals, offset and
gain of the torque.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from joint_recordings import swinging, write_npz
from slender_arm import mapping_of, slender_arm, swung

from impact_rs_analysis.diagnosis.diagnose import diagnose, effects_for
from impact_rs_analysis.diagnosis.document import DiagnosisDocument
from impact_rs_analysis.diagnosis.search.budget import Budget
from impact_rs_analysis.diagnosis.search.effect_selection import Search
from impact_rs_analysis.diagnosis.search.fit import Evidence
from impact_rs_analysis.evidence.sources.recording_source import RecordingSource
from impact_rs_sim.model import Model
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_trials.recordings.mapping import Mapping
from impact_rs_trials.recordings.recording import read_recordings

NEIGHBOURS = (
    "joint_coulomb_friction",
    "joint_viscous_friction",
    "joint_stribeck_friction",
    "torque_offset",
    "torque_gain",
    "joint_load_dependent_friction",
    "joint_asymmetric_friction",
    "joint_sum_friction",
    "joint_difference_friction",
    "joint_reversal_width",
)
WITH_LOAD = (
    "end_effector_payload",
    "joint_coulomb_friction",
    "joint_viscous_friction",
    "joint_load_dependent_friction",
)
OF_SHAFTS = ("joint_coulomb_friction", "joint_viscous_friction", "joint_sum_friction", "joint_difference_friction")
COULOMB = np.array([0.9, 0.6, 0.4])  # N m
SHARE = np.array([0.06, 0.08, 0.05])  # of the transmitted torque
UNEVEN = np.array([0.25, -0.2, 0.15])  # N m, half of forward minus backward
LOAD_KG = 1.2
NOISE = 0.02  # N m

TIME = np.arange(0.0, 12.0, 0.02)  # s
FREQUENCIES = np.full(3, 0.2), np.full(3, 0.5)  # Hz

Law = Callable[[Array, Array], Array]
"""Torque that friction takes, from velocity [rad/s] and transmitted torque [N m]."""


@pytest.fixture(scope="module")
def mapping(tmp_path_factory: pytest.TempPathFactory) -> Mapping:
    return mapping_of(tmp_path_factory.mktemp("arm"), slender_arm(("revolute",) * 3))


def recorded(path: Path, mapping: Mapping, law: Law, load: float = 0.0, seed: int = 1) -> Path:
    """36 s at 50 Hz of three joints that swing upright, with friction and a load at the flange."""
    end = mapping.end_effector.model_copy(update={"mass": load}).build()
    frequencies = 0.13 + 0.03 * np.arange(3), 0.37 - 0.02 * np.arange(3)
    found = swinging(RobotModel(mapping.facts, end), np.arange(0.0, 36.0, 0.02), 0.0, frequencies, (0.6, 0.15))
    found["effort"] = found["effort"] + law(found["velocity"], found["effort"])
    found["effort"] += np.random.default_rng(seed).normal(0.0, NOISE, found["effort"].shape)
    return write_npz(path, found)


def diagnosed(
    mapping: Mapping, path: Path, minus: Path | None = None, among: tuple[str, ...] = NEIGHBOURS
) -> DiagnosisDocument:
    references = [] if minus is None else read_recordings(minus, mapping)
    source = RecordingSource.of(read_recordings(path, mapping), mapping, Model(name="nominal"), references)
    return diagnose(source, source.model, among)


def assert_inside(found: DiagnosisDocument, name: str, parameter: str, truth: Array, width: float) -> None:
    """The 95 % interval of every joint holds the truth, and none is wider than ``width``."""
    effect = found.effect(name)
    assert effect is not None
    for joint, value in enumerate(truth, start=1):
        low, high = effect.parameters[f"{parameter}_joint{joint}"].interval
        assert low <= value <= high, f"{name}, joint {joint}: [{low:.4g}, {high:.4g}] leaves {value:.4g} out"
        assert high - low < width, f"{name}, joint {joint}: [{low:.4g}, {high:.4g}]"


def coulomb(velocity: Array, transmitted: Array) -> Array:
    return COULOMB * np.sign(velocity)


def by_load(velocity: Array, transmitted: Array) -> Array:
    return (COULOMB + SHARE * np.abs(transmitted)) * np.sign(velocity)


def test_friction_that_a_load_adds_is_load_dependent_friction(mapping: Mapping, tmp_path: Path) -> None:
    """Loaded minus unloaded: Coulomb friction cancels, and what remains of friction grows with the torque.

    Kills a difference in which a property of the arm cancels although the load changes what it does.
    """
    empty = recorded(tmp_path / "empty.npz", mapping, by_load, seed=1)
    loaded = recorded(tmp_path / "loaded.npz", mapping, by_load, LOAD_KG, seed=2)
    found = diagnosed(mapping, loaded, empty, WITH_LOAD)
    assert set(found.named) == {"end_effector_payload", "joint_load_dependent_friction"}
    assert_inside(found, "joint_load_dependent_friction", "coefficient", SHARE, width=0.02)
    mass = found.effect("end_effector_payload").parameters["mass"]
    assert mass.interval[0] <= LOAD_KG <= mass.interval[1]


def test_load_on_an_arm_with_constant_friction_names_no_friction(mapping: Mapping, tmp_path: Path) -> None:
    empty = recorded(tmp_path / "empty.npz", mapping, coulomb, seed=1)
    loaded = recorded(tmp_path / "loaded.npz", mapping, coulomb, LOAD_KG, seed=2)
    found = diagnosed(mapping, loaded, empty, WITH_LOAD)
    assert found.named == ("end_effector_payload",)


@pytest.mark.slow
def test_load_dependent_friction_is_told_from_constant_friction_where_gravity_varies(
    mapping: Mapping, tmp_path: Path
) -> None:
    found = diagnosed(mapping, recorded(tmp_path / "run.npz", mapping, by_load))
    assert {"joint_coulomb_friction", "joint_load_dependent_friction"} <= set(found.named)
    assert_inside(found, "joint_load_dependent_friction", "coefficient", SHARE, width=0.05)


def test_asymmetric_friction_is_confusable_with_an_offset_of_the_torque_in_motion(
    mapping: Mapping, tmp_path: Path
) -> None:
    """Kills an asymmetry that contains Coulomb friction: it alone would explain what two effects explain as well."""

    def uneven(velocity: Array, transmitted: Array) -> Array:
        return COULOMB * np.sign(velocity) + UNEVEN

    found = diagnosed(mapping, recorded(tmp_path / "run.npz", mapping, uneven))
    tied = {"joint_asymmetric_friction", "torque_offset"}
    assert len(tied & set(found.named)) == 1 and any(tied <= set(group) for group in found.confusable)
    assert set(found.named) - tied == {"joint_coulomb_friction"}
    assert_inside(found, "joint_asymmetric_friction", "difference", UNEVEN, width=1.3)


def test_without_time_for_fits_of_rivals_their_linear_fits_are_compared(mapping: Mapping, tmp_path: Path) -> None:
    """Kills CONFIRMED, because the time was spent before a rival was looked at."""
    path = recorded(tmp_path / "run.npz", mapping, lambda velocity, _: COULOMB * np.sign(velocity) + UNEVEN)
    source = RecordingSource.of(read_recordings(path, mapping), mapping, Model(name="nominal"))
    names = ("joint_coulomb_friction", "joint_asymmetric_friction", "torque_offset")
    search = Search(effects_for(source, names), Evidence.of(source, budget=Budget(0.0)))
    chosen = search.fitted(("joint_coulomb_friction", "joint_asymmetric_friction"))
    assert chosen is not None
    tied = [(rival.name, rival.instead_of) for rival in search.rivals(chosen) if rival.tied]
    assert tied == [("torque_offset", "joint_asymmetric_friction")]
    assert "torque_offset in the place of joint_asymmetric_friction" in search.evidence.budget.left_out


@pytest.mark.parametrize(
    ("ratio", "name", "among"),
    [
        pytest.param(1.0, "joint_sum_friction", NEIGHBOURS, marks=pytest.mark.slow),
        (-1.0, "joint_difference_friction", OF_SHAFTS),
    ],
)
def test_friction_of_a_shaft_that_two_joints_turn_is_found_with_its_sense(
    mapping: Mapping, tmp_path: Path, ratio: float, name: str, among: tuple[str, ...]
) -> None:
    """Kills a reaction on one of the two joints only, and shafts that turn the wrong way."""

    def shaft(velocity: Array, transmitted: Array) -> Array:
        speed = velocity[:, 1] + ratio * velocity[:, 2]
        own = 0.7 * np.sign(speed) + 0.5 * speed
        return coulomb(velocity, transmitted) + np.column_stack((0.0 * own, own, ratio * own))

    found = diagnosed(mapping, recorded(tmp_path / "run.npz", mapping, shaft), among=among)
    assert set(found.named) == {"joint_coulomb_friction", name}
    assert_inside(found, name, "coulomb", np.array([0.0, 0.7]), width=0.2)
    assert_inside(found, name, "viscous", np.array([0.0, 0.5]), width=0.2)


@pytest.mark.slow
def test_breakaway_torque_is_told_from_sliding_friction(mapping: Mapping, tmp_path: Path) -> None:
    """F_c + F_s exp(-(dq / v_s)^2): the torque that moves a joint off, above the one that keeps it moving."""
    breakaway = np.array([0.6, 0.8, 0.5])

    def sticking(velocity: Array, transmitted: Array) -> Array:
        return (COULOMB + breakaway * np.exp(-np.square(velocity / 0.12))) * np.sign(velocity)

    found = diagnosed(mapping, recorded(tmp_path / "run.npz", mapping, sticking))
    assert set(found.named) == {"joint_coulomb_friction", "joint_stribeck_friction"}
    assert_inside(found, "joint_stribeck_friction", "breakaway", breakaway, width=0.4)


@pytest.mark.parametrize("planted", [None, pytest.param(coulomb, marks=pytest.mark.slow)])
def test_plain_friction_names_no_other_friction(mapping: Mapping, tmp_path: Path, planted: Law | None) -> None:
    nothing: Law = lambda velocity, transmitted: np.zeros_like(velocity)  # noqa: E731
    found = diagnosed(mapping, recorded(tmp_path / "run.npz", mapping, planted or nothing))
    assert found.named == (() if planted is None else ("joint_coulomb_friction",))


def test_an_arm_of_one_joint_has_no_shaft_of_two(tmp_path: Path) -> None:
    """Kills an effect without parameters among the candidates."""
    alone = mapping_of(tmp_path, slender_arm(("revolute",)))
    path = write_npz(tmp_path / "run.npz", swung(alone, {}))
    source = RecordingSource.of(read_recordings(path, alone), alone, Model(name="nominal"))
    offered = {effect.name for effect in effects_for(source)}
    assert "joint_load_dependent_friction" in offered
    assert not {"joint_sum_friction", "joint_difference_friction"} & offered


def test_friction_is_found_where_each_recording_moves_one_joint(mapping: Mapping, tmp_path: Path) -> None:
    """Kills folds of whole recordings: no other recording predicts the friction of a joint that rests there."""
    (tmp_path / "runs").mkdir()
    for joint in range(3):
        moving = np.eye(3)[joint]
        arm = RobotModel(mapping.facts, mapping.end_effector.build())
        found = swinging(arm, TIME, 0.3, FREQUENCIES, (0.6 * moving, 0.15 * moving))
        found["effort"] = found["effort"] + COULOMB * np.sign(found["velocity"])
        found["effort"] += np.random.default_rng(joint).normal(0.0, NOISE, found["effort"].shape)
        write_npz(tmp_path / "runs" / f"joint_{joint + 1}.npz", found)
    document = diagnosed(mapping, tmp_path / "runs", among=("joint_coulomb_friction", "end_effector_payload"))
    assert document.named == ("joint_coulomb_friction",)
    assert_inside(document, "joint_coulomb_friction", "coulomb", COULOMB, width=0.1)
    assert document.held_out_error_after < 0.1 * document.held_out_error_before
