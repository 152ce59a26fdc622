"""Which topics of a bag are the lidar, the commands and the odometry."""

from collections.abc import Sequence
from dataclasses import dataclass

from zebrat_bullet.errors import ConfigError
from zebrat_bullet.files import shown
from zebrat_bullet.recording.bag import (
    ACKERMANN,
    ACKERMANN_STAMPED,
    CLOUD,
    ODOMETRY,
    SCAN,
    TWIST,
    TWIST_STAMPED,
    Bag,
    Topic,
)

_LIDAR = ((CLOUD,), (SCAN,))
_COMMAND = ((ACKERMANN_STAMPED, ACKERMANN), (TWIST_STAMPED, TWIST))
"""First those that say more: a cloud is what a scan was made from; a Twist loses the steering at standstill."""
_MOST_LISTED = 40


@dataclass(frozen=True, slots=True)
class Topics:
    """What is read of a bag; without an odometry (None) the car's speed is taken to be the last command's."""

    lidar: Topic
    command: Topic
    odometry: Topic | None


def choose_topics(bag: Bag, lidar: str = "", command: str = "", odometry: str = "") -> Topics:
    """Return the topics of these names, or, where a name is empty, the only one of its kind.

    Raises:
        ConfigError: there is none or more than one, or it is of another type; the message lists what there is.
    """
    alone = [topic for topic in bag.topics if topic.kind == ODOMETRY and topic.count]
    speeds = None
    if odometry:
        speeds = _choose(bag, ((ODOMETRY,),), odometry, "--odometry-topic")
    elif len(alone) == 1:
        speeds = alone[0]
    return Topics(
        _choose(bag, _LIDAR, lidar, "--lidar-topic"),
        _choose(bag, _COMMAND, command, "--command-topic"),
        speeds,
    )


def _choose(bag: Bag, kinds: tuple[tuple[str, ...], ...], name: str, option: str) -> Topic:
    topics, where = bag.topics, shown(bag.path)
    every = [kind for group in kinds for kind in group]
    if name:
        named = [topic for topic in topics if topic.name.lstrip("/") == name.lstrip("/")]
        fitting = [topic for topic in named if topic.kind in every and topic.count]
        if len(fitting) == 1:
            return fitting[0]
        what = f"is {', '.join(map(str, named))}" if named else "is not in the bag"
        raise ConfigError(
            f"{where}: {option} {shown(name)} {what}; it must have messages of {' or '.join(every)}. {_list(topics)}"
        )
    for group in kinds:
        found = [topic for topic in topics if topic.kind in group and topic.count]
        if len(found) == 1:
            return found[0]
        if found:
            raise ConfigError(
                f"{where}: has {len(found)} topics that it could be: {', '.join(map(str, found))}; name one: "
                f"{option} {shown(found[0].name)}"
            )
    raise ConfigError(f"{where}: has no messages of {' or '.join(every)}. {_list(topics)}")


def _list(topics: Sequence[Topic]) -> str:
    listed = [str(topic) for topic in topics[:_MOST_LISTED]]
    more = ["..."] if len(topics) > _MOST_LISTED else []
    return f"It holds: {', '.join(listed + more) or 'nothing'}"
