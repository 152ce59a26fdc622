"""Tables of a small comparison, made by hand: who succeeds where is what a test says."""

from collections.abc import Iterable, Mapping
from typing import Any

from zebrat_bullet.comparison.tables import COLUMNS, table_of
from zebrat_bullet.report.comparison.evidence import METHODS, TRACKS

LONG = dict.fromkeys(("DWA", "TEB", "IL"), "rivals")
SETTINGS = {"DWA": "radius 0.5", "TEB": "radius 0.5", "IL": "10,049 pairs"}
AGENTS = {"DWA": "dwa:inflation_radius_m=0.5", "TEB": "teb:inflation_radius_m=0.5", "IL": "il"}


def episodes(
    method: str, place: str, outcomes: Iterable[str], *, study: str | None = None, **more: Any
) -> list[dict[str, Any]]:
    """Return a row for each outcome, "s", "c" or "f"; the start poses are those of the episode's number."""
    names = {"s": "success", "c": "collision", "f": "stall"}
    rows = []
    for episode, outcome in enumerate(outcomes):
        row = {
            **{"agent": AGENTS.get(method, method.lower()), "method": method, "setting": SETTINGS.get(method, "")},
            **{"study": study or LONG.get(method, "paper"), "sim": "bullet", "place": place, "seed": 0, "noise": ""},
            **{"episode": episode, "outcome": names[outcome], "duration_s": 20.0, "n_reversals": 0},
            **{"min_gap_m": 0.1, "steering_effort_rad": 5.0, "distance_m": 10.0, "backed_m": 0.0},
            **{"x0": 0.001 * episode, "y0": 0.0, "yaw0": 0.0, "x1": 5.0, "y1": 0.0, "yaw1": 0.0},
        }
        rows.append(row | more)
    return rows


def run(name: str, algorithm: str = "ddpg", reward: str = "fomt", **more: Any) -> dict[str, Any]:
    """Return a completed run of the paper's budget."""
    row = {"run": name, "study": "paper", "algorithm": algorithm, "reward": reward, "variant": "", "seed": 0}
    row |= {
        "best_collision": 0.0,
        "best_time_s": None,
        "asked": "1000 episodes",
        "episodes": 1000,
        "steps": 100_000,
        "wall_s": 3600.0,
        "best_success": 0.5,
    }
    return row | {"state": "complete", "command": "zebrat train"} | more


def counts(representation: str, detected: int, **more: Any) -> dict[str, Any]:
    """Return a row of the collision study, 1,000 contacts with ghost walls."""
    row = {"walls": "ghost", "panel": "base", "setting": "", "representation": representation, "rays": 32}
    row |= {"margin_m": 0.0, "detected": detected, "within_1_s": detected, "events": 1000, "false_alarms": 0}
    return row | more


def tables(**rows: Iterable[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the five tables of these rows."""
    return {name: table_of(name, rows.get(name, ())) for name in COLUMNS}


def everyone(n: int = 4) -> list[dict[str, Any]]:
    """Return drives of every method of the paper in every track, all of which succeed."""
    return [row for method in METHODS for place in TRACKS for row in episodes(method, place, "s" * n)]
