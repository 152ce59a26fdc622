"""`zebrat ros sim`: one episode of our PyBullet car, driven by whoever publishes commands."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from zebrat_bullet.config import TaskConfig
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.robot import load_robot
from zebrat_bullet.ros.runtime import ros
from zebrat_bullet.task.drive import Drive
from zebrat_bullet.world import load_world, require_winnable


def simulate(
    world: str,
    task: TaskConfig,
    ros_arguments: Sequence[str] = (),
    *,
    seed: int = 0,
    episode: int = 0,
    rate: float = 1.0,
    lockstep_s: float | None = None,
    wait_s: float = 60.0,
) -> dict[str, Any]:
    """Drive one episode, the same as `zebrat evaluate`'s of that seed and number, and return how it ended.

    Args:
        world: a world's name or file.
        task: what is driven.
        ros_arguments: what stands behind --ros-args.
        seed, episode: which episode: start pose and noise.
        rate, lockstep_s: see `SimNode`.
        wait_s: for the first command.

    Raises:
        ConfigError: ROS does not start, a parameter is wrong, or no command came.
        AssetError, WorldError: there is no such world, or it cannot be driven.
    """
    if not 0.01 <= rate <= 100.0:
        raise ConfigError(f"--rate must be 0.01 to 100, got {rate}")
    if not (lockstep_s is None or 0.01 <= lockstep_s <= 600.0):
        raise ConfigError(f"--lockstep must be 0.01 to 600 s, got {lockstep_s}")
    if not 0.1 <= wait_s <= 86_400.0:
        raise ConfigError(f"--wait must be 0.1 to 86400 s, got {wait_s}")
    place = load_world(world, robot=load_robot(task.robot))
    require_winnable(place)
    with ros(ros_arguments):
        from zebrat_bullet.ros.parameters import SimSettings, make_node, read_parameters
        from zebrat_bullet.ros.sim_node import SimNode

        node = make_node("zebrat_sim", ros_arguments)
        settings = read_parameters(node, SimSettings)
        if rate != 1.0 or lockstep_s is not None:
            option = "--lockstep" if lockstep_s is not None else f"--rate {rate:g}"
            node.get_logger().info(
                f"with {option} simulated time is not this computer's: "
                "the driver needs --ros-args -p use_sim_time:=true"
            )
        drive = Drive(task, place)
        try:
            reading = drive.reset(np.random.default_rng([seed, episode]), whole_scans=True)
            return SimNode(node, settings, drive, rate, lockstep_s).run(reading, wait_s)
        finally:
            drive.close()
