# SPDX-License-Identifier: Apache-2.0
"""Forms of the page, made from the declarations of the commands, and the commands that filled-in forms become.

Paths come from the page as they are seen from the folder of the workbench, and go into the command as the terminal
sees them from where the workbench was started.
"""

from __future__ import annotations

import functools
import os
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, create_model

from impact_rs_commands import explaining, measuring, predicting
from impact_rs_commands.declaration import NAMED, READ, WRITTEN, Command, Option
from impact_rs_sim.errors import InputError, did_you_mean
from impact_rs_sim.scenarios.scenario import load_scenario
from impact_rs_sim.schema import Schema, validate
from impact_rs_trials.campaign import make_manifest
from impact_rs_trials.experiment_plan import read_plan
from impact_rs_workbench.jobs import Order
from impact_rs_workbench.workspace import NOMINAL, Workspace

FORMS: dict[str, Command] = {
    command.name: command
    for command in (
        measuring.CAMPAIGN,
        measuring.TRIAL,
        measuring.BLIND.actions[0],
        measuring.DESIGN,
        measuring.INVESTIGATE,
        measuring.REHEARSE,
        predicting.LIMITS,
        predicting.STUDY_DESIGN,
        explaining.IMPORT,
        explaining.IMPACTS,
        explaining.ANALYZE,
        explaining.COMPARE,
        explaining.DIAGNOSE,
        explaining.FOLLOW,
        explaining.DISCOVER,
        explaining.ADD,
        explaining.HISTORY,
        *explaining.EVIDENCE.actions,
    )
}


def _like(pattern: str, expected: str) -> AfterValidator:
    """A text that cannot be read as an option."""

    def checked(value: str) -> str:
        if re.fullmatch(pattern, value) is None:
            raise ValueError(f"expected {expected}")
        return value

    return AfterValidator(checked)


PathName = Annotated[str, Field(min_length=1, max_length=1000)]
Plain = Annotated[
    str, Field(max_length=200), _like(r"[A-Za-z0-9_][A-Za-z0-9_.+-]*", "a name of letters, digits, _, -, + and .")
]
TYPES: dict[str, Any] = {
    "whole": int,
    "number": float,
    "switch": bool,
    "address": Annotated[
        str,
        Field(max_length=200),
        _like(r"(tcp|tls|ucx|ws)://[A-Za-z0-9_.:\[\]-]+", "an address such as tcp://10.0.0.1:8786"),
    ],
    "text": Annotated[str, Field(max_length=1000), _like(r"[^\s-].*", "a text in one line that does not begin with -")],
    "setting": Annotated[str, Field(max_length=1000), _like(r"[A-Za-z0-9_][^=]*=.+", "KEY=VALUE")],
    **dict.fromkeys((*NAMED, *READ, *WRITTEN), PathName),
}


def form_of(command: Command) -> dict[str, Any]:
    """A form as the page draws it."""
    fields = [
        {name: getattr(option, name) for name in ("name", "kind", "unit", "choices", "default", "least", "most")}
        | {name: getattr(option, name) for name in ("required", "many", "advanced", "otherwise")}
        | {"label": option.label or option.name.replace("_", " "), "help": option.help}
        | {"spelled": " ".join((*option.flags[:1], option.metavar))}
        for option in options_of(command)
    ]
    return {"command": command.name, "fields": fields}


def options_of(command: Command) -> tuple[Option, ...]:
    """The options that a form has: all but ``--json``, whose document the page shows itself."""
    return tuple(option for option in command.options if option.kind != "json")


def order_of(data: Any, workspace: Workspace) -> Order:
    """The command that a form asks for.

    Raises:
        InputError: A value is missing or cannot be; or a path leads out of the folder, or to nothing.
    """
    name = data.get("command") if isinstance(data, dict) else None
    if not isinstance(name, str) or name not in FORMS:
        near = did_you_mean(name, FORMS) if isinstance(name, str) else ""
        raise InputError(f"expected one of {', '.join(FORMS)}{near}", key="command", value=name)
    command = FORMS[name]
    given = dict(validate(schema_of(command), data, None))
    values = {one.name: _argument(workspace, one, given[one.name]) for one in options_of(command)}
    if name in CHECKS:
        CHECKS[name](workspace, given)
    return Order(name, tuple(command.words(values)), _writes(workspace, command, given))


@functools.cache
def schema_of(command: Command) -> type[Schema]:
    """Required content of a form: the options of the command, each with values of its kind."""
    fields: dict[str, Any] = {option.name: _field(option) for option in options_of(command)}
    return create_model(f"form of {command.name}", __base__=Schema, command=(str, ...), **fields)


def _field(option: Option) -> tuple[Any, Any]:
    """Type and default of an option."""
    kind: Any = Literal[option.choices] if option.choices else TYPES.get(option.kind, Plain)
    if option.many:
        kind = Annotated[tuple[kind, ...], Field(min_length=1)]
    limits: dict[str, Any] = {"ge": option.least, "le": option.most}
    return (kind, Field(**limits)) if option.required else (kind | None, Field(option.default, **limits))


def _argument(workspace: Workspace, option: Option, value: Any) -> Any:
    """A value as the command line has it."""
    if value is None or isinstance(value, bool):
        return value
    if option.many:
        return tuple(_word(workspace, option, one) for one in value)
    return _word(workspace, option, value)


def _word(workspace: Workspace, option: Option, value: Any) -> Any:
    if option.kind in WRITTEN:
        return seen(workspace.inside(value))
    if option.kind in NAMED:
        return named(workspace, value, option.name)
    if option.kind in READ and value != NOMINAL:
        return seen(workspace.existing(value))
    return value


def _writes(workspace: Workspace, command: Command, given: Mapping[str, Any]) -> tuple[Path, ...]:
    """Output of a command; an analysis without a folder for it writes beside the trials."""
    writes = tuple(workspace.inside(given[name]) for name in command.written if given[name] is not None)
    if command.name == "analyze" and not writes:
        return (workspace.existing(given["directory"]) / "report",)
    return writes


def values_of(workspace: Workspace, command: Command, options: Mapping[str, Any]) -> dict[str, Any]:
    """Options of a document (with absolute paths) as values of a form, with paths as they are seen from the folder.

    Args:
        workspace: The folder.
        command: Whose form.
        options: Options by name; those that the form does not have are left out.

    Raises:
        InputError: A path leads out of the folder.
    """
    given = {option: options[option.name] for option in options_of(command) if option.name in options}
    return {
        option.name: workspace.name(workspace.inside(value))
        if option.kind in (*NAMED, *READ) and Path(str(value)).is_absolute()
        else value
        for option, value in given.items()
    }


def _check_campaign(workspace: Workspace, given: Mapping[str, Any]) -> None:
    """What the command checks first."""
    if given["plan"] is not None:
        read_plan(workspace.existing(given["plan"]))
        return
    if given["scenario"] is None:
        raise InputError("expected a scenario, or a plan", key="scenario")
    scenario = workspace.scenario_path(given["scenario"])
    make_manifest(scenario, given["objects"], given["cases"], given["scales"], given["trials"], given["seed"])


def _check_trial(workspace: Workspace, given: Mapping[str, Any]) -> None:
    """What the command checks first."""
    scenario = workspace.scenario_path(given["scenario"])
    make_manifest(scenario, [given["object"]], [given["case"]], [given["scale"]], 1, given["seed"])


def _check_hits(workspace: Workspace, given: Mapping[str, Any]) -> None:
    """What the command checks first: the scenario with its objects and cases."""
    scenario = load_scenario(workspace.scenario_path(given["scenario"]))
    for name in _named(given, "object"):
        scenario.object(name)
    for name in _named(given, "case"):
        scenario.case_name(name)


def _named(given: Mapping[str, Any], what: str) -> tuple[str, ...]:
    """What a form names, one of a kind or several of them."""
    one = given.get(what)
    return given.get(f"{what}s") or (() if one is None else (one,))


def _check_scenarios(workspace: Workspace, given: Mapping[str, Any]) -> None:
    """What the command checks first."""
    for name in given["scenarios"] or ():
        load_scenario(workspace.scenario_path(name))


CHECKS: dict[str, Callable[[Workspace, Mapping[str, Any]], None]] = {
    "campaign": _check_campaign,
    "design": _check_scenarios,
    "investigate": _check_scenarios,
    "limits": _check_hits,
    "rehearse": _check_hits,
    "study-design": _check_hits,
    "trial": _check_trial,
}


def seen(path: Path) -> str:
    """A path as the terminal sees it that started the workbench."""
    here = Path.cwd()
    name = os.path.relpath(path, here) if path.is_relative_to(here) else str(path)
    return f"./{name}" if name.startswith("-") else name  # no option


def named(workspace: Workspace, name: str, key: str = "scenario") -> str:
    """What the terminal calls a scenario, a mapping or a robot: the name of one that comes with impact_rs, or a file.

    Raises:
        InputError: The file lies outside the folder, or the name would be taken for an option.
    """
    if name.endswith((".yaml", ".yml")):
        return seen(workspace.existing(name))
    if name.startswith("-"):
        raise InputError(f"expected the name of a {key}", key=key, value=name)
    return name
