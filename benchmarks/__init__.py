# SPDX-License-Identifier: Apache-2.0
"""Boards of hidden truths, accuracy, time: measured, never asserted in tests. ``./run python -m benchmarks``."""

import os
import sys
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")  # as the docs state it; workers get the same from dask
_TEST = Path(__file__).resolve().parents[1] / "test"
# Closed forms, made-up recordings and the second robot cell are those of the tests.
sys.path += [str(_TEST / "shared"), str(_TEST / "impact_rs_sim"), str(_TEST / "impact_rs_analysis" / "diagnosis")]
