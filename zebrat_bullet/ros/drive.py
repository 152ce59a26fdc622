"""`zebrat ros drive`: loads an exported policy and drives a car with it until it is told to end."""

import gc
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from zebrat_bullet.deploy.definition import DEFINITION_FILE
from zebrat_bullet.deploy.driver import Driver, Limits
from zebrat_bullet.deploy.supervisor import Supervisor
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.ros.runtime import ros


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

        node = make_node("zebrat_drive")
        settings = read_parameters(node, DriveSettings)
        if not (policy := policy or settings.policy):
            raise ConfigError("no policy; give --policy FOLDER that zebrat export has written, or a shipped name")
        with _exported(policy) as folder:
            driver = Driver.load(folder, limits=Limits(stale_s=settings.watchdog_s))
        definition, supervisor = driver.definition, None
        if settings.watchdog_s <= definition.control_step_s:
            raise ConfigError(
                f"watchdog_s must be above the policy's control step of {definition.control_step_s} s, for no scan is "
                f"due before, got {settings.watchdog_s}"
            )
        if settings.supervised:
            late_s = settings.watchdog_s
            supervisor = Supervisor(driver.car, definition.control_step_s, settings.margin_m, late_s)
        running = DriveNode(node, settings, driver, supervisor)
        node.get_logger().info(
            f"policy {definition.name} for the car {driver.car.name} listens to {running.listener.topic} "
            f"({settings.input}, {settings.reliability}) and drives {running.command_topic}, "
            f"{'supervised' if supervisor else 'NOT supervised'}"
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
