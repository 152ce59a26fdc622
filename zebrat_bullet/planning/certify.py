"""The search for a drive out of a world, with few reversals; or for a proof that there is none."""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

from zebrat_bullet.config import PhysicsConfig
from zebrat_bullet.errors import PlanError, WorldError
from zebrat_bullet.planning.arc_path import ArcPath
from zebrat_bullet.planning.certificate import CLOSELY_M, Certificate, certificate_of, open_line_of
from zebrat_bullet.planning.hybrid_a_star import HybridAStarConfig, plan_path
from zebrat_bullet.planning.no_way import proves_no_way
from zebrat_bullet.processes import in_order
from zebrat_bullet.robot import RobotModel, robot_of, within_limits
from zebrat_bullet.world import World

LEAST_MARGIN_M = 0.003
"""What a certified drive keeps from the walls unless told otherwise."""

# Tried before the margin asked for, as who drives likes room; a path with fewer reversals is taken all the same.
_ROOMY_M = (0.03, 0.01)
# In metres of driving: worlds are told apart by the number of reversals.
_REVERSAL_COST = 10.0
# With no more than these a closer look has saved none.
_FEW = 2


def certify(
    world: World,
    robot: RobotModel | str | Path,
    physics: PhysicsConfig | None = None,
    margin_m: float = LEAST_MARGIN_M,
) -> Certificate:
    """Find a drive out of a world, from the middle of its start range.

    Args:
        world: what to leave.
        robot: in what, by name, file or as `load_robot` gives it.
        physics: limits of the commands, the defaults if None; the car's own where those are lower.
        margin_m: what the drive keeps from every wall at least.

    Raises:
        PlanError: `proven`, where no drive at all leads out; else the search found none, and there may be one.
        WorldError: the world declares no exit.
    """
    open_line_of(world)
    robot = robot_of(robot)
    physics = within_limits(physics or PhysicsConfig(), robot)
    return certificate_of(_find(world, robot, physics, margin_m), world, robot, physics)


def certify_all(
    worlds: Iterable[World],
    robot: RobotModel,
    physics: PhysicsConfig | None = None,
    *,
    workers: int = 2,
    margin_m: float = LEAST_MARGIN_M,
) -> Iterator[Certificate | PlanError | WorldError]:
    """Yield for each world, in order, its certificate, or what `certify` raises instead.

    Args:
        worlds: taken as they are needed; there may be no end of them.
        robot, physics, margin_m: as `certify`.
        workers: as for `in_order`.

    Raises:
        ConfigError: fewer than one worker.
    """
    task = partial(_certificate_or_refusal, robot=robot, physics=physics, margin_m=margin_m)
    return in_order(task, worlds, workers)


def _find(world: World, robot: RobotModel, physics: PhysicsConfig, margin_m: float) -> ArcPath:
    """Search with room to spare; then for a proof that it is in vain; then ever more closely."""
    # What rounding takes: of the steering, and of the clearance.
    margin = margin_m + 2.0 * CLOSELY_M
    search = HybridAStarConfig(
        max_steering_rad=physics.max_steering_rad - 1e-3,
        margins_m=(*(roomy for roomy in _ROOMY_M if roomy > margin), margin),
        reversal_cost=_REVERSAL_COST,
        save_reversals=True,
    )
    best = _fewer(world, robot, replace(search, margins_m=search.margins_m[:1]), None)
    if best is None and proves_no_way(world, robot):
        raise PlanError(
            "no drive leads out, however often the car reverses: what is free round the start does not reach the exit; "
            "widen the narrowest place",
            proven=True,
        )
    if (best is None or best.n_reversals > 0) and search.margins_m[1:]:
        best = _fewer(world, robot, replace(search, margins_m=search.margins_m[1:]), best)
    if best is None or best.n_reversals > _FEW:
        best = _fewer(world, robot, search.finer(), best)
    return best or _plan(world, robot, search.finest())


def _fewer(world: World, robot: RobotModel, search: HybridAStarConfig, best: ArcPath | None) -> ArcPath | None:
    """Return the path that a search finds where it has fewer reversals than the best so far, else that one."""
    try:
        path = _plan(world, robot, search)
    except PlanError as error:
        if error.proven:
            raise
        return best
    return path if best is None or path.n_reversals < best.n_reversals else best


def _plan(world: World, robot: RobotModel, search: HybridAStarConfig) -> ArcPath:
    return plan_path(world.walls, robot, world.start.pose, world.waypoints[-1], search).path


def _certificate_or_refusal(
    world: World, robot: RobotModel, physics: PhysicsConfig | None, margin_m: float
) -> Certificate | PlanError | WorldError:
    try:
        return certify(world, robot, physics, margin_m)
    except (PlanError, WorldError) as refusal:
        return refusal
