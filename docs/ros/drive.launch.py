"""ros2 launch drive.launch.py zebrat:=/opt/zebrat/venv/bin/zebrat policy:=/opt/zebrat/policy params:=drive.yaml

Starts `zebrat ros drive`, which has a Python 3.11 of its own, from a shell that knows another ROS 2.
"""

import os

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, EmitEvent, ExecuteProcess, RegisterEventHandler
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.substitutions import LaunchConfiguration

FOREIGN = ("PYTHONPATH", "LD_LIBRARY_PATH", "AMENT_PREFIX_PATH", "_ROS_WHEELS_BOOTSTRAP_COMPLETE")
"""What a shell with another ROS 2 tells Python of libraries; ROS_DOMAIN_ID and the like go through."""


def generate_launch_description() -> LaunchDescription:
    here = os.path.dirname(os.path.abspath(__file__))
    drive = ExecuteProcess(
        cmd=[
            LaunchConfiguration("zebrat"),
            *("ros", "drive", "--policy", LaunchConfiguration("policy")),
            *("--ros-args", "--params-file", LaunchConfiguration("params")),
        ],
        env={name: value for name, value in os.environ.items() if name not in FOREIGN},
        output="screen",
    )
    return LaunchDescription(
        [
            DeclareLaunchArgument("zebrat", default_value="zebrat", description="the command, in its own environment"),
            DeclareLaunchArgument("policy", default_value="", description="folder that zebrat export has written"),
            DeclareLaunchArgument("params", default_value=os.path.join(here, "drive.yaml"), description="parameters"),
            drive,
            # Without its driver a car should not wait for anything.
            RegisterEventHandler(OnProcessExit(target_action=drive, on_exit=[EmitEvent(event=Shutdown())])),
        ]
    )
