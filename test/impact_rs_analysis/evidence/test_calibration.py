# SPDX-License-Identifier: Apache-2.0
"""A calibration of the readings takes part in predictions and, with its intervals, in those of other effects."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from joint_recordings import write_npz
from refusals import lacking, refusal
from slender_arm import mapping_of, slender_arm, swung

from impact_rs_analysis.diagnosis.search.candidate import Candidate, linearise
from impact_rs_analysis.diagnosis.search.fit import Evidence
from impact_rs_analysis.evidence.calibration import (
    NO_CALIBRATION,
    LaboratoryCalibration,
    calibration_in,
    calibration_of,
    check_faults,
    write_calibration,
)
from impact_rs_analysis.evidence.sources.recording_source import RecordingSource
from impact_rs_sim.model import Model, ModelEffect, ParameterValue
from impact_rs_sim.numbers import NORMAL_95
from impact_rs_trials.recordings.recording import read_recordings

NOMINAL = Model(name="nominal")
SIGMA = 2e-3  # s


def late(delay: float, half: float | None = None) -> Model:
    """A calibration of torques that are recorded later than positions, with half an interval [s]."""
    ci95 = None if half is None else (delay - half, delay + half)
    value = ParameterValue(estimate=delay, unit="s", ci95=ci95)
    return Model(name="calibration", effects=(ModelEffect(name="torque_delay", parameters={"delay": value}),))


def test_an_interval_widens_those_of_other_effects_by_what_they_move(tmp_path: Path) -> None:
    """Half width^2 = own^2 + (1.96 change of the estimate per standard deviation)^2, by fits with the delay moved.

    Kills: an interval that is left out, or that counts as a standard deviation; rows on another scale than residuals.
    """
    mapping = mapping_of(tmp_path, slender_arm(("revolute",) * 3))
    write_npz(tmp_path / "run.npz", swung(mapping, {"joint_viscous_friction": {"viscous_joint1": 0.5}}))
    recordings = read_recordings(tmp_path / "run.npz", mapping)

    def fitted(faults: Model) -> tuple[np.ndarray, np.ndarray]:
        """Estimates of friction with the readings so, and what calibrations move them by [scales]."""
        source = RecordingSource.of(recordings, mapping, LaboratoryCalibration(faults).of(NOMINAL))
        effect = source.known_effects["joint_viscous_friction"]
        evidence = Evidence.of(source)
        start = np.array([0.5, 0.0, 0.0])
        candidate = linearise(
            Candidate.of((effect,), source, start), evidence.clusters, evidence.numbers, source, share=1e-3
        )
        assert candidate is not None
        problem = evidence.problem(candidate)
        return candidate.point / candidate.scale + problem.solve(), problem.calibration_standard_errors()

    exact, moved_exact = fitted(late(0.0))
    _, moved = fitted(late(0.0, NORMAL_95 * SIGMA))
    one = fitted(late(SIGMA))[0] - exact
    assert np.abs(one).max() > 0.05  # scales: it matters
    assert np.sqrt(moved**2 - moved_exact**2)[:1] == pytest.approx(np.abs(one)[:1], rel=0.1)


def test_a_calibration_belongs_to_the_folder_of_its_measurements(tmp_path: Path) -> None:
    """Kills: a calibration beside other data; ``nominal`` that is read from the folder."""
    assert not calibration_of(tmp_path)
    write_calibration(LaboratoryCalibration(late(0.02), tmp_path / "calibration.yaml"))
    (tmp_path / "run.npz").touch()
    for data in (tmp_path, tmp_path / "run.npz"):
        assert [item.name for item in calibration_of(data).faults.effects] == ["torque_delay"]
    assert not calibration_of(tmp_path, "nominal") and not calibration_in(tmp_path / "other.yaml")
    said = refusal(calibration_of, tmp_path, tmp_path / "missing.yaml")
    assert not lacking(said, "missing.yaml")


def test_a_calibration_adds_its_effects_and_keeps_the_name_of_the_model() -> None:
    payload = Model(name="mine", effects=(_mass(1.1),))
    whole = LaboratoryCalibration(late(0.02)).of(payload)
    assert (whole.name, [item.name for item in whole.effects]) == ("mine", ["object_mass", "torque_delay"])
    assert NO_CALIBRATION.of(payload) is payload
    said = refusal(LaboratoryCalibration(late(0.02), Path("c.yaml")).of, late(0.01))
    assert not lacking(said, "c.yaml|effects.0.name|torque_delay|applied twice|remove it from one")
    said = refusal(check_faults, payload, "c.yaml")
    assert not lacking(said, "c.yaml|effects.0.name|object_mass|--model")


def _mass(scale: float) -> ModelEffect:
    return ModelEffect(name="object_mass", parameters={"scale": ParameterValue(estimate=scale, unit="-")})
