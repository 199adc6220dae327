# SPDX-License-Identifier: Apache-2.0
"""Export: what a robot would give, with units, complete or not at all."""

import shutil
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from impact_rs_analysis.measure.export import CONTROLLER_UNITS, Exported, export, trial_row
from impact_rs_analysis.measure.net_feedback import net_feedback
from impact_rs_sim.errors import InputError
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.reader import TrialBag

NAME = "cat_food__case_2__s1.000__r0"


def exported(place: Path, file: Path) -> Exported:
    return export(place, file, map, lambda done, total: None)


@pytest.fixture
def with_cut_off(campaign: Path) -> Path:
    """The small campaign and a bag that was cut off."""
    shutil.copytree(campaign / NAME, campaign / "cut_off")
    (campaign / "cut_off" / "metadata.yaml").unlink()
    return campaign


def test_parquet_has_a_row_per_trial(with_cut_off: Path, tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    found = exported(with_cut_off, tmp_path / "new" / "push.parquet")
    assert (found.trials, found.skipped) == (4, ())
    rows = {row["trial"]: row for row in parquet.read_table(tmp_path / "new" / "push.parquet").to_pylist()}
    assert len(rows) == 4
    cut = rows["cut_off"]
    assert (cut["outcome"], cut["impact"], cut["net_feedback_m_s"]) == ("ABORTED", None, None)
    assert "cut off at t = 1.800 s" in cut["remark"]
    bag, row = TrialBag.open(with_cut_off / NAME), rows[NAME]
    assert (row["scenario"], row["object"], row["case"], row["repeat"]) == ("push", "cat_food", "case_2", 0)
    assert (row["seed"], row["outcome"], row["impact"]) == (bag.info.seed, "OK", True)
    assert row["net_feedback_m_s"] == net_feedback(bag).net
    assert row["arm_impact_time_s"] == bag.impact_time("arm")
    assert row["predicted_post_velocity_m_s"] == bag.info.predicted_post_velocity
    assert row["reference_post_velocity_m_s"] == bag.info.reference_post_velocity


def test_a_varied_trial_of_the_same_name_is_known_by_its_bag(campaign: Path, tmp_path: Path) -> None:
    """Kills a table in which trials with a varied setting look like those of the campaign, or are missing."""
    parquet = pytest.importorskip("pyarrow.parquet")
    varied = f"sensitivity/pad_stiffness_x0.5/{NAME}"
    shutil.copytree(campaign / NAME, campaign / varied)
    exported(campaign, tmp_path / "push.parquet")
    rows = parquet.read_table(tmp_path / "push.parquet").to_pylist()
    assert {row["bag"] for row in rows if row["trial"] == NAME} == {NAME, varied}


def test_hdf5_has_every_measured_signal_with_its_unit(with_cut_off: Path, tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    assert exported(with_cut_off, tmp_path / "push.h5").trials == 4
    bag = TrialBag.open(with_cut_off / NAME)
    with h5py.File(tmp_path / "push.h5") as file:
        assert len(file) == 4
        assert file["cut_off"].attrs["outcome"] == "ABORTED"
        trial = file[NAME]
        assert trial.attrs["outcome"] == "OK"
        assert trial.attrs["seed"] == bag.info.seed
        joints = bag.joints(topics.joint_states("arm"))
        for name, unit in (("time", "s"), ("position", "rad"), ("velocity", "rad/s"), ("effort", "N m")):
            dataset = trial[f"arm/joint_states/{name}"]
            assert dataset.attrs["units"] == unit
            np.testing.assert_array_equal(dataset[:], getattr(joints, name))
        assert set(trial["arm/motor_states"]) == {"time", "position", "velocity"}
        assert set(trial["arm/joint_command"]) == {"time", "effort"}
        assert set(trial["arm/controller_state"]) == {"time", *CONTROLLER_UNITS}
        np.testing.assert_array_equal(trial["object/position"][:], bag.poses(topics.OBJECT_POSE).position)
        names: list[str] = []
        file.visit(names.append)
        assert not [name for name in names if "truth" in name]
        units: list[bool] = []
        file.visititems(lambda _, item: units.append(not isinstance(item, h5py.Dataset) or "units" in item.attrs))
        assert all(units)


def test_a_trial_that_is_no_measurement_says_why(tmp_path: Path, with_outcome: Callable) -> None:
    with_outcome(tmp_path / NAME, "DROPPED")
    row = trial_row(tmp_path / NAME)
    assert isinstance(row, dict)
    assert (row["outcome"], row["net_feedback_m_s"]) == ("DROPPED", None)
    assert row["remark"] == "DROPPED: the object was dropped"


def test_a_single_bag_is_exported_as_a_campaign_of_one(push_campaign: Path, tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    assert exported(push_campaign / NAME, tmp_path / "one.h5").trials == 1
    with h5py.File(tmp_path / "one.h5") as file:
        assert list(file) == [NAME]


@pytest.mark.parametrize("package", ["pyarrow", "h5py"])
def test_a_missing_package_is_named_before_anything_is_read(
    package: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("IMPACT_RS_RUN", raising=False)
    monkeypatch.setitem(sys.modules, package, None)
    name = {"pyarrow": "push.parquet", "h5py": "push.h5"}[package]
    with pytest.raises(InputError, match=f"pip install {package}"):
        exported(tmp_path / "nowhere", tmp_path / name)


def test_nothing_to_export_leaves_no_file(tmp_path: Path) -> None:
    pytest.importorskip("h5py")
    (tmp_path / "push" / "cut_off").mkdir(parents=True)
    (tmp_path / "push" / "cut_off" / "cut_off.mcap").write_bytes(b"")
    with pytest.raises(InputError, match="no readable trials here; cut_off"):
        exported(tmp_path / "push", tmp_path / "push.h5")
    assert [path.name for path in tmp_path.iterdir()] == ["push"]
