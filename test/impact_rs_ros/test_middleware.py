# SPDX-License-Identifier: Apache-2.0
"""Nodes talk over the loopback alone, in the namespace of their graph, and every subscriber hears its publisher."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import pytest
from rclpy.qos import (
    QoSCompatibility,
    QoSDurabilityPolicy,
    QoSHistoryPolicy,
    QoSReliabilityPolicy,
    qos_check_compatible,
)

from impact_rs_ros import process
from impact_rs_ros.impact_map_node import ImpactMapNode
from impact_rs_ros.middleware import CHOICES, LOCALHOST, NETWORK, PROFILE, RANGE, discovery, set_middleware
from impact_rs_ros.names import SHARED, full_namespace, on_network, within
from impact_rs_ros.node_parameters import defaults_of
from impact_rs_ros.qos import AWAITED, EVENT, LATCHED, RECORD, STREAM, WATCH, offered
from impact_rs_sim.errors import InputError
from impact_rs_sim.paths import config_directory
from impact_rs_trials.bags import topics

TELL = """
import os, sys, rclpy
from pathlib import Path
rclpy.init()
node = rclpy.create_node("probe")
inodes = {os.readlink(link) for link in Path("/proc/self/fd").iterdir() if link.exists() or link.is_symlink()}
sockets = {inode[8:-1] for inode in inodes if inode.startswith("socket:[")}
lines = [line.split() for line in Path("/proc/net/udp").read_text().splitlines()[1:]]
print(*sorted({line[1].split(":")[0] for line in lines if line[9] in sockets}))
print(sum("/dev/shm/fastrtps" in line for line in Path("/proc/self/maps").read_text().splitlines()))
"""
LOOPBACK = "0100007F"  # 127.0.0.1, as the kernel writes it


@pytest.mark.skipif(not Path("/proc/net/udp").exists(), reason="needs Linux")
def test_a_node_listens_on_the_loopback_alone_and_shares_no_memory(domain_ids: Callable[[], int]) -> None:
    environment = {key: value for key, value in os.environ.items() if key not in (RANGE, PROFILE)}
    environment["ROS_DOMAIN_ID"] = str(domain_ids())
    set_middleware(environment)
    told = subprocess.run([sys.executable, "-c", TELL], env=environment, capture_output=True, text=True, check=True)
    addresses, shared = told.stdout.splitlines()
    assert addresses.split() == [LOOPBACK]
    assert shared == "0"


@pytest.mark.parametrize("name", CHOICES)
def test_who_has_chosen_anything_keeps_it_and_gets_no_restriction(name: str) -> None:
    chosen = {name: LOCALHOST if name == RANGE else "own"}
    environment = dict(chosen)
    set_middleware(environment)
    added = {} if "PROFILES" in name else {PROFILE: str(config_directory() / NETWORK)}
    assert environment == chosen | added


def test_on_a_network_a_lost_packet_is_repaired_while_the_trial_still_waits() -> None:
    """By the heartbeat of its writer; the profile restricts nothing. Kills: the 3 s of Fast DDS."""
    root = ElementTree.parse(config_directory() / NETWORK).getroot()
    (only,) = root
    seconds, nanoseconds = (int(part.text or "") for part in only.iterfind(".//{*}heartbeatPeriod/*"))
    assert only.tag.endswith("data_writer")
    assert only.get("is_default_profile") == "true"
    assert 5.0 * (seconds + 1e-9 * nanoseconds) < defaults_of("experiment")["progress_timeout"]


def test_a_variable_that_is_empty_chooses_nothing() -> None:
    environment = dict.fromkeys(CHOICES, "")
    set_middleware(environment)
    assert (environment[RANGE], Path(environment[PROFILE]).name) == ("SYSTEM_DEFAULT", "loopback.xml")


def test_another_middleware_stays_within_this_machine_by_its_own_means() -> None:
    environment = {"RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp"}
    set_middleware(environment)
    assert environment == {"RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp", RANGE: LOCALHOST}


IMPORT = """
import os, pkgutil, signal, sys, threading
import rclpy.node  # the libraries of others, whose effects are theirs
from importlib import import_module
import numpy, scipy.optimize, proxsuite, pinocchio
def state():
    handlers = {number: signal.getsignal(number) for number in signal.valid_signals()}
    return dict(os.environ), handlers, threading.active_count()
before = state()
import impact_rs_ros
for module in pkgutil.iter_modules(impact_rs_ros.__path__, "impact_rs_ros."):
    import_module(module.name)
after = state()
assert after == before, [pair for pair in zip(after, before) if pair[0] != pair[1]]
assert not rclpy.ok()
"""


def test_importing_the_nodes_changes_neither_environment_nor_signals_nor_threads() -> None:
    """Kills: an import that edits AMENT_PREFIX_PATH, sets SIGINT, or chooses a middleware."""
    environment = {key: value for key, value in os.environ.items() if key not in (*CHOICES, "AMENT_PREFIX_PATH")}
    program = [sys.executable, "-c", IMPORT, "node"]
    done = subprocess.run(program, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_a_node_says_who_finds_it_and_how_to_change_that() -> None:
    environment: dict[str, str] = {}
    set_middleware(environment)
    here = "discovery: this machine only; for several machines set ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET on all of them"
    assert discovery(environment) == here
    assert discovery({RANGE: LOCALHOST}) == here
    set_middleware(own := {RANGE: "SUBNET", "ROS_STATIC_PEERS": "10.0.0.2"})
    assert discovery(own) == (
        "discovery: by the environment, ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET, ROS_STATIC_PEERS=10.0.0.2"
    )


def test_a_node_that_is_run_by_itself_keeps_to_this_machine_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """As ``ros2 run`` and the launch file do: the rule is the node's own."""
    for name in CHOICES:
        monkeypatch.delenv(name, raising=False)
    met: dict[str, str] = {}

    def init(**arguments: object) -> None:
        met.update(os.environ)
        raise KeyboardInterrupt

    monkeypatch.setattr(process.signal, "signal", lambda *_: None)
    monkeypatch.setattr(process.os, "sched_setscheduler", lambda *_: None)
    monkeypatch.setattr(process.rclpy, "init", init)
    with pytest.raises(KeyboardInterrupt):
        process.run(ImpactMapNode)
    assert Path(met[PROFILE]).name == "loopback.xml"
    for name in (RANGE, PROFILE):  # what the node set
        os.environ.pop(name)


def test_without_the_profile_the_nodes_stay_within_this_machine(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("IMPACT_RS_CONFIG", str(tmp_path))  # a folder of one's own, without it
    environment: dict[str, str] = {}
    set_middleware(environment)
    assert environment == {RANGE: "LOCALHOST"}


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


@pytest.mark.parametrize("subscriber", [AWAITED, RECORD, WATCH, EVENT], ids=["awaited", "record", "watch", "event"])
@pytest.mark.parametrize("publisher", [STREAM, LATCHED], ids=["stream", "latched"])
def test_a_subscriber_of_any_kind_hears_a_publisher_of_any_kind(publisher, subscriber) -> None:
    compatibility, reason = qos_check_compatible(publisher, subscriber)
    assert compatibility != QoSCompatibility.ERROR, reason


def test_the_recorder_loses_nothing_and_nobody_waits_for_it() -> None:
    assert RECORD.reliability == QoSReliabilityPolicy.RELIABLE
    assert RECORD.history == QoSHistoryPolicy.KEEP_ALL
    assert STREAM.reliability == QoSReliabilityPolicy.RELIABLE
    assert STREAM.history == QoSHistoryPolicy.KEEP_LAST, "a publisher that keeps all blocks when a subscriber dies"


def test_only_signals_of_every_tick_have_a_deep_history() -> None:
    depths = {topic: offered(topic).depth for topic in topics.recorded(["arm"])}
    deep = {topic for topic, depth in depths.items() if depth == STREAM.depth}
    arms = (topics.joint_states, topics.motor_states, topics.joint_command, topics.controller_state)
    arms += (topics.truth_joint_states, topics.truth_contact_wrench)
    poses = {topics.OBJECT_POSE, topics.TRUTH_OBJECT_POSE, topics.TRUTH_OBJECT_TWIST}
    assert deep == {*(name("arm") for name in arms), *poses}
    assert max(depth for topic, depth in depths.items() if topic not in deep) == 100


def test_static_frames_are_latched_as_tf2_expects() -> None:
    assert offered(topics.TF_STATIC).durability == QoSDurabilityPolicy.TRANSIENT_LOCAL


def test_who_comes_late_still_hears_what_is_said_once() -> None:
    assert LATCHED.durability == QoSDurabilityPolicy.TRANSIENT_LOCAL
    assert qos_check_compatible(LATCHED, LATCHED)[0] != QoSCompatibility.ERROR
    assert qos_check_compatible(STREAM, LATCHED)[0] == QoSCompatibility.ERROR
