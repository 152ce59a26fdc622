"""The tables of records as the report asks of them: who drove where, and which episodes stand for a method."""

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.report.comparison.statistics import ENOUGH_SEEDS, Difference, Rate, rate_difference, seeds_difference

TRACKS = tuple(f"track_{i}" for i in range(1, 9))
SEEN, UNSEEN = TRACKS[:3], TRACKS[3:]
RIGHT_ANGLES = ("track_2", "track_7")
METHODS = ("DWA", "TEB", "IL", "RL_WG", "RL_FT", "RL_FOT", "RL_FOMT")
"""In the order of the paper's Table II."""
OURS = "RL_FOMT"
Way = NDArray[np.float32]
"""(N, 2) places of the body centre in m, world frame."""
Scope = Literal["paper", "scale"]
"""At the paper's budget; or at ours, and with fairer rivals."""
PAPER_SETTINGS = {"DWA": ("radius 0.3", "radius 0.5"), "TEB": ("radius 0.3", "radius 0.5"), "IL": ("10,049 pairs",)}
"""Of the methods that are not trained here, what the paper compares; anything else of them is a fairer rival."""


@dataclass(frozen=True, slots=True)
class Drive:
    """An episode in a world; the columns of the table `episodes`, and the label of its contestant."""

    agent: str
    method: str
    setting: str
    study: str
    run: str | None
    sim: str
    place: str
    seed: int
    episode: int
    noise: str
    outcome: str
    duration_s: float
    n_reversals: int
    min_gap_m: float | None
    steering_effort_rad: float | None
    distance_m: float | None
    x0: float | None
    y0: float | None
    yaw0: float | None
    x1: float | None
    y1: float | None
    yaw1: float | None

    @property
    def success(self) -> bool:
        """Whether the car left."""
        return self.outcome == "success"

    @property
    def start(self) -> tuple[Any, ...]:
        """Where and how it began: drives with the same are a pair."""
        pose = tuple(None if value is None else round(value, 6) for value in (self.x0, self.y0, self.yaw0))
        return (self.place, self.seed, self.episode, *pose)


def succeeded(drive: Drive) -> bool:
    """Return whether the car left."""
    return drive.success


def collided(drive: Drive) -> bool:
    """Return whether it touched a wall."""
    return drive.outcome == "collision"


def failed(drive: Drive) -> bool:
    """Return whether it neither left nor touched: false exit, time-out or stall."""
    return drive.outcome not in ("success", "collision")


def backed_up(drive: Drive) -> bool:
    """Return whether the car reversed at least once, and left."""
    return drive.success and drive.n_reversals > 0


def rate(drives: Sequence[Drive], what: Callable[[Drive], bool] = succeeded) -> Rate:
    """Return how many of the drives are so."""
    return Rate(sum(map(what, drives)), len(drives))


class Evidence:
    """What the five tables say, as `zebrat_bullet.comparison.tables` reads them.

    Attributes:
        runs, learning, collisions: rows, as dictionaries by column.
        drives: episodes in worlds.
        held_out: counts of episodes on held-out sets: study, method, setting, noise, run, sim, place, family,
            reversals (of the certificate), outcome, backed_up (whether the car reversed), n.
    """

    def __init__(self, tables: Mapping[str, Any]) -> None:
        self.runs: list[dict[str, Any]] = tables["runs"].to_pylist()
        self.learning: list[dict[str, Any]] = tables["learning"].to_pylist()
        self.collisions: list[dict[str, Any]] = tables["collisions"].to_pylist()
        episodes = tables["episodes"]
        in_worlds = episodes["family"].is_null()
        columns = list(Drive.__slots__)
        self.drives = [Drive(**row) for row in episodes.filter(in_worlds).select(columns).to_pylist()]
        keys = ["study", "method", "setting", "noise", "run", "sim", "place", "family", "reversals", "outcome"]
        on_tracks = episodes.filter(episodes["family"].is_valid())
        backed = [(n or 0) > 0 for n in on_tracks["n_reversals"].to_pylist()]
        keys.append("backed_up")
        counted = on_tracks.append_column("backed_up", [backed]).group_by(keys).aggregate([([], "count_all")])
        counted = counted.rename_columns([*keys, "n"]).sort_by([(key, "ascending") for key in keys])
        self.held_out: list[dict[str, Any]] = counted.to_pylist()
        self._paths = tables["paths"]

    @cached_property
    def _ways(self) -> dict[tuple[Any, ...], Way]:
        keys = ("agent", "setting", "study", "place", "seed", "episode", "noise")
        rows = zip(*(self._paths[key].to_pylist() for key in keys), strict=True)
        return {
            row: np.stack([np.array(x.values, np.float32), np.array(y.values, np.float32)], axis=1)
            for row, x, y in zip(rows, self._paths["x"], self._paths["y"], strict=True)
        }

    def way(self, drive: Drive) -> Way | None:
        """Return the (N, 2) way that a drive took; None where it is not known."""
        key = (drive.agent, drive.setting, drive.study, drive.place, drive.seed, drive.episode, drive.noise)
        return self._ways.get(key)

    @cached_property
    def _by_run(self) -> dict[str, dict[str, Any]]:
        return {run["run"]: run for run in self.runs}

    def variant(self, run: str | None) -> str:
        """Return what sets a run apart from its reward's plain form; empty where nothing does."""
        return self._by_run.get(run or "", {}).get("variant") or ""

    def algorithm(self, run: str | None) -> str:
        """Return what a run learned with; empty of what is not trained here."""
        return self._by_run.get(run or "", {}).get("algorithm") or ""

    def seed(self, run: str | None) -> int | None:
        """Return the seed of a run; None of what is not trained here."""
        return self._by_run.get(run or "", {}).get("seed")

    def best_success(self, run: str | None) -> float:
        """Return the success of a run's best policy in its own evaluations; -1 where it is not known."""
        value = self._by_run.get(run or "", {}).get("best_success")
        return -1.0 if value is None else float(value)

    @cached_property
    def _judged(self) -> dict[tuple[Scope, str, str], list[Drive]]:
        """Drives in PyBullet by scope, method and place; no variants of a reward, and noise of rivals alone."""
        found = defaultdict(list)
        for drive in self.drives:
            if drive.sim == "bullet" and (scope := self._scope(drive)):
                found[scope, drive.method, drive.place].append(drive)
        return found

    def _scope(self, drive: Drive) -> Scope | None:
        """Return what a drive is evidence for; fine-tuning is part of the paper's training."""
        if drive.study == "rivals":
            known = drive.setting in PAPER_SETTINGS.get(drive.method, ())
            return "paper" if known and not drive.noise else "scale"
        if drive.noise or self.variant(drive.run):
            return None
        if drive.study in ("paper", "finetuning"):
            return "paper" if self.algorithm(drive.run) in ("", "ddpg") else None
        return "scale" if drive.study == "scale" else None

    def drives_of(self, scope: Scope, method: str, place: str) -> list[Drive]:
        """Return every drive of a method in a world, under PyBullet."""
        return self._judged.get((scope, method, place), [])

    def shown(self, scope: Scope, method: str, place: str) -> list[Drive]:
        """Return the drives that stand for a method in a world.

        Of a trained set those of the run whose best policy succeeds most in its own evaluations, of several settings
        those of the one that succeeds most in this world (paper, IV-B).
        """
        drives = self.drives_of(scope, method, place)
        if runs := sorted({drive.run for drive in drives if drive.run is not None}):
            best = max(runs, key=self.best_success)  # the first of equals
            drives = [drive for drive in drives if drive.run == best]
        settings: dict[tuple[str, str, str], list[Drive]] = {}
        for drive in drives:
            settings.setdefault((drive.setting, drive.noise, drive.agent), []).append(drive)
        return max((settings[key] for key in sorted(settings)), key=lambda each: rate(each).share, default=[])

    def pool(self, scope: Scope, method: str, places: Iterable[str]) -> list[Drive]:
        """Return what stands for a method in several worlds; empty unless it has driven in each of them."""
        each = [self.shown(scope, method, place) for place in places]
        return [drive for drives in each for drive in drives] if all(each) else []

    def seeds(
        self, scope: Scope, method: str, places: Sequence[str], what: Callable[[Drive], bool] = succeeded
    ) -> list[float]:
        """Return the share of a method's drives that are so, one value a run that has driven in all of these worlds."""
        of_run: dict[str, dict[str, list[Drive]]] = defaultdict(lambda: defaultdict(list))
        for place in places:
            for drive in self.drives_of(scope, method, place):
                if drive.run is not None:
                    of_run[drive.run][place].append(drive)
        whole = [of_run[run] for run in sorted(of_run) if len(of_run[run]) == len(places)]
        return [sum(rate(drives, what).share for drives in at.values()) / len(places) for at in whole]

    def on_sets(self, method: str, families: Sequence[str], outcome: str) -> list[float]:
        """Return the share of a method's episodes on held-out tracks that ended so, one value a run at scale."""
        counts: dict[str, list[int]] = defaultdict(lambda: [0, 0])
        for row in self.held_out:
            its = (row["study"], row["method"], row["noise"]) == ("scale", method, "") and row["place"] in families
            if its and row["run"] is not None and not self.variant(row["run"]):
                at = counts[row["run"]]
                at[0] += row["n"] if row["outcome"] == outcome else 0
                at[1] += row["n"]
        return [k / n for _, (k, n) in sorted(counts.items())]

    def compare(
        self, scope: Scope, a: str, b: str, places: Sequence[str], what: Callable[[Drive], bool]
    ) -> tuple[Difference, str] | None:
        """Return how much oftener the drives of `a` are so than those of `b`, and both in words.

        Over runs where enough of either were judged, else over the episodes of those shown; None where one of them has
        not driven in all of these worlds.
        """
        by_seed = [self.seeds(scope, method, places, what) for method in (a, b)]
        if scope == "scale" and all(len(values) >= ENOUGH_SEEDS for values in by_seed):
            x, y = by_seed
            words = "; ".join(
                f"{method} {sum(v) / len(v):.0%} (mean of {len(v)} runs)"
                for method, v in zip((a, b), by_seed, strict=True)
            )
            return seeds_difference(x, y), words
        pools = [self.pool(scope, method, places) for method in (a, b)]
        if not all(pools):
            return None
        one, other = (rate(pool, what) for pool in pools)
        return rate_difference(one, other), f"{a} {one}; {b} {other}"
