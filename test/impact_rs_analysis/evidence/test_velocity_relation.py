# SPDX-License-Identifier: Apache-2.0
"""Velocities against the derivative of positions: what gains and delays change, and what nothing of the arm changes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from joint_recordings import write_npz
from slender_arm import mapping_of, slender_arm, swung, with_effects
from wrong_readings import SCALE, VELOCITY_DELAY, VELOCITY_GAIN, VELOCITY_LAG, Fault

from impact_rs_analysis.evidence.sources.recording_source import POSITION_SLOPE, RecordingSource
from impact_rs_sim.model import Model
from impact_rs_trials.recordings.recording import ARM, read_recordings


def source_of(folder: Path, fault: Fault | None = None) -> RecordingSource:
    mapping = mapping_of(folder, slender_arm(("revolute",) * 3))
    columns = swung(mapping, {})
    path = write_npz(folder / "run.npz", columns if fault is None else fault.made(columns))
    return RecordingSource.of(read_recordings(path, mapping), mapping, Model(name="nominal"))


def slopes(source: RecordingSource, effects: dict[str, dict[str, float]]) -> np.ndarray:
    """Recorded minus predicted numbers of all stretches, ``(K, 6)`` [rad/s]."""
    relation, readings = source._relation, with_effects(source.mapping, effects).arms[ARM].readings
    assert relation is not None
    return relation.recorded - relation.predicted(readings)


@pytest.mark.parametrize("fault", [VELOCITY_GAIN, VELOCITY_DELAY, VELOCITY_LAG], ids=lambda fault: fault.effect)
def test_a_wrong_velocity_is_what_its_sensor_model_predicts(fault: Fault, tmp_path: Path) -> None:
    """Kills the other sign of a delay, which makes the rest twice as large, and a filter that is left out."""
    source = source_of(tmp_path, fault)
    wrong = np.std(slopes(source, {}))
    assert wrong > 0.002  # rad/s
    assert np.std(slopes(source, fault.planted)) < 0.1 * wrong


def test_the_mean_of_the_first_numbers_is_the_gain_times_the_rms_velocity(tmp_path: Path) -> None:
    """v = 1.05 dq/dt in joint 2: mean 0.05 rms(dq); kills a scale by the sum of a stretch in place of the mean."""
    source = source_of(tmp_path)
    velocity = source.motions[0].velocity[source.motions[0].inner]
    found = slopes(source, {"velocity_gain": {"gain_joint2": 1.05}}).mean(axis=0)
    rms = np.sqrt(np.mean(np.square(velocity), axis=0))
    np.testing.assert_allclose(found[:3], [0.0, -0.05 * rms[1], 0.0], atol=1e-3 * rms[1])


def test_masses_and_scales_of_encoders_do_not_change_the_relation(tmp_path: Path) -> None:
    """An encoder's scale is in positions and velocities alike; kills a prediction from true positions."""
    source = source_of(tmp_path, SCALE)
    np.testing.assert_allclose(slopes(source, SCALE.planted), slopes(source, {}), atol=1e-12)
    places = np.array([feature.signal == POSITION_SLOPE for feature in source.clusters[0].features])
    heavy, nominal = source.predict([(0, (("link_mass", (1.2, 1.0, 1.0)),)), (0, ())], "test")
    assert heavy is not None and nominal is not None
    assert np.array_equal(heavy[places], nominal[places]) and not np.array_equal(heavy[~places], nominal[~places])


def test_the_error_of_a_model_is_that_of_torques_alone(tmp_path: Path) -> None:
    """Kills weights of velocities in N m, and a mean over numbers that have no weight."""
    source = source_of(tmp_path)
    squares = [np.square(item.mean * source.residual_weight(item)) for item in source.clusters]
    weights = [item.sigma.size for item in source.clusters]
    every = np.sqrt(np.average([np.mean(one) for one in squares], weights=weights))
    assert every == pytest.approx(source.size(), rel=1e-3)


def test_differences_and_computed_velocities_have_no_relation(tmp_path: Path) -> None:
    source = source_of(tmp_path)
    signals = {name: one for name, one in source.mapping.signals.items() if name != "velocity"}
    mapping = source.mapping.model_copy(update={"signals": signals})
    runs = read_recordings(tmp_path / "run.npz", mapping)
    assert RecordingSource.of(runs, mapping, source.model)._relation is None
    assert RecordingSource.of(source.recordings, source.mapping, source.model, source.recordings)._relation is None
