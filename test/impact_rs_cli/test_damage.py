# SPDX-License-Identifier: Apache-2.0
"""Damaged files, command lines and trials: each is read as it was, or refused in one line, and nothing is half done.

A change that leaves a valid file with other numbers cannot be seen by any reader; such changes of digits are not made.
One example in three is tried in the fast tier.
"""

from __future__ import annotations

import contextlib
import csv
import hashlib
import io
import json
import os
import random
import shutil
import warnings
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
import scipy.io
import yaml
from builders import mapping_of, read_positions
from damage import TIERS, damaged, edited, flipped, headless, mangled, repeatable, spliced
from hypothesis import given
from hypothesis import strategies as st
from impact_table_cases import write_csv
from live_hits import DAMAGES, JOINTS, MOTORS, POSE, Damage, Live, Messages, damaged_messages
from signal_files import TIME, VALUES, csv_file, hdf5_file, npz_file, parquet_file, torch_file

from impact_rs_cli.main import main
from impact_rs_sim.effects.formula import load_formulas
from impact_rs_sim.errors import InputError
from impact_rs_sim.model import load_model
from impact_rs_sim.paths import config_directory
from impact_rs_sim.robots.robot import load_facts
from impact_rs_sim.robots.robot_import import import_urdf
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_sim.schema import load
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.reader import BagError, TrialBag
from impact_rs_trials.campaign import Manifest, make_manifest
from impact_rs_trials.recordings.experiment import Experiment, load_experiment, read_runs
from impact_rs_trials.recordings.impacts.impact_table import read_impact_table
from impact_rs_trials.recordings.importing.candidates import candidates_of
from impact_rs_trials.recordings.importing.import_recordings import ImportOptions, draft_import
from impact_rs_trials.recordings.importing.table_layout import find_layout
from impact_rs_trials.recordings.mapping import Mapping, load_mapping
from impact_rs_trials.recordings.readers.array_file import ArrayFile
from impact_rs_trials.recordings.readers.series import Names
from impact_rs_trials.recordings.readers.table_file import TableFile
from impact_rs_trials.recordings.readers.text_file import read_text

BAG = "cat_food__case_2__s1.000__r0"
LONGEST = 2500  # characters of a message; those that list every known name are long
SHIPPED, ROWS = load_mapping("joint_state"), TIME.size


class Reader(NamedTuple):
    """A kind of file, and what reads it.

    Attributes:
        write: Writes the sound file.
        read: Reads it; false where what is read is not what the file holds.
        change: Damaged contents, made of the sound one.
        examples: How many of them are tried in full.
    """

    write: Callable[[Path], object]
    read: Callable[[Path], object]
    change: Callable[[bytes], st.SearchStrategy[bytes]]
    examples: int = 60


def listing(folder: Path) -> list[tuple[str, int]]:
    """Everything below a folder, with its size."""
    return sorted((str(path), path.lstat().st_size) for path in folder.rglob("*"))


# ---- tables and arrays of signals -----------------------------------------------------------------------------------

CELLS = (
    *('"', '""', '"slow', 'a"', "3_7", "\uff11", "0x1p3", "1d3", "infinity", "-inf", "nan", "", " ", "1,5", "1;5"),
    *("--1", "9" * 5000, "1e400", "x" * 140_000, "#", "\0", "\u2028", "=1+1", "True", "1+2j", "2026-01-01T00:00:00"),
)
URDF = """<robot name="arm">
<link name="base"/>
<link name="one"><inertial><origin xyz="0 0 0.1"/><mass value="2"/>
<inertia ixx="0.02" ixy="0" ixz="0" iyy="0.03" iyz="0" izz="0.025"/></inertial></link>
<joint name="turn" type="revolute"><parent link="base"/><child link="one"/><origin xyz="0 0 0.2" rpy="0.3 0 0"/>
<axis xyz="0 1 0"/><limit lower="-2" upper="1.5" velocity="3" effort="40"/></joint>
</robot>
"""


def text_damage(data: bytes) -> st.SearchStrategy[bytes]:
    return st.one_of(damaged(data), *[edited(data.decode(), CELLS, ',"')] * 3)


@st.composite
def with_a_second_array(draw: st.DrawFn, data: bytes) -> bytes:
    """An archive with a second array of one name, or of another kind."""
    kinds = (VALUES + 1.0, VALUES * 1j, VALUES.astype(str), np.zeros(0), TIME.astype("m8[s]"))
    array, archive = io.BytesIO(), io.BytesIO(data)
    np.save(array, draw(st.sampled_from(kinds)))
    with warnings.catch_warnings(), zipfile.ZipFile(archive, "a") as file:
        warnings.simplefilter("ignore")  # of the second one
        file.writestr(draw(st.sampled_from(("position", "time"))) + ".npy", array.getvalue())
    return archive.getvalue()


def impacts(path: Path) -> Path:
    """Cubes that fall."""
    body = [*(f"{axis} [m]" for axis in "xyz"), "qx", "qy", "qz", "qw", "mass [kg]", *(f"size_{i} [m]" for i in "xyz")]
    units = {"v": "m/s", "w": "rad/s"}
    twists = [f"{k}{axis}_{when} [{units[k]}]" for when in ("before", "after") for k in "vw" for axis in "xyz"]
    row = ["0", "0", "0.05", "0", "0", "0", "1", "0.3", "0.1", "0.1", "0.1", "fine"]
    moving = ["0.1", "0", "-1", "0", "0", "0", "0.05", "0", "0", "0", "0", "0"]
    return write_csv(path, [*body, "remark", *twists], [[*row, *moving]] * ROWS)


def runs(path: Path) -> Path:
    rows = [[f"run_{number}", "parcel", "hit", "fine"] for number in range(ROWS)]
    for name, *_ in rows:
        path.with_name(name).mkdir()
    return write_csv(path, ["bag", "object", "kind", "remark"], rows)


def lines_of(path: Path) -> int:
    text = read_text(path)
    return sum(bool(line.strip()) and not line.startswith("#") for line in text.split("\n")) - 1


def every_sample(path: Path) -> bool:
    """A row of positions for every line that has any; a last line that was cut off is left out, which is said."""
    found = TableFile(path, SHIPPED, Names()).series("position", SHIPPED.signals["position"])
    head, *rows = csv.reader(line for line in read_text(path).split("\n") if line.strip())
    places = [place for place, name in enumerate(head) if name.strip().startswith("position_")]
    held = sum(any(row[place].strip() for place in places if place < len(row)) for row in rows if row[0][:1] != "#")
    assert found.time.size == found.values.shape[0] <= lines_of(path)
    return found.time.size >= held - sum("left out" in str(remark) for remark in found.remarks)


def every_run(path: Path) -> bool:
    experiment = Experiment(scenario="push", runs=path.name)
    return len(read_runs(path.parent, experiment, experiment.load_scenario())) == lines_of(path)


def same_numbers(path: Path) -> bool:
    """Or it is said that a change of them could not be detected."""
    file = ArrayFile(path, SHIPPED, Names())
    found = file.series("position", SHIPPED.signals["position"])
    return bool(file.unsealed) or (np.array_equal(found.time, TIME) and np.array_equal(found.values, VALUES))


def any_numbers(path: Path) -> bool:
    """A format without checksums: its numbers may be others, but there is one row of them a stamp."""
    file = (TableFile if path.suffix == ".parquet" else ArrayFile)(path, SHIPPED, Names())
    found = file.series("position", SHIPPED.signals["position"])
    return found.time.size == found.values.shape[0]


FILES = {
    "signals.csv": Reader(lambda path: csv_file(path, ["fine"] * ROWS), every_sample, text_damage),
    "impacts.csv": Reader(impacts, lambda path: len(read_impact_table(path).rows) == lines_of(path), text_damage),
    "runs.csv": Reader(runs, every_run, text_damage),
    "arm.urdf": Reader(lambda path: path.write_text(URDF), lambda p: len(import_urdf(p).joints) == 1, text_damage),
    "signals.parquet": Reader(parquet_file, any_numbers, damaged),
    "signals.npz": Reader(npz_file, same_numbers, lambda data: st.one_of(damaged(data), with_a_second_array(data))),
    "signals.pt": Reader(torch_file, same_numbers, damaged),
    "plain.h5": Reader(hdf5_file, any_numbers, damaged),
    "sealed.h5": Reader(lambda path: hdf5_file(path, "latest", fletcher32=True, chunks=True), same_numbers, damaged),
}

# ---- raw logs, by the forms in which laboratories write them --------------------------------------------------------

TIMES = 0.01 * np.arange(40)  # s
SINES = np.round(0.3 * np.outer(np.sin(1.0 + TIMES), np.arange(1.0, 8.0)), 6)  # rad, within limits
SAMPLES = list(zip(TIMES, SINES.tolist(), strict=True))
NUMBERED = [f"c{column}" for column in range(2, 9)]


def log_of(*above: str, row: str, between: str = " ", decimal: str = ".") -> str:
    """A log; ``row`` has places for its second ``s``, its nanoseconds ``ns`` and its joints ``q``."""
    rows = [row.format(s=s, ns=round(1e9 * s), q=between.join(map(repr, q))) for s, q in SAMPLES]
    return "\n".join([*above, *rows]).replace(".", decimal) + "\n"


COLUMNS = [f"q{joint}" for joint in range(1, 8)]
LOGS = {
    "vectors": (
        log_of("made by x,1", "RosTime,Joint", row="{s:.2f},{q}"),
        mapping_of({"column": "RosTime"}, {"header": 2}, column="Joint"),
    ),
    "no names": (log_of(row="{s:.2f} {q}"), mapping_of({"column": "c1"}, {"header": 0}, columns=NUMBERED)),
    "a gripper": (
        log_of("made by x,1", "RosTime,Joint", row="{s:.2f},0.5 {q} 0.04"),
        mapping_of({"column": "RosTime"}, {"header": 2}, column="Joint", entries=range(2, 9)),
    ),
    "decimal commas": (
        log_of(";".join(["sec", "nsec", *COLUMNS]), row="17;{ns};{q}", between=";", decimal=","),
        mapping_of({"column": ["sec", "nsec"]}, {"decimal": ","}, column="q{joint}"),
    ),
    "dates": (
        log_of(",".join(["t", *COLUMNS]), row="2026-11-25 12:00:0{s:.2f},{q}", between=","),
        mapping_of({"column": "t", "unit": "date"}, {}, column="q{joint}"),
    ),
}


def rows_of(found: np.ndarray) -> set[tuple[float, ...]]:
    seen = np.isfinite(found).all(axis=1)  # a lost cell is nan, which the checks of a run refuse
    return {tuple(row) for row in np.round(found[seen], 9).tolist()}


def numbers_that_were_there(mapping: Mapping) -> Callable[[Path], bool]:
    """Rows that are read were in the file, but for the last one of a file that was cut within a number."""

    def read(path: Path) -> bool:
        found = read_positions(path, mapping).values
        return rows_of(found) - rows_of(SINES) <= rows_of(found[-1:])

    return read


def imported(path: Path) -> bool:
    """Whatever an import looks at answers, or refuses in one line; these logs lack the torques that it needs."""
    for look in (find_layout, candidates_of, lambda one: draft_import([one], one.parent, ImportOptions("kuka_iiwa7"))):
        try:
            look(path)
        except InputError as error:
            assert "\n" not in str(error) and path.name in str(error)
    return True


for form, (text, mapping) in LOGS.items():
    write, mangle = (lambda path, text=text: path.write_text(text)), (lambda data: mangled(data.decode()))
    FILES[f"log of {form}.csv"] = Reader(write, numbers_that_were_there(mapping), mangle, 300)
    FILES[f"raw {form}.csv"] = Reader(write, imported, mangle, 90)
FILES["log.mat"] = Reader(
    lambda path: scipy.io.savemat(path, {"time": TIMES, "position": SINES}),
    lambda path: read_positions(path, mapping_of({}, {}, array="position")),
    headless,
    200,
)
FILES["log.npy"] = Reader(
    lambda path: np.save(path, np.column_stack((TIMES, SINES))),
    lambda path: read_positions(path, mapping_of({"column": "c1"}, {}, columns=NUMBERED)),
    headless,
    200,
)

# ---- YAML that a user writes ----------------------------------------------------------------------------------------

FORMULAS = """\
effects:
- name: cable_drag
  sentence: A cable drags behind the end effector.
  end_effector_force: {y: "-drag * vy"}
  motor_torque: {joint2: "-c * tanh(dq2 / 0.02)"}
  parameters:
    drag: {unit: N s/m, nominal: 0, lower: 0, upper: 50, scale: 1}
    c: {unit: N m, nominal: 0, lower: 0, upper: 3, scale: 0.1}
"""
MODEL = """\
name: better
parent: nominal.yaml
effects:
- name: support_friction
  parameters: {scale: {estimate: 1.6, unit: '-', ci95: [1.5, 1.7]}}
"""
WORDS_OF_YAML = (
    *("null", "true", "-1", "0", "1e400", ".inf", ".nan", "1e-320", "9" * 5000, "0x" + "f" * 4000, "2026-13-45", "~"),
    *("!!int abc", "!!bool maybe", "!!binary x", "!!python/object:os.system {}", "!!set {a}", "? [a, b]", "12:30:45"),
    *("[]", "{}", "[[[[]]]]", "''", "'\\0'", '"\\ud800"', "../../x", ".hidden", "<script>x</script>", "<<: {a: 1}"),
    *("x" * 10_000, "[" * 3000, "{a: " * 500, "&a [x,x,x,x,x,x,x,x]", "*a", "k" * 900, "2026-01-01"),
    *("'1 +'", f"'{'9' * 330} * vy'", f"'{'(' * 199}1{')' * 199}'", "'vy ** 9 ** 9'"),
)


def shipped(path: str) -> str:
    return (config_directory() / path).read_text(encoding="utf-8")


def facts_of(path: Path) -> object:
    load_facts.cache_clear()
    return load_facts(str(path))


def yaml_damage(data: bytes) -> st.SearchStrategy[bytes]:
    text = data.decode()
    return st.one_of(*[edited(text, WORDS_OF_YAML, ":,{")] * 2, flipped(data), spliced(data))


MANIFEST = yaml.safe_dump(make_manifest("push", ["cat_food"], ["case_2"], [1.0], 1).model_dump(mode="json"))
YAML: dict[str, tuple[str, Callable[[Path], object]]] = {
    "model.yaml": (MODEL, lambda path: load_model(str(path))),
    "formulas.yaml": (FORMULAS, lambda path: load_formulas(str(path))),
    "experiment.yaml": ("scenario: push\nmapping: impact_rs\nruns: runs.csv\n", load_experiment),
    "manifest.yaml": (MANIFEST, lambda path: load(Manifest, str(path))),
    "mapping.yaml": (shipped("mappings/joint_state.yaml"), load_mapping),
    "robot.yaml": (shipped("robots/ur5e.yaml"), facts_of),
    "scenario.yaml": (shipped("scenarios/push.yaml"), lambda path: load_scenario(str(path))),
}
for name, (text, reader) in YAML.items():
    write = lambda path, text=text: path.write_text(text, encoding="utf-8")  # noqa: E731
    FILES[name] = Reader(write, lambda path, reader=reader: reader(path) is not None, yaml_damage, 40)


@TIERS
@pytest.mark.parametrize("name", FILES)
def test_a_damaged_file_is_read_as_it_was_or_refused_in_one_line(name: str, part: int, tmp_path: Path) -> None:
    """Kills: an error of a library that gets through, a row or a change of numbers lost in silence, a file left."""
    file, reader, counted = tmp_path / name, FILES[name], iter(range(10_000))
    reader.write(file)
    assert reader.read(file)  # what is damaged is read as it stands
    held(reader, lambda: tmp_path / f"{next(counted)} {name}", reader.change(file.read_bytes()), part)


def held(reader: Reader, place: Callable[[], Path], change: st.SearchStrategy[bytes], part: int) -> None:
    """Every damaged content is written to a place and read; some readers remember files, so that it is a new one."""

    @repeatable(reader.examples // part)
    @given(change)
    def check(content: bytes) -> None:
        file = place()
        file.write_bytes(content)
        before = listing(file.parent)
        try:
            assert reader.read(file)
        except (InputError, BagError) as error:
            assert "\n" not in str(error) and len(str(error)) <= LONGEST
            assert str(file) in str(error) or str(file.parent) in str(error)
        assert listing(file.parent) == before
        file.unlink()

    check()


# ---- bags -----------------------------------------------------------------------------------------------------------


def numbers(path: Path) -> str:
    """Digest of all that an analysis can read of a bag."""
    bag = TrialBag.open(path)
    found = [repr((bag.info, sorted(bag.metadata.items()), sorted(bag.counts.items(), key=str), bag.reason))]
    for topic in sorted(topics.recorded(list(bag.info.robots))):
        found.append(hashlib.sha256(b"".join(bag.serialized(topic))).hexdigest())
    for arm in bag.info.robots:
        found.append(repr((bag.controller(arm).twist.tobytes(), bag.impact_time(arm))))
    return hashlib.sha256("".join(found).encode()).hexdigest()


def bag_damage(file: Path) -> st.SearchStrategy[bytes]:
    """Damage anywhere, and more of it at both ends, where the frame of the messages is; in YAML that of lines too."""
    data = file.read_bytes()
    if file.suffix == ".yaml":
        words = ("null", "[]", "-1", "1e999", "'OK'", "{a: b}", "*a", "9" * 50, "")
        return st.one_of(damaged(data), edited(data.decode(), words, ":"))
    return st.one_of(damaged(data), flipped(data, 0, 200), flipped(data, len(data) - 9000))


@TIERS
@pytest.mark.parametrize("suffix", [".mcap", ".yaml"])
def test_a_damaged_bag_is_refused_or_has_the_same_numbers(
    push_campaign: Path, suffix: str, part: int, tmp_path: Path
) -> None:
    bag = Path(shutil.copytree(push_campaign / BAG, tmp_path / "bag"))
    whole = numbers(bag)
    assert TrialBag.open(bag).sealed
    (file,) = bag.glob(f"*{suffix}")
    reader = Reader(lambda path: None, lambda path: numbers(path.parent) == whole, damaged, 40)
    held(reader, lambda: file, bag_damage(file), part)


# ---- trials that arrive while they are followed ---------------------------------------------------------------------


@pytest.fixture(scope="module")
def live(hidden_campaign: Path, tmp_path_factory: pytest.TempPathFactory) -> Live:
    return Live.of_campaign(hidden_campaign, tmp_path_factory.mktemp("live") / "runs")


@TIERS
def test_a_damaged_trial_is_a_hit_or_refused_with_its_reason_and_the_follower_goes_on(live: Live, part: int) -> None:
    @repeatable(24 // part)
    @given(DAMAGES)
    def check(damage: Damage) -> None:
        name = live.add(lambda messages: damaged_messages(messages, damage))
        hits, refused = live.taken()
        assert [*hits, *refused] == [name]
        assert all(reason and "\n" not in reason for reason in refused.values())
        # None like a hit that ends early, which was seen once.
        json.dumps(dict(live.reports.prediction()), allow_nan=False)
        assert all(np.isfinite(one.estimate) for one in live.follower.followed())

    check()


REFUSED = [  # and the words that its reason has: topic, what is wrong, when
    (Damage("names", JOINTS, 0.5, "position", 0.0), ("/arm/joint_states", "joints", "t = 0.9")),
    (Damage("swapped names", MOTORS, 0.5, "position", 0.0), ("/arm/motor_states", "order", "t = 0.9")),
    (Damage("same stamp", JOINTS, 0.5, "position", 0.0), ("/arm/joint_states", "backwards", "t = 0.9")),
    (Damage("same stamp", MOTORS, 0.5, "position", 0.0), ("stamps", "t = 0.9")),
    (Damage("backwards", POSE, 0.5, "position", 0.0), ("/object/pose", "backwards", "t = ")),
    (Damage("number", JOINTS, 0.5, "velocity", np.nan), ("velocity", "finite", "t = 0.9")),
    (Damage("lost topic", MOTORS, 0.5, "position", 0.0), ("/arm/motor_states",)),
    (Damage("cut", JOINTS, 0.3, "position", 0.0), ("hits nothing",)),
]


def reversed_joints(messages: Messages) -> Messages:
    """The same order in all messages, as another program may name them."""
    for topic, _, message in messages:
        if topic in (JOINTS, MOTORS):
            message.name = message.name[::-1]
    return messages


def test_trials_that_would_be_misread_are_refused_with_place_and_time_and_a_sound_one_after_them_is_a_hit(
    live: Live,
) -> None:
    changes = [(lambda messages, own=damage: damaged_messages(messages, own), words) for damage, words in REFUSED]
    for change, words in [*changes, (reversed_joints, ("joints in the order", "arm_"))]:
        name = live.add(change)
        hits, refused = live.taken()
        assert not hits and all(word in refused[name] for word in words), (refused, words)
    name = live.add(lambda messages: messages)
    assert live.taken() == ([name], {})


def test_repeats_of_one_condition_with_and_without_the_object_are_hits_alike(live: Live) -> None:
    """Sensitivities of the one are not those of the other: they have other features."""
    for lost in (True, True, True, False):
        name = live.add(lambda messages, lost=lost: [one for one in messages if not lost or one[0] != POSE])  # type: ignore[misc]
        assert live.taken() == ([name], {})


# ---- command lines --------------------------------------------------------------------------------------------------

SHAPES = (  # what a command expects; words in capitals are drawn
    *("map NAME WORD WORD", "map NAME --impacts FILE", "trial FILE WORD WORD -o OUT", "campaign FILE -o OUT"),
    *("analyze FILE", "analyze FILE -o OUT --json", "show FILE -o OUT", "export FILE -o OUT"),
    *("compare FILE --model FILE", "diagnose FILE -o OUT --model FILE", "add WORD --from FILE -o OUT", "effects"),
    *("history FILE --runs FILE", "blind score FILE --diagnosis FILE", "friction FILE WORD WORD -o OUT"),
    *("paper --samples WORD", "WORD FILE", "robot import FILE -o OUT", "robot check FILE", "scenario new FILE -o OUT"),
)
NAMES = ("push", "grab", "excite", "franka_fer", "nominal", "joint_state")
WORDS = (
    *("cat_food", "1", "case_9", "-1", "0", "nan", "1e400", "inf", "9" * 5000, "x" * 5000, "", "a=b", "ä", "=", "k=["),
    *("control.clamp_force=[[[[", "..", "\udcff", "\x1b[31m", "--", "-", "@file", "%s", "{}", "null", "--nonsense"),
    *("no/such/file.yaml", "s3:/", "memory://nowhere", "nope://x", "file://", "1e-320", "--json", "--jobs", "--help"),
)


@pytest.fixture(scope="module")
def files(push_campaign: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Files and folders of every kind, good and damaged."""
    folder = tmp_path_factory.mktemp("wrong") / "files"
    bag = shutil.copytree(push_campaign / BAG, folder / "runs" / BAG)
    (whole,) = shutil.copytree(bag, folder / "damaged").glob("*.mcap")
    whole.write_bytes(whole.read_bytes()[:-100])
    noise = random.Random(5)
    contents = {
        "push.yaml": shipped("scenarios/push.yaml").replace("mass", "mas", 1).encode(),
        "cut.yaml": shipped("scenarios/grab.yaml").encode()[:900],
        "model.yaml": shipped("models/nominal.yaml").encode(),
        "list.yaml": b"[1, 2]",
        "alias.yaml": b"a: &a [1]\nb: *a\n",
        "deep.json": b"[" * 100_000,
        "other.json": b'{"format": 99}',
        "digits.json": b'{"format": ' + b"9" * 5000 + b"}",
        "table.csv": b"a,b\n1,2\n3\n",
        "empty.csv": b"",
        "robot.urdf": b"<robot name='x'><link name='a'/></robot>",
        "open.urdf": b"<robot><link",
        "entities.urdf": b"<!DOCTYPE r [<!ENTITY a 'aaaa'><!ENTITY b '&a;&a;&a;'>]><robot name='&b;'/>",
        **{f"noise.{kind}": noise.randbytes(500) for kind in ("yaml", "json", "parquet", "npz", "h5", "mcap", "db3")},
    }
    for name, content in contents.items():
        (folder / name).write_bytes(content)
    (folder / "empty").mkdir()
    (folder / "loop").symlink_to("loop")
    return folder


@contextlib.contextmanager
def elsewhere(folder: Path) -> Iterator[None]:
    """An empty working directory with a cache of its own, on one core: worker processes take seconds to start."""
    cores = os.sched_getaffinity(0)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder / "empty")
        patch.setenv("XDG_CACHE_HOME", str(folder.parent / "cache"))
        os.sched_setaffinity(0, {min(cores)})
        try:
            yield
        finally:
            os.sched_setaffinity(0, cores)


@TIERS
def test_a_wrong_command_line_ends_with_a_code_and_a_reason_and_leaves_nothing(files: Path, part: int) -> None:
    """Kills: a command that is refused after it has begun to write."""
    out = files.parent / "out"
    known = [str(path) for path in sorted(files.iterdir())] + ["/dev/null", str(files / "none")]
    drawn = {
        "FILE": st.sampled_from([*known, *WORDS]),
        "NAME": st.sampled_from([*NAMES, *known]),
        "WORD": st.sampled_from(WORDS),
        "OUT": st.sampled_from([str(out / f"x{end}") for end in ("", ".yaml", ".json", ".h5", ".parquet")]),
    }
    lines = st.sampled_from(SHAPES).flatmap(
        lambda shape: st.tuples(*(drawn.get(word, st.just(word)) for word in shape.split()))
    )
    before = listing(files)

    @repeatable(180 // part)
    @given(lines, st.lists(st.sampled_from((*WORDS, *known)), max_size=2))
    def check(line: tuple[str, ...], more: list[str]) -> None:
        output, error = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(output), contextlib.redirect_stderr(error):
            code = main([*line, *more])
        said = error.getvalue()
        assert code in (0, 1, 2)
        assert code != 2 or (said.strip() and not out.exists())
        assert "Traceback" not in said
        assert all(len(one) <= LONGEST for one in said.splitlines())
        assert listing(files) == before  # all that is written is the output that the line names
        shutil.rmtree(out, ignore_errors=True)

    with elsewhere(files):
        check()
