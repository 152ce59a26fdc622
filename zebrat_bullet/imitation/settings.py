"""Settings of a run of imitation learning: frozen, validated once, varied by `dataclasses.replace`."""

from dataclasses import dataclass, field

from zebrat_bullet.config import MOST_SEED, within
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.imitation.cloning import CloneConfig
from zebrat_bullet.training.settings import VALIDATION_SEED
from zebrat_bullet.world import HELD_OUT_SEED


@dataclass(frozen=True, kw_only=True)
class ImitationConfig:
    """One run of imitation learning.

    Attributes:
        demonstrations: folder of episode records, or a zip archive of one.
        iterations: DAgger iterations after behaviour cloning; 0 is the paper's imitation learning.
        expert: who labels in DAgger: an agent's name, policy file or run folder.
        beta: in iteration i the expert drives a step with probability beta ** i, else the learner.
        pairs: states to label in each iteration; the last episode is driven to its end.
        eval_episodes: noise-free episodes in each world that choose the best iteration.
        eval_tracks: these worlds, where the demonstrations are of generated tracks: so many tracks of the same families
            and of the seeds from `VALIDATION_SEED` on, on planar cars.
        clone: how the network is fitted.
        seed: of the network, the start poses and of who drives a step.
    """

    demonstrations: str
    iterations: int = 0
    expert: str = ""
    beta: float = 0.5
    pairs: int = 2000
    eval_episodes: int = 5
    eval_tracks: int = 240
    clone: CloneConfig = field(default_factory=CloneConfig)
    seed: int = 0

    def __post_init__(self) -> None:
        if self.iterations < 0 or self.pairs < 1 or self.eval_episodes < 1:
            raise ConfigError("iterations must be at least 0, pairs and eval_episodes at least 1")
        if self.iterations and not self.expert:
            raise ConfigError("DAgger needs an expert that labels what the learner meets: name one with --expert")
        within(self, iterations=(0, 1000), pairs=(1, 10**8), eval_episodes=(1, 10_000), seed=(0, MOST_SEED))
        within(self, eval_tracks=(1, HELD_OUT_SEED - VALIDATION_SEED))
        if not 0 <= self.beta <= 1:
            raise ConfigError(f"beta is a probability, got {self.beta}")
