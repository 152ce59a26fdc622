"""What the driving thread and the web server's threads share: who drives, which keys are down, what is to be seen."""

import math
import secrets
import threading
import time
from collections.abc import Callable, Iterable

KEYS = frozenset({"forward", "reverse", "left", "right", "stop"})
DEAD_MAN_S = 0.5
MOST_SEATS = 32


class Hub:
    """The seats of connected browser tabs and the state of the driver's keys; safe to use from many threads.

    The tab that has been connected longest drives; the others watch, and move up when it leaves.

    Attributes:
        sitting: a random name. A tab outlives the server that it was loaded from, and knows the next one by it.
    """

    def __init__(self) -> None:
        self.sitting = secrets.token_hex(8)
        self._changed = threading.Condition()
        self._seats: dict[str, None] = {}
        self._keys: frozenset[str] = frozenset()
        self._keys_at = -math.inf
        self._restart = False
        self._view, self._version = "null", 0

    def join(self) -> str | None:
        """Seat a tab and return its secret name; None where all seats are taken."""
        with self._changed:
            if len(self._seats) >= MOST_SEATS:
                return None
            seat = secrets.token_hex(8)
            self._seats[seat] = None
            self._changed.notify_all()
            return seat

    def leave(self, seat: str) -> None:
        """Free a seat; when it was the driver's, all keys are up."""
        with self._changed:
            if self.drives(seat):
                self._keys, self._keys_at, self._restart = frozenset(), -math.inf, False
            del self._seats[seat]
            self._changed.notify_all()

    def drives(self, seat: str) -> bool:
        """Return whether this seat is the driver's."""
        with self._changed:
            return next(iter(self._seats), None) == seat

    def press(self, seat: str, keys: Iterable[str], restart: bool) -> bool:
        """Take the state of all keys and whether R was struck; False, and nothing taken, from a seat that watches."""
        with self._changed:
            if not self.drives(seat):
                return False
            self._keys, self._keys_at = KEYS.intersection(keys), time.monotonic()
            self._restart |= restart
            self._changed.notify_all()
            return True

    def keys(self) -> frozenset[str]:
        """Return the driver's keys; "stop" alone when none has been heard of for 0.5 s, whatever was held then."""
        silent = time.monotonic() - self._keys_at > DEAD_MAN_S
        return frozenset({"stop"}) if silent else self._keys

    def occupied(self) -> bool:
        """Return whether anyone drives."""
        return bool(self._seats)

    def take_restart(self) -> bool:
        """Return whether R was struck since the last call."""
        with self._changed:
            struck, self._restart = self._restart, False
            return struck

    def wait(self, until: Callable[[], bool], timeout_s: float | None = None) -> None:
        """Sleep until a condition on this hub holds, or for so long."""
        with self._changed:
            self._changed.wait_for(until, timeout_s)

    def restart_struck(self) -> bool:
        """Return whether R was struck, and leave it so."""
        return self._restart

    def show(self, view: str) -> None:
        """Show every tab a new picture of the drive, as JSON."""
        with self._changed:
            self._view, self._version = view, self._version + 1
            self._changed.notify_all()

    def next_view(self, after: int, timeout_s: float) -> tuple[int, str]:
        """Return the number and the JSON of the view that follows number `after`, or the same again after a while."""
        with self._changed:
            self._changed.wait_for(lambda: self._version != after, timeout_s)
            return self._version, self._view
