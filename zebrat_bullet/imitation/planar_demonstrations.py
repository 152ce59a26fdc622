"""The oracle drives planar cars on generated tracks, by the thousand, and its commands are kept to be imitated.

A perfect drive shows no recoveries. So the car may be disturbed while the label stays the oracle's own command: by
noise (DART, Laskey et al. 2017), or by a learner that drives in its stead (DAgger, Ross et al. 2011).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from zebrat_bullet.agents import load_agent
from zebrat_bullet.agents.oracle import OracleAgent
from zebrat_bullet.agents.policy import PolicyAgent
from zebrat_bullet.config import TaskConfig, within
from zebrat_bullet.errors import ConfigError, ZebratError
from zebrat_bullet.evaluation.claim import claim_data_set
from zebrat_bullet.evaluation.csv_log import CsvLog
from zebrat_bullet.files import is_file, refusing
from zebrat_bullet.imitation.demonstration import SUFFIX, Demonstration, save_demonstrations
from zebrat_bullet.imitation.labelled_drive import Disturbance, drive_labelled
from zebrat_bullet.planar.drive import N_STARTS
from zebrat_bullet.processes import in_order
from zebrat_bullet.robot import load_robot
from zebrat_bullet.task.episode import Outcome
from zebrat_bullet.training.settings import VALIDATION_SEED
from zebrat_bullet.world import FAMILIES, check_family, generate_tracks

TRACKS_ABREAST = 64
"""Tracks that are driven together, and kept in one file."""
_COLUMNS = ("first", "tracks", "pairs", *map(str, Outcome))
"""Of `tracks.csv`, a row for each such file: its first seed, how many there are, what came of them."""


@dataclass(frozen=True, kw_only=True)
class Demonstrating:
    """How the oracle demonstrates on generated tracks.

    Attributes:
        agent: the oracle, with settings if any.
        families: of the tracks, in turn.
        episodes: from so many starts of each track.
        action_noise: most noise on what is driven, sigma as a fraction of the limits; each episode draws its own, from
            0 to this. The label stays the oracle's own command.
        task: the task driven.
        seed: of the noise.
    """

    agent: str = "oracle"
    families: tuple[str, ...] = FAMILIES
    episodes: int = 1
    action_noise: float = 0.0
    task: TaskConfig
    seed: int = 0

    def __post_init__(self) -> None:
        within(self, episodes=(1, N_STARTS), action_noise=(0.0, 10.0))
        if not self.families:
            raise ConfigError("families is empty; name at least one family of tracks")
        for family in self.families:
            check_family(family, None)
        _oracle(self)


@dataclass(frozen=True, slots=True)
class Driven:
    """What came of some tracks: the episodes to imitate, and how all that were driven ended."""

    demonstrations: list[Demonstration]
    outcomes: list[Outcome]

    @property
    def n_pairs(self) -> int:
        """Steps to imitate."""
        return sum(len(each.labels) for each in self.demonstrations)


def demonstrate_generated(
    how: Demonstrating,
    n_tracks: int,
    folder: Path,
    workers: int = 1,
    on_pairs: Callable[[int, int], None] = lambda n_tracks, n_pairs: None,
) -> dict[str, int]:
    """Let the oracle drive the generated tracks of the seeds from 0 on, and keep what is to be imitated.

    The same settings give the same files, whatever `workers`; what a kill has left is gone on with.

    Args:
        how: who drives, where and how disturbed.
        n_tracks: so many tracks; a seed that has none is left out.
        folder: where the files go; empty, absent, or with those of the same `how`.
        workers: processes.
        on_pairs: told after each file how many tracks are driven and how many pairs kept.

    Returns:
        "pairs", "tracks", and the number of episodes by outcome, of the files that hold the tracks: of more than
        `n_tracks` where an earlier call asked for more.

    Raises:
        ConfigError: the folder holds something else, or so many tracks there are not.
    """
    if not 1 <= n_tracks <= VALIDATION_SEED:
        raise ConfigError(f"demonstrate on 1 to {VALIDATION_SEED} generated tracks, got {n_tracks}")
    settings = {name: getattr(how, name) for name in ("agent", "families", "episodes", "action_noise", "seed")}
    claim_data_set(folder, how.task, **settings)
    log = CsvLog(folder / "tracks.csv", _COLUMNS)
    with refusing(folder / "tracks.csv", ZebratError, "is no table of tracks", "demonstrate anew in another folder"):
        rows = [{name: int(row[name]) for name in _COLUMNS} for row in log.rows()]
    there = {row["first"]: row for row in rows}
    done = dict.fromkeys(_COLUMNS[1:], 0)

    def count(row: Mapping[str, int]) -> None:
        for name in done:
            done[name] += row[name]
        on_pairs(done["tracks"], done["pairs"])

    missing = []
    for first in range(0, n_tracks, TRACKS_ABREAST):
        seeds = range(first, min(first + TRACKS_ABREAST, n_tracks))
        row = there.get(first, {"tracks": 0})
        if row["tracks"] >= len(seeds) and (row["pairs"] == 0 or is_file(_file_of(folder, first))):
            count(there[first])
        else:
            missing.append(seeds)
    for seeds, driven in zip(missing, in_order(partial(drive_seeds, how), missing, workers), strict=True):
        if driven.demonstrations:
            save_demonstrations(driven.demonstrations, _file_of(folder, seeds[0]))
        else:
            _file_of(folder, seeds[0]).unlink(missing_ok=True)  # of fewer tracks, otherwise disturbed
        ended = {str(outcome): driven.outcomes.count(outcome) for outcome in Outcome}
        row = {"first": seeds[0], "tracks": len(seeds), "pairs": driven.n_pairs, **ended}
        log.append(row)
        count(row)
    return done


def _file_of(folder: Path, first: int) -> Path:
    return folder / f"tracks-{first:06d}{SUFFIX}"


def drive_seeds(
    how: Demonstrating, seeds: Sequence[int], learner: PolicyAgent | None = None, beta: float = 1.0
) -> Driven:
    """Drive the generated tracks of some seeds, all at once, one start after the other.

    Failures that may be the oracle's own are left out: all, where nothing disturbs it; all but collisions, where noise
    does. Where a learner drives they are the learner's.

    Args:
        how: who labels, where and how disturbed.
        seeds: of the tracks.
        learner, beta: as of `Disturbance`.
    """
    worlds = list(generate_tracks(seeds, family=how.families, robot=load_robot(how.task.robot)))
    oracles = [_oracle(how) for _ in worlds]
    disturbance = Disturbance(how.action_noise, learner, beta)
    counted = {Outcome.SUCCESS, Outcome.COLLISION} if how.action_noise else {Outcome.SUCCESS}
    counted = set(Outcome) if learner else counted
    kept: list[Demonstration] = []
    outcomes: list[Outcome] = []
    for start in range(how.episodes):
        rng = np.random.default_rng([how.seed, seeds[0], start])
        episodes, ended = drive_labelled(worlds, oracles, how.task, start, disturbance, rng)
        outcomes += ended
        kept += [each for each, outcome in zip(episodes, ended, strict=True) if outcome in counted and len(each.labels)]
    return Driven(kept, outcomes)


def _oracle(how: Demonstrating) -> OracleAgent:
    if how.agent.partition(":")[0] != "oracle":
        raise ConfigError(
            f"on generated tracks the oracle demonstrates, {how.agent!r} is another; let it drive in PyBullet: --worlds"
        )
    agent = load_agent(how.agent, how.task)
    assert isinstance(agent, OracleAgent)
    return agent
