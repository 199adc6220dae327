# SPDX-License-Identifier: Apache-2.0
"""``impact-rs map``: one prediction of the impact map."""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from impact_rs_analysis.application.nominal_impact import planned_impact, velocities_before
from impact_rs_cli.arguments import settings_of, started_workers
from impact_rs_cli.terminal import Terminal
from impact_rs_sim.errors import InputError
from impact_rs_sim.impact_map import ImpactProblem, predict_impact
from impact_rs_sim.impact_map.derivatives import Derivatives, differentiate
from impact_rs_sim.impact_map.problem import ImpactResult
from impact_rs_sim.impact_map.uncertainty import UncertainPrediction, predict
from impact_rs_sim.impact_map.uniqueness import CHOICE, Uniqueness, uniqueness_of
from impact_rs_sim.model import Model, load_model
from impact_rs_sim.numbers import CONFIDENCE_LEVEL, estimate_text
from impact_rs_sim.physics import assumed_words
from impact_rs_sim.scenarios.scenario import Scenario
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_sim.scene import Scene
from impact_rs_trials.map_table import answer_table, check_answers, write_answers
from impact_rs_trials.recordings.impacts.impact_table import read_impact_table

MAX_SHOWN_SWITCHES = 3  # all are in the JSON document
UNUSED = ("drive.stiffness", "drive.damping")  # by the rigid impact map
MIN_SWITCH_SHARE = 0.01  # of the draws; rarer switches are not shown


@dataclass(frozen=True)
class _Answers:
    """Answers to one request; None: not asked for."""

    result: ImpactResult
    several: Uniqueness | None
    prediction: UncertainPrediction | None
    slopes: Derivatives | None


def run(args: argparse.Namespace, terminal: Terminal) -> int:
    """Run the command."""
    if args.table is not None:
        return _many(args, terminal)
    if args.scenario is None or args.object is None or args.case is None:
        raise InputError("expected SCENARIO OBJECT CASE, or --table FILE -o FILE")
    scenario = load_scenario(args.scenario).with_settings(settings_of(args))
    scenario.object(args.object)
    model = load_model(args.model)
    scene, problem = planned_impact(scenario, args.object, args.case, model, args.motor_inertia)
    answers = _solved(args, scenario, scene, problem)
    terminal.result(_document(args, scenario, model, scene, answers))
    _show(args, scenario, model, scene, answers, terminal)
    return 0


def _solved(args: argparse.Namespace, scenario: Scenario, scene: Scene, problem: ImpactProblem) -> _Answers:
    first_only = args.engine == "bullet" or args.uncertainty or args.derivatives or args.restitution_law
    if args.contact == "settled" and first_only:
        raise InputError(
            "--engine bullet, --uncertainty, --derivatives and --restitution-law are for the first contact only; leave "
            "them out with --contact settled"
        )
    if args.restitution_law:
        problem = replace(problem, restitution_law=args.restitution_law)
    return _Answers(
        result=predict_impact(problem, args.contact, args.engine),
        several=uniqueness_of(problem, scene.models) if args.contact == "first" else None,
        prediction=predict(problem, scenario.uncertainty, scene.models) if args.uncertainty else None,
        slopes=differentiate(problem, scene.models) if args.derivatives else None,
    )


def _assumed(scene: Scene) -> dict[str, list[str]]:
    """Assumed numbers that the rigid map uses, by arm."""
    return {name: [item for item in arm.assumed if item not in UNUSED] for name, arm in scene.physics.arms.items()}


def _document(
    args: argparse.Namespace, scenario: Scenario, model: Model, scene: Scene, answers: _Answers
) -> dict[str, Any]:
    """Answer of ``--json``."""
    before = velocities_before(scene)
    return {
        "scenario": scenario.name,
        "object": args.object,
        "case": scene.case_name,
        "model": model.name,
        "motor_inertia": args.motor_inertia,
        "contact": args.contact,
        "assumed": {name: words for name, words in _assumed(scene).items() if words},
        "ante": {
            "end_effector_twist": {name: twist.tolist() for name, twist in before.items()},
            "joint_position": {name: arm.position.tolist() for name, arm in scene.arms.items()},
            "joint_velocity": {name: arm.velocity.tolist() for name, arm in scene.arms.items()},
        },
        "post": {
            "end_effector_twist": {name: twist.tolist() for name, twist in answers.result.end_effector_twist.items()},
            "joint_velocity": {name: velocity.tolist() for name, velocity in answers.result.joint_velocity.items()},
            "object_twist": answers.result.object_twist.tolist(),
            **{f"{name}_twist": twist.tolist() for name, twist in answers.result.neighbour_twists.items()},
        },
        "contacts": [
            {
                "body_a": contact.body_a,
                "body_b": contact.body_b,
                "position": contact.position.tolist(),
                "normal": contact.normal.tolist(),
                "impulse": contact.impulse.tolist(),
            }
            for contact in answers.result.contacts
        ],
        **({} if answers.several is None else {"uniqueness": _uniqueness(answers.several)}),
        **({} if answers.prediction is None else {"uncertainty": _uncertainty(answers.prediction)}),
        **({} if answers.slopes is None else {"derivatives": _derivatives(answers.slopes)}),
        "residual": {name: float(value) for name, value in vars(answers.result.residual).items()},
        "engine": answers.result.engine,
        "iterations": answers.result.iterations,
        "elapsed_ms": 1e3 * answers.result.elapsed,
    }


def _show(
    args: argparse.Namespace, scenario: Scenario, model: Model, scene: Scene, answers: _Answers, terminal: Terminal
) -> None:
    before = velocities_before(scene)
    labels = f"{scenario.object(args.object).label}, {scenario.case(args.case).label}"
    of_model = f", model {model.name!r}" if model.effects else ""
    terminal.say(f"{scenario.name}: {labels}{of_model}, motor inertia '{args.motor_inertia}', contact '{args.contact}'")
    for name, twist in answers.result.end_effector_twist.items():
        terminal.say(f"  {name:<8} v before {_vector(before[name][:3])} m/s, after {_vector(twist[:3])} m/s")
    for name, twist in answers.result.twists.items():
        terminal.say(f"  {name:<8} v after  {_vector(twist[:3])} m/s")
    total = sum((c.impulse for c in answers.result.contacts if c.body_b in scene.physics.pads), np.zeros(3))
    terminal.say(
        f"  impulse of the pads on the object {_vector(total)} N s; {answers.result.engine}, "
        f"residual {answers.result.residual.largest:.1e}, {1e3 * answers.result.elapsed:.1f} ms"
    )
    if answers.prediction is not None:
        _say_uncertainty(answers.prediction, terminal)
    if answers.slopes is not None:
        _say_derivatives(answers.slopes, f"{next(iter(scene.arms))}.velocity.{scenario.axis}", terminal)
    if note := assumed_words(_assumed(scene)):
        terminal.say(f"note: {note}")
    if answers.several is not None and answers.several.warning:
        terminal.warn(answers.several.warning)


def _many(args: argparse.Namespace, terminal: Terminal) -> int:
    """Answer a table."""
    if args.output is None:
        raise InputError("--table needs -o FILE for the answers (.csv or .parquet)")
    if args.object is not None or args.uncertainty or args.derivatives or args.restitution_law or args.settings:
        raise InputError("with --table give at most a SCENARIO; its columns hold everything else")
    if str(args.model) != "nominal":
        raise InputError("--model is for one prediction; rows of a --table have the scenario's own physics")
    check_answers(args.output)
    scenario = load_scenario(args.scenario) if args.scenario is not None else None
    table = read_impact_table(args.table, scenario, questions=True)
    with started_workers(args) as map_tasks:
        answers = answer_table(table, map_tasks)
    write_answers(table, answers, args.output)
    for number, message in answers.messages.items():
        terminal.warn(f"row {number}: {message}")
    terminal.result(
        {"rows": len(table.rows), "answered": len(table.rows) - len(answers.messages), "output": str(args.output)}
    )
    terminal.say(f"{len(table.rows) - len(answers.messages)} of {len(table.rows)} rows answered: {args.output}")
    return 0


def _uniqueness(several: Uniqueness) -> dict[str, Any]:
    """Spread of the solutions of the contact laws, as JSON."""
    return {
        "spread": several.spread,
        "relative": several.relative,
        "unique": several.unique,
        "answers": several.answers,
        "choice": CHOICE,
    }


def _uncertainty(prediction: UncertainPrediction) -> dict[str, Any]:
    """Intervals and budgets as JSON."""
    return {
        "level": CONFIDENCE_LEVEL,
        "method": prediction.method,
        "switched": prediction.switched,
        "switches": dict(prediction.switches),
        "draws": prediction.draws,
        "without_answer": prediction.without_answer,
        "interval": {
            name: {"value": value, "low": low, "high": high}
            for name, value, low, high in zip(
                prediction.names,
                prediction.nominal.tolist(),
                prediction.low.tolist(),
                prediction.high.tolist(),
                strict=True,
            )
        },
        "budget": {
            name: {source: float(share[index]) for source, share in prediction.budget.items()}
            for index, name in enumerate(prediction.names)
        },
    }


def _say_uncertainty(prediction: UncertainPrediction, terminal: Terminal) -> None:
    """Intervals of linear velocities, with their largest sources."""
    method = (
        "linear propagation"
        if prediction.method == "linear"
        else f"{prediction.draws} draws, contacts switch in {prediction.switched:.0%}"
    )
    terminal.say(f"  {CONFIDENCE_LEVEL:.0%} intervals from the stated uncertainties ({method}):")
    for switch, share in [entry for entry in prediction.switches.items() if entry[1] >= MIN_SWITCH_SHARE][
        :MAX_SHOWN_SWITCHES
    ]:
        terminal.say(f"    in {share:.0%} of the draws {switch}")
    for index, name in enumerate(prediction.names):
        if ".velocity." not in name:
            continue
        shares = sorted(((float(share[index]), source) for source, share in prediction.budget.items()), reverse=True)[
            :3
        ]
        most = ", ".join(f"{source} {share:.0%}" for share, source in shares if share >= 0.01)
        low, high = prediction.low[index], prediction.high[index]
        value, *ends = estimate_text(float(prediction.nominal[index]), (float(low), float(high)), least=4)
        terminal.say(f"    {name:<20} {value:>8} m/s  [{', '.join(ends)}]  {most}")


def _derivatives(derivatives: Derivatives) -> dict[str, Any]:
    """Derivatives as JSON, velocity by velocity and parameter by parameter."""
    return {
        "states": list(derivatives.states),
        "margin_m_s": None if np.isinf(derivatives.margin) else derivatives.margin,
        "smooth": derivatives.smooth,
        "unit": {parameter.name: parameter.unit for parameter in derivatives.parameters},
        "of": {
            name: dict(zip((parameter.name for parameter in derivatives.parameters), row.tolist(), strict=True))
            for name, row in zip(derivatives.names, derivatives.jacobian, strict=True)
        },
    }


def _say_derivatives(derivatives: Derivatives, name: str, terminal: Terminal) -> None:
    """Derivatives of one velocity; all of them are in the JSON document."""
    row = derivatives.jacobian[derivatives.names.index(name)]
    states = ", ".join(f"{derivatives.states.count(state)} {state}" for state in dict.fromkeys(derivatives.states))
    terminal.say(
        f"  derivatives of {name}, contacts as they are ({states or 'none'}; the nearest change of state is "
        f"{derivatives.margin:.2g} m/s away); of all velocities with --json:"
    )
    for parameter, value in zip(derivatives.parameters, row, strict=True):
        if abs(value) > 1e-7:
            per = "" if parameter.unit == "-" else f" per {parameter.unit}"
            terminal.say(f"    {parameter.name:<28} {value:+11.4g} m/s{per}")


def _vector(values: Any) -> str:
    return "[" + ", ".join(f"{value + 0.0:.3f}" for value in values) + "]"
