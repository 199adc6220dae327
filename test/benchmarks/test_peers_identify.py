# SPDX-License-Identifier: Apache-2.0
"""Tools that identify are compared on equal terms: one model in two simulators, one noise, one way to say that."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

sysid = pytest.importorskip("mujoco.sysid")
if not hasattr(sysid, "SignalType"):  # MuJoCo without its extra is there, and empty
    pytest.skip("the extra 'peers' is not installed", allow_module_level=True)
identify = pytest.importorskip("benchmarks.peers_identify")

from impact_rs_analysis.evidence.replay import Window, replay  # noqa: E402
from impact_rs_sim.drive import DriveStart  # noqa: E402
from impact_rs_sim.scenario import load_scenario  # noqa: E402
from impact_rs_sim.scene import ArmState, Scene  # noqa: E402

TICKS, PERIOD = 101, 2.5e-4  # s, of the torque loop
ROLLOUT = identify.ROLLOUTS["plant"]


@pytest.fixture(scope="module")
def scene():
    return Scene.resolve(load_scenario("push"), "parcel", "case_1")


@pytest.fixture(scope="module")
def window(scene):
    """An arm that moves in all its joints, for a tenth of a second, and turns none of them back."""
    ((name, arm),) = scene.arms.items()
    q = arm.position
    speed = np.ones(7)
    weight = scene.models[name].terms(q, speed).bias
    beat = np.sin(0.06 * np.arange(TICKS - 1)[:, None] * (1.0 + 0.1 * np.arange(7)))
    return Window(
        contact=False,
        number=0,
        time=1e-3 * np.arange(TICKS),
        arms={name: ArmState(q, speed)},
        drives={name: DriveStart(weight, np.zeros(7))},
        object=scene.object,
        torque={name: weight + beat * [8.0, 8.0, 6.0, 6.0, 2.0, 2.0, 2.0]},
        acting={name: np.repeat(np.arange(TICKS - 1, dtype=np.int32), 4)},
        seen=np.zeros(0),
    )


def believed(scene, effect: str, values: list[float]):
    return identify.believed(scene.physics, identify.unknowns([effect]), values)


def test_noise_is_what_repeats_differ_by_and_not_what_the_model_is_wrong_by() -> None:
    rng = np.random.default_rng(0)
    wrong = np.linspace(0.0, 5.0, 400)[:, None]
    noise = np.array([0.1, 2.0])
    rows = [wrong + noise * rng.standard_normal((400, 2)) for _ in range(4)]
    for values in rows:
        values[1::4, 1] = np.nan  # a slow signal
    found = identify.weights([("box 0", True, values) for values in rows])
    assert found[True][0] == pytest.approx(0.1, rel=0.1)
    assert found[True][1] == pytest.approx(2.0, rel=0.2)
    assert False not in found


def test_interval_of_a_mean_is_that_of_student() -> None:
    values = np.random.default_rng(1).standard_normal(10)
    half = identify.interval(values - values.mean(), np.ones((10, 1)))
    assert half[0] == pytest.approx(2.262157 * values.std(ddof=1) / np.sqrt(10.0), rel=1e-6)


def test_an_effect_is_there_where_its_interval_leaves_out_the_nominal_value() -> None:
    fitted = identify.unknowns(["object_mass", "support_friction"])
    found = identify.answer("plain", fitted, np.array([1.15, 0.02]), np.array([0.01, 0.03]))
    assert found.says == ("object_mass",)
    assert identify.false_findings("object_mass", found) == []
    assert [item.effect for item in identify.false_findings("support_friction", found)] == ["object_mass"]


@pytest.mark.parametrize("coulomb", [0.0, 0.3])
def test_the_mujoco_model_of_sysid_moves_as_our_replay_does(scene, window, coulomb) -> None:
    physics = believed(scene, "joint_coulomb_friction", [coulomb] * 7)
    ours = identify.table(replay([window], physics, PERIOD, "command")[0])
    model = identify.described(physics, False, ROLLOUT)
    rolled = identify.sysid.sysid_rollout(
        [model],
        [identify.mujoco.MjData(model)],
        [identify.control_of(window, PERIOD, ROLLOUT.step)],
        [identify.start_of(model, window, physics)],
    )[0]
    theirs = identify.table_of_states(model, physics, rolled.state.data)
    without = identify.table(replay([window], scene.physics, PERIOD, "command")[0])
    moved = np.abs(ours - without)[:, :7].max() if coulomb else np.ptp(ours[:, :7], axis=0).max()
    assert np.abs(theirs - ours)[:, :7].max() < 0.01 * moved


def test_sysid_finds_a_motor_inertia_that_our_replay_has(scene, window) -> None:
    physics = believed(scene, "motor_inertia_scale", [1.2])
    measured = identify.table(replay([window], physics, PERIOD, "command")[0])
    noise = np.repeat([1e-5, 2e-3, 0.05, 1e-3], [7, 7, 7, 4])
    setup = SimpleNamespace(physics=scene.physics, drive_period=PERIOD)
    runs = SimpleNamespace(runs=[SimpleNamespace(path="run", place=("push", "none", ""), setup=setup)])
    cut = {"run": [identify.Stretch(window, measured, noise)]}
    found = identify.fitted_by_sysid("sysid", ["motor_inertia_scale"], runs, cut, ROLLOUT, 1)
    assert found.says == ("motor_inertia_scale",)
    assert found.estimates[0].value == pytest.approx(1.2, abs=0.01)
