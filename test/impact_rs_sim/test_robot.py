# SPDX-License-Identifier: Apache-2.0
"""Facts about robots: checked for their lengths, found by their names."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from impact_rs_sim.errors import InputError
from impact_rs_sim.paths import config_directory
from impact_rs_sim.robot import Flange, Link, load_facts

FER = config_directory() / "robots" / "franka_fer.yaml"


def test_the_published_masses_of_the_links_are_in_the_file() -> None:
    """Gaz et al. 2019; another set of the same arm is wrong by some percent in the velocity after an impact."""
    masses = [link.mass for link in load_facts("franka_fer").links]
    assert masses == pytest.approx([4.970684, 0.646926, 3.228604, 3.587895, 1.225946, 1.666555, 0.735522])


def test_every_link_is_a_body() -> None:
    for link in load_facts("franka_fer").links:
        smallest, middle, largest = np.linalg.eigvalsh(link.inertia_matrix)
        assert smallest > 0.0
        # The published values are identified numbers; the second link is rounded beyond the triangle inequality.
        assert largest < 1.5 * (smallest + middle)


def test_the_inertia_matrix_is_symmetric_with_each_entry_in_its_place() -> None:
    matrix = Link(mass=1.0, com=(0.0, 0.0, 0.0), inertia=(1.0, 2.0, 3.0, 4.0, 5.0, 6.0)).inertia_matrix
    np.testing.assert_array_equal(matrix, [[1.0, 2.0, 3.0], [2.0, 4.0, 5.0], [3.0, 5.0, 6.0]])


@pytest.mark.parametrize("key", ["links", "limits.torque_Nm"])
def test_an_entry_too_few_is_told_with_the_number_of_joints(tmp_path: Path, key: str) -> None:
    data = yaml.safe_load(FER.read_text())
    place = data
    *parents, last = key.split(".")
    for part in parents:
        place = place[part]
    place[last] = place[last][:6]
    path = tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump(data))
    with pytest.raises(InputError, match=f"{key} has 6 entries, expected one per joint"):
        load_facts(str(path))


def test_a_robot_that_is_not_there_is_answered_with_those_that_are() -> None:
    with pytest.raises(InputError, match="known robots: .*franka_fer"):
        load_facts("panda9")


def test_a_flange_along_the_last_link_reads_as_it_always_did() -> None:
    facts = load_facts("franka_fer")
    assert facts.model_dump()["flange"] == {"xyz": (0.0, 0.0, 0.107)}
    askew = facts.flange.model_copy(update={"rpy": (0.0, 0.5, 0.0)})
    assert askew.model_dump()["rpy"] == (0.0, 0.5, 0.0)
    assert Flange.model_validate_json(askew.model_dump_json()) == askew
