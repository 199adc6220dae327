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
CHOICES = (
    RANGE,
    "ROS_STATIC_PEERS",
    "ROS_DISCOVERY_SERVER",
    "ROS_LOCALHOST_ONLY",
    PROFILE,
    "FASTDDS_DEFAULT_PROFILES_FILE",
    "FASTDDS_BUILTIN_TRANSPORTS",
    "CYCLONEDDS_URI",
)
"""Environment variables: if any is set, discovery and transport are the user's choice."""
LOCALHOST = "LOCALHOST"
LOOPBACK = "loopback.xml"  # profile of Fast DDS


def set_middleware(environment: MutableMapping[str, str]) -> None:
    """Restrict communication to this machine unless one of ``CHOICES`` is set; call before ``rclpy.init``.

    Fast DDS gets ``config/loopback.xml``: UDP on 127.0.0.1. The discovery range ``LOCALHOST`` would not do: it makes
    transports of its own, shared memory among them, whatever ``FASTDDS_BUILTIN_TRANSPORTS`` says, and opens ports to
    all networks. In shared memory a killed process leaves its segments behind, and a frozen one can hold a lock. Any
    other middleware gets ``LOCALHOST``.

    Args:
        environment: Environment of this process, or of one to start; an empty variable counts as unset.
    """
    if any(environment.get(name) for name in CHOICES):
        return
    fast = environment.get("RMW_IMPLEMENTATION", "rmw_fastrtps_cpp").startswith("rmw_fastrtps")
    profile = config_directory() / LOOPBACK
    if fast and profile.is_file():
        environment.update({RANGE: "SYSTEM_DEFAULT", PROFILE: str(profile)})  # the profile decides on the range
    else:
        environment[RANGE] = LOCALHOST


def discovery(environment: Mapping[str, str]) -> str:
    """Who finds the nodes of this environment, and how to change it; a line for the log.

    Args:
        environment: Environment after :func:`set_middleware`, or as ``./run`` prepared it.
    """
    profile = Path(environment.get(PROFILE, "")).name
    if profile == LOOPBACK or environment.get(RANGE) == LOCALHOST:
        return f"discovery: this machine only; for several machines set {RANGE}=SUBNET on all of them"
    chosen = ", ".join(f"{name}={environment[name]}" for name in CHOICES if environment.get(name))
    return f"discovery: by the environment, {chosen}"
