# SPDX-License-Identifier: Apache-2.0
"""A change of parameters in words: first what a person would measure, in kilograms and percent, then the parameters."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

from impact_rs_analysis.following.lessons import Followed
from impact_rs_sim.numbers import estimate_text
from impact_rs_sim.physics import Physics

MOST_NAMED = 3  # parameters of an effect in a sentence, those that are surest
LEAST = 1e-9  # of a value of which a share is told


class Quantity(NamedTuple):
    """What a parameter is to a person.

    Attributes:
        noun: What it belongs to.
        more: Comparative of a larger value.
        less: Comparative of a smaller value.
        unit: Unit of the change; ``%``: share of the value before.
        worth: What a change of 1 of the parameter is, in that unit; of ``%`` what the parameter adds to at 0.
    """

    noun: str
    more: str
    less: str
    unit: str
    worth: Callable[[Physics], float]


QUANTITIES = {
    "object_mass.scale": Quantity("the object", "heavier", "lighter", "kg", lambda physics: physics.object.mass),
    "end_effector_payload.mass": Quantity("the tool", "heavier", "lighter", "kg", lambda _: 1.0),
    "pad_friction.friction": Quantity(
        "friction of the pad", "higher", "lower", "%", lambda physics: physics.pad_friction
    ),
    "support_friction.friction": Quantity(
        "friction of the support", "higher", "lower", "%", lambda physics: physics.support_friction
    ),
    "motor_inertia_scale.scale": Quantity("motor inertia", "larger", "smaller", "%", lambda _: 0.0),
    "joint_stiffness.scale": Quantity("stiffness of the joints", "higher", "lower", "%", lambda _: 0.0),
    "pad_compliance.scale": Quantity("stiffness of the pad", "higher", "lower", "%", lambda _: 0.0),
}
JOINT_FRICTION = ("joint_coulomb_friction", "joint_viscous_friction")


def in_words(effect: str, parameters: Sequence[Followed], scenes: Sequence[Physics]) -> str:
    """A change of an effect's parameters: those that moved for certain, else the one that moved most.

    Args:
        effect: Name.
        parameters: Its parameters, after the change.
        scenes: Nominal physics of the hits since then; their objects may differ.
    """
    sure = [p for p in parameters if not p.ci95[0] <= p.estimate - p.change <= p.ci95[1]]
    more = f" and {len(sure) - MOST_NAMED} more" if len(sure) > MOST_NAMED else ""
    sure = sorted(sure, key=_surely)[:MOST_NAMED]
    shown = sure or sorted(parameters, key=_surely)[:1]
    texts = ", ".join(_text(one) for one in shown)
    told = " and ".join(filter(None, (_told(one, scenes) for one in shown)))
    return f"{told} ({effect}: {texts}{more})" if told else f"{effect}: {texts}{more}"


def _surely(one: Followed) -> float:
    """Sorts what moved most, in multiples of its interval, to the front."""
    return -abs(one.change) / max(one.ci95[1] - one.ci95[0], 1e-300)


def _text(one: Followed) -> str:
    """A parameter with its change and interval."""
    half = 0.5 * (one.ci95[1] - one.ci95[0])
    value, low, high = estimate_text(one.change, (one.change - half, one.change + half))
    sign = "" if value.startswith("-") else "+"
    unit = "" if one.unit == "-" else f" {one.unit}"
    return f"{one.parameter.partition('.')[2]} {sign}{value}{unit} [{low}, {high}]"


def _told(one: Followed, scenes: Sequence[Physics]) -> str:
    """A change as a person says it; empty where the parameter says it best."""
    effect, _, name = one.parameter.partition(".")
    before = one.estimate - one.change
    if effect in JOINT_FRICTION and abs(before) > LEAST:
        joint = name.rpartition("joint")[2]
        return f"friction of joint {joint} {_share(one.change / before)} {'higher' if one.change > 0.0 else 'lower'}"
    quantity = QUANTITIES.get(one.parameter)
    if quantity is None:
        return ""
    worths = sorted({quantity.worth(scene) for scene in scenes})
    comparative = quantity.more if one.change > 0.0 else quantity.less
    if quantity.unit == "%":
        whole = worths[0] + before
        if len(worths) > 1 or abs(whole) < LEAST:
            return ""
        return f"{quantity.noun} is {_share(one.change / whole)} {comparative}"
    sizes = [f"{abs(one.change) * worth:.2g}" for worth in (worths[0], worths[-1])]
    size = " to ".join(dict.fromkeys(sizes))
    return f"{quantity.noun} is {size} {quantity.unit} {comparative}"


def _share(value: float) -> str:
    """A share in percent, two digits."""
    return f"{100.0 * abs(value):.2g} %"
