"""What a user should know of, and nothing stops for: warnings of one kind, said in a line."""

import warnings
from typing import Any

_python_format = warnings.formatwarning


class Note(UserWarning):
    """Says what was taken to be meant, or why something stands still; nothing stops for it."""


def say_notes_in_a_line() -> None:
    """Print notes as one line each, any other warning as Python does; for a process of the command line."""
    warnings.formatwarning = _format


def _format(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> str:
    if issubclass(category, Note):
        return f"zebrat: note: {message}\n"
    return _python_format(message, category, *where, **more)
