"""Each family of tracks is valid at every difficulty, reproducible, and the narrower the harder."""

from pathlib import Path

import numpy as np
import pytest
import shapely
from test_world_generate import ROBOT, same_track

from zebrat_bullet.arrays import on_host
from zebrat_bullet.config import TaskConfig
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.geometry import footprint_hits
from zebrat_bullet.planar.drive import PlanarDrive
from zebrat_bullet.task.drive import Drive
from zebrat_bullet.task.episode import anywhere_poses, start_pose
from zebrat_bullet.world import (
    FAMILIES,
    HELD_OUT_SEED,
    World,
    difficulty_of,
    generate_spec,
    generate_track,
    generate_tracks,
    load_world,
    world_summary,
)
from zebrat_bullet.world.schema import write_spec
from zebrat_bullet.world.validate import validate_world

DIFFICULTIES = (0.0, 0.5, 1.0)
OWN = FAMILIES[1:]
REVERSING = ("narrowing", "manoeuvres", "deadends")
CAR_WIDTH_M = float(np.ptp(ROBOT.footprint_base[:, 1]))


@pytest.fixture(scope="module", params=FAMILIES)
def tracks(request: pytest.FixtureRequest) -> dict[float, list[World]]:
    """Ten tracks of a family at each of three difficulties."""
    return {d: list(generate_tracks(range(10), family=request.param, difficulty=d)) for d in DIFFICULTIES}


def worlds_of(tracks: dict[float, list[World]]) -> list[World]:
    return [world for some in tracks.values() for world in some]


def test_a_track_of_every_family_and_difficulty_is_valid_whole_and_of_its_length(
    tracks: dict[float, list[World]],
) -> None:
    for world in worlds_of(tracks):
        validate_world(world, ROBOT, world.name)
        length_m = float(str(world_summary(world)["length_m"]))
        assert (3.0 if world.family in REVERSING else 4.4) <= length_m <= 14.0
        assert world.widths_m.min() > CAR_WIDTH_M
        assert shapely.Point(world.waypoints[-1]).distance(shapely.LineString(world.open_line)) == pytest.approx(1.0)
        assert not footprint_hits(world.walls, ROBOT.footprint_base, world.start.pose)


def test_a_car_can_start_anywhere_along_the_way_and_in_its_start_range(tracks: dict[float, list[World]]) -> None:
    rng = np.random.default_rng(0)
    for world in worlds_of(tracks):
        assert len(anywhere_poses(world, ROBOT, rng, 8)) == 8
        starts = [start_pose(world, rng) for _ in range(4)]
        assert not any(footprint_hits(world.walls, ROBOT.footprint_base, pose) for pose in starts)


@pytest.mark.parametrize("family", OWN)
def test_harder_tracks_of_a_family_are_narrower(family: str) -> None:
    easy, medium, hard = (
        np.mean([world.widths_m.min() for world in generate_tracks(range(10), family=family, difficulty=difficulty)])
        for difficulty in DIFFICULTIES
    )
    step_m = 0.03 if family == "manoeuvres" else 0.08
    assert easy - medium > step_m and medium - hard > step_m


def test_a_family_is_the_same_place_in_the_plane_and_in_pybullet(tracks: dict[float, list[World]]) -> None:
    worlds, task = [tracks[d][0] for d in DIFFICULTIES], TaskConfig()
    plane = PlanarDrive(task, worlds, len(worlds))
    plane.begin_at(np.arange(len(worlds), dtype=np.int32), [world.start.pose for world in worlds])
    drive = Drive(task, worlds[0])
    for world, ranges in zip(worlds, on_host(plane.sim.ranges), strict=True):
        seen = drive.reset(np.random.default_rng(0), world, world.start.pose).clearance.obs_m
        assert not drive.state.contact
        # Of boxes a ray may meet one edge here and the next there.
        assert np.quantile(np.abs(seen - ranges), 0.9) < 0.02, world.name
    drive.close()


@pytest.mark.parametrize("family", OWN)
def test_a_family_is_drawn_alike_alone_in_processes_and_from_its_file(family: str, tmp_path: Path) -> None:
    seeds = [7, 3, HELD_OUT_SEED + 1]
    alone = [generate_track(np.random.default_rng(seed), family=family, name=f"{family}-{seed}") for seed in seeds]
    spread = generate_tracks(seeds, family=family, workers=2)
    for seed, one, other in zip(seeds, alone, spread, strict=True):
        assert same_track(one, other)
        loaded = load_world(write_spec(generate_spec(seed, family=family), tmp_path))
        assert same_track(one, loaded)
        assert np.array_equal(one.mesh.vertices, loaded.mesh.vertices)
        assert one.family == loaded.family == family
        assert one.difficulty == other.difficulty == loaded.difficulty == difficulty_of(seed, family)


def test_difficulties_are_drawn_from_the_whole_range_and_mixed_ones_are_what_was_published() -> None:
    drawn = [difficulty_of(seed, "corners") for seed in range(200)]
    assert np.histogram(drawn, bins=4, range=(0.0, 1.0))[0].min() > 30
    assert {difficulty_of(seed) for seed in range(5)} == {0.6}


def test_held_out_tracks_of_a_family_are_others() -> None:
    seeds = [*range(10), *range(HELD_OUT_SEED, HELD_OUT_SEED + 10)]
    for family in OWN:
        tracks = generate_tracks(seeds, family=family, difficulty=0.5)
        assert len({shapely.to_wkb(world.walls) for world in tracks}) == 20


def widest_turn(world: World) -> float:
    return max((abs(turn) for turn in world.turns_deg), default=0.0)


def test_families_are_what_their_names_say() -> None:
    def some(family: str) -> list[World]:
        return list(generate_tracks(range(12), family=family, difficulty=1.0))

    assert all(15 <= abs(turn) <= 60 for world in some("corridors") for turn in world.turns_deg)
    assert all(abs(turn) == 90 for world in some("corners") for turn in world.turns_deg)
    # Two corners that turn the same way close together are a U-turn about a thin wall.
    assert {widest_turn(world) for world in some("uturns")} == {90.0, 180.0}
    assert all(30 <= abs(turn) <= 180 for world in some("curves") for turn in world.turns_deg)
    assert max(len(world.turns_deg) for world in some("curves")) > 2
    assert all(np.ptp(world.widths_m) > 0.3 for world in some("uneven"))
    assert all(world.widths_m.min() < CAR_WIDTH_M + 0.1 for world in some("bottlenecks"))
    assert all(len(world.walls.geoms) > 10 for world in some("boxes"))
    for family in ("niches", "deadends"):
        pockets = [
            world.free_space.area - world.free_space.intersection(corridor(world)).area for world in some(family)
        ]
        assert np.mean(np.array(pockets) > 1.0) > 0.5
    ahead = [np.exp(1j * world.start.pose.yaw) for world in some("deadends")]
    way = [complex(*(world.centre_line[1] - world.centre_line[0])) for world in some("deadends")]
    assert all((a.conjugate() * w).real < 1e-6 for a, w in zip(ahead, way, strict=True))


def corridor(world: World) -> shapely.Geometry:
    """Return the ground within half a width of the centre line, from the closed end on."""
    line = np.vstack([[0.0, 0.0], world.centre_line])
    return shapely.LineString(line).buffer(world.widths_m.max() / 2 + 0.05, join_style="mitre", cap_style="square")


def test_what_no_family_can_be_is_refused() -> None:
    with pytest.raises(ConfigError, match="no family of tracks 'ring': name one of mixed, corridors"):
        generate_tracks(range(2), family="ring")
    for difficulty in (-0.1, 1.1, float("nan")):
        with pytest.raises(ConfigError, match=r"0 \(easy\) to 1"):
            generate_track(np.random.default_rng(0), family="boxes", difficulty=difficulty)
    with pytest.raises(ConfigError, match="ring"):
        difficulty_of(3, "ring")
