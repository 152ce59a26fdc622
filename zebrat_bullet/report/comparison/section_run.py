"""What was run, at which budget, and what is missing."""

from collections import defaultdict
from typing import Any

from zebrat_bullet.report.comparison.document import Cell, Grid, Kind, Row, Section, Text
from zebrat_bullet.report.comparison.evidence import Evidence
from zebrat_bullet.report.comparison.settings import Asked

STUDIES = {
    "paper": "the paper's budget",
    "scale": "ours",
    "paper-at-scale": "the paper's algorithms, longer",
    "finetuning": "fine-tuning",
    "rivals": "planners and imitators",
}
_MOST_NAMED = 6


def run_section(evidence: Evidence, asked: dict[tuple[str, str, str, str, str], Asked]) -> Section:
    """Return the section."""
    return Section(
        "What was run",
        (Text(_sum(evidence, asked)),),
        (
            Section("Every training", (_trainings(evidence),), folded=True),
            Section("Every judgement", (_judgements(asked),), folded=True),
        ),
    )


def _sum(evidence: Evidence, asked: dict[tuple[str, str, str, str, str], Asked]) -> str:
    said = (
        "A run is the training of one seed; a cell is one policy or planner in one place, a world or a held-out set. "
        "What is missing is marked in the tables, never filled in."
    )
    lines = []
    for study, title in STUDIES.items():
        states = [run["state"] for run in evidence.runs if run["study"] == study]
        at = [each for key, each in asked.items() if key[0] == study]
        n, n_missing = sum(len(each.cells) for each in at), sum(len(each.missing) for each in at)
        runs = f"{states.count('complete')} of {len(states)} runs complete, {states.count('partial')} begun; "
        lines.append(f"- **{title}**: {runs if states else ''}{n - n_missing} of {n} cells driven")
    hours = sum(run["wall_s"] or 0.0 for run in evidence.runs) / 3600.0
    n_held_out = sum(row["n"] for row in evidence.held_out)
    counted = (
        f"{len(evidence.drives):,} episodes in worlds, {n_held_out:,} on held-out tracks; {hours:,.0f} h of training."
    )
    return "\n".join([said, "", *lines, "", counted])


def _trainings(evidence: Evidence) -> Grid:
    groups: dict[tuple[str, ...], list[dict[str, Any]]] = defaultdict(list)
    for run in evidence.runs:
        groups[run["study"], run["algorithm"], run["reward"], run["variant"] or "", run["asked"] or ""].append(run)
    rows: list[Row] = []
    for (study, algorithm, reward, variant, asked), runs in sorted(groups.items(), key=lambda item: _order(item[0])):
        done = [run for run in runs if run["state"] == "complete"]
        begun = [run for run in runs if run["state"] == "partial"]
        kind: Kind = "good" if len(done) == len(runs) else "open" if done or begun else "missing"
        said = f"{len(done)} of {len(runs)}" + (f", {len(begun)} begun" if begun else "")
        name = f"{algorithm} {reward.upper()}{f', {variant}' if variant else ''}"
        numbers = (_span(runs, "episodes"), _span(runs, "steps"), f"{sum(r['wall_s'] or 0.0 for r in runs) / 3600:.1f}")
        cells = (Cell(said, kind), *(Cell(text, "number") for text in numbers))
        rows.append((STUDIES.get(study, study), name, asked, *cells))
    head = ("budget", "set", "asked for", "seeds complete", "episodes of a run", "steps of a run", "hours, all runs")
    return Grid(head, tuple(rows))


def _order(key: tuple[str, ...]) -> tuple[int, tuple[str, ...]]:
    return (list(STUDIES).index(key[0]) if key[0] in STUDIES else len(STUDIES)), key


def _span(runs: list[dict[str, Any]], column: str) -> str:
    values = [run[column] for run in runs if run[column]]
    if not values:
        return "-"
    low, high = min(values), max(values)
    return f"{low:,}" if low == high else f"{low:,} to {high:,}"


def _judgements(asked: dict[tuple[str, str, str, str, str], Asked]) -> Grid:
    rows: list[Row] = []
    for (study, method, setting, noise, sim), at in sorted(asked.items(), key=lambda item: _order(item[0])):
        n, n_missing = len(at.cells), len(at.missing)
        kind: Kind = "good" if not n_missing else "missing" if n_missing == n else "open"
        places = list(dict.fromkeys(cell.place for cell in at.missing))
        named = ", ".join(places[:_MOST_NAMED]) + (
            f" and {len(places) - _MOST_NAMED} more" if len(places) > _MOST_NAMED else ""
        )
        words = ", ".join(filter(None, (setting, noise)))
        rows.append(
            (STUDIES.get(study, study), method, words or "-", sim, Cell(f"{n - n_missing} of {n}", kind), named or "-")
        )
    head = ("budget", "method", "setting", "simulator", "cells driven", "not driven")
    return Grid(head, tuple(rows))
