# SPDX-License-Identifier: Apache-2.0
"""Names of topics and services on the network, so that several graphs run side by side, each in its namespace.

In the program and in bags a topic has its name in the root namespace (``/arm/joint_states``). On the network it is
relative to the namespace of its graph (``/cell_a/arm/joint_states``), except for topics that all of ROS shares.
"""

from __future__ import annotations

import re

from rclpy.node import Node

from impact_rs_sim.errors import InputError
from impact_rs_trials.bags import topics

NAMESPACE = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+")  # of ROS 2, the root aside

SHARED = frozenset({topics.TF, topics.TF_STATIC, topics.DIAGNOSTICS})
"""Topics that every graph publishes under the same name, because ROS tools subscribe to them by it.

``/clock`` does not belong to them: with two publishers time would jump. In the namespace ``/cell_a`` it is
``/cell_a/clock``, and a node of yours that uses its time is started with ``-r /clock:=/cell_a/clock``.
"""


def on_network(topic: str) -> str:
    """Relative name of a topic for rclpy, which prepends the namespace of the node.

    Args:
        topic: Its name in the root namespace.
    """
    return topic if topic in SHARED else topic.removeprefix("/")


def resolved(node: Node, topic: str) -> str:
    """Full name of a topic of a node's graph, with namespace and remappings.

    Args:
        node: Whose graph it is.
        topic: Its name in the root namespace.
    """
    return str(node.resolve_topic_name(on_network(topic)))


def full_namespace(namespace: str) -> str:
    """A namespace as ``Node.get_namespace`` returns it: ``/cell_a`` for ``cell_a``, ``/`` for the empty text.

    Raises:
        InputError: ROS does not allow such a namespace.
    """
    full = f"/{namespace.strip('/')}"
    if full != "/" and not NAMESPACE.fullmatch(full):
        raise InputError(
            "expected names of letters, digits and _ that begin with no digit, with / between them",
            key="namespace",
            value=namespace,
        )
    return full


def frame_prefix(namespace: str) -> str:
    """Prefix of every frame of a graph on ``/tf``: ``cell_a/`` in ``/cell_a``, empty in the root namespace.

    The parameter ``frame_prefix`` of robot_state_publisher does the same.
    """
    return within(namespace, "").removeprefix("/")


def within(namespace: str, name: str) -> str:
    """Full name, ``/cell_a/run_trial``, of the relative ``name`` in a full ``namespace``."""
    return f"{namespace.rstrip('/')}/{name}"
