"""Record the graphs of a running system: ``ros2 launch oracle_graph_recorder ...``."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node


def generate_launch_description() -> LaunchDescription:
    """Return the recorder, with its folder and its clock as arguments."""
    return LaunchDescription(
        [
            DeclareLaunchArgument("folder", default_value="graphs"),
            DeclareLaunchArgument("use_sim_time", default_value="false"),
            Node(
                package="oracle_graph_recorder",
                executable="recorder",
                output="screen",
                parameters=[
                    {
                        "folder": LaunchConfiguration("folder"),
                        "use_sim_time": LaunchConfiguration("use_sim_time"),
                    }
                ],
            ),
        ]
    )
