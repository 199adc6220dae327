# SPDX-License-Identifier: Apache-2.0
"""Tools of developers, which make shipped files and compare versions."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1] / "test" / "shared"))  # the second robot cell is of the tests
