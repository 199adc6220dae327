"""Model files: what we believe about the physics, on top of the scenario's nominal values.

A model is a list of effects with their parameters. Adding an effect writes a new file that names its parent, so the way
from the nominal model to the present one can be read back (``impact-rs history``).
"""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import yaml
from pydantic import Field

from impact_rs_sim.effects import Effect, library
from impact_rs_sim.effects.formula import FormulaEffect, FormulaSpec
from impact_rs_sim.errors import InputError
from impact_rs_sim.paths import config_directory
from impact_rs_sim.physics import Physics
from impact_rs_sim.schema import Schema, load

JOINT_COUNT = 7


class ParameterValue(Schema):
    """A believed number."""

    estimate: float = Field(description="believed value, in its unit")
    unit: str = Field(description="unit, '-' where it has none")
    ci95: tuple[float, float] | None = Field(None, description="95 % interval, in the same unit")


class ModelEffect(Schema):
    """One effect that is switched on."""

    name: str = Field(description="name of the effect (impact-rs effects lists them)")
    parameters: dict[str, ParameterValue] = Field(description="its parameters")


class Model(Schema):
    """A belief about the physics (``config/models/*.yaml``)."""

    name: str = Field(description="name of the model")
    parent: str | None = Field(None, description="file of the model this one was made from")
    parent_digest: str | None = Field(None, description="digest of the parent's content when this was made")
    note: str = Field("", description="why it was made")
    formulas: tuple[FormulaSpec, ...] = Field((), description="user-defined effects")
    effects: tuple[ModelEffect, ...] = Field((), description="effects that are switched on, in order")

    @property
    def known_effects(self) -> dict[str, Effect]:
        """The library and this model's own formulas, by name."""
        return {**library(), **{spec.name: FormulaEffect(spec) for spec in self.formulas}}

    @property
    def digest(self) -> str:
        """Digest of what the model says about the physics; name, note and parent do not count."""
        content = self.model_dump_json(include={"formulas", "effects"})
        return hashlib.sha256(content.encode()).hexdigest()[:16]

    def apply(self, physics: Physics) -> Physics:
        """Nominal physics with every effect of the model."""
        known = self.known_effects
        for item in self.effects:
            effect = known[item.name]
            physics = effect.apply_vector(
                physics, np.array([item.parameters[scalar.name].estimate for scalar in effect.scalars(JOINT_COUNT)])
            )
        return physics

    def with_effect(self, item: ModelEffect, name: str, parent: str, formulas: tuple[FormulaSpec, ...] = ()) -> Model:
        """A child model with one more effect, or with another estimate of one it has."""
        kept = tuple(effect for effect in self.effects if effect.name != item.name)
        own = {spec.name: spec for spec in (*self.formulas, *formulas)}
        return Model(
            name=name,
            parent=parent,
            parent_digest=self.digest,
            note="",
            formulas=tuple(own.values()),
            effects=(*kept, item),
        )


def check_model(model: Model, file: str | Path) -> Model:
    """Check a model against the effects it names.

    Raises:
        InputError: An unknown effect or parameter, a missing one, a wrong unit, or a value out of bounds.
    """
    try:
        known = model.known_effects
    except InputError as error:
        raise InputError(error.message, file=file) from None
    for index, item in enumerate(model.effects):
        key = f"effects.{index}"
        if item.name not in known:
            raise InputError(
                f"unknown effect; known effects: {', '.join(sorted(known))}",
                file=file,
                key=f"{key}.name",
                value=item.name,
            )
        scalars = {scalar.name: scalar for scalar in known[item.name].scalars(JOINT_COUNT)}
        for name in item.parameters:
            if name not in scalars:
                raise InputError(
                    f"unknown parameter; {item.name} has: {', '.join(scalars)}",
                    file=file,
                    key=f"{key}.parameters.{name}",
                )
        for name, scalar in scalars.items():
            place = f"{key}.parameters.{name}"
            if name not in item.parameters:
                raise InputError(f"this key is missing ({scalar.meaning} [{scalar.unit}])", file=file, key=place)
            value = item.parameters[name]
            if value.unit != scalar.unit:
                raise InputError(f"expected the unit {scalar.unit!r}", file=file, key=f"{place}.unit", value=value.unit)
            if not scalar.lower <= value.estimate <= scalar.upper:
                raise InputError(
                    f"expected {scalar.lower:g} ... {scalar.upper:g} {scalar.unit} ({scalar.meaning})",
                    file=file,
                    key=f"{place}.estimate",
                    value=value.estimate,
                )
    return model


def load_model(path: str | Path) -> Model:
    """Load and check a model file; ``nominal`` is short for ``config/models/nominal.yaml``.

    Raises:
        InputError: The file is missing, breaks the schema, or fails :func:`check_model`.
    """
    file = Path(path)
    if not file.exists():
        shipped = config_directory() / "models" / (file.name if file.suffix else f"{file.name}.yaml")
        if shipped.exists() and (file.suffix == "" or file.parent in (Path("."), Path("config/models"))):
            file = shipped
    return check_model(load(Model, file), file)


def save_model(model: Model, path: str | Path) -> None:
    """Write a model file that :func:`load_model` reads back.

    Raises:
        InputError: The file exists or cannot be written.
    """
    file = Path(path)
    if file.exists():
        raise InputError("this file exists already; model files are never overwritten", file=file)
    content = model.model_dump(mode="json", exclude_none=True)
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(yaml.safe_dump(content, sort_keys=False, width=100), encoding="utf-8")
    except OSError as error:
        raise InputError(f"cannot be written: {error.strerror}", file=file) from None
