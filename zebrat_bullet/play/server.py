"""The web server of the drawing page: the page, the track, a stream of views out; drawings, wishes and keys in."""

import json
from collections.abc import Mapping, Sequence
from typing import Any

from zebrat_bullet.errors import ConfigError
from zebrat_bullet.play.stage import Stage
from zebrat_bullet.teleop.hub import Hub
from zebrat_bullet.teleop.local_server import Answer, LocalServer
from zebrat_bullet.teleop.server import MOST_KEYS_BYTES, SCENE, take_keys

_PACKAGE = "zebrat_bullet.play"
_PAGES = {
    "/": (_PACKAGE, "page.html"),
    **{f"/{name}": (_PACKAGE, name) for name in ("page.css", "editor.js", "picture.js", "page.js")},
    "/scene.js": SCENE,
}
_MOST_BYTES = {
    "/keys": MOST_KEYS_BYTES,
    "/fit": 300_000,
    "/draw": 50_000,
    "/open": 100_000,
    **dict.fromkeys(("/drive", "/stop", "/cancel", "/clear"), 1000),
}


class PlayServer(LocalServer):
    """Serves the page in threads of its own until `close`.

    Args:
        host, port: where to listen; port 0 takes a free one.
        hub, stage: what is shown, and to whom; the driver's seat alone changes it.
        options: what the page offers, as JSON, sent once to each page.

    Raises:
        ConfigError: the address cannot be listened on.
    """

    def __init__(self, host: str, port: int, hub: Hub, stage: Stage, options: Mapping[str, object]) -> None:
        self.stage, self.options = stage, json.dumps(options)
        super().__init__(host, port, hub, _PAGES, _MOST_BYTES)

    def get(self, path: str) -> Answer:
        """Answer with what is offered, or with the track."""
        if path == "/options":
            return 200, self.options
        return (200, self.stage.track_json()) if path == "/track" else super().get(path)

    def post(self, path: str, body: dict[str, Any]) -> Answer:
        """Do what the driver's seat asks for; 409 from a tab that only watches, 422 where it cannot be done now."""
        if path == "/keys":
            return take_keys(self.hub, body)
        if not self.hub.drives(str(body["seat"])):
            return 409, "another tab draws"
        stage = self.stage
        if path == "/fit":
            return 200, json.dumps(stage.fit(body["stroke"], body["width"]))
        if path == "/draw":
            return 200, stage.draw(body["drawing"])
        if path == "/open":
            return 200, stage.open(str(body["text"]))
        if path == "/clear":
            return 200, stage.clear()
        if path == "/drive":
            return self._drive(body["agents"], float(body["pace"]))
        stage.stop() if path == "/stop" else stage.cancel()
        return 200, "null"

    def _drive(self, agents: Sequence[str], pace: float) -> Answer:
        try:
            self.stage.drive([str(agent) for agent in agents], pace)
        except ConfigError as error:
            return 422, str(error)
        return 200, "null"
