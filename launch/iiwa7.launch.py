# SPDX-License-Identifier: Apache-2.0
"""One LBR iiwa 7 with lbr_fri_ros2_stack; on request watchdog and cell. Not tried; read docs/real_robot.md first.

``ros2 launch impact_rs iiwa7.launch.py`` moves by position, with the joint trajectory controller;
``command_mode:=torque cell:=true`` starts watchdog and cell with the effort controller, for a driver with a torque-only
mode. Start LBRServer on the smartPAD with the same command mode and a send period of 1 ms.
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.conditions import IfCondition
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

ROBOT = "lbr"  # namespace of the driver and prefix of its joints
STATES = f"/{ROBOT}/joint_states"
COMMANDS = f"/{ROBOT}/effort_controller/commands"


def generate_launch_description() -> LaunchDescription:
    """Return driver and controllers, and watchdog and cell where they are asked for."""
    share = FindPackageShare("impact_rs")
    driver = PathJoinSubstitution([FindPackageShare("lbr_bringup"), "launch", "hardware.launch.py"])
    return LaunchDescription(
        [
            DeclareLaunchArgument("scenario", default_value="push_iiwa7", description="Name or path of the scenario."),
            DeclareLaunchArgument(
                "command_mode",
                default_value="position",
                choices=["position", "torque"],
                description="Client command mode of FRI.",
            ),
            DeclareLaunchArgument(
                "cell", default_value="false", choices=["true", "false"], description="Start the cell."
            ),
            IncludeLaunchDescription(
                PythonLaunchDescriptionSource([driver]),
                launch_arguments={
                    "model": "iiwa7",
                    "robot_name": ROBOT,
                    "sys_cfg_pkg": "impact_rs",
                    "sys_cfg": ["config/drivers/iiwa7_", LaunchConfiguration("command_mode"), ".yaml"],
                    "ctrl_cfg_pkg": "impact_rs",
                    "ctrl_cfg": "config/drivers/iiwa7_controllers.yaml",
                    "ctrl": "joint_trajectory_controller",
                }.items(),
            ),
            Node(
                package="controller_manager",
                executable="spawner",
                namespace=ROBOT,
                arguments=["effort_controller", "--inactive", "--controller-manager", "controller_manager"],
                output="screen",
            ),
            IncludeLaunchDescription(
                PythonLaunchDescriptionSource([PathJoinSubstitution([share, "launch", "cell.launch.py"])]),
                launch_arguments={
                    "parameters": PathJoinSubstitution([share, "config", "drivers", "iiwa7_cell.yaml"]),
                    "scenario": LaunchConfiguration("scenario"),
                    "states": STATES,
                    "commands": COMMANDS,
                }.items(),
                condition=IfCondition(LaunchConfiguration("cell")),
            ),
        ]
    )
