# SPDX-License-Identifier: Apache-2.0
"""A killed or frozen process is lost, two of one name are duplicates, and a frozen one discovers no subscription."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack

import pytest
from node_trials import participant
from processes import until
from rclpy.executors import SingleThreadedExecutor

from impact_rs_ros.presence import GRACE, LEAVING, Presence, SubscriptionsMatched

PROGRAM = """
import rclpy, sys
from impact_rs_ros.presence import announce
rclpy.init()
node = rclpy.create_node(sys.argv[1], namespace="cell")
publisher = announce(node)
try:
    rclpy.spin(node)
except KeyboardInterrupt:
    node.destroy_node()
"""


class Watch:
    """A presence, and processes that it may see."""

    def __init__(self, domain: int, stack: ExitStack) -> None:
        self.node = stack.enter_context(participant(domain, "watch", "cell"))
        self.presence = Presence(self.node, ["one", "other"])
        self._executor = SingleThreadedExecutor(context=self.node.context)
        self._executor.add_node(self.node)
        stack.callback(self._executor.shutdown)
        self._stack = stack
        self._environment = dict(os.environ, ROS_DOMAIN_ID=str(domain))

    def start(self, name: str) -> subprocess.Popen[bytes]:
        process = subprocess.Popen([sys.executable, "-c", PROGRAM, name], env=self._environment)
        self._stack.enter_context(process)
        self._stack.callback(process.kill)
        return process

    def until(self, condition: Callable[[], object], what: str) -> None:
        until(condition, lambda: self._executor.spin_once(timeout_sec=0.05), what)

    def until_alive(self, name: str) -> None:
        self.until(lambda: name not in self.presence.absent(), "not discovered")


@pytest.fixture
def watch(domain_ids: Callable[[], int]) -> Iterator[Watch]:
    with ExitStack() as stack:
        yield Watch(domain_ids(), stack)


def test_a_frozen_and_a_killed_process_are_lost_and_a_resumed_one_not(watch: Watch) -> None:
    presence = watch.presence
    one = watch.start("one")
    watch.until_alive("one")
    watch.until(lambda: presence.publishers("one/alive") == ["/cell/one"], "its name is not discovered")
    assert presence.lost("one", "other") == []
    one.send_signal(signal.SIGSTOP)
    watch.until(lambda: presence.lost("one", "other") == ["one"], "not noticed that it froze")
    one.send_signal(signal.SIGCONT)
    watch.until(lambda: not presence.lost("one"), "not noticed that it goes on")
    one.kill()
    watch.until(lambda: presence.lost("one"), "not noticed that it was killed")
    presence.forget("one")
    assert presence.lost("one") == []


@pytest.mark.parametrize(("ends_by_itself", "after"), [(True, LEAVING), (False, GRACE)])
def test_a_node_that_takes_its_leave_has_time_to_end(
    watch: Watch, monkeypatch: pytest.MonkeyPatch, ends_by_itself: bool, after: float
) -> None:
    """One whose lease lapses has frozen."""
    one = watch.start("one")
    watch.until_alive("one")
    one.send_signal(signal.SIGINT if ends_by_itself else signal.SIGSTOP)
    watch.until(lambda: "one" in watch.presence.absent(), "not noticed that it is not alive")
    now = time.monotonic()
    for passed, lost in ((after - 0.5, []), (after + 0.5, ["one"])):
        monkeypatch.setattr(time, "monotonic", lambda passed=passed: now + passed)
        assert watch.presence.lost("one") == lost
    monkeypatch.undo()


def test_two_nodes_of_one_name_are_duplicates_until_one_leaves(watch: Watch) -> None:
    presence = watch.presence
    watch.start("one")
    other = watch.start("one")
    watch.until(lambda: presence.duplicates() == {"one": False}, "no duplicate, or certain at once")
    watch.until(lambda: presence.duplicates() == {"one": True}, "one of them may have ended")
    assert presence.full_name("one") == "/cell/one"
    other.kill()
    watch.until(lambda: not presence.duplicates(), "still a duplicate")
    assert presence.lost("one") == []


def test_subscriptions_are_matched_by_running_nodes_not_by_a_frozen_one(watch: Watch) -> None:
    matched = SubscriptionsMatched(watch.node, ["one", "other"])
    try:
        matched.begin()
        assert matched.awaited() == []  # no node runs
        one = watch.start("one")
        watch.until_alive("one")
        watch.until(lambda: not matched.awaited(), "not discovered")
        one.send_signal(signal.SIGSTOP)
        watch.until(lambda: "one" in watch.presence.absent(), "not noticed that it froze")
        matched.begin()
        watch.until(lambda: matched.awaited() == ["one/alive"], "a frozen process discovers nothing")
        one.send_signal(signal.SIGCONT)
        watch.until(lambda: not matched.awaited(), "not discovered when it went on")
    finally:
        matched.close()
