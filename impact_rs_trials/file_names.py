# SPDX-License-Identifier: Apache-2.0
"""Names of files that several modules use."""

from __future__ import annotations

from pathlib import Path

BAG_METADATA = "metadata.yaml"  # of a rosbag2 bag; written last
EXPERIMENT_FILE = "experiment.yaml"  # describes the runs of a laboratory
EXPERIMENT_FILES = (EXPERIMENT_FILE, "experiment.yml")
MAPPING_FILE = "mapping.yaml"  # signals of a recording
SENSITIVITY = "sensitivity"  # folder of campaigns with one setting varied
RUN_TABLE = "runs.csv"  # of a laboratory; no recording


def experiment_file_in(folder: Path) -> Path | None:
    """The experiment file of a folder; None: the folder has none."""
    return next((folder / name for name in EXPERIMENT_FILES if (folder / name).is_file()), None)
