# SPDX-License-Identifier: Apache-2.0
"""What the packages export: the names are there, and the examples of their docstrings run."""

from __future__ import annotations

import ast
import importlib
import inspect
import re
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

PACKAGES = ("impact_rs_sim", "impact_rs_trials", "impact_rs_analysis")
ROOT = Path(__file__).resolve().parents[1]


@pytest.mark.parametrize("package", PACKAGES)
def test_every_exported_name_is_there_and_known_to_type_checkers(package: str) -> None:
    module = importlib.import_module(package)
    found = {name: getattr(module, name) for name in module.__all__}
    assert all(inspect.getdoc(value) for value in found.values())
    tree = ast.parse((ROOT / package / "__init__.py").read_text(encoding="utf-8"))
    (checked,) = [node for node in tree.body if isinstance(node, ast.If)]
    typed = {
        (node.module, alias.name) for node in checked.body if isinstance(node, ast.ImportFrom) for alias in node.names
    }
    assert typed == {(f"{package}.{place}", name) for place, names in module.MODULES.items() for name in names}


@pytest.mark.parametrize("package", ["sim.descriptions", "sim.effects", "sim.impact_map", "analysis.report"])
def test_every_name_of_all_is_there(package: str) -> None:
    """Kills: a name in __all__ that the package no longer has."""
    module = importlib.import_module(f"impact_rs_{package}")
    assert [name for name in module.__all__ if not hasattr(module, name)] == []


@pytest.mark.parametrize("package", PACKAGES)
def test_a_name_that_is_not_exported_is_an_attribute_error(package: str) -> None:
    """Kills a KeyError, which hasattr and pickle do not expect."""
    with pytest.raises(AttributeError, match=f"module '{package}' has no attribute 'nothing_of_this_name'"):
        _ = importlib.import_module(package).nothing_of_this_name


def test_importing_the_packages_alone_imports_no_physics() -> None:
    code = f"import sys, {', '.join(PACKAGES)}; print('pinocchio' in sys.modules, 'pybullet' in sys.modules)"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.split() == ["False", "False"]


def example(package: str) -> str:
    """The code of a docstring."""
    text = inspect.getdoc(importlib.import_module(package)) or ""
    (code,) = re.findall(r"::\n\n((?:    .*\n|\n)+)", text)
    return textwrap.dedent(code)


def test_the_examples_predict_and_record(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    exec(example("impact_rs_sim"), {})
    assert re.search(r"end effector \[m/s\]: \[.*\]\nimpulse \[N s\]:", capsys.readouterr().out)
    names: dict[str, object] = {}
    exec(example("impact_rs_trials"), names)
    assert names["bag"].outcome == "OK"  # type: ignore[attr-defined]


def test_the_example_compares_and_diagnoses(
    hidden_campaign: Path, diagnosed: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """For one effect, whose twin runs are there already."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(diagnosed.parent / "cache"))
    code = example("impact_rs_analysis").replace("campaigns/example", str(hidden_campaign))
    assert code.count("diagnose(measured)") == 1
    exec(code.replace("diagnose(measured)", "diagnose(measured, only=['support_friction'])"), {})
    printed = capsys.readouterr().out
    assert re.search(r"error: \d+\.\d\d times repeatability", printed)
    assert "support_friction: friction = 0.1" in printed
