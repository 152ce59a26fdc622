"""Where a policy's commands differ from those of a bag: a table of every scan, and what it comes to."""

import csv
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from zebrat_bullet.errors import ConfigError
from zebrat_bullet.outputs import written_whole
from zebrat_bullet.recording.open_loop import Answer, OpenLoop

COLUMNS = (
    *("time_s", "speed_mps", "steering_rad", "recorded_speed_mps", "recorded_steering_rad"),
    *("speed_error_mps", "steering_error_rad", "within", "refusal"),
)
TOLERANCE = (0.05, 0.05)
"""Of speed in m/s and steering in rad: what no car can tell apart."""


def check_tolerance(tolerance: Sequence[float]) -> None:
    """Refuse a tolerance that is none.

    Raises:
        ConfigError: it is not two finite numbers of at least 0.
    """
    if len(tolerance) != 2 or not all(0.0 <= each < math.inf for each in tolerance):
        raise ConfigError(f"a tolerance is a speed and a steering, finite and at least 0, got {tolerance}")


def is_within(answer: Answer, tolerance: Sequence[float]) -> bool:
    """Return whether an answer is the recorded command; a steering that a Twist does not say counts as equal."""
    # A number that is none is not greater than another.
    return not (abs(answer.speed_error_mps) > tolerance[0] or abs(answer.steering_error_rad) > tolerance[1])


def summary(loop: OpenLoop, tolerance: Sequence[float] = TOLERANCE) -> dict[str, Any]:
    """Return what a comparison comes to, over the scans that a command answers and the policy did not refuse."""
    compared = [answer for answer in loop.answers if answer.recorded is not None and not answer.refusal]
    refused = [answer for answer in loop.answers if answer.refusal]
    within = sum(is_within(answer, tolerance) for answer in compared)
    made: dict[str, Any] = {
        "scans": len(loop.answers),
        "compared": len(compared),
        "within": within,
        "within_share": within / len(compared) if compared else None,
        "unanswered": sum(answer.recorded is None for answer in loop.answers),
        "refused": len(refused),
        "unusable": loop.n_unusable,
        "early": loop.n_early,
        "frame": loop.frame,
        "largest": {},
    }
    if refused:
        made["first_refusal"] = {"time_s": refused[0].time_s, "reason": refused[0].refusal}
    for name in ("speed_error_mps", "steering_error_rad"):
        known = [answer for answer in compared if not math.isnan(getattr(answer, name))]
        if known:
            worst = max(known, key=lambda answer: abs(getattr(answer, name)))
            made["largest"][name] = {"time_s": worst.time_s, "value": getattr(worst, name)}
    return made


def write_differences(loop: OpenLoop, path: Path, tolerance: Sequence[float] = TOLERANCE) -> None:
    """Write a row for each scan as CSV, whole or not at all; what there is not is an empty cell."""
    with written_whole(path) as part, part.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(COLUMNS)
        table.writerows(_row(answer, tolerance) for answer in loop.answers)


def _row(answer: Answer, tolerance: Sequence[float]) -> list[object]:
    command, recorded = answer.command, answer.recorded
    then = (math.nan, math.nan) if recorded is None else (recorded.speed_mps, recorded.steering_rad)
    numbers = (
        *(answer.time_s, command.speed_mps, command.steering_rad, *then),
        *(answer.speed_error_mps, answer.steering_error_rad),
    )
    within = "" if recorded is None or answer.refusal else int(is_within(answer, tolerance))
    return [*("" if math.isnan(number) else number for number in numbers), within, answer.refusal]
