# SPDX-License-Identifier: Apache-2.0
"""The rclpy nodes, one per file, and the runner that ties them."""

import os
import signal
import sys
import threading
from pathlib import Path

_INDEX_ENTRY = Path("share/ament_index/resource_index/packages/impact_rs")


def _announce_environment() -> None:
    """Let ROS tools and child processes find the packages of a pip environment.

    A colcon or apt installation does this in its ``setup.bash``; a pip environment has none.
    """
    prefixes = [p for p in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if p]
    if (Path(sys.prefix) / _INDEX_ENTRY).exists() and sys.prefix not in prefixes:
        os.environ["AMENT_PREFIX_PATH"] = os.pathsep.join([*prefixes, sys.prefix])


def _end_on_interrupt() -> None:
    """Let Ctrl-C end a node without a traceback while it imports; later it handles the signal itself."""
    started = Path(sys.argv[0])
    wrapper = started.parts[-3:-1] == ("lib", "impact_rs")  # as `ros2 run` does
    module = any(word.startswith("impact_rs_ros.") and word.endswith("_node") for word in sys.orig_argv[:4])
    if (wrapper or module) and threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.SIG_DFL)


_announce_environment()
_end_on_interrupt()
