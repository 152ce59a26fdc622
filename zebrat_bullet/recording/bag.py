"""Recordings of others: MCAP, rosbag2 folders and ROS 1 bags, read bit by bit, with the definitions that we know.

What a file says of its messages' types is never made into code, and what is compressed is unpacked only up to a bound.
"""

import heapq
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path
from typing import Any

from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from zebrat_bullet.errors import SensorError, ZebratError
from zebrat_bullet.files import MB, is_file, read_yaml, refusing, require_file, shown
from zebrat_bullet.recording.schemas import schema_text
from zebrat_bullet.recording.unpack import bound_unpacking, unzstd

MOST_BYTES = 64_000 * MB
"""Of a file; it is read piece by piece."""
MOST_FILES = 1000
_MOST_TIME_NS = 2**62
CLOUD, SCAN, ODOMETRY = "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/LaserScan", "nav_msgs/msg/Odometry"
TWIST, TWIST_STAMPED = "geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"
ACKERMANN, ACKERMANN_STAMPED = "ackermann_msgs/msg/AckermannDrive", "ackermann_msgs/msg/AckermannDriveStamped"
KNOWN = (CLOUD, SCAN, ODOMETRY, TWIST, TWIST_STAMPED, ACKERMANN, ACKERMANN_STAMPED)
"""What can be read here; messages of other types are passed over."""
_SUFFIXES = (".mcap", ".db3", ".bag")
_REMEDY = "record it again, or mend it with `mcap recover` or `ros2 bag convert`"


bound_unpacking()


@dataclass(frozen=True, slots=True)
class Topic:
    """A topic of a bag: its name, the type of its messages (as ROS 2 writes it) and how many they are."""

    name: str
    kind: str
    count: int

    def __str__(self) -> str:
        return f"{shown(self.name)} ({shown(self.kind)}, {self.count})"


class Bag:
    """A bag, open for reading; use it in a `with`.

    Args:
        path: an .mcap, .db3 or .bag file, or the folder that `ros2 bag record` makes.

    Attributes:
        path: of the bag.
        topics: what it holds, by name and type.

    Raises:
        ZebratError: it is none, damaged, or compressed in a way that is not read here.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        files, packed = _files(path)
        self._unpack: Callable[[bytes], bytes] = unzstd if packed else bytes
        self._stack = ExitStack()
        self._readers: list[Any] = []
        try:
            for file in files:
                with refusing(file, ZebratError, "is no whole bag", _REMEDY):
                    make = rosbag1.Reader if file.suffix == ".bag" else rosbag2.Reader
                    self._readers.append(self._stack.enter_context(make(file)))
            self._is_ros1 = files[0].suffix == ".bag"
            self._store = _typestore(self._is_ros1)
            self.topics = self._topics()
        except BaseException:
            self._stack.close()
            raise

    def __enter__(self) -> "Bag":
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def _topics(self) -> list[Topic]:
        counts: dict[tuple[str, str], int] = {}
        for reader in self._readers:
            for each in reader.connections:
                key = str(each.topic), str(each.msgtype)
                counts[key] = counts.get(key, 0) + int(each.msgcount)
        return [Topic(name, kind, count) for (name, kind), count in sorted(counts.items())]

    def messages(self, topics: Iterable[Topic]) -> Iterator[tuple[Topic, int, bytes]]:
        """Yield topic, time of arrival in ns and bytes of each message, in the order of arrival.

        Raises:
            ZebratError: the file is damaged.
        """
        wanted = {(topic.name, topic.kind): topic for topic in topics}
        parts = [self._part(reader, wanted) for reader in self._readers]
        with refusing(self.path, ZebratError, "is no whole bag", _REMEDY):
            # A split bag's files follow each other; one that was mended may overlap.
            for topic, time_ns, data in heapq.merge(*parts, key=itemgetter(1)):
                if not 0 <= time_ns < _MOST_TIME_NS:
                    raise ValueError(f"a message of {shown(topic.name)} arrived {time_ns} ns after 1970")
                yield topic, time_ns, self._unpack(data)

    @staticmethod
    def _part(reader: Any, wanted: dict[tuple[str, str], Topic]) -> Iterator[tuple[Topic, int, bytes]]:
        connections = [each for each in reader.connections if (each.topic, each.msgtype) in wanted]
        if connections:
            for each, time_ns, data in reader.messages(connections):
                yield wanted[each.topic, each.msgtype], time_ns, data

    def decode(self, topic: Topic, data: bytes) -> Any:
        """Return a message as an object with its fields as attributes.

        Raises:
            SensorError: its bytes are none of that type.
        """
        try:
            decode = self._store.deserialize_ros1 if self._is_ros1 else self._store.deserialize_cdr
            return decode(data, topic.kind)
        except Exception as error:  # whatever a decoder makes of garbage
            raise SensorError(f"{len(data)} bytes are no {topic.kind} ({shown(error)})") from error


def _typestore(is_ros1: bool) -> Any:
    store = get_typestore(Stores.ROS1_NOETIC if is_ros1 else Stores.EMPTY)
    for name in KNOWN:
        if name not in store.fielddefs:
            types = get_types_from_msg(schema_text(name), name)
            store.register({kind: what for kind, what in types.items() if kind not in store.fielddefs})
    return store


def _files(path: Path) -> tuple[list[Path], bool]:
    """Return the files of a bag, each checked, and whether its messages are compressed one by one."""
    if not path.is_dir():
        if path.suffix not in _SUFFIXES and is_file(path):
            raise ZebratError(
                f"{shown(path)}: is no bag; name an {', '.join(_SUFFIXES)} file or the folder of a rosbag2"
            )
        require_file(path, ZebratError, MOST_BYTES)
        _refuse_empty(path)
        return [path], False
    files = sorted(each for each in path.iterdir() if each.suffix in (".mcap", ".db3"))
    if packed := sorted(each.name for each in path.glob("*.zst*")):
        raise ZebratError(f"{shown(path)}: {shown(packed[0])} is compressed as a whole; unpack it first: zstd -d")
    if not 1 <= len(files) <= MOST_FILES:
        raise ZebratError(f"{shown(path)}: holds {len(files)} .mcap and .db3 files, a bag has 1 to {MOST_FILES}")
    for file in files:
        require_file(file, ZebratError, MOST_BYTES)
        _refuse_empty(file)
    return files, _has_packed_messages(path / "metadata.yaml")


def _refuse_empty(path: Path) -> None:
    if path.stat().st_size == 0:
        raise ZebratError(f"{shown(path)}: is empty; {_REMEDY}")


def _has_packed_messages(metadata: Path) -> bool:
    if not is_file(metadata):  # an interrupted recording has none
        return False
    data = read_yaml(metadata, ZebratError)
    about = data.get("rosbag2_bagfile_information") if isinstance(data, dict) else None
    if not isinstance(about, dict):
        raise ZebratError(f"{shown(metadata)}: says nothing of a bag; make it anew with `ros2 bag reindex`")
    mode, kind = str(about.get("compression_mode") or "none"), str(about.get("compression_format") or "")
    if mode.lower() == "message" and kind != "zstd":
        raise ZebratError(f"{shown(metadata)}: its messages are compressed as {shown(kind)!r}, only zstd is read here")
    return mode.lower() == "message"
