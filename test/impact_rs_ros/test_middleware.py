# SPDX-License-Identifier: Apache-2.0
"""Nodes talk over the loopback: no shared memory, and no socket that another machine reaches."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from impact_rs_ros import process
from impact_rs_ros.impact_map_node import ImpactMapNode
from impact_rs_ros.middleware import CHOICES, LOCALHOST, PROFILE, RANGE, set_middleware

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
def test_who_has_chosen_anything_keeps_it_and_nothing_is_added(name: str) -> None:
    chosen = {name: LOCALHOST if name == RANGE else "own"}
    environment = dict(chosen)
    set_middleware(environment)
    assert environment == chosen


def test_a_variable_that_is_empty_chooses_nothing() -> None:
    environment = dict.fromkeys(CHOICES, "")
    set_middleware(environment)
    assert (environment[RANGE], Path(environment[PROFILE]).name) == ("SYSTEM_DEFAULT", "loopback.xml")


def test_another_middleware_stays_within_this_machine_by_its_own_means() -> None:
    environment = {"RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp"}
    set_middleware(environment)
    assert environment == {"RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp", RANGE: LOCALHOST}


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
