"""The rclpy nodes, one per file, and the runner that ties them."""

import os
import sys
from pathlib import Path

_INDEX_ENTRY = Path("share/ament_index/resource_index/packages/impact_rs")


def _announce_environment() -> None:
    """Let ROS tools and child processes find the packages of a pip environment.

    A colcon or apt installation does this in its ``setup.bash``; a pip environment has none.
    """
    prefixes = [p for p in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if p]
    if (Path(sys.prefix) / _INDEX_ENTRY).exists() and sys.prefix not in prefixes:
        os.environ["AMENT_PREFIX_PATH"] = os.pathsep.join([*prefixes, sys.prefix])


_announce_environment()
