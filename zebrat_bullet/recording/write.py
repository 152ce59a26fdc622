"""Writes an episode as MCAP, as `ros2 bag record` would have: for Foxglove, Lichtblick, rosbags and ROS 2 itself."""

from collections.abc import Iterator
from pathlib import Path

from mcap.records import Schema
from mcap_ros2.writer import Writer

from zebrat_bullet import __version__
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.evaluation.records import EpisodeRecord
from zebrat_bullet.outputs import written_whole
from zebrat_bullet.recording import markers, messages
from zebrat_bullet.recording.episode import WatchedEpisode
from zebrat_bullet.recording.messages import Message
from zebrat_bullet.recording.schemas import schema_text
from zebrat_bullet.recording.stamps import stamp_ns
from zebrat_bullet.types import Clearance, Command, FlatScan
from zebrat_bullet.world import World

TOPICS = {
    "/tf_static": "tf2_msgs/msg/TFMessage",
    "/walls": "visualization_msgs/msg/MarkerArray",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/odom": "nav_msgs/msg/Odometry",
    "/points": "sensor_msgs/msg/PointCloud2",
    "/scan": "sensor_msgs/msg/LaserScan",
    "/safety_region": "visualization_msgs/msg/MarkerArray",
    "/command": "geometry_msgs/msg/TwistStamped",
    "/command_ackermann": "ackermann_msgs/msg/AckermannDriveStamped",
    "/supervisor": "std_msgs/msg/String",
    "/outcome": "std_msgs/msg/String",
}
"""The type of each topic of a recording. The commands' names are none that a car listens to when it is played."""
_LATCHED = ("/tf_static", "/walls")
_QOS = """\
- history: keep_last
  depth: {depth}
  reliability: reliable
  durability: {durability}
  deadline: {{sec: 9223372036, nsec: 854775807}}
  lifespan: {{sec: 9223372036, nsec: 854775807}}
  liveliness: automatic
  liveliness_lease_duration: {{sec: 9223372036, nsec: 854775807}}
  avoid_ros_namespace_conventions: false
"""


class _QosWriter(Writer):
    """A writer whose channels say how they were published, so that `ros2 bag play` latches what was latched."""

    def add_topic(self, topic: str, kind: str) -> Schema:
        """Begin a topic and return its schema."""
        schema = self.register_msgdef(kind, schema_text(kind))
        durability, depth = ("transient_local", 1) if topic in _LATCHED else ("volatile", 10)
        qos = {"offered_qos_profiles": _QOS.format(durability=durability, depth=depth)}
        self._channel_ids[topic] = self._writer.register_channel(
            topic=topic, message_encoding="cdr", schema_id=schema.id, metadata=qos
        )
        return schema


def check_mcap(path: Path) -> None:
    """Refuse another suffix than .mcap.

    Raises:
        ConfigError: it is another.
    """
    if path.suffix != ".mcap":
        raise ConfigError(f"a recording's name ends in .mcap, got {path.name!r}")


def write_recording(episode: WatchedEpisode, world: World, path: Path) -> int:
    """Write an episode as MCAP, whole or not at all, and return how many messages it holds.

    The same episode gives the same bytes.

    Raises:
        ConfigError: another suffix than .mcap.
    """
    check_mcap(path)
    n = 0
    with written_whole(path) as part, part.open("wb") as file, _QosWriter(file) as writer:
        schemas = {topic: writer.add_topic(topic, kind) for topic, kind in TOPICS.items()}
        writer.add_metadata("zebrat", _metadata(episode.record))
        for topic, time_s, message in episode_messages(episode, world):
            writer.write_message(topic, schemas[topic], message, stamp_ns(time_s))
            n += 1
    return n


def episode_messages(episode: WatchedEpisode, world: World) -> Iterator[tuple[str, float, Message]]:
    """Yield topic, time in s and message, in the order in which they would have been sent."""
    record, drive = episode.record, episode.drive
    robot, lidar = drive.robot, drive.config.lidar
    reasons = dict(zip(record.refused[:, 0].astype(int).tolist(), record.reasons, strict=True))
    yield "/tf_static", 0.0, messages.fixed_frames(robot)
    yield "/walls", 0.0, markers.wall_markers(world)
    for i, (time_s, seen) in enumerate(zip(record.time_s.tolist(), episode.seen, strict=True)):
        obs = record.obs_m[i]
        clearance = Clearance(obs, record.range_m, bool((obs <= record.range_m).any()))
        scan = FlatScan(record.scan_m[i], lidar.range_max_m)
        yield "/tf", time_s, messages.moving_frames(seen.state, time_s)
        yield "/odom", time_s, messages.odometry_message(seen.state, robot, time_s)
        yield "/points", time_s, messages.cloud_message(drive.lidar.cloud(seen.sweep), lidar.n_channels, time_s)
        yield "/scan", time_s, messages.scan_message(scan, drive.robot, drive.config.physics.control_step_s, time_s)
        region = markers.region_markers(drive.region, lidar.n_bearings, clearance, robot, time_s)
        yield "/safety_region", time_s, region
        if i < len(record.command):
            command = Command(*record.command[i].tolist())
            if i in reasons:
                yield "/supervisor", time_s, {"data": reasons[i]}
            yield "/command", time_s, messages.twist_message(command, robot, time_s)
            yield "/command_ackermann", time_s, messages.ackermann_message(command, time_s)
    yield "/outcome", record.duration_s, {"data": record.outcome}


def _metadata(record: EpisodeRecord) -> dict[str, str]:
    """Return what makes the episode again, as texts."""
    named = ("world", "agent", "seed", "episode", "caster", "outcome", "task")
    return {"version": __version__} | {name: str(getattr(record, name)) for name in named}
