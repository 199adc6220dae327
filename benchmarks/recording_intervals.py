# SPDX-License-Identifier: Apache-2.0
"""Do intervals from recordings hold the truth? ``./run python -m benchmarks.recording_intervals --draws 100``.

A Franka arm with 0.7 kg at its flange swings for 36 s, each joint at two frequencies; motions, friction and the scale
of each joint's torque (``--scale``, a standard deviation) are drawn anew. Coulomb friction, viscous friction and the
payload are fitted. What the fit does not have is

* nothing,
* a friction of 3 % of the load of the joint,
* a ripple of 0.4 N m,
* a friction that grows with the square of the speed, 1 N m s^2/rad^2.

Printed is the share of 95 % intervals that hold the mass, the centre of mass and, where their truth is defined, the
friction parameters.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np

from impact_rs_analysis.diagnosis.diagnose import effects_for
from impact_rs_analysis.diagnosis.fit import Evidence, measure_again
from impact_rs_analysis.diagnosis.search import Search
from impact_rs_analysis.evidence.recordings import RecordingSource
from impact_rs_sim.model import Model
from impact_rs_sim.robot import Array
from impact_rs_sim.robot_model import RobotModel
from impact_rs_trials.recordings.mapping import load_mapping
from impact_rs_trials.recordings.recording import read_recordings

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "test" / "shared"))

from joint_recordings import swinging, write_npz  # noqa: E402

MAPPING = load_mapping("joint_state")
FITTED = ["joint_coulomb_friction", "joint_viscous_friction", "end_effector_payload"]
LEFT_OUT = ("nothing", "load", "ripple", "square")
MASS = 0.7  # kg
CENTRE = np.array([0.0, -0.3, 0.0, -2.0, 0.0, 1.8, 0.5])  # rad
NOISE = 0.05  # N m
JOINTS = 7


def inside(seed: int, left_out: str, scale: float, folder: Path) -> Array:
    """Whether the interval holds the truth, of friction, mass and centre, ``(2 n + 4,)``."""
    rng = np.random.default_rng(seed)
    end = MAPPING.end_effector.model_copy(update={"mass": MASS}).build()
    frequencies = rng.uniform(0.08, 0.25, JOINTS), rng.uniform(0.25, 0.45, JOINTS)
    centre = CENTRE + rng.uniform(-0.3, 0.3, JOINTS)
    columns = swinging(RobotModel(MAPPING.facts, end), np.arange(0.0, 36.0, 0.02), centre, frequencies, (0.4, 0.12))
    position, velocity, torque = (columns[name] for name in ("position", "velocity", "effort"))
    coulomb, viscous = rng.uniform(0.2, 0.5, JOINTS), rng.uniform(0.2, 0.6, JOINTS)
    direction = np.tanh(velocity / 0.005)
    friction = coulomb * direction + viscous * velocity
    if left_out == "load":
        friction += 0.03 * np.abs(torque) * direction
    if left_out == "ripple":
        friction += 0.4 * np.sin(12.0 * position + rng.uniform(0.0, 2.0 * np.pi, JOINTS))
    if left_out == "square":
        friction += velocity * np.abs(velocity)
    measured = (torque + friction) * (1.0 + scale * rng.standard_normal(JOINTS))
    measured += rng.normal(0.0, NOISE, measured.shape)
    path = write_npz(folder / f"{seed}.npz", columns | {"effort": measured})
    source = RecordingSource.of(read_recordings(path, MAPPING), MAPPING, Model(name="nominal"))
    fitted = Search(effects_for(source, FITTED), Evidence.of(source)).fitted(FITTED)
    assert fitted is not None
    fitted = measure_again(fitted)
    truth = np.concatenate((coulomb, viscous, [MASS, 0.0, 0.0, 0.0]))
    return np.asarray(np.abs(fitted.estimate - truth) <= fitted.half_widths * fitted.candidate.scale)


def main() -> None:
    """Count and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draws", type=int, default=100, help="recordings of every row")
    parser.add_argument("--scale", type=float, default=0.01, help="standard deviation of the torque's scale")
    arguments = parser.parse_args()
    print("| not in the fit | friction | mass | centre |\n|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        for left_out in LEFT_OUT:
            found = np.array([inside(seed, left_out, arguments.scale, Path(folder)) for seed in range(arguments.draws)])
            friction, mass, centre = found[:, : 2 * JOINTS], found[:, 2 * JOINTS], found[:, 2 * JOINTS + 1 :]
            known = f"{friction.mean():.1%}" if left_out in ("nothing", "ripple") else "–"
            print(f"| {left_out} | {known} | {mass.mean():.1%} | {centre.mean():.1%} |", flush=True)


if __name__ == "__main__":
    main()
