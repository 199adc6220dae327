# SPDX-License-Identifier: Apache-2.0
"""The manual is right: links and anchors resolve, commands and options exist, tables of keys are those of the code."""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
from collections.abc import Iterator
from fractions import Fraction
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pinocchio as pin
import pytest
import yaml
from joint_recordings import swinging

from impact_rs_analysis.evidence.free_motion.torque_balance import TorqueBalance, prepare
from impact_rs_cli.main import parser
from impact_rs_commands import COMMANDS
from impact_rs_sim.effects.formula import CONTACT_SYMBOLS, FUNCTIONS, LAG, SYMBOLS, Formula, FormulaFile, FormulaSpec
from impact_rs_sim.model import Model
from impact_rs_sim.paths import config_directory
from impact_rs_sim.robots.robot import RobotFacts
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_sim.scenarios.scenario_docs import _key
from impact_rs_sim.schema import Schema
from impact_rs_trials.blind import draw_truth
from impact_rs_trials.recordings.experiment import COLUMNS, SESSION, Experiment
from impact_rs_trials.recordings.file_units import UNITS
from impact_rs_trials.recordings.mapping import QUANTITY, Mapping, SignalName, SignalSource, load_mapping
from impact_rs_trials.recordings.recording import ARM, read_recordings
from tools import manual

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", *sorted(DOCS.glob("*.md"))]
SCHEMAS: dict[str, type[Schema]] = {
    "experiment": Experiment,
    "mapping": Mapping,
    "signal": SignalSource,
    "formula": FormulaSpec,
    "model": Model,
    "robot": RobotFacts,
}
ELSEWHERE = {"mapping": "signals.NAME", "model": "formulas[N]", "signal": "table"}  # sections that another table has
CODE = re.compile(r"^```.*?^```$|^(?: {4,}\S.*\n?)+", re.MULTILINE | re.DOTALL)


@cache
def text(page: Path) -> str:
    """A page."""
    return page.read_text(encoding="utf-8")


@cache
def anchors(page: Path) -> set[str]:
    """Names of its headings, as GitHub and the workbench make them."""
    headings = re.findall(r"^#+ (.+)$", re.sub(r"^```.*?^```$", "", text(page), flags=re.M | re.S), re.MULTILINE)
    return {re.sub(r"[^\w -]", "", re.sub(r"[`*]", "", heading).lower()).replace(" ", "-") for heading in headings}


def table(page: str, head: str) -> list[list[str]]:
    """Cells of the rows below the header that begins with a column."""
    after = text(DOCS / page).split(f"\n| {head} |")
    assert len(after) == 2, f"{page}: expected one table {head!r}"
    rows = after[1].split("\n\n")[0].splitlines()[2:]
    return [[cell.strip() for cell in re.split(r"(?<!\\)\|", row.strip().strip("|"))] for row in rows]


def keys(schema: type[Schema], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Dotted names of all keys, ``NAME`` for a name that a user chooses, and their fields."""
    for name, field in schema.model_fields.items():
        key, below = _key(name, field.annotation)
        if below is None:
            yield f"{prefix}{name}", field
        else:
            yield from keys(below, f"{prefix}{key}.")


def commands() -> list[tuple[str, str]]:
    """Every command line of the program in the manual, with its page."""
    found = []
    for page in PAGES:
        joined = text(page).replace("\\\n", " ")
        blocks = "\n".join(CODE.findall(joined))
        lines = re.findall(r"^ *(?:\$ )?(?:\./run )?impact-rs (.+)$", blocks, re.MULTILINE)
        lines += re.findall(r"`\./run impact-rs ([^`\n]+)`", joined)
        found += [(page.name, line.strip()) for line in lines if not line.startswith("COMMAND")]
    return found


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_link_and_anchor_resolves(page: Path) -> None:
    broken = []
    for target in re.findall(r"\]\(([^)\s]+)\)", text(page)):
        name, _, anchor = target.partition("#")
        place = (page.parent / name).resolve() if name else page
        if "://" not in target and (not place.exists() or (anchor and anchor not in anchors(place))):
            broken.append(target)
    assert not broken


def test_pages_that_the_code_names_exist() -> None:
    named = set()
    for folder in ("impact_rs_*", "examples", "config", "src", "launch", "test"):
        for path in (path for root in ROOT.glob(folder) for path in root.rglob("*")):
            if path.suffix in (".py", ".js", ".yaml", ".cpp", ".hpp"):
                named |= set(re.findall(r"docs/(\w+\.md)|page: '(\w+\.md)'", path.read_text(encoding="utf-8")))
    assert {name for pair in named for name in pair if name and not (DOCS / name).exists()} == set()


def test_every_command_and_option_is_one_of_the_program(capsys: pytest.CaptureFixture[str]) -> None:
    wrong = []
    for page, line in commands():
        try:
            parser().parse_args(shlex.split(re.sub(r"(?<=--jobs) N|(?<=--port) N", " 1", line), comments=True))
        except SystemExit as stop:
            if stop.code:
                wrong.append(f"{page}: {line}: {capsys.readouterr().err.strip()}")
    assert len(commands()) > 80
    assert not wrong, "\n".join(wrong)


def options(command: str) -> set[str]:
    """Options of a command and of its actions."""
    found = COMMANDS[command]
    return {"--help", *(flag for part in (found, *found.actions) for option in part.options for flag in option.flags)}


def test_options_in_a_sentence_are_those_of_their_command() -> None:
    wrong = {
        f"{page.name}: {command} {option}"
        for page in PAGES
        for command, rest in re.findall(r"`(?:impact-rs )?([a-z]+) ([^`\n]*--[^`\n]*)`", text(page))
        for option in re.findall(r"(?<!\S)--[a-z][a-z-]*", rest)
        if command in COMMANDS and option not in options(command)
    }
    assert not wrong


def test_every_script_and_module_that_a_page_runs_exists() -> None:
    missing = set()
    for page in PAGES:
        for module, script in re.findall(
            r"\./run python (?:-m (benchmarks\.[\w.]+)|(\w+/[\w/]+(?:\.py)?))", text(page)
        ):
            path = ROOT / (script or module.replace(".", "/"))
            if not (path.exists() or path.with_suffix(".py").exists()):
                missing.add(f"{page.name}: {script or module}")
    assert not missing


def test_generated_tables_are_those_of_the_code() -> None:
    """Kills a key, default, option or node parameter that is changed in the code alone."""
    stale = [name for name, made in manual.pages().items() if made != text(DOCS / name)]
    assert stale == [], "run: ./run python -m tools.manual"
    shown = set(re.findall(r"\(table: (\w+)\)", "".join(map(text, PAGES))))
    assert shown == manual.TABLES.keys()


@pytest.mark.parametrize("name", [name for name in manual.TABLES if name != "commands"])
def test_a_generated_table_of_keys_has_every_key_once_with_a_meaning(name: str) -> None:
    """Kills a section that is walked past, one that refers to other keys than its own, and a key without a meaning."""
    schema = SCHEMAS[name]
    rows = [re.split(r" (?<!\\)\| ", line.strip("| ")) for line in manual.TABLES[name]().splitlines()[2:]]
    elsewhere = ELSEWHERE.get(name, "")
    there = [row[0].strip("`") for row in rows if row[1] != "section" or row[2]]
    there = [key for key in there if key != elsewhere]
    for section, first in ((row[0].strip("`"), row[3].partition("eys as of `")[2].strip("`")) for row in rows):
        there += [key.replace(first, section) for key in there if first and key.startswith(f"{first}.")]
    wanted = [key for key, _ in keys(schema) if not elsewhere or not key.startswith(f"{elsewhere}.")]
    assert sorted(there) == sorted(wanted)
    assert [row[0] for row in rows if len(row) != 4 or not row[3]] == []


def test_signals_of_a_mapping_are_those_of_the_code_with_their_units() -> None:
    rows = {name: row for row in table("files.md", "Signal of a mapping") for name in re.findall(r"`(\w+)`", row[0])}
    assert rows.keys() == set(get_args(SignalName))
    for name, row in rows.items():
        assert set(UNITS[QUANTITY[name]]) <= set(re.findall(r"`([^`]+)`", row[2])), name
    assert [row[0].strip("`") for row in table("files.md", "Column of a run")] == [*COLUMNS, SESSION]


def test_symbols_and_functions_of_a_formula_are_those_of_the_code() -> None:
    named = {name for row in table("effects.md", "In a formula") for name in re.findall(r"`(\w+)`", row[0])}
    assert named - {"q1", "q2", "dq1", "dq2", "tau1", "tau2", "pi"} == {
        *FUNCTIONS,
        LAG,
        *SYMBOLS,
        *CONTACT_SYMBOLS,
        "parameters",
    }


def test_the_numbers_of_a_verdict_are_those_of_the_code() -> None:
    """Kills a threshold that is changed in the code alone."""
    rows = table("diagnosis.md", "Name")
    assert len(rows) > 15
    for names, values, _ in rows:
        for name, value in zip(re.findall(r"`([\w.]+)`", names), values.split(", "), strict=True):
            module, _, constant = name.rpartition(".")
            there = import_module(f"impact_rs_analysis.diagnosis.{module or 'thresholds'}")
            assert getattr(there, constant) == pytest.approx(float(Fraction(value))), name


def test_files_that_a_page_shows_are_valid() -> None:
    """The first key of a block of YAML says which file it is."""
    kinds: dict[str, type[Schema]] = {
        "scenario": Experiment,
        "mapping": Experiment,
        "description": Mapping,
        "effects": FormulaFile,
        "name": Model,
    }
    shown = [
        yaml.safe_load(block)
        for page in ("your_data.md", "files.md", "effects.md")
        for block in re.findall(r"^```yaml\n(.*?)^```", text(DOCS / page), re.MULTILINE | re.DOTALL)
    ]
    assert len(shown) >= 4
    for content in shown:
        kinds[next(iter(content))].model_validate(content)


def shown_with(page: str, key: str) -> str:
    """The last block of YAML of a page that begins with a key."""
    *_, found = re.findall(rf"^```yaml\n({key}:.*?)^```", text(DOCS / page), re.MULTILINE | re.DOTALL)
    return str(found)


def test_the_mapping_that_a_page_shows_reads_an_arm_on_a_wall_by_its_motor_currents(tmp_path: Path) -> None:
    """tau = (M + B) ddq + h with gravity along the wall, in degrees, milliseconds and currents of the other sign."""
    shutil.copy(config_directory() / "robots" / "franka_fer.yaml", tmp_path / "my_arm.yaml")
    (tmp_path / "mapping.yaml").write_text(shown_with("files.md", "description"), encoding="utf-8")
    mapping = load_mapping(tmp_path / "mapping.yaml")
    base = pin.SE3(pin.rpy.rpyToMatrix(0.0, 1.5708, 0.0), np.zeros(3))
    time, frequencies = np.arange(0.0, 12.0, 0.01), (0.2 + 0.01 * np.arange(7), 0.5 - 0.02 * np.arange(7))
    centre = np.array([0.0, -0.3, 0.0, -2.0, 0.0, 1.8, 0.5])
    model = RobotModel(mapping.facts, mapping.end_effector.build(), base)
    truth = swinging(model, time, centre, frequencies, (0.3, 0.1))
    acceleration = np.gradient(truth["velocity"], time, axis=0)
    torque = truth["effort"] + np.array([0.6, 0.6, 0.5, 0.5, 0.2, 0.2, 0.2]) * acceleration
    currents = -torque / np.array(mapping.torque_constant)
    columns = (1e3 * time, np.rad2deg(truth["position"]), np.rad2deg(truth["velocity"]), currents)
    names = ["t", *(f"{letter}{joint}" for letter in ("a", "v_", "i_") for joint in range(1, 8))]
    np.savetxt(tmp_path / "log.csv", np.column_stack(columns), delimiter=",", header=",".join(names), comments="")

    (run,) = read_recordings(tmp_path / "log.csv", mapping)
    arm = run.signals.arms[ARM]
    np.testing.assert_allclose(run.signals.time, time, atol=1e-9)
    np.testing.assert_allclose(arm.position, truth["position"], atol=1e-9)
    np.testing.assert_allclose(arm.velocity, truth["velocity"], atol=1e-9)
    np.testing.assert_allclose(arm.torque, torque, atol=1e-9)
    balance = TorqueBalance([prepare(run, mapping.low_pass)], at_motor=True)
    assert np.abs(balance.recorded - balance.predict(run.physics)).max() < 0.03  # N m, where gravity alone makes 60


def test_formulas_that_a_page_shows_are_a_drag_a_pad_and_a_friction() -> None:
    blocks = map(yaml.safe_load, re.findall(r"```yaml\n(.*?)```", text(DOCS / "effects.md"), re.DOTALL))
    drag, pad = (spec for block in blocks if "name" not in block for spec in block.get("effects", []))
    force = Formula(drag["end_effector_force"]["y"], {"drag", "vy"})
    assert force({"drag": 5.0, "vy": -0.4}) == pytest.approx(2.0)  # N, against the motion
    push = Formula(FormulaSpec.model_validate(pad).contact_normal, {"c", "penetration", "closing"})
    assert push({"c": 1e4, "penetration": 0.002, "closing": 0.5}) == pytest.approx(10.0)  # N, apart while they approach
    (sliding,) = set(re.findall(r'"([^"]*tanh[^"]*)"', text(DOCS / "effects.md")))
    friction = Formula(sliding, {"c", "dq2"})
    assert friction({"c": 0.3, "dq2": 0.5}) == pytest.approx(-0.3)  # N m, against the motion
    assert friction({"c": 0.3, "dq2": 0.0}) == 0.0
    assert friction({"c": 0.3, "dq2": -0.02}) == pytest.approx(0.3 * np.tanh(1.0))


def test_every_page_is_in_the_index_and_every_picture_in_a_page() -> None:
    everything = "".join(map(text, PAGES))
    assert [page.name for page in PAGES[1:] if page.name != "README.md" and f"({page.name})" not in everything] == []
    assert [image.name for image in (DOCS / "images").iterdir() if f"images/{image.name})" not in everything] == []
    assert max(image.stat().st_size for image in (DOCS / "images").iterdir()) < 300_000  # bytes


def test_the_effect_that_the_first_hour_hides_and_finds_is_the_one_that_its_seed_hides() -> None:
    page = text(DOCS / "first_hour.md")
    ((hidden, named),) = re.findall(r"hidden (\w+), named (\w+)", page)
    assert [hidden] == [named] == [effect.name for effect in draw_truth(7, "single", None, None)]
    assert f"impact-rs add {hidden} " in page


def test_every_claim_of_the_safety_argument_names_tests_that_exist() -> None:
    """``docs/safety.md``: what can move a robot, and the envelope and questions of an investigation."""
    rows = [row for row in text(DOCS / "safety.md").splitlines() if "`test_" in row]
    there = {
        name
        for file in (ROOT / "test").rglob("test_*.py")
        for name in re.findall(r"^def (test_\w+)\(", file.read_text(), re.MULTILINE)
    }
    named = {name for row in rows for name in re.findall(r"`(test_\w+)`", row)}
    assert len(rows) >= 45
    assert named <= there


def test_what_the_first_hour_writes_into_a_clone_is_ignored_by_git() -> None:
    if not (ROOT / ".git").exists():
        pytest.skip("not a clone")
    lines = re.findall(r"^    \./run impact-rs (.*)$", text(DOCS / "first_hour.md"), re.MULTILINE)
    written = {found for line in lines for found in re.findall(r"(?:-o|--report) (\S+)", line)}
    assert {"trials", "campaigns/quick", "blind_7", "report_1", "diagnosis.json", "model_2.yaml"} <= written
    # A name that ends in a slash is a folder to git, although it is not there.
    paths = [path if Path(path).suffix else f"{path}/" for path in sorted(written)]
    done = subprocess.run(["git", "-C", ROOT, "check-ignore", *paths], capture_output=True, text=True)
    assert done.stdout.split() == paths, done.stderr
