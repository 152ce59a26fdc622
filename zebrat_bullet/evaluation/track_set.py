"""Named sets of certified tracks that nobody trains on: a file of seeds, and the tracks drawn again from it."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path

from zebrat_bullet.assets import find_asset
from zebrat_bullet.config_text import from_json
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.files import read_json, refusing
from zebrat_bullet.outputs import written_whole
from zebrat_bullet.robot import load_robot
from zebrat_bullet.world import World, generate_tracks
from zebrat_bullet.world.fingerprint import fingerprint, joint_fingerprint

FOLDER = "worlds/sets"
"""The kind of asset that shipped sets are."""
DIGITS = 12
"""Of the SHA-256 of a track that a set holds."""
_A_PROCESS = 300
"""As many tracks are drawn in the time that a process takes to start."""


@dataclass(frozen=True, kw_only=True)
class SetTrack:
    """One track of a set, and its certificate in numbers.

    Attributes:
        family, seed: from which it is drawn.
        difficulty: 0 easy to 1 hard.
        reversals, clearance_m, length_m: of the certified drive.
        least_time_s: no drive takes less.
        fingerprint: how the SHA-256 of its geometry begins.
    """

    family: str
    seed: int
    difficulty: float
    reversals: int
    clearance_m: float
    length_m: float
    least_time_s: float
    fingerprint: str


@dataclass(frozen=True, kw_only=True)
class TrackSet:
    """A set of tracks.

    Attributes:
        name: of the set.
        robot: the car that the tracks are certified for.
        sha256: of the geometry of all tracks in their order.
        tracks: its tracks.
    """

    name: str
    robot: str
    sha256: str
    tracks: tuple[SetTrack, ...]


_COLUMNS = [field.name for field in fields(SetTrack)]


def save_set(tracks: TrackSet, folder: Path) -> Path:
    """Write a set as `folder`/NAME.json, a track a line, whole or not at all, and return its path."""
    head = {"name": tracks.name, "robot": tracks.robot, "sha256": tracks.sha256, "columns": _COLUMNS}
    rows = ",\n".join(f"  {json.dumps(list(asdict(track).values()))}" for track in tracks.tracks)
    path = folder / f"{tracks.name}.json"
    with written_whole(path) as part:
        part.write_text(f'{json.dumps(head, indent=1)[:-2]},\n "tracks": [\n{rows}\n ]\n}}\n', encoding="utf-8")
    return path


def read_set(name_or_path: str) -> TrackSet:
    """Read a shipped set by name, or any by path; draws no track.

    Raises:
        AssetError: there is none; the message lists those there are.
        ConfigError: the file is not a set.
    """
    path = find_asset(FOLDER, name_or_path, ".json")
    with refusing(path, ConfigError, "is not a set of tracks", "make one with `zebrat sets --make`"):
        data = read_json(path, ConfigError)
        columns = data.pop("columns")
        data["tracks"] = [dict(zip(columns, row, strict=True)) for row in data["tracks"]]
        return from_json(TrackSet, json.dumps(data))


def draw_set(tracks: TrackSet, workers: int = 1, *, only: Sequence[int] | None = None) -> list[World]:
    """Draw the tracks of a set.

    Args:
        tracks: the set.
        workers: processes.
        only: the places of those wanted, in their order; None draws all.

    Raises:
        ConfigError: they are not those certified: the generator is of another version than the set's.
    """
    robot = load_robot(tracks.robot)
    wanted = tracks.tracks if only is None else [tracks.tracks[i] for i in only]
    drawn: dict[tuple[str, int], World] = {}
    for family in sorted({track.family for track in wanted}):
        seeds = [track.seed for track in wanted if track.family == family]
        worth = min(workers, 1 + len(seeds) // _A_PROCESS)
        of_family = generate_tracks(seeds, family=family, robot=robot, workers=worth)
        drawn |= {(family, seed): world for seed, world in zip(seeds, of_family, strict=True)}
    worlds = [drawn[track.family, track.seed] for track in wanted]
    prints = [fingerprint(world) for world in worlds]
    others = [track for track, found in zip(wanted, prints, strict=True) if track.fingerprint != found[:DIGITS]]
    if others or (only is None and joint_fingerprint(prints) != tracks.sha256):
        which = f"{len(others)} of {len(wanted)}, the first of seed {others[0].seed}" if others else "another order"
        raise ConfigError(
            f"set {tracks.name!r}: its seeds give other tracks here than those certified ({which}): "
            "the generator has changed; make the set anew with `zebrat sets --make`"
        )
    return worlds
