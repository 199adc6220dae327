# SPDX-License-Identifier: Apache-2.0
"""The cell and its watchdog, beside a driver that runs already or that another launch file starts.

``ros2 launch impact_rs cell.launch.py parameters:=my_cell.yaml scenario:=my_push.yaml``. Read docs/real_robot.md first.
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node


def generate_launch_description() -> LaunchDescription:
    """Return watchdog and cell, with the same scenario and topics."""
    remappings = [
        ("joint_states", LaunchConfiguration("states")),
        ("arm/effort_controller/commands", LaunchConfiguration("commands")),
    ]
    parameters = [LaunchConfiguration("parameters"), {"scenario": LaunchConfiguration("scenario")}]
    return LaunchDescription(
        [
            DeclareLaunchArgument("parameters", description="Parameter file of cell and watchdog."),
            DeclareLaunchArgument("scenario", description="Name or path of a scenario whose one arm is called arm."),
            DeclareLaunchArgument("states", default_value="/joint_states", description="Topic of the joint states."),
            DeclareLaunchArgument(
                "commands", default_value="/effort_controller/commands", description="Topic of the torques."
            ),
            *(
                Node(
                    package="impact_rs",
                    executable=name,
                    name=name,
                    output="screen",
                    parameters=parameters,
                    remappings=remappings,
                )
                for name in ("watchdog", "cell")
            ),
        ]
    )
