# SPDX-License-Identifier: Apache-2.0
"""Make a folder of bags as a laboratory with its own topics, names and clocks records them.

./run python examples/laboratory.py [FOLDER] [--hide EFFECT VALUE ...]       (--hide object_mass 1.15 for example)
"""

import argparse
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer

from impact_rs_control.closed_loop import Tick, make_plant, run_closed_loop
from impact_rs_sim.effects import library
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_trials.bags.types import typestore
from impact_rs_trials.spec import TrialSpec

EXPERIMENT = "scenario: push\nmapping: joint_state_effort_controller\nruns: runs.csv\n"
TRIALS = [("push", name, case) for name in ("parcel", "juice") for case in ("case_1", "case_2")]
TRIALS += [("excite", "none", case) for case in ("slow", "fast")]
START, ORDER = 1_763_500_000, [2, 0, 1, 3, 4, 5, 6]  # s, of the wall clock; joints as the driver has them
STORE = typestore()
MAKE = {name.split("/")[-1]: kind for name, kind in STORE.types.items()}


def messages(tick: Tick) -> Iterator[tuple[str, int, object]]:
    """Topic, delay of the log [ns] and message of each recording; joints are out of order, and poses come late."""
    header = MAKE["Header"](MAKE["Time"](START + tick.number // 1000, tick.number % 1000 * 1_000_000), "world")
    arm, tracked, names = tick.measurement.arms["arm"], tick.measurement.object, [f"panda_joint{n + 1}" for n in ORDER]
    numbers = (values[ORDER] for values in (arm.position, arm.velocity, arm.torque))
    yield "/joint_states", 200_000, MAKE["JointState"](header, names, *numbers)
    layout = MAKE["MultiArrayLayout"]([], 0)
    yield "/effort_controller/commands", 350_000, MAKE["Float64MultiArray"](layout, tick.commands["arm"].torque)
    if tracked is not None:
        pose = MAKE["Pose"](MAKE["Point"](*tracked.position), MAKE["Quaternion"](*tracked.quaternion))
        yield "/mocap/box/pose", 4_200_000, MAKE["PoseStamped"](header, pose)


def record(path: Path, trial: tuple[str, str, str], hide: list[str], seed: int) -> None:
    """Run a trial of scenario, object and case, and write its bag."""
    plan = TrialSpec.of(load_scenario(trial[0]), *trial[1:]).plan
    values = np.array(hide[1:], dtype=float)
    plant = make_plant(plan, seed, library()[hide[0]].apply_vector(plan.scene.physics, values) if hide else None)
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        topics = {}
        for tick in run_closed_loop(plan, plant):
            for topic, late, message in messages(tick):
                if topic not in topics:
                    topics[topic] = bag.add_connection(topic, message.__msgtype__, typestore=STORE)
                log = START * 10**9 + tick.number * 1_000_000 + late
                bag.write(topics[topic], log, STORE.serialize_cdr(message, message.__msgtype__))
    plant.close()


def main(folder: Path, hide: list[str], trials: list[tuple[str, str, str]] = TRIALS, repeats: int = 2) -> None:
    """Record trials, with experiment file and table of runs beside them."""
    if folder.exists() and any(folder.iterdir()):
        raise SystemExit(f"{folder}: this folder is not empty; name a new one")
    table = ["bag,object,kind,condition"]
    for number, trial in enumerate(trials * repeats, start=1):
        record(folder / f"run_{number:02d}", trial, hide, number)
        table.append(f"run_{number:02d},{trial[1]},{'hit' if trial[0] == 'push' else 'free motion'},{trial[2]}")
        print(table[-1])
    (folder / "runs.csv").write_text("\n".join(table) + "\n")
    (folder / "experiment.yaml").write_text(EXPERIMENT)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", nargs="?", type=Path, default=Path("campaigns/laboratory"), help="a new folder")
    parser.add_argument("--hide", nargs="+", default=[], metavar="", help="effect that the robot has, and its values")
    main(**vars(parser.parse_args()))
