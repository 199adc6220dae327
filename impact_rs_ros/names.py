# SPDX-License-Identifier: Apache-2.0
"""What a graph of nodes is called on the network, so that several run side by side in namespaces of their own.

In the program and in bags a topic has the name that it has in the root namespace (``/arm/joint_states``). On the
network it is relative to the namespace of its graph (``/cell_a/arm/joint_states``), unless all of ROS agrees on one.
"""

from __future__ import annotations

import re

from rclpy.node import Node

from impact_rs_sim.errors import InputError
from impact_rs_trials.bags import topics

NAMESPACE = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+")  # of ROS 2, the root aside

SHARED = frozenset({topics.TF, topics.TF_STATIC, topics.DIAGNOSTICS})
"""Topics that every graph publishes under the same name, for all of ROS reads them together.

``/clock`` is none of them: it has one publisher, or time jumps. In the namespace ``/cell_a`` it is ``/cell_a/clock``,
and a node of yours that uses its time is started with ``-r /clock:=/cell_a/clock``.
"""


def on_network(topic: str) -> str:
    """Name of a topic for rclpy, which puts the namespace of the node before it.

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
    """A namespace as a node tells it: ``cell_a`` is ``/cell_a``, and nothing is ``/``.

    Raises:
        InputError: ROS has no such namespace.
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
    """What stands before every frame of a graph on ``/tf``: ``cell_a/`` in ``/cell_a``, nothing in the root.

    The parameter of this name of robot_state_publisher does the same.
    """
    return within(namespace, "").removeprefix("/")


def within(namespace: str, name: str) -> str:
    """Full name, ``/cell_a/run_trial``, of what a node in a full ``namespace`` calls ``name``."""
    return f"{namespace.rstrip('/')}/{name}"
