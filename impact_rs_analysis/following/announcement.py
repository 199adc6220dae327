# SPDX-License-Identifier: Apache-2.0
"""Text of a change in everyday quantities: kilograms and percent."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import numpy as np

from impact_rs_analysis.following.documents import Followed
from impact_rs_sim.numbers import estimate_text
from impact_rs_sim.physics import ArmPhysics, Physics
from impact_rs_sim.robots.robot import Array

MAX_NAMED_PARAMETERS = 3  # of an effect in a sentence, the most certain ones
MIN_RELATIVE_BASE = 1e-9  # smallest value that a relative change refers to, and smallest change


class EverydayQuantity(NamedTuple):
    """An everyday quantity of a scene.

    Attributes:
        noun: Body that has it.
        more: Comparative of a larger value.
        less: Comparative of a smaller value.
        unit: Unit of a change; ``%``: share of the value before.
        of: Its value, in the unit.
        value_unit: Unit of the value, of a change from zero; empty: it has none.
    """

    noun: str
    more: str
    less: str
    unit: str
    of: Callable[[Physics], float]
    value_unit: str = ""


def mean_of(of: Callable[[ArmPhysics], Array | float]) -> Callable[[Physics], float]:
    """Mean over the joints and arms; 0 without an arm."""
    return lambda physics: float(np.mean([np.mean(of(arm)) for arm in physics.arms.values()])) if physics.arms else 0.0


def _mass(physics: Physics) -> float:
    """Mass of the object [kg]; 0 of a fixed one, which no effect changes."""
    return 0.0 if physics.object.fixed else physics.object.mass


QUANTITIES = (
    EverydayQuantity("the object", "heavier", "lighter", "kg", _mass),
    EverydayQuantity("the tool", "heavier", "lighter", "kg", mean_of(lambda arm: arm.end_effector.mass)),
    EverydayQuantity("friction of the pad", "higher", "lower", "%", lambda physics: physics.pad_friction),
    EverydayQuantity("friction of the support", "higher", "lower", "%", lambda physics: physics.support_friction),
    EverydayQuantity(
        "dry friction of the joints", "higher", "lower", "%", mean_of(lambda arm: arm.friction.coulomb), "N m"
    ),
    EverydayQuantity(
        "viscous friction of the joints",
        "higher",
        "lower",
        "%",
        mean_of(lambda arm: arm.friction.viscous),
        "N m s/rad",
    ),
    EverydayQuantity(
        "motor inertia", "larger", "smaller", "%", mean_of(lambda arm: arm.motor_inertia_reduced), "kg m^2"
    ),
    EverydayQuantity("stiffness of the joints", "higher", "lower", "%", mean_of(lambda arm: arm.stiffness), "N m/rad"),
    EverydayQuantity(
        "stiffness of the pad", "higher", "lower", "%", mean_of(lambda arm: arm.pad_stiffness or 0.0), "N/m"
    ),
)


def in_words(effect: str, parameters: Sequence[Followed], scenes: Iterable[tuple[Physics, Physics]]) -> str:
    """Text of a change of an effect: its significantly changed parameters, else the most changed one.

    Args:
        effect: Name.
        parameters: Its parameters, after the change.
        scenes: Physics of the hits since then, before and after the change; their objects may differ.
    """
    sure = [p for p in parameters if not p.ci95[0] <= p.estimate - p.change <= p.ci95[1]]
    more = f" and {len(sure) - MAX_NAMED_PARAMETERS} more" if len(sure) > MAX_NAMED_PARAMETERS else ""
    sure = sorted(sure, key=_by_significance)[:MAX_NAMED_PARAMETERS]
    shown = sure or sorted(parameters, key=_by_significance)[:1]
    texts = ", ".join(_text(parameter) for parameter in shown)
    scenes = list(scenes)
    plain = " and ".join(filter(None, (_plain(quantity, scenes) for quantity in QUANTITIES)))
    return f"{plain} ({effect}: {texts}{more})" if plain else f"{effect}: {texts}{more}"


def _by_significance(parameter: Followed) -> float:
    """Sort key: largest change over interval width first."""
    return -abs(parameter.change) / max(parameter.ci95[1] - parameter.ci95[0], 1e-300)


def _text(parameter: Followed) -> str:
    """A parameter with its change and interval."""
    half = 0.5 * (parameter.ci95[1] - parameter.ci95[0])
    value, low, high = estimate_text(parameter.change, (parameter.change - half, parameter.change + half))
    sign = "" if value.startswith("-") else "+"
    unit = "" if parameter.unit == "-" else f" {parameter.unit}"
    return f"{parameter.parameter.partition('.')[2]} {sign}{value}{unit} [{low}, {high}]"


def _plain(quantity: EverydayQuantity, scenes: Sequence[tuple[Physics, Physics]]) -> str:
    """Change of a quantity over all scenes; empty without a change, or if its sign differs between scenes."""
    unit = quantity.unit
    if unit == "%" and any(abs(quantity.of(before)) < MIN_RELATIVE_BASE for before, _ in scenes):
        unit = quantity.value_unit  # there is no share of nothing
    changes = []
    for before, after in scenes:
        old, change = quantity.of(before), quantity.of(after) - quantity.of(before)
        changes.append(change * 100.0 / old if unit == "%" else change)
    low, high = min(changes, default=0.0), max(changes, default=0.0)
    if low < MIN_RELATIVE_BASE and high > -MIN_RELATIVE_BASE:
        return ""
    sizes = dict.fromkeys(f"{size:.2g}" for size in sorted((abs(low), abs(high))))
    size = " ".join(filter(None, (" to ".join(sizes), unit)))
    return f"{quantity.noun} is {size} {quantity.more if low > 0.0 else quantity.less}"
