# SPDX-License-Identifier: Apache-2.0
"""How the processes of one graph talk: over the loopback of this machine, unless the environment says otherwise."""

from __future__ import annotations

from collections.abc import MutableMapping

from impact_rs_sim.paths import config_directory

RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
PROFILE = "FASTRTPS_DEFAULT_PROFILES_FILE"
CHOSEN = (PROFILE, "FASTDDS_DEFAULT_PROFILES_FILE", "FASTDDS_BUILTIN_TRANSPORTS")  # who set one of them has chosen
LOCALHOST = "LOCALHOST"


def set_middleware(environment: MutableMapping[str, str]) -> None:
    """How the nodes and who calls them talk, where the environment does not say it.

    Within this machine: by UDP on 127.0.0.1. With the discovery range ``LOCALHOST`` the middleware layer of Fast DDS
    makes transports of its own, shared memory among them, whatever ``FASTDDS_BUILTIN_TRANSPORTS`` says, and opens its
    ports to all networks; in shared memory a process that is killed leaves its segments behind, and one that is frozen
    can hold a lock. ``config/loopback.xml`` has neither.
    """
    fast = environment.get("RMW_IMPLEMENTATION", "rmw_fastrtps_cpp").startswith("rmw_fastrtps")
    free = environment.setdefault(RANGE, LOCALHOST) == LOCALHOST and not any(key in environment for key in CHOSEN)
    profile = config_directory() / "loopback.xml"
    if fast and free and profile.is_file():
        environment.update({RANGE: "SYSTEM_DEFAULT", PROFILE: str(profile)})  # the profile decides on the range
