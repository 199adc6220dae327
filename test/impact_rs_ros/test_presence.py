# SPDX-License-Identifier: Apache-2.0
"""A process that is killed or frozen is not there any more, and one that was never there is not missed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator

import pytest
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor

from impact_rs_ros.presence import Presence, SubscriptionsMatched

PATIENCE = 60.0  # s, of the tests; never reached on a machine that works
PROGRAM = """
import rclpy, sys
from impact_rs_ros.presence import announce
rclpy.init()
node = rclpy.create_node(sys.argv[1], namespace="cell")
publisher = announce(node)
rclpy.spin(node)
"""


class Watch:
    """A presence, and processes that it may see."""

    def __init__(self, domain: int) -> None:
        self.context = Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.node = rclpy.create_node("watch", namespace="cell", context=self.context)
        self.presence = Presence(self.node, ["one", "other"])
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.processes: list[subprocess.Popen[bytes]] = []
        self.environment = dict(os.environ, ROS_DOMAIN_ID=str(domain))

    def start(self, name: str) -> subprocess.Popen[bytes]:
        process = subprocess.Popen([sys.executable, "-c", PROGRAM, name], env=self.environment)
        self.processes.append(process)
        return process

    def until(self, condition: Callable[[], object], what: str) -> None:
        deadline = time.monotonic() + PATIENCE
        while not condition():
            assert time.monotonic() < deadline, what
            self.executor.spin_once(timeout_sec=0.05)

    def close(self) -> None:
        for process in self.processes:
            process.kill()
            process.wait()
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.try_shutdown(context=self.context)


@pytest.fixture
def watch(domain_ids: Callable[[], int]) -> Iterator[Watch]:
    watch = Watch(domain_ids())
    yield watch
    watch.close()


def test_a_frozen_and_a_killed_process_are_gone_and_one_that_goes_on_is_back(watch: Watch) -> None:
    presence = watch.presence
    one = watch.start("one")
    watch.until(lambda: presence.publishers("one/alive") == ["/cell/one"], "not met")
    watch.until(lambda: presence.alive("one"), "not there")
    assert presence.gone("one", "other") == []
    one.send_signal(signal.SIGSTOP)
    watch.until(lambda: presence.gone("one", "other") == ["one"], "not noticed that it froze")
    one.send_signal(signal.SIGCONT)
    watch.until(lambda: not presence.gone("one"), "not noticed that it goes on")
    one.kill()
    watch.until(lambda: presence.gone("one"), "not noticed that it was killed")
    presence.forget_absent()
    assert presence.gone("one") == []


def test_two_nodes_of_one_name_are_duplicates_until_one_of_them_leaves(watch: Watch) -> None:
    presence = watch.presence
    watch.start("one")
    other = watch.start("one")
    watch.until(lambda: presence.duplicates("one", "other") == ["one"], "no duplicate")
    watch.until(lambda: presence.duplicates("one", settled=True), "may be one that died")
    assert presence.full_name("one") == "/cell/one"
    other.kill()
    watch.until(lambda: not presence.duplicates("one"), "still a duplicate")
    assert presence.gone("one") == []


def test_subscriptions_are_matched_by_running_nodes_and_wait_for_a_frozen_one(watch: Watch) -> None:
    matched = SubscriptionsMatched(watch.node, ["one", "other"])
    try:
        matched.begin()
        assert matched.awaited() == []  # no node runs
        one = watch.start("one")
        watch.until(lambda: watch.presence.alive("one"), "not there")
        watch.until(lambda: not matched.awaited(), "not discovered")
        one.send_signal(signal.SIGSTOP)
        watch.until(lambda: not watch.presence.alive("one"), "not noticed that it froze")
        matched.begin()
        watch.until(lambda: matched.awaited() == ["one/alive"], "a frozen process discovers nothing")
        one.send_signal(signal.SIGCONT)
        watch.until(lambda: not matched.awaited(), "not discovered when it went on")
    finally:
        matched.close()
