# SPDX-License-Identifier: Apache-2.0
"""Rollouts of held-out motion say whether effects predict, and contradict a torque balance that is right by chance."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from joint_recordings import Columns, write_npz
from slender_arm import FLAT, lighter, mapping_of, slender_arm, swung

from impact_rs_analysis.diagnosis.diagnose import diagnose
from impact_rs_analysis.diagnosis.document import HeldOutRollouts
from impact_rs_analysis.diagnosis.search.hold_out import HoldOut, folds_of
from impact_rs_analysis.diagnosis.verdicts.held_out_rollouts import held_out_rollouts
from impact_rs_analysis.evidence.cluster import Added
from impact_rs_analysis.evidence.rollouts import CLOSED_LOOP
from impact_rs_analysis.evidence.sources.recording_source import RecordingSource
from impact_rs_sim.model import Model
from impact_rs_trials.recordings.mapping import Mapping
from impact_rs_trials.recordings.recording import read_recordings

TRUE, WRONG = (0.3, 0.2), (-0.3, -0.2)  # N m


def source_of(folder: Path, mapping: Mapping, columns: Columns) -> RecordingSource:
    (run,) = read_recordings(write_npz(folder / "run.npz", columns), mapping)
    return RecordingSource.of([run], mapping, Model(name="nominal"))


@pytest.fixture(scope="module")
def rubbed(tmp_path_factory: pytest.TempPathFactory) -> RecordingSource:
    folder = tmp_path_factory.mktemp("rubbed")
    mapping = mapping_of(folder, slender_arm(("revolute",) * 2, FLAT), torque_measured_at="motor")
    planted = {"joint_coulomb_friction": {"coulomb_joint1": TRUE[0], "coulomb_joint2": TRUE[1]}}
    return source_of(folder, mapping, swung(mapping, planted))


def held_out(source: RecordingSource, *added: Added) -> HeldOutRollouts:
    """Rollouts with given effects, one set per fold; only some of the effects change them."""
    found = rollouts_with(source, *added)
    assert found is not None
    return found


def rollouts_with(source: RecordingSource, *added: Added) -> HeldOutRollouts | None:
    """Rollouts with effects that are given fold by fold, in turn."""
    folds = folds_of(source)
    fitted = tuple(added[number % len(added)] for number in range(len(folds)))
    rest = tuple(item.mean for item in source.clusters)
    names = tuple(tuple(name for name, _ in one) for one in fitted)
    return held_out_rollouts(source, HoldOut(tuple(folds), rest, names, (True,) * len(folds), (), fitted))


def test_with_the_true_effect_every_held_out_rollout_is_closer(rubbed: RecordingSource) -> None:
    """Kills rollouts of the model in place of those of the fold's effects, and a change of the wrong sign."""
    found = held_out(rubbed, (("joint_coulomb_friction", TRUE),))
    assert found.closer == found.compared >= 6
    assert found.p_value is not None and found.p_value < 0.05 and not found.worse
    assert found.after.last.tool_mm < 0.2 * found.before.last.tool_mm
    assert found.disagreement((-0.2, -0.1)) == ""
    assert f"closer with the effects in {found.compared} of {found.compared}" in found.in_words


def test_effects_that_predict_worse_contradict_a_balance_that_improves(rubbed: RecordingSource) -> None:
    """Kills a sentence without a test, and one where the balance is not sure itself."""
    found = held_out(rubbed, (("joint_coulomb_friction", WRONG),))
    assert found.closer == 0 and found.worse
    assert "disagree" in found.disagreement((-0.2, -0.1)) and "wrong model class" in found.disagreement((-0.2, -0.1))
    assert "predictions in open loop over" in found.disagreement((-0.2, -0.1))
    servos = found.after.model_copy(update={"what": CLOSED_LOOP})  # kills a loop that is always open
    closed = found.model_copy(update={"after": servos})
    assert "predictions in closed loop over" in closed.disagreement((-0.2, -0.1))
    assert found.disagreement((-0.2, 0.1)) == "" == found.disagreement(None)


def test_folds_without_an_effect_do_not_count_for_or_against_it(rubbed: RecordingSource) -> None:
    """Kills effects of a fold that predict another one."""
    found = held_out(rubbed, (), (("joint_coulomb_friction", TRUE),))
    assert 0.3 * found.compared < found.closer < 0.7 * found.compared


def test_effects_that_change_no_free_motion_have_no_rollouts(rubbed: RecordingSource) -> None:
    """Kills "closer in 0 of 32" of a friction of the support."""
    assert rollouts_with(rubbed, ()) is None


@pytest.mark.parametrize(("factor", "horizon_s"), [pytest.param(1.0, 2.0, marks=pytest.mark.slow), (10.0, 0.5)])
def test_rollouts_are_compared_while_one_of_both_predicts(factor: float, horizon_s: float, tmp_path: Path) -> None:
    """The effect has 90 % of a friction of 0.3 or 3 N m. Kills the longest horizon, where both models fail."""
    mapping = mapping_of(tmp_path, slender_arm(("revolute",) * 2, FLAT), torque_measured_at="motor")
    planted = {"joint_coulomb_friction": {"coulomb_joint1": factor * TRUE[0], "coulomb_joint2": factor * TRUE[1]}}
    source = source_of(tmp_path, mapping, swung(mapping, planted))
    found = held_out(source, (("joint_coulomb_friction", tuple(0.9 * factor * one for one in TRUE)),))
    assert found.horizon_s == horizon_s
    assert found.closer >= found.compared - 1 >= 6
    assert ("after 0.5 s, beyond which neither predicts" in found.in_words) == (horizon_s < 2.0)


def test_friction_that_stands_in_for_a_law_of_the_frequency_is_contradicted_by_rollouts(tmp_path: Path) -> None:
    """Viscous friction of 0.3 N m s/rad at 0.9 Hz and of -0.1 N m s/rad at 0.08 Hz, of an inertia of 1.1 kg m^2.

    Most of the squared velocity is fast, and decides the balance. Slow errors are what two seconds add up to.
    """
    mapping = mapping_of(tmp_path, lighter(slender_arm(("revolute",), FLAT), 10.0), torque_measured_at="motor")
    time = np.arange(0.0, 72.0, 0.02)
    slow, fast = ((2.0 * np.pi * rate, size) for rate, size in ((0.08, 1.0), (0.9, 0.3)))
    q, dq, ddq = (np.zeros_like(time) for _ in range(3))
    effort = np.random.default_rng(0).normal(0.0, 0.01, time.size)
    for (omega, size), viscous in ((slow, -0.1), (fast, 0.3)):
        q += size * np.sin(omega * time)
        dq += size * omega * np.cos(omega * time)
        ddq -= size * omega**2 * np.sin(omega * time)
        effort += viscous * size * omega * np.cos(omega * time)
    effort += 1.1 * ddq
    columns = {"time": time} | {
        name: values[:, None] for name, values in (("position", q), ("velocity", dq), ("effort", effort))
    }
    source = source_of(tmp_path, mapping, columns)
    found = diagnose(source, source.model, only=["joint_viscous_friction"])
    assert found.named == ("joint_viscous_friction",)
    assert found.rollouts is not None and found.rollouts.worse, found.rollouts.in_words
    assert "The two estimators disagree" in found.summary
