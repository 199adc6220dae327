"""Recordings of robots that nobody here made: reading them, and what a free motion says about the model."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from impact_rs_sim.model import Model
from impact_rs_trials.recordings.mapping import Mapping, load_mapping, mapping_names
from impact_rs_trials.recordings.recording import Recording, is_foreign, read_recordings

__all__ = [
    "Mapping",
    "Recording",
    "compare_recording",
    "diagnose_recording",
    "is_foreign",
    "load_mapping",
    "mapping_names",
    "read_recordings",
]


def compare_recording(
    path: str | Path,
    mapping: str | Path | Mapping = "joint_state",
    model: Model | None = None,
    report: Path | None = None,
) -> dict[str, Any]:
    """Compare the model with recordings of a free motion.

    Args:
        path: A bag, a CSV or NPZ file, or a folder of them.
        mapping: Mapping, its name, or path of its file.
        model: What is believed beyond the rigid model; None: nothing.
        report: Folder for an HTML report; None: none is written.

    Returns:
        ``score``, ``score_is``, ``noise_floor``, ``levels``, ``where`` as for a campaign; ``recording``: what was read.

    Raises:
        InputError: The recording cannot be used.
    """
    from impact_rs_analysis.imports.diagnose import Setup, compare

    spec = mapping if isinstance(mapping, Mapping) else load_mapping(mapping)
    setup = Setup.make(read_recordings(Path(path), spec), spec, model)
    found = compare(setup)
    if report is not None:
        from impact_rs_analysis.report.recording import write_recording_comparison

        write_recording_comparison(found, setup, report)
    return found


def diagnose_recording(
    path: str | Path,
    mapping: str | Path | Mapping = "joint_state",
    model: Model | None = None,
    only: list[str] | None = None,
    report: Path | None = None,
) -> dict[str, Any]:
    """Find out which effects a model lacks in recordings of a free motion.

    Args:
        path: A bag, a CSV or NPZ file, or a folder of them.
        mapping: Mapping, its name, or path of its file.
        model: What is believed beyond the rigid model; None: nothing.
        only: Names of the effects to consider; None: all.
        report: Folder for an HTML report; None: none is written.

    Returns:
        ``verdict``, ``effects``, ``confusable``, ``unexplained``, ``next_experiment`` as for a campaign; errors in N m.

    Raises:
        InputError: The recording cannot be used.
    """
    from impact_rs_analysis.imports.diagnose import Setup, diagnose

    spec = mapping if isinstance(mapping, Mapping) else load_mapping(mapping)
    setup = Setup.make(read_recordings(Path(path), spec), spec, model)
    found, rest = diagnose(setup, model, only)
    if report is not None:
        from impact_rs_analysis.report.recording import write_recording_diagnosis

        write_recording_diagnosis(found, setup, rest, report)
    return found
