"""Many training runs as one report: figures, the data behind each, and a table, from the run folders alone."""

import csv
import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from zebrat_bullet.report.learning_curves import Curve, progress, training_curve
from zebrat_bullet.report.learning_figures import draw_curves, draw_reached
from zebrat_bullet.report.learning_runs import read_groups
from zebrat_bullet.report.learning_stats import summarise_group


def write_report(folders: Iterable[Path], out: Path) -> tuple[list[dict[str, Any]], str]:
    """Draw and tabulate every training run in or below the folders or zip archives.

    Args:
        folders: run folders, or folders or zip archives that hold some.
        out: gets training_curve, per_step, per_hour and reached as PNG and CSV, and the table as learning.md and .json.

    Returns:
        A summary a group, as in learning.json, and the text of learning.md.

    Raises:
        ConfigError: there is no run, or one that cannot be read.
    """
    groups = read_groups(folders)
    out.mkdir(parents=True, exist_ok=True)
    for name, x_label, curves in (
        ("training_curve", "episode", training_curve(groups)),
        ("per_step", "environment steps", progress(groups, "steps")),
        ("per_hour", "wall-clock hours", progress(groups, "hours")),
    ):
        draw_curves(curves, x_label, out / f"{name}.png")
        _write_csv([row for curve in curves for row in _curve_rows(curve, x_label)], out / f"{name}.csv")
    summaries = [summarise_group(group) for group in groups]
    draw_reached(summaries, out / "reached.png")
    _write_csv([_reached_row(at) for at in summaries], out / "reached.csv")
    text = learning_table(summaries)
    (out / "learning.md").write_text(text + "\n", encoding="utf-8")
    (out / "learning.json").write_text(json.dumps(summaries, indent=2), encoding="utf-8")
    return summaries, text


def learning_table(summaries: Sequence[Mapping[str, Any]]) -> str:
    """Return one row a group, and a line for every run that is unfinished (Markdown)."""
    head = (
        "algorithm", "reward", "seeds", "episodes", "steps", "best score", "success of the best policy: mean",
        "IQM (95 %)", "at the end: IQM (95 %)", "seeds with any success", "time of successes, s", "wall time, h",
        "failed episodes paid above the exit / above the median success", "best paid failure",
    )  # fmt: skip
    rows = [head, ["---"] * len(head), *map(_row, summaries)]
    notes = [
        "",
        "Mean over seeds, ± the standard deviation. Best score: the highest return of a training episode; it means "
        "nothing across rewards. The best policy is the best of the run's noise-free evaluations, by those same "
        "evaluations, so its success is optimistic; the policy at the end was not chosen.",
        *_notes(summaries),
    ]
    return "\n".join(["| " + " | ".join(row) + " |" for row in rows] + notes)


def _row(at: Mapping[str, Any]) -> list[str]:
    trap, n = at["reward_trap"], len(at["runs"])
    above_median = "no success" if trap["above_median_success"] is None else str(trap["above_median_success"])
    worst = trap["largest"]
    return [
        f"{at['algo']} ({at['variant']})" if at["variant"] else at["algo"],
        at["reward"],
        f"{n}, {at['unfinished']} unfinished" if at["unfinished"] else str(n),
        _mean(at["episodes"], ",.0f"),
        _mean(at["steps"], ",.0f"),
        _mean(at["best_score"], ".1f"),
        _mean(at["best_success"], ".0%"),
        _iqm(at["best_success"]),
        _iqm(at["last_success"]),
        f"{at['seeds_that_succeed']} of {n}",
        _mean(at["time_s"], ".1f"),
        _mean(at["wall_s"], ".2f", 1 / 3600),
        f"{trap['above_exit_reward']} / {above_median} of {trap['episodes']}",
        "-" if worst is None else f"{worst['return']:+.0f}, {worst['outcome']} after {worst['steps']} steps",
    ]


def _mean(at: Mapping[str, Any], form: str, scale: float = 1.0) -> str:
    if at["mean"] is None:
        return "-"
    spread = "" if at["sd"] is None else f" ± {at['sd'] * scale:{form}}"
    return f"{at['mean'] * scale:{form}}{spread}"


def _iqm(at: Mapping[str, Any]) -> str:
    if at["iqm"] is None:
        return "-"
    interval = "" if at["iqm_ci"] is None else f" ({at['iqm_ci'][0]:.0%}-{at['iqm_ci'][1]:.0%})"
    return f"{at['iqm']:.0%}{interval}"


def _notes(summaries: Sequence[Mapping[str, Any]]) -> list[str]:
    lines = [
        f"- {Path(run['folder']).name}: unfinished, {run[run['budget_unit']]:,} of {_budget(run['budget'])} "
        f"{run['budget_unit']}"
        for at in summaries
        for run in at["runs"]
        if not run["finished"]
    ]
    return ["", *lines] if lines else []


def _budget(n: int | None) -> str:
    return "an open number of" if n is None else f"{n:,}"


def _curve_rows(curve: Curve, x_name: str) -> list[dict[str, object]]:
    band = curve.band
    where: dict[str, object] = {"reward": curve.group.reward, "group": curve.group.label, "measure": curve.measure}
    columns = (band.x, band.n_seeds, band.mean, band.std, band.low, band.high)
    names = (x_name, "seeds", "mean", "std", "min", "max")
    return [
        where | {name: "" if value != value else f"{value:.7g}" for name, value in zip(names, values, strict=True)}
        for values in zip(*columns, strict=True)
        if values[1]
    ]


def _reached_row(at: Mapping[str, Any]) -> dict[str, object]:
    row: dict[str, object] = {name: at[name] for name in ("algo", "reward", "variant")} | {"seeds": len(at["runs"])}
    for key in ("best_success", "last_success"):
        for name in ("mean", "iqm"):
            low, high = at[key][f"{name}_ci"] or ("", "")
            row |= {f"{key}_{name}": at[key][name], f"{key}_{name}_low": low, f"{key}_{name}_high": high}
    return row


def _write_csv(rows: Sequence[Mapping[str, object]], path: Path) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]) if rows else [])
        writer.writeheader()
        writer.writerows(rows)
