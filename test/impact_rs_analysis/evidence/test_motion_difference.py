# SPDX-License-Identifier: Apache-2.0
"""The same motion without and with a load: friction, offsets and wrong links cancel, the load remains."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from intervals import assert_covers
from joint_recordings import write_npz
from slender_arm import mapping_of, slender_arm, swung

from impact_rs_analysis.diagnosis.diagnose import diagnose, effects_for
from impact_rs_analysis.evidence.free_motion.motion_difference import nearest, order_warning
from impact_rs_analysis.evidence.free_motion.torque_balance import Motion, prepare
from impact_rs_analysis.evidence.sources.recording_source import RecordingSource
from impact_rs_cli.main import main
from impact_rs_sim.effects import library
from impact_rs_sim.errors import InputError
from impact_rs_sim.model import Model, ModelEffect, ParameterValue
from impact_rs_trials.recordings.mapping import Mapping
from impact_rs_trials.recordings.recording import read_recordings

COMMON = {  # far beyond what the load changes, and none of it in the model
    "joint_coulomb_friction": {"coulomb_joint1": 3.0, "coulomb_joint2": 2.0, "coulomb_joint3": 1.0},
    "joint_viscous_friction": {"viscous_joint1": 2.0, "viscous_joint2": 1.0},
    "torque_offset": {"offset_joint1": 1.0, "offset_joint3": -0.5},
    "link_mass": {"scale_joint1": 1.2, "scale_joint2": 0.8, "scale_joint3": 1.3},
}
MASS, PLACE = 0.6, {"com_x": 0.0, "com_y": 0.03, "com_z": 0.05}  # kg, m; x lies along the axes of all joints
WIDTH = {"mass": 0.016, "com_x": 0.4, "com_y": 0.0014, "com_z": 0.017}  # half widths, of the fit
RIPPLE = 0.85  # N m, of the loaded recording alone
LATER = 4.36  # s, by which the loaded recording begins later in the motion


@pytest.fixture(scope="module")
def mapping(tmp_path_factory: pytest.TempPathFactory) -> Mapping:
    return mapping_of(tmp_path_factory.mktemp("arm"), slender_arm(("revolute",) * 3))


@pytest.fixture(scope="module")
def folder(mapping: Mapping, tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("runs")
    loaded = COMMON | {"end_effector_payload": {"mass": MASS, **PLACE}}
    write_npz(made / "unloaded.npz", swung(mapping, COMMON, seed=1))
    write_npz(made / "loaded.npz", swung(mapping, loaded, seed=2, start=LATER))
    return made


def motion_of(path: Path, mapping: Mapping) -> Motion:
    (run,) = read_recordings(path, mapping)
    return prepare(run, mapping.low_pass)


def source_of(folder: Path, mapping: Mapping, minus: str | None = "unloaded.npz") -> RecordingSource:
    references = [] if minus is None else read_recordings(folder / minus, mapping)
    return RecordingSource.of(
        read_recordings(folder / "loaded.npz", mapping), mapping, Model(name="nominal"), references
    )


def test_the_later_recording_is_found_in_the_earlier_one(folder: Path, mapping: Mapping) -> None:
    match = nearest(motion_of(folder / "loaded.npz", mapping), [motion_of(folder / "unloaded.npz", mapping)])
    assert match is not None
    assert match.shift == pytest.approx(LATER, abs=1e-3) and match.distance < 1e-4


def test_the_load_remains_and_nothing_else(folder: Path, mapping: Mapping) -> None:
    source = source_of(folder, mapping)
    found = diagnose(source, source.model, ["end_effector_payload", "joint_coulomb_friction", "torque_offset"])
    assert found.named == ("end_effector_payload",)
    effect = found.effect("end_effector_payload")
    assert effect is not None
    for name, value in {"mass": MASS, **PLACE}.items():
        assert_covers(effect.parameters[name].interval, value, WIDTH[name])
    assert source.recording.minus == (str(folder / "unloaded.npz"),)


def with_gains(folder: Path, mapping: Mapping, *gains: float) -> RecordingSource:
    """Recordings with and without the load, both with the same gains of the torque: true over recorded."""
    common = {"torque_gain": {f"gain_joint{joint}": gain for joint, gain in enumerate(gains, start=1)}}
    loaded = common | {"end_effector_payload": {"mass": MASS, **PLACE}}
    write_npz(folder / "unloaded.npz", swung(mapping, common, seed=1))
    write_npz(folder / "loaded.npz", swung(mapping, loaded, seed=2, start=LATER))
    return source_of(folder, mapping)


def test_a_gain_of_the_torque_that_all_joints_have_scales_the_load(mapping: Mapping, tmp_path: Path) -> None:
    source = with_gains(tmp_path, mapping, 0.9, 0.9, 0.9)
    found = diagnose(source, source.model, ["end_effector_payload"])
    assert_covers(found.effect("end_effector_payload").parameters["mass"].interval, MASS / 0.9, 0.018)
    assert any("A common gain of the torque scales the mass of the load" in remark for remark in found.remarks)


@pytest.mark.parametrize("unsure", [0.0, 0.1])
def test_what_the_model_knows_of_the_torque_does_not_scale_the_load(
    mapping: Mapping, tmp_path: Path, unsure: float
) -> None:
    """And how well it knows it is part of how well the load is known."""
    gains = (0.8, 1.0, 1.2)
    with_gains(tmp_path, mapping, *gains)
    known = {
        f"gain_joint{joint}": ParameterValue(
            estimate=gain, unit="-", ci95=(gain * (1.0 - unsure), gain * (1.0 + unsure)) if unsure else None
        )
        for joint, gain in enumerate(gains, start=1)
    }
    model = Model(name="calibrated", effects=(ModelEffect(name="torque_gain", parameters=known),))
    recorded, references = (read_recordings(tmp_path / name, mapping) for name in ("loaded.npz", "unloaded.npz"))
    found = diagnose(RecordingSource.of(recorded, mapping, model, references), model, ["end_effector_payload"])
    half = 0.12 if unsure else 0.02
    assert_covers(found.effect("end_effector_payload").parameters["mass"].interval, MASS, half * MASS, within=1.8)


def test_how_the_arm_is_made_changes_no_difference(folder: Path, mapping: Mapping) -> None:
    source = source_of(folder, mapping)
    load = ("end_effector_payload", (MASS, PLACE["com_x"], PLACE["com_y"], PLACE["com_z"]))
    heavy = ("link_mass", (1.5, 0.7, 1.2))
    np.testing.assert_allclose(source.residuals_by((load, heavy)), source.residuals_by((load,)), atol=1e-9)


def test_friction_that_the_load_adds_to_one_joint_is_seen_beside_what_nothing_explains(
    mapping: Mapping, tmp_path: Path
) -> None:
    """It is little beside what no effect explains in the first joint, and most of what is left in its own."""
    more = COMMON["joint_coulomb_friction"] | {"coulomb_joint2": 2.12}
    loaded = COMMON | {"joint_coulomb_friction": more, "end_effector_payload": {"mass": MASS, **PLACE}}
    columns = swung(mapping, loaded, seed=2, start=LATER)
    columns["effort"][:, 0] += RIPPLE * np.sin(15.0 * columns["position"][:, 0])
    write_npz(tmp_path / "loaded.npz", columns)
    write_npz(tmp_path / "unloaded.npz", swung(mapping, COMMON, seed=1))
    source = source_of(tmp_path, mapping)
    found = diagnose(source, source.model, ["end_effector_payload", "joint_coulomb_friction"])
    assert set(found.named) == {"end_effector_payload", "joint_coulomb_friction"}
    effect = found.effect("joint_coulomb_friction")
    assert effect is not None
    assert_covers(effect.parameters["coulomb_joint2"].interval, 0.12, 0.0044)


def test_without_the_reference_friction_and_links_hide_the_load(folder: Path, mapping: Mapping) -> None:
    """The residual is many times as large, and the difference leaves noise beside the load."""
    alone, difference = source_of(folder, mapping, None), source_of(folder, mapping)
    added = (("end_effector_payload", (MASS, PLACE["com_x"], PLACE["com_y"], PLACE["com_z"])),)
    assert np.all(alone.residuals.std(axis=0) > 3.0 * difference.residuals_by(added).std(axis=0))
    assert np.all(np.abs(difference.residuals_by(added).mean(axis=0)) < 0.02)  # N m; friction and offset are gone


def test_the_noise_of_both_recordings_counts(folder: Path, mapping: Mapping) -> None:
    alone, difference = source_of(folder, mapping, None), source_of(folder, mapping)
    np.testing.assert_allclose(difference.balance.noise, np.sqrt(2.0) * alone.balance.noise, rtol=0.3)


def test_another_motion_is_refused_with_the_remedy(folder: Path, mapping: Mapping) -> None:
    write_npz(folder / "other.npz", swung(mapping, COMMON, start=47.3))
    with pytest.raises(InputError, match="follows the motion of no recording of --minus.*record the same motion twice"):
        source_of(folder, mapping, "other.npz")


def test_what_a_session_does_not_change_is_no_change_between_two_recordings(folder: Path, mapping: Mapping) -> None:
    """A cell does not tilt, and a torque constant does not grow, while somebody mounts a load."""
    difference, alone = source_of(folder, mapping), source_of(folder, mapping, None)
    offered, every = ({e.name for e in effects_for(source)} for source in (difference, alone))
    assert every - offered == {
        name for name in every if not library()[name].may_change and not library()[name].shown_by_load
    }
    assert {"base_tilt", "torque_gain", "link_mass", "joint_sum_friction"} <= every - offered
    assert "joint_load_dependent_friction" in offered
    assert {"end_effector_payload", "joint_coulomb_friction", "torque_offset", "external_spring"} <= offered


@pytest.mark.parametrize("speed", [0.5, 1.6])
def test_the_same_way_at_another_speed_is_refused_for_what_it_is(folder: Path, mapping: Mapping, speed: float) -> None:
    columns = swung(mapping, COMMON, start=LATER, seconds=20.0)
    write_npz(folder / "first.npz", columns)
    write_npz(
        folder / "other.npz", columns | {"time": columns["time"] / speed, "velocity": speed * columns["velocity"]}
    )
    recorded, references = (read_recordings(folder / name, mapping) for name in ("first.npz", "other.npz"))
    with pytest.raises(InputError, match=rf"the same path {speed:.2g} times as fast.*at the same speed"):
        RecordingSource.of(recorded, mapping, Model(name="nominal"), references)


def test_only_recordings_have_something_to_subtract(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "t.csv").write_text("vx_before [m/s]\n1\n", encoding="utf-8")
    for arguments in (["--impacts", str(tmp_path / "t.csv")], [str(tmp_path), "--experiment", "e.yaml"]):
        assert main(["diagnose", *arguments, "--minus", str(tmp_path)]) == 2
        assert "--minus goes with recordings of free motion" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("order", "warned"), [("ABBA", None), ("BAAB", None), ("AABB", "later"), ("BBA", "earlier"), ("AB", "later")]
)
def test_an_order_in_which_a_drift_does_not_cancel_is_warned_of(order: str, warned: str | None) -> None:
    """A: without the load, five minutes each. Kills a sign, and a rule about the order of names in place of times."""
    time = np.linspace(0.0, 240.0, 100)
    kinds = {kind: [1.7e9 + 300.0 * place + time for place, own in enumerate(order) if own == kind] for kind in "AB"}
    found = order_warning(kinds["B"], kinds["A"])
    assert (found is None) == (warned is None) and (warned is None or f"minutes {warned} than" in found)
    assert order_warning([time], [time + 300.0]) is None  # clocks that begin with the recording


def test_a_diagnosis_says_the_order_of_its_recordings(folder: Path, mapping: Mapping, tmp_path: Path) -> None:
    """Kills a check that no path asks."""
    for name, start in (("loaded", 1.7e9 + 900.0), ("unloaded", 1.7e9)):
        own = dict(np.load(folder / f"{name}.npz"))
        write_npz(tmp_path / f"{name}.npz", own | {"time": own["time"] + start})
    source = source_of(tmp_path, mapping)
    assert any("minutes later than the recordings of --minus" in remark for remark in source.remarks)
    assert not any("than the recordings of --minus" in remark for remark in source_of(folder, mapping).remarks)


def test_recordings_of_one_name_are_held_out_one_by_one(mapping: Mapping, tmp_path: Path) -> None:
    """Kills: the stretches of the last file of a name are predicted and measured in place of the others."""
    for day, friction in ((1, 1.0), (2, 2.0)):
        (tmp_path / f"day_{day}").mkdir()
        effects = {"joint_coulomb_friction": {f"coulomb_joint{joint}": friction for joint in (1, 2, 3)}}
        write_npz(tmp_path / f"day_{day}" / "log.npz", swung(mapping, effects, seed=day))
    source = RecordingSource.of(read_recordings(tmp_path, mapping), mapping, Model(name="nominal"))
    names = [item.name for item in source.clusters]
    assert len(set(names)) == len(names) and {name.partition(",")[0] for name in names} == {
        "day_1/log.npz", "day_2/log.npz",
    }  # fmt: skip
    again = source.residuals_with((), source.clusters)
    assert again is not None
    for item, own in zip(source.clusters, again, strict=True):
        np.testing.assert_allclose(own.residuals, item.residuals, atol=1e-9)


@pytest.mark.parametrize("lacking", ["loaded", "unloaded"])
def test_a_torque_that_one_recording_lacks_is_left_out(
    folder: Path, mapping: Mapping, tmp_path: Path, lacking: str
) -> None:
    """Kills: 0 N m taken for a torque, or the torque of the model alone subtracted from that of the other recording."""
    for name in ("loaded", "unloaded"):
        columns = dict(np.load(folder / f"{name}.npz"))
        if name == lacking:
            columns["effort"][:, 1] = 0.0
        np.savez(tmp_path / f"{name}.npz", **columns)
    assert source_of(tmp_path, mapping).balance.joints.tolist() == [0, 2]
    both = RecordingSource.of(read_recordings(tmp_path, mapping), mapping, Model(name="nominal"))
    assert both.balance.joints.tolist() == [0, 2]
