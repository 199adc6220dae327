# SPDX-License-Identifier: Apache-2.0
"""Validated YAML; all user files are read through :func:`load`.

A schema is a frozen pydantic model whose fields carry a description that ends in the unit, so that an error
can state the expected value and its unit.

Every function here raises :class:`InputError` for invalid input. The message names file, line or key, value, and the
expected value; of several mistakes the first is explained.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from difflib import get_close_matches
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, TypeVar, Union, get_args, get_origin

import numpy as np
import yaml
from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, ValidationInfo

from impact_rs_sim.errors import InputError, shortened


class Schema(BaseModel):
    """Base of all file schemas: immutable, no unknown keys, no NaN or infinity."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


SchemaType = TypeVar("SchemaType", bound=Schema)


def omitted(default: Any, *, description: str) -> Any:
    """Field that is written only if it differs from its default.

    Keys added by later versions are such fields: files without them stay byte-identical, and so do their digests.
    """
    return Field(default, exclude_if=lambda value: value == default, description=description)


def _as_tuple(value: Any) -> Any:
    return tuple(value) if isinstance(value, (list, np.ndarray)) else value


def _check(test: Callable[[float], bool], expected: str) -> AfterValidator:
    def validate(values: tuple[float, ...]) -> tuple[float, ...]:
        if not all(test(value) for value in values):
            raise ValueError(f"every entry must be {expected}")
        return values

    return AfterValidator(validate)


def _check_name(value: str, info: ValidationInfo) -> str:
    if info.context == RECORDED:
        # Bags of 0.1.0 may have names with spaces; one that leads out of a folder has never been a name.
        if value.startswith(".") or any(sign in value for sign in "/\\\0"):
            raise ValueError("expected a name, not a path")
    elif re.fullmatch(r"[A-Za-z0-9_-]{1,100}", value) is None:
        raise ValueError("expected a name of letters, digits, _ and -, 100 at most: it becomes the name of folders")
    return value


RECORDED = "recorded"  # validation context of data that an earlier version recorded
Name = Annotated[str, AfterValidator(_check_name)]
Vector3 = Annotated[tuple[float, float, float], BeforeValidator(_as_tuple)]
Vector6 = Annotated[tuple[float, float, float, float, float, float], BeforeValidator(_as_tuple)]
Matrix6 = Annotated[tuple[Vector6, Vector6, Vector6, Vector6, Vector6, Vector6], BeforeValidator(_as_tuple)]
Vector = Annotated[tuple[float, ...], BeforeValidator(_as_tuple)]
Positive = Annotated[float, Field(gt=0.0)]
NonNegative = Annotated[float, Field(ge=0.0)]
PositiveVector = Annotated[Vector, _check(lambda value: value > 0.0, "> 0")]
NonNegativeVector = Annotated[Vector, _check(lambda value: value >= 0.0, ">= 0")]
PositiveVector3 = Annotated[Vector3, _check(lambda value: value > 0.0, "> 0")]


MAX_TEXT_LENGTH = 2_000_000  # characters; a friction compensation, the largest file, has 200,000
MAX_NODES = 200_000  # scalars, lists and mappings of a file
MAX_DEPTH = 40  # levels of nesting; a scenario has fewer than ten
MAX_NUMBER_LENGTH = 100  # characters of a number, and of every other value that is not text
MAX_KEY_LENGTH = 200  # characters
_MAPPING, _SEQUENCE = yaml.resolver.BaseResolver.DEFAULT_MAPPING_TAG, yaml.resolver.BaseResolver.DEFAULT_SEQUENCE_TAG
_TEXT = yaml.resolver.BaseResolver.DEFAULT_SCALAR_TAG


class _Mistake(Exception):
    """A YAML feature that is refused, at a node."""

    def __init__(self, message: str, mark: yaml.Mark, path: tuple[str, ...] = ()) -> None:
        super().__init__(message)
        self.mark, self.path = mark, path


class _Loader(yaml.SafeLoader):
    """Composes nodes within limits; without references, the size of the data is limited by that of the text."""

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self._depth = self._nodes = 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        if self.check_event(yaml.AliasEvent):
            raise _Mistake("references (*name) are not understood; write it out", self.peek_event().start_mark)
        self._depth += 1
        self._nodes += 1
        if self._depth > MAX_DEPTH or self._nodes > MAX_NODES:
            message = f"nested deeper than {MAX_DEPTH}" if self._depth > MAX_DEPTH else f"more than {MAX_NODES} entries"
            raise _Mistake(message, self.peek_event().start_mark)
        node = super().compose_node(parent, index)
        self._depth -= 1
        return node

    def value(self, node: yaml.Node | None, path: tuple[str, ...] = ()) -> Any:
        """Value of a node; ``path`` are the keys that lead to it."""
        if node is None:
            return None
        if isinstance(node, yaml.MappingNode) and node.tag == _MAPPING:
            mapping: dict[Any, Any] = {}
            for key_node, value_node in node.value:
                key = self._key(key_node, path)
                if key in mapping:
                    raise _Mistake(f"the key {key!r} stands here twice", key_node.start_mark, path)
                mapping[key] = self.value(value_node, (*path, str(key)))
            return mapping
        if isinstance(node, yaml.SequenceNode) and node.tag == _SEQUENCE:
            return [self.value(item, (*path, str(number))) for number, item in enumerate(node.value)]
        kind = node.tag.rpartition(":")[2]
        if not isinstance(node, yaml.ScalarNode) or node.tag not in self.yaml_constructors:
            raise _Mistake(f"the type {shortened(kind)!r} is not understood", node.start_mark, path)
        if node.tag != _TEXT and len(node.value) > MAX_NUMBER_LENGTH:
            length_text = f"{len(node.value)} characters"
            raise _Mistake(f"{length_text}, expected at most {MAX_NUMBER_LENGTH} for a {kind}", node.start_mark, path)
        try:
            return self.construct_object(node)
        except Exception:  # any error of a constructor: int('x'), an invalid date
            raise _Mistake(f"{node.value!r} is no {kind}", node.start_mark, path) from None

    def _key(self, node: yaml.Node, path: tuple[str, ...]) -> Any:
        if not isinstance(node, yaml.ScalarNode):
            raise _Mistake("a key must be a word, not a list or a mapping", node.start_mark, path)
        if len(node.value) > MAX_KEY_LENGTH:
            raise _Mistake(f"a key of {len(node.value)} characters; at most {MAX_KEY_LENGTH}", node.start_mark, path)
        return self.value(node, path)


def parse_value(text: str, file: str | Path) -> Any:
    """Parse any YAML, within limits of size and depth; without references, and every key once.

    Args:
        text: The YAML.
        file: Only names the place in errors.
    """
    if len(text) > MAX_TEXT_LENGTH:
        raise InputError(f"has {len(text)} characters, expected at most {MAX_TEXT_LENGTH}", file=file)
    try:
        loader = _Loader(text)
        return loader.value(loader.get_single_node())
    except _Mistake as mistake:
        key, mark = ".".join(mistake.path) or None, mistake.mark
        position = f" at line {mark.line + 1}, column {mark.column + 1}"
        raise InputError(f"not valid YAML{position}: {shortened(str(mistake))}", file=file, key=key) from None
    except yaml.YAMLError as error:
        mark_of_error = getattr(error, "problem_mark", None)
        position = f" at line {mark_of_error.line + 1}, column {mark_of_error.column + 1}" if mark_of_error else ""
        problem = getattr(error, "problem", None) or str(error)
        raise InputError(f"not valid YAML{position}: {shortened(problem)}", file=file) from None
    except Exception as error:  # the library has undocumented exceptions, for example for a version directive
        raise InputError(f"not valid YAML: {shortened(f'{type(error).__name__}: {error}')}", file=file) from None


def parse_yaml(text: str, file: str | Path) -> dict[str, Any]:
    """Parse a YAML mapping; see :func:`parse_value`."""
    data = parse_value(text, file)
    if not isinstance(data, dict):
        raise InputError(f"expected a YAML mapping, found {type(data).__name__}", file=file)
    return data


def load(schema: type[SchemaType], path: str | Path) -> SchemaType:
    """Read and validate one file."""
    return validate(schema, load_mapping(path), path)


def load_mapping(path: str | Path) -> dict[str, Any]:
    """Read one file without validating it."""
    return parse_yaml(read_text(path), path)


def read_text(path: str | Path, most: int = MAX_TEXT_LENGTH) -> str:
    """Text of a user's file.

    Args:
        path: The file.
        most: Bytes that it may have.
    """
    try:
        with Path(path).open("rb") as file:
            data = file.read(most + 1)
        text = data[:most].decode("utf-8")
    except UnicodeDecodeError as error:
        raise InputError(f"cannot be read: no UTF-8 text, from byte {error.start} on", file=path) from None
    except (OSError, ValueError) as error:  # ValueError: an invalid path
        raise InputError(f"cannot be read: {getattr(error, 'strerror', None) or error}", file=path) from None
    if len(data) > most:
        raise InputError(f"is larger than {most} bytes", file=path)
    return text


def read_json(path: str | Path, kind: str, most: int = MAX_TEXT_LENGTH) -> Any:
    """Content of a JSON file.

    Args:
        path: The file.
        kind: Kind of the file, for the message.
        most: Bytes that it may have.
    """
    text = read_text(path, most)
    try:
        return json.loads(text)
    except json.JSONDecodeError as error:
        raise InputError(f"not valid JSON at line {error.lineno}: {error.msg}", file=path) from None
    except (RecursionError, ValueError) as error:  # nested too deeply, or a number of thousands of digits
        raise InputError(f"not {kind}: {shortened(str(error))}", file=path) from None


def validate(schema: type[SchemaType], data: Any, file: str | Path | None, context: str | None = None) -> SchemaType:
    """Validate parsed data against ``schema``; ``file`` only names the place in errors.

    Args:
        schema: Schema of the data.
        data: Parsed data, as from :func:`parse_yaml`.
        file: Source of the data; None: not from a file.
        context: ``RECORDED`` for data that an earlier version may have written.
    """
    try:
        return schema.model_validate(data, context=context)
    except ValidationError as error:
        raise _input_error(schema, error, file) from None
    except (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError) as error:
        # A check between keys got numbers that it cannot calculate with.
        raise InputError(shortened(f"cannot be used ({type(error).__name__}: {error})"), file=file) from None


# Texts for errors that pydantic explains in programmer terms, by pydantic error type.
MISTAKE_TEXTS = {
    "too_short": "expected at least {min_length} of them, found {actual_length}",
    "too_long": "expected at most {max_length} of them, found {actual_length}",
    "string_too_short": "expected a text of at least {min_length} characters",
    "string_too_long": "expected a text of at most {max_length} characters",
    "int_parsing": "expected a whole number",
    "int_type": "expected a whole number",
    "int_from_float": "expected a whole number",
    "float_parsing": "expected a number",
    "float_type": "expected a number",
    "model_type": "expected names with their values",
    "model_attributes_type": "expected names with their values",
}


def _input_error(schema: type[Schema], error: ValidationError, file: str | Path | None) -> InputError:
    mistakes = error.errors(include_url=False)
    # A misspelt key is both unknown and missing; the error about the unknown key is the clearer one.
    first = next((mistake for mistake in mistakes if mistake["type"] == "extra_forbidden"), mistakes[0])
    location = [part for part in first["loc"] if part != "[key]"]
    key = ".".join(str(part) for part in location)
    meaning = _description(schema, location)
    kind = first["type"]
    value: object = None
    if kind == "missing":
        message = "this key is missing"
    elif kind == "extra_forbidden":
        message = f"unknown key{_did_you_mean(schema, location)}"
        meaning = ""
    else:
        template_text = MISTAKE_TEXTS[kind].format_map(first.get("ctx", {})) if kind in MISTAKE_TEXTS else first["msg"]
        message = template_text.removeprefix("Value error, ").removeprefix("Assertion failed, ")
        message = shortened(message.replace("Input should be", "expected").replace("Field required", "missing"), 600)
        value = first["input"] if not isinstance(first["input"], dict) else None
    if meaning:
        message += f" ({meaning})"
    if len(mistakes) > 1:
        message += f"; and {len(mistakes) - 1} more"
    return InputError(message, file=file, key=key or None, value=value)


def _walk(annotation: Any, location: list[Any]) -> tuple[type[Schema] | None, str]:
    description = ""
    schema: type[Schema] | None = None
    for part in [None, *location]:
        if part is not None:
            if isinstance(annotation, type) and issubclass(annotation, Schema):
                field = annotation.model_fields.get(str(part))
                if field is None:
                    return annotation, ""
                description = field.description or ""
                annotation = field.annotation
            elif get_origin(annotation) is dict:
                annotation = get_args(annotation)[1]
            elif get_origin(annotation) in (list, tuple):
                annotation = get_args(annotation)[0]
        while get_origin(annotation) in (Annotated, Union, UnionType):
            annotation = next(a for a in get_args(annotation) if a is not type(None))
        schema = annotation if isinstance(annotation, type) and issubclass(annotation, Schema) else None
    return schema, description


def _description(schema: type[Schema], location: list[Any]) -> str:
    return _walk(schema, location)[1]


def _did_you_mean(schema: type[Schema], location: list[Any]) -> str:
    parent = _walk(schema, location[:-1])[0]
    if parent is None:
        return ""
    close = get_close_matches(str(location[-1]), parent.model_fields, n=1)
    if close:
        return f"; did you mean {close[0]!r}?"
    return f"; known keys: {', '.join(parent.model_fields)}"
