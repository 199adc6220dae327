# SPDX-License-Identifier: Apache-2.0
"""A laboratory with signals that are known."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from known_recordings import BagFormat, Signals
from refusals import refusal

from impact_rs_sim.paths import config_directory
from impact_rs_trials.recordings.experiment import Experiment, load_experiment
from impact_rs_trials.recordings.laboratory_runs import read_laboratory
from impact_rs_trials.runs import Run

FREE = "run_1,none,free motion,fast,a"  # a row of the table of runs


class LaboratoryFolder:
    """A folder of recordings with its experiment file."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.signals = Signals.known()
        self.experiment: dict[str, object] = {"scenario": "push"}

    def change(self, **arrays: np.ndarray) -> None:
        """Other signals than those that are known."""
        self.signals = replace(self.signals, **arrays)

    def mapping(self, changes: dict[str, dict[str, object] | None], **further: object) -> None:
        """Use a mapping that differs from the shipped one in some keys of some signals; None takes a signal out."""
        shipped = config_directory() / "mappings" / "joint_state_effort_controller.yaml"
        content = yaml.safe_load(shipped.read_text())
        for name, keys in changes.items():
            if keys is None:
                del content["signals"][name]
            else:
                content["signals"][name] = {**content["signals"].get(name, {}), **keys}
        (self.path / "mapping.yaml").write_text(yaml.safe_dump({**content, **further}))
        self.experiment["mapping"] = "mapping.yaml"

    def load(self) -> Experiment:
        (self.path / "experiment.yaml").write_text(yaml.safe_dump(self.experiment))
        return load_experiment(self.path / "experiment.yaml")

    def bag(self, name: str = "run_1", **format_: object) -> Path:
        return BagFormat(**format_).write(self.path / name, self.signals)

    def read_all(self, *rows: str) -> tuple[list[Run], list[tuple[str, str]]]:
        """Runs of the table ``rows``, by default one hit, and what is left out."""
        table = ["bag,object,kind,speed,pose", *(rows or ("run_1,parcel,hit,fast,a",))]
        (self.path / "runs.csv").write_text("\n".join(table) + "\n")
        return read_laboratory(self.path, self.load(), map)

    def read(self, *rows: str) -> list[Run]:
        """The same where nothing is left out."""
        runs, skipped = self.read_all(*rows)
        assert skipped == []
        return runs

    def run(self, *rows: str, **format_: object) -> Run:
        """The run of a bag that is written with these signals."""
        self.bag(**format_)
        (run,) = self.read(*rows)
        return run

    def refusal(self, *rows: str) -> str:
        """What is said of a folder that cannot be read."""
        return refusal(self.read_all, *rows)


@pytest.fixture
def laboratory(tmp_path: Path) -> LaboratoryFolder:
    return LaboratoryFolder(tmp_path)
