# SPDX-License-Identifier: Apache-2.0
"""Blind campaigns with everything taken away that another laboratory would not have, diagnosed once more.

    ./run python -m benchmarks.stripped BOARD -o DIR [--only NAME ...] [--jobs 2]

BOARD is a folder of :mod:`benchmarks.blind`: campaigns with truth, runs and the diagnosis of the full bags; it is only
read. Of every campaign DIR gets a folder of bags with position, velocity and joint torque, commands without a stamp,
and the pose of the object, joints out of order and on a wall clock; no truth, no motor, no references, no trial info.
Verdicts are scored as those of the full bags are. It resumes where it stopped.
"""

from __future__ import annotations

import argparse
import csv
import json
import math
import shutil
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table
from rosbags.rosbag2 import StoragePlugin, Writer

from benchmarks.board import diagnosed_laboratory, share
from impact_rs_analysis.diagnosis.document import DiagnosisDocument, read_document
from impact_rs_analysis.diagnosis.scoring import held_against_truth
from impact_rs_sim.robot import Array
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.reader import TrialBag
from impact_rs_trials.bags.types import typestore
from impact_rs_trials.blind import RUNS, TRUTH
from impact_rs_trials.workers import Map, Workforce, workers

EXPERIMENT = "scenario: push\nmapping: joint_state_effort_controller\nruns: runs.csv\n"
START = 1_763_500_000 * 10**9  # ns, of the wall clock at the begin of every run
ORDER = [2, 0, 1, 3, 4, 5, 6]  # joints as the driver has them
STATE_LATE, COMMAND_LATE, POSE_LATE = 200_000, 350_000, 4_200_000  # ns from stamp to log
SIDES = ("full", "stripped")
STORE = typestore()
MAKE = {name.split("/")[-1]: kind for name, kind in STORE.types.items()}

console = Console(width=150)


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
    seen = bag.poses(topics.OBJECT_POSE)
    rows: Iterator[tuple[float, Array, Array]] = zip(seen.time, seen.position, seen.quaternion, strict=True)
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


@dataclass(frozen=True)
class Side:
    """What was said of one campaign, in full or stripped."""

    verdict: str
    correct: bool
    headline: bool
    also_named: tuple[str, ...]
    covered: tuple[int, int]

    @classmethod
    def of(cls, campaign: Path, document: DiagnosisDocument) -> Side:
        """Score a diagnosis."""
        scored = held_against_truth(campaign, document)
        return cls(document.verdict, scored.correct, scored.headline, scored.also_named, scored.covered)

    def __str__(self) -> str:
        return f"{self.verdict} {'right' if self.correct else 'WRONG'}"


@dataclass(frozen=True)
class Pair:
    """One campaign, in full and stripped."""

    name: str
    truth: str
    full: Side
    stripped: Side
    seconds: float


def compare(campaign: Path, output: Path, map_tasks: Map) -> Pair:
    """Strip and diagnose one campaign, and hold both diagnoses against its truth; what was diagnosed is kept."""
    folder = output / campaign.name
    document, began = folder / "diagnosis.json", time.perf_counter()
    strip_campaign(campaign, folder)
    stripped = diagnosed_laboratory(folder.absolute(), document, map_tasks)
    seconds = time.perf_counter() - began
    truth = json.loads((campaign / TRUTH).read_text(encoding="utf-8"))
    hidden = "+".join(item["name"] for item in truth["effects"]) or truth["outside"] or "nothing"
    full = read_document(campaign / "diagnosis.json")
    return Pair(campaign.name, hidden, Side.of(campaign, full), Side.of(campaign, stripped), seconds)


def table_of(pairs: Sequence[Pair]) -> Table:
    """Campaigns, and the shares below them."""
    table = Table("campaign", "hidden", "full bags", "stripped")
    for pair in pairs:
        table.add_row(pair.name, pair.truth, str(pair.full), str(pair.stripped))
    table.add_section()
    for label, value in (
        ("right", lambda side: side.correct),
        ("headline is the truth alone", lambda side: side.headline),
        ("something named that is not there", lambda side: bool(side.also_named)),
    ):
        table.add_row(label, "", *(share([value(getattr(pair, side)) for pair in pairs]) for side in SIDES))
    covered = [
        share([number < inside for inside, total in counts for number in range(total)])
        for counts in ([getattr(pair, side).covered for pair in pairs] for side in SIDES)
    ]
    table.add_row("true parameters in their intervals", "", *covered)
    table.add_row("same verdict", "", "", share([pair.full.verdict == pair.stripped.verdict for pair in pairs]))
    return table


def main() -> None:
    """Run what is missing, then print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("board", type=Path, help="folder of campaigns of benchmarks.blind, only read")
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder of what is made")
    parser.add_argument("--only", nargs="+", default=[""], help="campaigns whose name starts with one of these")
    parser.add_argument("--jobs", type=int, default=2, help="worker processes")
    parser.add_argument("--seconds", type=float, default=math.inf, help="start no further campaign after this time [s]")
    arguments = parser.parse_args()
    known = sorted(path.parent for path in arguments.board.glob("*/diagnosis.json"))
    wanted = [path for path in known if path.name.startswith(tuple(arguments.only))]
    pairs, began = [], time.monotonic()
    with workers(Workforce(arguments.jobs)) as map_tasks:
        for number, campaign in enumerate(wanted, start=1):
            done = (arguments.output / campaign.name / "diagnosis.json").exists()
            if not done and time.monotonic() - began > arguments.seconds:
                continue
            pair = compare(campaign, arguments.output, map_tasks)
            pairs.append(pair)
            console.print(
                rf"\[{number}/{len(wanted)}] {pair.name}: {pair.full} | {pair.stripped}, {pair.seconds:.0f} s"
            )
    console.print(table_of(pairs))
    if pairs:
        rows = json.dumps([asdict(pair) for pair in pairs], indent=2)
        (arguments.output / "stripped.json").write_text(rows + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
