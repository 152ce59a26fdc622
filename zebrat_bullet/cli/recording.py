"""The command that records, and the replay of a bag: record, replay --bag."""

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from zebrat_bullet.cli.common import AddCommand, Result, file_name, note, own_task_of, placed
from zebrat_bullet.cli.options import (
    noisy_options,
    place_options,
    randomise_option,
    reward_options,
    supervised_option,
    task_options,
    whole_number,
)
from zebrat_bullet.config import TaskConfig
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.files import shown
from zebrat_bullet.outputs import require_writable

if TYPE_CHECKING:
    from zebrat_bullet.recording.episode import WatchedEpisode
    from zebrat_bullet.recording.senses import Mount
    from zebrat_bullet.robot import RobotModel
    from zebrat_bullet.world import World

BAG_OPTIONS = (
    *("agent", "lidar_topic", "command_topic", "odometry_topic", "lidar_frame", "lidar_height", "lidar_rpy", "angular"),
    *("least_sector_points", "delay", "tolerance"),
)
"""Options of `replay` that go with --bag."""
_RECORDINGS = (".mcap", ".db3", ".bag")
_PACKAGES = ("mcap", "mcap_ros2", "rosbags", "lz4", "zstandard")


def record(arguments: argparse.Namespace) -> Result:
    """Write an episode as MCAP, for Foxglove and ROS 2: driven now, or one that is recorded already, driven again."""
    _check_packages()
    from zebrat_bullet.recording.write import check_mcap, write_recording

    arguments.set_task = [text for text in arguments.set if text.startswith("task.") and "=" in text]
    if len(arguments.set_task) != len(arguments.set):
        raise ConfigError(f"--set takes settings as task.KEY=VALUE, got {', '.join(arguments.set[:3])}")
    if arguments.out:
        check_mcap(arguments.out)
    if arguments.record and arguments.record.suffix.lower() in _RECORDINGS:
        raise ConfigError(
            f"{shown(arguments.record)} is a recording already; a record is an .npz that `zebrat evaluate` wrote "
            "(--bag of `zebrat replay` reads recordings)"
        )
    driven = (arguments.agent, arguments.world, arguments.episode)
    if arguments.record and driven != (None, None, None):
        raise ConfigError(f"{arguments.record} says itself who drove where; leave out --agent, --world and --episode")
    episode, world = _driven_again(arguments) if arguments.record else _driven(arguments)
    record = episode.record
    path = arguments.out
    n = write_recording(episode, world, path)
    megabytes = path.stat().st_size / 1e6
    result = {
        "recording": str(path),
        "outcome": record.outcome,
        "duration_s": record.duration_s,
        "messages": n,
        "megabytes": round(megabytes, 3),
    }
    return result, f"{record.outcome} after {record.duration_s:.1f} s: {path}, {n} messages, {megabytes:.1f} MB"


def _driven(arguments: argparse.Namespace) -> "tuple[WatchedEpisode, World]":
    from zebrat_bullet.agents import load_agent
    from zebrat_bullet.agents.supervised import supervised
    from zebrat_bullet.evaluation.judge import require_winnable_by
    from zebrat_bullet.recording.episode import watch_episode
    from zebrat_bullet.robot import load_robot
    from zebrat_bullet.world import load_world

    name = arguments.agent or "shipped"
    task = own_task_of(arguments, name)
    (reference,) = placed(arguments, [arguments.world or "big_track"])
    world = load_world(reference, robot=load_robot(task.robot))
    agent = load_agent(name, task, arguments.action_noise)
    require_winnable_by(agent, world)
    if arguments.supervised is not None:
        agent = supervised(agent, task, arguments.supervised)
    episode = arguments.episode or 0
    _place(arguments, agent.name, world, episode)
    return watch_episode(task, world, agent, arguments.seed, episode), world


def _driven_again(arguments: argparse.Namespace) -> "tuple[WatchedEpisode, World]":
    from zebrat_bullet.config_text import from_json
    from zebrat_bullet.evaluation.records import load_record
    from zebrat_bullet.recording.episode import watch_again
    from zebrat_bullet.robot import load_robot
    from zebrat_bullet.world import load_world

    record = load_record(arguments.record)
    task = from_json(TaskConfig, record.task)
    world = load_world(record.world, robot=load_robot(task.robot))
    _place(arguments, record.agent, world, record.episode)
    return watch_again(task, world, record), world


def _place(arguments: argparse.Namespace, agent: str, world: "World", episode: int) -> None:
    """Name the recording where --out does not, and try its place before the drive."""
    arguments.out = arguments.out or Path("results") / f"{file_name(agent)}-{world.name}-{episode}.mcap"
    require_writable(arguments.out)


def replay_bag(arguments: argparse.Namespace) -> Result:
    """Run a policy on a bag's lidar and say where its commands differ from the bag's."""
    _check_packages()
    from zebrat_bullet.agents import load_agent
    from zebrat_bullet.deploy.driver import Limits
    from zebrat_bullet.evaluation.own_task import as_trained
    from zebrat_bullet.recording.bag import Bag
    from zebrat_bullet.recording.differences import check_tolerance, summary, write_differences
    from zebrat_bullet.recording.open_loop import Reader, run_open_loop
    from zebrat_bullet.recording.topics import choose_topics
    from zebrat_bullet.robot import fitted, load_robot

    check_tolerance(arguments.tolerance)
    task, _ = as_trained(
        TaskConfig(robot=arguments.robot or TaskConfig().robot), arguments.agent, own_robot=arguments.robot is None
    )
    reader = Reader(
        mount=_mount(arguments, load_robot(fitted(task).robot)),
        delay_s=arguments.delay,
        twist_steers=arguments.angular == "steering",
        limits=Limits(least_sector_points=arguments.least_sector_points),
    )
    agent = load_agent(arguments.agent, task)
    with Bag(arguments.bag) as bag:
        topics = choose_topics(bag, arguments.lidar_topic, arguments.command_topic, arguments.odometry_topic)
        note(
            arguments,
            f"{topics.lidar} against {topics.command}; speed from {topics.odometry or 'the last command'}",
        )
        if arguments.out:
            require_writable(arguments.out)
        loop = run_open_loop(bag, topics, agent, task, reader)
    result = {
        "agent": arguments.agent,
        "lidar_topic": topics.lidar.name,
        "command_topic": topics.command.name,
        "odometry_topic": topics.odometry.name if topics.odometry else None,
        "tolerance": list(arguments.tolerance),
        **summary(loop, arguments.tolerance),
    }
    text = _told(result)
    if arguments.out:
        write_differences(loop, arguments.out, arguments.tolerance)
        result["table"] = str(arguments.out)
        text += f"\nevery scan: {arguments.out}"
    return result, text


def _mount(arguments: argparse.Namespace, robot: "RobotModel") -> "Mount":
    from zebrat_bullet.recording.senses import Mount

    given = arguments.lidar_rpy
    roll, pitch, yaw = map(float, robot.lidar_rpy) if given is None else map(math.radians, given)
    height = float(robot.lidar_xyz_base[2]) if arguments.lidar_height is None else arguments.lidar_height
    return Mount(height_m=height, rpy_rad=(roll, pitch, yaw), frame=arguments.lidar_frame.lstrip("/"))


def _told(result: dict[str, Any]) -> str:
    lines = [f"{result['agent']}: {result['within']} of {result['compared']} commands as recorded"]
    if not result["compared"]:
        lines = [f"{result['agent']}: nothing to compare: no command came in answer to one of {result['scans']} scans"]
    for name, worst in result["largest"].items():
        what, unit = ("speed", "m/s") if name.startswith("speed") else ("steering", "rad")
        lines.append(f"largest difference of {what}: {worst['value']:+.4g} {unit} at {worst['time_s']:.2f} s")
    for key, what in (
        ("unanswered", "scans that no command answers"),
        ("refused", "scans that the policy would have refused, and stopped"),
        ("unusable", "commands and odometries that could not be read"),
        ("early", "scans between two control steps, which a policy with a memory is not asked at"),
    ):
        if result[key]:
            lines.append(f"{result[key]} {what}")
    if "first_refusal" in result:
        lines.append(f"the first, at {result['first_refusal']['time_s']:.2f} s: {result['first_refusal']['reason']}")
    return "\n".join(lines)


def _check_packages() -> None:
    """Say what to install where the packages of recordings are missing."""
    from importlib import import_module

    for name in _PACKAGES:
        try:
            import_module(name)
        except ModuleNotFoundError as error:
            raise ConfigError(
                f"recordings need {error.name}, which is not installed: pip install 'zebrat-bullet[record]'"
            ) from error


def bag_options(made: argparse.ArgumentParser) -> None:
    """Add the options of `replay --bag`."""
    bag = made.add_argument_group("--bag")
    bag.add_argument("--bag", type=Path, help="instead: an .mcap, .db3 or .bag file, or the folder of a rosbag2")
    bag.add_argument("--agent", default="shipped", help="what is asked at each scan (default shipped)")
    bag.add_argument("--lidar-topic", default="", metavar="TOPIC", help="PointCloud2 or LaserScan (default: the only)")
    bag.add_argument("--command-topic", default="", metavar="TOPIC", help="Twist or AckermannDrive, stamped or not")
    bag.add_argument("--odometry-topic", default="", metavar="TOPIC", help="Odometry, for the speed; may be missing")
    bag.add_argument("--lidar-frame", default="", metavar="FRAME", help="frame_id that the lidar's messages have")
    bag.add_argument("--lidar-height", type=float, metavar="M", help="above the floor (default: as on the agent's car)")
    bag.add_argument(
        "--lidar-rpy",
        nargs=3,
        type=float,
        metavar=("ROLL", "PITCH", "YAW"),
        help="how the lidar's frame is turned on the car, in degrees (default: as on the agent's car)",
    )
    bag.add_argument(
        "--angular",
        choices=("yaw_rate", "steering"),
        default="yaw_rate",
        help="what a Twist's angular.z is (default yaw_rate, as ROS has it)",
    )
    bag.add_argument(
        "--least-sector-points",
        type=whole_number,
        default=1,
        metavar="N",
        help="returns that each eighth of a cloud's turn must hold, as on the car (default 1); 0: none",
    )
    bag.add_argument(
        "--delay", type=float, default=0.0, metavar="S", help="a scan's command comes at least so long after it"
    )
    bag.add_argument(
        "--tolerance",
        nargs=2,
        type=float,
        default=(0.05, 0.05),
        metavar=("MPS", "RAD"),
        help="commands nearer than this count as the same (default 0.05 0.05)",
    )


def add(command: AddCommand) -> None:
    """Add the command of this file."""
    made = command(
        record,
        *(task_options(), noisy_options(), randomise_option(), reward_options(), place_options(), supervised_option()),
    )
    made.set_defaults(robot=None)
    made.add_argument("record", nargs="?", type=Path, help="an .npz that `zebrat evaluate` wrote: drive it again")
    made.add_argument("--agent", help="who drives (default shipped)")
    made.add_argument("--set", nargs="+", action="extend", default=[], metavar="task.KEY=VALUE", help="as for evaluate")
    made.add_argument("--world", help="where (default big_track)")
    made.add_argument("--episode", type=whole_number, help="which episode of the seed (default 0)")
