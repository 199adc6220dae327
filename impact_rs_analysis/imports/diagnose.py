"""Comparison and diagnosis of recordings in free motion, in the words of those of campaigns."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from impact_rs_analysis.evidence.torque_balance import (
    ARM,
    Column,
    Motion,
    TorqueBalance,
    columns_of,
    physics_of,
    prepare,
)
from impact_rs_analysis.imports.inference import Pieces, Regression, adjusted, cut
from impact_rs_sim.model import Model
from impact_rs_sim.physics import Physics
from impact_rs_sim.robot import Array
from impact_rs_trials.recordings.mapping import Mapping
from impact_rs_trials.recordings.recording import Recording

SIGNIFICANT = 0.01  # false-discovery rate
LEAST_GAIN = 0.10  # share of the excess error that an accepted effect must remove on unseen stretches
LEAST_SHARE = 0.05  # the same, of the excess error that the model had before anything was added
LEAST_GAIN_JOINT = 0.05  # the same, of one joint's error, for a verdict on that joint
TIE = 0.05  # difference in log error below which two explanations are the same
MOST_EFFECTS = 5
UNSEEN = 20.0  # parameter scales; a wider interval says nothing
SLOW = 0.05  # rad/s

NOT_MEASURED = {
    "motor side": "the motor side is not in this recording",
    "actuation": "the commanded torque is not in this recording",
    "joint torque": "nothing of it is in the recorded torque",
    "link inertia": "nothing of it is in the recorded torque",
    "contact": "no contact was recorded",
    "object": "no object was recorded",
    "scene": "nothing of it is in the recorded torque",
}
BALANCE_TEXT = (
    "rms of recorded minus predicted joint torque, all joints and samples, in N m; rigid model in free motion, both "
    "sides low-passed"
)


@dataclass(frozen=True)
class Setup:
    """Recordings, ready to be compared with a model."""

    recordings: list[Recording]
    mapping: Mapping
    motions: list[Motion]
    balance: TorqueBalance
    physics: Physics
    rest: Array

    @staticmethod
    def make(recordings: list[Recording], mapping: Mapping, model: Model | None) -> Setup:
        """Filter the recordings and predict them."""
        motions = [prepare(recording, mapping.low_pass) for recording in recordings]
        physics = physics_of(mapping, motions)
        if model is not None:
            physics = model.apply(physics)
        balance = TorqueBalance(motions)
        return Setup(recordings, mapping, motions, balance, physics, balance.recorded - balance.predict(physics))

    @property
    def facts(self) -> dict[str, Any]:
        """What was read, and how it was filtered."""
        motion = self.motions[0]
        kept = sum(m.time[m.kept].size / m.rate for m in self.motions)
        return {
            "files": [str(recording.path) for recording in self.recordings],
            "robot": self.mapping.robot,
            "end_effector_mass_kg": self.mapping.end_effector.mass,
            "samples": int(sum(recording.time.size for recording in self.recordings)),
            "recorded_s": float(sum(recording.time[-1] - recording.time[0] for recording in self.recordings)),
            "used_s": float(kept),
            "sampled_Hz": float(1.0 / np.median(np.diff(self.recordings[0].time))),
            "low_pass_Hz": motion.cut_off,
            "low_pass": "zero-phase Butterworth of order 4 on both sides, ends cut off",
            "signals": sorted({"position", "velocity", "torque", *self.recordings[0].others}),
        }


def _rms(values: Array, axis: int | None = None) -> Any:
    return np.sqrt(np.mean(np.square(values), axis=axis))


def compare(setup: Setup) -> dict[str, Any]:
    """How far the model is from the recordings, and where."""
    rest, velocity = setup.rest, setup.balance.velocity
    noise = np.maximum(setup.balance.noise, 1e-12)
    total = float(np.sum(np.square(rest)))
    cells = []
    for joint in range(rest.shape[1]):
        speed = velocity[:, joint]
        for phase, chosen in (
            ("moving up", speed > SLOW),
            ("moving down", speed < -SLOW),
            ("slow", np.abs(speed) <= SLOW),
        ):
            if np.count_nonzero(chosen) < 5:
                continue
            part = rest[chosen, joint]
            cells.append(
                {
                    "phase": phase,
                    "signal": "torque",
                    "index": f"joint{joint + 1}",
                    "share": float(np.sum(np.square(part)) / max(total, 1e-300)),
                    "error": float(part.mean()),
                    "rms": float(_rms(part)),
                    "unit": "N m",
                    "times_noise": float(_rms(part) / noise[joint]),
                }
            )
    cells.sort(key=lambda cell: -float(cell["share"]))  # type: ignore[arg-type]
    score = float(_rms(rest))
    return {
        "kind": "recording",
        "score": score,
        "score_is": BALANCE_TEXT,
        "noise_floor": float(_rms(noise)),
        "noise_floor_is": "torque noise below the cut-off, if it is as dense there as just above [N m]",
        "levels": {
            "free_motion": {
                "what": "torque balance of the arm while it touches nothing",
                "times_noise": float(_rms(_rms(rest, 0) / noise)),
                "signals": [
                    {
                        "signal": "torque",
                        "index": f"joint{joint + 1}",
                        "error": float(_rms(rest[:, joint])),
                        "mean": float(rest[:, joint].mean()),
                        "unit": "N m",
                        "noise": float(noise[joint]),
                        "times_noise": float(_rms(rest[:, joint]) / noise[joint]),
                    }
                    for joint in range(rest.shape[1])
                ],
            }
        },
        "where": cells,
        "recording": setup.facts,
        "not_measured": ["velocity jump", "contact and impulses", "object", "controller and its references"],
    }


class Diagnosis:
    """Search over the effects that act on the recorded torque.

    Args:
        setup: Recordings and model.
        model: Effects it has are not tried again.
        only: Names of the effects to consider; None: all.
    """

    def __init__(self, setup: Setup, model: Model | None, only: list[str] | None) -> None:
        self.setup = setup
        known = (model or Model(name="nominal")).known_effects
        present = set() if model is None else {item.name for item in model.effects}
        self.effects = {
            name: effect for name, effect in known.items() if name not in present and (only is None or name in only)
        }
        columns: list[Column] = []
        self.variants: dict[str, list[tuple[int, ...]]] = {}
        self.not_measured: list[str] = []
        for name, effect in self.effects.items():
            own = columns_of(effect, setup.physics, setup.balance)
            if not own:
                self.not_measured.append(name)
                continue
            groups: dict[float | None, list[int]] = {}
            for column in own:
                groups.setdefault(column.variant, []).append(len(columns))
                columns.append(column)
            self.variants[name] = [tuple(group) for group in groups.values()]
        self.pieces: Pieces = cut(setup.balance)
        self.regression = Regression(setup.rest, columns, self.pieces)
        self.columns = columns
        self.noise = float(np.mean(np.square(setup.balance.noise)))
        self.chosen: dict[str, tuple[int, ...]] = {}
        self._select()

    def model(self, chosen: dict[str, tuple[int, ...]]) -> tuple[int, ...]:
        """Columns of chosen effects."""
        return tuple(index for group in chosen.values() for index in group)

    def error(self, model: tuple[int, ...]) -> float:
        """Mean square held-out error in units of each joint's rest: every joint counts alike [-]."""
        return float(np.mean(self.regression.held_out(model) / np.square(self.regression.sigma)))

    def rms(self, model: tuple[int, ...]) -> float:
        """Held-out error over all joints [N m]."""
        return math.sqrt(float(np.mean(self.regression.held_out(model))))

    def noticeable(self, base: tuple[int, ...], group: tuple[int, ...]) -> bool:
        """Whether the interval of some parameter lies wholly beyond the change that its effect calls noticeable.

        Columns that stop at a bound do not count: there the interval means nothing.
        """
        model = base + group
        estimates = self.regression.estimate(model)[len(base) :]
        halves = self.regression.half_width(model)[len(base) :]
        return any(
            abs(value - column.nominal) - half > column.scale and not _at_bound(column, value)
            for column, value, half in zip((self.columns[i] for i in group), estimates, halves, strict=True)
        )

    def best_variant(self, name: str, base: tuple[int, ...]) -> tuple[int, ...]:
        """Columns of an effect; of alternatives the one that fits best (not held out: a profile)."""

        def misfit(group: tuple[int, ...]) -> float:
            return float(np.mean(np.square(self.regression.residual(base + group) / self.regression.sigma)))

        groups = self.variants[name]
        return groups[0] if len(groups) == 1 else min(groups, key=misfit)

    def _select(self) -> None:
        floor = float(np.mean(np.square(self.setup.balance.noise / self.regression.sigma)))
        start = max(self.error(()) - floor, 0.0)
        for _ in range(MOST_EFFECTS):
            base = self.model(self.chosen)
            before = self.error(base)
            rest = [name for name in self.variants if name not in self.chosen]
            groups = {name: self.best_variant(name, base) for name in rest}
            p_values = adjusted({name: self.regression.p_value(base, group) for name, group in groups.items()})
            ranked = sorted(rest, key=lambda name: self.error(base + groups[name]))
            accepted = None
            for name in ranked:
                after = self.regression.held_out(base + groups[name]) / np.square(self.regression.sigma)
                folds = self.regression.held_out(base) / np.square(self.regression.sigma)
                gain = before - float(after.mean())
                enough = gain > max(LEAST_GAIN * max(before - floor, 0.0), LEAST_SHARE * start)
                noticed = self.noticeable(base, groups[name])
                if (
                    p_values[name] < SIGNIFICANT
                    and enough
                    and noticed
                    and np.mean(after.mean(axis=1) < folds.mean(axis=1)) > 0.5
                ):
                    accepted = name
                    break
            if accepted is None:
                break
            self.chosen[accepted] = groups[accepted]
        for name in list(self.chosen):  # what a later effect made superfluous
            others = {other: group for other, group in self.chosen.items() if other != name}
            if self.error(self.model(others)) <= self.error(self.model(self.chosen)):
                self.chosen = others

    def _tied(self, mine: tuple[int, ...], other: tuple[int, ...]) -> bool:
        """Whether another explanation predicts unseen stretches as well (mean log ratio within two standard errors)."""
        weight = np.square(self.regression.sigma)
        first = (self.regression.held_out(mine) / weight).mean(axis=1)
        second = (self.regression.held_out(other) / weight).mean(axis=1)
        return _log_tie(first, second)

    def swaps(self) -> dict[str, list[str]]:
        """Per chosen effect, the effects that could stand in its place."""
        result: dict[str, list[str]] = {}
        full = self.model(self.chosen)
        for name in self.chosen:
            others = {other: group for other, group in self.chosen.items() if other != name}
            base = self.model(others)
            for rival in self.variants:
                if rival in self.chosen:
                    continue
                group = self.best_variant(rival, base)
                swapped = base + group
                if self._tied(full, swapped):
                    result.setdefault(name, []).append(rival)
        return result


def _log_tie(mine: Array, other: Array) -> bool:
    ratio = np.log(np.maximum(other, 1e-300) / np.maximum(mine, 1e-300))
    spread = float(ratio.std(ddof=1) / math.sqrt(ratio.size))
    return float(ratio.mean()) < max(TIE, min(2.0 * spread, 0.25))


def diagnose(setup: Setup, model: Model | None = None, only: list[str] | None = None) -> tuple[dict[str, Any], Array]:
    """Which effects are missing, joint by joint where an effect has one parameter per joint.

    Returns:
        The diagnosis, and what the named effects leave of the torque, ``(k, n)`` [N m].
    """
    believed = model or Model(name="nominal")
    search = Diagnosis(setup, model, only)
    regression = search.regression
    full = search.model(search.chosen)
    swaps = search.swaps()
    partners: dict[str, list[str]] = {}
    for name, rivals in swaps.items():
        for rival in rivals:
            partners.setdefault(rival, []).append(name)
    raw: dict[str, float] = {}
    tests: dict[str, tuple[tuple[int, ...], tuple[int, ...]]] = {}
    for name in search.variants:
        group = search.chosen.get(name)
        base = tuple(i for i in full if group is None or i not in group)
        group = group or search.best_variant(name, base)
        tests[name] = (base, group)
        raw[name] = regression.p_value(base, group)
        if name in search.chosen:
            for index in group:
                if search.columns[index].joint is not None:
                    raw[f"{name}/{index}"] = regression.p_value(tuple(i for i in full if i != index), (index,))
    p_values = adjusted(raw)
    reports = [
        _report(search, name, *tests[name], p_values, swaps.get(name) or partners.get(name, [])) for name in tests
    ]
    order = {name: number for number, name in enumerate(search.chosen)}
    reports.sort(key=lambda report: (order.get(report["name"], len(order)), report["held_out_error_after"]))
    for name in search.not_measured:
        effect = search.effects[name]
        why = NOT_MEASURED.get(effect.acts_on, "nothing of it is in the recorded torque")
        reports.append(
            {
                "name": name,
                "sentence": effect.sentence,
                "verdict": "NOT-IDENTIFIABLE",
                "reason": f"not measured: {why}",
                "parameters": {},
                "joints": [],
                "held_out_error_before": None,
                "held_out_error_after": None,
                "p_value": None,
            }
        )
    before, after = search.rms(()), search.rms(full)
    noise = math.sqrt(search.noise)
    left = max(after**2 - search.noise, 0.0) / max(before**2 - search.noise, 1e-300)
    verdict = "+".join(search.chosen)
    if not verdict:
        verdict = "NONE-EXPLAINS" if before > 2.0 * noise else "NOTHING-MISSING"
    document = {
        "kind": "recording",
        "verdict": verdict,
        "effects": reports,
        "confusable": [[name, *rivals] for name, rivals in swaps.items()],
        "named": list(search.chosen),
        "noise_floor": noise,
        "held_out_error_before": before,
        "held_out_error_after": after,
        "error_is": "rms torque on stretches of time that the fit has not seen, all joints [N m]",
        "joints": _joints(search, full),
        "unexplained": _unexplained(search, full, left),
        "next_experiment": _next(search, swaps),
        "held_out": (
            f"{search.pieces.count} blocks of {search.pieces.seconds:.2g} s in {int(search.pieces.fold.max()) + 1} "
            "stretches of neighbours; every stretch is predicted from the others without the blocks that touch it"
        ),
        "remarks": _remarks(search, left),
        "recording": setup.facts,
        "model": {"name": believed.name, "digest": believed.digest},
        "formulas": [spec.model_dump(mode="json") for spec in believed.formulas],
    }
    return document, regression.residual(full)


def _joints(search: Diagnosis, full: tuple[int, ...]) -> list[dict[str, Any]]:
    before = np.sqrt(search.regression.held_out(()).mean(axis=0))
    after = np.sqrt(search.regression.held_out(full).mean(axis=0))
    noise = search.setup.balance.noise
    return [
        {"joint": f"joint{j + 1}", "before": float(before[j]), "after": float(after[j]), "noise": float(noise[j])}
        for j in range(before.size)
    ]


def _report(
    search: Diagnosis,
    name: str,
    base: tuple[int, ...],
    group: tuple[int, ...],
    p_values: dict[str, float],
    rivals: list[str],
) -> dict[str, Any]:
    """What is said of one effect, given the chosen others."""
    regression = search.regression
    fitted = base + group
    estimate = regression.estimate(fitted)[len(base) :]
    half = regression.half_width(fitted)[len(base) :]
    columns = [search.columns[index] for index in group]
    parameters: dict[str, Any] = {
        column.name: {
            "estimate": float(value),
            "ci95": [float(value - width), float(value + width)],
            "unit": column.unit,
            "meaning": column.meaning,
        }
        for column, value, width in zip(columns, estimate, half, strict=True)
    }
    if columns[0].variant is not None:
        effect = search.effects[name].parameters[-1]
        parameters[effect.name] = {
            "estimate": columns[0].variant,
            "ci95": None,
            "unit": effect.unit,
            "meaning": f"{effect.meaning}; the best of a grid, without interval",
        }
    unseen = [width > UNSEEN * column.scale for column, width in zip(columns, half, strict=True)]
    bound = [_at_bound(column, value) for column, value in zip(columns, estimate, strict=True)]
    chosen = name in search.chosen
    if all(unseen):
        verdict = "NOT-IDENTIFIABLE"
    elif not chosen:
        verdict = f"CONFUSABLE-WITH{{{', '.join(sorted(rivals))}}}" if rivals else "NO-IMPROVEMENT"
    elif all(bound) or (any(bound) and columns[0].joint is None):
        verdict = "AT-BOUND"
    elif rivals:
        verdict = f"CONFUSABLE-WITH{{{', '.join(sorted(rivals))}}}"
    else:
        verdict = "CONFIRMED"
    reason = ""
    if not chosen and p_values[name] < SIGNIFICANT and not search.noticeable(base, group):
        reason = "significant, but no estimate is surely beyond what the library calls noticeable"
    report: dict[str, Any] = {
        "name": name,
        "sentence": search.effects[name].sentence,
        "verdict": verdict,
        "parameters": parameters,
        "reason": reason,
        "held_out_error_before": search.rms(base),
        "held_out_error_after": search.rms(fitted),
        "p_value": p_values[name],
        "joints": [],
    }
    if chosen and columns[0].joint is not None:
        report["joints"] = [
            _joint_report(
                search, fitted, index, float(value), float(width), at_bound, blind, p_values[f"{name}/{index}"]
            )
            for index, value, width, at_bound, blind in zip(
                group, estimate.tolist(), half.tolist(), bound, unseen, strict=True
            )
        ]
        confirmed = any(entry["verdict"] == "CONFIRMED" for entry in report["joints"])
        if verdict == "CONFIRMED" and any(bound) and not confirmed:
            report["verdict"] = "AT-BOUND"
    return report


def _at_bound(column: Column, value: float) -> bool:
    """Whether an estimate stops at a bound that is not the value at which nothing happens."""
    return any(
        abs(value - bound) < 1e-6 * column.scale and abs(bound - column.nominal) > 1e-9
        for bound in (column.lower, column.upper)
    )


def _joint_report(
    search: Diagnosis,
    full: tuple[int, ...],
    index: int,
    value: float,
    half: float,
    at_bound: bool,
    unseen: bool,
    p_value: float,
) -> dict[str, Any]:
    """Verdict on one joint's parameter: with and without it, everything else as chosen."""
    column = search.columns[index]
    joint = column.joint
    assert joint is not None
    without = tuple(i for i in full if i != index)
    errors, errors_without = (search.regression.held_out(model)[:, joint] for model in (full, without))
    rivals = []
    for name in search.variants:
        if name in search.chosen:
            continue
        group = search.best_variant(name, full)
        own = tuple(i for i in group if search.columns[i].joint == joint)
        if own and _log_tie(errors, search.regression.held_out(without + own)[:, joint]):
            rivals.append(name)
    gain = 1.0 - float(errors.mean() / errors_without.mean())
    if at_bound:
        verdict = "AT-BOUND"
    elif unseen:
        verdict = "NOT-IDENTIFIABLE"
    elif p_value >= SIGNIFICANT or gain < LEAST_GAIN_JOINT:
        verdict = "NO-IMPROVEMENT"
    else:
        verdict = f"CONFUSABLE-WITH{{{', '.join(sorted(rivals))}}}" if rivals else "CONFIRMED"
    return {
        "joint": f"joint{joint + 1}",
        "verdict": verdict,
        "estimate": value,
        "low": value - half,
        "high": value + half,
        "unit": column.unit,
        "before": math.sqrt(float(errors_without.mean())),
        "after": math.sqrt(float(errors.mean())),
        "p_value": p_value,
    }


def _unexplained(search: Diagnosis, full: tuple[int, ...], left: float) -> dict[str, Any]:
    rest = search.regression.residual(full)
    velocity = search.setup.balance.velocity
    total = float(np.sum(np.square(rest)))
    noise = search.setup.balance.noise
    cells = []
    for joint in range(rest.shape[1]):
        for phase, chosen in (
            ("moving up", velocity[:, joint] > SLOW),
            ("moving down", velocity[:, joint] < -SLOW),
            ("slow", np.abs(velocity[:, joint]) <= SLOW),
        ):
            part = rest[chosen, joint]
            if part.size < 5:
                continue
            cells.append(
                {
                    "phase": phase,
                    "signal": "torque",
                    "index": f"joint{joint + 1}",
                    "share": float(np.sum(np.square(part)) / max(total, 1e-300)),
                    "times_noise": float(_rms(part) / max(noise[joint], 1e-300)),
                    "rms_Nm": float(_rms(part)),
                }
            )
    cells.sort(key=lambda cell: -float(cell["share"]))  # type: ignore[arg-type]
    return {"share_of_excess": left, "where": cells[:10]}


def _next(search: Diagnosis, swaps: dict[str, list[str]]) -> dict[str, Any] | None:
    """What to record next, in plain words."""
    tied = {name for first, rivals in swaps.items() for name in (first, *rivals)}
    rigid = tied & {"torque_offset", "torque_gain", "end_effector_payload", "base_tilt", "external_spring"}
    friction = tied & {"joint_coulomb_friction", "joint_viscous_friction", "joint_stribeck_friction"}
    if len(friction) > 1:
        what = "the same motion at a quarter and at twice the speed: Coulomb friction stays, viscous friction does not"
        splits = sorted(friction)
    elif len(rigid) > 1:
        what = "hold still in ten poses far apart, once with a known mass of 0.5 kg to 1 kg on the flange"
        splits = sorted(rigid)
    else:
        what = "an impact campaign, because motor inertia, contact and object act on nothing in a free motion"
        splits = sorted(search.not_measured)
    return {"advice": what, "splits": splits}


def _remarks(search: Diagnosis, left: float) -> list[str]:
    remarks = [
        "one recording is one condition: stretches of time are held out in its place, and whether the estimates hold "
        "at other speeds, poses or temperatures is not tested",
        "nothing was repeated, so there is no pure error: the noise floor is that of the torque signal, and a model "
        "error larger than it does not have to come from an effect of the library",
    ]
    if search.chosen and left > 0.1:
        remarks.append(
            f"{', '.join(search.chosen)} helps, but {100.0 * left:.0f} % of the excess error stays: something else is "
            "missing, too, possibly in the link parameters"
        )
    if search.setup.physics.arms[ARM].motor_inertia_reduced.max() == 0.0:
        remarks.append("the torque was measured behind the motors, so their inertia is not in it")
    return remarks
