# SPDX-License-Identifier: Apache-2.0
"""Steps of the loop write all of their files, or none."""

from __future__ import annotations

from pathlib import Path

import documents
import pytest

from impact_rs_analysis.application.described_folder import described_folder
from impact_rs_analysis.application.loop_steps import Addition
from impact_rs_analysis.evidence.calibration import LaboratoryCalibration
from impact_rs_sim.errors import InputError
from impact_rs_sim.model import load_model


def test_a_calibration_that_cannot_be_written_leaves_no_new_model(tmp_path: Path) -> None:
    """Kills a model without the faults that were diagnosed with it."""
    nominal, child = load_model("nominal"), tmp_path / "model_2.yaml"
    (tmp_path / "file").write_text("")
    calibration = LaboratoryCalibration(nominal, tmp_path / "file" / "calibration.yaml")
    with pytest.raises(InputError):
        Addition(nominal, nominal, calibration, (), (), documents.diagnosis()).write(child)
    assert not child.exists()


def test_a_description_is_written_whole_and_never_over_another(tmp_path: Path) -> None:
    """Kills files that stay when the description turns out to be wrong, and one that is overwritten."""
    texts = {"experiment.yaml": "scenario: push\n", "mapping.yaml": "robot: franka_fer\n"}
    with pytest.raises(ValueError, match="cannot be read"), described_folder(tmp_path, texts) as aside:
        assert {path.name for path in aside.iterdir()} == set(texts)
        raise ValueError("cannot be read")
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "mapping.yaml").write_text("mine")
    with pytest.raises(InputError, match="never overwritten"), described_folder(tmp_path, texts):
        pass
    assert (tmp_path / "mapping.yaml").read_text() == "mine" and len(list(tmp_path.iterdir())) == 1
