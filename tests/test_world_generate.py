"""Generated tracks are valid, reproducible and as long as asked."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import count, islice
from pathlib import Path

import numpy as np
import pytest
import shapely
import trimesh

from zebrat_bullet.config import EpisodeConfig
from zebrat_bullet.errors import ConfigError, WorldError
from zebrat_bullet.geometry import footprint_hits
from zebrat_bullet.robot import load_robot
from zebrat_bullet.task.episode import draw_pose
from zebrat_bullet.world import (
    HELD_OUT_SEED,
    World,
    generate_spec,
    generate_track,
    generate_tracks,
    load_world,
    world_summary,
)
from zebrat_bullet.world.build import build_world
from zebrat_bullet.world.generate import _check_closed
from zebrat_bullet.world.schema import WorldSpec
from zebrat_bullet.world.solid import ExtrudedMesh, Solid, extrude, join
from zebrat_bullet.world.validate import validate_world

ROBOT = load_robot("zebrat")


@pytest.mark.parametrize("seed", [-1, 1.5, "a", True])
def test_a_seed_that_is_none_is_refused(seed: object) -> None:
    for make in (lambda: next(generate_tracks([seed])), lambda: generate_spec(seed)):  # type: ignore[list-item,arg-type]
        with pytest.raises(ConfigError, match=r"a seed must be (a whole number|at least 0)"):
            make()


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"difficulty": "hard"}, r"difficulty must be 0 \(easy\) to 1 \(hard\), got 'hard'"),
        ({"family": []}, "family is empty; name at least one of mixed"),
        ({"workers": "a"}, "workers must be a whole number"),
        ({"seeds": 5}, "seeds must be a range or a list, got 5"),
        ({"robot": 5}, "a robot must be a RobotModel, got 5; name one"),
    ],
)
def test_what_no_track_can_be_drawn_by_is_refused_at_once(wrong: dict[str, object], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        generate_tracks(**({"seeds": [0]} | wrong))  # type: ignore[arg-type]


def test_a_car_may_be_named_and_randomness_be_no_number() -> None:
    named, loaded = (next(generate_tracks([np.int64(4)], robot=robot)) for robot in ("long", load_robot("long")))
    assert named.walls.equals(loaded.walls) and load_world("track_2", robot="zebrat").name == "track_2"
    with pytest.raises(ConfigError, match=r"rng must be a Generator, got 5; give np.random.default_rng\(SEED\)"):
        generate_track(5)  # type: ignore[arg-type]


def test_generated_tracks_are_valid_and_of_the_length_asked_for() -> None:
    rng = np.random.default_rng(0)
    for _ in range(15):
        world = generate_track(rng, robot=ROBOT)
        validate_world(world, ROBOT, "generated")
        # The centre line begins 1.5 m from the closed end and runs 1 m past the open-space line.
        course = np.hypot(*np.diff(world.centre_line, axis=0).T).sum() + 0.5
        assert 6.0 <= course <= 15.0
        assert world.widths_m.min() >= 0.99 and world.widths_m.max() <= 2.0
        assert len(world.turns_deg) >= 1


def test_the_same_random_state_gives_the_same_track() -> None:
    first, again = (generate_track(np.random.default_rng(7), robot=ROBOT) for _ in range(2))
    other = generate_track(np.random.default_rng(8), robot=ROBOT)
    assert np.array_equal(first.mesh.vertices, again.mesh.vertices)
    assert np.array_equal(first.centre_line, again.centre_line) and first.start == again.start
    assert not np.array_equal(first.centre_line, other.centre_line)


def test_tight_corners_and_u_turns_come_often() -> None:
    turns = np.concatenate([world.turns_deg for world in generate_tracks(range(100), difficulty=1.0)])
    assert set(np.abs(turns)) == {90.0, 180.0}
    assert 0.1 < np.mean(np.abs(turns) == 180.0) < 0.5
    assert 0.4 < np.mean(turns > 0) < 0.6


def same_track(one: World, other: World) -> bool:
    """Return whether two worlds are equal bit for bit, name and all, their meshes left unmade."""
    return (
        (one.name, one.start, one.turns_deg) == (other.name, other.start, other.turns_deg)
        and all(
            np.array_equal(getattr(one, field), getattr(other, field))
            for field in ("centre_line", "widths_m", "waypoints", "open_line")
        )
        and shapely.to_wkb(one.walls) == shapely.to_wkb(other.walls)
        and shapely.to_wkb(one.free_space) == shapely.to_wkb(other.free_space)
    )


def test_a_track_is_a_function_of_its_seed_alone_whatever_the_workers_and_the_neighbours() -> None:
    seeds = [11, 3, 900_001, *range(20, 40)]
    alone = [generate_track(np.random.default_rng(seed), robot=ROBOT, name=f"generated-{seed}") for seed in seeds]
    here = list(generate_tracks(seeds))
    spread = list(generate_tracks(seeds, workers=2))
    assert [world.name for world in spread] == [f"generated-{seed}" for seed in seeds]
    for one, other, third in zip(alone, here, spread, strict=True):
        assert same_track(one, other) and same_track(other, third)


def test_seeds_may_go_on_for_ever_and_are_taken_as_they_are_needed() -> None:
    taken = []

    def seeds() -> Iterator[int]:
        for seed in count():
            taken.append(seed)
            yield seed

    for workers in (1, 2):
        taken.clear()
        tracks = islice(generate_tracks(seeds(), workers=workers), 3)
        assert [world.name for world in tracks] == ["generated-0", "generated-1", "generated-2"]
        assert len(taken) < 100


def test_what_was_asked_for_reaches_the_tracks_of_every_worker() -> None:
    for world in generate_tracks(range(8), workers=2, difficulty=1.0):
        assert {abs(turn) for turn in world_summary(world)["turns_deg"]} <= {90, 180}


def test_fewer_than_one_worker_is_refused_at_once() -> None:
    with pytest.raises(ConfigError, match=r"at least 1.* got 0"):
        generate_tracks(range(3), workers=0)


def test_held_out_tracks_differ_from_those_to_train_on_and_from_each_other() -> None:
    trained = list(generate_tracks(range(60)))
    held_out = list(generate_tracks(range(HELD_OUT_SEED, HELD_OUT_SEED + 60)))
    assert len({shapely.to_wkb(world.walls) for world in trained + held_out}) == 120


@pytest.mark.parametrize("name", ["big_track", "track_4", "real_3"])
def test_a_shipped_worlds_mesh_is_its_prisms_one_after_the_other(name: str) -> None:
    mesh = load_world(name).mesh
    assert isinstance(mesh, ExtrudedMesh)
    made = join([extrude(solid.outline, solid.bottom_m, solid.top_m) for solid in mesh.solids])
    assert np.array_equal(mesh.vertices, made.vertices) and np.array_equal(mesh.faces, made.faces)
    assert mesh.vertices is mesh.vertices and mesh.faces.dtype == np.int32


def test_the_mesh_of_a_generated_track_is_made_when_first_looked_at_and_is_closed() -> None:
    n_hollow = 0
    for world in generate_tracks(range(200)):
        mesh = world.mesh
        assert isinstance(mesh, ExtrudedMesh)
        hollow = any(solid.outline.interiors for solid in mesh.solids)
        n_hollow += hollow
        assert hollow or "_made" not in vars(mesh)
        body = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
        assert body.is_watertight and body.is_winding_consistent and body.volume > 0
    assert n_hollow > 0, "some track must lie so that its walls enclose a hollow, or nothing was tested"


def is_boxed(world: World) -> bool:
    assert isinstance(world.mesh, ExtrudedMesh)
    return len({solid.top_m for solid in world.mesh.solids}) > 5


def n_buttresses(world: World) -> int:
    """Return how many blocks stand in a smooth-walled track."""
    assert isinstance(world.mesh, ExtrudedMesh)
    return sum(solid.outline.area < 0.2 for solid in world.mesh.solids)


@pytest.fixture(scope="module")
def varied() -> list[World]:
    return list(generate_tracks(range(240)))


def test_mixed_tracks_have_box_walls_runs_of_right_angles_narrow_places_and_two_buttresses(varied: list[World]) -> None:
    def share(has: Callable[[World], bool]) -> float:
        return float(np.mean([has(world) for world in varied]))

    def run_of_three(world: World) -> bool:
        turns = [abs(turn) for turn in world.turns_deg]
        return any(turns[i : i + 3] == [90.0] * 3 for i in range(len(turns)))

    # Points stand a decimetre apart, so that eight of them make a place longer than a step in width.
    def long_narrow(world: World) -> bool:
        return bool((np.convolve(world.widths_m <= 1.065, np.ones(8), "valid") == 8).any())

    assert 0.08 < share(is_boxed) < 0.22
    assert share(run_of_three) > 0.1 and share(long_narrow) > 0.1
    assert {n_buttresses(world) for world in varied if not is_boxed(world)} == {0, 1, 2}


def test_a_mixed_track_keeps_to_its_widths(varied: list[World]) -> None:
    for world in varied:
        validate_world(world, ROBOT, world.name)
        assert world.widths_m.min() >= 0.99 and world.widths_m.max() <= 2.0
        assert world.free_space.is_valid and not world.free_space.interiors


def test_the_walls_of_a_mixed_track_are_whole_all_along_but_for_the_exit(varied: list[World]) -> None:
    # Rounding once lost a box of the last of these.
    for world in [*varied, *generate_tracks([901_004])]:
        # Between two boxes 3 cm may be open, and a box may stand back 3 cm.
        open_m = world.free_space.boundary.difference(world.walls.buffer(0.05)).length
        assert open_m < np.hypot(*np.diff(world.open_line, axis=0)[0]) - 0.1 + 2e-3, world.name


def test_a_car_can_start_anywhere_along_a_mixed_track(varied: list[World]) -> None:
    rng = np.random.default_rng(0)
    for world in varied:
        poses = [draw_pose(world, ROBOT, EpisodeConfig(start="anywhere"), rng) for _ in range(6)]
        assert not any(footprint_hits(world.walls, ROBOT.footprint_base, pose) for pose in poses)


@pytest.mark.parametrize(
    ("difficulty", "ends"),
    [
        (0.6, {0: (3.950, -8.270), 1: (2.364, -3.172), 900_000: (4.410, -4.410), 900_001: (8.345, 5.110)}),
        (0.8, {0: (-2.514, -7.344), 1: (1.350, 6.010), 900_000: (4.410, -4.410), 900_001: (0.040, -6.130)}),
    ],
)
def test_mixed_tracks_are_those_that_published_scores_rest_on(
    difficulty: float, ends: dict[int, tuple[float, float]]
) -> None:
    for world in generate_tracks(ends, difficulty=difficulty):
        assert np.allclose(world.centre_line[-1], ends[int(world.name.split("-")[1])], atol=1e-3)


def corridor(*segments: tuple[float, ...]) -> WorldSpec:
    """Return a track of (straight, width) and (turn, radius, width)."""
    names = {2: ("straight", "width"), 3: ("turn", "radius", "width")}
    rows = [dict(zip(names[len(row)], row, strict=True)) for row in segments]
    return WorldSpec.model_validate({"name": "corridor", "segments": rows})


def test_a_hair_thin_hole_that_rounding_leaves_in_a_corridor_is_no_hole() -> None:
    # The union of these had one outside of its own outline, and GEOS refused to go on.
    spec = corridor(
        (2.58, 1.25), (0.77, 1.59), (-45, 0, 1.59), (1.24, 1.59), (0.21, 1.11), (90, 1.06, 1.11), (0.99, 1.11),
        (0.28, 1.51), (127, 1.65, 1.51), (1.05, 1.51), (0.89, 1.14), (1.38, 1.14),
    )  # fmt: skip
    assert build_world(spec, Path("corridor")).free_space.is_valid


def test_walls_that_geos_cannot_lay_are_refused_like_any_other_bad_draw() -> None:
    spec = corridor(
        (2.93, 1.69), (0.61, 1.52), (-45, 0, 1.52), (1.14, 1.52), (0.53, 1.48), (180, 0.85, 1.48), (0.89, 1.48),
        (0.96, 1.47), (-45, 0, 1.47), (1.45, 1.47), (1.05, 1.47),
    )  # fmt: skip
    with pytest.raises(WorldError, match="walls cannot stand there"):
        build_world(spec, Path("corridor"))


def test_a_generated_track_whose_wall_touches_itself_in_a_point_is_refused() -> None:
    (world,) = generate_tracks([0])
    outline = shapely.Polygon([(0, 0), (4, 0), (4, 4), (0, 4)], [[(0, 0), (2, 1), (1, 2)]])
    with pytest.raises(WorldError, match="touches itself"):
        _check_closed(replace(world, mesh=ExtrudedMesh([Solid(outline, 0.0, 1.0)])))
