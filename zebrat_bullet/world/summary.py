"""What a world is like in a few numbers."""

import shapely

from zebrat_bullet.world.world import World


def world_summary(world: World) -> dict[str, object]:
    """Return name, description, length, narrowest width and turns of a world.

    Returns:
        `length_m`: along the centre line from the start to the open-space line. `narrowest_m`: narrowest passage.
        `turns_deg`: the turns in order, left positive. All three are None where the world has no centre line.
    """
    line = world.centre_line
    facts: dict[str, object] = {"name": world.name, "description": world.description}
    if len(line) == 0:
        return facts | {"length_m": None, "narrowest_m": None, "turns_deg": None}
    course = shapely.LineString(line)
    length = course.length
    if world.open_line is not None:
        length = shapely.line_locate_point(course, shapely.Point(world.open_line.mean(axis=0)))
    return facts | {
        "length_m": round(float(length), 1),
        "narrowest_m": round(float(world.widths_m.min()), 2),
        "turns_deg": [round(turn) for turn in world.turns_deg],
    }
