# SPDX-License-Identifier: Apache-2.0
"""Follow a model from hit to hit: ``./run python benchmarks/follow.py --pool pool.npz -o follow.json``.

Hits are pushes by the plant (Bullet, with flexible drives, a compliant pad, a controller and scatter of the object's
pose), each read as a row of a table: state in the tick before the object moves, mean velocities 5 to 15 ms after it,
and sensor noise on top. They are predicted by the rigid impact map, so that measurement and model are two simulators.
Every hit of a day is drawn from a pool of simulated ones (``--pool`` keeps it) and has its own noise.

* **Quiet days**: nothing changes. Counted: alarms in all hits that were watched.
* **Changed days**: an effect is planted in the plant. Counted: hits to the alarm, whether its effect is named or among
  the explanations, the sign, and the prediction error from the sixth hit after the change on, over that of an
  *offline* fit: the planted effect and its first hit are known, and it is fitted to all hits after the change.
* **Warming days**: nothing changes that a hit could show, and yet not every hit is alike: dry friction of the joints
  falls from 0.3 N m to 0 over the day, as they warm up, and the scale of all velocities drifts by 1 per cent. Counted:
  alarms, as on quiet days.
* **Time**: wall clock and processor time of one hit, from its row to what it taught; of changed days too.
* **Stand-in for long data in time order**: restitution and friction of the pad drift over a day of hits, each of them
  simulated with its own. Compared: error of the object's sliding distance v^2 / (2 mu g), mu known, of the followed
  and of the frozen model. It is a stand-in: no hits of a real robot in time order are small enough to come along.
"""

from __future__ import annotations

import argparse
import copy
import json
import math
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from impact_rs_analysis.following.change import ChangeExplanation
from impact_rs_analysis.following.follow import Follower
from impact_rs_analysis.following.hits import Hit, TableDoor
from impact_rs_analysis.following.lessons import HitDocument
from impact_rs_control.closed_loop import make_plant, run_closed_loop, without_garbage_collection
from impact_rs_sim.effects import library
from impact_rs_sim.model import load_model
from impact_rs_sim.physics import Physics
from impact_rs_sim.robot import Array
from impact_rs_sim.scenario import load_scenario
from impact_rs_trials.recordings.impact_table import read_impact_table
from impact_rs_trials.spec import TrialSpec

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "test" / "shared"))

from impact_table_cases import POSE, _twist, write_csv  # noqa: E402

SCENARIO = load_scenario("push")
NOMINAL = load_model("nominal")
CONDITIONS = (("parcel", "case_1"), ("parcel", "case_2"), ("juice", "case_1"), ("juice", "case_2"))
WINDOW = (0.005, 0.015)  # s after the begin of the impact
MOVES, EXPECTED, TICKS_BEFORE = 0.01, 0.3, 2  # m/s, s; as benchmarks/foreign/map_discrepancy.py
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


def pool_of(path: Path | None, each: int) -> dict[str, Array]:
    """Simulated hits by kind of day, ``(conditions, each, 40)``; read from a file where it is there."""
    found: dict[str, Array] = {}
    if path is not None and path.exists():
        with np.load(path) as kept:
            found = dict(kept)
    warming = {
        f"warming {level}": {"joint_coulomb_friction": [COLD * (1.0 - level / (LEVELS - 1.0))] * 7}
        for level in range(LEVELS)
    }
    for kind, effects in {
        "quiet": {},
        **{what: {name: own} for what, (name, own) in PLANTED.items()},
        **warming,
    }.items():
        if kind in found:
            continue
        count = each if kind == "quiet" else max(each // 3, 4)
        base = 1000 if kind == "quiet" else 5000 + 100 * len(found)
        found[kind] = np.array([[pushed(one, base + seed, effects) for seed in range(count)] for one in CONDITIONS])
        print(f"simulated {count * len(CONDITIONS)} pushes: {kind}", flush=True)
    if path is not None:
        np.savez(path, **found)
    return found


def drawn(pool: Array, count: int, rng: np.random.Generator, begin: int = 0) -> list[list[object]]:
    """Rows of a table: conditions at random, hits of the pool at random, fresh noise."""
    rows: list[list[object]] = []
    for number in range(count):
        place = int(rng.integers(len(CONDITIONS)))
        values = pool[place, int(rng.integers(pool.shape[1]))].copy()
        values[-13:] += NOISE * rng.standard_normal(13)
        rows.append([*CONDITIONS[place], float(begin + number), *values])
    return rows


def hits_of(rows: list[list[object]], folder: Path) -> tuple[TableDoor, list[Hit]]:
    """Rows through the door that ships."""
    path = write_csv(folder / "hits.csv", HEADER, rows)
    door = TableDoor(lambda: read_impact_table(path, SCENARIO), NOMINAL)
    return door, list(door.arrived())


def warming(pool: Mapping[str, Array], length: int, rng: np.random.Generator) -> list[list[object]]:
    """Rows of a day on which joints warm up and the scale of velocities drifts."""
    rows = []
    for number in range(length):
        level = int(rng.binomial(LEVELS - 1, number / length))  # steps between levels are spread over the day
        (row,) = drawn(pool[f"warming {level}"], 1, rng, number)
        rows.append([*row[:-13], *((1.0 + SENSOR_DRIFT * number / length) * np.array(row[-13:], dtype=float)).tolist()])
    return rows


def quiet_days(
    day_of: Callable[[], list[list[object]]], days: int, folder: Path, what: str = "quiet"
) -> dict[str, Any]:
    """Alarms on days on which nothing changes, and the time of a hit."""
    alarms: list[str] = []
    watched, spent, wall, odd = 0, [], [], 0
    for day in range(days):
        door, hits = hits_of(day_of(), folder)
        follower = Follower(door, NOMINAL)
        for hit in hits:
            begun, clock = time.process_time(), time.perf_counter()
            (document,) = follower.take([hit])
            if document.error is None:
                continue
            watched, odd = watched + 1, odd + document.odd
            spent.append(1e3 * (time.process_time() - begun))
            wall.append(1e3 * (time.perf_counter() - clock))
            if document.change is not None:
                alarms.append(document.change.words)
        print(f"{what} day {day + 1}: {len(alarms)} alarms in {watched} hits so far", flush=True)
    return {
        "hits": watched,
        "alarms": len(alarms),
        "of": alarms,
        "odd": odd,
        "processor_ms": quantiles(spent),
        "wall_ms": quantiles(wall),
    }


def quantiles(values: Sequence[float]) -> dict[str, float]:
    """Median, 90th and 99th percentile, maximum and mean."""
    return {
        "median": round(float(np.median(values)), 2),
        "p90": round(float(np.percentile(values, 90)), 2),
        "p99": round(float(np.percentile(values, 99)), 2),
        "most": round(float(np.max(values)), 2),
        "mean": round(float(np.mean(values)), 2),
    }


def changed_days(pool: Mapping[str, Array], days: int, rng: np.random.Generator, folder: Path) -> dict[str, Any]:
    """What is found of planted changes."""
    result = {}
    for what, (effect, values) in PLANTED.items():
        found = [
            changed_day(pool["quiet"], pool[what], effect, np.array(values), 60, 40, rng, folder) for _ in range(days)
        ]
        ratios = [one["ratio"] for one in found]
        hits = [one["hits"] for one in found if one["hits"] is not None]
        result[what] = {
            "days": days,
            "found": len(hits),
            "hits_to_alarm": {} if not hits else {"median": float(np.median(hits)), "most": max(hits)},
            "named_first": sum(one["first"] for one in found),
            "among_explanations": sum(one["among"] for one in found),
            "right_sign": sum(one["sign"] for one in found),
            "named_at_the_end": sum(one["end"] for one in found),
            "error_over_offline": {"median": round(float(np.median(ratios)), 3), "most": round(max(ratios), 3)},
            "days_below_1.2": sum(bool(ratio <= 1.2) for ratio in ratios),
            "processor_ms": quantiles([time for one in found for time in one["spent"]]),
            "frozen_over_offline": round(float(np.median([one["frozen"] for one in found])), 2),
        }
        print(what, json.dumps(result[what]), flush=True)
    return result


def changed_day(
    quiet: Array, changed: Array, effect: str, values: Array, before: int, after: int, rng: np.random.Generator,
    folder: Path,
) -> dict[str, Any]:  # fmt: skip
    """One day with a change."""
    rows = drawn(quiet, before, rng) + drawn(changed, after, rng, before)
    door, hits = hits_of(rows, folder)
    follower = Follower(door, NOMINAL)
    for hit in hits[:before]:
        follower.take([hit])
    base = copy.deepcopy(follower.likeliest)
    alarm: HitDocument | None = None
    errors, frozen = [], []
    delay = None
    spent = []
    for number, hit in enumerate(hits[before:], start=1):
        begun = time.process_time()
        (document,) = follower.take([hit])
        spent.append(1e3 * (time.process_time() - begun))
        errors.append(math.nan if document.error is None else document.error)  # the model did not predict it
        if alarm is None and document.change is not None:
            alarm, delay = document, number
    offline, frozen = offline_errors(follower, base, effect, values, hits[before:])
    late = slice(5, None)  # from the sixth hit after the change on
    size = float(np.sqrt(np.nanmean(np.square(np.array(errors)[late]))))
    best = float(np.sqrt(np.mean(np.square(np.array(offline)[late]))))
    causes = [] if alarm is None or alarm.change is None else alarm.change.causes
    own = next((cause for cause in causes if cause.effect == effect), None)
    moved = int(np.argmax(np.abs(values - follower.candidate.nominal[follower.candidate.part(effect)])))
    wanted = values[moved] - follower.candidate.nominal[follower.candidate.part(effect)][moved]
    name = follower.candidate.scalars[follower.candidate.part(effect)][moved].name
    change = next((p.change for p in own.parameters if p.parameter == f"{effect}.{name}"), 0.0) if own else 0.0
    return {
        "hits": delay,
        "first": bool(causes and causes[0].effect == effect),
        "among": own is not None,
        "sign": bool(change * wanted > 0.0),
        "end": follower.likeliest.effect == effect,
        "spent": spent,
        "ratio": float(size / best),
        "frozen": float(np.sqrt(np.mean(np.square(np.array(frozen)[late])))) / best,
    }


def offline_errors(follower: Follower, base: Any, effect: str, values: Array, hits: list[Hit]) -> tuple[Any, Any]:
    """Prediction errors of the planted effect fitted to all hits since the change, and of the frozen model."""
    window = copy.deepcopy(base)
    frozen = []
    for hit in hits:
        evidence = follower._evidence(hit, window.point)
        window.posterior.make_room([(hit.group, evidence.patterns.shape[1])])
    for hit in hits:
        evidence = follower._evidence(hit, base.point)
        base.posterior.make_room([(hit.group, evidence.patterns.shape[1])])
        frozen.append(rms(base.posterior.innovation(evidence)[0]))
    window.posterior.believe_before(len(window.posterior.window))
    for hit in hits:
        window.posterior.add([follower._evidence(hit, window.point)])
    part = follower.candidate.part(effect)
    numbers = [n for n in range(part.start, part.stop) if n in follower.active]
    scale, nominal = follower.candidate.scale[part], follower.candidate.nominal[part]
    start = [(values - nominal)[n - part.start] / scale[n - part.start] for n in numbers]
    fitted = follower._about(window, ChangeExplanation(effect, 0, np.array(start), 0.0))
    return [rms(fitted.posterior.innovation(follower._evidence(hit, fitted.point))[0]) for hit in hits], frozen


def rms(values: Array) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def drifting_day(count: int, rng: np.random.Generator, folder: Path) -> dict[str, Any]:
    """The stand-in: restitution rises by 0.25 and pad friction falls by 0.3 over a day, each hit has its own."""
    rows: list[list[object]] = []
    for number in range(count):
        place = int(rng.integers(len(CONDITIONS)))
        share = max(number - 40, 0) / (count - 40)
        values = pushed(
            CONDITIONS[place], 90_000 + number, {"restitution": [0.25 * share], "pad_friction": [-0.3 * share]}
        )
        values[-13:] += NOISE * rng.standard_normal(13)
        rows.append([*CONDITIONS[place], float(number), *values])
    door, hits = hits_of(rows, folder)
    follower = Follower(door, NOMINAL)
    base = None
    errors: dict[str, list[float]] = {"followed": [], "frozen": []}
    changes = 0
    for hit in hits:
        if follower.watching:
            base = copy.deepcopy(follower.likeliest) if base is None else base
            true = distance(hit.measured)
            for name, one in (("followed", follower.likeliest), ("frozen", base)):
                mean, _ = follower._predicted(one, hit)
                errors[name].append(distance(mean) - true)
        (document,) = follower.take([hit])
        changes += document.change is not None
    followed, frozen = (rms(np.array(errors[name])) for name in ("followed", "frozen"))
    return {
        "hits": count,
        "changes_announced": changes,
        "followed_m": round(followed, 5),
        "frozen_m": round(frozen, 5),
        "below_frozen_percent": round(100.0 * (1.0 - followed / frozen), 1),
    }


def distance(features: Array) -> float:
    """Sliding distance by the velocity of the object's centre after a hit [m]."""
    return float(np.sum(np.square(features[7:9]))) / (2.0 * SCENARIO.support.friction * GRAVITY)


def main() -> None:
    """Run all, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pool", type=Path, help="file that keeps the simulated hits")
    parser.add_argument("--each", type=int, default=36, help="quiet hits simulated in each condition")
    parser.add_argument("--quiet", type=int, default=12, help="quiet days")
    parser.add_argument("--warming", type=int, default=6, help="days on which joints warm up")
    parser.add_argument("--length", type=int, default=450, help="hits of a quiet day")
    parser.add_argument("--changed", type=int, default=8, help="days with each change")
    parser.add_argument("--drift", type=int, default=200, help="hits of the drifting day; 0: none")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("-o", "--output", type=Path, help="JSON file")
    arguments = parser.parse_args()
    rng = np.random.default_rng(arguments.seed)
    pool = pool_of(arguments.pool, arguments.each)
    with tempfile.TemporaryDirectory() as folder:
        result: dict[str, Any] = {}
        if arguments.changed:
            result["changed"] = changed_days(pool, arguments.changed, rng, Path(folder))
        if arguments.quiet:
            quiet = partial(drawn, pool["quiet"], arguments.length, rng)
            result["quiet"] = quiet_days(quiet, arguments.quiet, Path(folder))
        if arguments.warming:
            warm = partial(warming, pool, arguments.length, rng)
            result["warming"] = quiet_days(warm, arguments.warming, Path(folder), "warming")
        if arguments.drift:
            result["drift"] = drifting_day(arguments.drift, rng, Path(folder))
    text = json.dumps(result, indent=2)
    print(text)
    if arguments.output is not None:
        arguments.output.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
