# SPDX-License-Identifier: Apache-2.0
"""Names on the network: relative to the namespace of the graph, but for what all of ROS agrees on."""

from __future__ import annotations

import pytest

from impact_rs_ros.names import SHARED, full_namespace, on_network, within
from impact_rs_sim.errors import InputError
from impact_rs_trials.bags import topics


def test_recorded_topics_are_in_the_namespace_but_tf_and_diagnostics() -> None:
    absolute = {topic for topic in topics.recorded(["left", "right"]) if on_network(topic).startswith("/")}
    assert absolute == SHARED == {"/tf", "/tf_static", "/diagnostics"}
    assert on_network("/left/joint_states") == "left/joint_states"


def test_two_plants_in_namespaces_do_not_publish_to_one_clock() -> None:
    """Time would jump to and fro for whoever uses it."""
    assert on_network(topics.CLOCK) == "clock"


@pytest.mark.parametrize(
    ("text", "full"),
    [("", "/"), ("/", "/"), ("cell_a", "/cell_a"), ("/cell_a/", "/cell_a"), ("hall/cell_a", "/hall/cell_a")],
)
def test_a_namespace_is_taken_with_and_without_slashes(text: str, full: str) -> None:
    assert full_namespace(text) == full


@pytest.mark.parametrize("text", ["cell a", "1st", "cell//a", "cell-a", "a/../b"])
def test_a_namespace_that_ros_does_not_have_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="namespace = .*begin with no digit"):
        full_namespace(text)


def test_a_name_within_the_root_has_one_slash() -> None:
    assert (within("/", "plant"), within("/cell_a", "plant")) == ("/plant", "/cell_a/plant")
