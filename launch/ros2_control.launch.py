# SPDX-License-Identifier: Apache-2.0
"""One arm under ros2_control: description, controllers, watchdog, cell. Not tried; read docs/real_robot.md first.

``ros2 launch impact_rs ros2_control.launch.py description:=my_robot.urdf.xacro controllers:=my_controllers.yaml
parameters:=my_cell.yaml scenario:=my_push.yaml``, with copies of config/drivers/ros2_control_controllers.yaml and
ros2_control_cell.yaml. The description holds the ros2_control tag with the hardware of the robot. The joint trajectory
controller is active at first, to move the arm to the start; the effort controller is loaded and inactive.
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import Command, LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

STATES = "/joint_states"
COMMANDS = "/effort_controller/commands"


def generate_launch_description() -> LaunchDescription:
    """Return description, controller manager, controllers, watchdog and cell."""
    description = ParameterValue(Command(["xacro ", LaunchConfiguration("description")]), value_type=str)
    cell = PathJoinSubstitution([FindPackageShare("impact_rs"), "launch", "cell.launch.py"])
    return LaunchDescription(
        [
            DeclareLaunchArgument("description", description="URDF or xacro of the robot, with its ros2_control tag."),
            DeclareLaunchArgument("controllers", description="YAML of the controller manager and its controllers."),
            DeclareLaunchArgument("parameters", description="Parameter file of cell and watchdog."),
            DeclareLaunchArgument("scenario", description="Name or path of the scenario."),
            Node(
                package="robot_state_publisher",
                executable="robot_state_publisher",
                output="screen",
                parameters=[{"robot_description": description}],
            ),
            Node(
                package="controller_manager",
                executable="ros2_control_node",
                output="screen",
                parameters=[LaunchConfiguration("controllers")],
                remappings=[("~/robot_description", "/robot_description")],
            ),
            _spawner("joint_state_broadcaster"),
            _spawner("joint_trajectory_controller"),
            _spawner("effort_controller", "--inactive"),
            IncludeLaunchDescription(
                PythonLaunchDescriptionSource([cell]),
                launch_arguments={
                    "parameters": LaunchConfiguration("parameters"),
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
