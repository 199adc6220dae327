# SPDX-License-Identifier: Apache-2.0
"""Has every Python of a mutant's tests import the packages of the copy, wherever they are installed from.

An editable installation answers imports by a finder of its own, which stands before ``sys.path``; this one stands
before both. Python runs this module at its start, because its folder is on ``PYTHONPATH``.
"""

import os
import sys
from importlib.machinery import PathFinder

COPY = os.environ["IMPACT_RS_MUTANT_COPY"]


class CopyFinder:
    """Finds ``impact_*`` packages and their modules in the copy."""

    @staticmethod
    def find_spec(name, path=None, target=None):
        """Spec of one of our modules; None leaves all others to the finders that follow."""
        package = name.partition(".")[0]
        if not package.startswith("impact_") or not os.path.isfile(os.path.join(COPY, package, "__init__.py")):
            return None
        return PathFinder.find_spec(name, [COPY] if path is None else path, target)


sys.meta_path.insert(0, CopyFinder)
