"""The command for a person who draws: play."""

import argparse
import sys

from zebrat_bullet.cli.common import AddCommand, Result, task_of
from zebrat_bullet.cli.options import task_options


def play(arguments: argparse.Namespace) -> Result:
    """Draw a passage in a browser, learn whether it can be driven, and watch a policy drive it."""
    from zebrat_bullet.play.session import play

    play(
        task_of(arguments),
        agents=arguments.agent,
        host=arguments.host,
        port=arguments.port,
        seed=arguments.seed,
        limit_s=arguments.limit_s,
        on_ready=lambda url: print(f"draw at {url} (Ctrl-C ends)", file=sys.stderr, flush=True),
    )
    return {}, "nothing is kept but what you have downloaded"


def add(command: AddCommand) -> None:
    """Add the commands of this file."""
    made = command(play, task_options())
    made.set_defaults(caster="embree", reward="fomt")
    made.add_argument(
        "--agent", nargs="+", default=[], help="who drives: one of the shipped, a policy file, a run folder; several"
    )
    made.add_argument("--host", default="127.0.0.1", help="address to listen on (default: this machine only)")
    made.add_argument("--port", type=int, default=8766, help="port to listen on, 0 for any that is free (default 8766)")
    made.add_argument(
        "--limit-s", type=float, default=30.0, help="most time of the search for a way out, s (default 30)"
    )
