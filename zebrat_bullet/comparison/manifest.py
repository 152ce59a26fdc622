"""The manifest of a comparison: which runs and judgements, and what of them each budget does; one YAML file."""

import json
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from pydantic import ConfigDict

from zebrat_bullet.config_text import from_json
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.files import read_yaml, refusing, shown

SHIPPED = Path(__file__).with_name("manifest.yaml")
Study = Literal["paper", "scale", "paper-at-scale", "finetuning"]
_EXACT = ConfigDict(extra="forbid")


@dataclass(frozen=True, kw_only=True)
class Training:
    """Runs that differ in algorithm, reward and seed; a sweep, as `zebrat sweep` has it.

    Attributes:
        study: which of the paper's questions it answers.
        asked: its length in words, for people.
        algos, rewards, preset, set: as in `zebrat sweep`.
        variant: what it has beside the study's plain runs, such as "crash"; empty for those.
        seeds: those of a budget's that it has; none: all of them.
        init: name of another training; each algorithm and reward begins with the best model of its runs there.
        kept: a folder or zip archive of run folders that exist: finished ones are not run again.
        kept_seeds: of these, in every budget that does not cut the training short.
        policies: of kept runs, a folder of those policies that can be judged: RUN.safetensors.
    """

    __pydantic_config__ = _EXACT

    study: Study
    asked: str
    algos: tuple[str, ...] = ("ddpg",)
    rewards: tuple[str, ...] = ("fomt",)
    preset: str = "paper"
    variant: str = ""
    seeds: tuple[int, ...] = ()
    set: tuple[str, ...] = ()
    init: str = ""
    kept: str = ""
    kept_seeds: tuple[int, ...] = ()
    policies: str = ""

    def __post_init__(self) -> None:
        _check_seeds(self.seeds)

    def seeds_of(self, wanted: Sequence[int]) -> tuple[int, ...]:
        """Return the seeds that it has in a budget that wants these."""
        return tuple(seed for seed in wanted if not self.seeds or seed in self.seeds)

    def setting(self, algo: str) -> str:
        """Return what tells a judged policy from others of the same study and reward."""
        length = self.asked if self.study == "paper-at-scale" else ""
        return ", ".join(filter(None, [algo if len(self.algos) > 1 else "", self.variant, length]))


@dataclass(frozen=True, kw_only=True)
class Driver:
    """An agent that is not trained here.

    Attributes:
        method: the paper's name for what it is: DWA, TEB, IL, oracle, ...
        agent: as `--agent` takes it; paths begin in the checkout.
        setting: what tells it from others of its method.
        study: "rivals", or that of the policy's training.
    """

    __pydantic_config__ = _EXACT

    method: str
    agent: str
    setting: str = ""
    study: Literal["rivals"] | Study = "rivals"


@dataclass(frozen=True, kw_only=True)
class Judgement:
    """What drives where, how often.

    Attributes:
        trainings: names; of each algorithm and reward there the best of its seeds drives, or every one.
        seeds: "best" by the runs' own noise-free evaluations, or "every": the budget's, and kept ones with policies.
        drivers: agents that are not trained here.
        worlds, sets: where; of sets `tracks` tracks, drawn from the seed (none: all).
        sim: "bullet", "mujoco", or for sets "planar".
        episodes: in each world or track.
        seed: of the episodes.
        noise: in words, "" for none; the options that make it are in `options`.
        options: more of `zebrat evaluate`.
    """

    __pydantic_config__ = _EXACT

    trainings: tuple[str, ...] = ()
    seeds: Literal["best", "every"] = "best"
    drivers: tuple[Driver, ...] = ()
    worlds: tuple[str, ...] = ()
    sets: tuple[str, ...] = ()
    tracks: int | None = None
    sim: Literal["bullet", "mujoco", "planar"] = "bullet"
    episodes: int
    seed: int = 0
    noise: str = ""
    options: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not (self.trainings or self.drivers) or bool(self.worlds) == bool(self.sets):
            raise ConfigError("a judgement names trainings or drivers, and either worlds or sets")
        if self.sim == "planar" and self.worlds:
            raise ConfigError("planar cars drive sets, not worlds: name sets, or another sim")
        if self.episodes < 1 or self.seed < 0 or (self.tracks is not None and self.tracks < 1):
            raise ConfigError("episodes and tracks are at least 1, the seed at least 0")


@dataclass(frozen=True, kw_only=True)
class Share:
    """What a budget does of a judgement; None: all of it."""

    __pydantic_config__ = _EXACT

    trainings: tuple[str, ...] | None = None
    drivers: tuple[str, ...] | None = None
    worlds: tuple[str, ...] | None = None
    sets: tuple[str, ...] | None = None
    tracks: int | None = None
    episodes: int | None = None


@dataclass(frozen=True, kw_only=True)
class Contacts:
    """A collision study: contacts to drive for, and more options of `zebrat collisions`."""

    __pydantic_config__ = _EXACT

    events: int
    options: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.events < 1:
            raise ConfigError(f"events are at least 1, got {self.events}")


@dataclass(frozen=True, kw_only=True)
class Budget:
    """How much of the manifest is run.

    Attributes:
        about: in a sentence.
        seeds: of every training, but where that has fewer of its own.
        trainings: those that are run, each with settings that cut it short (none: as the manifest has it).
        judgements: those that are driven, each with what is done of it.
        collisions: the collision study that is driven; None for none.
        records: a folder of tables, "" for none: judged episodes that are kept there are not driven again.
    """

    __pydantic_config__ = _EXACT

    about: str
    seeds: tuple[int, ...]
    trainings: dict[str, tuple[str, ...]] = field(default_factory=dict)
    judgements: dict[str, Share] = field(default_factory=dict)
    collisions: Contacts | None = None
    records: str = ""

    def __post_init__(self) -> None:
        if not self.seeds:
            raise ConfigError("seeds are whole numbers from 0 up, at least one; got none")
        _check_seeds(self.seeds)


@dataclass(frozen=True, kw_only=True)
class Manifest:
    """Everything that a comparison can be.

    Attributes:
        collisions: a folder with the cases.csv of a collision study that exists, used where a budget drives none.
        trainings, judgements, budgets: by name.
    """

    __pydantic_config__ = _EXACT

    trainings: dict[str, Training]
    judgements: dict[str, Judgement]
    budgets: dict[str, Budget]
    collisions: str = ""

    def __post_init__(self) -> None:
        for name, training in self.trainings.items():
            if training.init:
                _known(f"trainings.{name}.init", [training.init], self.trainings)
        for name, judgement in self.judgements.items():
            _known(f"judgements.{name}.trainings", judgement.trainings, self.trainings)
        for name, budget in self.budgets.items():
            _known(f"budgets.{name}.trainings", budget.trainings, self.trainings)
            for part in budget.trainings:
                if not self.trainings[part].seeds_of(budget.seeds):
                    seeds = f"budgets.{name}.seeds are {list(budget.seeds)}"
                    raise ConfigError(f"{seeds}, and none is among trainings.{part}.seeds, which budgets.{name} runs")
            _known(f"budgets.{name}.judgements", budget.judgements, self.judgements)
            for part, share in budget.judgements.items():
                whole = self.judgements[part]
                where = f"budgets.{name}.judgements.{part}"
                _known(f"{where}.trainings", share.trainings or (), whole.trainings)
                _known(f"{where}.drivers", share.drivers or (), [driver.agent for driver in whole.drivers])
                _known(f"{where}.worlds", share.worlds or (), whole.worlds)
                _known(f"{where}.sets", share.sets or (), whole.sets)

    def budget(self, name: str) -> Budget:
        """Return a budget by name.

        Raises:
            ConfigError: there is none; the message lists those there are.
        """
        if name not in self.budgets:
            raise ConfigError(f"no budget {shown(name)!r}; there are {', '.join(self.budgets)}")
        return self.budgets[name]


def _check_seeds(seeds: Sequence[int]) -> None:
    if len(set(seeds)) != len(seeds) or min(seeds, default=0) < 0:
        raise ConfigError(f"seeds are whole numbers from 0 up, each once; got {list(seeds)}")


def _known(where: str, names: Iterable[str], known: Collection[str]) -> None:
    wrong = [name for name in names if name not in known]
    if wrong:
        raise ConfigError(f"{where} names {shown(wrong[0])!r}; there are {', '.join(known) or 'none'}")


def read_manifest(path: Path = SHIPPED) -> Manifest:
    """Read a manifest.

    Raises:
        ConfigError: it cannot be read, or names what there is not; the message names the file and the place in it.
    """
    with refusing(path, ConfigError, "is no manifest of a comparison", "mend what it names (docs/reproduce.md)"):
        return from_json(Manifest, json.dumps(read_yaml(path, ConfigError)))
