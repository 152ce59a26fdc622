"""Scores, worlds and robots as Markdown tables: one text for the terminal, a results folder and the README."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from zebrat_bullet.config import PhysicsConfig, SafetyRegionConfig
from zebrat_bullet.errors import AssetError
from zebrat_bullet.evaluation.metrics import Score
from zebrat_bullet.planning.certificate import load_certificate
from zebrat_bullet.robot import GRAVITY_MPS2, Inspection, RobotModel, within_limits
from zebrat_bullet.sensing.safety_region import make_region


def score_table(scores: Mapping[str, Score], certified: bool = True) -> str:
    """Return one row a world: rates, the 95 % Wilson interval of success, mean time, and why the rest failed.

    Beside the time stands the least that any drive can take, where the world has a certificate and is `certified`: with
    this car, and begun where its own file says; the last column is
    what the agent was given beyond the lidar. Where a supervisor was between them, its interventions follow.
    """
    rows = [
        "| world | success | 95 % interval | collision | fail | time of successes, s | least possible | episodes "
        "| causes of the rest | beyond the lidar |",
        "|---|---|---|---|---|---|---|---|---|---|",
        *(_row(world, score, certified) for world, score in scores.items()),
    ]
    if any(score.supervision for score in scores.values()):
        more = [" stops a minute | of these false | stalled before a stop |", "---|---|---|"]
        rows = [row + end for row, end in zip(rows, [*more, *map(_supervision_row, scores.values())], strict=True)]
    return "\n".join(rows)


def _supervision_row(score: Score) -> str:
    at = score.supervision
    return " - | - | - |" if at is None else f" {at.per_minute:.2f} | {at.false_per_minute:.2f} | {at.stalls} |"


def comparison_table(scores: Mapping[str, Mapping[str, Score]], certified: bool = True) -> str:
    """Return one row an agent and one column a world: the success rate, and the mean time of the successes in s.

    Where a supervisor was between them: also its stops a minute, and how many of these were false.

    The last row is the least time that any drive can take, where the world has a certificate; `certified` as above.
    """
    worlds = list(next(iter(scores.values())))
    rows = [
        f"| agent | beyond the lidar | {' | '.join(map(_name, worlds))} |",
        "|---" * (len(worlds) + 2) + "|",
    ]
    for agent, of_agent in scores.items():
        cells = [_cell(of_agent[world]) for world in worlds]
        given = ", ".join(of_agent[worlds[0]].privileged) or "-"
        rows.append(f"| {_name(agent)} | {given} | {' | '.join(cells)} |")
    rows.append(f"| least possible | | {' | '.join(_least_time(w, certified) for w in worlds)} |")
    return "\n".join(rows)


def _least_time(world: str, certified: bool) -> str:
    if not certified or Path(world).suffix:  # a user's own file
        return "-"
    try:
        return f"{load_certificate(world).least_time_s:.1f}"
    except AssetError:
        return "-"


def _cell(at: Score) -> str:
    said = f"{at.success:.0%}" + ("" if at.time_s is None else f", {at.time_s:.1f}")
    if at.supervision is None:
        return said
    return f"{said}; {at.supervision.per_minute:.2f} stops a minute, {at.supervision.false_per_minute:.2f} false"


def worlds_table(summaries: Mapping[str, Mapping[str, Any]]) -> str:
    """Return one row a world: length, narrowest width, turns in order (left positive), what it is."""
    rows = ["| world | length | narrowest | turns in degrees | |", "|---|---|---|---|---|"]
    for name, at in summaries.items():
        metres = ("-" if at[key] is None else f"{at[key]:.2f} m" for key in ("length_m", "narrowest_m"))
        turns = " ".join(f"{turn:+.0f}" for turn in at["turns_deg"] or ()) or "-"
        rows.append(f"| {name} | {' | '.join(metres)} | {turns} | {at['description']} |")
    return "\n".join(rows)


def robot_summary(robot: RobotModel, config: SafetyRegionConfig, n_bearings: int) -> dict[str, Any]:
    """Return a car's numbers, in SI units, and how many bearings its safety region has on a scan of `n_bearings`."""
    length, width = np.ptp(robot.footprint_base, axis=0)
    physics = within_limits(PhysicsConfig(), robot)
    return {
        "length_m": float(length),
        "width_m": float(width),
        "corners": len(robot.footprint_base),
        "wheelbase_m": robot.wheelbase_m,
        "track_m": robot.track_m,
        "front_track_m": robot.front_track_m,
        "wheel_radius_m": robot.wheel_radius_m,
        "rear_axle_x_m": robot.rear_axle_x_m,
        "mass_kg": robot.weight_n / GRAVITY_MPS2,
        "max_speed_mps": physics.max_speed_mps,
        "max_steering_rad": physics.max_steering_rad,
        "turning_radius_m": robot.wheelbase_m / math.tan(physics.max_steering_rad),
        "lidar_m": [float(value) for value in robot.lidar_xyz_base],
        "footprint_m": robot.footprint_base.tolist(),
        "bearings": len(make_region(robot, config, n_bearings).indices),
        "notes": list(robot.notes),
        "problems": [],
    }


def refused_summary(seen: Inspection) -> dict[str, Any]:
    """Return what is known of a car that is refused, as `robot_summary` names it, and all its problems."""
    known: dict[str, Any] = {"problems": seen.problems, "notes": seen.notes}
    if seen.chassis is not None:
        wheels = seen.chassis.wheels
        known |= {
            "wheelbase_m": seen.chassis.wheelbase_m,
            "track_m": float(wheels[0, 1] - wheels[1, 1]),
            "front_track_m": float(wheels[2, 1] - wheels[3, 1]),
            "wheel_radius_m": float(seen.chassis.radii[:2].mean()),
        }
    if seen.body is not None and seen.body.outline is not None:
        length, width = np.ptp(seen.body.outline, axis=0)
        known |= {"length_m": float(length), "width_m": float(width), "footprint_m": seen.body.outline.tolist()}
    if seen.lidar_base is not None:
        known["lidar_m"] = seen.lidar_base.tolist()
    return known


def robots_table(summaries: Mapping[str, Mapping[str, Any]]) -> str:
    """Return one row a car: size, corners of its outline, wheelbase, turning radius at full lock, lidar, bearings."""
    rows = [
        "| robot | size, m | corners | wheelbase | turning radius | lidar at x, y, z | bearings |",
        "|---" * 7 + "|",
    ]
    for name, at in summaries.items():
        if at["problems"]:
            continue
        lidar = ", ".join(f"{value:.2f}" for value in at["lidar_m"])
        rows.append(
            f"| {_name(name)} | {at['length_m']:.2f} x {at['width_m']:.2f} | {at['corners']} "
            f"| {at['wheelbase_m']:.2f} m | {at['turning_radius_m']:.2f} m | {lidar} | {at['bearings']} |"
        )
    notes = [f"{name}: {note}" for name, at in summaries.items() for note in at["notes"]]
    return "\n".join([*rows, *([""] if notes else []), *notes])


def _name(name: str) -> str:
    """Return a name as it may stand in a cell: of the user's own file it may hold anything."""
    return name.replace("|", r"\|").replace("\n", " ")


def _row(world: str, score: Score, certified: bool) -> str:
    low, high = score.success_ci
    time = "-" if score.time_s is None else f"{score.time_s:.1f}"
    causes = ", ".join(f"{count} {cause}" for cause, count in score.causes.items() if cause != "success") or "-"
    least = _least_time(world, certified)
    return (
        f"| {_name(world)} | {score.success:.0%} | {low:.0%}-{high:.0%} | {score.collision:.0%} | {score.fail:.0%} "
        f"| {time} | {least} | {score.episodes} | {causes} | {', '.join(score.privileged) or '-'} |"
    )
