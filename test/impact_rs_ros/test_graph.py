# SPDX-License-Identifier: Apache-2.0
"""Who waits in vain is told for what."""

from __future__ import annotations

from functools import partial
from types import SimpleNamespace

import pytest
from rclpy.task import Future

from impact_rs_ros.graph import Graph, GraphError


def test_a_service_that_does_not_answer_is_named() -> None:
    """Kills: "the experiment node is silent", whatever node the service is of."""
    client = SimpleNamespace(srv_name="/plant/get", service_is_ready=lambda: True, call_async=lambda _: Future())
    node = SimpleNamespace(create_client=lambda *_: client, destroy_client=lambda _: None)
    graph = SimpleNamespace(node=node, lost=dict, spin=lambda _: None)
    graph._wait = partial(Graph._wait, graph)
    with pytest.raises(GraphError, match=r"^/plant/get is silent for 0\.01 s$"):
        Graph.call(graph, None, "plant/get", None, timeout=0.01)  # type: ignore[arg-type]
