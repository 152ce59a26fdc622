"""A node's settings as ROS parameters: declared, checked once, and unknown ones refused."""

import difflib
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeVar

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.node import Node

from zebrat_bullet.deploy.supervisor import MARGIN_M
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.files import is_file, read_text, shown

ROS_S_OWN = ("use_sim_time", "start_type_description_service")
_TOP_KEY = re.compile(r"""^["']?([^\s#"':{}\[\],-][^\s"':]*)["']?\s*:""", re.MULTILINE)
RELIABILITIES = ("best_effort", "reliable")
_Settings = TypeVar("_Settings")


def parameter(default: Any, description: str) -> Any:
    """Return a field of settings that is a ROS parameter."""
    return field(default=default, metadata={"description": description})


@dataclass(frozen=True, kw_only=True)
class DriveSettings:
    """The parameters of the node `zebrat_drive`; each field's description is what ROS is told of it."""

    policy: str = parameter("", "folder that zebrat export has written, or the name of a shipped policy")
    input: str = parameter("cloud", "what to listen to: cloud (PointCloud2) or scan (LaserScan)")
    cloud_topic: str = parameter("points", "PointCloud2 of the lidar")
    scan_topic: str = parameter("scan", "LaserScan of the lidar")
    odometry_topic: str = parameter("odom", "Odometry, for the supervisor; empty: none, it then reckons from commands")
    command_topic: str = parameter("cmd_vel", "where the commands go as TwistStamped (Twist where stamped is false)")
    ackermann_topic: str = parameter("ackermann_cmd", "where they go as AckermannDriveStamped, if its package is there")
    lidar_frame: str = parameter("lidar", "frame_id that scans must have; empty: any")
    lidar_yaw_rad: float = parameter(
        0.0, "how far the lidar is turned about the vertical against the car, left positive"
    )
    base_frame: str = parameter("base_link", "frame_id of the commands")
    reliability: str = parameter(
        "best_effort", "QoS of the subscriptions: best_effort hears every publisher, or reliable"
    )
    stamped: bool = parameter(True, "commands carry a header")
    trust_stamps: bool = parameter(True, "a scan's age is told by its stamp; false: as if measured on arrival")
    watchdog_s: float = parameter(0.4, "no scan for so long, or one so old: stop")
    supervised: bool = parameter(True, "the supervisor stops commands that lead into what the lidar sees")
    margin_m: float = parameter(MARGIN_M, "the supervisor's distance around the car")
    deceleration_mps2: float = parameter(0.0, "how hard the car brakes, for the supervisor; 0: as the policy's car")
    delay_s: float = parameter(0.0, "time until a command reaches the motors, for the supervisor")
    least_sector_points: int = parameter(1, "returns that each eighth of a cloud's turn must hold; 0: none")
    max_speed_mps: float = parameter(math.inf, "commands are cut off there; inf: the policy's own limit")
    max_steering_rad: float = parameter(math.inf, "the same for the steering")

    def __post_init__(self) -> None:
        if self.input not in ("cloud", "scan"):
            raise ConfigError(f"input must be cloud or scan, got {shown(self.input)!r}")
        if self.reliability not in RELIABILITIES:
            raise ConfigError(f"reliability must be {' or '.join(RELIABILITIES)}, got {shown(self.reliability)!r}")
        if not self.command_topic:
            raise ConfigError("command_topic must name a topic, got none")
        if not 0.05 <= self.watchdog_s <= 10.0:
            raise ConfigError(f"watchdog_s must be 0.05 to 10, got {self.watchdog_s}")
        if not 0.0 <= self.margin_m <= 10.0:
            raise ConfigError(f"margin_m must be 0 to 10, got {self.margin_m}")
        if not abs(self.lidar_yaw_rad) <= 2.0 * math.pi:
            raise ConfigError(
                f"lidar_yaw_rad must be -2 pi to 2 pi (-6.283 to 6.283), got {self.lidar_yaw_rad}; it is in radians: "
                "90 degrees are 1.5708"
            )
        if not 0.0 <= self.deceleration_mps2 <= 100.0:
            raise ConfigError(f"deceleration_mps2 must be 0 to 100, got {self.deceleration_mps2}")
        if not 0.0 <= self.delay_s <= 10.0:
            raise ConfigError(f"delay_s must be 0 to 10, got {self.delay_s}")
        for name in ("max_speed_mps", "max_steering_rad"):
            if not getattr(self, name) > 0.0:
                raise ConfigError(f"{name} must be above 0, got {getattr(self, name)}")

    @property
    def sensor_topic(self) -> str:
        """The topic that is listened to."""
        return self.cloud_topic if self.input == "cloud" else self.scan_topic


@dataclass(frozen=True, kw_only=True)
class SimSettings:
    """The parameters of the node `zebrat_sim`."""

    cloud_topic: str = parameter("points", "PointCloud2 of the lidar")
    scan_topic: str = parameter("scan", "LaserScan: the same, flattened")
    odometry_topic: str = parameter("odom", "Odometry, without error")
    command_topic: str = parameter("cmd_vel", "TwistStamped to obey (Twist where stamped is false)")
    ackermann_topic: str = parameter("ackermann_cmd", "AckermannDriveStamped to obey, if its package is there")
    lidar_frame: str = parameter("lidar", "frame_id of cloud and scan")
    base_frame: str = parameter("base_link", "child_frame_id of the odometry")
    odometry_frame: str = parameter("odom", "frame_id of the odometry: the world")
    reliability: str = parameter("best_effort", "QoS of cloud and scan: best_effort, as lidars are, or reliable")
    stamped: bool = parameter(True, "commands carry a header")
    timeout_s: float = parameter(0.4, "a command older than this: brake")

    def __post_init__(self) -> None:
        if self.reliability not in RELIABILITIES:
            raise ConfigError(f"reliability must be {' or '.join(RELIABILITIES)}, got {shown(self.reliability)!r}")
        if not 0.05 <= self.timeout_s <= 10.0:
            raise ConfigError(f"timeout_s must be 0.05 to 10, got {self.timeout_s}")


def make_node(name: str, arguments: Sequence[str] = ()) -> Node:
    """Return a node that has been given whatever parameters the command line and params files name for it.

    Args:
        name: of the node, unless the arguments say otherwise.
        arguments: what stands behind --ros-args.

    Raises:
        ConfigError: parameters are given, in a file or by -p, for other nodes alone; ROS passes over them in silence.
    """
    node = Node(name, automatically_declare_parameters_from_overrides=True)
    full = node.get_fully_qualified_name().strip("/")
    n_meant, others = 0, list[str]()

    def is_meant(key: str) -> bool:
        key = key.strip("/")
        return "*" in key or key == node.get_name() or f"{full}/".startswith(f"{key}/")

    for option, value in pairwise(arguments):
        if option in ("-p", "--param") and ":" in (key := value.partition(":=")[0]) and not is_meant(key.split(":")[0]):
            raise ConfigError(
                f"-p {shown(value)} is for another node, this one is {node.get_name()}; leave its name out"
            )
        if option == "--params-file" and is_file(value):
            keys = _TOP_KEY.findall(read_text(Path(value), ConfigError))
            n_meant += not keys or any(map(is_meant, keys))
            others += keys
    if others and not n_meant:
        raise ConfigError(
            f"the parameter files are of {', '.join(map(shown, others))} and none is of {node.get_name()}, so nothing "
            f"in them would count; begin one with {node.get_name()}:"
        )
    return node


def read_parameters(node: Node, kind: type[_Settings]) -> _Settings:
    """Return a node's parameters as settings, and declare every one, so that ROS's tools list and describe them.

    A whole number stands for a float too, which ROS alone would refuse.

    Args:
        node: of `make_node`.
        kind: the settings' dataclass.

    Raises:
        ConfigError: a parameter is unknown, of another type, or out of its range; ROS ignores unknown ones in silence.
    """
    given = {name: each.value for name, each in node.get_parameters_by_prefix("").items()}
    known = {each.name: each for each in fields(kind)}  # type: ignore[arg-type]
    for name in given:
        if name not in known and name not in ROS_S_OWN and not name.startswith("qos_overrides."):
            near = difflib.get_close_matches(name, known, 1)
            hint = f"; did you mean {near[0]}?" if near else f"; there are {', '.join(known)}"
            raise ConfigError(f"{node.get_name()} has no parameter {shown(name)!r}{hint}")
    values = {}
    for name, each in known.items():
        value = given.get(name, each.default)
        if type(each.default) is float and type(value) is int:
            value = float(value)
        if type(value) is not type(each.default):
            raise ConfigError(
                f"parameter {name} must be a {type(each.default).__name__}, got {shown(value)!r}, "
                f"a {type(value).__name__}"
            )
        if name in given:
            node.undeclare_parameter(name)
        descriptor = ParameterDescriptor(description=each.metadata["description"], read_only=True)
        node.declare_parameter(name, value, descriptor, ignore_override=True)
        values[name] = value
    return kind(**values)
