"""The watchdog: a run that does not learn says so, names how, and shows the episode.

After every noise-free evaluation it looks at the evaluation's records and at the critic. What it can name is `COLLAPSES`;
to add one that an episode shows by itself, write a function and name it in `EPISODE_SIGNS`.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.config import TaskConfig, from_json
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.evaluation.records import EpisodeRecord

WATCHDOG_COLUMNS = ("episode", "name", "in_a_row", "measured")


@dataclass(frozen=True, kw_only=True)
class WatchdogConfig:
    """What counts as a collapse.

    Attributes:
        patience: evaluations in a row that must show a collapse before it is confirmed.
        min_share: nothing is confirmed before this share of the run; findings are listed all the same.
        restarts: how often a confirmed collapse may end the run and the next seed begin.
        most: share of an evaluation's episodes that must show a behaviour.
        critic_change: a critic is frozen if its values move by less than this share of their size between evaluations.
        critic_spread: it is frozen, too, if they differ between observations by less than this share of their size.
        command_spread: largest standard deviation of speed and of steering, as shares of their limits, of a policy that
            gives one command whatever it sees.
        crash_steps: a collision within so many control steps is one at once.
        still_m: a car that is cut off and never left a circle of this diameter stood still.
        circling_steps: so many steps at the end of an episode are looked at for circling.
        circling_ratio: a car circles if it drove this many times the diameter of the ground it covered.
    """

    patience: int = 3
    min_share: float = 0.3
    restarts: int = 0
    most: float = 0.75
    critic_change: float = 1e-3
    critic_spread: float = 1e-3
    command_spread: float = 0.05
    crash_steps: int = 30
    still_m: float = 0.5
    circling_steps: int = 150
    circling_ratio: float = 4.0

    def __post_init__(self) -> None:
        for name in ("patience", "crash_steps", "circling_steps"):
            if getattr(self, name) < 1:
                raise ConfigError(f"watchdog.{name} must be at least 1, got {getattr(self, name)}")
        for name in ("critic_change", "critic_spread", "command_spread", "still_m"):
            if getattr(self, name) < 0:
                raise ConfigError(f"watchdog.{name} must be at least 0, got {getattr(self, name)}")
        if not 0 <= self.min_share <= 1:
            raise ConfigError(f"watchdog.min_share must be in [0, 1], got {self.min_share}")
        if not 0 < self.most <= 1:
            raise ConfigError(f"watchdog.most must be in (0, 1], got {self.most}")
        if self.circling_ratio <= 1:
            raise ConfigError(f"watchdog.circling_ratio must be above 1, got {self.circling_ratio}")


@dataclass(frozen=True)
class CriticProbe:
    """What the critic says now of a sample of observations that stays the same all through the run.

    Attributes:
        values: (n,) Q(s, a) or V(s), in units of the reward that the learner sees; n at least 2.
    """

    values: NDArray[np.floating]

    def __post_init__(self) -> None:
        if self.values.ndim != 1 or len(self.values) < 2 or not np.isfinite(self.values).all():
            raise ConfigError(f"a critic probe is at least 2 finite values in a row, got shape {self.values.shape}")


@dataclass(frozen=True, kw_only=True)
class Finding:
    """A collapse that one evaluation shows.

    Attributes:
        name: which of `COLLAPSES`.
        measured: what was measured, in words and numbers.
        record: the first episode that shows it.
        in_a_row: evaluations in a row that showed it, this one included.
    """

    name: str
    measured: str
    record: EpisodeRecord
    in_a_row: int

    def row(self, episode: int) -> dict[str, object]:
        """Return the row of `watchdog.csv`; `episode` is the training episode after which was evaluated."""
        return {"episode": episode, "name": self.name, "in_a_row": self.in_a_row, "measured": self.measured}


def _task(record: EpisodeRecord) -> TaskConfig:
    return from_json(TaskConfig, record.task)


def _cut_off(record: EpisodeRecord) -> bool:
    return record.outcome in ("timeout", "stall")


def _path_m(pose: NDArray[np.float64]) -> float:
    return float(np.hypot(*np.diff(pose[:, :2], axis=0).T).sum())


def _extent_m(pose: NDArray[np.float64]) -> float:
    """Return the diagonal of the box that holds all positions: the diameter of the ground covered."""
    return float(np.hypot(*np.ptp(pose[:, :2], axis=0)))


def _net_turns(pose: NDArray[np.float64]) -> float:
    """Return the whole turns to the left, less those to the right."""
    yaw = np.unwrap(pose[:, 2])
    return float(yaw[-1] - yaw[0]) / math.tau


def crashing_at_once(record: EpisodeRecord, config: WatchdogConfig) -> str | None:
    """Say whether the car collided within the first steps."""
    n_steps = len(record.reward)
    if record.outcome != "collision" or n_steps > config.crash_steps:
        return None
    return f"collision after {n_steps} steps and {_path_m(record.pose):.1f} m"


def standing_still(record: EpisodeRecord, config: WatchdogConfig) -> str | None:
    """Say whether the car stayed where it was until cut off, and whether that pays more than a crash."""
    extent = _extent_m(record.pose)
    if not _cut_off(record) or extent > config.still_m:
        return None
    earned, crash = record.reward.sum(), _task(record).reward.collision
    better = "more" if earned > crash else "no more"
    return (
        f"{record.outcome} after {len(record.reward)} steps within {extent:.2f} m; return {earned:.0f}, "
        f"{better} than the {crash:.0f} of a crash"
    )


def circling(record: EpisodeRecord, config: WatchdogConfig) -> str | None:
    """Say whether the car at the end drove round and round, or to and fro, over the same ground."""
    pose = record.pose[-config.circling_steps - 1 :]
    path, extent = _path_m(pose), _extent_m(pose)
    if record.outcome == "success" or _extent_m(record.pose) <= config.still_m or path < config.circling_ratio * extent:
        return None
    return f"drove {path:.1f} m within {extent:.1f} m and turned {_net_turns(pose):+.1f} times, then {record.outcome}"


def paid_to_stay(record: EpisodeRecord, config: WatchdogConfig) -> str | None:
    """Say whether the car was cut off with more than the exit is worth, and was still being paid in the end."""
    task = _task(record)
    earned, at_the_end = record.reward.sum(), record.reward[-task.episode.stall_steps :].mean()
    if not _cut_off(record) or earned <= task.reward.success or at_the_end <= 0:
        return None
    return (
        f"{record.outcome} after {len(record.reward)} steps with return {earned:.0f}, {at_the_end:+.1f} a step in the "
        f"end; the exit is worth {task.reward.success:+.0f}"
    )


EPISODE_SIGNS: dict[str, Callable[[EpisodeRecord, WatchdogConfig], str | None]] = {
    "crashing_at_once": crashing_at_once,
    "standing_still": standing_still,
    "circling": circling,
    "paid_to_stay": paid_to_stay,
}
COLLAPSES = ("frozen_critic", "one_action", *EPISODE_SIGNS)


class Watchdog:
    """Examines evaluation after evaluation and remembers what it saw.

    Args:
        config: what counts as a collapse.
        state: what `state` returned when the run was saved; None for a new run.
    """

    def __init__(self, config: WatchdogConfig, state: Mapping[str, Any] | None = None) -> None:
        self._config = config
        self._in_a_row: dict[str, int] = dict(state["in_a_row"]) if state else {}
        self._critic = np.array(state["critic"]) if state and state["critic"] is not None else None
        self._confirmed: Finding | None = None

    @property
    def confirmed(self) -> Finding | None:
        """The collapse of the last examination that has lasted for `patience` evaluations."""
        return self._confirmed

    def state(self) -> dict[str, Any]:
        """Return all that is remembered, as JSON values."""
        return {"in_a_row": self._in_a_row, "critic": None if self._critic is None else self._critic.tolist()}

    def examine(self, records: Sequence[EpisodeRecord], critic: CriticProbe | None, share: float) -> list[Finding]:
        """Return the collapses that an evaluation shows, in the order of `COLLAPSES`.

        Args:
            records: the evaluation's episodes, at least one; those of worlds that can be loaded again first, for a
                finding carries the first record that shows it.
            critic: the critic's values; None where there is no critic.
            share: of the run that is over, 0 to 1.
        """
        seen = {"frozen_critic": self._frozen(records, critic), "one_action": self._one_action(records)}
        seen |= {name: self._shown(records, sign) for name, sign in EPISODE_SIGNS.items()}
        self._in_a_row = {name: self._in_a_row.get(name, 0) + 1 for name, shown in seen.items() if shown}
        findings = [
            Finding(name=name, measured=shown[0], record=shown[1], in_a_row=self._in_a_row[name])
            for name, shown in seen.items()
            if shown
        ]
        lasting = [f for f in findings if f.in_a_row >= self._config.patience and share >= self._config.min_share]
        self._confirmed = lasting[0] if lasting else None
        return findings

    def _frozen(self, records: Sequence[EpisodeRecord], critic: CriticProbe | None) -> tuple[str, EpisodeRecord] | None:
        before, self._critic = self._critic, None if critic is None else critic.values.astype(np.float64)
        if self._critic is None:
            return None
        now = self._critic
        size = float(np.abs(now).mean())
        if np.ptp(now) <= self._config.critic_spread * size:
            text = f"all {len(now)} values of the critic lie in {now.min():.4g} to {now.max():.4g}, whatever it sees"
            return text, records[0]
        if before is not None and (change := float(np.abs(now - before).mean())) <= self._config.critic_change * size:
            return f"the critic's values, {size:.3g} in size, moved by {change:.2g} since the last evaluation", records[
                0
            ]
        return None

    def _one_action(self, records: Sequence[EpisodeRecord]) -> tuple[str, EpisodeRecord] | None:
        failed = [record for record in records if record.outcome != "success"]
        if len(failed) < self._config.most * len(records):
            return None
        physics = _task(records[0]).physics
        limits = np.array([physics.max_speed_mps, physics.max_steering_rad])
        commands = np.concatenate([record.command for record in records])
        speed, steering = commands.std(axis=0) / limits
        if max(speed, steering) > self._config.command_spread:
            return None
        mean = commands.mean(axis=0)
        text = (
            f"{len(commands)} commands in {len(records)} episodes: speed {mean[0]:+.2f} m/s, spread {speed:.1%} of its "
            f"limit, steering {mean[1]:+.2f} rad, spread {steering:.1%}"
        )
        return text, failed[0]

    def _shown(
        self, records: Sequence[EpisodeRecord], sign: Callable[[EpisodeRecord, WatchdogConfig], str | None]
    ) -> tuple[str, EpisodeRecord] | None:
        shown = [(text, record) for record in records if (text := sign(record, self._config))]
        if not shown or len(shown) < self._config.most * len(records):
            return None
        text, record = shown[0]
        where = f"{record.world}, episode {record.episode}"
        return f"{len(shown)} of {len(records)} episodes; {where}: {text}", record
