"""The cheapest way over a ROS costmap, 8-connected, as navfn and global_planner price it."""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage, sparse
from scipy.sparse import csgraph

from zebrat_bullet.errors import ConfigError, PlanError
from zebrat_bullet.planning.grid import INSCRIBED, OccupancyGrid, inflate

NEUTRAL, COST_FACTOR = 50.0, 0.8
"""navfn: a step into a cell costs its length in cells times NEUTRAL + COST_FACTOR * (the cell's cost)."""

_STEPS = [(0, 1), (1, 1), (1, 0), (1, -1), (0, -1), (-1, -1), (-1, 0), (-1, 1)]
_UNREACHED = -9999  # scipy's predecessor of a node that was not reached


def plan(
    grid: OccupancyGrid,
    start_xy: ArrayLike,
    goal_xy: ArrayLike,
    inflation_radius_m: float,
    *,
    inscribed_radius_m: float,
    cost_scaling_factor: float = 10.0,
    method: str = "dijkstra",
    tolerance_m: float = 0.25,
) -> NDArray[np.float64]:
    """Return the cheapest way for the car's centre, which keeps the inscribed radius from every wall, to within a cell.

    Args:
        grid: the map.
        start_xy, goal_xy: (2,) m, world frame.
        inflation_radius_m: up to this distance from a wall a cell costs more than a free one.
        inscribed_radius_m: no cell so near to a wall is entered.
        cost_scaling_factor: how fast that cost falls with the distance, see `inflate`.
        method: "dijkstra" or "astar"; both find a cheapest way.
        tolerance_m: a start or goal that is too near to a wall is moved to the nearest free cell within this distance.

    Returns:
        (N, 2) float64 points in m, world frame, a cell apart or less: from `start_xy` to `goal_xy`, where the cheapest
        way over cells is pulled straight as far as that makes it no dearer.

    Raises:
        ConfigError: the method is neither.
        PlanError: start or goal lies in a wall or off the map, or no way joins them.
    """
    if method not in ("dijkstra", "astar"):
        raise ConfigError(f"method must be 'dijkstra' or 'astar', got {method!r}")
    costs = inflate(grid, max(inflation_radius_m, inscribed_radius_m), inscribed_radius_m, cost_scaling_factor)
    regions, _ = ndimage.label(costs < INSCRIBED, structure=np.ones((3, 3)))
    start = _nearest_free(grid, regions, start_xy, tolerance_m, "start")
    goal = _nearest_free(grid, regions, goal_xy, tolerance_m, "goal")
    if regions[start] != regions[goal]:
        raise PlanError(
            f"no way from {_text(start_xy)} to {_text(goal_xy)}: every passage is narrower than "
            f"{2 * inscribed_radius_m:g} m at cells of {grid.resolution_m:g} m; widen one or make the cells smaller"
        )
    inside = regions == regions[start]
    cells = np.argwhere(inside)
    node_of = np.full(grid.occupied.shape, -1)
    node_of[inside] = np.arange(len(cells))
    search = _dijkstra if method == "dijkstra" else _astar
    graph = _graph(costs, cells, node_of)
    nodes = _trace(search(graph, cells, int(node_of[start]), int(node_of[goal])), int(node_of[goal]))
    way = grid.centres_of(_straightened(cells[nodes], costs))
    return np.vstack([np.asarray(start_xy, float), way[1:-1], np.asarray(goal_xy, float)])


def _nearest_free(
    grid: OccupancyGrid, regions: NDArray[np.int32], point: ArrayLike, tolerance_m: float, what: str
) -> tuple[int, int]:
    """Return the cell of a point, or the nearest free one within the tolerance."""
    cell = grid.cells_of(point)
    if not grid.contains(cell):
        raise PlanError(f"the {what} {_text(point)} lies off the map; make the map with it `also_inside`")
    reach = math.ceil(tolerance_m / grid.resolution_m)
    low = np.maximum(cell - reach, 0)
    near = low + np.argwhere(regions[low[0] : cell[0] + reach + 1, low[1] : cell[1] + reach + 1])
    away_m = np.linalg.norm(near - cell, axis=1) * grid.resolution_m
    if not len(near) or away_m.min() > tolerance_m:
        raise PlanError(
            f"the {what} {_text(point)} is {grid.distance_m[tuple(cell)]:.2f} m from a wall and no place the car's "
            f"centre may be is within {tolerance_m:g} m; move it"
        )
    row, col = near[np.argmin(away_m)]
    return int(row), int(col)


def _graph(costs: NDArray[np.uint8], cells: NDArray[np.intp], node_of: NDArray[np.intp]) -> sparse.csr_matrix:
    """Return the (N, N) prices of steps between neighbouring cells; a step's price is the mean of its two cells'."""
    padded = np.pad(node_of, 1, constant_values=-1)
    price = NEUTRAL + COST_FACTOR * costs[tuple(cells.T)].astype(float)
    here, there, weight = [], [], []
    for step in _STEPS:
        to = padded[tuple((cells + step + 1).T)]
        known = np.flatnonzero(to >= 0)
        here.append(known)
        there.append(to[known])
        weight.append(math.hypot(*step) * (price[known] + price[to[known]]) / 2.0)
    edges = (np.concatenate(weight), (np.concatenate(here), np.concatenate(there)))
    return sparse.csr_matrix(edges, shape=(len(cells), len(cells)))


def _dijkstra(graph: sparse.csr_matrix, cells: NDArray[np.intp], start: int, goal: int) -> NDArray[np.int32]:
    """Return the node before each on a cheapest way from the start."""
    return csgraph.dijkstra(graph, indices=start, return_predecessors=True)[1]


def _astar(graph: sparse.csr_matrix, cells: NDArray[np.intp], start: int, goal: int) -> NDArray[np.int32]:
    """As Dijkstra, but only over nodes whose price and straight-line rest to the goal stay within a bound.

    A* is Dijkstra on prices reduced by the drop of the heuristic, w + h(to) - h(from); the bound, the detour from the
    straight line, is doubled until the goal is reached.
    """
    rest = NEUTRAL * np.linalg.norm(cells - cells[goal], axis=1)
    edges = graph.tocoo()
    reduced = np.maximum(edges.data + rest[edges.col] - rest[edges.row], 1e-9)  # rounding must not make it negative
    graph = sparse.csr_matrix((reduced, (edges.row, edges.col)), shape=graph.shape)
    bound = NEUTRAL + 0.1 * rest[start]
    while True:
        before = csgraph.dijkstra(graph, indices=start, return_predecessors=True, limit=bound)[1]
        if before[goal] != _UNREACHED or start == goal:
            return before
        bound *= 2.0


def _trace(before: NDArray[np.int32], goal: int) -> list[int]:
    """Return the nodes from the start to the goal."""
    nodes = [goal]
    while before[nodes[-1]] != _UNREACHED:
        nodes.append(int(before[nodes[-1]]))
    return nodes[::-1]


def _straightened(way: NDArray[np.intp], costs: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Return a way over (N, 2) cells with straight lines, where they cost no more, for its steps of 45 degrees.

    navfn descends an interpolated potential to the same end: cells alone give eight headings.
    """
    price = NEUTRAL + COST_FACTOR * costs[tuple(way.T)].astype(float)
    steps = np.linalg.norm(np.diff(way, axis=0), axis=1) * (price[1:] + price[:-1]) / 2.0
    spent = np.concatenate([[0.0], np.cumsum(steps)])
    pieces, here = [way[:1].astype(float)], 0
    while here < len(way) - 1:
        there, line = here + 1, way[here + 1 : here + 2].astype(float)
        while there + 1 < len(way):
            longer = np.linspace(way[here], way[there + 1], int(np.abs(way[there + 1] - way[here]).max()) + 1)
            under = costs[tuple(longer.round().astype(int).T)]
            length = np.linalg.norm(way[there + 1] - way[here])
            dearer = length * (NEUTRAL + COST_FACTOR * under.mean()) > spent[there + 1] - spent[here] + 1e-6
            if under.max() >= INSCRIBED or dearer:
                break
            there, line = there + 1, longer[1:]
        pieces.append(line)
        here = there
    return np.vstack(pieces)


def _text(point: ArrayLike) -> str:
    x, y = np.asarray(point, float)
    return f"({x:.2f}, {y:.2f})"
