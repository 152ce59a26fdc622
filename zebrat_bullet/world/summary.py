"""What a world is like in a few numbers."""

import numpy as np

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
    past = np.array([world.past_open_line(float(x), float(y)) for x, y in line])
    inside = line[~past]
    return facts | {
        "length_m": round(float(np.hypot(*np.diff(inside, axis=0).T).sum()), 1),
        "narrowest_m": round(float(world.widths_m.min()), 2),
        "turns_deg": [round(turn) for turn in world.turns_deg],
    }
