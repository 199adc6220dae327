# SPDX-License-Identifier: Apache-2.0
"""Starts the five nodes: ``ros2 launch impact_rs impact_rs.launch.py scenario:=push namespace:=cell_a``.

``without:=plant`` leaves one out, or several (``without:="plant controller"``), because you provide it yourself.
One that dies is started again.
"""

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction, SetEnvironmentVariable
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

NODES = ("plant", "impact_map", "controller", "recorder", "experiment")


def generate_launch_description() -> LaunchDescription:
    """Return the five nodes, or those that are wanted of them, all with the same parameter file and scenario."""
    return LaunchDescription(
        [
            OpaqueFunction(function=over_the_loopback),
            DeclareLaunchArgument("scenario", default_value="push", description="Name or path of the scenario."),
            DeclareLaunchArgument("namespace", default_value="", description="Namespace of the nodes."),
            DeclareLaunchArgument(
                "without", default_value="", description="Nodes that are not started: names with a space in between."
            ),
            DeclareLaunchArgument(
                "params_file",
                default_value=PathJoinSubstitution([FindPackageShare("impact_rs"), "config", "nodes.yaml"]),
                description="Parameters of the nodes.",
            ),
            OpaqueFunction(function=wanted_nodes),
        ]
    )


def over_the_loopback(context: LaunchContext) -> list[SetEnvironmentVariable]:
    """Return how the nodes talk, as ``impact_rs_ros.middleware`` says; ``ros2 launch`` may not be able to import it."""
    chosen = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE", "FASTDDS_BUILTIN_TRANSPORTS")
    within = context.environment.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST") == "LOCALHOST"
    fast = context.environment.get("RMW_IMPLEMENTATION", "rmw_fastrtps_cpp").startswith("rmw_fastrtps")
    if not within or not fast or any(name in context.environment for name in chosen):
        return []
    profile = PathJoinSubstitution([FindPackageShare("impact_rs"), "config", "loopback.xml"])
    return [
        SetEnvironmentVariable("ROS_AUTOMATIC_DISCOVERY_RANGE", "SYSTEM_DEFAULT"),
        SetEnvironmentVariable("FASTRTPS_DEFAULT_PROFILES_FILE", profile),
    ]


def wanted_nodes(context: LaunchContext) -> list[Node]:
    """Return the nodes that ``without`` does not name.

    Raises:
        RuntimeError: It names one that there is not; ``ros2 launch`` tells it and starts nothing.
    """
    without = LaunchConfiguration("without").perform(context).split()
    for name in without:
        if name not in NODES:
            raise RuntimeError(f"without: no node {name!r}; expected one or more of {', '.join(NODES)}")
    return [
        Node(
            package="impact_rs",
            executable=node,
            name=node,
            namespace=LaunchConfiguration("namespace"),
            output="screen",
            respawn=True,
            respawn_delay=1.0,
            parameters=[LaunchConfiguration("params_file"), {"scenario": LaunchConfiguration("scenario")}],
        )
        for node in NODES
        if node not in without
    ]
