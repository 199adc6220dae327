# SPDX-License-Identifier: Apache-2.0
"""How nodes find each other: on this machine alone, unless the user's environment says anything about it.

One rule for every node and command of impact_rs, however it is started: ``ros2 run``, ``ros2 launch``,
``impact-rs up``, ``./run``.
"""

from __future__ import annotations

from collections.abc import MutableMapping

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
"""Environment variables of which any leaves discovery and transport to the user."""
LOCALHOST = "LOCALHOST"


def set_middleware(environment: MutableMapping[str, str]) -> None:
    """Keep to this machine where the environment has none of ``CHOICES``; before ``rclpy.init``.

    With Fast DDS that is UDP on 127.0.0.1, by ``config/loopback.xml``. With the discovery range ``LOCALHOST`` the
    middleware layer of Fast DDS makes transports of its own, shared memory among them, whatever
    ``FASTDDS_BUILTIN_TRANSPORTS`` says, and opens its ports to all networks; in shared memory a process that is killed
    leaves its segments behind, and one that is frozen can hold a lock. Any other middleware gets ``LOCALHOST``.

    Args:
        environment: Of this process, or of one that is started; an empty variable counts as none.
    """
    if any(environment.get(name) for name in CHOICES):
        return
    fast = environment.get("RMW_IMPLEMENTATION", "rmw_fastrtps_cpp").startswith("rmw_fastrtps")
    profile = config_directory() / "loopback.xml"
    if fast and profile.is_file():
        environment.update({RANGE: "SYSTEM_DEFAULT", PROFILE: str(profile)})  # the profile decides on the range
    else:
        environment[RANGE] = LOCALHOST
