# SPDX-License-Identifier: Apache-2.0
"""Simple shapes of arms: they hold together, and look like the robot whose joints they connect."""

from __future__ import annotations

import numpy as np
import pytest

from impact_rs_sim.link_shapes import Shape, link_shapes
from impact_rs_sim.robot import RobotFacts, load_facts

ROBOTS = ("franka_fer", "franka_fr3", "kinova_gen3", "kuka_iiwa7", "ur5e", "ur10e")


def tubes(shapes: list[Shape]) -> list[Shape]:
    """Cylinders of the shell that are no housing about the own axis."""
    return [one for one in shapes if one.colour == "shell" and np.any(one.start != one.end) and not _about(one)]


def _about(shape: Shape) -> bool:
    return bool(np.allclose(shape.start, -shape.end) and np.allclose(shape.end[:2], 0.0))


def ends(facts: RobotFacts) -> list[np.ndarray]:
    return [np.array(joint.xyz) for joint in facts.joints[1:]] + [np.array(facts.flange.xyz)]


@pytest.mark.parametrize("name", ROBOTS)
def test_tubes_lead_from_each_joint_to_the_next_one_without_a_gap(name: str) -> None:
    facts = load_facts(name)
    for shapes, end in zip(link_shapes(facts)[1:], ends(facts), strict=True):
        own = tubes(shapes)
        if np.linalg.norm(end) < 1e-3:
            continue
        assert own[0].start == pytest.approx(np.zeros(3))
        assert own[-1].end == pytest.approx(end)
        for before, after in zip(own, own[1:], strict=False):
            assert before.end == pytest.approx(after.start)


@pytest.mark.parametrize("name", ROBOTS)
def test_the_wrist_is_thinner_than_the_shoulder(name: str) -> None:
    radii = [one.radius for shapes in link_shapes(load_facts(name))[1:] for one in shapes if _about(one)]
    assert len(radii) == load_facts(name).joint_count
    assert radii[-1] < radii[0]
    assert radii == sorted(radii, reverse=True)


def test_the_elbow_of_a_fer_is_set_off_and_the_upper_arm_of_a_ur_lies_beside_its_shoulder() -> None:
    """The common normal of elbow and forearm of a FER is 82.5 mm; a tube of a UR lies at its centre of mass."""
    forearm = tubes(link_shapes(load_facts("franka_fer"))[4])
    assert [float(np.linalg.norm(one.end - one.start)) for one in forearm] == pytest.approx([0.0825, 0.384])
    upper = tubes(link_shapes(load_facts("ur5e"))[2])
    assert upper[1].start == pytest.approx([0.0, 0.0, 0.11336])
    assert upper[1].end == pytest.approx([-0.425, 0.0, 0.11336])
