# SPDX-License-Identifier: Apache-2.0
"""Random seeds of tasks, independent of process and order."""

from __future__ import annotations

import zlib

import numpy as np


def seed_of(seed: int, name: str) -> int:
    """Seed of the task ``name`` derived from ``seed`` alone."""
    return int(np.random.SeedSequence([seed, zlib.crc32(name.encode())]).generate_state(1, np.uint64)[0])
