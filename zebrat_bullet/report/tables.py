"""Scores and worlds as Markdown tables: the same text on the terminal, in a results folder and in the README."""

from collections.abc import Mapping
from typing import Any

from zebrat_bullet.evaluation.metrics import Score


def score_table(scores: Mapping[str, Score]) -> str:
    """Return one row a world: rates, the 95 % Wilson interval of success, mean time, and why the rest failed.

    The last column is what the agent was given beyond the lidar.
    """
    rows = [
        "| world | success | 95 % interval | collision | fail | time of successes | episodes | causes of the rest "
        "| beyond the lidar |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    return "\n".join(rows + [_row(world, score) for world, score in scores.items()])


def comparison_table(scores: Mapping[str, Mapping[str, Score]]) -> str:
    """Return one row an agent and one column a world: the success rate, and the mean time of the successes in s."""
    worlds = list(next(iter(scores.values())))
    rows = [
        f"| agent | beyond the lidar | {' | '.join(worlds)} |",
        "|---" * (len(worlds) + 2) + "|",
    ]
    for agent, of_agent in scores.items():
        cells = [_cell(of_agent[world]) for world in worlds]
        given = ", ".join(of_agent[worlds[0]].privileged) or "-"
        rows.append(f"| {agent} | {given} | {' | '.join(cells)} |")
    return "\n".join(rows)


def _cell(at: Score) -> str:
    return f"{at.success:.0%}" + ("" if at.time_s is None else f", {at.time_s:.1f}")


def worlds_table(summaries: Mapping[str, Mapping[str, Any]]) -> str:
    """Return one row a world: length, narrowest width, turns in order (left positive), what it is."""
    rows = ["| world | length | narrowest | turns in degrees | |", "|---|---|---|---|---|"]
    for name, at in summaries.items():
        metres = ("-" if at[key] is None else f"{at[key]:.2f} m" for key in ("length_m", "narrowest_m"))
        turns = " ".join(f"{turn:+.0f}" for turn in at["turns_deg"] or ()) or "-"
        rows.append(f"| {name} | {' | '.join(metres)} | {turns} | {at['description']} |")
    return "\n".join(rows)


def _row(world: str, score: Score) -> str:
    low, high = score.success_ci
    time = "-" if score.time_s is None else f"{score.time_s:.1f} s"
    causes = ", ".join(f"{count} {cause}" for cause, count in score.causes.items() if cause != "success") or "-"
    return (
        f"| {world} | {score.success:.0%} | {low:.0%}-{high:.0%} | {score.collision:.0%} | {score.fail:.0%} "
        f"| {time} | {score.episodes} | {causes} | {', '.join(score.privileged) or '-'} |"
    )
