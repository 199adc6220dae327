# SPDX-License-Identifier: Apache-2.0
"""Boards of hidden truths, accuracy, time: measured, never asserted in tests. ``./run python -m benchmarks``."""

import os
import sys
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")  # as the docs state it; workers get the same from dask
_TEST = Path(__file__).resolve().parents[1] / "test"
# Closed forms, simulated recordings and the MuJoCo cell stand in the test folder and are used here as well.
sys.path += [str(_TEST / "shared"), str(_TEST / "impact_rs_sim"), str(_TEST / "impact_rs_analysis" / "diagnosis")]
