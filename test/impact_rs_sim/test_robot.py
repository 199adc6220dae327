# SPDX-License-Identifier: Apache-2.0
"""Facts about robots: checked for their lengths, found by their names."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import yaml

from impact_rs_sim.errors import InputError
from impact_rs_sim.paths import config_directory
from impact_rs_sim.robot import EndEffector, Flange, Link, load_facts
from impact_rs_sim.robot_check import empty_flange, random_positions
from impact_rs_sim.robot_model import RobotModel

FER = config_directory() / "robots" / "franka_fer.yaml"


def test_the_published_masses_of_the_links_are_in_the_file() -> None:
    """Gaz et al. 2019; another set of the same arm is wrong by some percent in the velocity after an impact."""
    masses = [link.mass for link in load_facts("franka_fer").links]
    assert masses == pytest.approx([4.970684, 0.646926, 3.228604, 3.587895, 1.225946, 1.666555, 0.735522])


def test_a_panda_with_hand_moves_as_one_without_that_carries_the_hand() -> None:
    """Hand and fingers of the maker's description as an end effector, in the frame of the tool centre point."""
    tcp = 0.1034  # m from the hand's frame, which is turned by -45 degrees about the flange's axis
    hand = pin.Inertia(
        0.6544,
        np.array([-3.76e-5, 0.0119128, 0.020726]),
        np.array([[1.86e-3, 0.0, 0.0], [0.0, 3.0e-4, -2.0e-5], [0.0, -2.0e-5, 1.74e-3]]),
    )
    finger = pin.Inertia(
        0.0291,
        np.array([0.0, 0.015285, 0.0219675]),
        np.array([[8.49e-6, 0.0, 0.0], [0.0, 8.53e-6, -1.06e-6], [0.0, -1.06e-6, 1.77e-6]]),
    )
    for yaw in (0.0, np.pi):
        hand += pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, yaw), np.array([0.0, 0.0, 0.0584])).act(finger)
    carried = EndEffector(
        hand.mass, hand.lever - [0.0, 0.0, tcp], hand.inertia, tcp, -np.pi / 4.0, pad_size=(0.01, 0.01, 0.01)
    )
    without = RobotModel(load_facts("franka_fer"), carried)
    whole = RobotModel(load_facts("franka_fer_hand"), empty_flange())
    for q in random_positions(whole)[:10]:
        np.testing.assert_allclose(whole.mass_matrix(q), without.mass_matrix(q), atol=1e-5)
        np.testing.assert_allclose(whole.gravity_torque(q), without.gravity_torque(q), atol=1e-4)
        assert whole.placement(q).isApprox(without.placement(q), 1e-9)


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
