"""Refuses worlds where the body of the car would hit what is none of the walls: what hangs above or lies below them."""

import shapely

from zebrat_bullet.errors import WorldError
from zebrat_bullet.robot import RobotModel
from zebrat_bullet.world.elements import LOWEST_WALL_M
from zebrat_bullet.world.mesh_walls import BAND_M, HIGHEST_CUT_M, beyond, seen_from_above
from zebrat_bullet.world.solid import ExtrudedMesh, polygons_of
from zebrat_bullet.world.world import World

# So far past the open-space line an episode may go on.
_PAST_LINE_M = 1.0


def check_clearance(world: World, robot: RobotModel, source: str) -> None:
    """Refuse what the body reaches and neither planners nor planar cars know of, over floor where the car may drive.

    Args:
        world: what was built.
        robot: how high and how low its body reaches.
        source: the file, for the message.

    Raises:
        WorldError: names the file, the place and the remedy.
    """
    above = _no_wall(world, HIGHEST_CUT_M, robot.body_top_m)
    if above is not None:
        raise WorldError(
            f"{source}: over ({above.x:.2f}, {above.y:.2f}) something hangs lower than the top of this car at "
            f"{robot.body_top_m:.2f} m, and what begins at {LOWEST_WALL_M} m or higher is none of the walls that it "
            "avoids; raise it, take it away, or let it reach down as a wall does",
            at=(above.x, above.y),
        )
    below = _no_wall(world, robot.body_bottom_m, BAND_M[0])
    if below is not None:
        raise WorldError(
            f"{source}: mesh: at ({below.x:.2f}, {below.y:.2f}) lies something that the body of this car hits, which "
            f"reaches down to {robot.body_bottom_m:.3f} m, and what ends at {BAND_M[0]} m or lower is none of the "
            "walls that it avoids; take it away, or if it is the floor, say `offset: [0, 0, z]` in a world file, so "
            "that the floor is z = 0",
            at=(below.x, below.y),
        )


def _no_wall(world: World, low_m: float, high_m: float) -> shapely.Point | None:
    """Return where the mesh reaches between two heights, over floor to drive on but not over a wall, or None."""
    if low_m >= high_m:
        return None
    if isinstance(world.mesh, ExtrudedMesh):  # what stands lower is a wall: known without making the mesh
        hanging = [each.outline for each in world.mesh.solids if LOWEST_WALL_M <= each.bottom_m < high_m]
        found = shapely.union_all(hanging)
    else:
        found = beyond(seen_from_above(world.mesh, low_m, high_m), world.walls)
    if found.is_empty:
        return None
    floor: shapely.Geometry = world.free_space
    if world.open_line is not None:
        floor = floor.union(shapely.LineString(world.open_line).buffer(_PAST_LINE_M, cap_style="flat"))
    parts = polygons_of(found.difference(world.walls).intersection(floor))
    return parts[0].representative_point() if parts else None
