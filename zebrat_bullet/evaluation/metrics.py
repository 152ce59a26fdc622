"""Rates, intervals and times from episode records."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from zebrat_bullet.evaluation.records import EpisodeRecord


@dataclass(frozen=True, kw_only=True)
class Supervision:
    """What a supervisor did to an agent in one world.

    An intervention is a run of refused commands, one control step after the other. It is a false stop if none of these
    commands would have led to contact: had the car obeyed it for its control step and then braked, its body would have
    touched no wall, says the simulation.

    Attributes:
        margin_m: of the supervisor.
        interventions, false_stops: how many.
        per_minute, false_per_minute: of these, in a minute of simulated time.
        stopped: share of the control steps that were refused.
        stalls: episodes that ended by the stall rule with the last command refused: agent and supervisor stand off.
    """

    margin_m: float
    interventions: int
    false_stops: int
    per_minute: float
    false_per_minute: float
    stopped: float
    stalls: int


@dataclass(frozen=True, kw_only=True)
class Score:
    """How an agent did in one world (paper, IV-C).

    Attributes:
        success, collision, fail: rates in [0, 1] that add up to 1; fail is false exit, time-out or stall.
        success_ci: 95 % Wilson interval of the success rate.
        time_s: mean simulated time of the successes; None when nothing succeeded.
        causes: number of episodes by outcome.
        privileged: what the agent was given beyond the lidar.
        supervision: what the supervisor did; None where there was none.
    """

    success: float
    collision: float
    fail: float
    success_ci: tuple[float, float]
    time_s: float | None
    episodes: int
    caster: str
    engine: str
    seed: int
    causes: dict[str, int]
    privileged: tuple[str, ...]
    supervision: Supervision | None = None

    def as_dict(self) -> dict[str, object]:
        """Return the score as plain values for JSON."""
        values = asdict(self)
        if self.supervision is None:
            del values["supervision"]
        return values


def wilson_interval(successes: float, episodes: float) -> tuple[float, float]:
    """Return the 95 % Wilson score interval of a rate; neither number need be whole."""
    z, share = float(norm.ppf(0.975)), successes / episodes
    middle = (share + z**2 / (2 * episodes)) / (1 + z**2 / episodes)
    half = z / (1 + z**2 / episodes) * math.sqrt(share * (1 - share) / episodes + z**2 / (4 * episodes**2))
    return (middle - half if share > 0 else 0.0), (middle + half if share < 1 else 1.0)


def tracks_interval(by_track: NDArray[np.integer], starts: int) -> tuple[float, float]:
    """Return the 95 % interval of success over all tracks of a kind, from a sample with some episodes in each.

    Episodes of one track end alike, so they say less than as many episodes of different tracks: it is the Wilson
    interval of as many independent episodes as would scatter like the tracks do (Kish's effective sample size), and of
    one a track where all succeed or none, or there is but one track.

    Args:
        by_track: (tracks,) successes of each.
        starts: episodes of each.
    """
    shares = by_track / starts
    mean, n = float(shares.mean()), len(shares)
    if n == 1 or mean in (0.0, 1.0):
        return wilson_interval(mean * n, n)
    scatter = float(shares.var(ddof=1)) / n
    effective = min(mean * (1 - mean) / scatter, n * starts) if scatter > 0 else n * starts
    return wilson_interval(mean * effective, effective)


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
        engine=records[0].engine,
        seed=records[0].seed,
        causes=causes,
        privileged=records[0].privileged,
        supervision=_supervision(records),
    )


def _supervision(records: Sequence[EpisodeRecord]) -> Supervision | None:
    margin_m = records[0].supervised_m
    if margin_m is None:
        return None
    runs = [run for record in records for run in interventions(record.refused)]
    n, n_false = len(runs), sum(not run[:, 3].any() for run in runs)
    minutes = sum(record.duration_s for record in records) / 60.0
    stood_off = [len(r.refused) and r.refused[-1, 0] == len(r.command) - 1 and r.outcome == "stall" for r in records]
    return Supervision(
        margin_m=margin_m,
        interventions=n,
        false_stops=n_false,
        per_minute=n / minutes,
        false_per_minute=n_false / minutes,
        stopped=sum(len(record.refused) for record in records) / sum(len(record.command) for record in records),
        stalls=sum(map(bool, stood_off)),
    )


def interventions(refused: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Return the (K, 4) refused commands parted into runs of control steps one after the other."""
    if not len(refused):
        return []
    return np.split(refused, np.flatnonzero(np.diff(refused[:, 0]) > 1.0) + 1)
