# SPDX-License-Identifier: Apache-2.0
"""A marble on a plate as a camera sees it: two coordinates in pixels, frames, no scale; bounces by closed forms."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from refusals import refusal

from impact_rs_trials.recordings.experiment import load_experiment
from impact_rs_trials.recordings.impacts.found_impacts import FoundImpacts, find_impacts
from impact_rs_trials.recordings.importing.import_recordings import ImportOptions, draft_import
from impact_rs_trials.recordings.readers.guesses import fall_in, unit_of_flight

DROPS = ((0.2, 0.4), (0.35, 0.3), (0.5, 0.45))  # speed along and height [m/s, m]
G, RADIUS, RESTITUTION, FRICTION = 9.81, 0.008, 0.82, 0.15  # m/s^2, m, -, -
RATE, SCALE, NOISE = 240.0, 2000.0, 3e-4  # Hz, pixels per m, m


def bounces(speed: float, height: float, seconds: float = 1.4) -> tuple[np.ndarray, list[float]]:
    """Places of a solid ball at every frame, ``(k, 2)`` [m], and its spin after every bounce [rad/s]."""
    x, z, vx, vz, spin, start, places, spins = 0.0, height + RADIUS, speed, 0.0, 0.0, 0.0, [], []
    times = np.arange(0.0, seconds, 1.0 / RATE)
    while len(places) < times.size:
        fall = (vz + np.sqrt(vz**2 + 2.0 * G * max(z - RADIUS, 0.0))) / G
        own = times[(times >= start) & (times < start + fall)][: times.size - len(places)] - start
        places += [(x + vx * t, z + vz * t - 0.5 * G * t**2) for t in own]
        start, x, z, vz = start + fall, x + vx * fall, RADIUS, vz - G * fall
        push = min(FRICTION * (1.0 + RESTITUTION) * -vz, abs(vx - RADIUS * spin) / 3.5)
        push *= np.sign(vx - RADIUS * spin)
        vx, spin, vz = vx - push, spin + 2.5 * push / RADIUS, -RESTITUTION * vz
        spins.append(spin)
    return np.array(places), spins


def video(path: Path, drop: tuple[float, float], remark: bool, lost: bool) -> None:
    """A table of a tracking program: y downwards in pixels, one remark below the names, frames that were lost."""
    places = bounces(*drop)[0]
    places = places + np.random.default_rng(5).normal(0.0, NOISE, places.shape)
    rows = [f"{n},{300 + SCALE * x:.2f},{1500 - SCALE * z:.2f}" for n, (x, z) in enumerate(places)]
    kept = [row for n, row in enumerate(rows) if not (lost and n % 37 == 5)]
    path.parent.mkdir(exist_ok=True)
    path.write_text("\n".join(["frame,x,y", *(["Tracks 1 to 1"] if remark else []), *kept]) + "\n")


def found_in(folder: Path, output: Path) -> tuple[FoundImpacts, dict]:
    draft = draft_import([folder], output, ImportOptions(robot="none", rate=RATE))
    output.mkdir()
    for name, text in draft.texts.items():
        (output / name).write_text(
            text.replace("  # radius: 0.02", f"  mass: 0.005\n  spin: [0, 0, 0]\n  radius: {RADIUS}")
        )
    experiment = load_experiment(output / "experiment.yaml")
    return find_impacts(folder, experiment, map), yaml.safe_load(draft.texts["mapping.yaml"])


@pytest.mark.parametrize("lost", [False, True])
def test_bounces_in_pixels_give_restitution_scale_and_the_spin_of_the_ball(lost: bool, tmp_path: Path) -> None:
    """Kills y upwards, a frame for a second, lost frames closed up, and a spin that starts anew at every bounce."""
    for number, drop in enumerate(DROPS, start=1):
        video(tmp_path / "video" / f"drop_{number}.csv", drop, remark=number == 1, lost=lost)
    found, mapping = found_in(tmp_path / "video", tmp_path / "lab")
    along, up = mapping["signals"]["object_position"]["factor"]
    assert along == -up == pytest.approx(1.0 / SCALE, rel=0.01)
    assert mapping["time"] == {"column": "frame", "unit": "frames", "rate": RATE}
    ratios = [-impact.after[2] / impact.before[2] for impact in found.impacts]
    assert len(ratios) >= 9 and np.mean(ratios) == pytest.approx(RESTITUTION, abs=0.004)
    for number, drop in enumerate(DROPS, start=1):
        own = [one for one in found.impacts if one.run.startswith(f"drop_{number}")]
        for impact, spin in zip(own[1:], bounces(*drop)[1], strict=False):
            assert impact.before[4] == pytest.approx(spin, abs=4.0)  # rad/s; noise: 0.6 for every bounce


def test_after_an_impact_that_the_camera_did_not_see_the_spin_is_unknown(tmp_path: Path) -> None:
    """Kills the spin before the first bounce for that before the second, which friction has changed."""
    path = tmp_path / "video" / "drop.csv"
    video(path, DROPS[0], remark=False, lost=False)
    lines = path.read_text().splitlines()
    first = round(RATE * np.sqrt(2.0 * DROPS[0][1] / G))
    path.write_text("\n".join([*lines[: first - 14], *lines[first + 18 :]]) + "\n")
    found, _ = found_in(tmp_path / "video", tmp_path / "lab")
    assert found.impacts == ()
    assert "does not see the impact" in found.left_out[0].reason
    assert "the spin of the ball is unknown" in found.left_out[1].reason


def test_a_height_alone_gives_restitution_and_no_motion_along_the_plane(tmp_path: Path) -> None:
    """A range finder above, in mm, with a column of its temperature. Kills x and z exchanged, and the wrong column."""
    (tmp_path / "drops").mkdir()
    for number, (_, height) in enumerate(DROPS, start=1):
        z = bounces(0.0, height)[0][:, 1] + np.random.default_rng(number).normal(0.0, NOISE, int(1.4 * RATE))
        rows = [f"{n / RATE:.5f},{21.0 + 0.01 * n},{-1e3 * one:.3f}" for n, one in enumerate(z)]
        (tmp_path / "drops" / f"drop_{number}.csv").write_text("\n".join(["time,temp,range", *rows]) + "\n")
    found, mapping = found_in(tmp_path / "drops", tmp_path / "lab")
    assert mapping["signals"]["object_position"] == {"columns": ["range"], "unit": "mm", "factor": [-1.0]}
    assert len(found.impacts) >= 9
    assert np.mean([-one.after[2] / one.before[2] for one in found.impacts]) == pytest.approx(RESTITUTION, abs=0.004)
    assert all(np.all(one.before[[0, 1, 3, 4, 5]] == 0.0) for one in found.impacts)


def track(path: Path, places: np.ndarray, steps: bool) -> Path:
    """A table in metres, x along; the frames have no number, but perhaps the time since the one before."""
    rows = [f"{x:.6f},{y:.6f}" + f",{1.0 / RATE:.6f}" * steps for x, y in places]
    path.write_text("\n".join(["x,y" + ",dt" * steps, *rows]) + "\n")
    return path


def test_a_place_that_increases_is_no_clock(tmp_path: Path) -> None:
    """A ball that rolls on in x while it bounces. Kills a clock of any column that increases."""
    places = bounces(0.3, 0.4)[0]
    said = refusal(draft_import, [track(tmp_path / "a.csv", places, False)], tmp_path, ImportOptions(robot="none"))
    assert "no column holds time stamps" in said
    draft = draft_import([track(tmp_path / "b.csv", places, True)], tmp_path, ImportOptions(robot="none"))
    mapping = yaml.safe_load(draft.texts["mapping.yaml"])
    assert mapping["time"] == {"column": "dt", "unit": "s", "steps": True}
    assert mapping["signals"]["object_position"] == {"columns": ["x", "y"], "unit": "m"}


@pytest.mark.parametrize(("unit", "size"), [("m", 1.0), ("cm", 0.01), ("mm", 1e-3)])
def test_the_unit_of_a_ball_in_space_is_that_in_which_it_falls_by_g(tmp_path: Path, unit: str, size: float) -> None:
    """Kills: mm for a ball up to 106 cm from the origin, as if there were a robot."""
    x, z = bounces(0.3, 0.8)[0].T / size
    rows = [f"{n / RATE:.6f},{one:.6f},{0.0:.6f},{up:.6f}" for n, (one, up) in enumerate(zip(x, z, strict=True))]
    (tmp_path / "ball.csv").write_text("\n".join(["time,x,y,z", *rows]) + "\n")
    draft = draft_import([tmp_path / "ball.csv"], tmp_path, ImportOptions(robot="none"))
    assert yaml.safe_load(draft.texts["mapping.yaml"])["signals"]["object_position"]["unit"] == unit
    assert unit_of_flight(np.arange(90) / RATE, np.full((90, 3), 0.5)).sure is False


def test_a_body_on_a_table_is_sent_to_a_table_of_impacts(tmp_path: Path) -> None:
    """A puck that hits walls. Kills a refusal that does not say what to do."""
    along, across = (np.abs(np.arange(300) * speed % 2.0 - 1.0) for speed in (0.01, 0.017))
    file = track(tmp_path / "puck.csv", np.column_stack((along, across)), True)
    said = refusal(draft_import, [file], tmp_path, ImportOptions(robot="none"))
    assert "Neither of x, y falls freely" in said and "the normal of the wall (nx, ny, nz)" in said


def test_a_fall_is_found_in_metres_and_none_on_a_table(tmp_path: Path) -> None:
    """Kills a scale that replaces a known unit, and gravity where a puck slides."""
    time = np.arange(0.0, 1.4, 1.0 / RATE)
    falling = fall_in(time, bounces(0.3, 0.4)[0][:, ::-1])
    assert falling is not None
    axis, unit = falling
    assert (axis, unit.value, unit.sure, dict(unit.further)) == (0, "m", True, {})
    sliding = np.cumsum(np.random.default_rng(0).normal(0.0, 1e-3, (time.size, 2)), axis=0)
    assert fall_in(time, sliding) is None and fall_in(time[:10], sliding[:10]) is None
