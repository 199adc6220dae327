# SPDX-License-Identifier: Apache-2.0
"""Seeds of tasks that may run anywhere and in any order."""

from __future__ import annotations

import zlib

import numpy as np


def seed_of(seed: int, name: str) -> int:
    """Seed of the task ``name`` of a whole that has ``seed``: it depends on these two alone."""
    return int(np.random.SeedSequence([seed, zlib.crc32(name.encode())]).generate_state(1, np.uint64)[0])
