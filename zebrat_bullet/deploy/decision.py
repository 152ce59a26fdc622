"""What a driver of a real car answers at a control step."""

from dataclasses import dataclass

from zebrat_bullet.types import Command


@dataclass(frozen=True, slots=True)
class Decision:
    """A command, and why it is a stop if it is one.

    Attributes:
        command: speed in m/s and steering in rad; speed 0 and the last steering where it was refused to drive.
        refusal: what was wrong, what is allowed and what to do; empty where the car drives.
    """

    command: Command
    refusal: str = ""
