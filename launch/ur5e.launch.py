# SPDX-License-Identifier: Apache-2.0
"""One UR5e with ur_robot_driver; on request watchdog and cell. Not tried on a robot; read docs/real_robot.md first.

``ros2 launch impact_rs ur5e.launch.py robot_ip:=192.168.56.101`` starts the driver with its own controllers at 500 Hz:
the scaled joint trajectory controller is active, the effort controller loaded and inactive. ``cell:=true`` starts
watchdog and cell as well; ``states`` is then a topic with joint torques of the link side, which the driver has not.
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.conditions import IfCondition
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.substitutions import FindPackageShare

STATES = "/joint_states"
COMMANDS = "/forward_effort_controller/commands"


def generate_launch_description() -> LaunchDescription:
    """Return the driver with its controllers, and watchdog and cell where they are asked for."""
    share = FindPackageShare("impact_rs")
    driver = PathJoinSubstitution([FindPackageShare("ur_robot_driver"), "launch", "ur_control.launch.py"])
    return LaunchDescription(
        [
            DeclareLaunchArgument("robot_ip", description="Address of the robot's controller."),
            DeclareLaunchArgument("scenario", default_value="push_ur5e", description="Name or path of the scenario."),
            DeclareLaunchArgument(
                "cell", default_value="false", choices=["true", "false"], description="Start the cell."
            ),
            DeclareLaunchArgument("states", default_value=STATES, description="Topic of states with joint torques."),
            IncludeLaunchDescription(
                PythonLaunchDescriptionSource([driver]),
                launch_arguments={
                    "ur_type": "ur5e",
                    "robot_ip": LaunchConfiguration("robot_ip"),
                    "launch_rviz": "false",
                }.items(),
            ),
            IncludeLaunchDescription(
                PythonLaunchDescriptionSource([PathJoinSubstitution([share, "launch", "cell.launch.py"])]),
                launch_arguments={
                    "parameters": PathJoinSubstitution([share, "config", "drivers", "ur5e_cell.yaml"]),
                    "scenario": LaunchConfiguration("scenario"),
                    "states": LaunchConfiguration("states"),
                    "commands": COMMANDS,
                }.items(),
                condition=IfCondition(LaunchConfiguration("cell")),
            ),
        ]
    )
