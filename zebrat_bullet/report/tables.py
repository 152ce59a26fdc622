"""Scores as a Markdown table: the same text on the terminal, in the results folder and in the README."""

from collections.abc import Mapping

from zebrat_bullet.evaluation.metrics import Score


def score_table(scores: Mapping[str, Score]) -> str:
    """Return one row a world: rates, the 95 % Wilson interval of success, mean time, and why the rest failed."""
    rows = [
        "| world | success | 95 % interval | collision | fail | time of successes | episodes | causes of the rest |",
        "|---|---|---|---|---|---|---|---|",
    ]
    return "\n".join(rows + [_row(world, score) for world, score in scores.items()])


def _row(world: str, score: Score) -> str:
    low, high = score.success_ci
    time = "-" if score.time_s is None else f"{score.time_s:.1f} s"
    causes = ", ".join(f"{count} {cause}" for cause, count in score.causes.items() if cause != "success") or "-"
    return (
        f"| {world} | {score.success:.0%} | {low:.0%}-{high:.0%} | {score.collision:.0%} | {score.fail:.0%} "
        f"| {time} | {score.episodes} | {causes} |"
    )
