# SPDX-License-Identifier: Apache-2.0
"""Commands as the tests run them: one that is refused with one line, and one that prints a JSON document."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from impact_table_cases import CUBE_HEADER, cube, cube_rows, write_csv

from impact_rs_cli.main import main

Refused = Callable[..., str]
Document = Callable[..., dict[str, Any]]


@pytest.fixture
def refused(capfd: pytest.CaptureFixture) -> Refused:
    """Runs a command of a user's mistake: exit code 2, and one line, which is returned; ``warned``: after warnings."""

    def run(*arguments: object, warned: bool = False) -> str:
        capfd.readouterr()
        assert main([str(word) for word in arguments]) == 2
        out, err = capfd.readouterr()
        assert out == "" and "Traceback" not in err
        (line,) = [line for line in err.splitlines() if line.startswith("impact-rs")]
        assert warned or err == f"{line}\n"
        return line

    return run


@pytest.fixture
def document(capfd: pytest.CaptureFixture) -> Document:
    """Runs a command with ``--json``; returns its document, which is all that it prints."""

    def run(*arguments: object, code: int = 0) -> dict[str, Any]:
        capfd.readouterr()
        assert main([*(str(word) for word in arguments), "--json"]) == code
        return dict(json.loads(capfd.readouterr().out))

    return run


@pytest.fixture(scope="session")
def cubes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Impacts of cubes with mu = 0.2, where the nominal model has 0.5."""
    return write_csv(tmp_path_factory.mktemp("cubes") / "cubes.csv", CUBE_HEADER, cube_rows(cube(0.2), 36))


@pytest.fixture
def laboratory(push_campaign: Path, tmp_path: Path) -> Path:
    """Two runs of a laboratory, as our own bags."""
    folder = tmp_path / "lab"
    for number, scale in enumerate(("0.800", "1.000"), start=1):
        shutil.copytree(push_campaign / f"cat_food__case_2__s{scale}__r0", folder / f"run_{number}")
    (folder / "runs.csv").write_text("bag,object,kind\nrun_1,cat_food,hit\nrun_2,cat_food,hit\n")
    (folder / "experiment.yaml").write_text("scenario: push\nmapping: impact_rs\n")
    return folder


@pytest.fixture(scope="session")
def model_2(diagnosed: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The nominal model with what the diagnosis of ``hidden_campaign`` named."""
    path = tmp_path_factory.mktemp("models") / "model_2.yaml"
    assert main(["add", "support_friction", "--from", str(diagnosed), "-o", str(path)]) == 0
    return path
