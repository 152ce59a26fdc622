"""What the run folder's tables hold: one CSV row an episode and one an evaluation."""

import math
from collections.abc import Mapping
from typing import Any

EPISODE_COLUMNS = (
    "episode", "total_steps", "wall_s", "env", "world", "outcome", "return", "steps", "epsilon",
)  # fmt: skip
EVALUATION_COLUMNS = ("episode", "total_steps", "wall_s", "success", "collision", "fail", "time_s", "best")


def rank(evaluation: Mapping[str, Any]) -> tuple[float, float, float]:
    """Return the order in which policies are better, given their evaluations: success, then collisions, then time."""
    success, collision, time_s = (evaluation[name] for name in ("success", "collision", "time_s"))
    return float(success), -float(collision), -float(time_s or math.inf)
