"""The web server of the teleoperation page: the page, the world, a stream of views out, key states in."""

import errno
import json
import sys
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from threading import Thread

from zebrat_bullet.errors import ConfigError
from zebrat_bullet.teleop.hub import Hub

RESEND_S = 0.5
MAX_BODY = 1000


class TeleopServer(ThreadingHTTPServer):
    """Serves the page in threads of its own until `close`.

    Args:
        host, port: where to listen; port 0 takes a free one.
        hub: what the threads share with the driver.
        world: the world as JSON, sent once to each page.

    Raises:
        ConfigError: the address cannot be listened on.
    """

    daemon_threads = True

    def __init__(self, host: str, port: int, hub: Hub, world: str) -> None:
        self.hub, self.world = hub, world
        self.page = files("zebrat_bullet.teleop").joinpath("page.html").read_bytes()
        try:
            super().__init__((host, port), _Handler)
        except OverflowError as error:
            raise ConfigError(f"a port is a number from 0 to 65535, got {port}") from error
        except OSError as error:
            reason = "another program listens there" if error.errno == errno.EADDRINUSE else error.strerror
            raise ConfigError(
                f"cannot listen on {host}:{port} ({reason}); name another --port, 0 for any that is free"
            ) from error
        Thread(target=self.serve_forever, daemon=True).start()

    @property
    def url(self) -> str:
        """Where a browser finds the page."""
        host, port = self.server_address[:2]
        return f"http://{host!s}:{port}/"

    def handle_error(self, request: object, client_address: object) -> None:
        """Say nothing of a tab that closed in the middle of a request; anything else is a fault worth its traceback."""
        if not isinstance(sys.exception(), OSError):
            super().handle_error(request, client_address)  # type: ignore[arg-type]

    def close(self) -> None:
        """Stop listening."""
        self.shutdown()
        self.server_close()


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    timeout = 5  # a tab that takes nothing for so long has left
    server: TeleopServer

    def do_GET(self) -> None:
        if self.path == "/":
            self._answer(200, "text/html; charset=utf-8", self.server.page)
        elif self.path == "/world":
            self._answer(200, "application/json", self.server.world.encode())
        elif self.path == "/views":
            self._stream()
        else:
            self._answer(404, "text/plain", b"no such page")

    def do_POST(self) -> None:
        """Take {"seat": name, "keys": [...], "restart": bool}; 409 from a tab that only watches."""
        length = self.headers.get("Content-Length", "")
        if self.path != "/keys" or not length.isdecimal() or int(length) > MAX_BODY:
            self.close_connection = True
            self._answer(400, "text/plain", b"post a short key state to /keys")
            return
        try:
            state = json.loads(self.rfile.read(int(length)))
            taken = self.server.hub.press(state["seat"], map(str, state["keys"]), bool(state["restart"]))
        except (ValueError, KeyError, TypeError):
            self._answer(400, "text/plain", b"a key state has seat, keys and restart")
            return
        self._answer(200 if taken else 409, "text/plain", b"")

    def log_message(self, format: str, *args: object) -> None:
        """Say nothing: ten requests a second would hide everything else."""

    def _answer(self, status: int, kind: str, body: bytes) -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        self.wfile.write(body)

    def _stream(self) -> None:
        """Send every view as a server-sent event until the tab goes; a repeat now and then finds out that it has."""
        self.close_connection = True
        self.send_response(200)
        self.send_header("Content-Type", "text/event-stream")
        self.send_header("Cache-Control", "no-store")
        self.send_header("Connection", "close")
        self.end_headers()
        hub = self.server.hub
        seat, version = hub.join(), -1
        try:
            while True:
                version, view = hub.next_view(version, RESEND_S)
                event = f'{{"seat": "{seat}", "drives": {json.dumps(hub.drives(seat))}, "view": {view}}}'
                self.wfile.write(f"data: {event}\n\n".encode())
        except OSError:
            pass  # the tab was closed
        finally:
            hub.leave(seat)
