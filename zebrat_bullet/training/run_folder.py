"""What the folder of a run says of it: whether it can be resumed, whether it is over, what it has reached."""

from pathlib import Path
from typing import Any

from zebrat_bullet.errors import ZebratError
from zebrat_bullet.evaluation.csv_log import read_rows
from zebrat_bullet.files import read_json, refusing

POLICY_FILES = ("best.safetensors", "best.zip")
ERROR = "error.txt"
SUMMARY = "summary.json"


def has_checkpoint(folder: Path) -> bool:
    """Return whether the run in a folder can be resumed."""
    return any((folder / name).is_dir() for name in ("checkpoint", "checkpoint.old"))


def is_finished(folder: Path) -> bool:
    """Return whether the folder holds a run that came to its end."""
    return (folder / SUMMARY).is_file()


def read_summary(folder: Path) -> dict[str, Any] | None:
    """Return what a run has reached, None if it is not finished."""
    if not is_finished(folder):
        return None
    summary = read_json(folder / SUMMARY, ZebratError)
    if not isinstance(summary, dict):
        raise ZebratError(f"{folder / SUMMARY}: holds no summary of a run; delete it, and resume the run")
    return summary


def evaluations(folder: Path) -> list[dict[str, str]]:
    """Return the rows of a run's noise-free evaluations."""
    return read_rows(folder / "evaluations.csv")


def summarise(folder: Path) -> dict[str, Any]:
    """Return what a run has reached: its episodes, steps and wall time, and the evaluation of its best policy."""
    with refusing(folder, ZebratError, "its tables are not those of a run", "restore them, or begin the run anew"):
        episodes, judged = read_rows(folder / "episodes.csv"), evaluations(folder)
        best = [row for row in judged if row["best"] == "1"][-1]
        return {
            "folder": str(folder),
            "episodes": len(episodes),
            "total_steps": max((int(rows[-1]["total_steps"]) for rows in (episodes, judged) if rows), default=0),
            "wall_s": float(judged[-1]["wall_s"]),
            "best": {key: float(value) if value else None for key, value in best.items() if key != "best"},
        }
