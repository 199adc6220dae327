# SPDX-License-Identifier: Apache-2.0
"""Friction that one arm of two has is found in that arm, where the arms have different numbers of joints."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from intervals import assert_covers
from mixed_grab import MIXED, with_own

from impact_rs_analysis.diagnosis.add import add_effects
from impact_rs_analysis.diagnosis.diagnose import diagnose
from impact_rs_analysis.diagnosis.document import DiagnosisDocument, read_document, write_document
from impact_rs_analysis.diagnosis.verdict import CONFIRMED
from impact_rs_analysis.evidence.replays.measured_runs import Runs, read_runs
from impact_rs_analysis.evidence.replays.replay_cache import ReplayCache
from impact_rs_analysis.evidence.sources.run_source import ReplaySource
from impact_rs_sim.model import load_model
from impact_rs_trials.bags.record import record_trial
from impact_rs_trials.bags.trial_info import TrialInfo
from impact_rs_trials.campaign import Trial
from impact_rs_trials.spec import TrialSpec

FRICTION = 2.0  # N m, in the second joint of the UR5e
CONDITIONS = (("parcel", "case_1"), ("cat_food", "case_1"), ("parcel", "case_2"))
# s; a third as long, and half of the steps, in plant and replay alike
SHORT = {
    "nominal_impact": 0.34,
    "approach": 0.3,
    "push": 0.1,
    "duration": 0.46,
    "window_after": 0.1,
    "drive_period": 0.0005,
}
SCENARIO = MIXED.model_copy(update={"timing": MIXED.timing.model_copy(update=SHORT)})


@pytest.fixture(scope="module")
def runs(made_once: Callable[[str, Callable[[Path], None]], Path]) -> Runs:
    values = np.zeros(13)
    values[7 + 1] = FRICTION

    def record(folder: Path) -> None:
        for spec in (TrialSpec.of(SCENARIO, *condition) for condition in CONDITIONS):
            for repeat in range(2):
                trial = Trial.of(spec, repeat, 3)
                info = TrialInfo.of(spec.plan, trial.key, trial.seed, "inprocess")
                hidden = with_own(spec.plan.scene.physics, "joint_coulomb_friction", values)
                assert record_trial(spec.plan, info, folder / trial.key.name, hidden)[0].outcome == "OK"

    return read_runs(made_once("mixed_runs", record), map)


@pytest.fixture(scope="module")
def document(runs: Runs, tmp_path_factory: pytest.TempPathFactory) -> DiagnosisDocument:
    with pytest.MonkeyPatch.context() as patched:
        patched.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        model = load_model("nominal")
        source = ReplaySource.of(runs, model, ReplayCache(map))
        return diagnose(source, model, ["joint_coulomb_friction", "object_mass"])


def test_friction_is_found_in_the_arm_and_joint_that_have_it(document: DiagnosisDocument) -> None:
    assert str(document.verdict) == "joint_coulomb_friction"
    assert document.held_out_error_after < 0.1 * document.held_out_error_before
    found = document.effects[0].parameters
    assert len(found) == 13 and document.arms == {"left": 7, "right": 6}
    for name, value in found.items():
        assert (value.verdict == CONFIRMED) == (name == "coulomb_right_joint2"), name
    planted = found["coulomb_right_joint2"]
    assert (planted.arm, planted.joint) == ("right", "joint2")
    assert_covers(planted.interval, FRICTION, 0.022)


def test_the_added_effect_predicts_the_runs(document: DiagnosisDocument, runs: Runs, tmp_path: Path) -> None:
    file = tmp_path / "diagnosis.json"
    write_document(document, file)
    nominal, output = load_model("nominal"), tmp_path / "model_2.yaml"
    child = add_effects(
        nominal, Path("nominal"), read_document(file), file, ["joint_coulomb_friction"], output, force=False
    )
    assert child.arms == {"left": 7, "right": 6}
    before, after = (ReplaySource.of(runs, model, ReplayCache(map)).size() for model in (nominal, child))
    assert after < 0.1 * before
