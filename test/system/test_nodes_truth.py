# SPDX-License-Identifier: Apache-2.0
"""``ros2 node list -a`` and ``ros2 node info`` show what docs/nodes.md says: five nodes, and everything they offer."""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from pathlib import Path

import pytest
from node_trials import spin_until
from rclpy.action import get_action_server_names_and_types_by_node

from impact_rs_ros.graph import Graph
from impact_rs_ros.message_types import available
from impact_rs_ros.node_processes import NODES
from impact_rs_trials.bags import topics

DOCS = Path(__file__).resolve().parents[2] / "docs" / "nodes.md"
OF_ROS = re.compile(  # what rclpy gives every node, lifecycle node or action
    r"/(rosout|parameter_events|transition_event|change_state|get_state|get_available_\w+|get_transition_graph"
    r"|get_type_description|\w+_parameters(_atomically)?|get_parameter_types|_action/\w+)$"
)
EVERY_NODE = {"publishes": {"/diagnostics", "/NODE/alive"}}
Offered = dict[str, set[str]]  # names by kind of entity


def documented() -> dict[str, Offered]:
    """The table of docs/nodes.md, for one arm called ``arm``; ``/truth/...`` stands for all below it."""
    found: dict[str, Offered] = {node: defaultdict(set) for node in NODES}
    node = ""
    for line in DOCS.read_text().partition("**Namespaces.**")[0].splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if len(cells) != 4 or cells[1] not in ("publishes", "subscribes", "service", "action"):
            continue
        node = cells[0].strip("`") or node
        found[node][cells[1]] |= {name.replace("ARM", "arm") for name in re.findall(r"`(/[\w/.]+)`", cells[2])}
    for node, offered in found.items():
        offered["publishes"] |= {name.replace("NODE", node) for name in EVERY_NODE["publishes"]}
        if not available(topics.TF_MESSAGE):
            offered["publishes"] -= {topics.TF, topics.TF_STATIC}
    return found


def shown(graph: Graph, node: str) -> Offered:
    """Topics, services and actions of a node, as the middleware lists them."""
    asked = graph.node
    entities = {
        "publishes": asked.get_publisher_names_and_types_by_node(node, "/"),
        "subscribes": asked.get_subscriber_names_and_types_by_node(node, "/"),
        "service": asked.get_service_names_and_types_by_node(node, "/"),
        "action": get_action_server_names_and_types_by_node(asked, node, "/"),
    }
    return {
        kind: {re.sub(r"^/truth/.*", "/truth/...", name) for name, _ in names if not OF_ROS.search(name)}
        for kind, names in entities.items()
    }


def test_each_program_is_one_node_and_none_is_hidden(graph: Graph) -> None:
    """Kills: a second node in a process, such as one that receives its messages."""

    def names() -> Counter[str]:
        return Counter(name for name, _ in graph.node.get_node_names_and_namespaces())

    expected = Counter([*NODES, graph.node.get_name()])
    spin_until(graph, lambda: names() == expected, f"not the five nodes alone: {names()}")


@pytest.mark.parametrize("node", NODES)
def test_a_node_has_the_topics_services_and_actions_of_the_docs_and_no_others(graph: Graph, node: str) -> None:
    wanted = {kind: names for kind, names in documented()[node].items() if names}
    assert wanted["publishes"]
    difference: list[str] = []

    def agrees() -> bool:
        here = shown(graph, node)
        difference[:] = [f"{kind}: {name}" for kind in here for name in sorted(here[kind] ^ wanted.get(kind, set()))]
        return not difference

    try:
        spin_until(graph, agrees)
    except AssertionError:
        pytest.fail(f"docs/nodes.md and the node differ in {difference}")
