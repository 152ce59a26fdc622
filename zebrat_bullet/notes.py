"""What a user should know of, and nothing stops for: warnings of one kind, said in a line."""

import sys
import warnings
from pathlib import Path
from typing import Any

_PACKAGE = f"{Path(__file__).parent}/"
_python_format = warnings.formatwarning


class Note(UserWarning):
    """Says what was taken to be meant, or why something stands still; nothing stops for it."""


def say(message: str, category: type[Note]) -> None:
    """Warn of something at the line of the program outside this package that led here."""
    frame, level = sys._getframe(1), 2
    while frame.f_back is not None and frame.f_code.co_filename.startswith(_PACKAGE):
        frame, level = frame.f_back, level + 1
    warnings.warn(message, category, stacklevel=level)


def say_notes_in_a_line() -> None:
    """Print notes as one line each, any other warning as Python does; for a process of the command line."""
    warnings.formatwarning = _format


def _format(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> str:
    if issubclass(category, Note):
        return f"zebrat: note: {message}\n"
    return _python_format(message, category, *where, **more)
