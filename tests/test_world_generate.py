"""Generated tracks are valid, reproducible and as long as asked."""

from collections.abc import Iterator
from itertools import count, islice

import numpy as np
import pytest
import shapely
import trimesh

from zebrat_bullet.errors import ConfigError, WorldError
from zebrat_bullet.robot import load_robot
from zebrat_bullet.world import HELD_OUT_SEED, World, generate_track, generate_tracks, load_world, world_summary
from zebrat_bullet.world.solid import ExtrudedMesh, extrude, join
from zebrat_bullet.world.validate import validate_world

ROBOT = load_robot("zebrat")


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
    rng = np.random.default_rng(3)
    turns = [
        turn for _ in range(30) for turn in world_summary(generate_track(rng, tightness=1.0, robot=ROBOT))["turns_deg"]
    ]
    assert {abs(turn) for turn in turns} == {90, 180}
    assert 0.1 < np.mean([abs(turn) == 180 for turn in turns]) < 0.5
    assert 0.3 < np.mean([turn > 0 for turn in turns]) < 0.7


def test_a_length_that_no_track_can_have_is_refused() -> None:
    with pytest.raises(WorldError, match="length_m"):
        generate_track(np.random.default_rng(0), length_m=(1.0, 1.5), robot=ROBOT)


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
    for world in generate_tracks(range(4), workers=2, length_m=(8.0, 9.0), tightness=1.0):
        facts = world_summary(world)
        # The start is 1.5 m from the closed end.
        assert 6.5 - 0.05 <= float(str(facts["length_m"])) <= 7.5 + 0.05
        assert {abs(turn) for turn in facts["turns_deg"]} <= {90, 180}


def test_fewer_than_one_worker_is_refused_at_once() -> None:
    with pytest.raises(ConfigError, match="at least 1, got 0"):
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
    assert n_hollow >= 3, "some tracks must lie so that their walls enclose a hollow, or nothing was tested"
