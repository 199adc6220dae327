# SPDX-License-Identifier: Apache-2.0
"""A pytest plugin: the mutated module must have been imported, and from the copy, or the outcome means nothing."""

import os
import sys

FOREIGN = 99  # exit code where it was not


def pytest_sessionfinish(session, exitstatus):
    """A run that passes without the mutated code is no survivor."""
    name = os.environ["IMPACT_RS_MUTANT_MODULE"]
    if not name or exitstatus != 0:
        return
    file = getattr(sys.modules.get(name), "__file__", None)
    if file is None or not file.startswith(os.environ["IMPACT_RS_MUTANT_COPY"] + os.sep):
        print(f"mutant_guard: {name} was imported from {file}")
        session.exitstatus = FOREIGN
