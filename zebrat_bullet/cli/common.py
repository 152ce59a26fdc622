"""What the commands share: results, the task that options describe, progress, notes. It loads with numpy alone."""

import argparse
import math
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from zebrat_bullet.config import (
    ENGINES,
    RANDOM_DYNAMICS,
    VLP16_NOISE,
    TaskConfig,
    with_engine,
    with_reward,
)
from zebrat_bullet.errors import ConfigError, ZebratError

if TYPE_CHECKING:
    from rich.progress import Progress

TRACKS = ("big_track", *(f"track_{i}" for i in range(1, 9)))

_PICTURES = (".png", ".svg", ".pdf", ".jpg")
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

    def __call__(self, run: Run, *parents: argparse.ArgumentParser, car: bool = True) -> argparse.ArgumentParser:
        """Return it, with the options of its parents, and with those of the car unless it takes none."""


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


def require_default(arguments: argparse.Namespace, name: str) -> None:
    """Raise unless what an option names is there, where it was left out: its default lies in a checkout alone."""
    path = Path(getattr(arguments, name))
    if name not in arguments.given and not path.exists():
        raise ConfigError(f"{path} of a checkout is not here; run it in a checkout, or name another with --{name}")


def given(arguments: argparse.Namespace, names: Iterable[str]) -> list[str]:
    """Return those of the options that were given, as they are written.

    Args:
        arguments: the options.
        names: their names there: n_cars for --n-cars.
    """
    return [f"--{name.replace('_', '-')}" for name in names if name in arguments.given]


def require_no_settings(arguments: argparse.Namespace, folder: Path, *naming: str) -> None:
    """Refuse what would say how a run is to be, where it goes on as it was begun.

    Args:
        arguments: the options of a command that has --resume.
        folder: of the run.
        naming: options that name the folder where --out is left out.

    Raises:
        ConfigError: an option is there that could not be heeded.
    """
    heeded = {"resume", "out", "json", "quiet", "debug", *(naming if arguments.out is None else ())}
    if others := given(arguments, [name for name in vars(arguments) if name not in heeded]):
        raise ConfigError(
            f"--resume goes on with the settings in {folder}, so {', '.join(others)} cannot change them; leave that "
            "out, or begin anew in another folder"
        )


def placed(arguments: argparse.Namespace, worlds: Sequence[str]) -> list[str]:
    """Return the worlds with the start, goal and exit of the options, which go with one world."""
    from zebrat_bullet.world.reference import parse_reference

    start, goal, exit = arguments.start, arguments.goal, arguments.exit
    if start is None and goal is None and exit is None:
        return list(worlds)
    if len(worlds) != 1:
        raise ConfigError(f"--start, --goal and --exit go with one world, got {len(worlds)}; name one")
    reference = parse_reference(str(worlds[0])).with_places(
        start=None if start is None else (start[0], start[1], math.radians(math.fmod(start[2], 360.0))),
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


def take_own_robot(arguments: argparse.Namespace) -> None:
    """Put the car that the agents were trained on where --robot was left out; of another than the default tell.

    For commands that measure all agents on one car.

    Raises:
        ConfigError: they were trained on several.
        ZebratError: an agent cannot be loaded.
    """
    if arguments.robot is not None:
        return
    from zebrat_bullet.agents import trained_task

    trained = {agent: task.robot for agent in arguments.agent if (task := trained_task(agent)) is not None}
    if len(set(trained.values())) > 1:
        said = ", ".join(f"{agent} on {robot}" for agent, robot in trained.items())
        raise ConfigError(
            f"the agents were trained on several cars, {said}; measure one of them at a time, or on --robot"
        )
    arguments.robot = next(iter(trained.values()), TaskConfig().robot)
    if arguments.robot != TaskConfig().robot:
        note(arguments, f"the car is that which {next(iter(trained))} was trained on: {arguments.robot}")


def of_engine(arguments: argparse.Namespace) -> str:
    """Return what keeps the results of the second engine apart where --out is left out."""
    return "-mujoco" if arguments.sim == "mujoco" else ""


def file_name(agent: str) -> str:
    """Return an agent's name or path as part of a file name."""
    return Path(agent).name.removesuffix(".safetensors").replace(":", "-").replace(",", "-")


def file_names(agents: Sequence[str]) -> dict[str, str]:
    """Return `file_name` of each agent; of all with their folders where two would be alike."""
    names = {agent: file_name(agent) for agent in agents}
    if len(set(names.values())) == len(names):
        return names
    return {agent: file_name(agent.replace("/", "-")) for agent in names}


def picture(path: Path) -> Path:
    """Return where a picture is to be written.

    Raises:
        ConfigError: its ending is of no picture that can be.
    """
    if path.suffix not in _PICTURES:
        raise ConfigError(f"{path} is to be a picture: end it in {', '.join(_PICTURES)}")
    return path


def note(arguments: argparse.Namespace, message: str) -> None:
    """Say something on standard error, unless --quiet."""
    if not arguments.quiet:
        print(message, file=sys.stderr)


@contextmanager
def told_when_stopped(arguments: argparse.Namespace, message: str) -> Iterator[None]:
    """Say on standard error what is left of the work in this block, should Ctrl-C end it."""
    try:
        yield
    except KeyboardInterrupt:
        note(arguments, message)
        raise


def progress_bar(arguments: argparse.Namespace) -> "Progress":
    """Return a progress bar on standard error, disabled by --quiet."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    return Progress(*columns, console=Console(stderr=True), disable=arguments.quiet)
