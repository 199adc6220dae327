# SPDX-License-Identifier: Apache-2.0
"""Recordings of an arm that is right but for one reading: the reading is named, and nothing of the arm but what acts.

The faults are made of right columns by formulas of their own. Free motion does not tell everything apart: an encoder's
zero from the centres of all links behind it, a filter of a slow motion from a delay. Then the verdict says so.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from intervals import assert_covers
from joint_recordings import write_npz
from slender_arm import mapping_of, slender_arm, swung
from wrong_readings import (
    CROSSTALK,
    OFFSET,
    SCALE,
    TORQUE_LAG,
    VELOCITY_DELAY,
    VELOCITY_GAIN,
    VELOCITY_LAG,
    Fault,
)

from impact_rs_analysis.diagnosis.diagnose import diagnose
from impact_rs_analysis.diagnosis.document import DiagnosisDocument
from impact_rs_analysis.diagnosis.verdict import CONFIRMED
from impact_rs_analysis.evidence.sources.recording_source import RecordingSource
from impact_rs_sim.model import Model
from impact_rs_trials.recordings.recording import read_recordings

COULOMB = {f"coulomb_joint{joint}": 0.8 / joint for joint in (1, 2, 3)}  # N m
NOISE = 0.02  # N m
FEW = ("joint_coulomb_friction", "encoder_offset", "base_tilt", "torque_offset", "velocity_lag", "torque_delay")
HALF_WIDTHS = {  # of what is planted, most of it for the scale of the torque
    OFFSET.effect: 0.0041,
    SCALE.effect: 0.0125,
    CROSSTALK.effect: 0.0058,
    TORQUE_LAG.effect: 0.0011,
    VELOCITY_LAG.effect: 0.00043,
    VELOCITY_DELAY.effect: 0.00032,
    VELOCITY_GAIN.effect: 0.0028,
}


def source_of(folder: Path, fault: Fault, friction: bool = True) -> RecordingSource:
    mapping = mapping_of(folder, slender_arm(("revolute",) * 3))
    wrong = fault.made(swung(mapping, {"joint_coulomb_friction": COULOMB} if friction else {}, noise=0.0))
    noise = np.random.default_rng(3).normal(0.0, NOISE, wrong["effort"].shape)
    path = write_npz(folder / "run.npz", wrong | {"effort": wrong["effort"] + noise})
    return RecordingSource.of(read_recordings(path, mapping), mapping, Model(name="nominal"))


def found(folder: Path, fault: Fault, only: Sequence[str] | None = None, friction: bool = True) -> DiagnosisDocument:
    source = source_of(folder, fault, friction)
    return diagnose(source, source.model, only)


@pytest.mark.parametrize(
    ("fault", "only"),
    [
        (OFFSET, FEW),
        *(
            pytest.param(fault, None, marks=pytest.mark.slow)
            for fault in (OFFSET, SCALE, CROSSTALK, TORQUE_LAG, VELOCITY_LAG, VELOCITY_DELAY, VELOCITY_GAIN)
        ),
    ],
    ids=lambda value: value.effect if isinstance(value, Fault) else "all" if value is None else "few",
)
def test_a_wrong_reading_is_named_beside_friction_and_nothing_else_is(
    fault: Fault, only: Sequence[str] | None, tmp_path: Path
) -> None:
    """Both values lie in their intervals; kills the other sign, and physics in the place of the reading."""
    document = found(tmp_path, fault, only)
    assert set(document.named) == {"joint_coulomb_friction", fault.effect}
    (friction,) = (one for one in document.effects if one.name == "joint_coulomb_friction")
    assert friction.verdict == CONFIRMED
    for name, value in COULOMB.items():
        low, high = friction.parameters[name].interval
        assert low <= value <= high
    (reading,) = (one for one in document.effects if one.name == fault.effect)
    assert_covers(reading.parameters[fault.key].interval, fault.value, HALF_WIDTHS[fault.effect])
    assert document.held_out_error_after < 0.007  # N m; the noise of the torque below the cut-off


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "tied"),
    [(OFFSET, "link_com"), (TORQUE_LAG, "torque_delay"), (VELOCITY_LAG, "velocity_delay")],
    ids=lambda value: value.effect if isinstance(value, Fault) else value,
)
def test_what_a_smooth_motion_cannot_tell_apart_is_said(fault: Fault, tied: str, tmp_path: Path) -> None:
    document = found(tmp_path, fault, friction=False)
    assert set(document.named) <= {fault.effect, tied}
    assert any({fault.effect, tied} <= set(group) for group in document.confusable)


def test_a_recording_offers_the_sensors_that_it_has(tmp_path: Path) -> None:
    """Currents have no strain gauges, derivatives of positions no filter, and no recording has a command."""
    at_links = source_of(tmp_path, OFFSET)
    currents = at_links.mapping.model_copy(
        update={
            "torque_measured_at": "motor",
            "signals": {name: at_links.mapping.signals[name] for name in ("position", "torque")},
        }
    )
    at_motors = RecordingSource.of(at_links.recordings, currents, at_links.model)

    def offered(source: RecordingSource) -> set[str]:
        return {name for name, effect in source.known_effects.items() if source.offers(effect)}

    encoders = {"encoder_offset", "encoder_scale", "torque_sensor_lag", "torque_sensor_butterworth", "torque_delay"}
    assert encoders <= offered(at_motors) & offered(at_links)
    assert offered(at_links) - offered(at_motors) >= {
        "torque_sensor_crosstalk", "velocity_lag", "velocity_butterworth", "velocity_delay", "velocity_gain"
    }  # fmt: skip
    assert not offered(at_links) & {"command_clock", "motor_encoder_offset", "torque_sensor_drift"}
