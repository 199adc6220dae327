# SPDX-License-Identifier: Apache-2.0
"""Cylinders, capsules and meshes that land on a plane: closed forms, and laws hidden in MuJoCo and Bullet are found."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from impact_table_cases import write_csv
from intervals import assert_covers
from shape_tosses import HEADER, MASS, SIZES, com, in_bullet, in_mujoco, lowest, moments, thrown, write_pyramid

from impact_rs_analysis.diagnosis.diagnose import diagnose
from impact_rs_analysis.evidence.sources.table_source import ImpactTableSource
from impact_rs_sim.model import load_model
from impact_rs_trials.recordings.impacts.impact_table import ImpactTable, read_impact_table

NOMINAL = load_model(Path("nominal"))
KINDS = ["cylinder", "capsule", "mesh"]
NOISE = (0.005, 0.1)  # m/s, rad/s
UP = np.array([0.0, 0.0, 1.0])


def row_of(
    kind: str, place: np.ndarray, rotation: np.ndarray, twists: Sequence[np.ndarray], assumed: Sequence[float]
) -> list[Any]:
    """A row; of a mesh its extents are those of the file, so that these columns may be left out."""
    shape = ["", "pyramid.stl"] if kind == "mesh" else [kind, ""]
    return [*place, *pin.Quaternion(rotation).coeffs(), *np.ravel(twists), *shape, MASS, *SIZES[kind], *assumed]


def read(folder: Path, rows: Sequence[Sequence[Any]], header: Sequence[str] = HEADER, **options: Any) -> ImpactTable:
    write_pyramid(folder / "pyramid.stl")
    return read_impact_table(write_csv(folder / "tosses.csv", header, rows), **options)


def bounced(
    kind: str, rotation: np.ndarray, twist: np.ndarray, normal: np.ndarray, restitution: float
) -> tuple[np.ndarray, float]:
    """Twist of the middle after an impact without friction, and the energy after it over that before.

    J = (1 + e) v_n m_eff, 1 / m_eff = 1 / m + (r x n) . I^-1 (r x n), with r from the centre of mass (Routh 1877).
    """
    middle = rotation @ com(kind)
    lever = lowest(kind, rotation, normal) - middle
    inertia = rotation @ np.diag(moments(kind)) @ rotation.T
    turn = np.linalg.solve(inertia, np.cross(lever, normal))
    velocity = twist[:3] + np.cross(twist[3:], middle)
    approach = -normal @ (velocity + np.cross(twist[3:], lever))
    impulse = (1.0 + restitution) * approach / (1.0 / MASS + np.cross(lever, normal) @ turn)
    after, spin = velocity + impulse / MASS * normal, twist[3:] + impulse * turn

    def energy(v: np.ndarray, w: np.ndarray) -> float:
        return float(0.5 * MASS * v @ v + 0.5 * w @ inertia @ w)

    ratio = energy(after, spin) / energy(velocity, twist[3:])
    return np.array([*(after - np.cross(spin, middle)), *spin]), ratio


@pytest.mark.parametrize("restitution", [0.0, 0.6, 1.0])
@pytest.mark.parametrize("kind", KINDS)
def test_a_tilted_body_bounces_as_routh_says(tmp_path: Path, kind: str, restitution: float) -> None:
    """On planes of any tilt; kills a point beside the lowest one, and a mesh whose weight is in its middle."""
    rng, rows, ratios = np.random.default_rng(5), [], []
    for _ in range(12):
        place, rotation, twist = thrown(rng, kind)
        tilt = pin.exp3(np.array([*rng.uniform(-1.5, 1.5, 2), 0.0]))  # all of the problem
        normal, rotation = tilt @ UP, tilt @ rotation
        twist = np.concatenate((tilt @ twist[:3], tilt @ twist[3:]))
        after, ratio = bounced(kind, rotation, twist, normal, restitution)
        rows.append([*row_of(kind, place, rotation, (twist, after), (0.0, restitution)), *normal])
        ratios.append(ratio)
    table = read(tmp_path, rows, [*HEADER, "nx [-]", "ny [-]", "nz [-]"])
    source = ImpactTableSource(table, NOMINAL)
    np.testing.assert_allclose(source.predicted, source.measured, atol=1e-7)
    np.testing.assert_allclose(ratios, 1.0, atol=1e-12) if restitution == 1.0 else np.testing.assert_array_less(
        ratios, 1
    )


def test_a_rod_on_its_edge_sticks_as_kane_says(tmp_path: Path) -> None:
    """With friction enough to stick: u_t^+ = 0 and u_n^+ = -e u_n where it touches (Kane and Levinson 1985)."""
    half, radius, e, mu = SIZES["capsule"][2] / 2.0, SIZES["capsule"][0] / 2.0, 0.3, 5.0
    angle = 0.5
    rotation = pin.utils.rotate("y", np.pi / 2.0 + angle)  # its z points down by `angle` along x
    twist = np.array([0.4, 0.2, -1.5, 0.3, 0.5, -0.2])
    lever = np.array([(half - radius) * np.cos(angle), 0.0, -(half - radius) * np.sin(angle) - radius])
    inertia = rotation @ np.diag(moments("capsule")) @ rotation.T
    skew = np.cross(np.eye(3), lever)  # skew @ x = lever x x
    mobility = np.eye(3) / MASS - skew @ np.linalg.solve(inertia, skew)
    coming = twist[:3] + np.cross(twist[3:], lever)
    impulse = np.linalg.solve(mobility, -coming - e * coming[2] * UP)
    assert np.hypot(*impulse[:2]) < mu * impulse[2]
    after = np.concatenate((twist[:3] + impulse / MASS, twist[3:] + np.linalg.solve(inertia, skew @ impulse)))
    source = ImpactTableSource(
        read(tmp_path, [row_of("capsule", np.zeros(3), rotation, (twist, after), (mu, e))]), NOMINAL
    )
    np.testing.assert_allclose(source.predicted, source.measured, atol=1e-8)
    (point,) = source.table.rows[0].impact.points
    np.testing.assert_allclose(point.position, lever, atol=1e-12)


@pytest.mark.parametrize("kind", [pytest.param(kind, marks=pytest.mark.slow) for kind in KINDS[1:]] + ["cylinder"])
def test_restitution_hidden_in_mujoco_is_found_without_friction(tmp_path: Path, kind: str) -> None:
    """The table assumes e = 0.2; there is no friction, and a restitution by stiffness and damping."""
    rng, rows, ratios = np.random.default_rng(0), [], []
    for _ in range(50):
        place, rotation, twist = thrown(rng, kind)
        after = in_mujoco(kind, place, rotation, twist)
        lever = lowest(kind, rotation, UP)
        coming, leaving = ((one[:3] + np.cross(one[3:], lever))[2] for one in (twist, after))
        ratios.append(-float(leaving / coming))
        seen = after + np.repeat(NOISE, 3) * rng.standard_normal(6)
        rows.append(row_of(kind, place, rotation, (twist, seen), (0.0, 0.2)))
    source = ImpactTableSource(read(tmp_path, rows), NOMINAL)
    document = diagnose(source, NOMINAL, ["restitution", "support_friction", "object_com_offset"])
    assert document.named == ("restitution",)
    found = document.effect("restitution").parameters["restitution"]
    assert_covers(found.interval, float(np.mean(ratios)) - 0.2, 0.001)


def test_friction_and_restitution_hidden_in_bullet_are_found(tmp_path: Path) -> None:
    """Of a short capsule: the friction of Bullet turns away from the slip where a body is slender."""
    rng, rows = np.random.default_rng(3), []
    friction, restitution = 0.2, 0.4
    with in_bullet(friction, restitution) as land:
        for _ in range(50):
            place, rotation, twist = thrown(rng, "capsule")
            after = land(place, rotation, twist) + np.repeat(NOISE, 3) * rng.standard_normal(6)
            rows.append(row_of("capsule", place, rotation, (twist, after), (0.5, 0.0)))
    source = ImpactTableSource(read(tmp_path, rows), NOMINAL)
    document = diagnose(source, NOMINAL, ["restitution", "support_friction", "rolling_resistance"])
    assert set(document.named) == {"restitution", "support_friction"}
    assert_covers(document.effect("restitution").parameters["restitution"].interval, restitution, 0.001)
    assert_covers(document.effect("support_friction").parameters["friction"].interval, friction - 0.5, 0.0007)
