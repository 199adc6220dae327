"""Starts the five nodes: ``ros2 launch impact_rs impact_rs.launch.py scenario:=push``.

One that dies is started again.
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, SetEnvironmentVariable
from launch.substitutions import EnvironmentVariable, LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

NODES = ("plant", "impact_map", "controller", "recorder", "experiment")


def generate_launch_description() -> LaunchDescription:
    """Return the five nodes, all with the same parameter file and scenario."""
    return LaunchDescription(
        [
            # The shared memory of Fast DDS stalls nodes when one of them is killed.
            SetEnvironmentVariable(
                "FASTDDS_BUILTIN_TRANSPORTS", EnvironmentVariable("FASTDDS_BUILTIN_TRANSPORTS", default_value="UDPv4")
            ),
            DeclareLaunchArgument("scenario", default_value="push", description="Name or path of the scenario."),
            DeclareLaunchArgument(
                "params_file",
                default_value=PathJoinSubstitution([FindPackageShare("impact_rs"), "config", "nodes.yaml"]),
                description="Parameters of the nodes.",
            ),
            *(
                Node(
                    package="impact_rs",
                    executable=node,
                    name=node,
                    output="screen",
                    respawn=True,
                    respawn_delay=1.0,
                    parameters=[
                        LaunchConfiguration("params_file"),
                        {"scenario": LaunchConfiguration("scenario")},
                    ],
                )
                for node in NODES
            ),
        ]
    )
