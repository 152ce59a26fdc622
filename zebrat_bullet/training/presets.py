"""Training settings: the paper's, and those of the shipped policy; vary one by `dataclasses.replace`."""

from dataclasses import dataclass, field, replace

from zebrat_bullet.config import EpisodeConfig, LidarConfig, TaskConfig
from zebrat_bullet.errors import ConfigError


@dataclass(frozen=True, kw_only=True)
class TrainConfig:
    """One training run; the defaults are the paper's DDPG (III-C, IV-B, and the authors' code).

    Attributes:
        worlds: worlds of the training episodes, by name or file; each episode draws one.
        n_generated: so many generated tracks join them.
        tightness: share of tight turns among the generated tracks' turns.
        episodes: length of the run.
        max_minutes: wall-clock limit, None for none; the run ends early and keeps what it has.
        init: an SB3 zip (a run's best.zip) whose networks to begin with, for fine-tuning (paper: 500 episodes from the
            best model); empty to begin anew. Zips unpickle: name only files of your own.
        seed: of networks, exploration, generated tracks and start poses.
        n_envs: environments stepped side by side; each adds one transition and one gradient step.
        hidden: units of each hidden layer.
        actor_lr, critic_lr: learning rates at the start.
        lr_final: both fall linearly to this share of themselves at the last episode (1: constant, as in the paper).
        buffer_size, batch_size, gamma, tau: replay and targets.
        n_step: rewards summed before the critic bootstraps.
        n_critics: critics, of whose targets the smallest counts (1: DDPG, 2: as in TD3).
        policy_delay: critic updates to an actor update (1: DDPG, 2: as in TD3).
        target_noise: Gaussian smoothing of the target action (0: DDPG, 0.2: TD3), clipped at 2.5 sigma.
        warmup_steps: uniformly random steps before the first update.
        epsilon: probability of a uniformly random action at the start; falls linearly to 0 at the last episode.
        hold_steps: a random action is kept for up to so many steps (1: DDPG of the paper); epsilon stays the share of
            random steps. Single random steps of 0.2 s never swing wide before a tight corner; held ones do.
        sigma: Gaussian noise on the action otherwise, as a fraction of the limits.
        mirror: half of each batch is seen left-right mirrored (the car and its reward are symmetric).
        reward_scale: factor on the reward the learner sees; logs and records keep the paper's.
        matmul_precision: torch's float32 setting; "medium" computes products in bfloat16.
        fused_adam: torch's fused optimizer.
        threads: torch threads.
        eval_every, eval_episodes: a noise-free evaluation every so many episodes, with so many in each world.
        eval_worlds: where; empty for the training worlds' first.
        n_generated_eval: so many generated tracks, never trained on, join them.
        checkpoint_every: episodes between checkpoints, the most a killed run loses.
        task: the task driven.
    """

    worlds: tuple[str, ...] = ("big_track",)
    n_generated: int = 0
    tightness: float = 0.6
    episodes: int = 1000
    max_minutes: float | None = None
    init: str = ""
    seed: int = 0
    n_envs: int = 1
    hidden: tuple[int, ...] = (512, 512)
    actor_lr: float = 1e-4
    critic_lr: float = 2e-4
    lr_final: float = 1.0
    buffer_size: int = 200_000
    batch_size: int = 64
    gamma: float = 0.99
    tau: float = 0.005
    n_step: int = 1
    n_critics: int = 1
    policy_delay: int = 1
    target_noise: float = 0.0
    warmup_steps: int = 200
    epsilon: float = 0.8
    hold_steps: int = 1
    sigma: float = 0.1
    mirror: bool = False
    reward_scale: float = 1.0
    matmul_precision: str = "highest"
    fused_adam: bool = False
    threads: int = 1
    eval_every: int = 20
    eval_episodes: int = 4
    eval_worlds: tuple[str, ...] = ()
    n_generated_eval: int = 0
    checkpoint_every: int = 50
    task: TaskConfig = field(default_factory=lambda: TaskConfig(lidar=LidarConfig(caster="embree")))

    def __post_init__(self) -> None:
        counts = (
            "episodes",
            "n_envs",
            "batch_size",
            "buffer_size",
            "n_step",
            "n_critics",
            "policy_delay",
            "hold_steps",
            "threads",
        )
        for name in (*counts, "warmup_steps", "eval_every", "eval_episodes", "checkpoint_every"):
            if getattr(self, name) < 1:
                raise ConfigError(f"{name} must be at least 1, got {getattr(self, name)}")
        if not self.worlds and not self.n_generated:
            raise ConfigError("nothing to train on: name worlds, or set n_generated above 0")
        for name in ("epsilon", "gamma", "tau", "tightness", "lr_final"):
            if not 0 <= getattr(self, name) <= 1:
                raise ConfigError(f"{name} must be in [0, 1], got {getattr(self, name)}")
        if self.matmul_precision not in ("highest", "high", "medium"):
            raise ConfigError(f"matmul_precision must be highest, high or medium, got {self.matmul_precision!r}")


_GENERAL = TrainConfig(
    worlds=("big_track",) * 20,
    n_generated=300,
    tightness=0.9,
    episodes=2600,
    hidden=(256, 256),
    actor_lr=3e-4,
    critic_lr=1e-3,
    lr_final=0.05,
    batch_size=128,
    n_critics=2,
    policy_delay=2,
    target_noise=0.1,
    warmup_steps=2000,
    epsilon=0.3,
    hold_steps=8,
    mirror=True,
    reward_scale=0.1,
    fused_adam=True,
    eval_every=100,
    eval_episodes=1,
    eval_worlds=("big_track",),
    n_generated_eval=30,
    checkpoint_every=200,
    task=TaskConfig(lidar=LidarConfig(caster="embree"), episode=EpisodeConfig(start="anywhere")),
)

TRAIN_PRESETS = {
    "paper": TrainConfig(),
    "general": _GENERAL,
    "finetune": replace(
        _GENERAL,
        worlds=("big_track",) * 60 + ("track_1", "track_2", "track_3") * 10,
        n_generated=210,
        tightness=0.6,
        episodes=700,
        actor_lr=5e-5,
        critic_lr=2e-4,
        batch_size=256,
        target_noise=0.05,
        warmup_steps=500,
        epsilon=0.1,
        eval_every=50,
        eval_episodes=2,
        eval_worlds=("big_track", "track_1", "track_2", "track_3"),
        checkpoint_every=50,
    ),
    "quick": replace(
        _GENERAL,
        worlds=("track_2",),
        n_generated=0,
        episodes=250,
        max_minutes=3.0,
        lr_final=1.0,
        warmup_steps=500,
        eval_every=25,
        eval_episodes=5,
        eval_worlds=("track_2",),
        n_generated_eval=0,
        checkpoint_every=50,
    ),
}
"""`paper`: the paper's. `general`: many generated tracks, to drive unseen ones. `finetune`: on from a `general`
run's model (with `init=`). `quick`: one track in three minutes at most."""
