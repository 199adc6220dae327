# SPDX-License-Identifier: Apache-2.0
"""Predictions while a slider moves: the impact map of a scenario with some of its values changed.

Every slider is a key of the scenario, so the page shows what ``impact-rs map --uncertainty --set KEY=VALUE`` prints,
and the answer contains the command. The interval comes from :mod:`impact_rs_sim.impact_map.uncertainty`; while a slider
moves, and along a band, it comes from a few draws, always the same ones, so that it does not flicker.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np
from pydantic import Field

from impact_rs_analysis.application.nominal_impact import planned_impact, velocities_before
from impact_rs_analysis.report.figures import MODEL_STYLE
from impact_rs_analysis.report.scene_3d import scene_data
from impact_rs_commands.predicting import MAP
from impact_rs_control.plan import LARGEST_SCALE
from impact_rs_sim.errors import InputError
from impact_rs_sim.impact_map import ImpactMapError, ImpactProblem, predict_impact
from impact_rs_sim.impact_map.uncertainty import UncertainPrediction, interval_of_draws, predict
from impact_rs_sim.impact_map.uniqueness import uniqueness_of
from impact_rs_sim.model import Model
from impact_rs_sim.numbers import CONFIDENCE_LEVEL
from impact_rs_sim.physics import MOTOR_INERTIA_MODELS, Physics
from impact_rs_sim.rotations import quaternion_of
from impact_rs_sim.scenarios.scenario import Scenario
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_sim.scenarios.trial_settings import Uncertainties
from impact_rs_sim.scene import Scene, standing
from impact_rs_sim.schema import Schema

NOTHING = Model(name="nominal")
MOVING_DRAWS = 16  # while a slider moves; the interval of so few is too narrow by about a tenth
SWEEP_POINTS = 13
SPEED = "speed"  # slider without a key of the scenario: a factor on the ante_velocity of every arm

Ends = dict[str, tuple[float, float]]  # of intervals, by velocity
Setting = float | tuple[float, float, float]


@dataclass(frozen=True)
class Slider:
    """A number of the scenario that can be varied.

    Attributes:
        key: Key of the scenario, or ``speed``.
        label: Short name.
        unit: Unit, ``-`` where it has none.
        value: Value of the scenario.
        low: Left end.
        high: Right end.
        meaning: Meaning in a sentence.
        page: Page of the manual.
        known: Whether it is an uncertainty.
    """

    key: str
    label: str
    unit: str
    value: float
    low: float
    high: float
    meaning: str
    page: str = "physics.md"
    known: bool = False


class MapQuery(Schema):
    """Inputs of one prediction by the impact map."""

    scenario: str = Field(description="name, or path of a file in the folder")
    object: str = Field(description="object of the scenario")
    case: str = Field(description="case of the scenario")
    arm: str = Field("", description="arm of the figure and of the budget; empty: the first")
    model: str = Field("nominal", description="model file of the folder, or nominal")
    motor_inertia: Literal["reduced", "rotor", "zero"] = Field("reduced", description="motor-inertia model")
    values: dict[str, float] = Field({}, description="sliders that were moved, by key")
    moving: bool = Field(False, description="whether a slider is being moved: fewer draws, nothing that takes long")


def sliders_of(scenario: Scenario, object_name: str) -> tuple[Slider, ...]:
    """The sliders of an object, with an explanation of each."""
    target = scenario.object(object_name)
    widths = Uncertainties.model_fields
    return (
        Slider(SPEED, "ante-impact speed", "×", 1.0, 0.3, 1.4, "factor on the velocity of every arm before the impact"),
        *(
            Slider(f"objects.{object_name}.mass", "object mass", "kg", mass, 0.25 * mass, 2.5 * mass,
                   "mass of the object")
            for mass in (target.mass,) if mass is not None
        ),
        Slider("contact.restitution", "restitution e", "-", scenario.contact.restitution, 0.0, 1.0,
               "normal velocity after over before, with the sign turned (Newton)"),
        Slider("contact.friction", "pad friction µ", "-", scenario.contact.friction, 0.0, 1.2,
               "Coulomb friction between pad and object"),
        Slider("support.friction", "support friction µ", "-", scenario.support.friction, 0.0, 1.2,
               "Coulomb friction between object and support"),
        *(
            Slider(f"uncertainty.{name}", name.replace("_", " "), "± relative", getattr(scenario.uncertainty, name),
                   0.0, max(0.3, getattr(scenario.uncertainty, name)), str(widths[name].description), "scenarios.md",
                   True)
            for name in widths if str(widths[name].description).find("relative") >= 0
        ),
    )  # fmt: skip


def settings_of(scenario: Scenario, query: MapQuery) -> dict[str, Setting]:
    """Settings of the scenario by the moved sliders, by dotted key.

    Raises:
        InputError: There is no such slider.
    """
    settings: dict[str, Setting] = {}
    for key, value in query.values.items():
        if slider_of(scenario, query.object, key).key != SPEED:
            settings[key] = value
            continue
        case = scenario.case_name(query.case)
        for name, robot in scenario.cases[case].robots.items():
            x, y, z = (float(f"{value * speed:.6g}") for speed in robot.ante_velocity)
            settings[f"cases.{case}.robots.{name}.ante_velocity"] = (x, y, z)
    return settings


def map_arguments(scenario: str, model: str, query: MapQuery, settings: Mapping[str, Setting]) -> list[str]:
    """Equivalent arguments of ``impact-rs``; scenario and model as on the command line."""
    selection = {"object": query.object, "case": query.case, "motor_inertia": query.motor_inertia}
    changed = tuple(f"{key}={_yaml(value)}" for key, value in settings.items())
    return MAP.words({"scenario": scenario, **selection, "uncertainty": True, "model": model, "settings": changed})


def _yaml(value: Setting) -> str:
    return f"{value:.6g}" if isinstance(value, float) else f"[{', '.join(f'{component:.6g}' for component in value)}]"


def answer(
    scenario: Scenario, query: MapQuery, model: Model = NOTHING, stopped: Callable[[], bool] = lambda: False
) -> dict[str, Any]:
    """Velocities before and after with their intervals, impulses, and the shares of the sources.

    Args:
        scenario: The scenario.
        query: Its inputs.
        model: Effects beyond the scenario's nominal physics.
        stopped: Whether the answer is no longer wanted.

    Raises:
        Stopped: ``stopped`` said so.
        InputError: The scenario has no such object, case, arm or value, or the query has no answer.
        ImpactMapError: No answer was found.
    """
    arm = _arm(scenario, query)
    scene, problem = _problem(scenario, query, model)
    result = predict_impact(problem)
    uncertainties = scene.scenario.uncertainty
    uncertain: UncertainPrediction | None = None
    ends: Ends = {}
    note = ""
    try:
        if query.moving:
            names, low, high = interval_of_draws(problem, uncertainties, scene.models, MOVING_DRAWS)
        else:
            uncertain = predict(problem, uncertainties, scene.models, stopped=stopped)
            names, low, high = uncertain.names, uncertain.low, uncertain.high
        ends = dict(zip(names, zip(low.tolist(), high.tolist(), strict=True), strict=True))
    except (InputError, ImpactMapError) as error:  # velocities are known all the same
        note = f"no interval: {error}"
    if not query.moving:
        note = note or (uniqueness_of(problem, scene.models).warning or "")
    before = velocities_before(scene)
    bodies = [(name, before[name], twist) for name, twist in result.end_effector_twist.items()]
    bodies.append(("object", scene.object.twist, result.object_twist))
    rows = [
        _row(body, axis, ante[index], post[index], ends, axis == scenario.axis)
        for body, ante, post in bodies
        for index, axis in enumerate("xyz")
    ]
    impulses = {name: np.zeros(3) for name in scene.arms}
    for contact in result.contacts:
        if contact.body_b in impulses:
            impulses[contact.body_b] = impulses[contact.body_b] + contact.impulse
    return {
        "axis": scenario.axis,
        "rows": rows,
        "arm": arm,
        "impulses": {name: impulse.tolist() for name, impulse in impulses.items()},
        "moment": _moment(scene, rows),
        "budget": _budget(uncertain, f"{arm}.velocity.{scenario.axis}"),
        "interval": None
        if uncertain is None
        else {"level": CONFIDENCE_LEVEL, "method": uncertain.method, "draws": uncertain.draws},
        "moving": query.moving,
        "residual": result.residual.largest,
        "note": note,
    }


def _moment(scene: Scene, rows: list[dict[str, Any]]) -> dict[str, Any]:
    """The impact as the picture shows it: where joints and object are, and velocities with the ends of intervals."""
    jumps = []
    for body in (*scene.arms, *(() if scene.scenario.excursion is not None else ("object",))):
        rows_of_body = [row for row in rows if row["body"] == body]
        has_interval = all(row["low"] is not None for row in rows_of_body)
        jumps.append(
            {
                "arm": None if body == "object" else body,
                "before": [row["before"] for row in rows_of_body],
                "after": [row["after"] for row in rows_of_body],
                "low": [row["low"] for row in rows_of_body] if has_interval else None,
                "high": [row["high"] for row in rows_of_body] if has_interval else None,
            }
        )
    pose, *neighbour_poses = (
        (*body.position.tolist(), *quaternion_of(body.rotation).tolist())
        for body in (scene.object, *standing(scene.physics, scene.object))
    )
    return {
        "joints": np.concatenate([arm.position for arm in scene.arms.values()]).tolist(),
        "object": pose,
        "neighbours": neighbour_poses,
        "jumps": jumps,
    }


def scene_of(path: str, object_name: str) -> dict[str, Any]:
    """Arms, support and object of a scenario as the picture draws them.

    Raises:
        InputError: There is no such scenario or object.
    """
    return scene_data(Physics.nominal(load_scenario(path), object_name))


def _row(body: str, axis: str, ante: float, post: float, ends: Ends, main: bool) -> dict[str, Any]:
    low, high = ends.get(f"{body}.velocity.{axis}", (None, None))
    ante, post = float(ante), float(post)
    return {"body": body, "axis": axis, "main": main, "before": ante, "after": post, "low": low, "high": high}


def _budget(uncertain: UncertainPrediction | None, name: str) -> list[dict[str, Any]]:
    """Shares of the sources in the variance of a velocity, the largest first."""
    if uncertain is None:
        return []
    index = uncertain.names.index(name)
    shares = {source: float(rows[index]) for source, rows in uncertain.budget.items()}
    return [
        {"source": source.replace("_", " "), "share": share}
        for source, share in sorted(shares.items(), key=lambda entry: -entry[1])
        if share >= 0.005
    ]


def _arm(scenario: Scenario, query: MapQuery) -> str:
    """The arm of the query.

    Raises:
        InputError: There is no such arm.
    """
    arm = query.arm or next(iter(scenario.robots))
    if arm not in scenario.robots:
        raise InputError(f"scenario {scenario.name!r} has no arm {arm!r}; known: {', '.join(scenario.robots)}")
    return arm


def _problem(scenario: Scenario, query: MapQuery, model: Model) -> tuple[Scene, ImpactProblem]:
    scenario.check_chains("the workbench, which draws them,")
    changed = scenario.with_settings(settings_of(scenario, query))
    return planned_impact(changed, query.object, query.case, model, query.motor_inertia)


@dataclass(frozen=True)
class SweepPoint:
    """Velocities along the scenario's axis after the impact at one place of a slider [m/s]; None: no answer.

    Attributes:
        value: Where the slider is.
        arms: Velocity of the chosen arm, by motor inertia.
        object: Velocity of the object, with the chosen motor inertia.
        low: Lower end of the arm's interval.
        high: Upper end of it.
    """

    value: float
    arms: dict[str, float | None]
    object: float | None = None
    low: float | None = None
    high: float | None = None


def slider_of(scenario: Scenario, object_name: str, key: str) -> Slider:
    """One slider.

    Raises:
        InputError: There is no such slider.
    """
    sliders = {slider.key: slider for slider in sliders_of(scenario, object_name)}
    if key not in sliders:
        raise InputError(f"no slider {key!r}; known: {', '.join(sliders)}")
    return sliders[key]


def sweep(scenario: Scenario, query: MapQuery, slider: Slider, model: Model = NOTHING) -> Iterator[SweepPoint]:
    """Points over one slider, computed lazily."""
    for value in np.linspace(slider.low, slider.high, SWEEP_POINTS):
        query_at_value = query.model_copy(update={"values": {**query.values, slider.key: float(value)}})
        yield _point(scenario, query_at_value, model, float(value))


def _point(scenario: Scenario, query: MapQuery, model: Model, value: float) -> SweepPoint:
    arms: dict[str, float | None] = dict.fromkeys(MOTOR_INERTIA_MODELS)
    object_velocity = low = high = None
    axis, arm = scenario.axis_index, _arm(scenario, query)
    try:
        scene, problem = _problem(scenario, query, model)
        for name in arms:
            result = predict_impact(ImpactProblem.at_nominal_impact(scene, name))
            arms[name] = float(result.end_effector_twist[arm][axis])
            if name == query.motor_inertia:
                object_velocity = float(result.object_twist[axis])
        names, lows, highs = interval_of_draws(problem, scene.scenario.uncertainty, scene.models, MOVING_DRAWS)
        index = names.index(f"{arm}.velocity.{scenario.axis}")
        low, high = float(lows[index]), float(highs[index])
    except (InputError, ImpactMapError):  # a value at which there is no answer leaves a gap
        pass
    return SweepPoint(value, arms, object_velocity, low, high)


def drawn(query: MapQuery, slider: Slider, points: Sequence[SweepPoint]) -> dict[str, Any]:
    """Points of a sweep as the page draws them."""
    return {
        "slider": asdict(slider),
        "x": [point.value for point in points],
        "lines": [
            {
                "label": label,
                "colour": colour,
                "y": [point.arms[name] for point in points],
                "chosen": name == query.motor_inertia,
            }
            for name, (label, colour, _) in MODEL_STYLE.items()
        ],
        "object": [point.object for point in points],
        "low": [point.low for point in points],
        "high": [point.high for point in points],
    }


def describe(name: str, path: str) -> dict[str, Any]:
    """Choices in a scenario.

    Raises:
        InputError: There is no such scenario, or it breaks its schema.
    """
    scenario = load_scenario(path)
    arms = {arm: robot.facts_name for arm, robot in scenario.robots.items()}
    return {
        "name": name,
        "description": scenario.description,
        "axis": scenario.axis,
        "arms": arms,
        "hits": scenario.excursion is None,
        "scales": list(scenario.velocity_scales),
        "largest_scale": LARGEST_SCALE,
        "trials": scenario.trials,
        "objects": {
            key: {"label": object_spec.label, "mass": object_spec.mass} for key, object_spec in scenario.objects.items()
        },
        "cases": {key: case.label for key, case in scenario.cases.items()},
        "sliders": {key: [asdict(slider) for slider in sliders_of(scenario, key)] for key in scenario.objects},
    }
