# SPDX-License-Identifier: Apache-2.0
"""Tables of keys from the schema of a file, and ``docs/scenarios.md`` from the schema of a scenario.

python -m impact_rs_sim.scenarios.scenario_docs > docs/scenarios.md
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from annotated_types import Ge, Gt, Le
from pydantic.fields import FieldInfo

from impact_rs_sim.robots.robot import Reflexes, RobotFacts
from impact_rs_sim.scenarios.friction_compensation import FrictionCompensation
from impact_rs_sim.scenarios.scenario import Scenario
from impact_rs_sim.schema import Schema

HEADER = """\
# Scenario files

*Look up.* Scene, task of the robots, and measurement. Commands take the name of a scenario or the path of your own
file; start from a copy of `config/scenarios/push.yaml`:

    ./run impact-rs map path/to/mine.yaml cat_food case_2

Units are SI; vectors have the axes of the inertial frame A, z up (REP-103), unless a row names another frame. `NAME` is
a name of your choice. Lists per joint run from base to tip; for prismatic joints read m for rad, N for N m and kg for
kg m². A wrong key stops every command with one line that names file, key, value and unit. Estimated effects belong in
[model files](effects.md#model-files).
"""

LIMITS = {Gt: ("gt", ">"), Ge: ("ge", ">="), Le: ("le", "<=")}
MOST_WORDS_OF_A_NAME = 3  # a section with a shorter description ("Arms by name") has no row
UNIT = re.compile(r" ?\[([^\]]+)\](?!\()")
PRISMATIC = re.compile(r",? prismatic \[[^\]]+\]")  # a page has the rule once


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
    """The field's annotation, its metadata, and the parts of nested annotations."""
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
        return ", ".join(f"`{value}`" for value in get_args(kind))
    if get_origin(kind) is tuple:
        entries = get_args(kind)
        entry = _alternatives(entries[0])[0]
        noun = "names" if get_origin(entry) is Literal else {str: "texts", int: "whole numbers"}.get(entry, "numbers")
        if isinstance(entry, type) and issubclass(entry, Schema):
            return "sections"
        if get_origin(entry) is tuple and Ellipsis not in entries:
            return f"{len(entries)} rows of {len(get_args(entry))} numbers"
        return noun if Ellipsis in entries else f"{len(entries)} {noun}"
    if get_origin(kind) is dict or (isinstance(kind, type) and issubclass(kind, Schema)):
        return "section"
    return {float: "number", int: "whole number", str: "text", bool: "`true`, `false`"}.get(kind, kind.__name__)


def _limits(schema: type[Schema], name: str, field: FieldInfo) -> str:
    """Bounds of a number, or of every entry of a list."""
    bounds = [
        f"{sign} {getattr(part, attribute):g}"
        for part in _annotations(field)
        for kind, (attribute, sign) in LIMITS.items()
        if isinstance(part, kind)
    ]
    declared = str(schema.__annotations__.get(name, ""))
    for word, text in (("PositiveVector3", "> 0"), ("PositiveVector", "> 0"), ("NonNegativeVector", ">= 0")):
        if re.search(rf"\b{word}\b", declared):
            bounds.append(text)
    if "Positive, Positive" in declared:
        bounds.append("> 0")
    return ", ".join(bounds)


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "required"
    value = field.default
    if value is None or value == "":
        return "absent"
    if isinstance(value, bool):
        return f"`{str(value).lower()}`"
    return f"`{list(value) if isinstance(value, tuple) else value}`"


def _sentence_case(text: str) -> str:
    """First letter large, unless the text begins with a symbol."""
    return text if "_" in text.split(",")[0].split(" ")[0] else text[:1].upper() + text[1:]


def _row(schema: type[Schema], name: str, field: FieldInfo, key: str) -> tuple[str, str, str, str]:
    description = PRISMATIC.sub("", field.description or "")
    description = description.replace("That file has these keys", "[Its keys](robots.md#robot-facts)")
    unit = UNIT.search(description)
    kind, limits = _kind(field), _limits(schema, name, field)
    words = ["" if kind == "number" and limits else kind, limits]
    words.append(f"[{unit[1]}]" if unit and unit[1] != "-" else "")
    meaning = _sentence_case(UNIT.sub("", description, count=1))
    return f"`{key}`", " ".join(filter(None, words)), _default(field), meaning


def _sections(
    prefix: str, schema: type[Schema], presence: str, without: tuple[type[Schema], ...]
) -> Iterator[tuple[str, type[Schema], str]]:
    """Every section, parents first: dotted path, schema, purpose."""
    yield prefix, schema, presence
    for name, field in schema.model_fields.items():
        key, below = _key(name, field.annotation)
        if below is not None and not issubclass(below, without):
            text = field.description or ""
            yield from _sections(f"{prefix}.{key}".lstrip("."), below, text, without)


def key_table(head: str, schema: type[Schema], without: tuple[type[Schema], ...] = ()) -> str:
    """One table of all keys of a file in Markdown, dotted, ``NAME`` for a name that a user chooses.

    A section with the keys of an earlier section refers to it; one with additional keys lists only these.

    Args:
        head: Heading of the first column.
        schema: Schema of the file.
        without: Schemas of sections that have tables of their own.
    """
    rows: list[tuple[str, ...]] = [(head, "Value", "Default", "Meaning")]
    shown: dict[type[Schema], str] = {}
    referred: list[str] = []  # to an earlier section, and with it all sections below
    for path, section, meaning in _sections("", schema, "", without):
        if path.startswith(tuple(referred)):
            continue
        if (first := shown.setdefault(section, path)) != path:
            if not path.startswith(f"{first}."):
                referred.append(f"{path}.")
                rows.append(
                    (f"`{path}`", "section", "", f"{_sentence_case(meaning)}. Keys as of `{first}`".lstrip(". "))
                )
            continue
        base = next(
            (parent for parent in shown if parent is not section and issubclass(section, parent)),
            None,
        )
        if base is not None:
            text = f"{_sentence_case(meaning)}. Its own keys, and keys as of `{shown[base]}`"
            rows.append((f"`{path}`", "section", "", text))
        elif path and len(meaning.split()) > MOST_WORDS_OF_A_NAME:
            rows.append((f"`{path}`", "section", "", _sentence_case(meaning)))
        for name, field in section.model_fields.items():
            if base is not None and name in base.model_fields:
                continue
            key, below = _key(name, field.annotation)
            dotted = f"{path}.{name if below is None else key}".lstrip(".")
            if below is None or below in without:
                rows.append(_row(section, name, field, dotted))
    lines = ["| " + " | ".join(row) + " |" for row in rows]
    lines.insert(1, "|---" * 4 + "|")
    return "\n".join(lines).replace(">= ", "≥ ").replace("<= ", "≤ ")


def markdown() -> str:
    """``docs/scenarios.md``."""
    return f"{HEADER}\n{key_table('Key', Scenario, (RobotFacts, Reflexes, FrictionCompensation))}\n"


if __name__ == "__main__":
    print(markdown(), end="")
