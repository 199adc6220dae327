# SPDX-License-Identifier: Apache-2.0
"""One FR3 with franka_ros2: driver, controllers, watchdog, cell. Not tried on a robot; read docs/real_robot.md first.

``ros2 launch impact_rs fr3.launch.py robot_ip:=172.16.0.2 scenario:=push_fr3``. The joint trajectory controller is
active at first, to move the arm to the start; the effort controller, which the cell commands, is loaded and inactive.
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

STATES = "/franka/joint_states"
COMMANDS = "/effort_controller/commands"


def generate_launch_description() -> LaunchDescription:
    """Return driver, controllers, watchdog and cell."""
    share = FindPackageShare("impact_rs")
    driver = PathJoinSubstitution([FindPackageShare("franka_bringup"), "launch", "franka.launch.py"])
    controllers = PathJoinSubstitution([share, "config", "drivers", "fr3_controllers.yaml"])
    return LaunchDescription(
        [
            DeclareLaunchArgument("robot_ip", description="Address of the robot's controller."),
            DeclareLaunchArgument("scenario", default_value="push_fr3", description="Name or path of the scenario."),
            IncludeLaunchDescription(
                PythonLaunchDescriptionSource([driver]),
                launch_arguments={
                    "robot_type": "fr3",
                    "robot_ip": LaunchConfiguration("robot_ip"),
                    "load_gripper": "false",
                    "controllers_yaml": controllers,
                }.items(),
            ),
            _spawner("joint_trajectory_controller"),
            _spawner("effort_controller", "--inactive"),
            IncludeLaunchDescription(
                PythonLaunchDescriptionSource([PathJoinSubstitution([share, "launch", "cell.launch.py"])]),
                launch_arguments={
                    "parameters": PathJoinSubstitution([share, "config", "drivers", "fr3_cell.yaml"]),
                    "scenario": LaunchConfiguration("scenario"),
                    "states": STATES,
                    "commands": COMMANDS,
                }.items(),
            ),
        ]
    )


def _spawner(*arguments: str) -> Node:
    """Loads a controller."""
    return Node(package="controller_manager", executable="spawner", arguments=list(arguments), output="screen")
