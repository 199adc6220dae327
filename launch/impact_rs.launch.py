# SPDX-License-Identifier: Apache-2.0
"""Starts the five nodes: ``ros2 launch impact_rs impact_rs.launch.py scenario:=push namespace:=cell_a``.

``without:=plant`` does not start a node that you provide yourself; ``without:="plant controller"`` names several.
A node that dies is started again, at most ``RESPAWNS`` times; one that refuses its parameters (exit code 2) is not.
Where robot_state_publisher is installed it publishes the links of every arm from /ARM/joint_states, and the plant does
not. Each node configures discovery from the environment, as everywhere in impact_rs.
"""

from pathlib import Path

from ament_index_python.packages import get_packages_with_prefixes
from launch import LaunchContext, LaunchDescription, LaunchDescriptionEntity
from launch.actions import DeclareLaunchArgument, EmitEvent, LogInfo, OpaqueFunction, RegisterEventHandler
from launch.event_handlers import OnProcessExit
from launch.events import matches_action
from launch.events.process import ProcessExited, ShutdownProcess
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

from impact_rs_ros.names import frame_prefix, full_namespace, within
from impact_rs_ros.node_processes import NODES, REFUSED_EXIT_CODE
from impact_rs_sim.physics import Physics
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.record import descriptions

LEVELS = ["debug", "info", "warn", "error", "fatal"]
RESPAWNS = 5  # of each node
VIEWED = ("/robot_description", "/object/robot_description", "/object/pose", "/clock")  # topics of impact_rs.rviz


def generate_launch_description() -> LaunchDescription:
    """Return the nodes to start, all with the same parameter file and scenario."""
    share = FindPackageShare("impact_rs")
    return LaunchDescription(
        [
            DeclareLaunchArgument("scenario", default_value="push", description="Name or path of the scenario."),
            DeclareLaunchArgument("namespace", default_value="", description="Namespace of the nodes."),
            DeclareLaunchArgument(
                "without", default_value="", description="Nodes that are not started: names separated by spaces."
            ),
            DeclareLaunchArgument(
                "params_file",
                default_value=PathJoinSubstitution([share, "config", "nodes.yaml"]),
                description="YAML file with the parameters of the nodes; must exist.",
            ),
            DeclareLaunchArgument(
                "use_sim_time",
                default_value="false",
                choices=["true", "false"],
                description="The nodes take their time from /clock, except the plant, which publishes it.",
            ),
            DeclareLaunchArgument(
                "log_level", default_value="info", choices=LEVELS, description="Least severity that the nodes log."
            ),
            DeclareLaunchArgument(
                "respawn",
                default_value="true",
                choices=["true", "false"],
                description=f"Start a node that died again, {RESPAWNS} times at most.",
            ),
            DeclareLaunchArgument(
                "rviz",
                default_value="false",
                choices=["true", "false"],
                description="Open RViz with config/viewers/impact_rs.rviz; needs the package rviz2.",
            ),
            OpaqueFunction(function=wanted_nodes),
        ]
    )


def wanted_nodes(context: LaunchContext) -> list[LaunchDescriptionEntity]:
    """Return the nodes that ``without`` does not name, and RViz if ``rviz`` is true.

    Raises:
        RuntimeError: ``without`` names an unknown node, or there is no such parameter file; ``ros2 launch`` prints the
            message and starts nothing.
    """
    without = LaunchConfiguration("without").perform(context).split()
    for name in without:
        if name not in NODES:
            raise RuntimeError(f"without: no node {name!r}; expected one or more of {', '.join(NODES)}")
    file = LaunchConfiguration("params_file").perform(context)
    if not Path(file).is_file():
        raise RuntimeError(f"params_file: there is no file {file!r}; expected a YAML file of node parameters")
    sim_time = LaunchConfiguration("use_sim_time").perform(context) == "true"
    publishers = state_publishers(context, sim_time) if "robot_state_publisher" in get_packages_with_prefixes() else []
    started: list[LaunchDescriptionEntity] = [*publishers]
    for name in NODES:
        if name not in without:
            node = Node(
                package="impact_rs",
                executable=name,
                name=name,
                namespace=LaunchConfiguration("namespace"),
                output="screen",
                respawn=LaunchConfiguration("respawn"),
                respawn_delay=1.0,
                respawn_max_retries=RESPAWNS,
                parameters=[
                    file,
                    {
                        "scenario": LaunchConfiguration("scenario"),
                        "use_sim_time": sim_time and name != "plant",
                    }
                    | ({"link_transforms": not publishers} if name == "plant" else {}),
                ],
                remappings=[("/clock", "clock")],  # of its own namespace
                ros_arguments=["--log-level", LaunchConfiguration("log_level")],
            )
            started += [node, RegisterEventHandler(OnProcessExit(target_action=node, on_exit=stay_down_if_refused))]
    if LaunchConfiguration("rviz").perform(context) == "true":
        started.append(viewer())
    return started


def stay_down_if_refused(event: ProcessExited, context: LaunchContext) -> list[LaunchDescriptionEntity] | None:
    """Prevent the restart of a node that refused its parameters."""
    del context
    if event.returncode != REFUSED_EXIT_CODE:
        return None
    text = f"{event.process_name}: its parameters were refused (see above), so it is not started again"
    return [LogInfo(msg=text), EmitEvent(event=ShutdownProcess(process_matcher=matches_action(event.action)))]


def state_publishers(context: LaunchContext, sim_time: bool) -> list[Node]:
    """Return a robot_state_publisher for every arm, beside its joint states."""
    scenario = load_scenario(LaunchConfiguration("scenario").perform(context))
    namespace = full_namespace(LaunchConfiguration("namespace").perform(context))
    urdfs = descriptions(Physics.nominal(scenario, next(iter(scenario.objects))))
    return [
        Node(
            package="robot_state_publisher",
            executable="robot_state_publisher",
            namespace=within(namespace, arm),
            output="screen",
            parameters=[
                {
                    "robot_description": ParameterValue(urdfs[topics.robot_description(arm)], value_type=str),
                    "frame_prefix": frame_prefix(namespace),
                    "publish_frequency": 50.0,
                    "use_sim_time": sim_time,
                }
            ],
            remappings=[("/clock", within(namespace, "clock")), ("robot_description", "~/robot_description")],
        )
        for arm in scenario.robots
    ]


def viewer() -> Node:
    """Return RViz with the topics of this namespace, on the time of ``/clock``, because stamps are trial time."""
    layout = PathJoinSubstitution([FindPackageShare("impact_rs"), "config", "viewers", "impact_rs.rviz"])
    return Node(
        package="rviz2",
        executable="rviz2",
        namespace=LaunchConfiguration("namespace"),
        arguments=["-d", layout],
        parameters=[{"use_sim_time": True}],
        remappings=[(topic, topic.removeprefix("/")) for topic in VIEWED],
    )
