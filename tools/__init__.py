# SPDX-License-Identifier: Apache-2.0
"""What developers make shipped files with, and compare versions with."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1] / "test" / "shared"))  # the second robot cell is of the tests
