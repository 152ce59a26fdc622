"""Errors a user can cause, each saying what was got, what is allowed and what to do."""


class ZebratError(Exception):
    """Base of every error this package raises on purpose."""


class ConfigError(ZebratError, ValueError):
    """A setting is out of its range, or two settings do not fit together."""


class AssetError(ZebratError, FileNotFoundError):
    """A named URDF, world or policy does not exist; the message lists those that do."""


class RobotError(ZebratError, ValueError):
    """A URDF lacks a role (joint or link) that a car-like robot needs, or its numbers contradict each other."""


class WorldError(ZebratError, ValueError):
    """A world file breaks the schema or describes a place that cannot be driven; names file, field and remedy.

    Attributes:
        at: where, (x, y) in m, world frame; None where the fault has no place.
    """

    def __init__(self, message: str, *, at: tuple[float, float] | None = None) -> None:
        super().__init__(message)
        self.at = at


class ActionError(ZebratError, ValueError):
    """An action or command is not finite, or has the wrong shape; it is never simulated."""


class PolicyError(ZebratError, ValueError):
    """A policy file is not one of ours, or does not fit the observation."""


class SensorError(ZebratError, ValueError):
    """What a real sensor sent cannot be relied on; the car stops."""


class EpisodeError(ZebratError, RuntimeError):
    """There is no episode to step or to draw: none was begun yet, or the environment is closed."""


class SimulationError(ZebratError, RuntimeError):
    """The physics produced a non-finite number; the state that made it was saved."""


class MissingSystemLibraryError(ZebratError, OSError):
    """A shared library from the operating system is absent; the message names the package to install."""


class RenderError(ZebratError, RuntimeError):
    """A picture or video could not be made: the wrong kind of window, or a size no encoder takes."""


class PlanError(ZebratError, ValueError):
    """There is no way from start to goal on the map, or one of them lies in a wall or off the map.

    Attributes:
        proven: no drive can get there; otherwise the search only found none.
    """

    def __init__(self, message: str, *, proven: bool = False) -> None:
        super().__init__(message)
        self.proven = proven
