"""Rates, intervals and times from episode records."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass

from scipy.stats import binomtest

from zebrat_bullet.evaluation.records import EpisodeRecord


@dataclass(frozen=True, kw_only=True)
class Score:
    """How an agent did in one world (paper, IV-C).

    Attributes:
        success, collision, fail: rates in [0, 1] that add up to 1; fail is false exit, time-out or stall.
        success_ci: 95 % Wilson interval of the success rate.
        time_s: mean simulated time of the successes; None when nothing succeeded.
        causes: number of episodes by outcome.
        privileged: what the agent was given beyond the lidar.
    """

    success: float
    collision: float
    fail: float
    success_ci: tuple[float, float]
    time_s: float | None
    episodes: int
    caster: str
    seed: int
    causes: dict[str, int]
    privileged: tuple[str, ...]

    def as_dict(self) -> dict[str, object]:
        """Return the score as plain values for JSON."""
        return asdict(self)


def wilson_interval(successes: int, episodes: int) -> tuple[float, float]:
    """Return the 95 % Wilson score interval of a rate."""
    interval = binomtest(successes, episodes).proportion_ci(0.95, method="wilson")
    return float(interval.low), float(interval.high)


def score(records: Sequence[EpisodeRecord]) -> Score:
    """Summarise the episodes of one agent in one world; there must be at least one."""
    n = len(records)
    outcomes = [record.outcome for record in records]
    causes = {outcome: outcomes.count(outcome) for outcome in sorted(set(outcomes))}
    times = [record.duration_s for record in records if record.outcome == "success"]
    n_success, n_collision = causes.get("success", 0), causes.get("collision", 0)
    return Score(
        success=n_success / n,
        collision=n_collision / n,
        fail=(n - n_success - n_collision) / n,
        success_ci=wilson_interval(n_success, n),
        time_s=sum(times) / len(times) if times else None,
        episodes=n,
        caster=records[0].caster,
        seed=records[0].seed,
        causes=causes,
        privileged=records[0].privileged,
    )
