"""Subscriptions that say why they hear nothing."""

import time
from collections.abc import Callable
from typing import Any

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.exceptions import InvalidTopicNameException
from rclpy.node import Node
from rclpy.qos import QoSProfile, QoSReliabilityPolicy

from zebrat_bullet.errors import ConfigError
from zebrat_bullet.files import shown

SILENCE_S = 2.0
"""Time without a message after which a subscription says why it may be so, and again after twice the time each."""


def qos(reliability: str, depth: int = 1) -> QoSProfile:
    """Return a profile with "best_effort" or "reliable", that keeps the last messages."""
    return QoSProfile(depth=depth, reliability=getattr(QoSReliabilityPolicy, reliability.upper()))


def create_publisher(node: Node, kind: Any, topic: str, reliability: str) -> Any:
    """Return a publisher.

    Raises:
        ConfigError: the topic is none that ROS takes.
    """
    try:
        return node.create_publisher(kind, topic, qos(reliability))
    except InvalidTopicNameException as error:
        raise _not_a_topic(topic, error) from error


def create_subscription(
    node: Node,
    kind: Any,
    topic: str,
    reliability: str,
    callback: Callable[[Any], None],
    events: SubscriptionEventCallbacks | None = None,
) -> Any:
    """Return a subscription.

    Raises:
        ConfigError: the topic is none that ROS takes.
    """
    try:
        return node.create_subscription(kind, topic, callback, qos(reliability), event_callbacks=events)
    except InvalidTopicNameException as error:
        raise _not_a_topic(topic, error) from error


class Listener:
    """A subscription to a sensor. It warns where publishers are there and nothing comes, and where there are none.

    Args:
        node: whose subscription it is.
        kind, topic, reliability: what it subscribes to.
        callback: told of every message.

    Raises:
        ConfigError: the topic is none that ROS takes.
    """

    def __init__(self, node: Node, kind: Any, topic: str, reliability: str, callback: Callable[[Any], None]) -> None:
        self._node, self._kind, self._reliability, self._callback = node, kind, reliability, callback
        self._heard_s, self._patience_s = time.monotonic(), SILENCE_S
        self.n_heard = 0
        events = SubscriptionEventCallbacks(
            incompatible_qos=lambda event: self._warn(), incompatible_type=lambda event: self._warn()
        )
        self.topic = create_subscription(node, kind, topic, reliability, self._hear, events).topic_name

    def _hear(self, message: Any) -> None:
        self._heard_s, self._patience_s = time.monotonic(), SILENCE_S
        self.n_heard += 1
        self._callback(message)

    def look(self) -> None:
        """Warn if it has been silent for long; to be called now and then."""
        if time.monotonic() - self._heard_s > self._patience_s:
            self._patience_s *= 2.0
            self._warn()

    def _warn(self) -> None:
        self._node.get_logger().warning(self.why_silent())

    def why_silent(self) -> str:
        """Return what is known of the reasons for hearing nothing: who publishes what, and with which QoS."""
        publishers = self._node.get_publishers_info_by_topic(self.topic)
        wanted = _type_name(self._kind)
        if not publishers:
            topics = sorted(name for name, types in self._node.get_topic_names_and_types() if wanted in types)
            others = [name for name in topics if self._publishes(name, wanted)][:10]
            there = f"there are {', '.join(others)}" if others else "nor any other topic of that type"
            return (
                f"nobody publishes {self.topic} ({wanted}); {there}. Does the lidar's driver run, with the same "
                "ROS_DOMAIN_ID?"
            )
        told: list[str] = []
        for publisher in publishers:
            node = f"{publisher.node_namespace.rstrip('/')}/{publisher.node_name}"
            offered = publisher.qos_profile.reliability.name.lower()
            if publisher.topic_type != wanted:
                told.append(f"{node} publishes {publisher.topic_type}, this node wants {wanted}: name another topic")
            elif offered == "best_effort" and self._reliability == "reliable":
                told.append(
                    f"{node} publishes best_effort, this node asks for reliable and will never hear it: give this node "
                    "the parameter reliability:=best_effort"
                )
            else:
                told.append(f"{node} publishes {offered}, this node asks for {self._reliability}: that fits")
        return f"{self.topic} has {len(publishers)} publisher(s) and nothing arrives: {'; '.join(told)}"

    def _publishes(self, topic: str, wanted: str) -> bool:
        return any(each.topic_type == wanted for each in self._node.get_publishers_info_by_topic(topic))


def _type_name(kind: Any) -> str:
    """Return a message class's name as ROS writes it: sensor_msgs/msg/LaserScan."""
    return f"{kind.__module__.split('.')[0]}/msg/{kind.__name__}"


def _not_a_topic(topic: str, error: Exception) -> ConfigError:
    return ConfigError(f"{shown(topic)!r} is no topic: {' '.join(str(error).split())[:200]}")
