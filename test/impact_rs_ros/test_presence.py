# SPDX-License-Identifier: Apache-2.0
"""A killed or frozen process is lost, two of one name are duplicates, and a frozen one discovers no subscription."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack

import pytest
from node_trials import participant
from processes import PATIENCE, until
from rclpy.executors import SingleThreadedExecutor

from impact_rs_ros import presence as presence_module
from impact_rs_ros.presence import LEASE_GRACE_S, LEAVING_S, Presence, SubscriptionsMatched
from impact_rs_ros.qos import LEASE_S

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
    """A presence with a clock of the test's, and processes that it may see: those take the time that they take."""

    def __init__(self, domain: int, stack: ExitStack) -> None:
        self.node = stack.enter_context(participant(domain, "watch", "cell"))
        self.presence = Presence(self.node, ["one", "other"])
        self.time = 0.0  # s
        self._executor = SingleThreadedExecutor(context=self.node.context)
        self._executor.add_node(self.node)
        stack.callback(self._executor.shutdown)
        self._stack = stack
        self._environment = dict(os.environ, ROS_DOMAIN_ID=str(domain))

    def monotonic(self) -> float:
        return self.time

    def start(self, name: str) -> subprocess.Popen[bytes]:
        process = subprocess.Popen([sys.executable, "-c", PROGRAM, name], env=self._environment)
        self._stack.enter_context(process)
        self._stack.callback(process.kill)
        return process

    def until(self, condition: Callable[[], object], what: str) -> None:
        until(condition, lambda: self._executor.spin_once(timeout_sec=0.05), what)

    def until_alive(self, name: str, alive: bool = True) -> None:
        """For a lease of a process that a busy machine starves lapses as well."""
        self.until(lambda: (name not in self.presence.absent()) == alive, f"alive is not {alive}")


@pytest.fixture
def watch(domain_ids: Callable[[], int], monkeypatch: pytest.MonkeyPatch) -> Iterator[Watch]:
    with ExitStack() as stack:
        made = Watch(domain_ids(), stack)
        monkeypatch.setattr(presence_module, "time", made)
        yield made


def test_a_frozen_and_a_killed_process_are_lost_after_some_grace_and_a_resumed_one_not(watch: Watch) -> None:
    """Kills: a lease that is not looked at, and one that counts at once."""
    presence = watch.presence
    one = watch.start("one")
    watch.until_alive("one")
    watch.until(lambda: presence.publishers("one/alive") == ["/cell/one"], "its name is not discovered")
    watch.time += 100.0
    watch.until(lambda: presence.lost("one", "other") == [], "lost, though it is alive")
    one.send_signal(signal.SIGSTOP)
    watch.until_alive("one", False)
    watch.time += LEASE_GRACE_S
    assert presence.lost("one", "other") == []
    watch.time += 0.1
    assert presence.lost("one", "other") == ["one"]
    one.send_signal(signal.SIGCONT)
    watch.until(lambda: not presence.lost("one"), "not noticed that it goes on")
    one.kill()
    watch.until_alive("one", False)
    watch.time += LEAVING_S + 0.1
    assert presence.lost("one") == ["one"]
    presence.forget("one")
    assert presence.lost("one") == []


def test_a_node_that_takes_its_leave_has_time_to_end(watch: Watch) -> None:
    one = watch.start("one")
    watch.until_alive("one")
    one.send_signal(signal.SIGINT)
    assert one.wait(PATIENCE) is not None
    watch.until(lambda: not watch.presence.publishers("one/alive"), "its publisher does not go")
    watch.until_alive("one", False)
    watch.time += LEAVING_S
    assert watch.presence.lost("one") == []
    watch.time += 0.1
    assert watch.presence.lost("one") == ["one"]


def test_two_nodes_of_one_name_are_duplicates_until_one_leaves(watch: Watch) -> None:
    presence = watch.presence
    watch.start("one")
    other = watch.start("one")
    watch.until(lambda: presence.duplicates() == {"one": False}, "no duplicate, or certain at once")
    watch.time += LEASE_S + LEASE_GRACE_S + 0.1  # neither of them has ended
    watch.until(lambda: presence.duplicates() == {"one": True}, "never certain")
    assert presence.full_name("one") == "/cell/one"
    other.kill()
    watch.until(lambda: not presence.duplicates(), "still a duplicate")
    watch.time += 100.0
    watch.until(lambda: presence.lost("one") == [], "the one that is left is lost")


def test_subscriptions_are_matched_by_running_nodes_not_by_a_frozen_one(watch: Watch) -> None:
    matched = SubscriptionsMatched(watch.node, ["one", "other"])
    try:
        matched.begin()
        assert matched.awaited() == []  # no node runs
        one = watch.start("one")
        watch.until_alive("one")
        watch.until(lambda: not matched.awaited(), "not discovered")
        one.send_signal(signal.SIGSTOP)
        watch.until_alive("one", False)
        matched.begin()
        watch.until(lambda: matched.awaited() == ["one/alive"], "a frozen process discovers nothing")
        one.send_signal(signal.SIGCONT)
        watch.until(lambda: not matched.awaited(), "not discovered when it went on")
    finally:
        matched.close()
