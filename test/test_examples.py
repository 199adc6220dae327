"""The scripts of ``examples/`` run, and what they print is so."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import pytest

from impact_rs_trials.bags.reader import TrialBag
from impact_rs_trials.recordings.experiment import load_experiment
from impact_rs_trials.recordings.laboratory import read_laboratory

EXAMPLES = Path(__file__).resolve().parent.parent / "examples"


def load(name: str) -> ModuleType:
    """A script as a module."""
    found = importlib.util.spec_from_file_location(f"example_{name}", EXAMPLES / f"{name}.py")
    assert found is not None and found.loader is not None
    module = importlib.util.module_from_spec(found)
    found.loader.exec_module(module)
    return module


def test_examples_run_and_say_what_is_so(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    hidden_campaign: Path,
    diagnosed: Path,
) -> None:
    """In small: three scales, one diagnosed effect, whose twin runs are there already."""
    predicted = load("predict").main()
    assert abs(predicted["zero"]) < abs(predicted["reduced"]) < abs(predicted["rotor"])  # more inertia slows down less

    measured = load("campaign").main(tmp_path, [0.8, 1.0, 1.2])
    assert measured.estimate == pytest.approx(abs(predicted["reduced"]), rel=0.02)

    before, after = load("read_a_bag").main(tmp_path / measured.trials[0].name)
    assert before == pytest.approx(-0.7, abs=0.01)
    assert abs(after) < abs(before)

    comparison = load("compare").main(tmp_path)
    assert (comparison.trials, comparison.model.name) == (3, "nominal")
    assert comparison.score < 3.0  # nothing is hidden

    example = load("diagnose")
    example.record(tmp_path / "hidden", [("parcel", "case_1")], repeats=1)
    ((bag,),) = ([TrialBag.open(path)] for path in (tmp_path / "hidden").glob("parcel*"))
    assert bag.outcome == "OK"
    monkeypatch.setenv("XDG_CACHE_HOME", str(diagnosed.parent / "cache"))
    document = example.main(hidden_campaign, ["support_friction"])
    found = document.effect("support_friction").parameters["scale"]
    assert found.estimate == pytest.approx(1.6, abs=0.1)

    printed = capsys.readouterr().out
    for line in ("motor inertia reduced: -0.5", "95 % interval", "impact at 0.", "model 'nominal' against 3 trials"):
        assert line in printed
    assert f"{document.verdict}: {document.summary}" in printed


def test_the_bags_of_a_laboratory_are_read_with_the_experiment_file_beside_them(tmp_path: Path) -> None:
    load("laboratory").main(tmp_path, ["object_mass", "1.15"], [("push", "parcel", "case_2")], repeats=1)
    ((run,), skipped) = read_laboratory(tmp_path, load_experiment(tmp_path / "experiment.yaml"), map)
    assert (run.object, run.condition, skipped) == ("parcel", "case_2", [])
    assert run.object_position[-1, 1] < run.object_position[0, 1] - 0.1  # m, it is pushed along -y
    assert len(run.remarks) == 1  # that the commands have no stamps


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.py")), ids=lambda path: path.stem)
def test_an_example_is_short_and_says_how_to_run_it(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert f"./run python examples/{path.name}" in text
    assert len(text.splitlines()) <= 75
