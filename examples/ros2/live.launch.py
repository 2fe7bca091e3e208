"""Start the node; each argument is a parameter, and ``points`` is the topic with the clouds."""

from __future__ import annotations

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

ARGUMENTS = {
    "method": ("seethrough", str, "see 'dynaviz list methods'"),
    "sensor": ("", str, "see 'dynaviz list sensors'; some methods need none"),
    "reach": ("60.0", float, "metres around the sensor within which points are judged"),
    "world": ("odom", str, "frame of the map; TF knows the pose of the sensor in it"),
    "deskew": ("true", bool, "use the times of points; false for clouds that are deskewed already"),
    "timeout": ("0.5", float, "seconds that a cloud waits for its transform"),
    "map_period": ("1.0", float, "seconds between two maps"),
}


def generate_launch_description() -> LaunchDescription:
    """The arguments and the node."""
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, (default, _, text) in ARGUMENTS.items()
    ]
    declared.append(
        DeclareLaunchArgument("points", default_value="points", description="topic with the clouds")
    )
    parameters = {
        name: ParameterValue(LaunchConfiguration(name), value_type=kind)
        for name, (_, kind, _) in ARGUMENTS.items()
    }
    node = Node(
        package="dynaviz",
        executable="live",
        name="dynaviz",
        output="screen",
        parameters=[parameters],
        remappings=[("points", LaunchConfiguration("points"))],
    )
    return LaunchDescription([*declared, node])
