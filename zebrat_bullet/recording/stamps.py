"""When the messages of a recording were sent: simulated time from a fixed day, so that the same is the same again."""

EPOCH_S = 1_704_067_200
"""Begin of every episode: 2024-01-01 00:00 UTC."""
_NS = 1_000_000_000


def stamp_ns(time_s: float) -> int:
    """Return the time of an episode as ns since 1970."""
    return EPOCH_S * _NS + round(time_s * _NS)


def header(time_s: float, frame: str) -> dict[str, object]:
    """Return a `std_msgs/Header`."""
    sec, nanosec = divmod(stamp_ns(time_s), _NS)
    return {"stamp": {"sec": sec, "nanosec": nanosec}, "frame_id": frame}
