"""How a policy does on generated tracks that nobody has trained on, by the thousand, on planar cars."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.agents import load_agent
from zebrat_bullet.agents.policy import PolicyAgent
from zebrat_bullet.config import TaskConfig
from zebrat_bullet.errors import ConfigError, PolicyError
from zebrat_bullet.evaluation.metrics import wilson_interval
from zebrat_bullet.evaluation.planar_policy import cars_for
from zebrat_bullet.planar.drive import N_STARTS
from zebrat_bullet.planar.trial import Trial, drive_out
from zebrat_bullet.robot import load_robot
from zebrat_bullet.task.episode import OUTCOMES, Outcome
from zebrat_bullet.world import generate_tracks


@dataclass(frozen=True, kw_only=True)
class GeneratedScore:
    """How a policy did on generated tracks.

    Attributes:
        tracks, starts: so many tracks, so many episodes in each.
        success, success_ci: share of the episodes, and its 95 % Wilson interval.
        worst_tenth: success on the tenth of the tracks where it is lowest.
        causes: episodes by outcome.
        time_s: mean simulated time of the successes; None when nothing succeeded.
        by_track: (tracks,) successes of each, in the order of the seeds.
    """

    tracks: int
    starts: int
    success: float
    success_ci: tuple[float, float]
    worst_tenth: float
    causes: dict[str, int]
    time_s: float | None
    by_track: tuple[int, ...]

    def as_dict(self) -> dict[str, object]:
        """Return the score as plain values for JSON."""
        return asdict(self)


def judge_generated(
    agent: str, seeds: Sequence[int], starts: int, task: TaskConfig, *, action_noise: float = 0.0, workers: int = 1
) -> GeneratedScore:
    """Drive a policy out of one generated track for each seed, several times.

    Args:
        agent: a policy's name, file or run folder.
        seeds: of the tracks.
        starts: episodes in each, at most `N_STARTS`.
        task: the task, which says where they begin; it shows what the policy observes.
        action_noise: Gaussian noise on the commands, as a fraction of the limits.
        workers: processes that draw the tracks.

    Raises:
        ConfigError: there are no seeds or starts, or the policy observes what this car does not.
        PolicyError: the agent is no policy.
    """
    if not seeds or not 1 <= starts <= N_STARTS:
        raise ConfigError(f"name at least 1 track and 1 to {N_STARTS} starts, got {len(seeds)} and {starts}")
    policy = load_agent(agent, task)
    if not isinstance(policy, PolicyAgent):
        raise PolicyError(f"planar cars are driven by trained policies, {agent!r} is none; use --worlds for it")
    worlds = list(generate_tracks(seeds, robot=load_robot(task.robot), workers=workers))
    drive = cars_for(policy, task, worlds, len(seeds) * starts)
    where = np.repeat(np.arange(len(seeds), dtype=np.int32), starts)
    poses = drive.starts[where, np.tile(np.arange(starts), len(seeds))]
    rng = np.random.default_rng(0)

    def act(observations: NDArray[np.float32]) -> NDArray[np.float32]:
        actions = policy.action(observations)
        if action_noise == 0.0:
            return actions
        return actions + rng.normal(0.0, action_noise, actions.shape).astype(np.float32)

    return _score(drive_out(drive, act, where, poses), len(seeds), starts, task)


def _score(trial: Trial, tracks: int, starts: int, task: TaskConfig) -> GeneratedScore:
    success = trial.outcome == Outcome.SUCCESS.code
    by_track = success.reshape(tracks, starts).sum(axis=1)
    worst = np.sort(by_track)[: max(tracks // 10, 1)]
    step_s = task.physics.control_step_s
    return GeneratedScore(
        tracks=tracks,
        starts=starts,
        success=float(success.mean()),
        success_ci=wilson_interval(int(success.sum()), len(success)),
        worst_tenth=float(worst.mean() / starts),
        causes={str(each): int((trial.outcome == each.code).sum()) for each in OUTCOMES},
        time_s=float(trial.n_steps[success].mean()) * step_s if success.any() else None,
        by_track=tuple(by_track.tolist()),
    )
