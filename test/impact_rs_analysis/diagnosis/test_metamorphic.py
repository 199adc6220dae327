# SPDX-License-Identifier: Apache-2.0
"""What must not matter does not: units, names, order, kind of file, effects that are not there, where a fit begins.

Two tables with a truth (balls with known noise, cubes with repeats), recordings of arms, and trials of a world with a
closed form. Verdict and estimates
are compared with those of the same data, changed in a way that changes no physics.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from analytic_world import EFFECTS, AnalyticSource, features, knowing
from ball_impacts import Racket, ball_table
from impact_table_cases import CUBE_HEADER, NOISE, cube, cube_rows, write_csv
from joint_recordings import swinging, write_bag, write_npz
from slender_arm import mapping_of, slender_arm
from slender_arm import swung as swung_arm

from impact_rs_analysis.diagnosis.diagnose import diagnose
from impact_rs_analysis.diagnosis.document import DiagnosisDocument
from impact_rs_analysis.evidence.sources.recording_source import RecordingSource
from impact_rs_analysis.evidence.sources.table_source import ImpactTableSource
from impact_rs_sim.model import load_model
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_trials.recordings.impacts.impact_table import read_impact_table
from impact_rs_trials.recordings.mapping import load_mapping
from impact_rs_trials.recordings.recording import read_recordings

NOMINAL = load_model(Path("nominal"))
OF_BALLS = ["restitution", "restitution_fall", "support_friction", "tangential_restitution", "drilling_friction"]
OF_CUBES = ["restitution", "support_friction", "object_com_offset", "rolling_resistance"]
OF_TRIALS = ["straight", "bent", "payload", "of_joints", "one_sided"]
OF_ARMS = ["joint_coulomb_friction", "joint_viscous_friction", "torque_offset", "torque_gain", "end_effector_payload"]
MAPPING = load_mapping("joint_state")

Table = tuple[list[str], list[list[str]]]


def diagnosed(path: Path, effects: Sequence[str]) -> DiagnosisDocument:
    return diagnose(ImpactTableSource(read_impact_table(path), NOMINAL), NOMINAL, effects)


def estimates(document: DiagnosisDocument) -> dict[tuple[str, str], tuple[float, float]]:
    """Estimate and half width of the parameters of all named effects."""
    return {
        (name, key): (found.estimate, (found.interval[1] - found.interval[0]) / 2.0)
        for name in document.named
        for key, found in document.effect(name).parameters.items()
    }


def assert_alike(
    one: DiagnosisDocument, other: DiagnosisDocument, share: float = 1e-6, factors: dict[str, float] | None = None
) -> None:
    """Same verdicts, and estimates that differ by less than a share of their intervals.

    Args:
        one: A diagnosis.
        other: That of the same physics told in another way.
        share: Of a half width [-].
        factors: By parameter, its value in the units of the other over its value in those of the one.
    """
    assert set(one.named) == set(other.named)
    for (name, key), (value, half) in estimates(one).items():
        factor = (factors or {}).get(key, 1.0)
        again = estimates(other)[name, key][0] / factor
        assert again == pytest.approx(value, abs=share * half + 1e-9), (name, key)
        assert one.effect(name).verdict == other.effect(name).verdict


@pytest.fixture(scope="module")
def balls(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Balls with e = 0.53 and mu = 0.212 that are believed to have 0.3 and 0.4."""
    path = tmp_path_factory.mktemp("balls") / "balls.csv"
    return ball_table(path, Racket(lambda v: 0.53, 0.212), rows=96, friction=0.4, restitution=0.3)


@pytest.fixture(scope="module")
def of_balls(balls: Path) -> DiagnosisDocument:
    document = diagnosed(balls, OF_BALLS)
    assert set(document.named) == {"restitution", "support_friction"}
    return document


@pytest.fixture(scope="module")
def cubes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Five tosses, six times each, of cubes with mu = 0.2 and e = 0.3."""
    rng, rows = np.random.default_rng(3), []
    for number, row in enumerate(cube_rows(cube(0.2, 0.3), 5, seed=4, noise=False)):
        for _ in range(6):
            again = np.array(row)
            again[13:19] += np.repeat(NOISE[:2], 3) * rng.standard_normal(6)
            rows.append([*again, f"toss {number}"])
    path = tmp_path_factory.mktemp("cubes") / "cubes.csv"
    return write_csv(path, [*CUBE_HEADER, "condition"], rows)


@pytest.fixture(scope="module")
def of_cubes(cubes: Path) -> DiagnosisDocument:
    document = diagnosed(cubes, OF_CUBES)
    assert set(document.named) == {"restitution", "support_friction"}
    return document


def read(path: Path) -> Table:
    with path.open(encoding="utf-8", newline="") as file:
        header, *rows = csv.reader(file)
    return header, rows


def changed(path: Path, folder: Path, change: Callable[[list[str], list[list[str]]], Table]) -> Path:
    """The table with a change."""
    return write_csv(folder / "changed.csv", *change(*read(path)))


@pytest.mark.slow
@pytest.mark.parametrize("removed", ["restitution_fall", "drilling_friction"])
def test_an_effect_that_is_not_named_can_be_taken_from_the_list(
    balls: Path, of_balls: DiagnosisDocument, removed: str
) -> None:
    assert_alike(of_balls, diagnosed(balls, [name for name in OF_BALLS if name != removed]))


@pytest.mark.slow
def test_the_order_of_rows_without_repeats_moves_blocks_alone(
    balls: Path, of_balls: DiagnosisDocument, tmp_path: Path
) -> None:
    def backwards(header: list[str], rows: list[list[str]]) -> Table:
        return header, rows[::-1]

    assert_alike(of_balls, diagnosed(changed(balls, tmp_path, backwards), OF_BALLS), share=0.05)


DIMENSIONS = {  # powers of kg, m, s
    "mass": (1, 0, 0), "radius": (0, 1, 0), "x": (0, 1, 0), "y": (0, 1, 0), "z": (0, 1, 0),
    "size_x": (0, 1, 0), "size_y": (0, 1, 0), "size_z": (0, 1, 0), "v": (0, 1, -1), "w": (0, 0, -1),
}  # fmt: skip


def in_units(path: Path, folder: Path, mass: float, length: float, time: float) -> Path:
    """The table of bodies of another mass and size that come at another speed, in proportion."""

    def factor(name: str) -> float:
        powers = DIMENSIONS.get(name.split()[0], DIMENSIONS.get(name[0]) if "_" in name else None)
        return 1.0 if powers is None else mass ** powers[0] * length ** powers[1] * time ** powers[2]

    def scaled(header: list[str], rows: list[list[str]]) -> Table:
        factors = [factor(name) for name in header]
        scale = [[repr(float(c) * f) if f != 1.0 else c for c, f in zip(row, factors, strict=True)] for row in rows]
        return header, scale

    return changed(path, folder, scaled)


@pytest.fixture(scope="module")
def spun(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, DiagnosisDocument]:
    """Balls whose parameters have units: a restitution that falls with speed, and friction against their spin."""
    racket = Racket(lambda v: 0.9 - 0.0213 * v, 0.25, drilling=0.001)
    path = ball_table(tmp_path_factory.mktemp("spun") / "balls.csv", racket, rows=96, friction=0.25, restitution=0.9)
    document = diagnosed(path, OF_BALLS)
    assert set(document.named) == {"restitution_fall", "drilling_friction"}
    return path, document


def columns_mixed(header: list[str], rows: list[list[str]]) -> Table:
    order = np.random.default_rng(2).permutation(len(header)).tolist()
    return [header[k] for k in order], [[row[k] for k in order] for row in rows]


def test_units_and_the_order_of_columns_do_not_matter(spun: tuple[Path, DiagnosisDocument], tmp_path: Path) -> None:
    """Bodies of another mass and size at another speed, in proportion. Kills: a limit in kg, m or s."""
    path, document = spun
    mass, length, time = 50.0, 30.0, 100.0
    again = diagnosed(changed(in_units(path, tmp_path, mass, length, time), tmp_path, columns_mixed), OF_BALLS)
    assert again.verdict == document.verdict
    assert_alike(document, again, share=1e-3, factors={"fall": time / length, "arm": length})
    speed = length / time
    assert again.held_out_error_after == pytest.approx(speed * document.held_out_error_after, rel=1e-3)


def test_units_names_and_order_do_not_matter_where_bodies_have_edges_and_rows_repeats(
    cubes: Path, of_cubes: DiagnosisDocument, tmp_path: Path
) -> None:
    """Rows and columns in another order, conditions with other names, in other units, all at once."""

    def renamed(header: list[str], rows: list[list[str]]) -> Table:
        place = header.index("condition")
        names = {f"toss {k}": f"{chr(ord('z') - k)}" for k in range(5)}
        rows = [[*row[:place], names[row[place]], *row[place + 1 :]] for row in rows]
        return columns_mixed(header, [rows[k] for k in np.random.default_rng(0).permutation(len(rows))])

    again = diagnosed(changed(in_units(cubes, tmp_path, mass=40.0, length=7.0, time=3.0), tmp_path, renamed), OF_CUBES)
    assert again.verdict == of_cubes.verdict
    assert_alike(of_cubes, again, share=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("assumed", [0.0, 1.0])  # less and more than there is
def test_the_restitution_that_is_assumed_does_not_matter(tmp_path: Path, assumed: float) -> None:
    """A row of cubes with e = 0.3 and mu = 0.2, believed to bounce otherwise."""
    rows = cube_rows(cube(0.2, 0.3), 60)
    for row in rows:
        row[-1] = assumed
    document = diagnosed(write_csv(tmp_path / "cubes.csv", CUBE_HEADER, rows), OF_CUBES)
    assert set(document.named) == {"restitution", "support_friction"}
    found = estimates(document)
    value, half = found["restitution", "restitution"]
    assert value + assumed == pytest.approx(0.3, abs=1.5 * half)
    value, half = found["support_friction", "friction"]
    assert value + 0.5 == pytest.approx(0.2, abs=1.5 * half)


@pytest.fixture(scope="module")
def swung() -> dict[str, np.ndarray]:
    """24 s of an arm with friction in its joints, at 50 Hz."""
    frequencies = 0.11 + 0.017 * np.arange(7), 0.31 - 0.013 * np.arange(7)
    centre = np.array([0.0, -0.3, 0.0, -2.0, 0.0, 1.8, 0.5])
    model = RobotModel(MAPPING.facts, MAPPING.end_effector.build())
    found = swinging(model, np.arange(0.0, 24.0, 0.02), centre, frequencies, (0.45, 0.12))
    friction = np.array([0.9, 1.1, 0.8, 1.0, 0.6, 0.5, 0.5])
    found["effort"] += friction * np.tanh(found["velocity"] / 0.005)
    found["effort"] += np.random.default_rng(1).normal(0.0, 0.05, found["effort"].shape)
    return found


def of_recording(path: Path, effects: Sequence[str] = OF_ARMS) -> DiagnosisDocument:
    source = RecordingSource.of(read_recordings(path, MAPPING), MAPPING, NOMINAL)
    return diagnose(source, NOMINAL, effects)


@pytest.fixture(scope="module")
def of_swing(swung: dict[str, np.ndarray], tmp_path_factory: pytest.TempPathFactory) -> DiagnosisDocument:
    document = of_recording(write_npz(tmp_path_factory.mktemp("swing") / "swing.npz", swung))
    assert document.named == ("joint_coulomb_friction",)
    return document


@pytest.mark.slow
def test_names_and_order_of_joints_and_the_kind_of_file_do_not_matter(
    swung: dict[str, np.ndarray], of_swing: DiagnosisDocument, tmp_path: Path
) -> None:
    """A bag whose messages list joints with other names, in another order of the alphabet, in another order."""
    names = [f"axis_{chr(ord('g') - joint)}" for joint in range(7)]
    path = write_bag(tmp_path / "swing", swung, [3, 0, 6, 1, 5, 2, 4], names=names)
    renamed = MAPPING.model_copy(update={"joints": tuple(names)})
    source = RecordingSource.of(read_recordings(path, renamed), renamed, NOMINAL)
    assert_alike(of_swing, diagnose(source, NOMINAL, OF_ARMS), share=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("factor", [0.02, 50.0])
def test_the_unit_of_mass_does_not_matter_to_a_recording(tmp_path: Path, factor: float) -> None:
    """A pendulum whose links and torques are lighter or heavier by a factor, with friction in proportion."""
    found = []
    for scale in (1.0, factor):
        folder = tmp_path / f"{scale}"
        folder.mkdir()
        arm = slender_arm(("revolute",) * 2)
        links = [
            link.model_copy(update={"mass": scale * link.mass, "inertia": tuple(scale * i for i in link.inertia)})
            for link in arm.links
        ]
        limits = arm.limits.model_copy(update={"torque_Nm": tuple(scale * most for most in arm.limits.torque_Nm)})
        mapping = mapping_of(folder, arm.model_copy(update={"links": tuple(links), "limits": limits}))
        friction = {"coulomb_joint1": 0.6 * scale, "coulomb_joint2": 0.3 * scale}
        columns = swung_arm(mapping, {"joint_coulomb_friction": friction}, noise=0.02 * scale)
        path = write_npz(folder / "run.npz", columns)
        source = RecordingSource.of(read_recordings(path, mapping), mapping, NOMINAL)
        found.append(diagnose(source, NOMINAL, OF_ARMS))
    assert found[0].named == ("joint_coulomb_friction",)
    factors = {f"coulomb_joint{joint}": factor for joint in (1, 2)}
    assert_alike(*found, share=0.02, factors=factors)


@pytest.fixture(scope="module")
def of_trials() -> DiagnosisDocument:
    document = of_world()
    assert set(document.named) == {"straight", "bent"}
    return document


def of_world(order: Sequence[int] = range(6), label: str = "", effects: Sequence[str] = OF_TRIALS) -> DiagnosisDocument:
    """Diagnosis of six conditions, three times each, in some order and with other names."""
    source = AnalyticSource(2, (("straight", (2.0,)), ("bent", (3.0,))))
    knowing(source, *(EFFECTS[name] for name in effects))
    source.clusters = tuple(replace(source.clusters[number], unit=f"{label}{number}") for number in order)
    source.predict = lambda wanted, what: [features(order[number], added) for number, added in wanted]  # type: ignore[method-assign]
    return diagnose(source, source.model)


def test_order_and_names_of_conditions_do_not_matter(of_trials: DiagnosisDocument) -> None:
    assert_alike(of_trials, of_world((2, 0, 5, 1, 4, 3), "campaign of "), share=1e-3)


SLOW = pytest.mark.slow


@pytest.mark.parametrize(
    "removed", ["of_joints", *(pytest.param(name, marks=SLOW) for name in ("payload", "one_sided"))]
)
def test_an_effect_that_trials_do_not_show_can_be_taken_from_the_list(
    of_trials: DiagnosisDocument, removed: str
) -> None:
    assert_alike(of_trials, of_world(effects=[name for name in OF_TRIALS if name != removed]), share=1e-3)
