"""What the commands share: options, progress, notes. Like all of `cli`, it loads with numpy alone."""

import argparse
import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from zebrat_bullet.config import (
    CASTERS,
    ENGINES,
    FOOTPRINTS,
    RANDOM_DYNAMICS,
    REWARD_PRESETS,
    VLP16_NOISE,
    TaskConfig,
    with_engine,
    with_reward,
)
from zebrat_bullet.deploy.supervisor import MARGIN_M
from zebrat_bullet.errors import ConfigError, ZebratError
from zebrat_bullet.files import shown

if TYPE_CHECKING:
    from rich.progress import Progress

_DIGITS = 18
"""Of a whole number; more would not fit into the 64 bits that a record has for it."""

TRACKS = ("big_track", *(f"track_{i}" for i in range(1, 9)))

_ENGINE_NAMES = {"bullet": "PyBullet", "mujoco": "MuJoCo"}

Result = tuple[Mapping[str, object], str]
"""What a command returns: its results for --json, and a text for people."""


class PartialResultError(ZebratError):
    """A command did only part of its work.

    Args:
        message: what is missing.
        result: what there is, printed all the same.
    """

    def __init__(self, message: str, result: Result) -> None:
        super().__init__(message)
        self.result = result


class Run(Protocol):
    """A command: its name and docstring are what the command line shows."""

    __name__: str

    def __call__(self, arguments: argparse.Namespace) -> Result:
        """Run it."""


class AddCommand(Protocol):
    """Makes the parser of a command."""

    def __call__(self, run: Run, *parents: argparse.ArgumentParser) -> argparse.ArgumentParser:
        """Return it, with the options of its parents."""


def whole_number(text: str) -> int:
    """Return what an option says that takes a whole number from 0 up: a seed, the number of an episode, a count.

    Raises:
        ArgumentTypeError: it says something else.
    """
    if not (text.isascii() and text.isdecimal()) or len(text) > _DIGITS:
        raise argparse.ArgumentTypeError(
            f"takes a whole number from 0 up, of at most {_DIGITS} digits, got {shown(text)!r}"
        )
    return int(text)


def robot_options() -> argparse.ArgumentParser:
    """Return the options of the car."""
    made = argparse.ArgumentParser(add_help=False)
    made.add_argument("--robot", default="zebrat", help="URDF or xacro file, or name of a shipped car (default zebrat)")
    made.add_argument(
        "--joints",
        nargs="+",
        action="extend",
        default=[],
        metavar="ROLE=NAME",
        help="which joint of the URDF is what, e.g. left_rear_wheel_joint=rl_wheel lidar_mount=laser; also numbers "
        "that it lacks: steering_limit_rad=0.5 (docs/your_own_car.md; or CAR.roles.yaml beside it)",
    )
    made.add_argument(
        "--footprint",
        choices=FOOTPRINTS,
        help="outline of the body: of its collision shapes, the hull of all shapes, or whichever covers it (auto)",
    )
    return made


def robot_settings(arguments: argparse.Namespace) -> list[str]:
    """Return what the options say of the car's URDF."""
    return [*arguments.joints, *([f"footprint={arguments.footprint}"] if arguments.footprint else [])]


def name_robot(arguments: argparse.Namespace) -> None:
    """Make one name, good for any folder, of --robot and what other options say of it.

    Raises:
        AssetError, RobotError: there is no such car, or no such setting of one.
        ConfigError: settings without a car.
    """
    settings = robot_settings(arguments)
    if arguments.robot is not None:
        from zebrat_bullet.robot import named_robot

        arguments.robot = named_robot(arguments.robot, settings)
    elif settings:
        raise ConfigError(f"{' '.join(settings)} says something of a car, but of which? Give --robot FILE too")


def task_options() -> argparse.ArgumentParser:
    """Return the options of the senses."""
    made = argparse.ArgumentParser(add_help=False)
    made.add_argument(
        "--caster",
        choices=CASTERS,
        help="ray caster of the lidar: embree, or that of the engine, bullet or mujoco (default)",
    )
    made.add_argument("--noise", type=float, default=0.0, help="lidar range noise, sigma in m")
    return made


def reward_options() -> argparse.ArgumentParser:
    """Return the option of the reward."""
    made = argparse.ArgumentParser(add_help=False)
    made.add_argument("--reward", choices=tuple(REWARD_PRESETS), default="fomt", help="reward preset")
    return made


def agents_option() -> argparse.ArgumentParser:
    """Return the option of one agent or several."""
    made = argparse.ArgumentParser(add_help=False)
    made.add_argument(
        "--agent",
        required=True,
        nargs="+",
        help="shipped, il, dagger, dwa, dwa_tuned, teb:inflation_radius_m=0.5, oracle, a policy file, a run folder",
    )
    return made


def sim_option() -> argparse.ArgumentParser:
    """Return the option of the simulator where planar cars may drive too."""
    made = argparse.ArgumentParser(add_help=False)
    made.add_argument(
        "--sim",
        choices=("planar", *ENGINES),
        help="what drives: planar cars (default, policies alone), PyBullet, or the second engine, MuJoCo. `evaluate`: "
        "planar cars drive only --set and --generated, PyBullet is the default in --worlds",
    )
    return made


def engine_option() -> argparse.ArgumentParser:
    """Return the option of the engine where planar cars do not drive."""
    made = argparse.ArgumentParser(add_help=False)
    made.add_argument("--sim", choices=ENGINES, default="bullet", help="engine: PyBullet (default) or MuJoCo")
    return made


def workers_option() -> argparse.ArgumentParser:
    """Return the option of how many processes share the work."""
    made = argparse.ArgumentParser(add_help=False)
    made.add_argument("--workers", type=int, help="processes (default: one a core)")
    return made


def noisy_options() -> argparse.ArgumentParser:
    """Return the option of noise on the commands."""
    made = argparse.ArgumentParser(add_help=False)
    made.add_argument("--action-noise", type=float, default=0.0, help="sigma on the commands, fraction of the limits")
    return made


def supervised_option() -> argparse.ArgumentParser:
    """Return the option of a supervisor between agent and car."""
    made = argparse.ArgumentParser(add_help=False)
    made.add_argument(
        "--supervised",
        nargs="?",
        type=float,
        const=MARGIN_M,
        metavar="MARGIN_M",
        help="commands go through the supervisor of the real car, which stops it before anything is nearer than this "
        f"(default {MARGIN_M:g} m)",
    )
    return made


def randomise_option() -> argparse.ArgumentParser:
    """Return the option of cars and sensors that differ from what is written of them."""
    made = argparse.ArgumentParser(add_help=False)
    made.add_argument(
        "--randomise",
        action="store_true",
        help="dynamics drawn for each episode (RANDOM_DYNAMICS) and the noise of a VLP-16",
    )
    return made


def place_options() -> argparse.ArgumentParser:
    """Return the options of where the car begins and ends in one world."""
    made = argparse.ArgumentParser(add_help=False)
    made.add_argument(
        "--start", nargs=3, type=float, metavar=("X", "Y", "YAW"), help="begin there: m, m and degrees, 90 along y"
    )
    made.add_argument("--goal", nargs=2, type=float, metavar=("X", "Y"), help="what is to be reached, in m")
    made.add_argument(
        "--exit",
        nargs=4,
        type=float,
        metavar=("X1", "Y1", "X2", "Y2"),
        help="both ends of the line over which a mesh or map is left, in m",
    )
    return made


def placed(arguments: argparse.Namespace, worlds: Sequence[str]) -> list[str]:
    """Return the worlds with the start, goal and exit of the options, which go with one world."""
    from zebrat_bullet.world.reference import parse_reference

    start, goal, exit = arguments.start, arguments.goal, arguments.exit
    if start is None and goal is None and exit is None:
        return list(worlds)
    if len(worlds) != 1:
        raise ConfigError(f"--start, --goal and --exit go with one world, got {len(worlds)}; name one")
    reference = parse_reference(str(worlds[0])).with_places(
        start=None if start is None else (start[0], start[1], math.radians(start[2])),
        goal=goal,
        exit=None if exit is None else (exit[:2], exit[2:]),
    )
    return [str(reference)]


def task_of(arguments: argparse.Namespace) -> TaskConfig:
    """Return the task that the options describe.

    Raises:
        ConfigError: its engine is not installed, or --caster casts in the other.
    """
    task = engine_task_of(arguments)
    require_own_caster(arguments, task)
    return task


def require_own_caster(arguments: argparse.Namespace, task: TaskConfig) -> None:
    """Refuse a ray caster that casts in another engine than the one that drives; planar cars cast with neither.

    Args:
        arguments: the options.
        task: what they describe, with all that --set says.

    Raises:
        ConfigError: it does.
    """
    sim, caster, engine = getattr(arguments, "sim", None), task.lidar.caster, task.physics.engine
    if sim == "planar" or caster not in ENGINES or caster == engine:
        return
    instead = f"--caster {engine} or embree" + (f", or --sim {caster}" if sim else "")
    raise ConfigError(
        f"--caster {caster} casts its rays in {_ENGINE_NAMES[caster]}, but {_ENGINE_NAMES[engine]} drives; "
        f"give {instead}"
    )


def engine_task_of(arguments: argparse.Namespace) -> TaskConfig:
    """Return the task that the options describe, upon which more is put: `require_own_caster` is asked then.

    Raises:
        ConfigError: its engine is not installed.
    """
    from zebrat_bullet.sim.engine import require_engine

    task = with_reward(TaskConfig(robot=arguments.robot or TaskConfig().robot), arguments.reward)
    engine = "mujoco" if getattr(arguments, "sim", "") == "mujoco" else task.physics.engine
    require_engine(engine)
    task = with_engine(task, engine)
    task = replace(task, lidar=replace(task.lidar, caster=arguments.caster or task.lidar.caster))
    if getattr(arguments, "anywhere", False):
        task = replace(task, episode=replace(task.episode, start="anywhere"))
    if getattr(arguments, "randomise", False):
        task = replace(task, noise=VLP16_NOISE, dynamics=RANDOM_DYNAMICS)
    return replace(task, noise=replace(task.noise, range_sigma_m=arguments.noise)) if arguments.noise else task


def own_task_of(arguments: argparse.Namespace, agent: str) -> TaskConfig:
    """Return the task that the options describe, with car, senses and limits as an agent was trained with.

    What --robot and --set say goes before; where the agent's own differ from the default is noted.

    Raises:
        ConfigError: its engine is not installed, or --caster casts in the other.
    """
    from zebrat_bullet.config_text import with_overrides
    from zebrat_bullet.evaluation.own_task import as_trained

    task, differing = as_trained(engine_task_of(arguments), agent, own_robot=arguments.robot is None)
    if differing:
        note(arguments, f"{agent} is judged under the task that it was trained on: {', '.join(differing)}")
    task = with_overrides(task, [text.removeprefix("task.") for text in arguments.set_task])
    require_own_caster(arguments, task)
    return task


def of_engine(arguments: argparse.Namespace) -> str:
    """Return what keeps the results of the second engine apart where --out is left out."""
    return "-mujoco" if arguments.sim == "mujoco" else ""


def file_name(agent: str) -> str:
    """Return an agent's name or path as part of a file name."""
    return Path(agent).name.removesuffix(".safetensors").replace(":", "-").replace(",", "-")


def note(arguments: argparse.Namespace, message: str) -> None:
    """Say something on standard error, unless --quiet."""
    if not arguments.quiet:
        print(message, file=sys.stderr)


def progress_bar(arguments: argparse.Namespace) -> "Progress":
    """Return a progress bar on standard error, disabled by --quiet."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    return Progress(*columns, console=Console(stderr=True), disable=arguments.quiet)
