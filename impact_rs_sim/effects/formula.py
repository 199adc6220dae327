# SPDX-License-Identifier: Apache-2.0
"""Effects that a user writes as formulas in YAML, without any code.

    - name: cable_drag
      sentence: A cable drags behind the end effector.
      end_effector_force: {y: "-drag * vy"}
      motor_torque: {joint2: "-c * tanh(dq2 / 0.02)"}
      parameters: {drag: {unit: N s/m, nominal: 0, lower: 0, upper: 50, scale: 1},
                   c: {unit: N m, nominal: 0, lower: 0, upper: 3, scale: 0.1}}

A law of the object or of its contacts:

    - name: air_drag
      sentence: Air resists the object with the square of its speed.
      object_force: {x: "-c * object_speed * object_vx", y: "-c * object_speed * object_vy"}
      parameters: {c: {unit: N s^2/m^2, nominal: 0, lower: 0, upper: 100, scale: 1}}

A contact of a single impact, in tables of impacts only:

    - name: plastic_contact
      sentence: The contact yields, so that restitution falls with the fourth root of the speed.
      contact: {restitution: "-c * v ** 0.25"}
      parameters: {c: {unit: "-", nominal: 0, lower: -1, upper: 1, scale: 0.05}}

``contact`` adds to the coefficients ``restitution``, ``tangential_restitution`` and ``friction`` of a contact point, as
functions of its closing speed ``v`` and its ``slip`` [m/s]. With the inverse mass G_n of the body at this point, a
normal impulse L_n(v) corresponds to the restitution G_n L_n(v) / v - 1.

Points of action:

* ``joint_torque`` on a link, measured by the torque sensor; ``motor_torque`` on the motor before the transmission, like
  friction of a gear and errors of the command; ``end_effector_force`` at the origin of E. They are evaluated at every
  control tick, with position and velocity of the links.
* ``object_force`` at the centre of the object, ``object_moment`` on it, along the axes of A.
* ``contact_normal`` and ``contact_tangential`` between pad and object while they touch: a repulsive force, and a force
  against the sliding of the object on the pad. The pad feels the reaction. ``support_normal`` and
  ``support_tangential`` act between support and object in the same way. They are evaluated in every step, with forces
  of the previous step.

Symbols: :data:`SYMBOLS`; ``q1`` ... ``dq1`` ... ``tau1`` ... of the joints [rad, rad/s, N m]; ``pi``; and the named
parameters. Formulas of object and support have the symbols of time, object and support, and ``normal_force`` and
``since_contact`` of all pads together. Functions: see :data:`FUNCTIONS`; and ``lag(u, T)`` or ``lag(u, T, start)``, the
memory of :mod:`impact_rs_sim.memory`, with a time constant T [s] that may depend on the state. The text is parsed into
a syntax tree of which only arithmetic is accepted; nothing is ever evaluated as Python. Whether an arm has the joints
that a formula names is known when the effect meets the arm, not before.
"""

from __future__ import annotations

import ast
import math
import operator
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Literal, Self, get_args

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from impact_rs_sim.effects.base import SINGLE_IMPACT, Effect, Parameter, Values, digest, number
from impact_rs_sim.errors import InputError
from impact_rs_sim.memory import Memory, lag_along
from impact_rs_sim.physics import ContactCondition, ContactLaw, Load, LoadState, ObjectLoad, Physics
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.rotations import AXES
from impact_rs_sim.schema import Schema, load, omitted

Value = float | Array
"""A number, or an array of them for many samples at once."""

FUNCTIONS: dict[str, tuple[int, Callable[..., Value]]] = {
    "sin": (1, np.sin),
    "cos": (1, np.cos),
    "tan": (1, np.tan),
    "exp": (1, np.exp),
    "log": (1, np.log),
    "sqrt": (1, np.sqrt),
    "tanh": (1, np.tanh),
    "abs": (1, np.abs),
    "sign": (1, np.sign),
    "min": (2, np.minimum),
    "max": (2, np.maximum),
}
LAG = "lag"  # of a quantity, with a time constant and, if given, an initial value; impact_rs_sim/memory.py
_BINARY: dict[type[ast.operator], Callable[[Value, Value], Value]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: np.divide,  # x / 0 is infinite, of numbers too
    ast.Pow: np.power,
}
SYMBOLS = {
    "t": "s",  # since the start of the trial
    **dict.fromkeys(AXES, "m"),  # of frame E in A
    **{f"v{axis}": "m/s" for axis in AXES},
    "speed": "m/s",
    **{f"object_{axis}": "m" for axis in AXES},  # of its middle in A
    **{f"object_v{axis}": "m/s" for axis in AXES},
    **{f"object_w{axis}": "rad/s" for axis in AXES},
    "object_speed": "m/s",
    "normal_force": "N",  # between pad and object
    "penetration": "m",  # mean over the contact points, weighted with their forces
    "closing": "m/s",  # rate of the penetration
    "slip": "m/s",  # at which the object slides on the pad
    "since_contact": "s",  # since the first contact of pad and object; 0 before
    "support_force": "N",  # normal, between support and object
    "support_slip": "m/s",
}
SCENE_SYMBOLS = frozenset(SYMBOLS) - {
    "t",
    *AXES,
    *(f"v{axis}" for axis in AXES),
    "speed",
}  # of object and contact, without the arm
OBJECT_SYMBOLS = frozenset(
    name for name in SYMBOLS if name in ("t", "normal_force", "since_contact") or name.startswith(("object", "support"))
)
MIN_SLIDING_SPEED_M_S = 2e-3  # below, the force against sliding falls to 0 with the speed, so that rest is a state
Coefficient = Literal["restitution", "tangential_restitution", "friction"]
"""Coefficients of a contact point of a single impact, to which formulas add."""

COEFFICIENTS = get_args(Coefficient)
CONTACT_SYMBOLS = ("v", "slip")
JOINT_KEY = re.compile(r"joint([1-9][0-9]{0,2})")
JOINT_SYMBOL = re.compile(r"\b(q|dq|tau)([1-9][0-9]{0,2})\b")
PLACES = (
    "joint_torque", "motor_torque", "end_effector_force", "object_force", "object_moment", "contact_normal",
    "contact_tangential", "support_normal", "support_tangential", "contact",
)  # fmt: skip
MAX_FORMULA_LENGTH = 1000  # characters; a physical law is shorter, a curve of nine knots has 600

Symbols = Mapping[str, Value]
Expression = Callable[[Symbols, Memory | None], Value]


class Formula:
    """Arithmetic text as a function of its symbols.

    It is pickled as text and parsed again in worker processes: functions made at run time cannot be pickled.

    Args:
        text: The formula.
        symbols: Names that it may use.

    Attributes:
        names: Symbols in the formula.
        remembers: Whether it has memory (a lag).

    Raises:
        InputError: The text does not parse, has an unknown symbol or function, or is not arithmetic.
    """

    def __init__(self, text: str, symbols: Iterable[str]) -> None:
        self.text, self.symbols = text, frozenset(symbols)
        self._function = _parse(text, self.symbols)
        words = set(re.findall(r"[A-Za-z_]\w*", text))
        self.names, self.remembers = self.symbols & words, LAG in words

    def __call__(self, values: Symbols, memory: Memory | None = None) -> Value:
        """Value of the formula.

        Args:
            values: Values of its symbols: numbers, or arrays of samples in the order of time.
            memory: State of its lags; not needed for samples along time.

        Raises:
            InputError: It has memory, and ``values`` are a single state without ``memory``.
        """
        return self._function(values, memory)

    def __reduce__(self) -> tuple[type[Formula], tuple[str, frozenset[str]]]:
        """See the class."""
        return Formula, (self.text, self.symbols)


def _parse(text: str, symbols: frozenset[str]) -> Expression:
    """See :class:`Formula`."""
    if len(text) > MAX_FORMULA_LENGTH:
        raise InputError(f"formula is longer than {MAX_FORMULA_LENGTH} characters")
    try:
        tree = ast.parse(text.strip(), mode="eval").body
        return _compile(tree, symbols, text)
    except SyntaxError as error:
        raise InputError(f"formula {text!r} does not parse at column {error.offset}: {error.msg}") from None
    except (ArithmeticError, RecursionError, ValueError, MemoryError) as error:  # Arithmetic: 330 digits are no float
        if isinstance(error, InputError):
            raise
        raise InputError(f"formula {text!r} does not parse") from None


def _compile(node: ast.AST, symbols: frozenset[str], text: str) -> Expression:
    if isinstance(node, ast.Constant) and isinstance(node.value, (int, float)) and not isinstance(node.value, bool):
        value = float(node.value)
        return lambda *_: value
    if isinstance(node, ast.Name):
        name = node.id
        if name == "pi":
            return lambda *_: math.pi
        if name not in symbols:
            raise InputError(f"formula {text!r}: unknown symbol {name!r}; known: {', '.join(sorted(symbols))}")
        return lambda values, _: values[name]
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, (ast.USub, ast.UAdd)):
        inner = _compile(node.operand, symbols, text)
        sign = -1.0 if isinstance(node.op, ast.USub) else 1.0
        return lambda values, memory: sign * inner(values, memory)
    if isinstance(node, ast.BinOp) and type(node.op) in _BINARY:
        left, right = _compile(node.left, symbols, text), _compile(node.right, symbols, text)
        combine = _BINARY[type(node.op)]
        return lambda values, memory: combine(left(values, memory), right(values, memory))
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and not node.keywords:
        functions = [*FUNCTIONS, LAG]
        if node.func.id not in functions:
            raise InputError(f"formula {text!r}: unknown function {node.func.id!r}; known: {', '.join(functions)}")
        if node.func.id == LAG:
            return _lag([_compile(argument, symbols, text) for argument in node.args], text)
        count, function = FUNCTIONS[node.func.id]
        if len(node.args) != count:
            raise InputError(f"formula {text!r}: {node.func.id} takes {count} argument(s)")
        arguments = [_compile(argument, symbols, text) for argument in node.args]
        return lambda values, memory: function(*(argument(values, memory) for argument in arguments))
    raise InputError(f"formula {text!r}: only arithmetic is understood, not {type(node).__name__}")


def _lag(arguments: Sequence[Expression], text: str) -> Expression:
    """A lag as an expression; ``text`` is the formula, for messages."""
    if len(arguments) not in (2, 3):
        raise InputError(f"formula {text!r}: {LAG} takes a quantity, a time constant and, if it has one, a start")
    key = object()

    def lag(values: Symbols, memory: Memory | None) -> Value:
        arguments_now, time = [argument(values, memory) for argument in arguments], values.get("t")
        if isinstance(time, np.ndarray) and time.ndim:
            return lag_along(time, *arguments_now)
        if memory is None or time is None:
            raise InputError(
                f"formula {text!r}: {LAG}() depends on what was before, and a single state has no past; "
                "it acts in trials and recordings"
            )
        return memory.lag(key, float(time), *map(float, arguments_now))

    return lag


class FormulaParameter(Schema):
    """A named number of a formula."""

    unit: str = Field(description="unit, '-' where it has none")
    nominal: float = Field(0.0, description="value at which the effect does nothing")
    lower: float = Field(description="smallest value that makes sense")
    upper: float = Field(description="largest value that makes sense")
    scale: float = Field(gt=0.0, description="a noticeable change")
    meaning: str = Field("", description="meaning of the parameter")
    shape: bool = omitted(False, description="whether it changes nothing while the others are nominal, as a threshold")
    grid: tuple[float, ...] = omitted((), description="values of a shape from which a fit starts")

    @model_validator(mode="after")
    def _limits_in_order(self) -> Self:
        if self.lower >= self.upper:
            raise ValueError(f"lower = {self.lower:g} must be below upper = {self.upper:g} [{self.unit}]")
        if not self.lower <= self.nominal <= self.upper:
            raise ValueError(f"nominal = {self.nominal:g} must lie within lower and upper [{self.unit}]")
        return self


class FormulaSpec(Schema):
    """One effect written as formulas."""

    name: str = Field(pattern=r"^[a-z][a-z0-9_]*$", description="name of the effect, lower case with underscores")
    sentence: str = Field(description="the effect in one sentence")
    joint_torque: dict[str, str] = Field({}, description="torque on a link, formula per joint (joint1 ...) [N m]")
    motor_torque: dict[str, str] = Field({}, description="torque on a motor, formula per joint (joint1 ...) [N m]")
    end_effector_force: dict[str, str] = Field({}, description="formula per axis (x, y, z) [N]")
    object_force: dict[str, str] = omitted({}, description="force at the object's middle, formula per axis [N]")
    object_moment: dict[str, str] = omitted({}, description="moment on the object, formula per axis [N m]")
    contact_normal: str = omitted("", description="force that parts pad and object while they touch [N]")
    contact_tangential: str = omitted("", description="force against the object's sliding on the pad [N]")
    support_normal: str = omitted("", description="force that parts support and object while they touch [N]")
    support_tangential: str = omitted("", description="force against the object's sliding on the support [N]")
    contact: dict[str, str] = Field(
        {},
        description="formula per coefficient of a single impact (restitution, tangential_restitution, friction) [-]",
    )
    parameters: dict[str, FormulaParameter] = Field(min_length=1, description="named numbers")
    valid: dict[str, tuple[float, float]] = omitted(
        {}, description="smallest and largest value by symbol at which the formulas were seen to hold, in SI units"
    )

    @model_validator(mode="after")
    def _ranges_of_known_symbols(self) -> Self:
        for symbol, (low, high) in self.valid.items():
            symbols = [*SYMBOLS, *(name for name in CONTACT_SYMBOLS if name not in SYMBOLS)]
            if symbol not in symbols and not JOINT_SYMBOL.fullmatch(symbol):
                raise ValueError(f"valid: unknown symbol {symbol!r}; known: q1, dq1, tau1, ..., {', '.join(symbols)}")
            if low >= high:
                raise ValueError(f"valid.{symbol}: {low:g} must be below {high:g}")
        return self


def _with_names_of_their_own(specs: tuple[FormulaSpec, ...]) -> tuple[FormulaSpec, ...]:
    names = [spec.name for spec in specs]
    if repeated := {name for name in names if names.count(name) > 1}:
        raise ValueError(f"two effects have the name {min(repeated)!r}; expected a name of its own for each of them")
    return specs


FormulaSpecs = Annotated[tuple[FormulaSpec, ...], AfterValidator(_with_names_of_their_own)]


class FormulaFile(Schema):
    """A YAML file of formula effects."""

    effects: FormulaSpecs = Field(min_length=1, description="effects as formulas")


class FormulaEffect(Effect):
    """An effect made from a :class:`FormulaSpec`.

    Args:
        spec: The formulas.
        family: See :class:`Effect`.

    Raises:
        InputError: A formula does not parse or names something unknown.
    """

    acts_on = "joint torque"

    def __init__(self, spec: FormulaSpec, family: str = "") -> None:
        self.spec, self.family = spec, family
        self.name = spec.name
        self.sentence = spec.sentence
        self.parameters = tuple(
            Parameter(name, p.unit, p.nominal, p.lower, p.upper, p.scale, p.meaning, shape=p.shape, grid=p.grid)
            for name, p in spec.parameters.items()
        )
        reserved = FUNCTIONS.keys() | SYMBOLS.keys() | {"pi", LAG}
        clash = [name for name in spec.parameters if name in reserved or JOINT_SYMBOL.fullmatch(name)]
        if clash:
            raise InputError(f"effect {spec.name!r}: {sorted(clash)} cannot be parameter names")
        self._torque = {self._joint(key): self._parse(text) for key, text in spec.joint_torque.items()}
        self._motor = {self._joint(key): self._parse(text) for key, text in spec.motor_torque.items()}
        self._force = {self._axis(key): self._parse(text) for key, text in spec.end_effector_force.items()}
        self._pad = self._at_surface(spec.contact_normal, spec.contact_tangential, self._parse)
        self._object = {self._axis(key): self._parse_object(text) for key, text in spec.object_force.items()}
        self._object |= {3 + self._axis(key): self._parse_object(text) for key, text in spec.object_moment.items()}
        self._support = self._at_surface(spec.support_normal, spec.support_tangential, self._parse_object)
        self._contact = {self._coefficient(key): self._parse_contact(text) for key, text in spec.contact.items()}
        on_arms = self._torque or self._motor or self._force
        on_contacts = self._pad or self._object or self._support
        if not (on_arms or on_contacts or self._contact):
            places = ", ".join(PLACES)
            raise InputError(f"effect {spec.name!r} needs a formula of one of: {places}")
        if not on_arms:
            self.acts_on = "object" if self._object or self._support else "contact"
            self.phases = ("contact",) if on_contacts else SINGLE_IMPACT

    def _joint(self, key: str) -> int:
        match = JOINT_KEY.fullmatch(key)
        if match is None:
            raise InputError(f"effect {self.name!r}: unknown {key!r}; expected joint1, joint2, ...")
        return int(match[1]) - 1

    def _axis(self, key: str) -> int:
        if key not in AXES:
            raise InputError(f"effect {self.name!r}: unknown {key!r}; known: {', '.join(AXES)}")
        return AXES.index(key)

    def _coefficient(self, key: str) -> str:
        if key not in COEFFICIENTS:
            raise InputError(f"effect {self.name!r}: unknown {key!r}; known: {', '.join(COEFFICIENTS)}")
        return key

    @staticmethod
    def _at_surface(normal: str, tangential: str, parse: Callable[[str], Formula]) -> dict[int, Formula]:
        """Formulas of the normal force (0) and of the force against sliding (1)."""
        return {index: parse(text) for index, text in enumerate((normal, tangential)) if text}

    def _parse_contact(self, text: str) -> Formula:
        clash = sorted({*CONTACT_SYMBOLS} & self.spec.parameters.keys())
        if clash:
            raise InputError(f"effect {self.name!r}: {clash} cannot be parameter names")
        formula = Formula(text, {*CONTACT_SYMBOLS, *self.spec.parameters})
        if formula.remembers:
            raise InputError(
                f"effect {self.name!r}: a single impact has no past, so its coefficients cannot use {LAG}(); "
                "contact_normal and contact_tangential can, in trials",
                key="contact",
                value=text,
            )
        return formula

    def _parse_object(self, text: str) -> Formula:
        return Formula(text, {*OBJECT_SYMBOLS, *self.spec.parameters})

    def _parse(self, text: str) -> Formula:
        joint_symbols = {match[0] for match in JOINT_SYMBOL.finditer(text)}
        return Formula(text, {*SYMBOLS, "q1", "dq1", "tau1", *self.spec.parameters, *joint_symbols})

    def apply(self, physics: Physics, values: Values) -> Physics:
        """See :meth:`Effect.apply`.

        Raises:
            InputError: A formula names a joint that an arm does not have.
        """
        for name, arm in physics.arms.items():
            self._check_joints(name, arm.facts.joint_count)
        numbers = {parameter.name: number(values, parameter.name) for parameter in self.parameters}
        arms, laws, object_loads = physics.arms, physics.contact_laws, physics.object_loads
        if self._torque or self._motor or self._force or self._pad:
            load = FormulaLoad(self.name, self._torque, self._motor, self._force, self._pad, numbers)
            arms = {name: replace(arm, loads=(*arm.loads, load)) for name, arm in arms.items()}
        if self._object or self._support:
            object_loads = (*object_loads, FormulaObjectLoad(self.name, self._object, self._support, numbers))
        if self._contact:
            laws = (*laws, FormulaContact(self.name, self._contact, numbers, tuple(self.spec.contact.items())))
        return replace(physics, arms=arms, contact_laws=laws, object_loads=object_loads)

    def _check_joints(self, arm: str, joint_count: int) -> None:
        spec = self.spec
        for table in (spec.joint_torque, spec.motor_torque):
            for key in table:
                if self._joint(key) >= joint_count:
                    raise InputError(f"effect {self.name!r}: unknown {key!r}; arm {arm!r} has {joint_count} joints")
        tables = (spec.joint_torque, spec.motor_torque, spec.end_effector_force)
        for text in (
            *(text for table in tables for text in table.values()),
            spec.contact_normal,
            spec.contact_tangential,
        ):
            for symbol in JOINT_SYMBOL.finditer(text):
                if int(symbol[2]) > joint_count:
                    raise InputError(
                        f"effect {self.name!r}: formula {text!r}: unknown symbol {symbol[0]!r}; "
                        f"arm {arm!r} has {joint_count} joints"
                    )

    def with_parameters(self, change: Callable[[Parameter], Parameter]) -> Effect:
        """The effect itself, whose author states the ranges; a candidate law with new ranges of its amplitudes."""
        if not self.family:
            return self
        return super().with_parameters(lambda parameter: parameter if parameter.shape else change(parameter))

    @property
    def identity(self) -> str:
        """See :attr:`Effect.identity`; includes the formulas."""
        return digest(super().identity, self.spec.model_dump_json())


@dataclass(frozen=True)
class FormulaContact(ContactLaw):
    """Formulas of a contact with numbers filled in.

    Attributes:
        name: Name of the effect, for messages.
        formulas: By coefficient.
        numbers: Parameters.
        texts: The formulas as text.
    """

    name: str
    formulas: dict[str, Formula] = field(repr=False)
    numbers: dict[str, float]
    texts: tuple[tuple[str, str], ...]

    def apply(self, contact: ContactCondition) -> ContactCondition:
        """See :meth:`ContactLaw.apply`."""
        symbols: dict[str, Value] = {"v": contact.closing, "slip": contact.slip, **self.numbers}
        changed = {}
        for name, expression in self.formulas.items():
            try:
                with np.errstate(all="ignore"):
                    changed[name] = getattr(contact, name) + expression(symbols)
            except (ArithmeticError, ValueError, TypeError) as error:
                raise InputError(f"effect {self.name!r} blows up at a contact: {error}") from None
            if not np.isfinite(changed[name]).all():
                raise InputError(f"effect {self.name!r} blows up at a contact")
        return replace(contact, **changed)


def _evaluated(effect: str, table: dict[int, Formula], size: int, symbols: Symbols, memory: Memory | None) -> Array:
    """Values of formulas by number, 0 without a formula, ``(..., size)`` with an axis of samples in front if any.

    Raises:
        InputError: One of them is not finite.
    """
    time = np.asarray(symbols["t"])
    result = np.zeros((*time.shape, size))
    for index, expression in table.items():
        try:
            with np.errstate(all="ignore"):
                result[..., index] = expression(symbols, memory)
        except InputError as error:
            raise InputError(f"effect {effect!r}: {error.message}") from None
        except (ArithmeticError, ValueError, TypeError) as error:
            raise InputError(f"effect {effect!r} blows up at t = {time.min():.3f} s: {error}") from None
        if not np.isfinite(result[..., index]).all():
            first = time[~np.isfinite(result[..., index])].min()
            raise InputError(f"effect {effect!r} blows up at t = {first:.3f} s")
    return result


@dataclass(frozen=True)
class FormulaLoad(Load):
    """Formulas of an arm with numbers filled in."""

    name: str
    torque: dict[int, Formula]
    motor: dict[int, Formula]
    force: dict[int, Formula]
    pad: dict[int, Formula]
    numbers: dict[str, float]

    @property
    def touches(self) -> bool:
        """See :class:`Load`."""
        return bool(self.pad)

    @property
    def remembers(self) -> bool:
        """See :class:`Load`; for the load between pad and object."""
        return any(formula.remembers for formula in self.pad.values())

    @property
    def reads_scene(self) -> bool:
        """See :class:`Load`."""
        tables = (self.torque, self.motor, self.force)
        return any(SCENE_SYMBOLS & formula.names for table in tables for formula in table.values())

    @property
    def vectorised(self) -> bool:
        """See :class:`Load`."""
        return True

    def _evaluate(self, table: dict[int, Formula], size: int, state: LoadState) -> Array:
        values: dict[str, Value] = {**dict.fromkeys(SYMBOLS, 0.0), **state.scene, "t": state.time, **self.numbers}
        torque = np.zeros_like(state.joint_position) if state.joint_torque is None else state.joint_torque
        for name, joints in (("q", state.joint_position), ("dq", state.joint_velocity), ("tau", torque)):
            values |= {f"{name}{index + 1}": value for index, value in enumerate(joints.T)}
        values |= dict(zip(AXES, state.position.T, strict=True))
        values |= {f"v{axis}": value for axis, value in zip(AXES, state.velocity.T, strict=True)}
        values["speed"] = np.linalg.norm(state.velocity, axis=-1)
        return _evaluated(self.name, table, size, values, state.memory and state.memory.part(id(self)))

    def joint_torque(self, state: LoadState) -> Array | None:
        """Torque on the links, ``(n,)`` [N m]."""
        return self._evaluate(self.torque, state.joint_position.shape[-1], state) if self.torque else None

    def motor_torque(self, state: LoadState) -> Array | None:
        """Torque on the motors, ``(n,)`` [N m]."""
        return self._evaluate(self.motor, state.joint_position.shape[-1], state) if self.motor else None

    def end_effector_force(self, state: LoadState) -> Array | None:
        """Force at E, axes of A, ``(3,)`` [N]."""
        return self._evaluate(self.force, 3, state) if self.force else None

    def pad_force(self, state: LoadState) -> tuple[float, float] | None:
        """See :meth:`Load.pad_force`."""
        if not self.pad:
            return None
        normal, against = self._evaluate(self.pad, 2, state).tolist()
        return normal, against


@dataclass(frozen=True)
class FormulaObjectLoad(ObjectLoad):
    """Formulas of the object with numbers filled in."""

    name: str
    free: dict[int, Formula]
    support: dict[int, Formula]
    numbers: dict[str, float]

    @property
    def remembers(self) -> bool:
        """See :class:`ObjectLoad`."""
        return any(formula.remembers for formula in self.support.values())

    def wrench(self, scene: Symbols, memory: Memory) -> Array:
        """See :meth:`ObjectLoad.wrench`."""
        return self._evaluate(self.free, 6, scene, memory)

    def support_force(self, scene: Symbols, memory: Memory) -> tuple[float, float]:
        """See :meth:`ObjectLoad.support_force`."""
        normal, against = self._evaluate(self.support, 2, scene, memory).tolist()
        return normal, against

    def _evaluate(self, table: dict[int, Formula], size: int, scene: Symbols, memory: Memory) -> Array:
        symbols = {**dict.fromkeys(OBJECT_SYMBOLS, 0.0), **scene, **self.numbers}
        return _evaluated(self.name, table, size, symbols, memory.part(id(self)))


def load_formulas(path: str | Path) -> dict[str, FormulaEffect]:
    """Effects of a formula file, by name.

    Raises:
        InputError: The file breaks the schema, or a formula does not parse.
    """
    try:
        return {spec.name: FormulaEffect(spec) for spec in load(FormulaFile, path).effects}
    except InputError as error:
        if error.file is None:
            raise error.in_file(path) from None
        raise
