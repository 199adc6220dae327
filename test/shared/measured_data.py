# SPDX-License-Identifier: Apache-2.0
"""Measured data that is too large for the repository, or not ours to publish."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

VARIABLE = "IMPACT_RS_TEST_DATA"
BESIDE = Path(__file__).resolve().parents[3] / "shared" / "data"


def measured_data(*names: str) -> Path:
    """A file or folder of the measured data, by its path below the folder that ``IMPACT_RS_TEST_DATA`` names.

    Without the variable the folder ``shared/data`` beside the checkout is looked at, and a test whose data is missing
    is skipped. With it, missing data is a failure, so that no test is left out for ever without anyone noticing.
    """
    named = os.environ.get(VARIABLE)
    path = Path(named or BESIDE).joinpath(*names)
    if not path.exists():
        if named:
            pytest.fail(f"{path} is missing, and {VARIABLE} says that the measured data is there")
        pytest.skip(f"needs {'/'.join(names)} of the measured data: {VARIABLE}=FOLDER")
    return path
