# SPDX-License-Identifier: Apache-2.0
"""Faults of readings, and the board that hides them: what is rewritten, what is not, how a document is scored."""

from __future__ import annotations

import json
import math
from pathlib import Path
from types import SimpleNamespace

from benchmarks import harness  # isort: skip, for it puts the stored documents on the path
import documents
import numpy as np
import pytest
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from scipy.spatial.transform import Rotation

from benchmarks.boards import measurement
from benchmarks.faults import BEGIN, BETWEEN, FAULTS, STORE, Drawn, Readings, rewrite_campaign, seconds_of
from examples.laboratory import ORDER, messages
from impact_rs_analysis.diagnosis.document import EffectDocument, EstimateDocument, write_document
from impact_rs_analysis.diagnosis.verdict import DiagnosisVerdict
from impact_rs_sim.effects import library
from impact_rs_sim.errors import InputError

RATE, JOINTS = 1000.0, 7
TIME = np.arange(400) / RATE
SEEN = TIME[::4]
TURN = Rotation.from_rotvec(np.multiply.outer(np.radians(90.0 + 20.0 * SEEN), (0.0, 0.0, 1.0)))
RUN = Readings(
    time=TIME,
    position=0.1 * np.arange(1, JOINTS + 1) + np.square(TIME)[:, None],
    velocity=2.0 * TIME[:, None] * np.ones(JOINTS),
    torque=np.arange(1.0, JOINTS + 1) + 30.0 * TIME[:, None],
    object_time=SEEN,
    object_position=np.array([0.5, 0.1, 0.3]) + SEEN[:, None] * np.array([0.0, 1.0, 0.0]),
    object_rotation=TURN.as_quat(),
    share=0.5,
)
CHANGED = {
    "none": set(),
    "quantised": {"position", "velocity", "torque", "object_position"},
    "encoder_offset": {"position"},
    "encoder_scale": {"position", "velocity"},
    "tracker_turned": {"object_position", "object_rotation"},
    "tracker_low_pass": {"object_position", "object_rotation"},
    "tracker_late": {"object_time"},
    "tracker_shifted": {"object_position"},
    "tracked_point": {"object_position"},
}


def rewritten(name: str, size: float, joint: int = 3, sign: float = -1.0, angle: float = 0.4) -> Readings:
    return FAULTS[name].rewrite(RUN, Drawn(size, joint, sign, angle, 1800.0))


@pytest.mark.parametrize("name", FAULTS)
def test_only_the_reading_that_is_wrong_is_changed(name: str) -> None:
    """Kills: a fault of one sensor or joint that reaches another, and one that changes what it is given."""
    before = {key: np.copy(value) for key, value in vars(RUN).items()}
    found = rewritten(name, FAULTS[name].sizes[-1])
    changed = {key for key, value in before.items() if not np.array_equal(getattr(found, key), value)}
    assert changed == CHANGED.get(name, {name.split("_")[0]})
    assert all(np.array_equal(getattr(RUN, key), value) for key, value in before.items())
    if any(parameter.endswith("_joint4") for own in truths(name).values() for parameter in own):
        beside = {"torque_crosstalk": {3, 4}}.get(name, {3})
        for key in changed:
            others = [joint for joint in range(JOINTS) if joint not in beside]
            assert np.array_equal(getattr(found, key)[:, others], before[key][:, others])


def truths(name: str, size: float | None = None) -> dict[str, dict[str, float]]:
    fault = FAULTS[name]
    found = fault.truths(Drawn(fault.sizes[-1] if size is None else size, 3, -1.0, 0.4, 1800.0))
    return {effect: dict(own) for effect, own in found.items()}


def test_offsets_and_gains_of_a_joint_are_as_large_as_the_table_says() -> None:
    """Kills: degrees for radians, percent for shares, a lost sign."""
    offset, gain = truths("encoder_offset")["encoder_offset"], truths("torque_gain")["torque_sensor_gain"]
    assert rewritten("encoder_offset", 1.0).position[:, 3] - RUN.position[:, 3] == pytest.approx(
        offset["offset_joint4"]
    )
    assert offset["offset_joint4"] == pytest.approx(-0.0174533)
    assert rewritten("torque_gain", 7.0).torque[:, 3] / RUN.torque[:, 3] - 1.0 == pytest.approx(gain["gain_joint4"])
    scale = truths("encoder_scale")["encoder_scale"]["scale_joint4"]
    for key in ("position", "velocity"):
        changed, before = (getattr(run, key)[1:, 3] for run in (rewritten("encoder_scale", 1.0), RUN))
        assert changed / before - 1.0 == pytest.approx(scale)
    assert rewritten("torque_offset", 1.0).torque[:, 3] - RUN.torque[:, 3] == pytest.approx(-1.0)
    assert rewritten("velocity_gain", 3.0).velocity[:, 3] == pytest.approx(0.97 * RUN.velocity[:, 3])


def test_neighbours_take_a_share_of_what_both_feel() -> None:
    """Kills: the second sensor takes of the first one's reading, which has crosstalk already; the wrong neighbour."""
    found = rewritten("torque_crosstalk", 5.0).torque
    own = truths("torque_crosstalk")["torque_sensor_crosstalk"]
    assert found[:, 3] == pytest.approx(RUN.torque[:, 3] + own["from_next_joint4"] * RUN.torque[:, 4])
    assert found[:, 4] == pytest.approx(RUN.torque[:, 4] + own["from_previous_joint5"] * RUN.torque[:, 3])


def test_a_drift_is_nothing_in_the_first_run_and_all_of_it_in_the_last() -> None:
    """Kills: a drift of the whole size in every run, and a rate that is of the whole campaign."""
    assert rewritten("torque_drift", 0.35).torque[:, 3] - RUN.torque[:, 3] == pytest.approx(-0.175)
    assert truths("torque_drift", 0.35)["torque_sensor_drift"]["rate_joint4"] == pytest.approx(-0.35 / 1800.0)


@pytest.mark.parametrize(("order", "share"), [("low_pass", 1.0), ("butterworth", math.sqrt(2.0))])
@pytest.mark.parametrize(("signal", "cutoff"), [("torque", 8.0), ("velocity", 12.0)])
def test_a_filtered_ramp_is_late_by_the_time_constant(signal: str, cutoff: float, order: str, share: float) -> None:
    """Kills: a cutoff in rad/s or of half the rate, a filter that begins at 0, one run backwards as well."""
    found, before = (getattr(run, signal)[:, 0] for run in (rewritten(f"{signal}_{order}", cutoff), RUN))
    slope = (before[-1] - before[0]) / TIME[-1]
    assert (before[-1] - found[-1]) / slope == pytest.approx(share / (2.0 * math.pi * cutoff), rel=0.01)
    assert found[0] == pytest.approx(before[0], abs=0.2 * slope / cutoff)
    if order == "low_pass":
        (constant,) = next(iter(truths(f"{signal}_low_pass", cutoff).values())).values()
        assert constant == pytest.approx(1.0 / (2.0 * math.pi * cutoff))


def test_an_own_velocity_is_late_by_half_its_samples() -> None:
    """Kills: a central difference, which is not late, and a difference over one sample fewer."""
    found = rewritten("velocity_difference", 20.0).velocity[:, 0]
    late = truths("velocity_difference", 20.0)["velocity_delay"]["delay"]
    assert found[20:] == pytest.approx(2.0 * (TIME[20:] - late)) and late == pytest.approx(0.01)
    assert np.all(found[:20] == found[20])


@pytest.mark.parametrize("name", ["tracker_turned", "tracker_shifted"])
def test_poses_are_those_of_the_frame_in_the_table(name: str) -> None:
    """p_reading = R(yaw) p + (x, y). Kills: a frame that is off the other way; a turn about the object."""
    found, frame = rewritten(name, FAULTS[name].sizes[-1]), truths(name)["tracker_frame"]
    c, s = math.cos(frame["yaw"]), math.sin(frame["yaw"])
    x, y, z = RUN.object_position.T
    expected = np.array([c * x - s * y + frame["x"], s * x + c * y + frame["y"], z]).T
    assert found.object_position == pytest.approx(expected)
    turned = (Rotation.from_quat(found.object_rotation) * TURN.inv()).as_rotvec()
    assert turned == pytest.approx(np.tile([0.0, 0.0, frame["yaw"]], (len(SEEN), 1)), abs=1e-7)
    assert np.linalg.norm((frame["x"], frame["y"])) == pytest.approx({"tracker_shifted": 0.008}.get(name, 0.0))


def test_the_tracked_point_turns_with_the_object() -> None:
    """Kills: a shift along the axes of the base."""
    found, point = rewritten("tracked_point", 15.0), truths("tracked_point")["tracked_point"]
    beside = TURN.inv().apply(found.object_position - RUN.object_position)
    assert beside == pytest.approx(np.tile([point["x"], point["y"], 0.0], (len(SEEN), 1)))
    assert np.linalg.norm(beside[0]) == pytest.approx(0.015)


def test_a_low_passed_pose_is_late_in_place_and_turn() -> None:
    """Kills: a filter on the components of a quaternion whose sign changes."""
    found, lag = rewritten("tracker_low_pass", 8.0), truths("tracker_low_pass")["tracker_lag"]["lag"]
    assert RUN.object_position[-1, 1] - found.object_position[-1, 1] == pytest.approx(lag, rel=0.05)
    behind = (Rotation.from_quat(found.object_rotation[-1]).inv() * TURN[-1]).magnitude()
    assert behind == pytest.approx(math.radians(20.0) * lag, rel=0.05)
    flipped = Readings(**{**vars(RUN), "object_rotation": RUN.object_rotation * np.resize([1, -1], (len(SEEN), 1))})
    again = FAULTS["tracker_low_pass"].rewrite(flipped, Drawn(8.0, 3, 1.0, 0.0))
    turned = Rotation.from_quat(again.object_rotation).inv() * Rotation.from_quat(found.object_rotation)
    assert turned.magnitude() == pytest.approx(0.0, abs=1e-7)


def test_what_a_seed_draws_is_the_same_again_and_of_the_joints_that_show_it() -> None:
    """Kills: a draw that depends on the process or the other cases."""
    for fault in FAULTS.values():
        drawn = [fault.drawn(fault.sizes[-1], seed) for seed in range(40)]
        assert drawn == [fault.drawn(fault.sizes[-1], seed) for seed in range(40)]
        assert {one.joint for one in drawn} == set(fault.joints) and {one.sign for one in drawn} == {-1.0, 1.0}
    assert FAULTS["encoder_offset"].drawn(1.0, 0) == Drawn(1.0, 2, -1.0, pytest.approx(-1.4541, abs=1e-3))


def campaign(folder: Path, runs: int) -> None:
    """A laboratory's folder of short bags."""
    rng = np.random.default_rng(3)
    for number in range(runs):
        with Writer(folder / f"run_{number}", version=9, storage_plugin=StoragePlugin.MCAP) as bag:
            topics = {}
            for tick in range(8):
                arm = SimpleNamespace(
                    **{key: rng.standard_normal(JOINTS) for key in ("position", "velocity", "torque")}
                )
                pose = SimpleNamespace(position=rng.standard_normal(3), quaternion=np.array([0.0, 0.0, 0.6, 0.8]))
                shown = SimpleNamespace(arms={"arm": arm}, object=pose if tick % 4 == 0 and number else None)
                command = SimpleNamespace(torque=rng.standard_normal(JOINTS))
                fields = SimpleNamespace(number=tick, measurement=shown, commands={"arm": command})
                for topic, late, message in messages(fields):
                    if topic not in topics:
                        topics[topic] = bag.add_connection(topic, message.__msgtype__, typestore=STORE)
                    log = BEGIN + tick * 10**6 + late
                    bag.write(topics[topic], log, STORE.serialize_cdr(message, message.__msgtype__))
    rows = [f"run_{number},{'box' if number else 'none'},free motion" for number in range(runs)]
    (folder / "runs.csv").write_text("\n".join(["bag,object,kind", *rows]) + "\n")
    (folder / "experiment.yaml").write_text("scenario: push\n")


def read(path: Path) -> dict[str, list[tuple[int, object]]]:
    """Log time and message by topic."""
    found: dict[str, list[tuple[int, object]]] = {}
    with Reader(path) as bag:
        for connection, log, raw in bag.messages():
            found.setdefault(connection.topic, []).append((log, STORE.deserialize_cdr(raw, connection.msgtype)))
    return found


def test_a_rewritten_bag_has_the_fault_and_is_otherwise_what_it_was(tmp_path: Path) -> None:
    """Kills: joints in the order of the driver taken for that of the arm; commands or clocks that change as well."""
    source, target = tmp_path / "source", tmp_path / "target"
    campaign(source, 3)
    assert seconds_of(source) == 240.0
    rewrite_campaign(source, target, FAULTS["torque_drift"], Drawn(0.3, 3, 1.0, 0.0))
    for number in range(3):
        before, after = read(source / f"run_{number}"), read(target / f"run_{number}")
        late = {log - own for topic in before for (own, _), (log, _) in zip(before[topic], after[topic], strict=True)}
        assert len(late) == 1 and after["/joint_states"][0][0] == BEGIN + number * BETWEEN
        for topic in before.keys() - {"/joint_states"}:
            assert len(before[topic]) == len(after[topic])
        for (_, own), (log, other) in zip(before["/joint_states"], after["/joint_states"], strict=True):
            moved = other.effort - own.effort
            assert moved[ORDER.index(3)] == pytest.approx(0.15 * number)
            assert np.array_equal(np.delete(moved, ORDER.index(3)), np.zeros(6))
            assert other.name == own.name and np.array_equal(other.position, own.position)
            assert log - 200_000 == other.header.stamp.sec * 10**9 + other.header.stamp.nanosec
        for (_, own), (_, other) in zip(
            before["/effort_controller/commands"], after["/effort_controller/commands"], strict=True
        ):
            assert np.array_equal(own.data, other.data)
    assert (target / "runs.csv").read_text() == (source / "runs.csv").read_text()


def test_a_late_pose_has_a_later_stamp_and_comes_later(tmp_path: Path) -> None:
    """Kills: a pose that is logged before its stamp; a delay of joint states as well."""
    source, target = tmp_path / "source", tmp_path / "target"
    campaign(source, 2)
    rewrite_campaign(source, target, FAULTS["tracker_late"], Drawn(18.0, 0, 1.0, 0.0))
    before, after = read(source / "run_1"), read(target / "run_1")
    shift = after["/joint_states"][0][0] - before["/joint_states"][0][0]
    for (log, own), (later, other) in zip(before["/mocap/box/pose"], after["/mocap/box/pose"], strict=True):
        stamps = [one.header.stamp.sec * 10**9 + one.header.stamp.nanosec for one in (own, other)]
        assert later - log - shift == stamps[1] - stamps[0] - shift == 18_000_000
        assert other.pose.position.x == own.pose.position.x


HIDDEN = {"object_mass": {"scale": 0.15}}
WRONG = {"torque_delay": {"delay": 0.02}, "spin_axes": {}}


def document(named: tuple[str, ...], ties: tuple[tuple[str, ...], ...] = (), scale: float = 1.14):
    """A diagnosis that names these, with an interval of 0.02 to either side."""
    effects = tuple(
        EffectDocument(
            name=name,
            verdict="CONFIRMED",
            parameters={
                key: EstimateDocument(estimate=value, ci95=(value - 0.02, value + 0.02), unit="-", nominal=nominal)
            },
            held_out_error_before=9.0,
            held_out_error_after=1.0,
            p_value=0.001,
        )
        for name, key, value, nominal in (("object_mass", "scale", scale, 1.0), ("torque_delay", "delay", 0.03, 0.0))
    )
    verdict = DiagnosisVerdict.parse("+".join(named) or "NOTHING-MISSING")
    update = {"named": named, "verdict": verdict, "effects": effects, "confusable": ties}
    return documents.diagnosis().model_copy(update=update)


def test_fault_and_physics_beneath_are_both_named() -> None:
    """Kills: an interval of a value held against a difference from nominal."""
    row = measurement.scored(document(("torque_delay", "object_mass")), WRONG, HIDDEN)
    assert row["fault_found"] and row["physics_right"] and row["exact"] and not row["physics_in_vain"]
    assert row["fault_covered"] == [1, 1] and row["physics_covered"] == [[1, 1]]
    row = measurement.scored(document(("torque_delay", "object_mass"), scale=1.2), WRONG, HIDDEN)
    assert row["exact"] and row["physics_covered"] == [[0, 1]]


@pytest.mark.parametrize(
    ("named", "ties", "found", "physics", "vain", "readings"),
    [
        ((), (), False, False, [], []),
        (("torque_gain",), (), False, False, ["torque_gain"], []),
        (("torque_gain", "object_mass"), (("torque_gain", "torque_delay"),), True, True, [], []),
        (("spin_axes", "base_tilt"), (), True, False, ["base_tilt"], []),
        (("torque_delay",), (("torque_delay", "object_mass"),), True, True, [], []),
    ],
)
def test_a_name_is_in_vain_unless_it_is_tied_with_what_is_there(
    named: tuple[str, ...],
    ties: tuple[tuple[str, ...], ...],
    found: bool,
    physics: bool,
    vain: list[str],
    readings: list[str],
) -> None:
    """Kills: a tie that counts for the fault and, of the same name, as physics in vain; a second word for the fault."""
    row = measurement.scored(document(named, ties), WRONG, HIDDEN)
    assert (row["fault_found"], row["physics_right"]) == (found, physics)
    assert (row["physics_in_vain"], row["readings_in_vain"]) == (vain, readings)
    assert not row["exact"]


def test_without_a_fault_a_reading_that_is_named_is_not_right() -> None:
    """Kills: a name of a reading counted as one of physics, or as nothing."""
    row = measurement.scored(document(("torque_delay",)), {}, {})
    assert row["fault_found"] is None and row["physics_right"] is None and not row["exact"]
    assert row["readings_in_vain"] == ["torque_delay"] and row["physics_in_vain"] == []
    row = measurement.scored(document(()), {}, {})
    assert row["exact"] and row["nothing_missing"]
    assert measurement.scored(document(("torque_delay", "spin_axes")), WRONG, {})["exact"] is False


def test_a_refused_campaign_has_found_nothing() -> None:
    """Kills: a campaign that was refused and is left out of the shares."""
    row = measurement.refused("no", WRONG, HIDDEN)
    assert row["fault_found"] is False and row["physics_right"] is False and not row["exact"]
    assert measurement.refused("no", {}, {})["fault_found"] is None


def test_truths_are_differences_from_nominal() -> None:
    """Kills: an effect without a parameter of the library, or its value left as it is."""
    assert measurement.differences({"object_mass": {"scale": 1.15}}) == {"object_mass": {"scale": pytest.approx(0.15)}}
    for name, (_, values) in measurement.BENCHES.items():
        assert not values or set(measurement.differences({name: values})[name]) <= {
            one.name for one in library()[name].scalars(7)
        }


def test_clear_faults_on_nothing_come_first_and_fresh_seeds_are_one_option_away() -> None:
    """Kills: a board that is stopped early without its clear faults; campaigns that keep seeds that were looked at."""
    parser = harness.parser_of("measurement")
    cases = measurement.cases(parser.parse_args([]))
    kinds = len(FAULTS)
    assert [case.base for case in cases[: 2 * kinds]] == ["nothing"] * (2 * kinds)
    assert {(case.fault.name, case.size) for case in cases[:kinds]} == {(f.name, f.sizes[-1]) for f in FAULTS.values()}
    assert len({case.name for case in cases}) == len(cases)
    fresh = measurement.cases(parser.parse_args(["--first-seed", "90000"]))
    assert [case.seed + 90000 for case in cases] == [case.seed for case in fresh]
    some = measurement.cases(parser.parse_args(["--sample", "60"]))
    assert len(some) == 60 and [case for case in cases if case in some] == some and len({c.base for c in some}) == 5
    few = measurement.cases(parser.parse_args(["--on", "bench", "--clear", "--fault", "encoder_offset"]))
    assert [case.name for case in few] == [
        f"encoder_offset__1__{base}__bench__seed0" for base in ("nothing", "object_mass", "joint_coulomb_friction")
    ]


def test_the_table_has_a_row_for_each_fault_and_one_for_all() -> None:
    """Kills: nulls among all faults, and intervals of faults without a number."""
    scored = measurement.scored(document(("torque_delay",)), WRONG, {})
    rows = [
        {"fault": name, "base": "nothing", "seconds": 2.0} | row
        for name, row in (("none", measurement.scored(document(()), {}, {})), ("torque_low_pass", scored))
    ]
    lines = {line[0]: line[1:] for line in measurement.table(rows, None).rows}
    assert lines["none"][:2] == ("1", "–") and lines["none"][4:6] == ("0 of 1", "1 of 1")
    assert lines["torque low pass, 20 and 8 Hz"][:3] == ("1", "1 of 1", "1 of 1")
    assert lines["all faults, nothing hidden"][:2] == ("1", "1 of 1") and "all faults, physics beneath" not in lines


def test_a_diagnosis_that_is_there_is_scored_again_and_a_refused_campaign_is_a_row(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Kills: a diagnosis made anew for another table of truths, its time lost; a board that ends at a refusal."""
    source, folder, made = tmp_path / "source", tmp_path / "case", []
    source.mkdir()
    folder.mkdir()
    campaign(source, 2)

    def diagnosed(path: Path, read: object, map_tasks: object) -> None:
        assert (folder / "runs" / "run_1" / "metadata.yaml").exists()
        made.append(path)
        write_document(document(("torque_delay",)), path)

    monkeypatch.setattr(measurement, "base_of", lambda *_: (source, {}))
    monkeypatch.setattr(measurement, "diagnosed", diagnosed)
    options = harness.parser_of("measurement").parse_args(
        ["--fault", "torque_low_pass", "--base", "nothing", "--clear"]
    )
    work, case = harness.Work(folder, options, map), measurement.cases(options)[0]
    first = measurement.run(case, work)
    assert first["fault_found"] and first["truth"]["torque_sensor_lag"] == {"lag": pytest.approx(0.0199, abs=1e-4)}
    assert not (folder / "runs").exists()
    assert measurement.run(case, work) == first and len(made) == 1
    (folder / "diagnosis.json").unlink()

    def refuse(*_: object) -> None:
        raise InputError("the replay hits nothing")

    monkeypatch.setattr(measurement, "diagnosed", refuse)
    row = measurement.run(case, work)
    assert row["fault_found"] is False and "hits nothing" in row["said"] and row["joint"] == first["joint"]
    assert measurement.table([row | {"name": "x"}], options).rows[0][-1] == "–"


def test_a_further_seed_is_another_recording_of_every_base(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Kills: nulls that are one campaign many times; bases that share seeds; a base that hides nothing."""
    asked = []

    def make(folder: Path, seed: int, map_tasks: object, kind: str, effect: str, size: str, magnitude: float) -> list:
        del map_tasks, size
        asked.append((seed, kind, effect))
        folder.mkdir()
        own = {effect: {"scale": {"value": 1.15, "unit": "-"}}} if effect == "object_mass" else {}
        effects = [{"name": name, "parameters": values} for name, values in own.items()]
        (folder / "truth.json").write_text(json.dumps({"effects": effects}))
        return []

    monkeypatch.setattr(measurement, "make", make)
    monkeypatch.setattr(measurement, "strip_campaign", lambda *_: None)
    options = harness.parser_of("measurement").parse_args(["--on", "plant", "--fault", "none", "--seeds", "30"])
    hidden = [measurement.base_of(case, tmp_path, map)[1] for case in measurement.cases(options)]
    assert len({seed for seed, *_ in asked}) == len(asked) == len(list(tmp_path.iterdir())) == 150
    assert {kind for _, kind, effect in asked if effect is None} == {"null"}
    assert {effect for _, kind, effect in asked if kind == "single"} == set(measurement.BASES[1:])
    assert hidden.count({"object_mass": {"scale": pytest.approx(0.15)}}) == 30


@pytest.mark.parametrize("name", FAULTS)
def test_free_motion_without_an_object_can_have_every_fault(name: str) -> None:
    """Kills: a first pose that is taken for granted."""
    empty = {"object_time": np.zeros(0), "object_position": np.zeros((0, 3)), "object_rotation": np.zeros((0, 4))}
    fault = FAULTS[name]
    found = fault.rewrite(Readings(**{**vars(RUN), **empty}), fault.drawn(fault.sizes[-1], 0, 1800.0))
    assert all(getattr(found, key).shape == value.shape for key, value in empty.items())
