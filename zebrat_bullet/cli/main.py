"""Parses, calls one command, prints: results on standard output, everything else on standard error."""

import argparse
import errno
import json
import os
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO

from zebrat_bullet import __version__
from zebrat_bullet.cli import (
    bench,
    collisions,
    comparison,
    curves,
    driving,
    export,
    families,
    held_out,
    learning,
    parity,
    playing,
    recording,
    robustness,
    ros,
    sweep,
    width,
    worlds,
)
from zebrat_bullet.cli.common import PartialResultError, Run, name_robot
from zebrat_bullet.cli.options import robot_options, whole_number
from zebrat_bullet.errors import ZebratError
from zebrat_bullet.files import shown
from zebrat_bullet.notes import say_notes_in_a_line

_WRITTEN = ("out", "map", "certify")
"""Options that name what is written."""
_PART = re.compile(r"\..+\.part")
"""What a file is called until it is whole, see `outputs.written_whole`."""
_NOT_WRITABLE = (
    *(errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOENT, errno.ENOTDIR, errno.EISDIR, errno.EEXIST),
    errno.ENAMETOOLONG,
)


def main(argv: list[str] | None = None) -> int:
    """Run one command and return its status: 0, 1 after part of the work, 2 after a user's mistake, 3 after ours."""
    arguments = parse(sys.argv[1:] if argv is None else argv)
    status = 0
    say_notes_in_a_line()
    with _real_stdout() as stdout:
        try:
            if "robot" in arguments and arguments.run is not worlds.robots:  # that names its cars itself
                name_robot(arguments)
            result, text = arguments.run(arguments)
        except PartialResultError as error:
            print(f"zebrat {arguments.command}: {error}", file=sys.stderr)
            (result, text), status = error.result, 1
        except ZebratError as error:
            print(f"zebrat {arguments.command}: {error}", file=sys.stderr)
            return 2
        except OSError as error:
            if not _cannot_write(error, arguments):
                return _ours(error, arguments)
            said = f"{error.strerror}: {shown(error.filename)}" if error.filename else error.strerror
            print(f"zebrat {arguments.command}: cannot be written: {said}; name another place", file=sys.stderr)
            return 2
        except KeyboardInterrupt:
            print(f"zebrat {arguments.command}: stopped", file=sys.stderr)
            return 130
        except Exception as error:
            if isinstance(error, ModuleNotFoundError) and not str(error.name).startswith("zebrat_bullet"):
                if arguments.debug:
                    raise
                print(
                    f"zebrat {arguments.command}: needs {error.name}, which is not installed: pip install "
                    "zebrat-bullet, with all it depends on",
                    file=sys.stderr,
                )
                return 2
            return _ours(error, arguments)
        return _say(json.dumps(result) if arguments.json else text, stdout, arguments.command) or status


def _say(text: str, stdout: TextIO, command: str) -> int:
    """Print what a command returns; the work is done, whoever has stopped to listen. Return 2 if it finds no room."""
    try:
        print(text, file=stdout, flush=True)
    except OSError as error:
        with open(os.devnull, "w", encoding="utf-8") as nowhere:
            os.dup2(nowhere.fileno(), stdout.fileno())  # for what is left of it
        if not isinstance(error, BrokenPipeError):
            print(f"zebrat {command}: standard output cannot be written: {error.strerror}", file=sys.stderr)
            return 2
    return 0


def parse(argv: list[str]) -> argparse.Namespace:
    """Return the options of a call, and in `given` the names of those that are there, be it with their default."""
    arguments = make_parser().parse_args(argv)
    no_value: list[str] = []  # a list, for options that add to one
    again = argparse.Namespace(**dict.fromkeys(vars(arguments), no_value))
    arguments.parser.parse_args(argv[1:], again)
    arguments.given = {name for name, value in vars(again).items() if value is not no_value}
    return arguments


def _ours(error: Exception, arguments: argparse.Namespace) -> int:
    """Say that an error is ours, or raise it with --debug; return the status."""
    if arguments.debug:
        raise error
    said = " ".join(shown(error, 500).split())
    print(
        f"zebrat {arguments.command}: this is a bug of ours: {type(error).__name__}: {said}; "
        "run it again with --debug for the traceback, and send us that",
        file=sys.stderr,
    )
    return 3


def _cannot_write(error: OSError, arguments: argparse.Namespace) -> bool:
    """Return whether a path to write, or a folder above it, is none that can be written, or the disk is full.

    A file is first written beside its place, under a name of its own.
    """
    if error.errno == errno.ENOSPC:
        return True
    if error.errno not in _NOT_WRITABLE or not isinstance(error.filename, str):
        return False
    named = Path(error.filename).resolve()
    wanted = [at.resolve() for at in map(vars(arguments).get, _WRITTEN) if isinstance(at, Path)]
    # What is missing in a folder that is there is for us to write, and so our mistake.
    inside = error.errno != errno.ENOENT
    return any(
        at.is_relative_to(named)
        or (inside and named.is_relative_to(at))
        or (inside and named.parent == at.parent and _PART.fullmatch(named.name) and at.stem in named.name)
        for at in wanted
    )


@contextmanager
def _real_stdout() -> Iterator[TextIO]:
    """Yield the true standard output while all else that is written there, PyBullet's greeting too, goes to stderr."""
    if sys.stdout is None:  # closed by the caller
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        sys.stdout = os.fdopen(1, "w", closefd=False)
    sys.stdout.flush()
    saved = os.dup(1)
    os.dup2(2, 1)
    try:
        with os.fdopen(os.dup(saved), "w", errors="backslashreplace") as stream:  # a locale may lack a letter
            yield stream
    finally:
        sys.stdout.flush()
        os.dup2(saved, 1)
        os.close(saved)


def _common_options() -> argparse.ArgumentParser:
    made = argparse.ArgumentParser(add_help=False)
    made.add_argument("--json", action="store_true", help="print one JSON object as the last line")
    made.add_argument("--seed", type=whole_number, default=0, help="seed of everything random (default 0)")
    made.add_argument("--out", type=Path, help="file or folder to write")
    made.add_argument("--debug", action="store_true", help="a traceback where the program itself fails")
    made.add_argument("--quiet", action="store_true", help="no progress")
    return made


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of every command: what `zebrat --help` and the reference page show."""
    parser = argparse.ArgumentParser(prog="zebrat", description="Learn to drive out of narrow spaces.")
    parser.add_argument("--version", action="version", version=__version__)
    commands = parser.add_subparsers(dest="command", required=True)

    def command(run: Run, *parents: argparse.ArgumentParser, car: bool = True) -> argparse.ArgumentParser:
        # Made anew: a command may change its defaults.
        all_of = (_common_options(), *((robot_options(),) if car else ()), *parents)
        made = commands.add_parser(run.__name__, parents=all_of, help=run.__doc__, description=run.__doc__)
        made.set_defaults(run=run, parser=made)
        return made

    for commands_of_a_kind in (
        learning,
        sweep,
        curves,
        driving,
        playing,
        export,
        worlds,
        bench,
        width,
        robustness,
        held_out,
        families,
        parity,
        recording,
        ros,
        collisions,
        comparison,
    ):
        commands_of_a_kind.add(command)
    return parser
