# SPDX-License-Identifier: Apache-2.0
"""One identification by three tools: mujoco.sysid, impact_rs and plain least squares over our own replay.

    ./run python -m benchmarks.peers_identify -o DIR [--jobs 2] [--trials 12] [--only TEXT ...]

mujoco.sysid is optional: ``./run python -m pip install "mujoco[sysid]>=4"`` (or the extra ``peers``).

A box is pushed, with an effect hidden: its mass is 15 % larger, or the joints have Coulomb friction. Twice as many
campaigns as effects, because every plant belongs to one of the tools:

    plant    the plant of this package under its controller; the replay is made of it, so impact_rs plays at home
    cell     the MuJoCo cell of :mod:`benchmarks.foreign` under a controller of its own; mujoco.sysid plays at home,
             with the cell's own steps and contact settings, unknown of a real table

Both record what a laboratory does: q, dq, joint torque and desired torque at 1 kHz, pose of the box at 250 Hz, as bags
with clocks of their own. For all tools it is ours to read them, to find the impact, to put clocks together and to cut
windows; so are the states in which windows start (16 ms local fit, motors ahead by the joint torque over K), and what
signals are weighed with, :func:`weights`.

    sysid      mujoco.sysid.optimize with its SciPy backend, its own batched rollouts in threads and its own intervals.
               The model is a MuJoCo model with B_theta behind a spring-damper tendon in every joint, which is what the
               torque loop makes of the motor, desired torque as control, frictionloss for Coulomb friction and the
               contacts of the cell. What to fit is given: once what is hidden alone, once all of ``FITTED``
    plain      scipy.optimize.least_squares over the raw signals of our replay, all of ``FITTED`` at once. It gives no
               interval; here it gets the formula that sysid has, s^2 (J'J)^-1
    impact_rs  impact-rs diagnose, whole library, without a hint; nothing is in its cache

sysid and plain say that an effect is there where an interval excludes its nominal value, impact_rs where it names it.
Times are those of the tool alone, reading excluded; processor time is that of all processes.
"""

from __future__ import annotations

import argparse
import contextlib
import functools
import io
import json
import logging
import os
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import psutil
import scipy.optimize
import scipy.special
from mujoco import sysid
from rich.console import Console
from rich.table import Table

from benchmarks.foreign.cell import DEFAULT_CONTACTS, compile_scene
from benchmarks.foreign.laboratory import record_run
from examples.laboratory import EXPERIMENT
from examples.laboratory import record as record_trial
from impact_rs_analysis.diagnosis.diagnose import diagnose
from impact_rs_analysis.evidence.command_clock import read_laboratory_runs
from impact_rs_analysis.evidence.measured_runs import Runs, Setup
from impact_rs_analysis.evidence.replay import Window
from impact_rs_analysis.evidence.replay_cache import ReplayCache
from impact_rs_analysis.evidence.replays import ReplaySource
from impact_rs_sim.effects import library
from impact_rs_sim.model import load_model
from impact_rs_sim.physics import Physics
from impact_rs_sim.robot import Array
from impact_rs_sim.rotations import quaternion_of
from impact_rs_trials.blind import Hidden
from impact_rs_trials.recordings.experiment import load_experiment
from impact_rs_trials.runs import Signals
from impact_rs_trials.workers import Map, Workforce, workers

JOINTS = 7
FITTED = ("object_mass", "support_friction", "pad_friction", "motor_inertia_scale", "joint_coulomb_friction")
HIDDEN: dict[str, tuple[float, ...]] = {
    "object_mass": (1.15,),
    "joint_coulomb_friction": (0.35, 0.30, 0.25, 0.30, 0.20, 0.15, 0.15),  # N m, motor side
}
CONDITIONS = {  # by plant; object and condition
    "plant": [(object_name, case) for object_name in ("parcel", "juice") for case in ("case_1", "case_2")],
    "cell": [(object_name, pose) for object_name in ("parcel", "juice") for pose in ("pose_a_fast", "pose_b_fast")],
}
FREE = [("none", "slow"), ("none", "fast")]
TICK = 1e-3  # s, of the recordings
LEAST = 1e-6  # of the weights, in units of the signals
FAR = (5.0, 5.0, 0.0)  # m, where the object is in free motion
TOLERANCE = 1e-3  # relative, of step and cost, where mujoco.sysid and plain least squares end
OFF_BOUND = 0.01  # of the range, where what is nominal at a bound starts, as mujoco.sysid advises
SYSID_DIFFERENCE = 5e-3  # step of its finite differences; over less, contact is jumpy
DIFFERENCE = 0.1  # step of finite differences, in scales of the parameters

try:
    CUSTOM = sysid.SignalType.CustomObs
except AttributeError:  # mujoco.sysid is empty without what it needs
    raise SystemExit('mujoco.sysid is not installed; pip install "impact_rs[peers]"') from None

console = Console(width=180)


@dataclass(frozen=True)
class Rollout:
    """How mujoco.sysid rolls out: the integrator of MuJoCo and its step [s]."""

    integrator: mujoco.mjtIntegrator
    step: float


ROLLOUTS = {  # what agrees best with the true values; both cost the same
    "plant": Rollout(mujoco.mjtIntegrator.mjINT_RK4, 0.5e-3),
    "cell": Rollout(mujoco.mjtIntegrator.mjINT_IMPLICITFAST, 0.125e-3),  # the cell's own
}


# What is fitted, and what was measured


@dataclass(frozen=True)
class Unknown:
    """One number that is fitted: a parameter of an effect, its nominal value and its bounds, in its unit."""

    effect: str
    name: str
    nominal: float
    lower: float
    upper: float
    scale: float


def unknowns(effects: Sequence[str] = FITTED) -> list[Unknown]:
    """Parameters of some effects, joint by joint, with the bounds that the library has."""
    return [
        Unknown(effect, item.name, item.nominal, item.lower, item.upper, item.scale)
        for effect in effects
        for item in library()[effect].scalars(JOINTS)
    ]


def believed(physics: Physics, fitted: Sequence[Unknown], values: Sequence[float]) -> Physics:
    """Physics with the effects that are fitted."""
    for effect in dict.fromkeys(item.effect for item in fitted):
        own = [value for item, value in zip(fitted, values, strict=True) if item.effect == effect]
        physics = library()[effect].apply_vector(physics, np.array(own))
    return physics


def table(signals: Signals) -> Array:
    """q, dq, tau_J, position and yaw of the object at every tick but the first, NaN where it was not tracked."""
    (arm,) = signals.arms.values()
    seen = np.full((signals.time.size, 4), np.nan)
    if signals.object_time.size:
        rows = np.argmin(np.abs(signals.time[:, None] - signals.object_time), axis=0)
        seen[rows] = np.column_stack((signals.object_position, signals.object_yaw))
    return np.hstack((arm.position, arm.velocity, arm.torque, seen))[1:]


def weights(differences: Sequence[tuple[str, bool, Array]]) -> dict[bool, Array]:
    """Noise of every column of :func:`table`, by whether something is hit: what measured minus model differs by.

    Args:
        differences: Name of the window that repeats share, whether it holds an impact, and its ``(k, 25)``.
    """
    grouped: dict[tuple[str, bool], list[Array]] = {}
    for name, contact, values in differences:
        grouped.setdefault((name, contact), []).append(values)
    squares: dict[bool, list[Array]] = {False: [], True: []}
    for (_, contact), repeats in grouped.items():
        shared = min(len(values) for values in repeats)
        rows = np.array([_filled(values[:shared]) for values in repeats])
        if len(rows) > 1:
            squares[contact].append(np.square(rows - rows.mean(axis=0)).sum(axis=0) / (len(rows) - 1))
    return {
        contact: np.maximum(np.sqrt(np.vstack(found).mean(axis=0)), LEAST)
        for contact, found in squares.items()
        if found
    }


def _filled(values: Array) -> Array:
    """Without NaN: straight between what is known; columns of which nothing is known are 0."""
    filled = np.zeros_like(values)
    for column, (own, known) in enumerate(zip(values.T, np.isfinite(values).T, strict=True)):
        if known.any():
            filled[:, column] = np.interp(np.arange(own.size), np.flatnonzero(known), own[known])
    return filled


@dataclass(frozen=True)
class Stretch:
    """A window of a run with what was measured in it, and the noise of every column of it."""

    window: Window
    measured: Array
    noise: Array

    def residual(self, predicted: Array) -> Array:
        """Measured minus predicted over the noise, ``(m,)``."""
        scaled = (self.measured - predicted) / self.noise
        return np.asarray(scaled[np.isfinite(self.measured)])


def stretches(runs: Runs, map_tasks: Map) -> dict[str, list[Stretch]]:
    """Windows of every run by its path."""
    nominal = list(map_tasks(replayed_tables, [(run.setup, [run.setup.physics]) for run in runs.runs]))
    differences = [
        (f"{run.condition} {number}", window.contact, table(signals) - predicted)
        for run, (predictions,) in zip(runs.runs, nominal, strict=True)
        for number, (window, signals, predicted) in enumerate(
            zip(run.setup.windows, run.windowed, predictions, strict=True)
        )
    ]
    noise = weights(differences)
    return {
        str(run.path): [
            Stretch(window, table(signals), noise[window.contact])
            for window, signals in zip(run.setup.windows, run.windowed, strict=True)
        ]
        for run in runs.runs
    }


def replayed_tables(task: tuple[Setup, Sequence[Physics]]) -> list[list[Array]]:
    """What our replay says of the windows of a run, as :func:`table` has it, under each of some physics."""
    setup, worlds = task
    return [[table(signals) for signals in setup.replayed(physics)] for physics in worlds]


# Answers


@dataclass(frozen=True)
class Estimate:
    """A parameter with its 95 % interval, in its unit."""

    effect: str
    name: str
    value: float
    lower: float
    upper: float


@dataclass(frozen=True)
class Answer:
    """What a tool says, and what that took.

    Attributes:
        tool: Its name.
        says: Which effects are there.
        estimates: What it fitted, or what it named.
        wall: [s].
        processor: [s], of all processes.
        remark: What it says besides.
    """

    tool: str
    says: tuple[str, ...]
    estimates: tuple[Estimate, ...]
    wall: float = 0.0
    processor: float = 0.0
    remark: str = ""


def answer(tool: str, fitted: Sequence[Unknown], values: Array, half: Array, remark: str = "") -> Answer:
    """An answer in which an effect is there where an interval excludes what it is nominally."""
    estimates = [
        Estimate(item.effect, item.name, float(value), float(value - width), float(value + width))
        for item, value, width in zip(fitted, values, half, strict=True)
    ]
    off = [
        item.effect
        for item, found in zip(fitted, estimates, strict=True)
        if not found.lower <= item.nominal <= found.upper
    ]
    return Answer(tool, tuple(dict.fromkeys(off)), tuple(estimates), remark=remark)


def interval(residual: Array, jacobian: Array) -> Array:
    """Half widths of 95 % intervals if residuals were independent and the model right, ``(p,)``."""
    free = residual.size - jacobian.shape[1]
    covariance = np.linalg.pinv(jacobian.T @ jacobian) * (residual @ residual) / free
    return np.asarray(np.sqrt(np.diag(covariance)) * scipy.special.stdtrit(free, 0.975))


# Tools


def plain(runs: Runs, cut: dict[str, list[Stretch]], map_tasks: Map) -> Answer:
    """Bounded least squares over the raw signals of our replay."""
    fitted = unknowns()
    scale = np.array([item.scale for item in fitted])

    def residuals(points: Sequence[Array]) -> list[Array]:
        tasks = [(run.setup, [believed(run.setup.physics, fitted, point) for point in points]) for run in runs.runs]
        rows: list[list[Array]] = [[] for _ in points]
        for run, found in zip(runs.runs, map_tasks(replayed_tables, tasks), strict=True):
            for row, tables in zip(rows, found, strict=True):
                row += [own.residual(values) for own, values in zip(cut[str(run.path)], tables, strict=True)]
        return [np.concatenate(row) for row in rows]

    def jacobian(point: Array) -> Array:
        way = np.where(point + DIFFERENCE * scale > [item.upper for item in fitted], -1.0, 1.0) * DIFFERENCE * scale
        at, *moved = residuals([point, *(point + way * row for row in np.eye(point.size))])
        return np.column_stack([(one - at) / step for one, step in zip(moved, way, strict=True)])

    found = scipy.optimize.least_squares(
        lambda point: residuals([point])[0],
        [item.nominal for item in fitted],
        jac=jacobian,
        bounds=([item.lower for item in fitted], [item.upper for item in fitted]),
        x_scale=scale,
        method="dogbox",  # bounds are active where there is no friction, and trf creeps towards them
        xtol=TOLERANCE,
        ftol=TOLERANCE,
    )
    return answer("plain", fitted, found.x, interval(found.fun, found.jac), f"{found.nfev} steps")


def with_drives(physics: Physics, integrator: mujoco.mjtIntegrator) -> Callable[[mujoco.MjSpec], None]:
    """Controls and friction at the motors of a description."""

    def modify(spec: mujoco.MjSpec) -> None:
        spec.option.integrator = integrator
        for name, arm in physics.arms.items():
            for index, coulomb in enumerate(np.broadcast_to(arm.friction.coulomb, JOINTS)):
                motor = f"{name}/motor{index + 1}"
                spec.joint(motor).frictionloss = coulomb
                actuator = spec.add_actuator(name=motor, target=motor, trntype=mujoco.mjtTrn.mjTRN_JOINT)
                actuator.set_to_motor()

    return modify


def described(
    physics: Physics, contact: bool, rollout: Rollout, keep: Callable[[mujoco.MjSpec], None] | None = None
) -> mujoco.MjModel:
    """A scene as MuJoCo's own users describe it: motors of inertia B_theta, driven by the desired torque.

    Args:
        physics: What is believed.
        contact: Whether there is something to hit.
        rollout: How it is integrated.
        keep: Gets the description.
    """
    arms = {name: replace(arm, motor_inertia_rotor=arm.motor_inertia_reduced) for name, arm in physics.arms.items()}
    drives = with_drives(physics, rollout.integrator)

    def modify(spec: mujoco.MjSpec) -> None:
        drives(spec)
        if keep is not None:
            keep(spec)

    height = physics.support_height if contact else None
    return compile_scene(replace(physics, arms=arms, support_height=height), rollout.step, modify=modify)


def start_of(model: mujoco.MjModel, window: Window, physics: Physics) -> Array:
    """State in which a rollout starts: motors ahead of the links by the joint torque over K."""
    position, velocity = np.zeros(model.nq), np.zeros(model.nv)
    for name, arm in window.arms.items():
        stiffness, drive = physics.arms[name].stiffness, window.drives[name]
        for index in range(JOINTS):
            link, motor = (model.joint(f"{name}/{kind}{index + 1}") for kind in ("joint", "motor"))
            position[link.qposadr], velocity[link.dofadr] = arm.position[index], arm.velocity[index]
            position[motor.qposadr] = arm.position[index] + drive.torque[index] / stiffness[index]
            velocity[motor.dofadr] = arm.velocity[index] + drive.torque_rate[index] / stiffness[index]
    x, y, z, w = quaternion_of(window.object.rotation)
    sunk = -physics.object.mass * physics.gravity[2] / (4.0 * DEFAULT_CONTACTS.support_stiffness)
    place = model.joint("object").qposadr[0]
    where = window.object.position - [0.0, 0.0, sunk] if window.contact else FAR
    position[place : place + 7] = [*where, w, x, y, z]
    return np.asarray(sysid.create_initial_state(model, position, velocity))


def control_of(window: Window, drive_period: float, step: float) -> sysid.TimeSeries:
    """Desired torques at the steps of a rollout; the last is held for nothing."""
    ((name, acting),) = window.acting.items()
    finest = min(step, drive_period)
    torque = np.repeat(window.torque[name][acting], round(drive_period / finest), axis=0)
    torque = torque.reshape(-1, round(step / finest), JOINTS).mean(axis=1)
    return sysid.TimeSeries(step * np.arange(len(torque) + 1), np.vstack((torque, torque[-1])))


def table_of_states(model: mujoco.MjModel, physics: Physics, states: Array) -> Array:
    """Columns of :func:`table` of a rollout, at the ticks of the recordings."""
    each = round(TICK / model.opt.timestep)
    rows = states[each - 1 :: each, 1:]  # behind the time
    ((name, arm),) = physics.arms.items()
    links, motors = ([model.joint(f"{name}/{kind}{n + 1}") for n in range(JOINTS)] for kind in ("joint", "motor"))
    q, theta = (rows[:, [joint.qposadr[0] for joint in group]] for group in (links, motors))
    dq = rows[:, [model.nq + joint.dofadr[0] for joint in links]]
    place = model.joint("object").qposadr[0]
    w, x, y, z = rows[:, place + 3 : place + 7].T
    yaw = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return np.column_stack((q, dq, arm.stiffness * (theta - q), rows[:, place : place + 3], yaw))


def fitted_by_sysid(
    tool: str, effects: Sequence[str], runs: Runs, cut: dict[str, list[Stretch]], rollout: Rollout, threads: int
) -> Answer:
    """Fit some effects with mujoco.sysid to the windows of all runs."""
    fitted = unknowns(effects)
    grouped: dict[str, list[tuple[Setup, Stretch]]] = {}  # one model for each object, and one for free motion
    for run in runs.runs:
        for stretch in cut[str(run.path)]:
            grouped.setdefault(run.place[1] if stretch.window.contact else "free", []).append((run.setup, stretch))
    parts = [_residual_of(name, own, fitted, rollout, threads) for name, own in grouped.items()]

    def residual(x: Array, params: sysid.ParameterDict, **further: Any) -> tuple[list[Any], list[Any], list[Any]]:
        found = [part(x, params, **further) for part in parts]
        return tuple([row for one in found for row in one[place]] for place in range(3))  # type: ignore[return-value]

    params = sysid.ParameterDict()
    for item in fitted:
        params.add(sysid.Parameter(f"{item.effect}.{item.name}", item.nominal, item.lower, item.upper))
    params.move_off_bounds(OFF_BOUND)
    with contextlib.redirect_stdout(io.StringIO()):  # it prints every step
        scale = np.array([item.scale for item in fitted])
        best, result = sysid.optimize(
            params,
            residual,
            optimizer="scipy_parallel_fd",  # its own was at work five times as long: contact makes the cost rough
            method="dogbox",
            x_scale=scale,
            diff_step=SYSID_DIFFERENCE,
            xtol=TOLERANCE,
            ftol=TOLERANCE,
        )
    _, half = sysid.calculate_intervals(residual(result.x, best)[0], result.jac)
    return answer(tool, fitted, result.x, half, f"{result.nfev} steps")


def _residual_of(
    name: str, own: Sequence[tuple[Setup, Stretch]], fitted: Sequence[Unknown], rollout: Rollout, threads: int
) -> Callable[..., Any]:
    """What mujoco.sysid makes of the windows that one model is for."""
    setup, first = own[0]
    contact, physics = first.window.contact, setup.physics
    kept: list[mujoco.MjSpec] = []
    nominal = described(physics, contact, rollout, kept.append)

    @functools.lru_cache(2 * len(fitted) + 2)
    def model_of(values: tuple[float, ...]) -> mujoco.MjModel:
        return described(believed(physics, fitted, values), contact, rollout)

    def compare(
        params: Any, predicted: Any, measured: sysid.TimeSeries, model: mujoco.MjModel, everything: bool, state: Array
    ) -> tuple[Array, Any, Any]:
        values = table_of_states(model, physics, state)
        scaled = (measured.data - values) / first.noise
        predicted = sysid.TimeSeries(measured.times, values, measured.signal_mapping)
        return scaled[np.isfinite(measured.data)], predicted, measured

    sequences = sysid.ModelSequences(
        name,
        kept[0],
        [f"{name}_{number}" for number in range(len(own))],
        [start_of(nominal, stretch.window, physics) for _, stretch in own],
        [control_of(stretch.window, setup.drive_period, rollout.step) for setup, stretch in own],
        [
            sysid.TimeSeries.from_custom_map(
                stretch.window.time[1:] - stretch.window.time[0], stretch.measured, [("signals", 25, CUSTOM)]
            )
            for _, stretch in own
        ],
        allow_missing_sensors=True,
    )
    return sysid.build_residual_fn(
        models_sequences=[sequences],
        build_model=lambda params, spec: model_of(tuple(params.as_vector())),
        modify_residual=compare,
        n_threads=threads,
        resample_true=False,
    )


def diagnosed(runs: Runs, map_tasks: Map) -> Answer:
    """What impact-rs diagnose says, without a hint what to look for."""
    source = ReplaySource.of(runs, load_model("nominal"), ReplayCache(map_tasks))
    document = diagnose(source, source.model)
    estimates = tuple(
        Estimate(effect.name, name, value.estimate, *(value.ci95 or (value.estimate, value.estimate)))
        for effect in document.effects
        if effect.name in document.named
        for name, value in effect.parameters.items()
    )
    return Answer("impact_rs", tuple(document.named), estimates, remark=document.verdict)


# Campaigns


@dataclass(frozen=True)
class Campaign:
    """Recorded on a plant, with an effect hidden."""

    plant: str
    hidden: str

    @property
    def name(self) -> str:
        """Name of its folder."""
        return f"{self.plant}_{self.hidden}"

    def conditions(self, trials: int) -> list[tuple[str, str]]:
        """Object and condition of every trial."""
        kinds = [*CONDITIONS[self.plant], *FREE]
        return kinds * (trials // len(kinds))


@dataclass(frozen=True)
class Recording:
    """A trial to be recorded; everything a worker needs."""

    path: str
    campaign: Campaign
    object_name: str
    condition: str
    seed: int


def record(task: Recording) -> None:
    """Record a trial; a finished one stands."""
    path, values = Path(task.path), HIDDEN[task.campaign.hidden]
    if (path / "metadata.yaml").exists():
        return
    if task.campaign.plant == "cell":
        record_run(path, task.object_name, task.condition, task.seed, [Hidden(task.campaign.hidden, values, 0.0)])
    else:
        scenario = "excite" if task.object_name == "none" else "push"
        record_trial(
            path, (scenario, task.object_name, task.condition), [task.campaign.hidden, *map(str, values)], task.seed
        )


def make(campaign: Campaign, folder: Path, trials: int, map_tasks: Map) -> None:
    """Record a campaign, or what is missing of it."""
    folder.mkdir(parents=True, exist_ok=True)
    rows, tasks = ["bag,object,kind,condition"], []
    for number, (object_name, condition) in enumerate(campaign.conditions(trials), start=1):
        name = f"run_{number:02d}"
        rows.append(f"{name},{object_name},{'free motion' if object_name == 'none' else 'hit'},{condition}")
        tasks.append(Recording(str(folder / name), campaign, object_name, condition, number))
    for _ in map_tasks(record, tasks):
        pass
    (folder / "runs.csv").write_text("\n".join(rows) + "\n")
    (folder / "experiment.yaml").write_text(EXPERIMENT)


def processor_time() -> float:
    """Of this process and of those that it started [s]."""
    own = psutil.Process()
    times = [one.cpu_times() for one in (own, *own.children(recursive=True))]
    return sum(one.user + one.system for one in times)


def timed(work: Callable[[], Answer]) -> Answer:
    """An answer with what it took."""
    wall, processor = time.perf_counter(), processor_time()
    found = work()
    return replace(found, wall=time.perf_counter() - wall, processor=processor_time() - processor)


# What is printed


TOOLS = ("sysid, told", "sysid, list", "plain", "impact_rs")


def answers(
    campaign: Campaign, folder: Path, tools: Sequence[str], jobs: int, map_tasks: Map
) -> Iterator[tuple[float, Answer]]:
    """What each tool says, with how long reading took [s]."""
    began = time.perf_counter()
    runs = read_laboratory_runs(folder, load_experiment(folder / "experiment.yaml"), map_tasks)
    cut = stretches(runs, map_tasks)
    reading = time.perf_counter() - began
    rollout = ROLLOUTS[campaign.plant]
    work: dict[str, Callable[[], Answer]] = {
        "sysid, told": lambda: fitted_by_sysid("sysid, told", [campaign.hidden], runs, cut, rollout, jobs),
        "sysid, list": lambda: fitted_by_sysid("sysid, list", FITTED, runs, cut, rollout, jobs),
        "plain": lambda: plain(runs, cut, map_tasks),
        "impact_rs": lambda: diagnosed(runs, map_tasks),
    }
    for tool in tools:
        yield reading, timed(work[tool])


def false_findings(hidden: str, found: Answer) -> list[Estimate]:
    """Parameters that are said to be off their nominal values and are not."""
    nominal = {(item.effect, item.name): item.nominal for item in unknowns()}
    others = [item for item in found.estimates if item.effect != hidden]
    if found.tool == "impact_rs":  # it has estimates of what it names alone
        return others
    return [item for item in others if not item.lower <= nominal[item.effect, item.name] <= item.upper]


def row_of(hidden: str, found: Answer) -> list[str]:
    """Cells of the table: how far off what is hidden was estimated, its interval, and what is said of the rest."""
    own = [item for item in found.estimates if item.effect == hidden]
    cells = ["-", "-", "-"]
    if own:
        truth = HIDDEN[hidden]
        off = np.array([item.value for item in own]) - truth
        held = sum(item.lower <= value <= item.upper for item, value in zip(own, truth, strict=True))
        half = float(np.median([(item.upper - item.lower) / 2.0 for item in own]))
        error = f"{off[0]:+.4f}" if len(own) == 1 else f"{np.sqrt(np.mean(off**2)):.4f} rms"
        cells = [error, f"{half:.4f}", f"{held} of {len(own)}"]
    wrong: dict[str, list[Estimate]] = {}
    for item in false_findings(hidden, found):
        wrong.setdefault(item.effect, []).append(item)
    words = [
        f"{name} {own[0].value:.4g}"
        if len(own) == 1
        else f"{name} {len(own)} x, up to {max(one.value for one in own):.2g}"
        for name, own in wrong.items()
    ]
    there = "yes" if hidden in found.says else "no"
    return [found.tool, f"{found.wall:.0f}", f"{found.processor:.0f}", *cells, there, "; ".join(words) or "-"]


def main() -> None:
    """Record, ask every tool, and print."""
    campaigns = [Campaign(plant, hidden) for plant in CONDITIONS for hidden in HIDDEN]
    names = ", ".join(one.name for one in campaigns)
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder of the campaigns; recordings are kept")
    parser.add_argument("--jobs", type=int, default=2, help="worker processes, and threads of mujoco.sysid")
    parser.add_argument("--trials", type=int, default=12, help="trials of a campaign, a multiple of its 6 conditions")
    parser.add_argument("--only", default="", help=f"campaigns whose name starts so: {names}")
    parser.add_argument("--tools", nargs="+", default=TOOLS, choices=TOOLS, help="tools that are asked")
    arguments = parser.parse_args()
    if arguments.trials < 12 or arguments.trials % 6:
        parser.error(f"--trials {arguments.trials}: expected a multiple of 6, at least 12")
    logging.getLogger("absl").setLevel(logging.ERROR)
    began = time.perf_counter()
    shown = Table("", "wall [s]", "CPU [s]", "off by", "95 %: ±", "holds truth", "says it is there", "and what is not")
    with tempfile.TemporaryDirectory() as cache:
        os.environ["XDG_CACHE_HOME"] = cache
        with workers(Workforce(arguments.jobs)) as map_tasks:
            for campaign in (one for one in campaigns if one.name.startswith(arguments.only)):
                folder = arguments.output / f"{campaign.name}_{arguments.trials}"
                make(campaign, folder, arguments.trials, map_tasks)
                shown.add_section()
                found = []
                for reading, one in answers(campaign, folder, arguments.tools, arguments.jobs, map_tasks):
                    if not found:
                        shown.add_row(f"[bold]{campaign.name}[/], read in {reading:.0f} s")
                    found.append(one)
                    row = row_of(campaign.hidden, one)
                    shown.add_row(*row)
                    console.print(f"{campaign.name}: {', '.join(row)}; {one.remark}", highlight=False)
                (folder / "answers.json").write_text(json.dumps([asdict(one) for one in found], indent=1) + "\n")
    console.print(shown)
    console.print(f"{time.perf_counter() - began:.0f} s in all")


if __name__ == "__main__":
    from benchmarks.peers_identify import main as run_main  # what workers get is then known by its module

    run_main()
