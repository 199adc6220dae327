# SPDX-License-Identifier: Apache-2.0
"""Options that several commands have."""

from __future__ import annotations

from typing import Any

from impact_rs_commands.declaration import Option, argument, option

RUNS_TEXT = "folder with bags of trials, searched with its subfolders, or URL"
SCENARIO_TEXT = "name of a scenario, or path of its YAML file"

SCENARIO = argument("scenario", SCENARIO_TEXT, kind="scenario", metavar="SCENARIO")
OBJECT = argument("object", "name of an object of the scenario", kind="object", metavar="OBJECT")
CASE = argument("case", "name of a case of the scenario; 2 is short for case_2", kind="case", metavar="CASE")
OBJECTS = option("--objects", kind="object", many=True, metavar="NAME", help="objects", otherwise="all of the scenario")
CASES = option("--cases", kind="case", many=True, metavar="NAME", help="cases", otherwise="all of the scenario")
SEED = option("--seed", kind="whole", default=0, least=0, metavar="N", help="seed of scatter and noise")
REFLEXES = (  # thresholds at which a robot stops by itself
    option(
        "--reflex-torque", kind="number", least=0.0, metavar="NM", unit="N m",
        help="external torque at which a joint stops the robot", label="reflex at a joint torque of",
        otherwise="as in the robot facts",
    ),
    option(
        "--reflex-force", kind="number", least=0.0, metavar="N", unit="N",
        help="external force at the end effector at which the robot stops itself", label="reflex at a force of",
        otherwise="that of the robot facts",
    ),
)  # fmt: skip
JSON = option("--json", kind="json", help="print one JSON document on standard output, nothing else")
MODEL = option(
    "--model", kind="model", default="nominal", metavar="FILE", help="model file", otherwise="the nominal model"
)
RUNS = argument(
    "runs", f"{RUNS_TEXT}; leave it out with --impacts", kind="runs", url=True, required=False, metavar="RUNS",
    label="measurements",
)  # fmt: skip
NAMESPACE = option(
    "--namespace", kind="name", default="", metavar="NAME", label="ROS namespace", advanced=True, otherwise="none",
    help="ROS namespace of the nodes; lets several sets of nodes run side by side",
)  # fmt: skip
WITHOUT = option(
    "--without", kind="name", many=True, default=(), metavar="NODE", label="without nodes", advanced=True,
    help="nodes that are not started because you provide them; the command waits for yours",
)  # fmt: skip
SETTINGS = option(
    "--set", name="settings", kind="setting", many=True, default=(), metavar="KEY=VALUE", advanced=True,
    label="scenario settings",
    help="override values of the scenario, for example control.clamp_force=90",
)  # fmt: skip
PLANT = option(
    "--plant", choices=("bullet", "twin"), default="bullet", label="simulator of the plant", advanced=True,
    help="what moves the plant: Bullet, or the compiled twin, which takes a third of the time (and which diagnose "
    "replays with: it would look at itself)",
)  # fmt: skip
NO_BROWSER = option("--no-browser", kind="switch", help="only print the address")
JOBS = (
    option(
        "--jobs", kind="whole", least=1, metavar="N", label="workers", advanced=True, otherwise="one per core",
        help="worker processes, and threads that replay trials",
    ),
    option(
        "--scheduler", kind="address", metavar="ADDRESS", label="dask scheduler", advanced=True,
        help="run on the workers of a running dask scheduler instead (tcp://host:port)",
    ),
)  # fmt: skip
SOURCE = (
    option(
        "--mapping", kind="mapping", metavar="NAME", label="mapping of a recording", advanced=True,
        otherwise="joint_state",
        help="RUNS is a recording of a real robot in free motion (.db3, .mcap, .bag, .csv, .npz, or a folder of them): "
        "name of a mapping (joint_state, franka_robot_state), or path of a mapping file",
    ),
    option(
        "--minus", kind="runs", metavar="UNLOADED", label="subtract recordings", advanced=True,
        help="RUNS are recordings of free motion: subtract those of the same motions in this file or folder, for "
        "example without a load; friction and errors of the model cancel, and a payload remains. The order without, "
        "with, with, without cancels a drift",
    ),
    option(
        "--experiment", kind="experiment", metavar="FILE.yaml", label="experiment file", advanced=True,
        help="RUNS is a folder of runs recorded with another controller: experiment file with scenario, mapping and "
        "table of runs (docs/files.md); path relative to the working directory, else to RUNS",
        otherwise="experiment.yaml in RUNS, if there is one",
    ),
    option(
        "--impacts", kind="file", metavar="TABLE", label="table of impacts", advanced=True,
        help="instead of RUNS: a table (.csv, .parquet) with one row per impact, of one free body on a plane or of an "
        "arm and an object; a column header is name and unit, for example 'vx_before [m/s]' (docs/files.md)",
    ),
    option(
        "--scenario", kind="scenario", metavar="NAME", label="scenario of the table", advanced=True,
        help="with --impacts: scenario (name or file) whose robots, pads and support the rows refer to; without it "
        "each row is one free body that hits a fixed plane",
    ),
    option(
        "--contact-tolerance", kind="number", metavar="M", unit="m", label="contact tolerance", advanced=True,
        otherwise="0.001",
        help="with --impacts: points touch that are no more than this further off than the nearest",
    ),
    option(
        "--covariates", kind="text", many=True, default=(), metavar="COLUMN", label="circumstances of the rows",
        advanced=True, otherwise="none",
        help="with --impacts: columns with circumstances of the measurement, for example session or "
        "temperature; diagnose says whether an effect depends on them (numbers: linearly, words: level by level)",
    ),
    option(
        "--since", kind="text", metavar="WHEN", label="only measurements since", advanced=True, otherwise="all",
        help="only trials, or rows of a table, that were measured from then on: the name of a trial or row, or a time",
    ),
    option(
        "--calibration", kind="file", metavar="FILE.yaml", label="calibration of the readings", advanced=True,
        otherwise="calibration.yaml in the folder of the measurements, if there is one",
        help="faults of the readings, which are predicted with every model: a file as that of a model, with effects of "
        "the measurement alone (docs/measurement.md); nominal: none",
    ),
    option(
        "--no-discrepancy", kind="switch", label="assume an exact simulation", advanced=True,
        help="assume that the simulation is exact: ignore the model discrepancy between simulators "
        "(config/discrepancy.yaml), or of the impact map (config/map_discrepancy.yaml)",
    ),
)  # fmt: skip


def contact(help: str) -> Option:
    """The option ``--contact``; ``help`` describes its effect."""
    return option("--contact", choices=("first", "settled"), default="first", help=help, advanced=True)


def output(kind: Any, help: str, metavar: str = "DIR", **more: Any) -> Option:
    """The option ``-o``, also spelled ``--output``."""
    return option("-o", "--output", kind=kind, help=help, metavar=metavar, **more)


def optional(required: Option) -> Option:
    """A copy of an option that may be omitted."""
    return required._replace(required=False)
