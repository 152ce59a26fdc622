"""The tables of records as the report asks of them: who drove where, and which episodes stand for a method."""

import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.evaluation.endings import BACKED_M
from zebrat_bullet.report.comparison.statistics import Rate

TRACKS = tuple(f"track_{i}" for i in range(1, 9))
UNSEEN = TRACKS[3:]
REAL = ("real_1", "real_2", "real_3")  # like those of the paper's real-world test (IV-D)
RIGHT_ANGLES = ("track_2", "track_7")
STRAIGHT_OUT = ("corridors", "corners", "uturns", "curves", "uneven", "bottlenecks", "boxes", "niches")
"""Held-out sets of tracks that need no reversing."""
VARIANTS = {"": "", "crash": "a contact costs 400", "margin": "2 cm from a wall count as touched while it learns"}
"""What sets runs at scale apart from those of the paper's rewards as they are, in words."""
METHODS = ("DWA", "TEB", "IL", "RL_WG", "RL_FT", "RL_FOT", "RL_FOMT")
"""In the order of the paper's Table II."""
OURS = "RL_FOMT"
Way = NDArray[np.float32]
"""(N, 2) places of the body centre in m, world frame."""
Scope = Literal["paper", "finetuned", "cloning", "scale"]
"""At the paper's budget, before its fine-tuning, after it, or after it with cloning; at scale, with fairer rivals."""
_OF_FINETUNING: dict[str, Scope] = {"": "finetuned", "cloning": "cloning"}
"""By the variant of the run."""
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
    backed_m: float | None
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
    """Return whether the car drove back at least `BACKED_M` in one go; a command alone need not move it."""
    return drive.backed_m is not None and drive.backed_m >= BACKED_M


def backed_out(drive: Drive) -> bool:
    """Return whether the car backed up, and left."""
    return drive.success and backed_up(drive)


def rate(drives: Sequence[Drive], what: Callable[[Drive], bool] = succeeded) -> Rate:
    """Return how many of the drives are so."""
    return Rate(sum(map(what, drives)), len(drives))


def _contestant(drive: Drive) -> tuple[str, ...]:
    """Return what tells who drives from other contestants of the same method: run, setting, noise, agent."""
    return drive.run or "", drive.setting, drive.noise, drive.agent


class Evidence:
    """What the five tables say, as `zebrat_bullet.comparison.tables` reads them.

    Attributes:
        runs, learning, collisions: rows, as dictionaries by column.
        drives: episodes in worlds.
        held_out: counts of episodes on held-out sets: study, method, setting, noise, run, sim, place, family,
            reversals (of the certificate), outcome, backed (whether the car backed up; None where nobody knows), n.
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
        backed = [None if way_m is None else way_m >= BACKED_M for way_m in on_tracks["backed_m"].to_pylist()]
        keys.append("backed")
        counted = on_tracks.append_column("backed", [backed]).group_by(keys).aggregate([([], "count_all")])
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

    def is_asked(self, scope: Scope, method: str) -> bool:
        """Return whether a set is trained in a scope at all, finished or not; of what is not trained here True."""
        reward = method.removeprefix("RL_").lower()
        return reward == method.lower() or any((run["study"], run["reward"]) == (scope, reward) for run in self.runs)

    def _rank(self, run: str | None) -> tuple[float, float, float]:
        """Return the order in which runs are better: their best policy's success, collisions and time, as it judged."""
        row = self._by_run.get(run or "", {})
        success, collision, time_s = (row.get(f"best_{name}") for name in ("success", "collision", "time_s"))
        return -1.0 if success is None else success, -(collision or 0.0), -(math.inf if time_s is None else time_s)

    @cached_property
    def _judged(self) -> dict[tuple[Scope, str, str], list[Drive]]:
        """Drives in PyBullet by scope, method and place; no variants of a reward, and noise of rivals alone."""
        found = defaultdict(list)
        for drive in self.drives:
            if drive.sim == "bullet" and (scope := self._scope(drive)):
                found[scope, drive.method, drive.place].append(drive)
        return found

    def _scope(self, drive: Drive) -> Scope | None:
        """Return what a drive is evidence for."""
        if drive.study == "rivals":
            known = drive.setting in PAPER_SETTINGS.get(drive.method, ())
            return "paper" if known and not drive.noise else "scale"
        variant = self.variant(drive.run)
        if drive.study == "finetuning" and not drive.noise:
            return _OF_FINETUNING.get(variant)
        if drive.noise or variant:
            return None
        if drive.study == "paper" and self.algorithm(drive.run) in ("", "ddpg"):
            return "paper"
        return "scale" if drive.study == "scale" else None

    def drives_of(self, scope: Scope, method: str, place: str) -> list[Drive]:
        """Return every drive of a method in a world, under PyBullet."""
        return self._judged.get((scope, method, place), [])

    @cached_property
    def _chosen(self) -> dict[tuple[Scope, str], tuple[str, ...]]:
        """What tells the drives that stand for a method from its others."""
        found: dict[tuple[Scope, str], dict[tuple[str, ...], list[Drive]]] = defaultdict(lambda: defaultdict(list))
        for (scope, method, _), drives in self._judged.items():
            for drive in drives:
                found[scope, method][_contestant(drive)].append(drive)

        def better(key: tuple[str, ...], drives: Sequence[Drive]) -> tuple[Any, ...]:
            if key[0]:
                return self._rank(key[0])  # not by the drives that are to be reported
            own = [drive for drive in drives if drive.place in TRACKS]
            times = [drive.duration_s for drive in own if drive.success]
            share = rate(own).share if own else -1.0
            return len({drive.place for drive in own}), share, -np.mean(times) if times else -np.inf

        return {
            who: max(sorted(contestants), key=lambda key: better(key, contestants[key]))  # the first of equals
            for who, contestants in found.items()
        }

    def shown(self, scope: Scope, method: str, place: str) -> list[Drive]:
        """Return the drives that stand for a method in a world.

        Of a trained set those of the run whose best policy ranks highest in its own evaluations; of several settings
        those of the one that succeeds most over Tracks 1 to 8, then of the fastest (paper, IV-C: the better radius).
        """
        chosen = self._chosen.get((scope, method))
        return [drive for drive in self.drives_of(scope, method, place) if _contestant(drive) == chosen]

    def label(self, scope: Scope, method: str) -> str:
        """Return a method's name, with the setting that stands for it where it has several."""
        _, setting, noise, _ = self._chosen.get((scope, method), ("",) * 4)
        return ": ".join(filter(None, (method, ", ".join(filter(None, (setting, noise))))))

    def pool(self, scope: Scope, method: str, places: Iterable[str]) -> list[Drive]:
        """Return what stands for a method in several worlds; empty unless it has driven in each of them."""
        each = [self.shown(scope, method, place) for place in places]
        return [drive for drives in each for drive in drives] if all(each) else []

    def of_seeds(self, scope: Scope, method: str, places: Sequence[str]) -> list[dict[str, list[Drive]]]:
        """Return a method's drives by world, one dictionary a run that has driven in all of these worlds."""
        return [at for at in self.by_run(scope, method, places).values() if len(at) == len(places)]

    def seeds(
        self, scope: Scope, method: str, places: Sequence[str], what: Callable[[Drive], bool] = succeeded
    ) -> list[float]:
        """Return the share of a method's drives that are so, one value a run that has driven in all of these worlds."""
        runs = self.of_seeds(scope, method, places)
        return [sum(rate(drives, what).share for drives in at.values()) / len(places) for at in runs]

    def by_run(self, scope: Scope, method: str, places: Iterable[str]) -> dict[str, dict[str, list[Drive]]]:
        """Return a method's drives by run, then by world, of those that the run has driven."""
        found: dict[str, dict[str, list[Drive]]] = defaultdict(lambda: defaultdict(list))
        for place in places:
            for drive in self.drives_of(scope, method, place):
                if drive.run is not None:
                    found[drive.run][place].append(drive)
        return {run: dict(at) for run, at in sorted(found.items())}

    def on_sets(self, method: str, families: Sequence[str], outcome: str, variant: str = "") -> list[float]:
        """Return the share of its episodes on held-out sets that ended so, one value a run that drove them all."""
        counts: dict[str, dict[str, list[int]]] = defaultdict(lambda: defaultdict(lambda: [0, 0]))
        for row in self.held_out:
            its = (row["study"], row["method"], row["noise"]) == ("scale", method, "") and row["place"] in families
            if its and row["run"] is not None and self.variant(row["run"]) == variant:
                at = counts[row["run"]][row["place"]]
                at[0] += row["n"] if row["outcome"] == outcome else 0
                at[1] += row["n"]
        whole = [list(counts[run].values()) for run in sorted(counts) if len(counts[run]) == len(families)]
        return [sum(k for k, _ in of_run) / sum(n for _, n in of_run) for of_run in whole]
