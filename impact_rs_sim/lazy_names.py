# SPDX-License-Identifier: Apache-2.0
"""Lazy imports of a package: names are imported at first use (PEP 562).

Importing the physics takes seconds on a cold machine. A command that needs none of it should start at once.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from typing import Any


def lazy_names(package: str, modules: Mapping[str, Sequence[str]]) -> Callable[[str], Any]:
    """``__getattr__`` of a package.

    Args:
        package: ``__name__`` of the package.
        modules: Names by module, relative to the package.
    """
    module_of_name = {name: module for module, names in modules.items() for name in names}

    def get(name: str) -> Any:
        if name not in module_of_name:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(import_module(f"{package}.{module_of_name[name]}"), name)

    return get
