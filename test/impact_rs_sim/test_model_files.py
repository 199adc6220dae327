"""A model file: effects on top of nominal physics, in order; checked against what each effect allows."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from impact_rs_sim.effects import library
from impact_rs_sim.errors import InputError
from impact_rs_sim.model import Model, ModelEffect, ParameterValue, check_model, load_model, save_model
from impact_rs_sim.physics import Physics
from impact_rs_sim.scenario import load_scenario

PHYSICS = Physics.nominal(load_scenario("push"), "juice")


def effect(name: str, *values: float, unit: str | None = None) -> ModelEffect:
    """An effect with its scalars in order."""
    scalars = library()[name].scalars(PHYSICS.joint_count)
    parameters = {
        scalar.name: ParameterValue(estimate=value, unit=scalar.unit if unit is None else unit)
        for scalar, value in zip(scalars, np.resize(values, len(scalars)).tolist(), strict=True)
    }
    return ModelEffect(name=name, parameters=parameters)


def model(*effects: ModelEffect, name: str = "m") -> Model:
    return Model(name=name, effects=effects)


def test_every_effect_of_a_model_is_applied_with_its_own_values() -> None:
    found = model(effect("object_mass", 1.2), effect("support_friction", 1.5)).apply(PHYSICS)
    assert found.object.mass == pytest.approx(1.2 * PHYSICS.object.mass)
    assert found.support_friction == pytest.approx(1.5 * PHYSICS.support_friction)


def test_values_per_joint_go_to_their_own_joints() -> None:
    offsets = np.linspace(-0.3, 0.3, 7)
    found = model(effect("torque_offset", *offsets)).apply(PHYSICS)
    np.testing.assert_allclose(found.arms["arm"].torque_offset, offsets)


def test_the_nominal_model_changes_nothing() -> None:
    assert load_model("nominal").apply(PHYSICS) is PHYSICS


def test_a_model_for_arms_with_other_joints_is_refused() -> None:
    values = {f"offset_joint{number}": ParameterValue(estimate=0.1, unit="N m") for number in range(1, 7)}
    short = model(ModelEffect(name="torque_offset", parameters=values))
    with pytest.raises(InputError, match="for arms with 6 joints .* this arm has 7"):
        short.apply(PHYSICS)


def test_a_child_has_another_estimate_of_what_its_parent_had_and_knows_its_parent() -> None:
    parent = model(effect("object_mass", 1.2), effect("support_friction", 1.5))
    child = parent.with_effect(effect("object_mass", 1.1), "child", "parent.yaml")
    assert [item.name for item in child.effects] == ["support_friction", "object_mass"]
    assert child.apply(PHYSICS).object.mass == pytest.approx(1.1 * PHYSICS.object.mass)
    assert (child.parent, child.parent_digest) == ("parent.yaml", parent.digest)
    assert parent.apply(PHYSICS).object.mass == pytest.approx(1.2 * PHYSICS.object.mass)


def test_the_digest_is_of_the_physics_and_of_nothing_else() -> None:
    one = model(effect("object_mass", 1.2))
    assert one.digest == model(effect("object_mass", 1.2), name="other").digest
    assert one.digest != model(effect("object_mass", 1.21)).digest


@pytest.mark.parametrize(
    ("broken", "complaint"),
    [
        (model(ModelEffect(name="ghost", parameters={})), "unknown effect"),
        (model(effect("object_mass", 1.2, unit="kg")), "expected the unit '-'"),
        (model(effect("object_mass", -3.0)), "mass over its assumed value"),
        (model(ModelEffect(name="object_mass", parameters={})), "this key is missing"),
        (
            model(
                ModelEffect(
                    name="object_mass",
                    parameters={
                        **effect("object_mass", 1.0).parameters,
                        "colour": ParameterValue(estimate=1.0, unit="-"),
                    },
                )
            ),
            "unknown parameter",
        ),
    ],
)
def test_what_an_effect_does_not_allow_is_refused_with_file_and_key(broken: Model, complaint: str) -> None:
    with pytest.raises(InputError, match=r"mine\.yaml: effects\.0") as caught:
        check_model(broken, "mine.yaml")
    assert complaint in str(caught.value)


def test_a_model_that_is_written_is_read_back_and_never_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "models" / "mine.yaml"
    written = model(effect("torque_offset", *np.linspace(-0.1, 0.1, 7)), effect("object_mass", 1.2))
    save_model(written, path)
    assert load_model(path).effects == written.effects
    with pytest.raises(InputError, match="never overwritten"):
        save_model(written, path)
