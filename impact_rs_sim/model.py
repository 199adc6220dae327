# SPDX-License-Identifier: Apache-2.0
"""Model files: estimated effects, on top of the nominal values of a scenario.

A model is a list of effects with their parameters. Adding an effect writes a new file that names its parent, so the
history of a model since the nominal one can be read back (``impact-rs history``).

A file does not name a robot. With a parameter per joint it names joints 1 to n, and the model fits arms with n joints
of the types that the units imply; without such an effect it fits any arm. If ``arms`` names arms with separate
parameters, an effect of arms may have one set for each (``coulomb_left_joint1``), and the model fits arms of these
names.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
import yaml
from pydantic import Field

from impact_rs_sim.effects import Effect, library
from impact_rs_sim.effects.base import PRISMATIC_UNITS, Joints, Parameter
from impact_rs_sim.effects.contact import FORMER
from impact_rs_sim.effects.each_arm import EachArm, of_each
from impact_rs_sim.effects.formula import FormulaEffect, FormulaSpec, FormulaSpecs
from impact_rs_sim.errors import InputError
from impact_rs_sim.files import is_file, write_whole
from impact_rs_sim.paths import config_directory
from impact_rs_sim.physics import Physics
from impact_rs_sim.robots.robot import Array, JointType
from impact_rs_sim.schema import Schema, load, parse_yaml, validate

PRISMATIC_ONLY_UNITS = {unit for unit, _ in PRISMATIC_UNITS.values()}  # never units of a revolute joint's parameters


class ParameterValue(Schema):
    """An estimated parameter."""

    estimate: float = Field(description="believed value, in its unit")
    unit: str = Field(description="unit, '-' where it has none")
    ci95: tuple[float, float] | None = Field(None, description="95 % interval, in the same unit")


class ModelEffect(Schema):
    """One active effect."""

    name: str = Field(description="name of the effect (impact-rs effects lists them)")
    parameters: dict[str, ParameterValue] = Field(description="its parameters")

    def vector(self, scalars: Sequence[Parameter]) -> Array:
        """Estimates of the scalars of the effect, ``(p,)``; a missing scalar with a prior is nominal."""
        estimates = self.parameters
        return np.array([estimates[s.name].estimate if s.name in estimates else s.nominal for s in scalars])


class Model(Schema):
    """A model of the physics (``config/models/*.yaml``)."""

    name: str = Field(description="name of the model")
    parent: str | None = Field(None, description="file of the model this one was made from")
    parent_digest: str | None = Field(None, description="digest of the parent's content when this was made")
    note: str = Field("", description="why it was made")
    arms: dict[str, Annotated[int, Field(ge=1)] | tuple[JointType, ...]] = Field(
        {},
        description="joints, how many or how each moves, of arms with parameters of their own; none: arms share",
    )
    formulas: FormulaSpecs = Field((), description="user-defined effects")
    effects: tuple[ModelEffect, ...] = Field((), description="effects that are switched on, in order")

    @property
    def known_effects(self) -> dict[str, Effect]:
        """Effects of the library and of this model's formulas, by name; with parameters per arm if ``arms`` is set."""
        return {name: of_each(effect, self.arms) for name, effect in self._shared_effects.items()}

    @property
    def _shared_effects(self) -> dict[str, Effect]:
        return {**library(), **{spec.name: FormulaEffect(spec) for spec in self.formulas}}

    def effect_of(self, item: ModelEffect) -> Effect:
        """Effect of an entry, with parameters per arm unless the entry names shared parameters."""
        if item.name in FORMER and "scale" in item.parameters:
            return FORMER[item.name]
        shared = self._shared_effects[item.name]
        effect_per_arm = of_each(shared, self.arms)
        own_names = {scalar.name for scalar in effect_per_arm.scalars(0)}
        return effect_per_arm if own_names & item.parameters.keys() else shared

    def containing(self, names: Iterable[str]) -> Model:
        """The model reduced to its active or named formulas: the part that a simulation needs."""
        wanted = {*names, *(item.name for item in self.effects)}
        formulas = tuple(spec for spec in self.formulas if spec.name in wanted)
        return self if len(formulas) == len(self.formulas) else self.model_copy(update={"formulas": formulas})

    @property
    def digest(self) -> str:
        """Digest of the physics of the model, without name, note and parent."""
        content = self.model_dump_json(include={"formulas", "effects"})
        return hashlib.sha256(content.encode()).hexdigest()[:16]

    def apply(self, physics: Physics) -> Physics:
        """Nominal physics with every effect of the model; in a scene without arms, effects of joints are skipped.

        Raises:
            InputError: The model is for arms with another number or other types of joints.
        """
        for item in self.effects:
            effect = self.effect_of(item)
            count = _joint_count(effect, item)
            if count is not None and not physics.arms:
                continue
            if count is not None and count != physics.joint_count:
                raise InputError(
                    f"model {self.name!r} is for arms with {count} joints (effect {item.name}), "
                    f"this arm has {physics.joint_count}"
                )
            scalars = effect.scalars(0 if count is None else physics.joints)
            for scalar in scalars:
                if scalar.name in item.parameters and item.parameters[scalar.name].unit != scalar.unit:
                    raise InputError(
                        f"model {self.name!r} has {item.name}.{scalar.name} in {item.parameters[scalar.name].unit}, "
                        f"this arm has it in {scalar.unit}: that joint moves otherwise"
                    )
            physics = effect.apply_vector(physics, item.vector(scalars))
        return physics

    def with_effect(self, item: ModelEffect, name: str, parent: str, formulas: tuple[FormulaSpec, ...] = ()) -> Model:
        """Child model with one more effect, or with a new estimate of an existing effect, in its place."""
        effects = {effect.name: effect for effect in (*self.effects, item)}  # a name keeps its first position
        all_formulas = {spec.name: spec for spec in (*self.formulas, *formulas)}
        return Model(
            name=name,
            parent=parent,
            parent_digest=self.digest,
            note="",
            arms=self.arms,
            formulas=tuple(all_formulas.values()),
            effects=tuple(effects.values()),
        )


def _joint_count(effect: Effect, item: ModelEffect) -> int | None:
    """Number of joints in the parameters of an effect, at least 1; None without shared parameters per joint.

    It is the largest joint number, plus 1 if the last joint has no parameter (shafts of two neighbouring joints).
    """
    if isinstance(effect, EachArm):
        return None
    parameters = [parameter for parameter in effect.parameters if parameter.per_joint]
    if not parameters:
        return None
    pattern = re.compile(
        f"(?:{'|'.join(re.escape(parameter.name) for parameter in parameters)})_joint([1-9][0-9]{{0,2}})"
    )
    last = max((int(match[1]) for name in item.parameters if (match := pattern.fullmatch(name))), default=0)
    return max(last + all(parameter.except_joint == -1 for parameter in parameters), 1)


def _joints(effect: Effect, item: ModelEffect) -> Joints:
    """Types of the joints named by an effect, from the units of its parameters; revolute if these do not decide."""
    count = _joint_count(effect, item) or 0
    sliding: JointType = "prismatic"
    slides = {
        scalar.joint
        for scalar in effect.scalars((sliding,) * count)
        if scalar.unit in PRISMATIC_ONLY_UNITS and scalar.name in item.parameters
        if item.parameters[scalar.name].unit == scalar.unit
    }
    return tuple("prismatic" if joint in slides else "revolute" for joint in range(count))


def check_model(model: Model, file: str | Path) -> Model:
    """Check a model against the effects it names.

    Raises:
        InputError: An unknown or repeated effect, an unknown or missing parameter, a wrong unit, a value out of bounds,
            or effects with unequal numbers of joints.
    """
    try:
        known_effects = model.known_effects
    except InputError as error:
        raise error.in_file(file) from None
    _check_repeated(model, file)
    joints: tuple[str, int] | None = None
    for index, item in enumerate(model.effects):
        key = f"effects.{index}"
        if item.name not in known_effects:
            raise InputError(
                f"unknown effect; known effects: {', '.join(sorted(known_effects))}",
                file=file,
                key=f"{key}.name",
                value=item.name,
            )
        effect = model.effect_of(item)
        count = _joint_count(effect, item)
        scalars = {scalar.name: scalar for scalar in effect.scalars(_joints(effect, item))}
        for name in item.parameters:
            if name not in scalars:
                raise InputError(
                    f"unknown parameter; {item.name} has: {', '.join(scalars)}",
                    file=file,
                    key=f"{key}.parameters.{name}",
                )
        for name, scalar in scalars.items():
            key_path = f"{key}.parameters.{name}"
            if name not in item.parameters and scalar.prior is not None:
                continue
            if name not in item.parameters:
                missing_last_joint = scalar.joint is not None and count not in (None, scalar.joint + 1)
                last = f"; joint {count} is here" if missing_last_joint else ""
                raise InputError(
                    f"this key is missing ({scalar.meaning} [{scalar.unit}]){last}", file=file, key=key_path
                )
            value = item.parameters[name]
            if value.unit != scalar.unit:
                raise InputError(
                    f"expected the unit {scalar.unit!r}", file=file, key=f"{key_path}.unit", value=value.unit
                )
            lower, upper = scalar.possible if effect.name in library() else (scalar.lower, scalar.upper)
            if not lower <= value.estimate <= upper:
                raise InputError(
                    f"expected {lower:g} ... {upper:g} {scalar.unit} ({scalar.meaning})",
                    file=file,
                    key=f"{key_path}.estimate",
                    value=value.estimate,
                )
        if count is not None:
            joints = joints or (item.name, count)
            if count != joints[1]:
                raise InputError(
                    f"has {count} joints, but {joints[0]} has {joints[1]}; a model is for arms of one kind",
                    file=file,
                    key=f"{key}.parameters",
                )
    return model


def _check_repeated(model: Model, file: str | Path) -> None:
    """Refuse an effect that stands in a model twice."""
    names = [item.name for item in model.effects]
    for index, name in enumerate(names):
        if name in names[:index]:
            raise InputError(
                "this effect stands here twice, and would act twice; remove one",
                file=file,
                key=f"effects.{index}.name",
                value=name,
            )


def load_model(path: str | Path) -> Model:
    """Load and check a model file; ``nominal`` is short for ``config/models/nominal.yaml``.

    Raises:
        InputError: The file is missing, breaks the schema, or fails :func:`check_model`.
    """
    file = Path(path)
    if not is_file(file):
        shipped = config_directory() / "models" / (file.name if file.suffix else f"{file.name}.yaml")
        if is_file(shipped) and (file.suffix == "" or file.parent in (Path("."), Path("config/models"))):
            file = shipped
    return check_model(load(Model, file), file)


def parse_model(text: str, source: str) -> Model:
    """A model from the text of a model file.

    Raises:
        InputError: The text is not a model; the error names ``source``.
    """
    return check_model(validate(Model, parse_yaml(text, source), source), source)


def model_text(model: Model) -> str:
    """Text of a model file, as :func:`parse_model` reads it."""
    return yaml.safe_dump(model.model_dump(mode="json", exclude_none=True), sort_keys=False, width=100)


def save_model(model: Model, path: str | Path) -> None:
    """Write a model file that :func:`load_model` reads back.

    Raises:
        InputError: The file exists or cannot be written.
    """
    file = Path(path)
    if file.exists():
        raise InputError("this file exists already; model files are never overwritten", file=file)
    write_whole(file, model_text(model))
