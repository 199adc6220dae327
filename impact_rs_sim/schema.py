"""Validated YAML: every border of the program reads its files through :func:`load`.

A schema is a frozen pydantic model whose fields carry a description that ends in the unit, so that an error
can say what was expected, and in which unit.
"""

from __future__ import annotations

from collections.abc import Callable
from difflib import get_close_matches
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, TypeVar, Union, get_args, get_origin

import numpy as np
import yaml
from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, ValidationError

from impact_rs_sim.errors import InputError


class Schema(BaseModel):
    """Base of all file schemas: immutable, no unknown keys, no NaN or infinity."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


SchemaType = TypeVar("SchemaType", bound=Schema)


def _as_tuple(value: Any) -> Any:
    return tuple(value) if isinstance(value, (list, np.ndarray)) else value


def _check(test: Callable[[float], bool], expected: str) -> AfterValidator:
    def validate(values: tuple[float, ...]) -> tuple[float, ...]:
        if not all(test(value) for value in values):
            raise ValueError(f"every entry must be {expected}")
        return values

    return AfterValidator(validate)


Vector3 = Annotated[tuple[float, float, float], BeforeValidator(_as_tuple)]
Vector = Annotated[tuple[float, ...], BeforeValidator(_as_tuple)]
PositiveVector = Annotated[Vector, _check(lambda value: value > 0.0, "> 0")]
NonNegativeVector = Annotated[Vector, _check(lambda value: value >= 0.0, ">= 0")]
PositiveVector3 = Annotated[Vector3, _check(lambda value: value > 0.0, "> 0")]


def _unique_key_loader() -> type[yaml.SafeLoader]:
    class Loader(yaml.SafeLoader):
        pass

    def construct_mapping(loader: yaml.SafeLoader, node: yaml.MappingNode) -> dict[Any, Any]:
        mapping: dict[Any, Any] = {}
        for key_node, value_node in node.value:
            key = loader.construct_object(key_node, deep=True)
            if key in mapping:
                raise yaml.constructor.ConstructorError(
                    None, None, f"the key {key!r} stands here twice", key_node.start_mark
                )
            mapping[key] = loader.construct_object(value_node, deep=True)
        return mapping

    Loader.add_constructor(yaml.resolver.BaseResolver.DEFAULT_MAPPING_TAG, construct_mapping)
    return Loader


_Loader = _unique_key_loader()


def parse_yaml(text: str, file: str | Path) -> dict[str, Any]:
    """Parse a YAML mapping; a key that stands twice is a mistake, not a silent overwrite.

    Raises:
        InputError: The text is not YAML or not a mapping.
    """
    try:
        data = yaml.load(text, Loader=_Loader)  # noqa: S506  (a SafeLoader subclass)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        place = f" at line {mark.line + 1}, column {mark.column + 1}" if mark else ""
        problem = getattr(error, "problem", None) or str(error)
        raise InputError(f"not valid YAML{place}: {problem}", file=file) from None
    if not isinstance(data, dict):
        raise InputError(f"expected a YAML mapping, found {type(data).__name__}", file=file)
    return data


def load(schema: type[SchemaType], path: str | Path) -> SchemaType:
    """Read and validate one file.

    Raises:
        InputError: The file is missing, is no YAML, or breaks the schema. The message names file, key, value and
            what was expected with its unit.
    """
    return validate(schema, load_mapping(path), path)


def load_mapping(path: str | Path) -> dict[str, Any]:
    """Read one file without validating it.

    Raises:
        InputError: The file is missing, is no YAML, or no mapping.
    """
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot be read: {error}", file=path) from None
    return parse_yaml(text, path)


def validate(schema: type[SchemaType], data: dict[str, Any], file: str | Path) -> SchemaType:
    """Validate parsed data against ``schema``; ``file`` only names the place in errors.

    Raises:
        InputError: As :func:`load`; the first mistake is spelled out, the number of others is given.
    """
    try:
        return schema.model_validate(data)
    except ValidationError as error:
        raise _input_error(schema, error, file) from None


def _input_error(schema: type[Schema], error: ValidationError, file: str | Path) -> InputError:
    mistakes = error.errors(include_url=False)
    # A misspelt key is unknown and also missing; the unknown one tells what was meant.
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
        message = first["msg"].removeprefix("Value error, ").removeprefix("Assertion failed, ")
        message = message.replace("Input should be", "expected").replace("Field required", "missing")
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
