"""A driver of the user's own, out of a Python file: FILE.py:NAME."""

import hashlib
import importlib.util
import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

from zebrat_bullet.agents.agent import PRIVILEGES, Agent
from zebrat_bullet.arrays import is_refused_write
from zebrat_bullet.config import TaskConfig
from zebrat_bullet.errors import ActionError, AssetError, ConfigError, ZebratError
from zebrat_bullet.files import is_file, shown
from zebrat_bullet.sim.ackermann import in_floats
from zebrat_bullet.types import Command, Reading

_HAS_TO = "an agent has name, privileged, reset(seed) and act(reading) (docs/compare.md)"


class OwnAgent:
    """A driver from a file, each of whose mistakes is told by the file's name and line.

    Args:
        agent: what decides.
        path: the file.
        name: what in the file made it.

    Attributes:
        digest: first digits of the SHA-256 of the file, and of the driver's own `digest` where it has one: one that was
            edited, or says that it is another, is another driver.
    """

    def __init__(self, agent: Agent, path: Path, name: str) -> None:
        self._agent, self._path, self._named = agent, path, f"{path}:{name}"
        with _told(path, "the agent"):
            missing = [part for part in ("name", "privileged", "reset", "act") if not hasattr(agent, part)]
            called, privileged = getattr(agent, "name", ""), getattr(agent, "privileged", ())
            own = str(getattr(agent, "digest", ""))
        if missing:
            raise ConfigError(f"{path}: {type(agent).__name__} has no {', '.join(missing)}; {_HAS_TO}")
        if not isinstance(privileged, set | frozenset) or not privileged <= PRIVILEGES:
            raise ConfigError(
                f"{path}: privileged is {shown(privileged)}; it is a set of {', '.join(sorted(PRIVILEGES))}, "
                "empty for none"
            )
        self.name, self.privileged = str(called), frozenset(privileged)
        self.digest = hashlib.sha256(path.read_bytes() + own.encode()).hexdigest()[:8]

    def reset(self, seed: int) -> None:
        """Reset the agent.

        Raises:
            ConfigError: its code fails.
        """
        with _told(self._path, "reset"):
            self._agent.reset(seed)

    def act(self, reading: Reading) -> Command:
        """Return the agent's command.

        Raises:
            ConfigError: its code fails, or what it returns is no command.
        """
        with _told(self._path, "act"):
            command = self._agent.act(reading)
        if not isinstance(command, Command):
            raise ConfigError(
                f"{self._named}: act returned {shown(command)}; return a Command(speed_mps, steering_rad) of "
                "zebrat_bullet.types"
            )
        try:
            return in_floats(command)
        except ActionError as error:
            raise ConfigError(
                f"{self._named}: act returned {shown(command)}: speed and steering angle are finite numbers, in m/s "
                "and rad; mend it"
            ) from error


def load_own(file_and_name: str, task: TaskConfig) -> OwnAgent:
    """Return a driver from a file, which is run for it: NAME(task), of a class or a function there.

    What lies beside the file can be imported while it runs, by no other driver than its own.

    Args:
        file_and_name: FILE.py:NAME.
        task: what it will drive in.

    Raises:
        AssetError: there is no such file, or no such name in it; the message lists those there are.
        ConfigError: the file or what it names fails, or that is no agent.
    """
    file, _, name = file_and_name.partition(":")
    path = Path(file)
    if not is_file(path):
        raise AssetError(f"no file {shown(file)}, named by --agent {shown(file_and_name)}; it is FILE.py:NAME")
    with _neighbours(path.resolve().parent):
        return _loaded(path, name, task)


def _loaded(path: Path, name: str, task: TaskConfig) -> OwnAgent:
    module = _module(path)
    make: Any = vars(module).get(name)
    if not callable(make):
        there = [key for key, at in vars(module).items() if getattr(at, "__module__", "") == module.__name__]
        raise AssetError(
            f"{path} has no class or function {shown(name)!r} that makes an agent; there are "
            f"{', '.join(there) or 'none'}: --agent {path}:NAME"
        )
    with _told(path, f"{name}(task)"):
        agent = make(task)
    return OwnAgent(agent, path, name)


def _module(path: Path) -> ModuleType:
    """Run a file and return it as a module."""
    name = "zebrat_own_" + hashlib.sha256(bytes(path.resolve())).hexdigest()[:16]
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # where dataclasses look for it
    with _told(path, "the file"):
        spec.loader.exec_module(module)
    return module


@contextmanager
def _neighbours(folder: Path) -> Iterator[None]:
    """Let what lies in a folder be imported, and forget it afterwards: another driver's may have the same names."""
    before = set(sys.modules)
    sys.path.insert(0, str(folder))
    try:
        yield
    finally:
        sys.path.remove(str(folder))
        new = {name: name.partition(".")[0] for name in set(sys.modules) - before}
        for name in [name for name, top in new.items() if top not in before and _lies_in(top, folder)]:
            del sys.modules[name]


def _lies_in(module: str, folder: Path) -> bool:
    file = getattr(sys.modules.get(module), "__file__", None) or ""
    return file in (str(folder / f"{module}.py"), str(folder / module / "__init__.py"))


@contextmanager
def _told(path: Path, what: str) -> Iterator[None]:
    """Tell what the user's code raises by file and line."""
    try:
        yield
    except ZebratError:
        raise
    except (Exception, SystemExit) as error:
        frames = traceback.extract_tb(error.__traceback__)
        lines = [frame.lineno for frame in frames if Path(frame.filename).resolve() == path.resolve()]
        line = error.lineno if isinstance(error, SyntaxError) else lines[-1] if lines else None
        where = f", line {line}" if line is not None else ""
        remedy = "compute on a copy of what it is given: array.copy()" if is_refused_write(error) else "mend it"
        raise ConfigError(
            f"{path}{where}: {what} fails: {type(error).__name__}: {shown(error, 300)}; {remedy}"
        ) from error
