# SPDX-License-Identifier: Apache-2.0
"""Places of campaigns: folders and URLs hold the same, and a folder has one owner at a time."""

import errno
import fcntl
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import fsspec
import pytest

from impact_rs_analysis.sharing.evidence_package import digests_of
from impact_rs_sim.errors import InputError
from impact_rs_trials.campaign import Manifest, Trial, TrialReport, make_manifest, run_campaign, run_in
from impact_rs_trials.store import LOCK, Folder, Remote, Store, local_copy, open_store, owned, trials_below, trials_in


@pytest.fixture
def manifest() -> Manifest:
    return make_manifest("push", ["cat_food"], ["2"], [0.8, 1.0], trials=1)


@pytest.fixture
def memory() -> Iterator[str]:
    yield "memory://campaigns/push"
    fsspec.filesystem("memory").rm("/campaigns", recursive=True)


def fake(directory: Path, trial: Trial) -> TrialReport:
    bag = directory / trial.key.name
    bag.mkdir()
    (bag / "signals.mcap").write_text(trial.key.name)
    (bag / "metadata.yaml").write_text("complete")
    return TrialReport(trial.key, "OK")


@pytest.mark.parametrize("place", ["{}/push", "file://{}/push"])
def test_a_path_and_a_file_url_are_the_same_folder(place: str, tmp_path: Path) -> None:
    store = open_store(place.format(tmp_path))
    assert isinstance(store, Folder)
    assert store.path == tmp_path / "push"


def test_a_campaign_at_a_url_is_resumed_and_copied_down(memory: str, manifest: Manifest) -> None:
    reports = run_campaign(memory, manifest, run=fake)
    first = next(reports)
    reports.close()
    assert open_store(memory).names() == {first.key.name}
    assert [report.outcome for report in run_campaign(memory, manifest, run=fake)] == ["OK"]
    assert not list(run_campaign(memory, manifest, run=fake))
    with local_copy(memory, ("manifest.yaml",)) as directory:
        assert sorted(path.name for path in directory.iterdir()) == sorted(
            [*(key.name for key in manifest.keys), "manifest.yaml"]
        )
        assert (directory / first.key.name / "signals.mcap").read_text() == first.key.name
    assert not directory.exists()


def test_a_stamp_changes_when_its_bag_is_written_again(tmp_path: Path, memory: str, manifest: Manifest) -> None:
    for store in (Folder(tmp_path), open_store(memory)):
        names = [report.key.name for report in run_campaign(store, manifest, run=fake)]
        stamps = store.stamps()
        assert sorted(stamps) == sorted(names)
        assert store.stamps() == stamps
        store.write(f"{names[0]}/signals.mcap", "other")
        changed = store.stamps()
        assert changed[names[0]] != stamps[names[0]]
        assert changed[names[1]] == stamps[names[1]]
        store.write(f".partial/{names[0]}/metadata.yaml", "hidden")
        store.write(f"deeper/{names[0]}/metadata.yaml", "")
        assert store.stamps().keys() - stamps.keys() == {f"deeper/{names[0]}"}


def test_only_a_folder_has_stamps_of_bags_without_metadata(tmp_path: Path, memory: str) -> None:
    """There a bag that was cut off is told; at a URL it is still being uploaded."""
    for store in (Folder(tmp_path), open_store(memory)):
        store.write("cut_off/signals.mcap", "")
    assert Folder(tmp_path).stamps().keys() == {"cut_off"}
    assert not open_store(memory).stamps()
    with pytest.raises(InputError, match="no such folder"):
        Folder(tmp_path / "nowhere").stamps()
    with pytest.raises(InputError, match="no such file or folder"):
        Folder(tmp_path / "nowhere.csv").stamps()


def test_a_bag_that_was_uploaded_by_half_is_run_again(memory: str, manifest: Manifest) -> None:
    name = manifest.keys[0].name
    fsspec.filesystem("memory").pipe(f"/campaigns/push/{name}/signals.mcap", b"half")
    assert not open_store(memory).exists(name)
    assert len(list(run_campaign(memory, manifest, run=fake))) == 2
    assert open_store(memory).exists(name)


def test_a_trial_at_a_url_that_is_aborted_without_a_bag_keeps_its_reason(memory: str, manifest: Manifest) -> None:
    """Kills: the upload of a folder that is not there, whose error took the place of the reason."""

    def aborted(_: Path, trial: Trial) -> TrialReport:
        return TrialReport(trial.key, "ABORTED", "the controller node died")

    assert {report.message for report in run_campaign(memory, manifest, run=aborted)} == {"the controller node died"}
    assert open_store(memory).names() == set()


def test_metadata_is_uploaded_last(memory: str, monkeypatch: pytest.MonkeyPatch, manifest: Manifest) -> None:
    store = open_store(memory)
    assert isinstance(store, Remote)
    uploaded = []
    monkeypatch.setattr(
        type(store._files), "put_file", lambda files, source, target: uploaded.append(Path(target).name)
    )
    with store.adding("bag") as directory:
        fake(directory, manifest.trial(manifest.keys[0]))
        (directory / manifest.keys[0].name).rename(directory / "bag")
    assert uploaded == ["signals.mcap", "metadata.yaml"]


@pytest.mark.parametrize(("place", "message"), [("nowhere://push", "nowhere"), ("nosuch+s3://bucket", "nosuch")])
def test_a_url_that_nobody_speaks_is_told(place: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        open_store(place)


def test_a_worker_that_does_not_see_the_place_says_so_and_runs_nothing(tmp_path: Path, manifest: Manifest) -> None:
    with pytest.raises(InputError, match=r"finds no manifest\.yaml here; expected a folder that all workers share"):
        run_in(Folder(tmp_path), fake, manifest.trial(manifest.keys[0]))
    assert not list(tmp_path.iterdir())


def test_a_second_process_on_a_folder_is_refused(tmp_path: Path, manifest: Manifest) -> None:
    reports = run_campaign(tmp_path, manifest, run=fake)
    next(reports)
    with pytest.raises(InputError, match=f"process {os.getpid()} on .* works on this campaign"):
        next(run_campaign(tmp_path, manifest, run=fake))
    reports.close()
    assert len(list(run_campaign(tmp_path, manifest, run=fake))) == 1
    assert not (tmp_path / LOCK).exists()


def test_the_lock_of_a_process_that_was_killed_does_not_count(tmp_path: Path) -> None:
    code = "import os, sys, pathlib; from impact_rs_trials.store import *; "
    code += "lock = owned(Folder(sys.argv[1])); lock.__enter__(); os._exit(9)"
    assert subprocess.run([sys.executable, "-c", code, str(tmp_path)], timeout=60).returncode == 9
    assert (tmp_path / LOCK).exists()
    with owned(open_store(tmp_path)):
        assert str(os.getpid()) in (tmp_path / LOCK).read_text()


def test_a_lock_file_that_vanishes_while_we_wait_is_made_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lock, calls = fcntl.flock, []

    def late(file: object, how: int) -> None:
        calls.append(how)
        if len(calls) == 1:
            (tmp_path / LOCK).unlink()
        lock(file, how)  # type: ignore[call-overload]

    monkeypatch.setattr(fcntl, "flock", late)
    store: Store = Folder(tmp_path)
    with owned(store):
        assert (tmp_path / LOCK).exists()
    assert len(calls) == 2


def test_a_file_system_without_locks_is_no_other_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Kills: `except OSError` around the lock, which told of another process that does not exist."""

    def without_locks(*_: object) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(fcntl, "flock", without_locks)
    with (
        pytest.raises(InputError, match="cannot be locked: No locks available; choose a folder"),
        owned(Folder(tmp_path)),
    ):
        pass


def test_trials_are_found_in_a_campaign_and_below_a_folder(tmp_path: Path) -> None:
    """Kills a search that leaves out damaged trials, which nobody would miss, or takes those of varied settings."""
    for name in ("b/metadata.yaml", "a/a.mcap", "varied/x/metadata.yaml", ".half/metadata.yaml", "notes/readme.md"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("")
    (tmp_path / "empty").mkdir()
    (tmp_path / "bare.db3").write_text("")
    (tmp_path / "manifest.yaml").write_text("")
    assert [path.name for path in trials_in(tmp_path)] == ["a", "b", "bare.db3", "empty"]
    (tmp_path / "bare.db3").unlink()
    assert trials_below(tmp_path) == [tmp_path / name for name in ("a", "b", "varied/x")]
    with pytest.raises(InputError, match="no such folder"):
        trials_below(tmp_path / "none")


def test_trials_with_a_varied_setting_are_no_repeats(tmp_path: Path) -> None:
    """Kills a search that takes every bag, so that halved gains with the seed of a trial pass for its repeats."""
    for name in ("t", "sensitivity/pad_stiffness_x0.5/t", "sensitivity/own/t"):
        (tmp_path / name).mkdir(parents=True)
        (tmp_path / name / "metadata.yaml").write_text("")
    assert trials_below(tmp_path) == [tmp_path / name for name in ("sensitivity/own/t", "t")]
    varied = tmp_path / "sensitivity" / "pad_stiffness_x0.5"
    assert trials_below(varied) == [varied / "t"]
    assert varied / "t" not in trials_below(varied.parent)


def test_linked_trials_are_read_once_by_every_search(tmp_path: Path) -> None:
    """Kills a search that overlooks links to bags, reads one bag twice, or walks in a circle."""
    campaign, disk = tmp_path / "campaign", tmp_path / "disk"
    for bag in (campaign / "b", disk / "c"):
        bag.mkdir(parents=True)
        (bag / "metadata.yaml").write_text("")
    (campaign / "a_latest").symlink_to("b")
    (campaign / "c").symlink_to(disk / "c")
    (campaign / "round").mkdir()
    (campaign / "round" / "up").symlink_to(campaign)
    assert trials_below(campaign) == trials_in(campaign) == [campaign / "b", campaign / "c"]
    assert [one.path for one in digests_of(campaign)] == ["b/metadata.yaml", "c/metadata.yaml"]
