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
from impact_rs_sim.scenarios.scenario_files import load_scenario
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


def _matching(pattern: str, expected: str) -> AfterValidator:
    """Validator of a text that matches ``pattern``, so that it cannot be read as an option."""

    def checked(value: str) -> str:
        if re.fullmatch(pattern, value) is None:
            raise ValueError(f"expected {expected}")
        return value

    return AfterValidator(checked)


PathName = Annotated[str, Field(min_length=1, max_length=1000)]
Plain = Annotated[
    str, Field(max_length=200), _matching(r"[A-Za-z0-9_][A-Za-z0-9_.+-]*", "a name of letters, digits, _, -, + and .")
]
TYPES: dict[str, Any] = {
    "whole": int,
    "number": float,
    "switch": bool,
    "address": Annotated[
        str,
        Field(max_length=200),
        _matching(r"(tcp|tls|ucx|ws)://[A-Za-z0-9_.:\[\]-]+", "an address such as tcp://10.0.0.1:8786"),
    ],
    "text": Annotated[
        str, Field(max_length=1000), _matching(r"[^\s-].*", "a text in one line that does not begin with -")
    ],
    "setting": Annotated[str, Field(max_length=1000), _matching(r"[A-Za-z0-9_][^=]*=.+", "KEY=VALUE")],
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
        suggestion = did_you_mean(name, FORMS) if isinstance(name, str) else ""
        raise InputError(f"expected one of {', '.join(FORMS)}{suggestion}", key="command", value=name)
    command = FORMS[name]
    given = {key: value for key, value in data.items() if value is not None}  # null: the default of the option
    form_values = dict(validate(schema_of(command), given, None))
    values = {option.name: _value_of(workspace, option, form_values[option.name]) for option in options_of(command)}
    if name in CHECKS:
        CHECKS[name](workspace, form_values)
    return Order(name, tuple(command.words(values)), _writes(workspace, command, form_values))


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


def _value_of(workspace: Workspace, option: Option, value: Any) -> Any:
    """Value of an option on the command line."""
    if value is None or isinstance(value, bool):
        return value
    if option.many:
        return tuple(_word(workspace, option, item) for item in value)
    return _word(workspace, option, value)


def _word(workspace: Workspace, option: Option, value: Any) -> Any:
    if option.kind in WRITTEN:
        return terminal_path(workspace.inside(value))
    if option.kind in NAMED:
        return terminal_name(workspace, value, option.name)
    if option.kind in READ and value != NOMINAL:
        return terminal_path(workspace.existing(value))
    return value


def _writes(workspace: Workspace, command: Command, form_values: Mapping[str, Any]) -> tuple[Path, ...]:
    """Output of a command; an analysis without a folder for it writes beside the trials."""
    writes = tuple(workspace.inside(form_values[name]) for name in command.written if form_values[name] is not None)
    if command.name == "analyze" and not writes:
        return (workspace.existing(form_values["directory"]) / "report",)
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
    form_values = {option: options[option.name] for option in options_of(command) if option.name in options}
    return {
        option.name: workspace.name(workspace.inside(value))
        if option.kind in (*NAMED, *READ) and Path(str(value)).is_absolute()
        else value
        for option, value in form_values.items()
    }


def _check_campaign(workspace: Workspace, form_values: Mapping[str, Any]) -> None:
    """Check the plan, or the scenario with its selection, as the command does first."""
    if form_values["plan"] is not None:
        read_plan(workspace.existing(form_values["plan"]))
        return
    if form_values["scenario"] is None:
        raise InputError("expected a scenario, or a plan", key="scenario")
    scenario = workspace.scenario_path(form_values["scenario"])
    make_manifest(
        scenario,
        form_values["objects"],
        form_values["cases"],
        form_values["scales"],
        form_values["trials"],
        form_values["seed"],
    )


def _check_trial(workspace: Workspace, form_values: Mapping[str, Any]) -> None:
    """Check scenario, object, case and scale, as the command does first."""
    scenario = workspace.scenario_path(form_values["scenario"])
    make_manifest(
        scenario, [form_values["object"]], [form_values["case"]], [form_values["scale"]], 1, form_values["seed"]
    )


def _check_hits(workspace: Workspace, form_values: Mapping[str, Any]) -> None:
    """Check the scenario with its objects and cases, as the command does first."""
    scenario = load_scenario(workspace.scenario_path(form_values["scenario"]))
    for name in _names_of(form_values, "object"):
        scenario.object(name)
    for name in _names_of(form_values, "case"):
        scenario.case_name(name)


def _names_of(form_values: Mapping[str, Any], key: str) -> tuple[str, ...]:
    """Names under ``KEYs`` of a form, or the single name under ``KEY``."""
    name = form_values.get(key)
    return form_values.get(f"{key}s") or (() if name is None else (name,))


def _check_scenarios(workspace: Workspace, form_values: Mapping[str, Any]) -> None:
    """Check that the scenarios can be read, as the command does first."""
    for name in form_values["scenarios"] or ():
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


def terminal_path(path: Path) -> str:
    """A path on the command line: relative if it lies below the folder in which the workbench was started."""
    working_directory = Path.cwd()
    name = os.path.relpath(path, working_directory) if path.is_relative_to(working_directory) else str(path)
    return f"./{name}" if name.startswith("-") else name  # no option


def terminal_name(workspace: Workspace, name: str, key: str = "scenario") -> str:
    """A scenario, mapping or robot on the command line: name of a shipped one, or path of a file.

    Raises:
        InputError: The file lies outside the folder, or the name would be taken for an option.
    """
    if name.endswith((".yaml", ".yml")):
        return terminal_path(workspace.existing(name))
    if name.startswith("-"):
        raise InputError(f"expected the name of a {key}", key=key, value=name)
    return name
