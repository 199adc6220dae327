# SPDX-License-Identifier: Apache-2.0
"""Grammar of laws: the formulas that ``impact-rs discover`` searches (``config/grammar.yaml``).

A law is a place, a quantity and a form, for example torque on a motor × joint velocity × cube. Units follow: an
amplitude of power n has the unit of the place over that of the quantity to the n. A law of a quantity that a
dissipative force opposes has the sign that dissipates; a law between two bodies includes its reaction.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field

from impact_rs_analysis.evidence.visited import Range
from impact_rs_sim.effects.dimensions import check_units
from impact_rs_sim.effects.formula import (
    COEFFICIENTS,
    PLACES,
    Coefficient,
    Formula,
    FormulaEffect,
    FormulaParameter,
    FormulaSpec,
)
from impact_rs_sim.errors import InputError
from impact_rs_sim.paths import config_directory
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.rotations import AXES
from impact_rs_sim.schema import Schema, load

GRAMMAR_FILE = "grammar.yaml"
MAX_AMPLITUDE = 300.0  # upper end of the range, in noticeable amplitudes
FREE_CURVE_KNOTS = (5, 9)  # the larger number if it predicts better
MAX_WAVE_NUMBER_STARTS = 24
MAX_WAVE_NUMBER = 80.0  # of a start, rad over the unit of the quantity
MIN_SPAN_SHARE = 1e-3  # of the typical size; smallest range of a quantity
ANCHOR_REACH = 4.0  # typical distances; largest distance of an anchor from the start of its fit
MIN_WIDTH_SHARE = 0.01  # of the range of the quantity


class QuantityShape(Schema):
    """A number in the formula of a quantity, such as a time constant."""

    unit: str = Field(description="unit")
    starts: tuple[float, ...] = Field(min_length=1, description="values from which fits start, above 0, in its unit")
    lower: float = Field(description="smallest value that makes sense")
    upper: float = Field(description="largest value that makes sense")

    @property
    def parameter(self) -> FormulaParameter:
        """The parameter of a formula; its noticeable change is a tenth of the geometric mean of the starts."""
        usual = float(np.exp(np.mean(np.log(self.starts))))
        return FormulaParameter(
            unit=self.unit, nominal=self.starts[0], lower=self.lower, upper=self.upper, scale=0.1 * usual, shape=True,
            grid=self.starts,
        )  # fmt: skip


class Quantity(Schema):
    """Quantity on which a law depends."""

    formula: str = Field(
        description="in symbols of formulas; {joint} is the joint of the place, {before} the one before"
    )
    unit: str = Field(description="unit")
    typical: float = Field(gt=0.0, description="its size if it was not measured, in its unit")
    words: str = Field(description="the quantity, in a sentence")
    opposes: bool = Field(False, description="whether a force that dissipates has the opposite sign")
    along: str = Field("", description="vector of which it is the norm, with {axis} for an axis; empty: none")
    of_place: str = Field(
        "",
        description="position whose distance from an anchor it is, with {axis}; anchor_x, ... are shapes",
    )
    shapes: dict[str, QuantityShape] = Field({}, description="numbers in its formula, by name")

    def vector(self, axis: str) -> str:
        """Formula of one component of the vector of which this is the norm; empty: this is no norm."""
        return (
            f"({self.of_place} - anchor_{{axis}})".format(axis=axis) if self.of_place else self.along.format(axis=axis)
        )


class Number(Schema):
    """A parameter of a form."""

    power: int = Field(
        0, description="n of an amplitude; its unit is that of the place over the n-th power of that of the quantity"
    )
    shape: Literal["", "limit", "width", "wave_number"] = Field(
        "", description="kind of a shape, which changes nothing while the amplitudes are 0; empty: an amplitude"
    )
    starts: tuple[float, ...] = Field(
        (),
        description="where fits of a shape start, as shares of the range of the quantity; of a wave number the angle "
        "over the range between two starts [rad]",
    )


class Form(Schema):
    """How a law depends on its quantity u."""

    law: str = Field(description="formula of u, the middle of its range, and the parameters")
    along: str = Field("", description="law over u, for a force along a vector; empty: not along a vector")
    numbers: dict[str, Number] = Field(min_length=1, description="its parameters")
    restores: bool = Field(False, description="whether it has the sign of a spring")
    words: str = Field(description="what it is, in a sentence")


class Place(Schema):
    """Load or coefficient to which a law adds."""

    formula: str = Field(description="key of a formula effect")
    each: Literal["joint", "pair", "opposed", "axis", "vector", "once"] | Coefficient = Field(
        "once",
        description="element with its own law; pair: two joints in a row with the same torque; opposed: the second "
        "joint has the reaction; a coefficient of formulas: coefficient of the contact of a single impact",
    )
    unit: str = Field(description="unit of the force or torque")
    noticeable: float = Field(gt=0.0, description="noticeable amplitude, in the unit")
    words: str = Field(description="what it is, in a sentence")
    contact: bool = Field(False, description="whether it acts in contact only")
    against: bool = Field(False, description="whether it is positive against the motion")
    needs: str = Field("", description="signal of free motion that shows the law; empty: no signal")
    laws: dict[str, tuple[str, ...]] = Field(description="forms by quantity")


class Grammar(Schema):
    """``config/grammar.yaml``."""

    quantities: dict[str, Quantity] = Field({}, description="quantities by name")
    forms: dict[str, Form] = Field({}, description="forms by name")
    places: dict[str, Place] = Field({}, description="places by name")


@dataclass(frozen=True)
class Law:
    """One formula with the points from which its fit starts.

    Attributes:
        spec: The formula effect.
        place: Name of its place in the grammar.
        where: Joint (``joint4``), two joints (``joint4_5``) or axis; empty: neither.
        quantity: Its quantity.
        symbol: Formula of the quantity.
        form: Name of its form.
        profile: The force over the quantity ``u``, without the sign by ``opposes``.
        needs: Signal of free motion that shows the law; empty: no signal.
        starts: Values of its shape parameters by name.
        words: The place, in words.
        unit: Unit of the force or torque.
        noticeable: Noticeable amplitude, in the unit.
        opposes: Whether the formula is minus the profile.
        reacts: Whether the second of two joints has the reaction.
        knots: Knots of a piecewise linear free curve; empty: a law.
    """

    spec: FormulaSpec
    place: str
    where: str
    quantity: Quantity
    symbol: str
    form: str
    profile: str
    needs: str
    starts: tuple[Mapping[str, float], ...]
    words: str
    unit: str
    noticeable: float
    opposes: bool
    reacts: bool = False
    knots: tuple[float, ...] = ()

    @property
    def joints(self) -> tuple[str, ...]:
        """Joints on which it acts, as ``joint4``; empty: a force, which may load all joints."""
        return _joints(self.where)

    @property
    def coefficient(self) -> str:
        """Contact coefficient that the law changes; empty: it acts during a motion."""
        return self.where if self.where in COEFFICIENTS else ""

    @property
    def formula(self) -> tuple[str, dict[str, str] | str]:
        """Key of the place in a formula effect, and the formulas of this key."""
        return next((key, table) for key in PLACES if (table := getattr(self.spec, key)))

    @property
    def effects(self) -> list[FormulaEffect]:
        """The effect at each of its starts."""
        effects = []
        for start in self.starts:
            parameters = {
                name: parameter.model_copy(update={"nominal": start.get(name, parameter.nominal)})
                for name, parameter in self.spec.parameters.items()
            }
            effects.append(FormulaEffect(self.spec.model_copy(update={"parameters": parameters}), self.family))
        return effects

    @property
    def family(self) -> str:
        """Key of the laws of one form at several joints; they may be accepted together."""
        where = "" if self.where.startswith("joint") else self.where
        return f"{self.place} {where} {self.quantity.words} {self.form}"

    def force(self, u: Array, numbers: Mapping[str, float]) -> Array:
        """Force without the sign by ``opposes`` at values ``u`` of the quantity, ``(k,)`` each [unit of the place]."""
        return np.broadcast_to(Formula(self.profile, {"u", *numbers})({"u": u, **numbers}), u.shape)

    def signed_force(self, u: Array, numbers: Mapping[str, float]) -> Array:
        """:meth:`force` with its sign; of a force along a vector the magnitude, ``(k,)`` [unit of the place]."""
        opposing = self.opposes and not self.quantity.vector(AXES[0])
        return -self.force(u, numbers) if opposing else self.force(u, numbers)


def load_grammar(more: Path | None = None) -> Grammar:
    """The shipped grammar with the terms of another file, which replace those of the same name.

    Raises:
        InputError: A file breaks the schema, or names an unknown quantity or form.
    """
    grammar = load(Grammar, config_directory() / GRAMMAR_FILE)
    if more is not None:
        added = load(Grammar, more)
        grammar = Grammar(
            quantities={**grammar.quantities, **added.quantities},
            forms={**grammar.forms, **added.forms},
            places={**grammar.places, **added.places},
        )
    for name, place in grammar.places.items():
        for quantity, forms in place.laws.items():
            _check_known("quantity", quantity, grammar.quantities, f"places.{name}.laws", more)
            for form in forms:
                _check_known("form", form, grammar.forms, f"places.{name}.laws", more)
    return grammar


def _check_known(kind: str, word: str, table: Mapping[str, object], key: str, file: Path | None) -> None:
    if word not in table:
        raise InputError(
            f"unknown {kind}; known: {', '.join(table)}",
            file=file or config_directory() / GRAMMAR_FILE,
            key=key,
            value=word,
        )


def laws_of(grammar: Grammar, ranges: Mapping[str, Range], joints: int) -> Iterator[Law]:
    """Every law of a grammar.

    Args:
        grammar: The grammar.
        ranges: Measured ranges, by symbol.
        joints: Number of joints of an arm.

    Raises:
        InputError: A law has a wrong unit, or does not parse.
    """
    for name, place in grammar.places.items():
        for quantity_name, forms in place.laws.items():
            quantity = grammar.quantities[quantity_name]
            for form_name in forms:
                for where in _locations(place, joints):
                    if where == "joint1" and "{before}" in quantity.formula:
                        continue
                    yield _law(name, place, quantity_name, quantity, form_name, grammar.forms[form_name], where, ranges)


def _locations(place: Place, joints: int) -> Sequence[str]:
    if place.each == "joint":
        return [f"joint{number}" for number in range(1, joints + 1)]
    if place.each in ("pair", "opposed"):
        return [f"joint{number}_{number + 1}" for number in range(1, joints)]
    if place.each in COEFFICIENTS:
        return (place.each,)
    return AXES if place.each == "axis" else ("",)


def _law(
    place_name: str,
    place: Place,
    quantity_name: str,
    quantity: Quantity,
    form_name: str,
    form: Form,
    where: str,
    ranges: Mapping[str, Range],
) -> Law:
    symbol = _symbol(quantity, where)
    low, high = _span(quantity, ranges, symbol)
    anchors: list[dict[str, float]] = [{}]
    if quantity.of_place:
        anchors = _anchors(_region(quantity, ranges)[0], quantity.typical)
    middle = (low + high) / 2.0
    profile = form.law.replace("- middle", f"- {middle:.3g}" if middle > 0.0 else f"+ {-middle:.3g}")
    opposes = (quantity.opposes or form.restores) and not place.against
    starts = {name: _starts(item, low, high) for name, item in form.numbers.items() if item.shape}
    starts |= {name: list(inner.starts) for name, inner in quantity.shapes.items()}
    number = "" if where in COEFFICIENTS else where.removeprefix("joint")
    words = f"{place.words} {' and '.join(number.split('_'))}".strip()
    text = _inserted(profile, symbol)
    spec = FormulaSpec.model_validate(
        {
            "name": _name(place_name, place, quantity_name, form_name, number),
            "sentence": f"{words}, {form.words} {quantity.words}."
            if form_name != "constant"
            else f"{words}, constant.",
            place.formula: _formula(place, quantity, form, where, f"-({text})" if opposes else text),
            "parameters": _parameters(place, quantity, form, (low, high), anchors[0]),
            "valid": {symbol: (low, high)} if symbol in ranges else {},
        }
    )
    check_units(spec)
    FormulaEffect(spec)
    shapes = [dict(zip(starts, values, strict=True)) for values in product(*starts.values())]
    return Law(
        spec=spec,
        place=place_name,
        where=where,
        quantity=quantity,
        symbol=symbol,
        form=form_name,
        profile=profile,
        needs=place.needs,
        starts=tuple(anchor | shape for anchor in anchors for shape in shapes),
        words=words,
        unit=place.unit,
        noticeable=place.noticeable,
        opposes=opposes or place.each == "vector",
        reacts=place.each == "opposed",
    )


def _span(quantity: Quantity, ranges: Mapping[str, Range], symbol: str) -> Range:
    """Range of a quantity in the measurements, or its typical one."""
    low, high = ranges.get(symbol, (-quantity.typical if quantity.opposes else 0.0, quantity.typical))
    if quantity.of_place:
        half = _region(quantity, ranges)[1]
        low, high = max(quantity.typical - half, 0.0), quantity.typical + half
    return low, max(high, low + MIN_SPAN_SHARE * quantity.typical)


def _parameters(
    place: Place, quantity: Quantity, form: Form, span: Range, anchor: Mapping[str, float]
) -> dict[str, FormulaParameter]:
    """Parameters of a law: amplitudes and shapes of the form, shapes of the quantity, and the anchor."""
    bounded = quantity.opposes or form.restores or place.against
    size = max(map(abs, span))
    parameters: dict[str, FormulaParameter] = {}
    for name, item in form.numbers.items():
        if item.shape:
            parameters[name] = _shape(item, quantity.unit, *span, _starts(item, *span)[0])
            continue
        scale = place.noticeable / size**item.power
        parameters[name] = FormulaParameter(
            unit=unit_of(place.unit, quantity.unit, item.power),
            lower=0.0 if bounded else -MAX_AMPLITUDE * scale,
            upper=MAX_AMPLITUDE * scale,
            scale=scale,
        )
    parameters |= {name: inner.parameter for name, inner in quantity.shapes.items()}
    reach = ANCHOR_REACH * quantity.typical
    for name, value in anchor.items():
        parameters[name] = FormulaParameter(
            unit=quantity.unit, nominal=value, lower=value - reach, upper=value + reach,
            scale=0.1 * quantity.typical, shape=True,
        )  # fmt: skip
    return parameters


def _formula(place: Place, quantity: Quantity, form: Form, where: str, text: str) -> dict[str, str] | str:
    """Formula of a law, by axis or joint if there are several; ``text`` for a scalar."""
    if place.each == "vector":
        factor = _inserted(form.along, _symbol(quantity, where))
        return {axis: f"-({factor}) * {quantity.vector(axis)}" for axis in AXES}
    return _on_joints(text, _joints(where), place.each == "opposed") or ({where: text} if where else text)


def _joints(where: str) -> tuple[str, ...]:
    """``joint4``, ``joint5`` of ``joint4_5``."""
    numbers = where.removeprefix("joint").split("_") if where.startswith("joint") else ()
    return tuple(f"joint{number}" for number in numbers)


def _on_joints(text: str, joints: Sequence[str], reacts: bool) -> dict[str, str]:
    """Formulas of a torque on one or two joints, by joint."""
    reaction = text.removeprefix("-") if text.startswith("-(") else f"-({text})"
    return {joint: reaction if reacts and number > 0 else text for number, joint in enumerate(joints)}


def _symbol(quantity: Quantity, where: str) -> str:
    """The formula of a quantity at a joint or along an axis."""
    if not where.startswith("joint"):
        return quantity.formula
    number = int(_joints(where)[-1].removeprefix("joint"))
    return quantity.formula.replace("{joint}", str(number)).replace("{before}", str(number - 1))


def _region(quantity: Quantity, ranges: Mapping[str, Range]) -> tuple[Array, float]:
    """Centre of the visited positions, ``(3,)``, and half of their largest extent [m]."""
    default = (-quantity.typical / 2.0, quantity.typical / 2.0)
    sides = [ranges.get(quantity.of_place.format(axis=axis), default) for axis in AXES]
    ends = np.array(sides)
    return ends.mean(axis=1), float(np.max(ends[:, 1] - ends[:, 0])) / 2.0


def _anchors(middle: Array, distance: float) -> list[dict[str, float]]:
    """Starts of the fit of an anchor: at a distance from the centre in both directions of every axis."""
    anchors = []
    for position in (middle + side * distance * row for row in np.eye(3) for side in (-1.0, 1.0)):
        anchors.append({f"anchor_{axis}": float(value) for axis, value in zip(AXES, position, strict=True)})
    return anchors


def curve_of(law: Law, domain: Range, count: int = FREE_CURVE_KNOTS[0], absolute: bool = True) -> Law:
    """A piecewise linear free curve in place of a law, with a force at each knot over the range of its quantity.

    Beyond the knots it falls to 0 within one spacing: it is valid in the measured range only.

    Args:
        law: Law with the place and quantity of the curve.
        domain: Range of the quantity.
        count: Number of knots.
        absolute: Whether the curve contains a constant; else it is 0 at the knot nearest to 0, for use with an offset.
    """
    (key, table), (low, high) = law.formula, domain
    # A speed: at rest the force is 0 or stiction, which is no point of a curve. Slow impacts do have coefficients.
    from_rest = 0.0 <= low < high / count and not law.coefficient
    positions = np.linspace(0.0, high, count + 1)[1:] if from_rest else np.linspace(low, high, count)
    width = float(positions[1] - positions[0])
    knots = positions if absolute else np.delete(positions, np.argmin(np.abs(positions)))
    profile = " + ".join(f"f{n} * max(0, 1 - abs(u - {knot:.4g}) / {width:.4g})" for n, knot in enumerate(knots))
    profile = profile.replace("u - -", "u + ")
    text = _inserted(profile, law.symbol)
    vector = law.quantity.vector
    rows: dict[str, str] | str
    if isinstance(table, str):
        rows = text
    elif vector(AXES[0]):
        rows = {axis: f"-({text}) * {vector(axis)} / max({law.symbol}, {0.01 * high:.2g})" for axis in table}
    else:
        rows = _on_joints(text, law.joints, law.reacts) or dict.fromkeys(table, text)
    most = MAX_AMPLITUDE * law.noticeable
    force = FormulaParameter(unit=law.unit, lower=-most, upper=most, scale=law.noticeable)
    stem = law.spec.name.removesuffix(f"_{law.form}")
    spec = FormulaSpec.model_validate(
        {
            "name": f"{stem}_curve_{count}",
            "sentence": f"{law.words}, a curve over {law.quantity.words}.",
            key: rows,
            "parameters": {f"f{number}": force for number in range(knots.size)},
            "valid": law.spec.valid,
        }
    )
    check_units(spec)
    return replace(
        law, spec=spec, form="curve", profile=profile, starts=({},), opposes=False, knots=tuple(knots.tolist())
    )


def _name(place_name: str, place: Place, quantity: str, form: str, number: str) -> str:
    """Name of a law: ``motor4_velocity_cube``, ``end_effector_y_above_x``, ``object_drag_square``."""
    if place.each == "vector":
        return f"{place_name}_{form}"
    where = f"_{number}" if place.each == "axis" else number
    return f"{place_name}{where}_{quantity.removeprefix(f'{place_name}_')}_{form}"


def _inserted(law: str, symbol: str) -> str:
    """The formula of a form with the quantity substituted for u."""
    inner = symbol if re.fullmatch(r"\w+", symbol) else f"({symbol})"
    return re.sub(r"\bu\b", inner, law)


def _shape(item: Number, unit: str, low: float, high: float, start: float) -> FormulaParameter:
    """A shape parameter for a quantity with this unit and range."""
    span = high - low
    if item.shape == "wave_number":
        shape_unit, lower, scale = unit_of("-", unit, 1), 0.0, 0.1 * item.starts[0] / span
        upper = max(2.0 * MAX_WAVE_NUMBER, 4.0 * start)
    elif item.shape == "width":
        shape_unit, lower, upper, scale = unit, MIN_WIDTH_SHARE * span, 10.0 * span, 0.1 * span
    else:
        shape_unit, lower, upper, scale = unit, low - span, high + span, 0.1 * span
    return FormulaParameter(unit=shape_unit, nominal=start, lower=lower, upper=upper, scale=scale, shape=True)


def _starts(item: Number, low: float, high: float) -> list[float]:
    """Starts of the fit of a shape parameter."""
    span = high - low
    if item.shape == "wave_number":
        step = item.starts[0] / span
        count = max(1, min(int(MAX_WAVE_NUMBER / step), MAX_WAVE_NUMBER_STARTS))
        return [number * step for number in range(1, count + 1)]
    return [(low if item.shape == "limit" else 0.0) + share * span for share in item.starts]


def unit_of(place: str, quantity: str, power: int) -> str:
    """Unit of a place over the unit of a quantity to a power, as ``N m s^3/rad^3``; ``-``: no unit."""
    exponents: dict[str, int] = {}
    for unit, factor in ((place, 1), (quantity, -power)):
        for part, sign in zip(unit.split("/"), (1, -1), strict=False):
            for word in part.split():
                if word != "-":
                    exponents[word] = exponents.get(word, 0) + sign * factor
    above = " ".join(_power(word, value) for word, value in exponents.items() if value > 0)
    below = " ".join(_power(word, -value) for word, value in exponents.items() if value < 0)
    return f"{above or '1'}/{below}" if below else above or "-"


def _power(word: str, value: int) -> str:
    return word if value == 1 else f"{word}^{value}"
