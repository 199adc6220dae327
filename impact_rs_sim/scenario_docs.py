# SPDX-License-Identifier: Apache-2.0
"""``docs/scenarios.md`` from the schema: every key of a scenario file with unit, limits and default.

python -m impact_rs_sim.scenario_docs > docs/scenarios.md
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from annotated_types import Ge, Gt, Le
from pydantic.fields import FieldInfo

from impact_rs_sim.scenario import Scenario
from impact_rs_sim.schema import Schema

HEADER = """\
# Scenario files

A scenario says what is in the scene, what the robots shall do, and how it is measured. Commands take its name
(`config/scenarios/NAME.yaml`) or the path of a YAML file of your own:

    ./run impact-rs map path/to/mine.yaml cat_food case_2

Start from a copy of `config/scenarios/push.yaml`. SI units everywhere; vectors in the axes of the inertial frame A,
z up (REP-103), where nothing else is said. A key that is missing, misspelt, written twice or out of its limits stops
every command with one line that names file, key, value and unit. What we *believe* of the physics beyond these nominal
values stands in model files (`config/models`), not here.

Made from `impact_rs_sim/scenario.py` by `python -m impact_rs_sim.scenario_docs > docs/scenarios.md`.
`NAME` stands for a name that you choose; a list per joint has one entry per joint, base to tip.
"""

LIMIT_SYMBOLS = {Gt: ("gt", ">"), Ge: ("ge", ">="), Le: ("le", "<=")}
UNIT_PATTERN = re.compile(r" ?\[([^\]]+)\]")


def _key(name: str, annotation: Any) -> tuple[str, type[Schema] | None]:
    """Spelling of a key, and the schema below it if it is a section."""
    for candidate in _alternatives(annotation):
        if get_origin(candidate) is dict:
            return _key(f"{name}.NAME", get_args(candidate)[1])
        if get_origin(candidate) is tuple and get_args(candidate)[1:] == (...,):
            key, below = _key(f"{name}[N]", get_args(candidate)[0])
            if below is not None:
                return key, below
        if isinstance(candidate, type) and issubclass(candidate, Schema):
            return name, candidate
    return name, None


def _alternatives(annotation: Any) -> list[Any]:
    while get_origin(annotation) is Annotated:
        annotation = get_args(annotation)[0]
    if get_origin(annotation) in (Union, UnionType):
        return [entry for part in get_args(annotation) if part is not NoneType for entry in _alternatives(part)]
    return [annotation]


def _annotations(field: FieldInfo) -> list[Any]:
    """The field's annotation with whatever it is wrapped in."""
    parts = [field.annotation, *field.metadata]
    for part in parts:
        if get_origin(part) in (Union, UnionType, Annotated):
            parts += [inner for inner in get_args(part) if inner is not NoneType]
        elif isinstance(part, FieldInfo):
            parts += part.metadata
    return parts


def _kind(field: FieldInfo) -> str:
    """Type in words."""
    (kind,) = _alternatives(field.annotation)[:1]
    if get_origin(kind) is Literal:
        return " or ".join(f"`{value}`" for value in get_args(kind))
    if get_origin(kind) is tuple:
        entries = get_args(kind)
        return "list of numbers" if Ellipsis in entries else f"{len(entries)} numbers"
    return {float: "number", int: "whole number", str: "text"}.get(kind, kind.__name__)


def _limits(schema: type[Schema], name: str, field: FieldInfo) -> str:
    """Bounds of a number, or of every entry of a list."""
    found = [
        f"{sign} {getattr(part, attribute):g}"
        for part in _annotations(field)
        for kind, (attribute, sign) in LIMIT_SYMBOLS.items()
        if isinstance(part, kind)
    ]
    declared = str(schema.__annotations__.get(name, ""))
    for word, text in (("PositiveVector3", "> 0"), ("PositiveVector", "> 0"), ("NonNegativeVector", ">= 0")):
        if re.search(rf"\b{word}\b", declared):
            found.append(f"each {text}")
    if "Positive, Positive" in declared:
        found.append("each > 0")
    return ", ".join(found)


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "required"
    value = field.default
    if value is None:
        return "absent"
    return f"`{list(value) if isinstance(value, tuple) else value}`"


def _sentence_case(text: str) -> str:
    """First letter large, unless the text begins with a symbol."""
    return text if "_" in text.split(",")[0].split(" ")[0] else text[:1].upper() + text[1:]


def _rows(schema: type[Schema]) -> Iterator[tuple[str, ...]]:
    for name, field in schema.model_fields.items():
        if _key(name, field.annotation)[1] is not None:
            continue
        description = field.description or ""
        unit = UNIT_PATTERN.search(description)
        meaning = UNIT_PATTERN.sub("", description, count=1)
        yield (
            f"`{name}`",
            _kind(field),
            unit[1] if unit else "",
            _limits(schema, name, field),
            _default(field),
            _sentence_case(meaning),
        )


def _sections(prefix: str, schema: type[Schema], presence: str) -> Iterator[tuple[str, type[Schema], str]]:
    """Every section, parents first: dotted path, schema, purpose."""
    yield prefix, schema, presence
    for name, field in schema.model_fields.items():
        key, below = _key(name, field.annotation)
        if below is not None:
            text = field.description or ""
            yield from _sections(f"{prefix}.{key}".lstrip("."), below, text)


def markdown() -> str:
    """``docs/scenarios.md``."""
    lines = [HEADER]
    for path, schema, meaning in _sections("", Scenario, ""):
        rows = list(_rows(schema))
        lines.append(f"## `{path}`\n" if path else "## Top level\n")
        purpose = meaning or (schema.__doc__ or "").splitlines()[0]
        lines.append(f"{_sentence_case(purpose).rstrip('.')}.\n")
        if rows:
            lines += ["| Key | Type | Unit | Limits | Default | Meaning |", "|---" * 6 + "|"]
            lines += ["| " + " | ".join(row) + " |" for row in rows]
            lines.append("")
    return "\n".join(line.replace(">= ", "≥ ").replace("<= ", "≤ ") for line in lines).rstrip() + "\n"


if __name__ == "__main__":
    print(markdown(), end="")
