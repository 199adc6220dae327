# SPDX-License-Identifier: Apache-2.0
"""Follow a model from hit to hit: planted changes, false alarms, days that warm up, a drift.

Hits are pushes by the plant (Bullet, with flexible drives, a compliant pad, a controller and scatter of the object's
pose), each read as a row of a table: state in the tick before the object moves, mean velocities 5 to 15 ms after it,
and sensor noise on top. They are predicted by the rigid impact map, so that measurement and model are two simulators.
Every hit of a day is drawn from a pool of simulated ones (``pool_*.npz`` in DIR) and has its own noise.

* **Changed days**: an effect is planted in the plant after ``BEFORE`` hits. Hits to the alarm, whether its effect is
  named, and the prediction error from the sixth hit after the change on, over that of an *offline* fit: the planted
  effect and its first hit are known, and it is fitted to all hits after the change.
* **Quiet days**: nothing changes. Alarms in all hits that were watched.
* **Warming days**: nothing changes that a hit could show, and yet not every hit is alike: dry friction of the joints
  falls from 0.3 N m to 0 over the day, as they warm up, and the scale of all velocities drifts by 1 per cent. Alarms.
* **A drifting day**, a stand-in for days of a real robot: restitution and friction of the pad drift, each hit is
  simulated with its own. Error of the object's sliding distance v^2 / (2 mu g), mu known, of the followed and of the
  frozen model.
"""

from __future__ import annotations

import argparse
import copy
import math
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from impact_table_cases import POSE, _twist, write_csv

from benchmarks.harness import Case, Row, Work, median_and_largest, quantiles
from benchmarks.results import Table
from impact_rs_analysis.following.causes import Causes
from impact_rs_analysis.following.change import ChangeExplanation
from impact_rs_analysis.following.documents import HitDocument
from impact_rs_analysis.following.follow import Follower
from impact_rs_analysis.following.hits import Hit, TableHitSource
from impact_rs_control.closed_loop import make_plant, run_closed_loop, without_garbage_collection
from impact_rs_sim.effects import library
from impact_rs_sim.model import load_model
from impact_rs_sim.physics import Physics
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_trials.recordings.impacts.impact_table import read_impact_table
from impact_rs_trials.spec import TrialSpec

SCENARIO = load_scenario("push")
NOMINAL = load_model("nominal")
CONDITIONS = (("parcel", "case_1"), ("parcel", "case_2"), ("juice", "case_1"), ("juice", "case_2"))
WINDOW = (0.005, 0.015)  # s after the begin of the impact
MOVES, EXPECTED, TICKS_BEFORE = 0.01, 0.3, 2  # m/s, s; as tools/map_discrepancy.py
NOISE = np.repeat((0.005, 0.005, 0.02), (7, 3, 3))  # rad/s, m/s, rad/s
PLANTED: dict[str, tuple[str, list[float]]] = {
    "object 25 % heavier": ("object_mass", [1.25]),
    "object 15 % lighter": ("object_mass", [0.85]),
    "restitution + 0.15": ("restitution", [0.15]),
    "pad friction - 0.4": ("pad_friction", [-0.4]),
    "tool 0.4 kg heavier": ("end_effector_payload", [0.4, 0.0, 0.0, 0.0]),
    "motor inertia 40 % larger": ("motor_inertia_scale", [1.4]),
}
COLD, LEVELS = 0.3, 4  # N m, dry friction of all joints at the start of a warming day; it falls in steps to 0
SENSOR_DRIFT = 0.01  # of all velocities after, over a warming day
GRAVITY = 9.81  # m/s^2
BEFORE, AFTER = 60, 40  # hits of a changed day
LATE = slice(5, None)  # from the sixth hit after the change on


def hidden(physics: Physics, effects: Mapping[str, Sequence[float]]) -> Physics:
    """Physics with effects."""
    for name, values in effects.items():
        physics = library()[name].apply_vector(physics, np.array(values))
    return physics


def pushed(condition: tuple[str, str], seed: int, effects: Mapping[str, Sequence[float]]) -> Array:
    """One push: q, dq before, pose, twist before, dq after, twist after, ``(7 + 7 + 7 + 6 + 7 + 6,)``."""
    plan = TrialSpec.of(SCENARIO, *condition).plan
    plant: Any = make_plant(plan, seed, hidden(plan.scene.physics, effects))
    (name,) = plan.arms
    until = plan.scene.scenario.timing.nominal_impact + 0.08
    rows = []
    try:
        with without_garbage_collection():
            for tick in run_closed_loop(plan, plant):
                arm, body = plant.truth().arms[name], plant.object_state()
                rows.append((tick.measurement.time, np.array(arm.position), np.array(arm.velocity), body))
                if tick.measurement.time >= until:
                    break
    finally:
        plant.close()
    times = np.array([row[0] for row in rows])
    speeds = np.array([np.linalg.norm(row[3].twist[:3]) for row in rows])
    onset = int(np.argmax((speeds > MOVES) & (times > EXPECTED))) - TICKS_BEFORE
    _, position, velocity, body = rows[onset]
    chosen = np.flatnonzero((times - times[onset] >= WINDOW[0]) & (times - times[onset] <= WINDOW[1]))
    after = np.mean([np.concatenate((rows[k][2], rows[k][3].twist)) for k in chosen.tolist()], axis=0)
    pose = np.concatenate((body.position, pin.Quaternion(body.rotation).coeffs()))
    return np.concatenate((position, velocity, pose, body.twist, after))


HEADER = [
    "object", "condition", "time [s]", *(f"q{n} [rad]" for n in range(1, 8)),
    *(f"dq{n}_before [rad/s]" for n in range(1, 8)), *POSE, *_twist("before"),
    *(f"dq{n}_after [rad/s]" for n in range(1, 8)), *_twist("after"),
]  # fmt: skip


def add_options(parser: argparse.ArgumentParser) -> None:
    """How many days."""
    parser.add_argument("--each", type=int, default=36, help="quiet hits simulated in each condition")
    parser.add_argument("--changed", type=int, default=8, help="days with each change")
    parser.add_argument("--quiet", type=int, default=6, help="quiet days")
    parser.add_argument("--warming", type=int, default=12, help="days on which joints warm up")
    parser.add_argument("--length", type=int, default=420, help="hits of a quiet or warming day")
    parser.add_argument("--drift", type=int, default=150, help="hits of the drifting day; 0: none")


def cases(options: argparse.Namespace) -> list[Case]:
    """Days."""
    days = [
        Case(f"changed, {day_kind}, day {day}", (day_kind, day))
        for day_kind in PLANTED
        for day in range(options.changed)
    ]
    days += [Case(f"quiet, day {day}", ("quiet", day)) for day in range(options.quiet)]
    days += [Case(f"warming, day {day}", ("warming", day)) for day in range(options.warming)]
    return days + [Case("drifting day", ("drift", 0))] * (options.drift > 0)


def pool(kind: str, work: Work) -> Array:
    """Simulated hits of a kind of day, ``(conditions, each, 40)``; simulated once."""
    path = work.folder.parent / f"pool_{kind.replace(' ', '_')}.npz"
    if not path.exists():
        effects: dict[str, list[float]] = {}
        if kind in PLANTED:
            effects = dict([PLANTED[kind]])
        elif kind != "quiet":
            effects = {"joint_coulomb_friction": [COLD * (1.0 - int(kind.split()[1]) / (LEVELS - 1.0))] * 7}
        count = work.options.each if kind == "quiet" else max(work.options.each // 3, 4)
        first = 1000 + 100_000 * [*PLANTED, *(f"warming {level}" for level in range(LEVELS)), "quiet"].index(kind)
        hits = [[pushed(condition, first + seed, effects) for seed in range(count)] for condition in CONDITIONS]
        np.savez(path, hits=hits)
    with np.load(path) as stored:
        return np.asarray(stored["hits"])


def drawn(hits: Array, count: int, rng: np.random.Generator, begin: int = 0) -> list[list[object]]:
    """Rows of a table: conditions at random, hits of a pool at random, fresh noise."""
    rows: list[list[object]] = []
    for number in range(count):
        index = int(rng.integers(len(CONDITIONS)))
        values = hits[index, int(rng.integers(hits.shape[1]))].copy()
        values[-13:] += NOISE * rng.standard_normal(13)
        rows.append([*CONDITIONS[index], float(begin + number), *values])
    return rows


def warming(work: Work, rng: np.random.Generator) -> list[list[object]]:
    """Rows of a day on which joints warm up and the scale of velocities drifts."""
    rows, length = [], work.options.length
    for number in range(length):
        level = int(rng.binomial(LEVELS - 1, number / length))  # steps between levels are spread over the day
        (row,) = drawn(pool(f"warming {level}", work), 1, rng, number)
        rows.append([*row[:-13], *((1.0 + SENSOR_DRIFT * number / length) * np.array(row[-13:], dtype=float)).tolist()])
    return rows


def follower_of(rows: list[list[object]], folder: Path) -> tuple[Follower, list[Hit]]:
    """Rows through the shipped hit source, and their follower."""
    path = write_csv(folder / "hits.csv", HEADER, rows)
    hit_source = TableHitSource(lambda: read_impact_table(path, SCENARIO), NOMINAL)
    return Follower(hit_source, NOMINAL), list(hit_source.arrived())


def take(follower: Follower, hit: Hit) -> tuple[HitDocument, float]:
    """What a hit taught, and its processor time [ms]."""
    started = time.process_time()
    (document,) = follower.take([hit])
    return document, 1e3 * (time.process_time() - started)


def run(case: Case, work: Work) -> Row:
    """One day."""
    day_kind, day = case.inputs
    rng = np.random.default_rng([1, day, len(day_kind)])
    if day_kind == "drift":
        return drifting_day(work, rng)
    if day_kind in PLANTED:
        return changed_day(day_kind, work, rng)
    rows = drawn(pool("quiet", work), work.options.length, rng) if day_kind == "quiet" else warming(work, rng)
    follower, hits = follower_of(rows, work.folder)
    row: Row = {"what": day_kind, "watched": 0, "odd": 0, "alarms": 0, "spent": []}
    for hit in hits:
        document, spent = take(follower, hit)
        if document.error is not None:
            row["watched"] += 1
            row["odd"] += document.odd
            row["alarms"] += document.change is not None
            row["spent"].append(spent)
    return row | {"said": f"{row['alarms']} alarms in {row['watched']} hits"}


def changed_day(day_kind: str, work: Work, rng: np.random.Generator) -> Row:
    """One day with a change."""
    effect, values = PLANTED[day_kind][0], np.array(PLANTED[day_kind][1])
    rows = drawn(pool("quiet", work), BEFORE, rng) + drawn(pool(day_kind, work), AFTER, rng, BEFORE)
    follower, hits = follower_of(rows, work.folder)
    for hit in hits[:BEFORE]:
        follower.take([hit])
    base = copy.deepcopy(follower.watch.likeliest)
    alarm: HitDocument | None = None
    errors, spent, delay = [], [], None
    for number, hit in enumerate(hits[BEFORE:], start=1):
        document, milliseconds = take(follower, hit)
        spent.append(milliseconds)
        errors.append(math.nan if document.error is None else document.error)  # the model did not predict it
        if alarm is None and document.change is not None:
            alarm, delay = document, number
    offline, frozen = offline_errors(follower, base, effect, values, hits[BEFORE:])
    best = rms(np.array(offline)[LATE])
    causes = [] if alarm is None or alarm.change is None else alarm.change.causes
    named_cause = next((cause for cause in causes if cause.effect == effect), None)
    part = follower.watch.hit_model.candidate.part(effect)
    largest = int(np.argmax(np.abs(values - follower.watch.hit_model.candidate.nominal[part])))
    planted_change = values[largest] - follower.watch.hit_model.candidate.nominal[part][largest]
    name = follower.watch.hit_model.candidate.scalars[part][largest].name
    change = (
        next((p.change for p in named_cause.parameters if p.parameter == f"{effect}.{name}"), 0.0)
        if named_cause
        else 0.0
    )
    return {
        "what": day_kind,
        "hits": delay,
        "first": bool(causes and causes[0].effect == effect),
        "among": named_cause is not None,
        "sign": bool(change * planted_change > 0.0),
        "ratio": float(np.sqrt(np.nanmean(np.square(np.array(errors)[LATE])))) / best,
        "frozen": rms(np.array(frozen)[LATE]) / best,
        "spent": spent,
        "said": f"alarm after {delay} hits" if delay else "no alarm",
    }


def offline_errors(follower: Follower, base: Any, effect: str, values: Array, hits: list[Hit]) -> tuple[Any, Any]:
    """Prediction errors of the planted effect fitted to all hits since the change, and of the frozen model."""
    hit_model, window = follower.watch.hit_model, copy.deepcopy(base)
    frozen = [rms(base.posterior.now.residual_of(hit_model.evidence(hit, base.point))) for hit in hits]
    window.posterior.absorb_before(len(window.posterior.window))
    for hit in hits:
        window.posterior.add([hit_model.evidence(hit, window.point)])
    part = hit_model.candidate.part(effect)
    numbers = [n for n in range(part.start, part.stop) if n in hit_model.active]
    scale, nominal = hit_model.candidate.scale[part], hit_model.candidate.nominal[part]
    start = [(values - nominal)[n - part.start] / scale[n - part.start] for n in numbers]
    fitted = Causes(hit_model).about(window, ChangeExplanation(effect, 0, np.array(start), 0.0))
    return [rms(fitted.posterior.now.residual_of(hit_model.evidence(hit, fitted.point))) for hit in hits], frozen


def rms(values: Array) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def drifting_day(work: Work, rng: np.random.Generator) -> Row:
    """The stand-in: restitution rises by 0.25 and pad friction falls by 0.3 over a day, each hit has its own."""
    rows: list[list[object]] = []
    count = work.options.drift
    for number in range(count):
        index = int(rng.integers(len(CONDITIONS)))
        share = max(number - 40, 0) / (count - 40)
        effects = {"restitution": [0.25 * share], "pad_friction": [-0.3 * share]}
        values = pushed(CONDITIONS[index], 90_000 + number, effects)
        values[-13:] += NOISE * rng.standard_normal(13)
        rows.append([*CONDITIONS[index], float(number), *values])
    follower, hits = follower_of(rows, work.folder)
    base, changes = None, 0
    errors: dict[str, list[float]] = {"followed": [], "frozen": []}
    for hit in hits:
        if follower.watching:
            base = copy.deepcopy(follower.watch.likeliest) if base is None else base
            true = distance(hit.measured)
            for name, explanation in (("followed", follower.watch.likeliest), ("frozen", base)):
                mean, _ = follower.watch.hit_model.predicted(explanation, hit)
                errors[name].append(distance(mean) - true)
        changes += take(follower, hit)[0].change is not None
    rms_errors = {name: 1e3 * rms(np.array(values)) for name, values in errors.items()}
    words = f"{rms_errors['followed']:.1f} mm, frozen {rms_errors['frozen']:.1f} mm; {changes} changes announced"
    return {"what": "drift", "said": words, "spent": []}


def distance(features: Array) -> float:
    """Sliding distance by the velocity of the object's centre after a hit [m]."""
    return float(np.sum(np.square(features[7:9]))) / (2.0 * SCENARIO.support.friction * GRAVITY)


def table(rows: list[Row], options: argparse.Namespace) -> Table:
    """A row for each change; quiet, warming and drifting days below."""
    columns = ("Planted after 60 quiet hits", "Days", "Found", "Hits to the alarm, median (largest)", "Named first")
    columns += ("Error from the sixth hit on, over an offline fit, median (largest)", "Frozen model over the same")
    lines = []
    for day_kind in PLANTED:
        if rows_of_day := [row for row in rows if row["what"] == day_kind]:
            hits = [row["hits"] for row in rows_of_day if row["hits"] is not None]
            lines.append(
                (
                    day_kind,
                    str(len(rows_of_day)),
                    str(len(hits)),
                    median_and_largest(hits) if hits else "–",
                    str(sum(row["first"] for row in rows_of_day)),
                    median_and_largest([row["ratio"] for row in rows_of_day]),
                    f"{np.median([row['frozen'] for row in rows_of_day]):.2g}",
                )
            )
    for day_kind in ("quiet", "warming"):
        if rows_of_day := [row for row in rows if row["what"] == day_kind]:
            alarms, watched = (sum(row[key] for row in rows_of_day) for key in ("alarms", "watched"))
            lines.append(
                (f"nothing, {day_kind} days", str(len(rows_of_day)), f"{alarms} in {watched} hits", *("–",) * 4)
            )
    lines += [("drift, sliding distance", "1", row["said"], *("–",) * 4) for row in rows if row["what"] == "drift"]
    if spent := [time_ for row in rows for time_ in row["spent"]]:
        lines.append(("processor time of a hit [ms]", "", quantiles(spent), *("–",) * 4))
    return Table(columns, tuple(lines))
