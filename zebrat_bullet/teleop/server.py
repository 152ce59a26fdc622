"""The web server of the teleoperation page: the page, the world, a stream of views out, key states in."""

from typing import Any

from zebrat_bullet.teleop.hub import Hub
from zebrat_bullet.teleop.local_server import Answer, LocalServer

SCENE = ("zebrat_bullet.teleop", "scene.js")
"""What draws walls, cars and scans on every page."""
MOST_KEYS_BYTES = 1000


class TeleopServer(LocalServer):
    """Serves the page in threads of its own until `close`.

    Args:
        host, port: where to listen; port 0 takes a free one.
        hub: what the threads share with the driver.
        world: the world as JSON, sent once to each page.

    Raises:
        ConfigError: the address cannot be listened on.
    """

    def __init__(self, host: str, port: int, hub: Hub, world: str) -> None:
        self.world = world
        pages = {"/": ("zebrat_bullet.teleop", "page.html"), "/scene.js": SCENE}
        super().__init__(host, port, hub, pages, {"/keys": MOST_KEYS_BYTES})

    def get(self, path: str) -> Answer:
        """Answer with the world."""
        return (200, self.world) if path == "/world" else super().get(path)

    def post(self, path: str, body: dict[str, Any]) -> Answer:
        """Take the keys."""
        return take_keys(self.hub, body)


def take_keys(hub: Hub, body: dict[str, Any]) -> Answer:
    """Take {"seat": name, "keys": [...], "restart": bool}; 409 from a tab that only watches.

    Raises:
        KeyError, TypeError: it is something else.
    """
    taken = hub.press(body["seat"], map(str, body["keys"]), bool(body["restart"]))
    return (200, "null") if taken else (409, "another tab drives")
