# SPDX-License-Identifier: Apache-2.0
"""Starts the five nodes: ``ros2 launch impact_rs impact_rs.launch.py scenario:=push``."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

NODES = ("plant", "impact_map", "controller", "recorder", "experiment")


def generate_launch_description() -> LaunchDescription:
    """Return the five nodes, all with the same parameter file and scenario."""
    return LaunchDescription(
        [
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
                    parameters=[
                        LaunchConfiguration("params_file"),
                        {"scenario": LaunchConfiguration("scenario")},
                    ],
                )
                for node in NODES
            ),
        ]
    )
