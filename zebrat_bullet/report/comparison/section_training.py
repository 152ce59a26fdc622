"""The collision counts and the training curves, beside what the paper says of them."""

from collections import defaultdict
from collections.abc import Callable
from typing import Any

import numpy as np

from zebrat_bullet.report.comparison.document import Block, Cell, Grid, Picture, Row, Section, Text
from zebrat_bullet.report.comparison.evidence import Evidence
from zebrat_bullet.report.comparison.figures import draw_bands, draw_counts, draw_intervals
from zebrat_bullet.report.comparison.studies import REPRESENTATIONS, base_cases
from zebrat_bullet.report.learning_curves import BLOCK, Band, at_grid, band
from zebrat_bullet.report.learning_stats import estimates

NOT_DRIVEN = Text("*Not driven at this budget.*")
_GRID = 101


def collision_section(evidence: Evidence) -> Section:
    """Return the section on the state representations (paper, IV-A)."""
    said = Text(
        "**The paper**: SR detects 508 collisions on the big track, FIRect 407 (-19.88 %), FIFR 363 (-28.54 %) (counts "
        "read from the picture, Fig. 4c). It does not say when a collision counts as detected, nor whether the walls "
        "stopped the car. **Ours** counts contacts reported by the first sweep after them (in time) or up to 1 s "
        "later; the picture shows *ghost* walls, which let the car pass on. *Solid* ones stop it with its outline at "
        "the wall, so that at margin 0 nearly nothing lies inside any outline: there FIFR leads, because its circle "
        "reaches 20 cm past the nose (and warns where nothing is touched), and SR needs a margin of 6 cm for 99.9 % "
        "(docs/collisions.md)."
    )
    drawn = draw_counts(evidence)
    if drawn is None:
        return Section("Collisions that are detected", (said, NOT_DRIVEN))
    rows = []
    for walls in ("ghost", "solid"):
        for kind, row in base_cases(evidence, walls).items():
            numbers = (row["detected"], row["within_1_s"], row["events"], row["false_alarms"])
            rows.append((REPRESENTATIONS.get(kind, kind), walls, *("-" if n is None else f"{n:g}" for n in numbers)))
    grid = Grid(("representation", "walls", "in time", "within 1 s", "contacts", "false alarms"), tuple(rows))
    return Section(
        "Collisions that are detected",
        (said, Picture("collisions", drawn, "Detected collisions by representation, the paper's and ours"), grid),
    )


def curve_section(evidence: Evidence) -> Section:
    """Return the section on the training curves (paper, IV-B)."""
    said = Text(
        f"**The paper** plots the best return of every {BLOCK} episodes, mean and spread of five seeds in 1,000 "
        "episodes, and says that DDPG gets the highest. Its numbers are only in a picture. **Ours**, the same curve: "
        "line mean, dark band standard deviation, light band least to greatest over the seeds that came to their "
        "end (of a set without one, over those begun). The paper puts 1,000 episodes at 300,000 to 1,000,000 steps, "
        f"the more the better a car drives{_steps_of_ours(evidence)}. A return is not success: under F O M T a car "
        "that crashes late is paid more than one that leaves early (docs/staying.md)."
    )
    blocks: list[Block] = [said]
    best, success = ("best return in 20 episodes", "best_return"), ("success in evaluations", "success")
    for name, title, (axis, column), keep, label, x in (
        ("curve_algorithms", "Best return in 20 episodes, F O M T", best, _fomt, "algorithm", "episode"),
        ("curve_returns", "Best return in 20 episodes, DDPG under each reward", best, _ddpg, "reward", "episode"),
        ("curve_rewards", "Success in noise-free evaluations, DDPG", success, _ddpg, "reward", "episode"),
        (
            "curve_finetuning",
            "Success in noise-free evaluations while fine-tuning",
            success,
            _finetuning,
            "variant",
            "episode",
        ),
        (
            "curve_scale",
            "Success in noise-free evaluations at scale, PPO on generated tracks",
            success,
            _scale,
            "variant",
            "total_steps",
        ),
    ):
        bands = learning_bands(evidence, column, keep, label, x)
        if bands:
            drawn = draw_bands(bands, x.replace("total_", ""), axis)
            blocks.append(Picture(name, drawn, title, title))
    return Section("Training", tuple(blocks if len(blocks) > 1 else [*blocks, NOT_DRIVEN]), (_reached(evidence),))


def _steps_of_ours(evidence: Evidence) -> str:
    """Return how many steps our runs of the paper's 1,000 episodes take, to end a sentence with; empty without any."""
    steps = sorted(run["steps"] for run in evidence.runs if run["study"] == "paper" and run["episodes"] == 1000)
    if not steps:
        return ""
    least, most = (round(n, -3) for n in (steps[0], steps[-1]))
    return f"; ours are {least:,} to {most:,} (*Every training*): the episodes end sooner"


def _fomt(run: dict[str, Any]) -> bool:
    return run["study"] == "paper" and run["reward"] == "fomt"


def _ddpg(run: dict[str, Any]) -> bool:
    return run["study"] == "paper" and run["algorithm"] == "ddpg"


def _finetuning(run: dict[str, Any]) -> bool:
    return run["study"] == "finetuning"


def _scale(run: dict[str, Any]) -> bool:
    return run["study"] == "scale"


def learning_bands(
    evidence: Evidence, column: str, keep: Callable[[dict[str, Any]], bool], label: str, x: str = "episode"
) -> dict[str, Band]:
    """Return a curve of each label of the runs to keep: the last value known at each of 101 episodes or steps (`x`).

    A label is a column of `runs`; "variant" is the reward with its variant, "set" the algorithm with its reward.
    """
    rows: dict[str, list[tuple[float, float]]] = defaultdict(list)
    for row in evidence.learning:
        if row[column] is not None and row[x] is not None:
            rows[row["run"]].append((float(row[x]), float(row[column])))
    groups: dict[str, list[np.ndarray]] = defaultdict(list)
    kept = [run for run in evidence.runs if keep(run) and rows[run["run"]]]
    names = {run["run"]: _label(run, label) for run in kept}
    whole = {names[run["run"]] for run in kept if run["state"] == "complete"}
    for run in kept:  # beside complete runs one that is not would only bend their mean
        if run["state"] == "complete" or names[run["run"]] not in whole:
            groups[names[run["run"]]].append(np.array(sorted(rows[run["run"]])))
    if not groups:
        return {}
    grid = np.linspace(0.0, max(at[-1, 0] for runs in groups.values() for at in runs), _GRID)
    return {
        name: band(grid, [at_grid(at[:, 0], at[:, 1], grid, at[-1, 0]) for at in runs])
        for name, runs in sorted(groups.items())
    }


def _label(run: dict[str, Any], label: str) -> str:
    columns = {"variant": ("reward", "variant"), "set": ("algorithm", "reward")}.get(label, (label,))
    return " ".join(run[column] for column in columns if run[column]).upper()


def _reached(evidence: Evidence) -> Section:
    """Return what the best policies of all runs reach in their own evaluations, over seeds."""
    values: dict[str, list[float]] = defaultdict(list)
    for run in sorted(evidence.runs, key=lambda run: (run["study"], run["asked"] or "", run["run"])):
        if run["best_success"] is not None and run["state"] == "complete":
            parts = (run["algorithm"], run["reward"].upper(), run["variant"], f"({run['study']}, {run['asked']})")
            values[" ".join(filter(None, parts))].append(run["best_success"])
    title = "What the runs reach by themselves"
    if not values:
        return Section(title, (NOT_DRIVEN,))
    rows = {name: (*_iqm(of_name), of_name) for name, of_name in values.items()}
    caption = (
        "Interquartile mean (dot) with its 95 % bootstrap interval over seeds (bar), and each seed (line): success of "
        "a run's best policy in its own noise-free evaluations, in the world it learned in or in more generated tracks "
        "like its own. It is the best of many evaluations, so it flatters all alike."
    )
    drawn = draw_intervals(rows, "success in own evaluations")
    table: list[Row] = []
    for name, (middle, low, high, of_name) in rows.items():
        each = ", ".join(f"{value:.0%}" for value in sorted(of_name, reverse=True))
        interval = f"{low:.0%} to {high:.0%}" if len(of_name) > 1 else "-"
        table.append((name, Cell(f"{middle:.0%}", "number"), Cell(interval, "number"), each))
    head = ("set", "interquartile mean", "95 % interval", "each seed")
    return Section(title, (Picture("reached", drawn, title, caption), Grid(head, tuple(table))))


def _iqm(values: list[float]) -> tuple[float, float, float]:
    at = estimates(values)
    low, high = at["iqm_ci"] or (at["iqm"], at["iqm"])
    return at["iqm"], low, high
