# SPDX-License-Identifier: Apache-2.0
"""Discovery: nodes find each other on this machine alone, unless the environment of the user configures it.

One rule for every node and command of impact_rs, however it is started: ``ros2 run``, ``ros2 launch``,
``impact-rs up``, ``./run``. Every node logs at its start which it is, and how to change it.
"""

from __future__ import annotations

from collections.abc import Mapping, MutableMapping
from pathlib import Path

from impact_rs_sim.paths import config_directory

RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
PROFILE = "FASTRTPS_DEFAULT_PROFILES_FILE"
NEWER_PROFILE = "FASTDDS_DEFAULT_PROFILES_FILE"
CHOICES = (
    RANGE,
    "ROS_STATIC_PEERS",
    "ROS_DISCOVERY_SERVER",
    "ROS_LOCALHOST_ONLY",
    PROFILE,
    NEWER_PROFILE,
    "FASTDDS_BUILTIN_TRANSPORTS",
    "CYCLONEDDS_URI",
)
"""Environment variables: if any is set, discovery and transport are the user's choice."""
LOCALHOST = "LOCALHOST"
LOOPBACK = "loopback.xml"  # profile of Fast DDS on this machine
NETWORK = "network.xml"  # and on a network: how soon a lost packet is repaired; it restricts nothing


def set_middleware(environment: MutableMapping[str, str]) -> None:
    """Restrict communication to this machine unless one of ``CHOICES`` is set; call before ``rclpy.init``.

    Fast DDS gets ``config/loopback.xml``: UDP on 127.0.0.1. The discovery range ``LOCALHOST`` would not do: it makes
    transports of its own, shared memory among them, whatever ``FASTDDS_BUILTIN_TRANSPORTS`` says, and opens ports to
    all networks. In shared memory a killed process leaves its segments behind, and a frozen one can hold a lock. Any
    other middleware gets ``LOCALHOST``.

    Where the user opens discovery, Fast DDS gets ``config/network.xml`` unless the user has a profile: a lost packet is
    repaired after 0.1 s instead of 3 s, which is longer than a trial waits for an answer.

    Args:
        environment: Environment of this process, or of one to start; an empty variable counts as unset.
    """
    chosen = any(environment.get(name) for name in CHOICES)
    fast = environment.get("RMW_IMPLEMENTATION", "rmw_fastrtps_cpp").startswith("rmw_fastrtps")
    profile = config_directory() / (NETWORK if chosen else LOOPBACK)
    if fast and profile.is_file() and not (environment.get(PROFILE) or environment.get(NEWER_PROFILE)):
        environment[PROFILE] = str(profile)
        if not chosen:
            environment[RANGE] = "SYSTEM_DEFAULT"  # the profile decides on the range
    elif not chosen:
        environment[RANGE] = LOCALHOST


def discovery(environment: Mapping[str, str]) -> str:
    """Who finds the nodes of this environment, and how to change it; a line for the log.

    Args:
        environment: Environment after :func:`set_middleware`, or as ``./run`` prepared it.
    """
    profile = Path(environment.get(PROFILE, "")).name
    if profile == LOOPBACK or environment.get(RANGE) == LOCALHOST:
        return f"discovery: this machine only; for several machines set {RANGE}=SUBNET on all of them"
    ours = (PROFILE,) if profile == NETWORK else ()
    chosen = ", ".join(f"{name}={environment[name]}" for name in CHOICES if environment.get(name) and name not in ours)
    return f"discovery: by the environment, {chosen}"
