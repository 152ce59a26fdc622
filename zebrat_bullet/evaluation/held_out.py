"""How an agent does on a held-out set: overall, by difficulty, by what its certificates say."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np

from zebrat_bullet.agents import load_agent
from zebrat_bullet.config import TaskConfig, with_engine
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.evaluation.endings import SIMULATORS, Endings, as_policy, engine_endings, in_order, planar_endings
from zebrat_bullet.evaluation.generated import TracksScore, tracks_score
from zebrat_bullet.evaluation.metrics import tracks_interval
from zebrat_bullet.evaluation.track_set import SetTrack, TrackSet, draw_set
from zebrat_bullet.robot import named_robot
from zebrat_bullet.world import World

_BINS = 5
# The groups, in their order; those by clearance with the least of each, in m.
_DIFFICULTIES = tuple(f"{i / _BINS:.1f}-{(i + 1) / _BINS:.1f}" for i in range(_BINS))
_REVERSALS = ("0", "1", "2", "3", "4", "5", "6+")
_CLEARANCES_M = {"from 30 mm": 0.03, "8 to 30 mm": 0.008, "under 8 mm": 0.0}


@dataclass(frozen=True, kw_only=True)
class Group:
    """How it went on some of the tracks.

    Attributes:
        tracks: so many.
        success, success_ci: share of the episodes, and its 95 % interval (`tracks_interval`).
        backing: share of the episodes in which the car backed up (`Endings.backed_up`).
    """

    tracks: int
    success: float
    success_ci: tuple[float, float]
    backing: float


@dataclass(frozen=True, kw_only=True)
class SetScore:
    """How an agent did on a set.

    Attributes:
        set, sha256: which set.
        sim: "planar", "bullet" or "mujoco".
        overall: over all tracks driven; its `by_track` goes with `seeds`.
        seeds: of the tracks driven.
        by_difficulty: by fifth of the difficulty, "0.0-0.2" and so on; those that hold a track.
        by_reversals: by number of reversals of the certificate, "0" to "5", "6+"; those that hold a track.
        by_clearance: by what the certified drive keeps from the walls, "from 30 mm", "8 to 30 mm", "under 8 mm"; those
            that hold a track.
        over_least: mean over the successes of time over the least that any drive can take; None without a success.
    """

    set: str
    sha256: str
    sim: str
    overall: TracksScore
    seeds: tuple[int, ...]
    by_difficulty: dict[str, Group]
    by_reversals: dict[str, Group]
    by_clearance: dict[str, Group]
    over_least: float | None

    def as_dict(self) -> dict[str, object]:
        """Return the score as plain values for JSON."""
        return asdict(self)


@dataclass(frozen=True, kw_only=True)
class SetJudgement:
    """How to judge agents on a set.

    Attributes:
        episodes: in each track.
        sim: "planar" for policies, the engines "bullet" and "mujoco" for any agent.
        n_tracks: only so many, drawn from the seed; None takes all.
        seed: of that draw, of the episodes in an engine, of noise and dynamics; the same for every agent.
        action_noise: Gaussian noise on the commands, as a fraction of the limits.
        supervised_m: margin of the supervisor that the commands go through, not of planar cars; None: there is none.
        workers: processes.
        task: the task, with the car that the set is certified for.
    """

    episodes: int
    sim: str = "planar"
    n_tracks: int | None = None
    seed: int = 0
    action_noise: float = 0.0
    supervised_m: float | None = None
    workers: int = 1
    task: TaskConfig

    def __post_init__(self) -> None:
        if self.sim not in SIMULATORS:
            raise ConfigError(f"sim must be one of {', '.join(SIMULATORS)}, got {self.sim!r}")
        if self.supervised_m is not None and self.sim == "planar":
            raise ConfigError("planar cars have no whole scans for a supervisor; drive in PyBullet: --sim bullet")


def judge_set(
    agents: Sequence[str],
    tracks: TrackSet,
    how: SetJudgement,
    on_tracks: Callable[[str, int, int], None] = lambda agent, done, total: None,
    tasks: Mapping[str, TaskConfig] | None = None,
    on_endings: Callable[[str, Sequence[SetTrack], Endings], None] = lambda agent, tracks, endings: None,
) -> dict[str, SetScore]:
    """Judge agents on a set, all on the same tracks.

    Args:
        agents: names, policy files or run folders.
        tracks: the set.
        how: the simulator, and how much of the set.
        on_tracks: called with an agent, how many of the tracks it has driven, and how many it will.
        tasks: of agents that drive under another task than `how` says.
        on_endings: called with each agent, the tracks that it drove and how its episodes there ended.

    Raises:
        ConfigError: the set is for another car, is smaller than asked for, or its tracks cannot be drawn here.
        PolicyError: an agent that is no policy is to drive planar cars; nothing was driven then.
    """
    own = {agent: replace(how, task=(tasks or {}).get(agent, how.task)) for agent in agents}
    for agent, its in own.items():
        loaded = load_agent(agent, its.task)
        if how.sim == "planar":
            as_policy(loaded, agent)
        if named_robot(tracks.robot) != named_robot(its.task.robot):
            raise ConfigError(f"set {tracks.name!r} is for {tracks.robot!r}, not {its.task.robot!r}; make another")
    chosen = _choose(tracks, how)
    facts = [tracks.tracks[i] for i in chosen]
    worlds = draw_set(tracks, how.workers, only=None if how.n_tracks is None else chosen)
    scores = {}
    for agent in agents:
        on_tracks(agent, 0, len(worlds))
        endings = _drive(agent, worlds, own[agent], lambda done, agent=agent: on_tracks(agent, done, len(worlds)))  # type: ignore[misc]
        on_endings(agent, facts, endings)
        scores[agent] = _score(tracks, facts, how, endings)
    return scores


def _choose(tracks: TrackSet, how: SetJudgement) -> list[int]:
    n = len(tracks.tracks)
    if how.n_tracks is None:
        return list(range(n))
    if not 1 <= how.n_tracks <= n:
        raise ConfigError(f"set {tracks.name!r} has {n} tracks, asked for {how.n_tracks}; ask for 1 to {n}")
    return sorted(np.random.default_rng(how.seed).choice(n, how.n_tracks, replace=False).tolist())


def _drive(agent: str, worlds: list[World], how: SetJudgement, on_done: Callable[[int], None]) -> Endings:
    if how.sim == "planar":
        policy = as_policy(load_agent(agent, how.task), agent)
        ended = 0

        def on_end(n: int) -> None:
            nonlocal ended
            ended += n
            on_done(ended // how.episodes)

        noise, seed = how.action_noise, how.seed
        return planar_endings(policy, how.task, worlds, how.episodes, seed=seed, action_noise=noise, on_end=on_end)
    found: dict[int, Endings] = {}
    driven = engine_endings(
        agent,
        with_engine(how.task, how.sim),
        worlds,
        how.episodes,
        seed=how.seed,
        action_noise=how.action_noise,
        supervised_m=how.supervised_m,
        workers=how.workers,
    )
    for i, endings in driven:
        found[i] = endings
        on_done(len(found))
    return in_order(found)


def _score(tracks: TrackSet, facts: Sequence[SetTrack], how: SetJudgement, endings: Endings) -> SetScore:
    success = endings.success
    over_least = endings.time_s / np.array([track.least_time_s for track in facts])[:, None]
    return SetScore(
        set=tracks.name,
        sha256=tracks.sha256,
        sim=how.sim,
        overall=tracks_score(endings),
        seeds=tuple(track.seed for track in facts),
        by_difficulty=_groups(endings, map(_difficulty, facts), _DIFFICULTIES),
        by_reversals=_groups(endings, map(_reversals, facts), _REVERSALS),
        by_clearance=_groups(endings, map(_clearance, facts), _CLEARANCES_M),
        over_least=float(over_least[success].mean()) if success.any() else None,
    )


def _difficulty(track: SetTrack) -> str:
    return _DIFFICULTIES[min(int(track.difficulty * _BINS), _BINS - 1)]


def _reversals(track: SetTrack) -> str:
    return _REVERSALS[min(track.reversals, len(_REVERSALS) - 1)]


def _clearance(track: SetTrack) -> str:
    return next(name for name, least_m in _CLEARANCES_M.items() if track.clearance_m >= least_m)


def _groups(endings: Endings, of_tracks: Iterable[str], names: Iterable[str]) -> dict[str, Group]:
    groups, keys = {}, list(of_tracks)
    for name in names:
        of_name = [i for i, key in enumerate(keys) if key == name]
        if of_name:
            success = endings.success[of_name]
            groups[name] = Group(
                tracks=len(of_name),
                success=float(success.mean()),
                success_ci=tracks_interval(success.sum(axis=1), success.shape[1]),
                backing=float(endings.backed_up[of_name].mean()),
            )
    return groups
