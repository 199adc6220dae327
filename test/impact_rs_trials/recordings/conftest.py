# SPDX-License-Identifier: Apache-2.0
"""A laboratory with signals that are known."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml
from known_recordings import BagFormat, Signals

from impact_rs_trials.recordings.experiment import load_experiment
from impact_rs_trials.recordings.laboratory import LaboratoryRun, read_laboratory


class LaboratoryFolder:
    """A folder of recordings with its experiment file."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.signals = Signals.known()
        self.experiment: dict[str, object] = {"scenario": "push"}

    def mapping(self, changes: dict[str, dict[str, object]], **further: object) -> None:
        """Use a mapping that differs from the shipped one in some keys of some signals; None takes a signal out."""
        from impact_rs_sim.paths import config_directory

        shipped = config_directory() / "mappings" / "joint_state_effort_controller.yaml"
        content = yaml.safe_load(shipped.read_text())
        for name, keys in changes.items():
            if keys is None:
                del content["signals"][name]
            else:
                content["signals"][name] = {**content["signals"].get(name, {}), **keys}
        (self.path / "mapping.yaml").write_text(yaml.safe_dump({**content, **further}))
        self.experiment["mapping"] = "mapping.yaml"

    def bag(self, name: str = "run_1", **format_: object) -> Path:
        return BagFormat(**format_).write(self.path / name, self.signals)

    def read(self, *rows: str) -> list[LaboratoryRun]:
        """Runs of the table ``rows``, by default one hit; nothing is left out."""
        runs, skipped = self.read_all(*rows)
        assert skipped == []
        return runs

    def read_all(self, *rows: str) -> tuple[list[LaboratoryRun], list[tuple[str, str]]]:
        table = ["bag,object,kind,speed,pose", *(rows or ("run_1,parcel,hit,fast,a",))]
        (self.path / "runs.csv").write_text("\n".join(table) + "\n")
        (self.path / "experiment.yaml").write_text(yaml.safe_dump(self.experiment))
        return read_laboratory(self.path, load_experiment(self.path / "experiment.yaml"), map)


@pytest.fixture
def laboratory(tmp_path: Path) -> LaboratoryFolder:
    return LaboratoryFolder(tmp_path)
