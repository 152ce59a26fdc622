"""`zebrat ros drive`: loads an exported policy and drives a car with it until it is told to end."""

import gc
import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from zebrat_bullet.deploy.definition import DEFINITION_FILE, MODEL_FILE
from zebrat_bullet.deploy.driver import Driver, Limits
from zebrat_bullet.deploy.supervisor import Supervisor
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.ros.runtime import ros

_ROUNDING = 1e-6
"""Limits a rounding apart are the same."""


def drive(policy: str, ros_arguments: Sequence[str]) -> dict[str, Any]:
    """Run the node until Ctrl-C or SIGTERM, and return what it did; its last command is a stop.

    Args:
        policy: an exported folder, or the name of a policy where the whole package is installed; empty: what the ROS
            parameter `policy` says.
        ros_arguments: what stands behind --ros-args.

    Raises:
        ConfigError: ROS does not start, or a parameter is wrong.
        PolicyError: the policy cannot be loaded.
    """
    with ros(ros_arguments):
        import rclpy

        from zebrat_bullet.ros.drive_node import DriveNode
        from zebrat_bullet.ros.parameters import DriveSettings, make_node, read_parameters

        node = make_node("zebrat_drive", ros_arguments)
        settings = read_parameters(node, DriveSettings)
        if not (policy := policy or settings.policy):
            raise ConfigError("no policy; give --policy FOLDER that zebrat export has written, or a shipped name")
        with _exported(policy) as folder:
            limits = Limits(stale_s=settings.watchdog_s, least_sector_points=settings.least_sector_points)
            driver = Driver.load(folder, limits=limits)
        definition, car, supervisor = driver.definition, driver.car, None
        if settings.watchdog_s <= definition.control_step_s:
            raise ConfigError(
                f"watchdog_s must be above the policy's control step of {definition.control_step_s} s, for no scan is "
                f"due before, got {settings.watchdog_s}"
            )
        for name in ("max_speed_mps", "max_steering_rad"):
            most, own = getattr(settings, name), getattr(car, name)
            if own * (1.0 + _ROUNDING) < most < math.inf:
                raise ConfigError(
                    f"{name} is {most:g}, above the policy's own limit of {own:g}, so it would limit nothing; it is in "
                    f"{'m/s' if name == 'max_speed_mps' else 'radians'}; give less, or leave it out"
                )
        if settings.supervised:
            braking = replace(car, deceleration_mps2=settings.deceleration_mps2 or car.deceleration_mps2)
            step_s, late_s = definition.control_step_s, settings.watchdog_s
            supervisor = Supervisor(braking, step_s, settings.margin_m, late_s, delay_s=settings.delay_s)
        running = DriveNode(node, settings, driver, supervisor)
        node.get_logger().info(
            f"policy {definition.name} for the car {car.name} listens to {running.listener.topic} "
            f"({settings.input}, {settings.reliability}) and drives {running.command_topic} at up to "
            f"{min(settings.max_speed_mps, car.max_speed_mps):g} m/s and "
            f"{min(settings.max_steering_rad, car.max_steering_rad):g} rad, "
            f"{f'supervised at {settings.margin_m:g} m' if supervisor else 'NOT supervised'}"
        )
        gc.freeze()  # what is loaded stays; to look through it again would make commands late
        try:
            rclpy.spin(node)
        except KeyboardInterrupt:
            pass  # the usual way to end
        finally:
            made = running.end()
        return {"policy": definition.name, **made}


@contextmanager
def _exported(policy: str) -> Iterator[Path]:
    """Yield the folder of an exported policy; a shipped one, or one from training, is exported first."""
    if Path(policy).name in (MODEL_FILE, DEFINITION_FILE) and Path(policy).is_file():
        raise ConfigError(f"{policy} is a file of an exported policy; name its folder, {Path(policy).parent}")
    if (Path(policy) / DEFINITION_FILE).is_file() or ("/" in policy and not Path(policy).exists()):
        yield Path(policy)
        return
    try:
        from zebrat_bullet.agents.export import export_policy
    except ModuleNotFoundError as error:
        raise ConfigError(
            f"{policy!r} is no folder that zebrat export has written, and to export it here {error.name} is missing: "
            "export it where the whole package is installed, and copy the folder"
        ) from error
    with TemporaryDirectory(prefix="zebrat-policy-") as folder:
        export_policy(policy, Path(folder))
        yield Path(folder)
