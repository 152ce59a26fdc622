"""Makes held-out sets: draws tracks, certifies each, keeps those that belong to the set."""

import re
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path

from zebrat_bullet.config import within
from zebrat_bullet.errors import ConfigError, WorldError
from zebrat_bullet.evaluation.csv_log import CsvLog
from zebrat_bullet.evaluation.track_set import DIGITS, SetTrack, TrackSet, draw_set, save_set
from zebrat_bullet.planning.certificate import Certificate
from zebrat_bullet.planning.certify import certify_all
from zebrat_bullet.processes import MOST_WORKERS
from zebrat_bullet.robot import RobotModel, load_robot
from zebrat_bullet.world import FAMILIES, HELD_OUT_SEED, World, generate_tracks
from zebrat_bullet.world.fingerprint import fingerprint, joint_fingerprint

_REVERSALS = re.compile(r"reversals-(\d+)")
# So many seeds of each family are tried before it is seen whether they suffice; fixed, for it says which are tried.
_BATCH = 128


@dataclass(frozen=True, kw_only=True)
class Recipe:
    """What a set is made of.

    Attributes:
        name: a family of tracks, or "reversals-K": tracks whose certificate has exactly K reversals.
        n_tracks: how many.
        families: where the tracks of "reversals-K" come from, by turns.
        most_seeds: of each family; where they do not suffice there is no set.
        robot: the car.
        workers: processes that certify.
    """

    name: str
    n_tracks: int
    families: tuple[str, ...] = ("manoeuvres",)
    most_seeds: int = 20_000
    robot: str = "zebrat"
    workers: int = 1

    def __post_init__(self) -> None:
        if self.name not in FAMILIES and self.reversals is None:
            known = ", ".join(FAMILIES)
            raise ConfigError(f"no set {self.name!r} can be made; name a family ({known}) or reversals-K")
        if unknown := set(self.families) - set(FAMILIES):
            raise ConfigError(f"no families of tracks {sorted(unknown)}; there are {', '.join(FAMILIES)}")
        if self.n_tracks < 1 or self.workers < 1 or self.most_seeds < 1:
            raise ConfigError("a set takes at least 1 track, 1 worker and 1 seed")
        within(self, n_tracks=(1, 10**6), workers=(1, MOST_WORKERS), most_seeds=(1, 10**9))

    @property
    def reversals(self) -> int | None:
        """Return K of "reversals-K", else None."""
        match = _REVERSALS.fullmatch(self.name)
        return int(match[1]) if match else None

    @property
    def sources(self) -> tuple[str, ...]:
        """Return the families that its tracks come from."""
        return self.families if self.reversals is not None else (self.name,)


@dataclass(frozen=True, kw_only=True)
class Candidate(SetTrack):
    """A track that was tried; a row of its family's table.

    Attributes:
        certified: 1 where the planner found a drive, or no number of it means anything.
        proven: 1 where it proved that there is none.
        fingerprint: the SHA-256 of the track's geometry.
    """

    certified: int
    proven: int


_COLUMNS = tuple(field.name for field in fields(Candidate))


def make_set(
    recipe: Recipe, folder: Path, on_candidate: Callable[[int, int], None] = lambda found, tried: None
) -> tuple[TrackSet, Path]:
    """Try held-out seeds in their order until enough tracks are found; write the set, and check it by drawing it again.

    What was tried is written at once to `candidates/FAMILY.csv`, from which a later call, also for another set of the
    same family, goes on: a kill loses only what was in work. The set does not depend on kills or workers.

    Args:
        recipe: what to make.
        folder: where NAME.json and the candidates are written.
        on_candidate: called with how many tracks are found and how many were tried.

    Raises:
        ConfigError: the seeds do not suffice, or the candidates there are came from another generator.
    """
    robot = load_robot(recipe.robot)
    found: list[Candidate] = []
    tried = 0
    for first in range(HELD_OUT_SEED, HELD_OUT_SEED + recipe.most_seeds, _BATCH):
        seeds = range(first, min(first + _BATCH, HELD_OUT_SEED + recipe.most_seeds))
        batch: list[Candidate] = []
        for family in recipe.sources:
            for candidate in _candidates(
                family, seeds, recipe, robot, folder / "candidates" / Path(recipe.robot.partition(":")[0]).name
            ):
                tried += 1
                batch += [candidate] if _belongs(candidate, recipe) else []
                on_candidate(min(len(found) + len(batch), recipe.n_tracks), tried)
        found += sorted(batch, key=lambda at: (at.seed, recipe.sources.index(at.family)))
        if len(found) >= recipe.n_tracks:
            made = _set_of(found[: recipe.n_tracks], recipe)
            draw_set(made, recipe.workers)
            return made, save_set(made, folder)
    raise ConfigError(
        f"set {recipe.name!r}: only {len(found)} of {recipe.n_tracks} tracks among {tried} of "
        f"{', '.join(recipe.sources)}; allow more seeds, name more families, or ask for fewer tracks"
    )


def _set_of(chosen: Sequence[Candidate], recipe: Recipe) -> TrackSet:
    own = [field.name for field in fields(SetTrack) if field.name != "fingerprint"]
    return TrackSet(
        name=recipe.name,
        robot=recipe.robot,
        sha256=joint_fingerprint(at.fingerprint for at in chosen),
        tracks=tuple(
            SetTrack(**{name: getattr(at, name) for name in own}, fingerprint=at.fingerprint[:DIGITS]) for at in chosen
        ),
    )


def _belongs(candidate: Candidate, recipe: Recipe) -> bool:
    return bool(candidate.certified) and recipe.reversals in (None, candidate.reversals)


def _candidates(family: str, seeds: range, recipe: Recipe, robot: RobotModel, folder: Path) -> Iterator[Candidate]:
    """Yield the candidates of some seeds, those that a table holds from there."""
    folder.mkdir(parents=True, exist_ok=True)
    log = CsvLog(folder / f"{family}.csv", _COLUMNS)
    rows = [Candidate(**{f.name: f.type(row[f.name]) for f in fields(Candidate)}) for row in log.rows()]  # type: ignore[operator]
    known = {row.seed: row for row in rows}
    yield from (known[seed] for seed in seeds if seed in known)
    missing = [seed for seed in seeds if seed not in known]
    waiting: deque[tuple[int, World]] = deque()

    def worlds() -> Iterator[World]:
        for seed in missing:
            try:
                (world,) = generate_tracks([seed], family=family, robot=robot)
            except WorldError:  # no track has this seed
                continue
            waiting.append((seed, world))
            yield world

    if not missing:
        return
    for result in certify_all(worlds(), robot, workers=recipe.workers):
        candidate = _candidate(family, *waiting.popleft(), result)
        log.append(asdict(candidate))
        yield candidate


def _candidate(family: str, seed: int, world: World, result: Certificate | Exception) -> Candidate:
    return Candidate(
        family=family,
        seed=seed,
        difficulty=world.difficulty or 0.0,
        reversals=result.n_reversals if isinstance(result, Certificate) else 0,
        clearance_m=float(result.clearance_m) if isinstance(result, Certificate) else 0.0,
        length_m=float(result.length_m) if isinstance(result, Certificate) else 0.0,
        least_time_s=float(result.least_time_s) if isinstance(result, Certificate) else 0.0,
        certified=int(isinstance(result, Certificate)),
        proven=int(getattr(result, "proven", False)),
        fingerprint=fingerprint(world),
    )
