"""Starts ROS: finds rclpy, and says what is in its way before it ends the process without a word."""

import os
import signal
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.metadata import PackageNotFoundError, version

from zebrat_bullet.errors import ConfigError

_MIDDLEWARE = "rmw_fastrtps_cpp"
_MOST_DOMAIN = 232


def check_ros() -> None:
    """Import rclpy.

    Raises:
        ConfigError: it is not installed, or the environment keeps it from starting.
    """
    _check_environment()
    try:
        import rclpy.node  # noqa: F401
    except ModuleNotFoundError as error:
        raise ConfigError(
            f"ROS 2 is not installed here (no module {error.name}): pip install 'zebrat-bullet[ros]', or on a robot "
            "the short list of docs/ros.md; it needs Python 3.11 on Linux"
        ) from error
    except ImportError as error:
        raise ConfigError(
            f"ROS 2 does not start ({' '.join(str(error).split())[:300]}). Does the shell know another ROS or another "
            "Python's? Try: env -u PYTHONPATH -u LD_LIBRARY_PATH -u AMENT_PREFIX_PATH "
            "-u _ROS_WHEELS_BOOTSTRAP_COMPLETE zebrat ros ..."
        ) from error


def _check_environment() -> None:
    wanted = os.environ.get("RMW_IMPLEMENTATION", "")
    if wanted not in ("", _MIDDLEWARE) and _from_wheels():  # rcl would exit with 102
        raise ConfigError(
            f"RMW_IMPLEMENTATION is {wanted}, and the wheels of ROS hold {_MIDDLEWARE} alone: unset it here, and give "
            f"the other nodes RMW_IMPLEMENTATION={_MIDDLEWARE} so that both sides speak the same"
        )
    domain = os.environ.get("ROS_DOMAIN_ID", "")
    if domain and not (domain.isdecimal() and int(domain) <= _MOST_DOMAIN):
        raise ConfigError(f"ROS_DOMAIN_ID must be a whole number from 0 to {_MOST_DOMAIN}, got {domain!r}")


def _from_wheels() -> bool:
    try:
        return bool(version("ros-rclpy"))
    except PackageNotFoundError:
        return False


@contextmanager
def ros(arguments: Sequence[str]) -> Iterator[None]:
    """Start rclpy with what stands behind --ros-args, and shut it down again.

    SIGTERM, and SIGHUP of a terminal that is closed, end a node as Ctrl-C does: its last word is a stop.

    Raises:
        ConfigError: rclpy cannot start, or does not take the arguments.
    """
    check_ros()
    import rclpy
    from rclpy.signals import SignalHandlerOptions

    try:
        # Python's own handler of Ctrl-C stays: after rclpy's, nothing could be published any more.
        rclpy.init(
            args=[sys.argv[0], "--ros-args", *arguments] if arguments else [],
            signal_handler_options=SignalHandlerOptions.NO,
        )
    except Exception as error:
        said = " ".join(str(error).split())[:400]
        raise ConfigError(f"ROS does not take --ros-args {' '.join(arguments)}: {said}") from error
    ends = [signal.SIGTERM]
    if signal.getsignal(signal.SIGHUP) != signal.SIG_IGN:  # nohup lets it drive on
        ends.append(signal.SIGHUP)
    before = {each: signal.signal(each, signal.default_int_handler) for each in ends}
    try:
        yield
    finally:
        for each, handler in before.items():
            signal.signal(each, handler)
        rclpy.try_shutdown()
