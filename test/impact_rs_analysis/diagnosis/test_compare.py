# SPDX-License-Identifier: Apache-2.0
"""Where a model fails, on three levels, from measured signals alone."""

import json
import shutil
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from mcap_ros2.reader import read_ros2_messages

from impact_rs_analysis.diagnosis.compare import ComparisonDocument, compare
from impact_rs_analysis.evidence.aligned_bags import write_aligned
from impact_rs_analysis.evidence.discrepancy import NO_DISCREPANCY
from impact_rs_analysis.evidence.replays.measured_runs import MeasuredRun, Runs, read_runs
from impact_rs_analysis.evidence.replays.replay_cache import Replay, ReplayCache
from impact_rs_analysis.evidence.sources.run_source import ReplaySource
from impact_rs_analysis.evidence.tracks import Track, track_of_run
from impact_rs_analysis.report.comparison import write_comparison
from impact_rs_cli.main import main
from impact_rs_sim.errors import InputError
from impact_rs_sim.model import Model, ModelEffect, ParameterValue, load_model
from impact_rs_trials.bags.topics import TRUTH

MORE_FRICTION = 0.18  # of the support, hidden in the fixture's plant


@pytest.fixture(scope="module")
def runs(hidden_campaign: Path) -> Runs:
    return read_runs(hidden_campaign, map)


def against(runs: Runs, model: Model) -> ComparisonDocument:
    return compare(ReplaySource.of(runs, model, ReplayCache(map)))


@pytest.fixture(scope="module")
def nominal(runs: Runs) -> ComparisonDocument:
    return against(runs, load_model("nominal"))


def _bytes(comparison: ComparisonDocument) -> str:
    return json.dumps(comparison.model_dump(mode="json"), allow_nan=False)


@pytest.fixture(scope="module")
def track(runs: Runs) -> tuple[Track, str]:
    """A push of the juice beside the nominal model, and its condition."""
    run = next(run for run in runs.runs if run.condition_key[1] == "juice")
    return track_of_run(run, load_model("nominal")), run.condition


def test_the_document_has_its_schema(nominal: ComparisonDocument) -> None:
    document = json.loads(_bytes(nominal))
    assert {"score", "score_is", "noise_floor", "levels", "where"} <= set(document)
    assert set(document["levels"]) == {"jump", "free_motion", "trial"}
    keys = {"object", "case", "phase", "signal", "index", "error", "unit", "times_noise"}
    assert all(keys <= set(cell) for cell in document["where"])
    sizes = [cell["times_relevant"] for cell in document["where"]]
    assert sizes == sorted(sizes, reverse=True)
    assert document["score"] > document["noise_floor"] == 1.0
    entries = document["levels"]["jump"]["entries"]
    assert {entry["object"] for entry in entries} == {"parcel", "juice"}
    assert {"joint velocity jump", "object velocity", "end-effector velocity jump"} <= {e["signal"] for e in entries}


def test_a_rougher_support_shows_in_the_push_and_not_in_free_motion(nominal: ComparisonDocument) -> None:
    assert nominal.where[0].phase == "push"
    assert nominal.levels["free_motion"].times_noise < 2.5 < nominal.levels["trial"].times_noise


def test_the_true_model_scores_about_the_repeatability(runs: Runs, nominal: ComparisonDocument) -> None:
    value = ParameterValue(estimate=MORE_FRICTION, unit="-", ci95=None)
    true = Model(name="true", effects=(ModelEffect(name="support_friction", parameters={"friction": value}),))
    found = against(runs, true)
    assert found.noise_floor == 1.0
    assert found.score < 2.0
    assert found.score < 0.4 * nominal.score


def test_the_truth_is_never_read(
    hidden_campaign: Path, tmp_path: Path, rewrite_bag: Callable, nominal: ComparisonDocument
) -> None:
    stripped = tmp_path / "elsewhere"
    for path in hidden_campaign.glob("*/*"):
        (stripped / path.parent.name).mkdir(parents=True, exist_ok=True)
        rewrite_bag(path, stripped / path.parent.name / path.name, lambda topic: not topic.startswith(TRUTH))
    found = against(read_runs(stripped, map), load_model("nominal"))
    (remark,) = set(found.remarks) - set(nominal.remarks)
    assert "carry no checksums" in remark  # as they were written again
    assert _bytes(found.model_copy(update={"remarks": nominal.remarks})) == _bytes(nominal)


def test_without_repeats_the_score_stands_and_the_noise_floor_is_none(hidden_campaign: Path, tmp_path: Path) -> None:
    shutil.copytree(hidden_campaign / "push/juice__case_1__s1.000__r0", tmp_path / "juice__case_1__s1.000__r0")
    found = against(read_runs(tmp_path, map), load_model("nominal"))
    assert found.noise_floor is None
    assert found.score > 0.0
    assert "not repeated" in found.remarks[0]
    _bytes(found)
    for cell in found.where:  # the root mean square of its features; the error is that of the worst one
        assert 0.2 < cell.times_noise / (abs(cell.error) / cell.floor) < 1.001
    for level in (found.levels["free_motion"], found.levels["trial"]):
        assert level.signals
        for row in level.signals:
            assert row.times_noise == pytest.approx(row.error / row.floor, rel=0.05)


def test_without_repeats_the_terminal_names_the_relevance_limit(
    hidden_campaign: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(hidden_campaign / "push/juice__case_1__s1.000__r0", tmp_path / "juice__case_1__s1.000__r0")
    assert main(["compare", str(tmp_path), "--jobs", "1"]) == 0
    shown = capsys.readouterr().out
    assert "How large the differences are [times the relevance limit]" in shown
    assert "size: times the" in shown and "times repeatability" not in shown


def test_others_read_an_aligned_bag_whose_residual_is_the_difference(track: tuple[Track, str], tmp_path: Path) -> None:
    path = write_aligned(*track, tmp_path)
    messages: dict[str, list] = defaultdict(list)
    for message in read_ros2_messages(next(path.glob("*.mcap"))):
        messages[message.channel.topic].append(message.ros_msg)
    sides = ("measured", "predicted", "residual")
    names = ("arm/joint_states", "arm/end_effector/twist", "arm/end_effector/pose", "object/pose")
    assert {f"/{side}/{name}" for side in sides for name in names} <= set(messages)
    measured, predicted, residual = (
        np.array([message.velocity for message in messages[f"/{side}/arm/joint_states"]]) for side in sides
    )
    np.testing.assert_allclose(measured - predicted, residual, atol=1e-12)
    with pytest.raises(InputError, match="exists already"):
        write_aligned(*track, tmp_path)


def test_the_report_is_one_file_that_needs_no_network(
    track: tuple[Track, str], nominal: ComparisonDocument, tmp_path: Path
) -> None:
    path = write_comparison(nominal, [track[0]], None, tmp_path)
    text = path.read_text(encoding="utf-8")
    body = text.split("<script>", 1)[0]
    assert "src=" not in body and "://" not in body
    assert "Where the model fails" in body
    assert text.count("plotly.js v") <= 2  # embedded once
    assert json.loads((tmp_path / "compare.json").read_text()) == json.loads(_bytes(nominal))


def test_the_discrepancy_of_the_twin_is_stated_and_can_be_left_out(runs: Runs, nominal: ComparisonDocument) -> None:
    assert nominal.discrepancy.used and "mujoco" in nominal.discrepancy.provenance
    without = compare(ReplaySource.of(runs, load_model("nominal"), ReplayCache(map), NO_DISCREPANCY))
    assert not without.discrepancy.used
    assert without.score > nominal.score
    force = {s.signal: s for s in nominal.levels["trial"].signals if s.phase == "impact"}["contact force"]
    assert force.unit == "N" and 0.1 < force.discrepancy < 5.0


@pytest.mark.parametrize("count", [1, 3])
def test_runs_whose_replay_hits_nothing_are_left_out_if_they_are_few(runs: Runs, count: int) -> None:
    hits = [run for run in runs.runs if run.hit]
    missed = hits[:count]
    store = ReplayCache(map)

    def blind(tasks: Sequence[Replay], what: str = "") -> list[np.ndarray | None]:
        lost = {run.setup.digest for run in missed}
        done = zip(tasks, store(tasks, what), strict=True)
        return [None if task.setup.digest in lost else found for task, found in done]

    model = load_model("nominal")
    if count > len(hits) / 2:
        with pytest.raises(InputError, match="the replay hits nothing"):
            ReplaySource.of(runs, model, blind)  # type: ignore[arg-type]
        return
    found = ReplaySource.of(runs, model, blind)  # type: ignore[arg-type]
    assert sum(len(item.residuals) for item in found.clusters) == len(runs.runs) - count
    (remark,) = (line for line in found.remarks if line.startswith("left out, because with model 'nominal' the replay"))
    assert all(Path(run.path).name in remark for run in missed)
    assert "motion_capture" not in remark


def test_hits_missed_by_a_shifted_tracker_are_kept_with_its_frame_as_the_hits_determine_it(runs: Runs) -> None:
    """Kills runs left out although an effect makes them hit, and a frame that is named without being needed."""
    shift = np.array([0.02, 0.02, 0.0])

    def shifted(run: MeasuredRun) -> MeasuredRun:
        *free, last = run.setup.windows
        box = replace(last.object, position=last.object.position + shift)
        return replace(run, setup=replace(run.setup, windows=(*free, replace(last, object=box))))

    seen = replace(runs, runs=tuple(shifted(run) if run.hit else run for run in runs.runs))
    lost, store = next(run for run in seen.runs if run.hit), ReplayCache(map)
    exact = {one.setup.digest: run.setup for one, run in zip(seen.runs, runs.runs, strict=True)}

    def misses_one(
        tasks: Sequence[Replay], what: str = "", but: Sequence[str] = ("tracker_frame",)
    ) -> list[np.ndarray | None]:
        bare = load_model("nominal")
        done = store([replace(task, setup=exact[task.setup.digest], model=bare) for task in tasks], what)
        hit = [
            task.setup.digest != lost.setup.digest or {*but} & {e.name for e in task.model.effects} for task in tasks
        ]
        return [found if kept else None for kept, found in zip(hit, done, strict=True)]

    found = ReplaySource.of(seen, load_model("nominal"), misses_one)  # type: ignore[arg-type]
    assert found.identity.count == len(runs.runs)
    (frame,) = found.model.effects
    (required,) = found.required
    assert frame == required.item and frame.name == "tracker_frame"
    assert (required.missed, required.impacts) == (1, sum(run.hit for run in runs.runs))
    offset = np.array([frame.parameters[name].estimate for name in ("x", "y")])
    assert np.linalg.norm(offset) > 0.01 and offset @ shift[:2] > 0.0
    assert found.declared_model.effects == () and compare(found).model.digest == load_model("nominal").digest
    assert any("the replays of 1 of" in line for line in found.remarks)
    assert all(item.calibrations is not None and len(item.calibrations) >= 3 for item in found.clusters)
    either = ReplaySource.of(seen, load_model("nominal"), partial(misses_one, but=("tracker_frame", "pad_position")))  # type: ignore[arg-type]
    assert {one.item.name for one in either.required} == {"tracker_frame", "pad_position"}
    assert either.required[0].size <= either.required[1].size
    assert [item.name for item in either.model.effects] == [either.required[0].item.name]
    still = ReplaySource.of(seen, load_model("nominal"), partial(misses_one, but=()))  # type: ignore[arg-type]
    assert still.required == () and still.identity.count == len(runs.runs) - 1
    assert ReplaySource.of(runs, load_model("nominal"), store).required == ()
