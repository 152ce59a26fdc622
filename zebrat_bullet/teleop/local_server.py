"""A web server that answers its own pages only: what else the same browser has open cannot drive the car."""

import errno
import json
import socket
import sys
from collections.abc import Mapping
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from ipaddress import ip_address
from threading import BoundedSemaphore, Thread
from typing import Any
from urllib.parse import urlsplit

from zebrat_bullet.errors import ConfigError
from zebrat_bullet.files import parse_json
from zebrat_bullet.teleop.hub import Hub

RESEND_S = 0.5
MOST_CONNECTIONS = 100
"""At a time; more are closed unheard. A tab that looks on holds one, and the hub has fewer seats than this."""
_KINDS = {".html": "text/html; charset=utf-8", ".js": "text/javascript; charset=utf-8", ".css": "text/css"}
# Nothing from elsewhere, and in no other page's frame, where a click could be stolen.
_POLICY = "default-src 'self' 'unsafe-inline'; img-src 'self' data:; frame-ancestors 'none'; base-uri 'none'"

Answer = tuple[int, str]
"""Status, and JSON or a line of text that says what was wrong."""


class LocalServer(ThreadingHTTPServer):
    """Serves pages, a stream of the hub's views and what its subclass answers, in threads of its own until `close`.

    A request must name this machine in `Host` (a name that a foreign site lets point here is refused), and, if it says
    from which page it comes (`Origin`, `Sec-Fetch-Site`), come from one of these.

    Args:
        host, port: where to listen; port 0 takes a free one.
        hub: what the threads share.
        pages: package and file of each page, by path.
        most_bytes: what may be posted to, by path, and how long it may be.

    Raises:
        ConfigError: the address cannot be listened on.
    """

    daemon_threads = True
    request_queue_size = 64

    def __init__(
        self, host: str, port: int, hub: Hub, pages: Mapping[str, tuple[str, str]], most_bytes: Mapping[str, int]
    ) -> None:
        self.hub, self.host, self.most_bytes = hub, host, dict(most_bytes)
        self.pages = {
            path: (_kind(name), files(package).joinpath(name).read_bytes()) for path, (package, name) in pages.items()
        }
        self._slots = BoundedSemaphore(MOST_CONNECTIONS)
        self.address_family = socket.AF_INET6 if ":" in host else socket.AF_INET
        try:
            super().__init__((host, port), _Handler)
        except OverflowError as error:
            raise ConfigError(f"a port is a number from 0 to 65535, got {port}") from error
        except OSError as error:
            raise ConfigError(f"cannot listen on {_in_url(host)}:{port} ({_why(error)}") from error
        Thread(target=self.serve_forever, daemon=True).start()

    def get(self, path: str) -> Answer:
        """Answer a GET that names none of the pages."""
        return 404, "no such page"

    def post(self, path: str, body: dict[str, Any]) -> Answer:
        """Answer a POST to one of `most_bytes`, whose body is a JSON object.

        A ValueError, KeyError or TypeError says that it is not as it should be: 400.
        """
        raise NotImplementedError

    @property
    def url(self) -> str:
        """Where a browser finds the page: on another machine too, if it is served on all of this one's addresses."""
        host, port = str(self.server_address[0]), self.server_address[1]
        host = _own_address(self.address_family) if ip_address(host).is_unspecified else host
        return f"http://{_in_url(host)}:{port}/"

    def process_request(self, request: Any, client_address: Any) -> None:
        """Answer in a thread of its own, if there are not too many."""
        if self._slots.acquire(blocking=False):
            super().process_request(request, client_address)
        else:
            self.shutdown_request(request)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Answer, and let the next one in."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._slots.release()

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
    server: LocalServer

    def do_GET(self) -> None:
        if not self._trusted():
            return
        if self.path in self.server.pages:
            kind, page = self.server.pages[self.path]
            self._answer(200, kind, page)
        elif self.path == "/views":
            self._stream()
        else:
            self._reply(*self.server.get(self.path))

    def do_POST(self) -> None:
        if not self._trusted():
            return
        length, most = self.headers.get("Content-Length", ""), self.server.most_bytes.get(self.path)
        if most is None or not length.isdecimal() or len(length) > 12 or int(length) > most:
            self.close_connection = True
            known = ", ".join(f"{path} (at most {n:,} bytes)" for path, n in self.server.most_bytes.items())
            self._reply(400, f"post JSON to {known}")
            return
        try:
            body = parse_json(self.rfile.read(int(length)).decode(), self.path, ConfigError)
            if not isinstance(body, dict):
                raise TypeError("a JSON object is needed")
            status, text = self.server.post(self.path, body)
        except (ValueError, KeyError, TypeError) as error:
            status, text = 400, f"{self.path}: {error}"
        self._reply(status, text)

    def log_message(self, format: str, *args: object) -> None:
        """Say nothing: ten requests a second would hide everything else."""

    def _trusted(self) -> bool:
        """Return whether the request is for this machine and comes from its own page or from none; else refuse it."""
        host, origin = self.headers.get("Host", ""), self.headers.get("Origin")
        site = self.headers.get("Sec-Fetch-Site", "none")
        own = origin in (None, f"http://{host}") and (site in ("none", "same-origin") or self.path == "/")
        here = _names_here(host, self.server.host)
        if own and here:
            return True
        self.close_connection = True
        # Which name this machine has is not told: whoever asks may be foreign.
        got = "" if here else f" (asked for {host!r}; localhost, this machine's number, name and name.local are taken)"
        self._reply(403, f"not from this page{got}: open the address that zebrat printed, as it stands")
        return False

    def _reply(self, status: int, text: str) -> None:
        self._answer(status, "application/json" if status == 200 else "text/plain; charset=utf-8", text.encode())

    def _answer(self, status: int, kind: str, body: bytes) -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Cache-Control", "no-store")
        self.send_header("Content-Security-Policy", _POLICY)
        self.send_header("X-Content-Type-Options", "nosniff")
        self.end_headers()
        self.wfile.write(body)

    def _stream(self) -> None:
        """Send every view as a server-sent event until the tab goes; a repeat now and then finds out that it has."""
        hub = self.server.hub
        seat = hub.join()
        if seat is None:
            self._reply(503, "too many tabs look on; close one")
            return
        version = -1
        try:
            self.close_connection = True
            self.send_response(200)
            self.send_header("Content-Type", "text/event-stream")
            self.send_header("Cache-Control", "no-store")
            self.send_header("Connection", "close")
            self.end_headers()
            while True:
                version, view = hub.next_view(version, RESEND_S)
                whose = f'"sitting": "{hub.sitting}", "seat": "{seat}", "drives": {json.dumps(hub.drives(seat))}'
                self.wfile.write(f'data: {{{whose}, "view": {view}}}\n\n'.encode())
        except OSError:
            pass  # the tab was closed
        finally:
            hub.leave(seat)


def _why(error: OSError) -> str:
    """Return why an address cannot be listened on, and which option names another."""
    if error.errno in (errno.EADDRINUSE, errno.EACCES):
        reason = "another program listens there" if error.errno == errno.EADDRINUSE else error.strerror
        return f"{reason}); name another --port, 0 for any that is free"
    return f"{error.strerror}); name another --host: 127.0.0.1 for this machine only, 0.0.0.0 for its network too"


def _own_address(family: int) -> str:
    """Return the number under which other machines find this one; its name where it is in no network."""
    with socket.socket(family, socket.SOCK_DGRAM) as probe:
        try:  # sends nothing, and no such machine is needed: it asks which way leads out
            probe.connect(("192.0.2.1" if family == socket.AF_INET else "2001:db8::1", 9))
        except OSError:
            return socket.gethostname()
        return str(probe.getsockname()[0])


def _in_url(host: str) -> str:
    return f"[{host}]" if ":" in host else host


def _kind(name: str) -> str:
    return _KINDS[name[name.rindex(".") :]]


def _names_here(host: str, listening_on: str) -> bool:
    """Return whether a Host header names this machine: by number, its own name, as localhost or as told to listen."""
    try:
        name = urlsplit(f"//{host}").hostname or ""
    except ValueError:
        return False
    own = socket.gethostname().lower()
    if name in ("localhost", listening_on.lower(), own, f"{own.partition('.')[0]}.local"):
        return True
    try:
        ip_address(name)
    except ValueError:
        return False
    return True
