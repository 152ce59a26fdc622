"""The command line."""

from zebrat_bullet.cli.main import main

__all__ = ["main"]
