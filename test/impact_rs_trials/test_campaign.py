# SPDX-License-Identifier: Apache-2.0
"""Campaigns: resumed where they stopped, never mixed, and not stopped by one broken trial."""

from __future__ import annotations

import errno
import os
import shutil
from pathlib import Path

import fsspec
import pytest
from trials import BRIEF, made_up

from impact_rs_sim.errors import InputError
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_trials.bags.reader import OF_THE_TWIN, TrialBag
from impact_rs_trials.bags.writer import BagWriter, partial_path
from impact_rs_trials.campaign import (
    FAILURES,
    MANIFEST,
    Manifest,
    Trial,
    TrialReport,
    make_manifest,
    open_campaign,
    run_campaign,
    run_campaigns,
    run_one,
)
from impact_rs_trials.store import Folder
from impact_rs_trials.varied_settings import SETTINGS, sensitivity_manifests, varied_folders, with_sensitivity
from impact_rs_trials.workers import Workforce

SCALES = [0.8, 1.0, 1.2]


@pytest.fixture
def manifest() -> Manifest:
    return make_manifest("push", ["cat_food"], ["2"], SCALES, trials=1, order="listed")


def test_a_campaign_is_resumed_where_it_stopped(tmp_path: Path, manifest: Manifest) -> None:
    reports = run_campaign(tmp_path, manifest, run=made_up)
    next(reports)
    reports.close()
    assert len(open_campaign(tmp_path, manifest)) == 2
    assert [report.key.scale for report in run_campaign(tmp_path, manifest, run=made_up)] == [1.0, 1.2]
    assert not list(run_campaign(tmp_path, manifest, run=made_up))


def test_an_interrupt_leaves_a_campaign_that_can_be_resumed(tmp_path: Path, manifest: Manifest) -> None:
    def interrupted(directory: Path, trial: Trial) -> TrialReport:
        if trial.key.scale == 1.0:
            raise KeyboardInterrupt
        return made_up(directory, trial)

    with pytest.raises(KeyboardInterrupt):
        list(run_campaign(tmp_path, manifest, run=interrupted))
    assert [key.scale for key in open_campaign(tmp_path, manifest)] == [1.0, 1.2]


def test_every_block_of_a_campaign_has_every_condition_once_in_an_order_of_its_own() -> None:
    manifest = make_manifest("push", ["cat_food"], ["1", "2"], SCALES, trials=4, seed=3)
    keys, conditions = manifest.in_order, 2 * len(SCALES)
    blocks = [keys[first : first + conditions] for first in range(0, len(keys), conditions)]
    assert [{key.repeat for key in block} for block in blocks] == [{0}, {1}, {2}, {3}]
    orders = [tuple((key.case, key.scale) for key in block) for block in blocks]
    assert all(len(set(order)) == conditions for order in orders) and len(set(orders)) == 4
    assert manifest.in_order == keys != make_manifest("push", ["cat_food"], ["1", "2"], SCALES, trials=4).in_order
    listed = manifest.model_copy(update={"order": "listed"})
    assert listed.in_order == manifest.keys and [key.repeat for key in listed.in_order][:5] == [0, 1, 2, 3, 0]


def test_a_trial_does_not_depend_on_the_order(manifest: Manifest) -> None:
    random = manifest.model_copy(update={"order": "random"})
    assert [random.trial(key) for key in manifest.keys] == [manifest.trial(key) for key in manifest.keys]


def test_a_campaign_goes_on_in_the_order_in_which_it_began(tmp_path: Path, manifest: Manifest) -> None:
    """Folders of earlier versions state no order: theirs was that of the list."""
    open_campaign(tmp_path, manifest)
    path = tmp_path / MANIFEST
    path.write_text("".join(line for line in path.read_text().splitlines(True) if not line.startswith("order")))
    random = make_manifest("push", ["cat_food"], ["2"], SCALES, trials=1)
    assert random.order == "random" and [key.scale for key in random.in_order] != SCALES
    assert [key.scale for key in open_campaign(tmp_path, random)] == SCALES


def test_another_manifest_is_refused(tmp_path: Path, manifest: Manifest) -> None:
    open_campaign(tmp_path, manifest)
    with pytest.raises(InputError, match="another campaign .* seed"):
        open_campaign(tmp_path, manifest.model_copy(update={"seed": 1}))


def test_a_campaign_on_the_twin_says_so_and_is_another_one(push_campaign: Path, tmp_path: Path) -> None:
    """Its bags say which simulator it was, and so does what reads them; its trials go as those of Bullet."""
    manifest = make_manifest("push", ["cat_food"], ["2"], [1.0], trials=1, plant="twin")
    assert [report.outcome for report in run_campaign(tmp_path, manifest)] == ["OK"]
    bag, other = (TrialBag.open(folder / manifest.keys[0].name) for folder in (tmp_path, push_campaign))
    assert (bag.info.via, bag.info.simulator, other.info.simulator) == ("twin", "twin", "bullet")
    assert bag.run().remarks == (OF_THE_TWIN,) and not other.run().remarks
    net, other_net = (0.001 * one.controller("arm").feedback_acceleration.sum(axis=0) for one in (bag, other))
    assert net == pytest.approx(other_net, abs=5e-3)  # m/s
    with pytest.raises(InputError, match="another campaign .* plant"):
        open_campaign(tmp_path, manifest.model_copy(update={"plant": "bullet"}))


def test_a_half_written_bag_is_run_again_and_gives_the_same_trial(
    push_campaign: Path, tmp_path: Path, manifest: Manifest
) -> None:
    key = manifest.keys[1]
    hidden = partial_path(tmp_path / key.name)
    hidden.mkdir(parents=True)
    (hidden / "half.mcap").write_bytes(b"")
    assert run_one(tmp_path, manifest.trial(key)).outcome == "OK"
    assert not hidden.exists()
    ours, theirs = (TrialBag.open(folder / key.name).controller("arm") for folder in (tmp_path, push_campaign))
    assert (ours.feedback_acceleration == theirs.feedback_acceleration).all()


def test_a_finished_bag_stands(push_campaign: Path, tmp_path: Path, manifest: Manifest) -> None:
    directory = Path(shutil.copytree(push_campaign, tmp_path / "push"))
    before = next((directory / manifest.keys[0].name).glob("*.mcap")).stat().st_mtime_ns
    assert run_one(directory, manifest.trial(manifest.keys[0])).outcome == "OK"
    assert next((directory / manifest.keys[0].name).glob("*.mcap")).stat().st_mtime_ns == before


def test_one_broken_trial_does_not_end_the_campaign(tmp_path: Path, manifest: Manifest) -> None:
    def broken(directory: Path, trial: Trial) -> TrialReport:
        if trial.key.scale == 0.8:
            raise ZeroDivisionError("by nothing")
        return made_up(directory, trial)

    reports = list(run_campaign(tmp_path, manifest, run=broken))
    assert [report.outcome for report in reports] == ["ABORTED", "OK", "OK"]
    assert "by nothing" in reports[0].message


def fails(directory: Path, trial: Trial) -> TrialReport:
    try:
        raise OSError("the disk hums")
    except OSError:
        raise InputError("cannot be written", file=directory) from None


def test_a_campaign_keeps_why_a_trial_failed_until_it_succeeds(tmp_path: Path, manifest: Manifest) -> None:
    (report, *_) = run_campaign(tmp_path, manifest, run=fails)
    assert report.message == f"{tmp_path}: cannot be written"
    text = (tmp_path / FAILURES / f"{report.key.name}.txt").read_text()
    assert text.startswith(report.message)
    assert "in fails" in text, "the traceback"
    assert "the disk hums" in text, "what lay behind it, which the message leaves out"
    assert len(list((tmp_path / FAILURES).iterdir())) == 3
    list(run_campaign(tmp_path, manifest, run=made_up))
    assert not (tmp_path / FAILURES).exists()


@pytest.mark.slow
def test_the_traceback_of_a_worker_process_is_kept(tmp_path: Path, manifest: Manifest) -> None:
    def breaks_in_the_worker(directory: Path, trial: Trial) -> TrialReport:
        raise ZeroDivisionError(f"in process {os.getpid()}")

    reports = list(run_campaign(tmp_path, manifest, Workforce(2), run=breaks_in_the_worker))
    assert [report.outcome for report in reports] == ["ABORTED"] * 3
    for report in reports:
        text = (tmp_path / FAILURES / f"{report.key.name}.txt").read_text()
        assert report.trace in text
        assert "in breaks_in_the_worker" in report.trace
        assert f"in process {os.getpid()}" not in report.trace


def test_a_campaign_at_a_url_keeps_there_why_a_trial_failed(manifest: Manifest) -> None:
    files = fsspec.filesystem("memory")
    one = manifest.model_copy(update={"velocity_scales": (1.0,)})
    failure = f"/failing/{FAILURES}/{one.keys[0].name}.txt"
    try:
        list(run_campaign("memory://failing", one, run=fails))
        assert b"the disk hums" in files.cat_file(failure)
        list(run_campaign("memory://failing", one, run=made_up))
        assert not files.exists(failure)
    finally:
        files.rm("/failing", recursive=True)


def test_a_trial_whose_worker_dies_is_run_again(
    tmp_path: Path, manifest: Manifest, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("OMP_NUM_THREADS")  # which the tests set for themselves; workers have it of their own

    def dies_once(directory: Path, trial: Trial) -> TrialReport:
        marker = directory / "died"
        if trial.key.scale == 1.0 and not marker.exists():
            marker.write_text("")
            os._exit(1)
        assert os.environ["OMP_NUM_THREADS"] == "1"
        (directory / trial.key.name).mkdir()  # a worker does not know this module and its functions
        return TrialReport(trial.key, "OK")

    reports = list(run_campaign(tmp_path, manifest, Workforce(2), run=dies_once))
    assert (tmp_path / "died").exists()
    assert sorted((report.key.scale, report.outcome, report.message) for report in reports) == [
        (scale, "OK", "") for scale in SCALES
    ]


def test_a_full_disk_ends_its_trial_alone_and_leaves_no_half_bag(
    tmp_path: Path, manifest: Manifest, monkeypatch: pytest.MonkeyPatch
) -> None:
    write, written = BagWriter.write_rows, []

    def full(bag: BagWriter, *arguments: object) -> None:
        if "s1.000" in bag.path.name and len(written) == 3:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        written.append(bag.path.name)
        write(bag, *arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(BagWriter, "write_rows", full)
    brief = {f"timing.{name}": seconds for name, seconds in BRIEF.items()}
    first = manifest.model_copy(update={"velocity_scales": (1.0, 0.8), "settings": brief})
    reports = list(run_campaign(tmp_path, first))
    assert [report.outcome for report in reports] == ["ABORTED", "OK"]
    assert f"No space left on device: '{tmp_path / reports[0].key.name}'" in reports[0].message
    assert sorted(path.name for path in tmp_path.iterdir()) == [FAILURES, reports[1].key.name, "manifest.yaml"]
    monkeypatch.setattr(BagWriter, "write_rows", write)
    assert [report.outcome for report in run_campaign(tmp_path, first)] == ["OK"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"scales": [0.0]}, "velocity scale"),
        ({"scales": [float("nan")]}, "velocity scale"),
        ({"trials": 0}, "trials = 0"),
        ({"seed": -1}, "seed = -1"),
        ({"objects": ["catfood"]}, "did you mean 'cat_food'"),
        ({"cases": ["case_22"]}, "did you mean 'case_2'"),
    ],
)
def test_mistakes_are_told_before_anything_runs(arguments: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        make_manifest("push", **arguments)


# ---- campaigns beside a campaign ------------------------------------------------------------------------------------


GRAB = make_manifest("grab", ["parcel"], seed=3)


def test_one_setting_at_a_time_is_halved_and_doubled() -> None:
    own = load_scenario("grab")
    found = sensitivity_manifests(GRAB)
    assert set(found) == {(setting.name, factor) for setting in SETTINGS for factor in setting.factors}
    for (name, factor), manifest in found.items():
        scenario = manifest.trial(manifest.keys[0]).spec.scenario
        pairs = {
            "clamp_force": [(scenario.control.clamp_force, own.control.clamp_force)],
            "interim_duration": [(scenario.control.interim_duration, own.control.interim_duration)],
            "orientation_gain": [
                (scenario.control.gains.orientation, own.control.gains.orientation),
                (scenario.control.gains.orientation_post, own.control.gains.orientation_post),
            ],
            "pad_stiffness": [
                (scenario.robots[arm].end_effector.pad.stiffness, own.robots[arm].end_effector.pad.stiffness)
                for arm in own.robots
            ],
        }
        for setting, values in pairs.items():
            for varied, usual in values:
                assert varied == pytest.approx(usual * (factor if setting == name else 1.0))


def test_a_varied_trial_has_the_seed_of_the_trial_it_is_held_against() -> None:
    seeds = {key.scale: GRAB.trial(key).seed for key in GRAB.keys if key.case == "case_1" and key.repeat == 0}
    for manifest in sensitivity_manifests(GRAB).values():
        assert {key.scale for key in manifest.keys} == {0.8, 1.0, 1.2}
        for key in manifest.keys:
            assert (key.case, key.repeat) == ("case_1", 0)
            assert manifest.trial(key).seed == seeds[key.scale]


def test_unused_settings_are_not_varied() -> None:
    assert not [key for key in sensitivity_manifests(make_manifest("push")) if key[0] == "clamp_force"]


def test_settings_of_the_campaign_itself_stay() -> None:
    firm = make_manifest("grab", ["parcel"], settings={"control.clamp_force": 100.0, "control.interim_duration": 0.08})
    found = sensitivity_manifests(firm)
    assert found["clamp_force", 1.5].settings == {"control.clamp_force": 150.0, "control.interim_duration": 0.08}
    assert found["pad_stiffness", 0.5].settings["control.clamp_force"] == 100.0


def test_varied_campaigns_are_found_in_the_campaign_folder(tmp_path: Path) -> None:
    campaign = Folder(tmp_path)

    campaigns = with_sensitivity(campaign, GRAB)
    places = [store for store, _ in run_campaigns(campaigns, run=made_up)]
    assert {str(place): places.count(place) for place in campaigns} == {
        str(store): len(manifest.keys) for store, manifest in campaigns.items()
    }
    assert set(varied_folders(tmp_path)) == set(sensitivity_manifests(GRAB))
    assert varied_folders(tmp_path)["clamp_force", 0.5] == "sensitivity/clamp_force_x0.5"
    (tmp_path / "sensitivity" / "notes_xy").mkdir()
    assert len(varied_folders(tmp_path)) == len(campaigns) - 1
