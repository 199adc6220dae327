# SPDX-License-Identifier: Apache-2.0
"""``docs/python.md``: exported names of the Python packages, with their signatures and first sentences."""

from __future__ import annotations

import ast
import importlib
import inspect
import re
import textwrap
from collections.abc import Iterator
from types import ModuleType
from typing import Any

PACKAGES = ("impact_rs_sim", "impact_rs_trials", "impact_rs_analysis")
HEADER = """\
# Python

*Look up.* Names that the packages export. `help(NAME)` explains arguments with their types, results and errors, with
shapes and units. Whole scripts: [examples](../examples).
"""


def markdown() -> str:
    """Text of the page."""
    return "\n".join([HEADER, *(_package(importlib.import_module(name)) for name in PACKAGES)])


def _package(package: ModuleType) -> str:
    """Section of a package: its sentence, its example, its functions and its classes."""
    text = inspect.getdoc(package) or ""
    (example,) = re.findall(r"::\n\n((?:    .*\n|\n)+)", text)
    exported = {name: getattr(package, name) for name in package.__all__}
    classes = {name: value for name, value in exported.items() if inspect.isclass(value)}
    lines = [f"## {package.__name__}", "", _sentence(package), "", "```python", textwrap.dedent(example).strip(), "```"]
    lines += ["", "Functions:", ""]
    for name, value in exported.items():
        if name not in classes:
            lines.append(f"* `{_signature(name, value)}`: {_sentence(value)}")
    lines += ["", "Classes:", ""]
    for name, kind in classes.items():
        lines.append(f"* `{name}`: {_sentence(kind)}")
        lines += [
            f"  * `{_signature(f'{name}.{maker}', method, False)}`: {_sentence(method)}"
            for maker, method in _makers(kind)
        ]
    return "\n".join(lines) + "\n"


def _makers(kind: type) -> Iterator[tuple[str, Any]]:
    """Class methods and static methods of a class, which make its instances, by name."""
    for name, value in vars(kind).items():
        if isinstance(value, classmethod | staticmethod) and not name.startswith("_") and value.__func__.__doc__:
            yield name, value.__func__


def _signature(name: str, function: Any, with_result: bool = True) -> str:
    """Name, arguments with their defaults, and type of the result; class methods without their class."""
    source = textwrap.dedent(inspect.getsource(inspect.unwrap(function)))
    (definition,) = ast.parse(source).body
    assert isinstance(definition, ast.FunctionDef) and not (
        definition.args.kwonlyargs or definition.args.vararg or definition.args.kwarg
    )
    texts = [argument.arg for argument in definition.args.args if argument.arg != "cls"]
    defaults = [f"={ast.unparse(default)}" for default in definition.args.defaults]
    defaults = [""] * (len(texts) - len(defaults)) + defaults
    arguments = ", ".join(text + default for text, default in zip(texts, defaults, strict=True))
    returned = f" -> {ast.unparse(definition.returns)}" if with_result and definition.returns else ""
    return f"{name}({arguments}){returned}"


def _sentence(documented: Any) -> str:
    """First paragraph of a docstring on one line, in Markdown."""
    first = " ".join((inspect.getdoc(documented) or "").split("\n\n")[0].split())
    return re.sub(r":\w+:`~?([^`]+)`", r"`\1`", first).replace("``", "`")
