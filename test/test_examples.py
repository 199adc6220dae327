# SPDX-License-Identifier: Apache-2.0
"""The scripts of ``examples/`` run, and what they print is so."""

from __future__ import annotations

import importlib.util
import io
import pickle
import shutil
import struct
import sys
import zipfile
from collections import OrderedDict
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pinocchio as pin
import pytest
from ball_impacts import Racket, bounced
from impact_table_cases import cube, tossed
from intervals import assert_covers

from impact_rs_sim.errors import InputError
from impact_rs_sim.impact_map import ImpactProblem, compute_impact_map
from impact_rs_sim.impact_map.contacts import contact_pairs
from impact_rs_sim.impact_map.measured import MeasuredImpact, points_that_touch, solve_measured
from impact_rs_sim.model import Model
from impact_rs_sim.physics import ObjectPhysics, Physics
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_sim.scene import Scene, pad_placements
from impact_rs_trials.bags.reader import TrialBag
from impact_rs_trials.recordings.experiment import load_experiment
from impact_rs_trials.recordings.impacts.impact_table import read_impact_table
from impact_rs_trials.recordings.laboratory_runs import read_laboratory
from impact_rs_trials.spec import TrialSpec

LONG = ("ball_bounces", "cube_tosses", "draw_robot", "foreign_plant")  # beside files, nodes or views of others, in full
EXAMPLES = Path(__file__).resolve().parent.parent / "examples"


def load(name: str) -> ModuleType:
    """A script as a module."""
    found = importlib.util.spec_from_file_location(f"example_{name}", EXAMPLES / f"{name}.py")
    assert found is not None and found.loader is not None
    module = importlib.util.module_from_spec(found)
    sys.modules[found.name] = module  # where dataclasses look for what their annotations mean
    found.loader.exec_module(module)
    return module


def test_examples_of_a_campaign_run_and_say_what_is_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], push_campaign: Path
) -> None:
    """In small: three scales, whose trials are there already."""
    predicted = load("predict").main()
    assert abs(predicted["zero"]) < abs(predicted["reduced"]) < abs(predicted["rotor"])  # more inertia slows down less

    folder = tmp_path / "push"
    shutil.copytree(push_campaign, folder)
    measured = load("campaign").main(folder, [0.8, 1.0, 1.2])
    assert measured.estimate == pytest.approx(abs(predicted["reduced"]), rel=0.02)

    before, after = load("read_a_bag").main(folder / measured.trials[0].name)
    assert before == pytest.approx(-0.7, abs=0.01)
    assert 0.8 < after / predicted["reduced"] < 1.0  # on the way from the predicted velocity to this trial's reference

    figure = tmp_path / "figure.png"
    assert abs(load("paper_figure").main(folder, figure)) == pytest.approx(measured.estimate, abs=1e-12)
    assert figure.read_bytes().startswith(b"\x89PNG")

    picture = tmp_path / "robot.png"
    assert load("draw_robot").main(folder / measured.trials[0].name, picture) > 15  # shapes of arm, pad, box, support
    assert picture.read_bytes().startswith(b"\x89PNG")

    printed = capsys.readouterr().out
    for line in ("motor inertia reduced: -0.5", "95 % interval", "impact at 0."):
        assert line in printed


def test_the_example_of_a_diagnosis_finds_the_friction_that_it_hides(
    monkeypatch: pytest.MonkeyPatch, hidden_campaign: Path, diagnosed: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """For one effect, whose twin runs are there already. Kills a comparison or an estimate that is not printed."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(diagnosed.parent / "cache"))
    document = load("diagnose").main(str(hidden_campaign), ["support_friction"])
    assert list(document.named) == ["support_friction"]
    assert_covers(document.effect("support_friction").parameters["friction"].ci95, 0.18, half_width=0.04)
    score, *where, summary, estimate = capsys.readouterr().out.splitlines()
    assert float(score.split()[1]) > 3.0 and len(where) == 3
    assert summary == document.summary and estimate.startswith("  support_friction: friction 0.1")


def test_two_hands_are_where_their_poses_say_and_a_locked_torso_makes_both_heavier(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """By inverse kinematics of 15 joints; the box of 0.6 kg is between them, and both go on with it."""
    example = load("two_hands")
    scene = Scene.resolve(example.scenario(), "parcel", "case_1")
    state, model, wanted = scene.arms["robot"], scene.models["robot"], example.scenario().robots["robot"]
    assert wanted.hands["right"].impact is not None
    for hand, pose, linear in (
        ("", wanted.impact.placement, [0.0, -0.4, 0.0]),
        ("right", wanted.hands["right"].impact.placement, [0.0, 0.0, 0.0]),
    ):
        found = model.placement(state.position, hand)
        np.testing.assert_allclose(found.rotation, pose.rotation, atol=1e-8)
        np.testing.assert_allclose(model.jacobian(state.position, hand) @ state.velocity, [*linear, 0, 0, 0], atol=1e-8)
    for pair in contact_pairs(scene.physics, scene.object, pad_placements(scene.physics, scene.models, scene.arms)):
        assert abs(pair.separation) < 1e-8
    found = example.main()
    (left, right), (left_locked, right_locked) = found["turns"], found["locked"]
    assert left > left_locked + 2e-4 and left_locked > 0.1  # the hand that hits is lighter on a torso that gives way
    assert right_locked < right < -0.1
    assert "torso turns: left hand" in capsys.readouterr().out


def test_the_cable_of_ones_own_holds_the_box_back_in_proportion_to_its_drag() -> None:
    free, dragged, twice = load("own_effect").main((0.0, 20.0, 40.0))
    assert free > dragged
    assert free - twice == pytest.approx(2.0 * (free - dragged), rel=0.2)


def test_bags_of_a_laboratory_are_read_with_the_experiment_file_beside(tmp_path: Path) -> None:
    load("laboratory").main(tmp_path, ["object_mass", "1.15"], [("push", "parcel", "case_2")], repeats=1)
    ((run,), skipped) = read_laboratory(tmp_path, load_experiment(tmp_path / "experiment.yaml"), map)
    assert (run.condition_key[1], run.condition, skipped) == ("parcel", "parcel/case_2", [])
    assert run.signals.object_position[-1, 1] < run.signals.object_position[0, 1] - 0.1  # m, it is pushed along -y
    assert len(run.remarks) == 1  # that the commands have no stamps


def test_tosses_as_torch_writes_them_become_a_table_of_impacts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Cubes that bounce as the impact map says, in the layout of the public files; one in the zip format, one twice."""
    example = load("cube_tosses")
    truth = replace(cube(0.2, 0.3), object=ObjectPhysics(0.37, np.full(3, 0.1048), np.full(3, 8.1e-4), np.zeros(3)))
    rng = np.random.default_rng(0)
    before, after = [], []
    for number in range(6):
        states, twists = _toss(rng, truth, np.array([0.0, 0.0, -9.81]), example.PERIOD)
        _save_like_torch(tmp_path / f"{number}.pt", states / example.HALF_WIDTH ** _lengths(), number == 3, monkeypatch)
        before.append(twists[0])
        after.append(twists[1])
    (tmp_path / "6.pt").write_bytes((tmp_path / "2.pt").read_bytes())
    assert example.write_table(tmp_path, tmp_path / "tosses.csv", 0.3, 0.0) == 6
    assert "6 of 7 tosses; left out: 1 recorded twice" in capsys.readouterr().out
    table = read_impact_table(tmp_path / "tosses.csv")
    for row, ante, post in zip(table.rows, before, after, strict=True):
        assert row.impact.object.twist == pytest.approx(ante, abs=0.02)
        assert row.after == pytest.approx(post, abs=0.02)
        assert len(row.impact.points) == 1
    (tmp_path / "7.pt").write_bytes(pickle.dumps(Path("x")))
    with pytest.raises(InputError, match="no tensor of a toss"):
        example.read_tensor(tmp_path / "7.pt")


def test_flights_of_balls_become_a_table_of_their_bounces(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Balls that slide on a table by closed forms, in air that bends their flight, seen to the millimetre."""
    example, rng = load("ball_bounces"), np.random.default_rng(0)
    racket, truth = Racket(lambda _: 0.9, 0.2), []
    index, flights = ["traj_file,x_spin,y_spin,z_spin"], {}
    for number in range(6):
        before = np.array([*rng.uniform(-1.0, 1.0, 1), -6.0, -2.5, *rng.uniform(-100.0, 100.0, 3)])
        after = bounced(before, racket)
        times = np.arange(-14, 15) / 145.0 + rng.uniform(0.001, 0.005)
        bent = np.array([1.0, 2.0, -12.0])  # m/s^2, gravity, drag and Magnus force
        sides = np.where(times[:, None] < 0.0, before[:3], after[:3])
        seen = np.round(sides * times[:, None] + 0.5 * bent * times[:, None] ** 2, 3)
        flights[f"{number:03d}.csv"] = "\n".join(
            f"{t:.4f};{x};{y};{z}" for t, (x, y, z) in zip(times, seen, strict=True)
        )
        spin = before[3:] if number else np.array([2000.0, 0.0, 0.0])  # faster than any spin that was measured
        of_camera = (spin[0], -spin[2], spin[1])  # x to the right, y down, and it looks along y of the table
        index.append(f"{number},{','.join(map(str, of_camera))}")
        truth.append((before, after))
    with zipfile.ZipFile(tmp_path / "flights.zip", "w") as archive:
        for name, text in {**flights, "index.csv": "\n".join(index)}.items():
            archive.writestr(name, text)
    assert example.write_table(tmp_path / "flights.zip", tmp_path / "bounces.csv", 0.3, 0.5) == 5
    assert "5 of 6 flights; left out: 1 spin of more than 160 turns" in capsys.readouterr().out
    table = read_impact_table(tmp_path / "bounces.csv")
    for row, (before, after) in zip(table.rows, truth[1:], strict=True):
        assert row.impact.object.twist == pytest.approx(before, abs=0.06)  # m/s: 0.3 mm over 14 samples
        assert row.after[:3] == pytest.approx(after[:3], abs=0.06)
    (tmp_path / "none.zip").write_text("none")
    with pytest.raises(InputError, match="no archive of flights"):
        example.write_table(tmp_path / "none.zip", tmp_path / "none.csv", 0.3, 0.5)


def _lengths() -> np.ndarray:
    """Powers of length in the columns of a toss."""
    powers = np.zeros(19)
    powers[[0, 1, 2, 7, 8, 9]] = 1.0
    return powers


def _toss(
    rng: np.random.Generator, truth: Physics, gravity: np.ndarray, period: float
) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray]]:
    """Ten samples before an impact on one corner and ten after it, and both twists."""
    while True:
        impact = tossed(rng)
        signs = np.array([[x, y, z] for x in (1, -1) for y in (1, -1) for z in (1, -1)])
        heights = np.sort(0.0524 * signs @ impact.object.rotation[2])
        if heights[1] - heights[0] > 0.03:
            break
    place = np.array([0.1, 0.2, -heights[0]])
    body = replace(impact.object, position=place)
    impact = MeasuredImpact({}, body, points_that_touch(body, truth.object.size, np.array([0.0, 0.0, 1.0])))
    after, _ = solve_measured(truth, impact)
    states = np.zeros((20, 19))
    for sample in range(20):
        time = (sample - 9.6) * period
        twist = body.twist if time < 0.0 else after
        turn = pin.exp3(twist[3:] * time) @ body.rotation
        x, y, z, w = pin.Quaternion(turn).coeffs()
        states[sample, :3] = place + twist[:3] * time + 0.5 * gravity * time**2
        states[sample, 3:7] = w, x, y, z
    return states, (body.twist, after)


def _save_like_torch(path: Path, states: np.ndarray, as_zip: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file as ``torch.save`` writes it, in its old format or as zip."""
    torch, utils = ModuleType("torch"), ModuleType("torch._utils")
    torch.DoubleStorage = type("DoubleStorage", (), {"__module__": "torch", "__qualname__": "DoubleStorage"})

    def _rebuild_tensor_v2() -> None: ...

    _rebuild_tensor_v2.__module__, _rebuild_tensor_v2.__qualname__ = "torch._utils", "_rebuild_tensor_v2"
    utils._rebuild_tensor_v2 = _rebuild_tensor_v2
    monkeypatch.setitem(sys.modules, "torch", torch)
    monkeypatch.setitem(sys.modules, "torch._utils", utils)
    shape = (1, *states.shape)

    class Storage:
        pass

    class Tensor:
        def __reduce__(self) -> tuple[object, ...]:
            return _rebuild_tensor_v2, (Storage(), 0, shape, (states.size, shape[2], 1), False, OrderedDict())

    class Pickler(pickle.Pickler):
        def persistent_id(self, item: object) -> object:
            return ("storage", torch.DoubleStorage, "0", "cpu", states.size) if isinstance(item, Storage) else None

    stream = io.BytesIO()
    Pickler(stream, protocol=2).dump(Tensor())
    raw = states.astype("<f8").tobytes()
    if as_zip:
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("toss/data.pkl", stream.getvalue())
            archive.writestr("toss/data/0", raw)
        return
    head = b"".join(pickle.dumps(part, protocol=2) for part in (0x1950A86A20F9469CFC6C, 1001, {"little_endian": True}))
    keys = pickle.dumps(["0"], protocol=2)
    path.write_bytes(head + stream.getvalue() + keys + struct.pack("<q", states.size) + raw)


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.py")), ids=lambda path: path.stem)
def test_an_example_is_short_and_says_how_to_run_it(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert f"./run python examples/{path.name}" in text
    assert len(text.splitlines()) <= (75 if path.stem not in LONG else 310)


def test_on_a_changing_day_the_last_pushes_are_of_a_heavier_object(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same trial before and after the change: the pad goes on more slowly, in the ratio of both impact maps."""
    example, speeds = load("changing_day"), []
    monkeypatch.setattr(example, "KINDS", example.KINDS[:1])
    for name, quiet, changed in (("before", 1, 0), ("after", 0, 1)):
        example.main(tmp_path / name, quiet, changed)
        (path,) = (tmp_path / name / "push").iterdir()
        bag = TrialBag.open(path)
        state, hit = bag.controller("arm"), bag.impact_time("arm")
        assert bag.outcome == "OK" and hit is not None
        speeds.append(abs(float(state.twist[np.searchsorted(state.time, hit + 0.02), 1])))
    scene = TrialSpec.of(load_scenario("push"), *example.KINDS[0][1:]).scene
    heavier = Model(name="truth", effects=(example.HEAVIER,)).apply(scene.physics)
    light, heavy = (
        compute_impact_map(ImpactProblem.at_nominal_impact(replace(scene, physics=one))).end_effector_twist["arm"][1]
        for one in (scene.physics, heavier)
    )
    assert heavy / light < 0.98
    assert speeds[1] / speeds[0] == pytest.approx(heavy / light, abs=0.012)


@pytest.mark.parametrize("name", ["push_ur5e", "push_iiwa7"])
def test_a_trajectory_goal_leads_the_pad_straight_through_the_place_of_the_hit(name: str) -> None:
    """Its speed there is that of the case, between two points too, and at its end the arm rests."""
    module = load("trajectory_goal")
    points = module.goal(name)["trajectory"]["points"]
    scenario = load_scenario(name)
    spec = TrialSpec.of(scenario, next(iter(scenario.objects)), next(iter(scenario.cases)))
    model, (arm,) = spec.scene.models["arm"], spec.plan.arms.values()
    times = np.array([point["time_from_start"]["sec"] + 1e-9 * point["time_from_start"]["nanosec"] for point in points])
    q, dq = (np.array([point[key] for point in points]) for key in ("positions", "velocities"))
    assert np.diff(times) == pytest.approx(module.PERIOD)
    assert module.goal(name, start=True)["trajectory"]["points"][0]["positions"] == pytest.approx(arm.initial, abs=1e-6)
    assert q[0] == pytest.approx(arm.initial, abs=1e-3) and dq[-1] == pytest.approx(0.0 * dq[-1], abs=1e-6)
    hit = int(np.argmin(np.abs(times - scenario.timing.nominal_impact)))
    case = scenario.cases[spec.scene.case_name].robots["arm"]
    assert model.placement(q[hit]).translation == pytest.approx(scenario.robots["arm"].impact.position, abs=1e-5)
    assert (model.jacobian(q[hit]) @ dq[hit])[:3] == pytest.approx(case.ante_velocity, abs=1e-4)
    mean = (q[1:] - q[:-1]) / module.PERIOD
    assert np.abs(mean - 0.5 * (dq[1:] + dq[:-1])).max() < 0.02 * np.abs(dq).max()
    path = np.array([model.placement(joints).translation for joints in q])
    across = np.delete(path - path[hit], scenario.axis_index, axis=1)
    assert np.abs(across).max() < 1e-5
