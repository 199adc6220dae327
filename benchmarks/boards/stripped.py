# SPDX-License-Identifier: Apache-2.0
"""Blind campaigns with everything taken away that another laboratory would not have, diagnosed once more.

``--board BOARD`` is the folder of the board ``blind``: campaigns with truth, runs and the diagnosis of the full bags;
it is only read. Of every campaign a folder of bags is made with position, velocity and joint torque, commands without a
stamp, and the pose of the object, joints out of order and on a wall clock; no truth, no motor, no references, no trial
info.
"""

from __future__ import annotations

import argparse
import csv
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from rosbags.rosbag2 import StoragePlugin, Writer

from benchmarks.harness import Case, Row, Work
from benchmarks.hidden import judged, laboratory_runs, table_of_diagnoses, timed_diagnosis
from benchmarks.results import Table
from impact_rs_analysis.diagnosis.document import read_document
from impact_rs_sim.robots.robot import Array
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.reader import TrialBag
from impact_rs_trials.bags.types import typestore
from impact_rs_trials.blind import RUNS

EXPERIMENT = "scenario: push\nmapping: joint_state_effort_controller\nruns: runs.csv\n"
START = 1_763_500_000 * 10**9  # ns, of the wall clock at the begin of every run
ORDER = [2, 0, 1, 3, 4, 5, 6]  # joints as the driver has them
STATE_LATE, COMMAND_LATE, POSE_LATE = 200_000, 350_000, 4_200_000  # ns from stamp to log
STORE = typestore()
MAKE = {name.split("/")[-1]: kind for name, kind in STORE.types.items()}


def messages(bag: TrialBag, arm: str, hit: bool) -> Iterator[tuple[int, str, Any]]:
    """Log time since the start [ns], topic and message of all that is left of a trial."""

    def header(moment: float) -> Any:
        stamp = START + round(1e9 * moment)
        return MAKE["Header"](MAKE["Time"](stamp // 10**9, stamp % 10**9), "world")

    names = [f"panda_joint{joint + 1}" for joint in ORDER]
    measured = bag.joints(topics.joint_states(arm))
    rows = zip(measured.time, measured.position, measured.velocity, measured.effort, strict=True)
    for moment, *signals in rows:
        state = MAKE["JointState"](header(moment), names, *(values[ORDER] for values in signals))
        yield round(1e9 * moment) + STATE_LATE, "/joint_states", state
    commanded = bag.joints(topics.joint_command(arm))
    for moment, torque in zip(commanded.time, commanded.effort, strict=True):
        command = MAKE["Float64MultiArray"](MAKE["MultiArrayLayout"]([], 0), torque)
        yield round(1e9 * moment) + COMMAND_LATE, "/effort_controller/commands", command
    for moment, pose in _poses(bag) if hit else ():
        stamped = MAKE["PoseStamped"](header(moment), pose)
        yield round(1e9 * moment) + POSE_LATE, "/mocap/box/pose", stamped


def _poses(bag: TrialBag) -> Iterator[tuple[float, Any]]:
    """Stamp [s] and pose of the object; none where nothing was tracked."""
    if not bag.counts.get(topics.OBJECT_POSE):
        return
    poses = bag.poses(topics.OBJECT_POSE)
    rows: Iterator[tuple[float, Array, Array]] = zip(poses.time, poses.position, poses.quaternion, strict=True)
    for moment, position, quaternion in rows:
        yield moment, MAKE["Pose"](MAKE["Point"](*position), MAKE["Quaternion"](*quaternion))


def strip_trial(source: Path, target: Path) -> tuple[str, str, str]:
    """Write what is left of the bag of a trial; object, kind and condition for the table of runs."""
    bag = TrialBag.open(source)
    (arm,) = bag.info.robots
    spec = bag.info.spec
    hit = spec.scenario.excursion is None
    with Writer(target, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections: dict[str, Any] = {}
        for log, topic, message in sorted(messages(bag, arm, hit), key=lambda item: item[0]):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, message.__msgtype__, typestore=STORE)
            writer.write(connections[topic], START + log, STORE.serialize_cdr(message, message.__msgtype__))
    return spec.object if hit else "none", "hit" if hit else "free motion", spec.case


def strip_campaign(campaign: Path, folder: Path) -> None:
    """Write the laboratory's folder of a campaign; what is complete is kept."""
    if (folder / "experiment.yaml").exists():
        return
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    bags = sorted(file.parent for file in (campaign / RUNS).rglob("metadata.yaml"))
    names = [f"run_{number:02d}" for number in range(1, len(bags) + 1)]
    rows = [strip_trial(bag, folder / name) for name, bag in zip(names, bags, strict=True)]
    with (folder / "runs.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(("bag", "object", "kind", "condition"))
        writer.writerows((name, *row) for name, row in zip(names, rows, strict=True))
    (folder / "experiment.yaml").write_text(EXPERIMENT, encoding="utf-8")


def add_options(parser: argparse.ArgumentParser) -> None:
    """Where the campaigns are."""
    parser.add_argument("--board", type=Path, required=True, help="output folder of the board blind, only read")


def cases(options: argparse.Namespace) -> list[Case]:
    """Every campaign that was diagnosed."""
    return [Case(path.parent.name, path.parent) for path in sorted(options.board.glob("*/diagnosis.json"))]


def run(case: Case, work: Work) -> Row:
    """Strip and diagnose one campaign, and hold both diagnoses against its truth."""
    folder = work.folder.absolute() / "stripped"
    strip_campaign(case.inputs, folder)
    document = work.folder / "diagnosis.json"
    stripped = timed_diagnosis(document, case.inputs, lambda: laboratory_runs(folder, work.map_tasks), work.map_tasks)
    full = judged(case.inputs, read_document(case.inputs / "diagnosis.json"))
    return {"full": full, "stripped": stripped, "said": f"{full['said']} | {stripped['said']}"}


def table(rows: list[Row], options: argparse.Namespace) -> Table:
    """Shares of right diagnoses, full bags beside stripped ones."""
    del options
    full, stripped = (
        table_of_diagnoses([row[side] for row in rows], heading)
        for side, heading in (("full", "full bags"), ("stripped", "stripped"))
    )
    return full.with_(stripped)
