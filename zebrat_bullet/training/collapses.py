"""What can go wrong with a run, and what shows it: in an evaluation's records, or in the critic's values.

To add a collapse that an episode shows by itself, write a function and name it in `EPISODE_SIGNS`.

Where the thresholds come from: "drivers" below are the shipped policy, `il` and `dagger`, two episodes on each of the
12 shipped worlds, and the 71 recorded drives of the oracle; "scripts" are cars that do one thing only (straight on,
full lock, to and fro, nothing) on the same worlds and in a room of 4.0 x 3.4 m.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.config import TaskConfig, within
from zebrat_bullet.config_text import from_json
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.evaluation.records import EpisodeRecord


@dataclass(frozen=True, kw_only=True)
class WatchdogConfig:
    """What counts as a collapse.

    Attributes:
        patience: evaluations in a row that must show a collapse before it is confirmed: single ones are bad luck, good
            runs lose and regain 15 % of success from one to the next.
        min_share: nothing is confirmed before this share of the run, findings are listed all the same. The runs of the
            paper's preset had 25 % success after 30 to 50 % of the episodes; one lost it from 55 to 75 %, standing
            still, and got it back.
        most: share of an evaluation's episodes that must show a behaviour: 3 of 4 in the paper's preset.
        critic_change: a critic is frozen if its values move by less than this share of their size between evaluations.
            DDPG that learns: 0.15 to 0.96 in 500 updates; with learning rates of 1e-12: 2e-8.
        critic_spread: it is frozen, too, if half of its values lie within this share of their size, whatever it sees:
            quartiles, for of a critic whose units had died one value in 64 still differed. DDPG that learns: 0.43 to
            2.4; with a learning rate of 0.5, unstable but alive: 0.03; of 20, dead: 0.
        command_spread: largest standard deviation of speed and of steering, as shares of their limits, of a policy that
            gives one command whatever it sees. Scripts: 0. The least of a driver that failed: 0.06, `il` on 40 steps
            of track_4 straight on.
        crash_steps: a collision within so many control steps (10 s) is one at once. Straight on blindly: 10 to 22, full
            lock: 5 to 7. The runs of the paper's preset that took to driving at full speed into the first bend of
            big_track, which pays up to +113: 40 to 46; those that learned: 200 and more by a tenth of the run. Drivers
            that failed: 39 on all of track_4 (`il`), 49 and 56 on track_6 (`dagger`, `il`); else single episodes.
        still_m: a car that was cut off and did not leave ground of this diameter in its last steps (as many as make a
            stall) stood still. To and fro for 0.8 s each: 0.48; drivers that crash at once: 1.2 on.
        circling_steps: so many steps at the end of an episode are looked at for circling; a minute.
        circling_ratio: a car circles if it drove this many times the diameter of the ground it covered. Full lock at
            full speed: 15, at a third of it: 5.2; to and fro: 21; drivers: at most 2.4; random commands: up to 6.2 in
            one episode of four.
    """

    patience: int = 3
    min_share: float = 0.4
    most: float = 0.75
    critic_change: float = 1e-3
    critic_spread: float = 1e-2
    command_spread: float = 0.02
    crash_steps: int = 50
    still_m: float = 0.5
    circling_steps: int = 300
    circling_ratio: float = 5.0

    def __post_init__(self) -> None:
        for name in ("patience", "crash_steps", "circling_steps"):
            if getattr(self, name) < 1:
                raise ConfigError(f"watchdog {name} must be at least 1, got {getattr(self, name)}")
        for name in ("critic_change", "critic_spread", "command_spread", "still_m"):
            if getattr(self, name) < 0:
                raise ConfigError(f"watchdog {name} must be at least 0, got {getattr(self, name)}")
        if not 0 <= self.min_share <= 1:
            raise ConfigError(f"watchdog min_share must be in [0, 1], got {self.min_share}")
        if not 0 < self.most <= 1:
            raise ConfigError(f"watchdog most must be in (0, 1], got {self.most}")
        most = 2**31 - 1
        within(self, patience=(1, most), crash_steps=(1, most), circling_steps=(1, most), circling_ratio=(-most, most))
        for name in ("critic_change", "critic_spread", "command_spread", "still_m"):
            within(self, **{name: (0.0, 1e9)})
        if self.circling_ratio <= 1:
            raise ConfigError(f"watchdog circling_ratio must be above 1, got {self.circling_ratio}")


def crashing_at_once(record: EpisodeRecord, config: WatchdogConfig) -> str | None:
    """Return what shows that the car collided within its first steps, None if it did not."""
    n_steps = len(record.reward)
    if record.outcome != "collision" or n_steps > config.crash_steps:
        return None
    return f"collision after {n_steps} steps and {_path_m(record.pose):.1f} m, with return {record.reward.sum():+.0f}"


def standing_still(record: EpisodeRecord, config: WatchdogConfig) -> str | None:
    """Return what shows that the car stood until cut off, from the start or later, and if that pays more than a crash.

    One of five runs of the paper's preset ended so: it drove on to a bend that it could not take and waited before it
    (DDPG's seed 1 in `docs/results/algorithms.zip`).
    """
    task = _task(record)
    n_last = min(task.episode.stall_steps, len(record.reward))
    extent = _extent_m(record.pose[-n_last - 1 :])
    if not _cut_off(record) or extent > config.still_m:
        return None
    earned, crash = record.reward[-n_last:].sum(), task.reward.collision
    return (
        f"{record.outcome} after {len(record.reward)} steps and {_path_m(record.pose):.1f} m, the last {n_last} within "
        f"{extent:.2f} m; these paid {earned:.0f}, "
        f"{'more' if earned > crash else 'no more'} than the {crash:.0f} of a crash"
    )


def circling(record: EpisodeRecord, config: WatchdogConfig) -> str | None:
    """Return what shows that the car, in the end, drove round and round or to and fro over the same ground."""
    if record.outcome == "success" or _extent_m(record.pose) <= config.still_m:
        return None
    pose = record.pose[-config.circling_steps - 1 :]
    path, extent = _path_m(pose), _extent_m(pose)
    if path < config.circling_ratio * extent:
        return None
    yaw = np.unwrap(pose[:, 2])
    turns = (yaw[-1] - yaw[0]) / math.tau
    return f"drove {path:.1f} m within {extent:.1f} m and turned {turns:+.1f} times, then {record.outcome}"


def paid_to_stay(record: EpisodeRecord, config: WatchdogConfig) -> str | None:
    """Return what shows that the car earned more than the exit is worth, was cut off, and was still being paid.

    A return above the exit's worth alone says nothing: drivers that leave earn far more (docs/staying.md). Nor does one
    that drove well and then stopped stay for the pay: standing costs. What the way to a waypoint pays does not count: a
    car that was slow was still on its way out.
    """
    task = _task(record)
    staying = record.reward - record.terms[:, record.term_names.index("W")]
    earned, at_the_end = record.reward.sum(), staying[-task.episode.stall_steps :].mean()
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
"""What can be named, causes first: of several that last, the first is the one confirmed."""


def frozen_critic(now: NDArray[np.float64], before: NDArray[np.float64] | None, config: WatchdogConfig) -> str | None:
    """Return what shows that the critic's values are the same, or the same as before; None if they are not."""
    low, high = np.quantile(now, [0.25, 0.75])
    if high - low <= config.critic_spread * np.median(np.abs(now)):
        return f"half of the critic's {len(now)} values lie between {low:.5g} and {high:.5g}, whatever it sees"
    if before is None or len(before) != len(now):
        return None
    size, change = np.abs(now).mean(), np.abs(now - before).mean()
    if change > config.critic_change * size:
        return None
    return f"the critic's values, {size:.3g} in size, moved by {change:.1g} since the last evaluation"


def one_action(records: Sequence[EpisodeRecord], config: WatchdogConfig) -> str | None:
    """Return what shows that the policy failed with one command in all the evaluation's steps, None if it did not.

    Speed and steering are judged together, over whole episodes: straight on at full speed is right in a straight.
    """
    if not mostly_fails(records, config):
        return None
    physics = _task(records[0]).physics
    commands = np.concatenate([record.command for record in records])
    speed, steering = commands.std(axis=0) / (physics.max_speed_mps, physics.max_steering_rad)
    if max(speed, steering) > config.command_spread:
        return None
    mean = commands.mean(axis=0)
    return (
        f"{len(commands)} commands of {mean[0]:+.2f} m/s (spread {speed:.1%} of the limit) and {mean[1]:+.2f} rad "
        f"(spread {steering:.1%})"
    )


def mostly_fails(records: Sequence[EpisodeRecord], config: WatchdogConfig) -> bool:
    """Return whether so many episodes of an evaluation failed that a behaviour could be a collapse."""
    return sum(record.outcome != "success" for record in records) >= config.most * len(records)


def _cut_off(record: EpisodeRecord) -> bool:
    return record.outcome in ("timeout", "stall")


def _task(record: EpisodeRecord) -> TaskConfig:
    return from_json(TaskConfig, record.task)


def _path_m(pose: NDArray[np.float64]) -> float:
    """Return the length of the path through (T, 3) poses."""
    return float(np.hypot(*np.diff(pose[:, :2], axis=0).T).sum())


def _extent_m(pose: NDArray[np.float64]) -> float:
    """Return the diameter of the ground that (T, 3) poses cover: the diagonal of the box round their positions."""
    return float(np.hypot(*np.ptp(pose[:, :2], axis=0)))
