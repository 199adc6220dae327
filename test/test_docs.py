# SPDX-License-Identifier: Apache-2.0
"""The manual leads somewhere: links exist, commands are those of the command line, pictures stay small."""

import re
import subprocess
from pathlib import Path

import pytest

from impact_rs_cli.main import parser
from impact_rs_trials.blind import draw_truth

ROOT = Path(__file__).resolve().parent.parent
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_link_leads_to_a_file(page: Path) -> None:
    for target in re.findall(r"\]\(([^)#\s]+)", page.read_text(encoding="utf-8")):
        if "://" not in target:
            assert (page.parent / target).exists(), target


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_command_that_a_page_tells_can_be_parsed_that_far(page: Path) -> None:
    known = next(action for action in parser()._actions if action.choices).choices
    for command in re.findall(r"^ +\./run impact-rs ([a-z]+)", page.read_text(encoding="utf-8"), re.MULTILINE):
        assert command in known, command


def test_every_page_is_in_the_index() -> None:
    index = (ROOT / "docs" / "README.md").read_text(encoding="utf-8")
    missing = [page.name for page in PAGES[1:] if page.name != "README.md" and f"({page.name})" not in index]
    assert not missing


def test_pictures_are_small() -> None:
    for picture in (ROOT / "docs" / "images").iterdir():
        assert picture.stat().st_size < 300_000, picture.name


def test_the_effect_that_the_tutorial_hides_and_finds_is_the_one_that_its_seed_hides() -> None:
    ((hidden, named),) = re.findall(
        r"hidden (\w+), named (\w+)", (ROOT / "docs" / "tutorial.md").read_text(encoding="utf-8")
    )
    assert [hidden] == [named] == [effect.name for effect in draw_truth(7, "single", None, None)]
    assert f"    {hidden}\n" in (ROOT / "docs" / "missing_effects.md").read_text(encoding="utf-8")


def test_every_claim_of_the_safety_argument_names_tests_that_exist() -> None:
    """``docs/real_robot.md``: what can move a robot."""
    argument = (ROOT / "docs" / "real_robot.md").read_text().split("## Safety argument")[1].split("\n## ")[0]
    rows = [row for row in argument.splitlines() if "`test_" in row]
    there = {
        name
        for file in (ROOT / "test").rglob("test_*.py")
        for name in re.findall(r"^def (test_\w+)\(", file.read_text(), re.MULTILINE)
    }
    named = {name for row in rows for name in re.findall(r"`(test_\w+)`", row)}
    assert len(rows) >= 15
    assert named <= there


def test_what_the_tutorial_writes_into_a_clone_is_ignored_by_git() -> None:
    if not (ROOT / ".git").exists():
        pytest.skip("not a clone")
    commands = re.findall(r"^    \./run impact-rs (.*)$", (ROOT / "docs" / "tutorial.md").read_text(), re.MULTILINE)
    written = {found for command in commands for found in re.findall(r"(?:-o|--report) (\S+)", command)}
    assert {"trials", "campaigns/quick", "blind_7", "report_1", "diagnosis.json", "model_2.yaml"} <= written
    # A name that ends in a slash is a folder to git, although it is not there.
    paths = [path if Path(path).suffix else f"{path}/" for path in sorted(written)]
    done = subprocess.run(["git", "-C", ROOT, "check-ignore", *paths], capture_output=True, text=True)
    assert done.stdout.split() == paths, done.stderr
