# SPDX-License-Identifier: Apache-2.0
"""Nodes talk over the loopback: no shared memory, and no socket that another machine reaches."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from impact_rs_ros.middleware import PROFILE, RANGE, set_middleware

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


def test_who_has_chosen_keeps_it() -> None:
    for chosen in (
        {RANGE: "SUBNET"},
        {PROFILE: "/own.xml"},
        {"FASTDDS_BUILTIN_TRANSPORTS": "SHM"},
        {"RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp"},
    ):
        environment = dict(chosen)
        set_middleware(environment)
        assert environment == {RANGE: "LOCALHOST"} | chosen


def test_without_the_profile_the_nodes_stay_within_this_machine(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("IMPACT_RS_CONFIG", str(tmp_path))  # a folder of one's own, without it
    environment: dict[str, str] = {}
    set_middleware(environment)
    assert environment == {RANGE: "LOCALHOST"}
