"""Settings of a training run: frozen, validated once, varied by `dataclasses.replace`."""

from dataclasses import dataclass, field
from pathlib import Path

from zebrat_bullet.config import MOST_SEED, LidarConfig, TaskConfig, at_least_one, require_planar_cars, shares, within
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.planar.margins import Margins, margins_of
from zebrat_bullet.task.rewards import check_weights
from zebrat_bullet.training.collapses import WatchdogConfig
from zebrat_bullet.training.learner_settings import DDPGConfig, Learner
from zebrat_bullet.world import HELD_OUT_SEED, check_family, world_names

VALIDATION_SEED = 800_000
"""Generated tracks of seeds from here to `HELD_OUT_SEED` choose the best policy of a run."""

_PLANAR_STARTS = 64  # those that planar.drive draws of a world


@dataclass(frozen=True, kw_only=True)
class PlanarConfig:
    """What is particular to training on planar cars.

    Attributes:
        n_cars: cars side by side.
        device: "cpu" or "cuda", where they drive.
        n_tracks: generated tracks that join the run's worlds, of the seeds from 0 on.
        families: of these tracks, in turn; one that is named twice has twice as many.
        difficulty: of these tracks, 0 to 1; None draws each one's (0.6 for `mixed`), as for the tracks of evaluations.
        curriculum: a track is drawn in proportion to this plus p (1 - p), p its recent success: most often where there
            is something to learn (Sampling For Learnability); 0: all alike.
        margin_m: walls so near to the outline count as touched while it learns; of a range each episode draws its own;
            by family of tracks, as in {narrowing: 0.002, other: [0.01, 0.03]}, where some leave less room.
        n_eval_tracks, n_eval_starts: tracks of these families and of the seeds from `VALIDATION_SEED` on, beside the
            run's `eval_worlds` (0: those alone, or if there are none the training worlds), and episodes from the start
            of each, by which the best policy is chosen; sensor and dynamics drawn as in training, no exploration.
        eval_every_steps: steps between two evaluations, and between two checkpoints.
        gradient_steps: of DDPG and SAC, for each step of all cars; None for as many as there are cars, the paper's one
            for each transition.
    """

    n_cars: int = 1024
    device: str = "cpu"
    n_tracks: int = 2000
    families: tuple[str, ...] = ("mixed",)
    difficulty: float | None = None
    curriculum: float = 0.004
    margin_m: Margins = 0.02
    n_eval_tracks: int = 250
    n_eval_starts: int = 4
    eval_every_steps: int = 500_000
    gradient_steps: int | None = None

    def __post_init__(self) -> None:
        at_least_one(self, "n_cars", "n_eval_starts", "eval_every_steps")
        if self.gradient_steps is not None:
            within(self, gradient_steps=(1, 2**18))
        shares(self, "curriculum")
        within(self, n_cars=(1, 2**18), n_eval_tracks=(0, HELD_OUT_SEED - VALIDATION_SEED))
        within(self, n_eval_starts=(1, _PLANAR_STARTS), eval_every_steps=(1, 10**12))
        margins_of(self.margin_m)
        if not self.families:
            raise ConfigError("planar.families is empty; name at least one family of tracks")
        for family in self.families:
            check_family(family, self.difficulty)
        if not 0 <= self.n_tracks <= VALIDATION_SEED:
            raise ConfigError(
                f"planar.n_tracks must be 0 to {VALIDATION_SEED}, the seeds that are not kept for judging, "
                f"got {self.n_tracks}"
            )


EPISODES = 1000
"""Of the paper's runs."""


@dataclass(frozen=True, kw_only=True)
class TrainConfig:
    """One training run.

    Attributes:
        learner: the algorithm and its settings.
        worlds: worlds of the training episodes, by name or file; each episode draws one.
        episodes: length of the run; schedules end with it. Planar cars have `steps` and `max_minutes` instead.
        steps: length in environment steps, None for no such limit; whichever limit comes first ends run and schedules.
        max_minutes: wall-clock limit, None for none; the run ends early and keeps what it has.
        init: an SB3 zip (a run's best.zip) whose networks to begin with, for fine-tuning (paper: 500 episodes from the
            best model); empty to begin anew. It is judged first (which ends the run if it reaches `stop_at`), and
            stays the best policy unless one is found that is no worse. Its tensors alone are read. PPO takes up a
            policy without a memory where the task has one (`observation.trail_steps`): it drives as it did at first.
        seed: of networks, exploration and start poses.
        n_envs: environments stepped side by side; each adds one transition and one gradient step.
        overlap: step the environments in processes of their own while the learner updates. The result is the same to
            the last bit; it pays where a second core is idle.
        threads: torch threads.
        eval_every, eval_episodes: a noise-free evaluation every so many episodes, with so many in each world. PPO is
            judged and saved between two rollouts only, so it waits for the end of one (2,048 steps).
        eval_worlds: where; empty for the training worlds' first (of planar cars: see `planar.n_eval_tracks`).
        stop_at: the run ends with the first evaluation of this success rate; None for never.
        checkpoint_every: episodes between checkpoints, the most a killed run loses.
        watchdog: when a run that does not learn is named; only of runs in PyBullet.
        planar: train on planar cars instead of PyBullet's; `n_envs`, `overlap`, `eval_every`, `eval_episodes` and
            `checkpoint_every` then have no meaning, and `worlds` may be empty.
        task: the task driven; evaluations begin at the world's start wherever training does.
    """

    learner: Learner = field(default_factory=DDPGConfig)
    worlds: tuple[str, ...] = ("big_track",)
    episodes: int = EPISODES
    steps: int | None = None
    max_minutes: float | None = None
    init: str = ""
    seed: int = 0
    n_envs: int = 1
    overlap: bool = False
    threads: int = 1
    eval_every: int = 50
    eval_episodes: int = 4
    eval_worlds: tuple[str, ...] = ()
    stop_at: float | None = None
    checkpoint_every: int = 50
    watchdog: WatchdogConfig = field(default_factory=WatchdogConfig)
    planar: PlanarConfig | None = None
    task: TaskConfig = field(default_factory=lambda: TaskConfig(lidar=LidarConfig(caster="embree", bearings="region")))

    def __post_init__(self) -> None:
        for name in ("worlds", "eval_worlds"):
            object.__setattr__(self, name, world_names(getattr(self, name)))
        at_least_one(self, "episodes", "n_envs", "threads", "eval_every", "eval_episodes", "checkpoint_every")
        if self.stop_at is not None:
            shares(self, "stop_at")
        within(self, n_envs=(1, 256), threads=(1, 256), seed=(0, MOST_SEED), eval_episodes=(1, 10_000))
        within(self, **dict.fromkeys(("episodes", "eval_every", "checkpoint_every"), (1, 10**9)))
        check_weights(self.task.reward)
        if not self.worlds and not (self.planar and self.planar.n_tracks):
            raise ConfigError("nothing to train on: name at least one world, or set planar.n_tracks")
        if self.planar:
            require_planar_cars(self.task)
            if self.steps is None and self.max_minutes is None and self.stop_at is None:
                raise ConfigError("a run on planar cars would never end; set steps or max_minutes")
            if self.episodes != EPISODES:
                raise ConfigError(
                    f"episodes={self.episodes} says nothing to planar cars, of which many drive at once; set steps "
                    "or max_minutes"
                )
            if not (self.planar.n_eval_tracks or self.eval_worlds or self.worlds):
                raise ConfigError("nothing to choose the best policy by: name eval_worlds, or set planar.n_eval_tracks")
        if self.steps is not None and self.steps < 1:
            raise ConfigError(f"steps must be at least 1, or null for no such limit; got {self.steps}")
        if self.max_minutes is not None and not self.max_minutes > 0:
            raise ConfigError(f"max_minutes must be above 0, or null for no such limit; got {self.max_minutes}")
        within(self, steps=(1, 10**12), max_minutes=(0, 1e7))


def require_init(config: TrainConfig) -> None:
    """Raise unless the model to begin with, if there is to be one, is there.

    Raises:
        ConfigError: it is not.
    """
    if config.init and not Path(config.init).is_file():
        raise ConfigError(f"init must name a run's best.zip, got {config.init!r}, which is no file")
