"""What was run, at which budget, and what is missing."""

from collections import Counter
from dataclasses import dataclass
from typing import Any

from zebrat_bullet.report.comparison.document import Cell, Grid, Kind, Row, Section, Text
from zebrat_bullet.report.comparison.evidence import Evidence
from zebrat_bullet.report.comparison.settings import Asked

STUDIES = {
    "paper": "the paper's budget",
    "scale": "at scale",
    "paper-at-scale": "the paper's algorithms, longer",
    "finetuning": "fine-tuning",
    "rivals": "planners and imitators",
}
_MOST_NAMED = 6


def run_section(
    evidence: Evidence, asked: dict[tuple[str, str, str, str, str], Asked], runs: dict[tuple[str, ...], int]
) -> Section:
    """Return the section.

    Args:
        evidence: what was done.
        asked: what was to be judged, as `asked_for` returns it.
        runs: what was to be trained, as `asked_runs` returns it.
    """
    trained = _trained(evidence, runs)
    return Section(
        "What was run",
        (Text(_sum(evidence, asked, trained)),),
        (
            Section("Every training", (_trainings(trained),), folded=True),
            Section("Every judgement", (_judgements(asked),), folded=True),
        ),
    )


@dataclass(frozen=True, slots=True)
class _Trained:
    """Runs of one set, and how many there were to be."""

    runs: list[dict[str, Any]]
    n_asked: int

    def count(self, state: str) -> int:
        return sum(run["state"] == state for run in self.runs)


def _trained(evidence: Evidence, asked: dict[tuple[str, ...], int]) -> dict[tuple[str, ...], _Trained]:
    groups: dict[tuple[str, ...], list[dict[str, Any]]] = {key: [] for key in asked}
    for run in evidence.runs:
        key = run["study"], run["algorithm"], run["reward"], run["variant"] or "", run["asked"] or ""
        groups.setdefault(key, []).append(run)
    at = {key: _Trained(runs, max(asked.get(key, 0), len(runs))) for key, runs in groups.items()}
    return dict(sorted(at.items(), key=lambda item: _order(item[0])))


def _sum(
    evidence: Evidence,
    asked: dict[tuple[str, str, str, str, str], Asked],
    trained: dict[tuple[str, ...], _Trained],
) -> str:
    said = (
        "Beside what the largest budget asks for. A run is the training of one seed; a cell is one policy or planner "
        "in one place, a world or a held-out set. What is missing is marked in the tables, never filled in; and a cell "
        "counts as driven with fewer episodes than asked for, too, whose share stands with it."
    )
    lines = []
    for study, title in STUDIES.items():
        of_study = [each for key, each in trained.items() if key[0] == study]
        at = [each for key, each in asked.items() if key[0] == study]
        n, n_missing = sum(len(each.cells) for each in at), sum(len(each.missing) for each in at)
        complete, begun = (sum(each.count(state) for each in of_study) for state in ("complete", "partial"))
        runs = f"{complete} of {sum(each.n_asked for each in of_study)} runs complete, {begun} begun; "
        done, wanted = sum(each.n_driven for each in at), sum(each.n_wanted for each in at)
        share = f", in worlds with {done / wanted:.0%} of the episodes" if wanted else ""
        lines.append(f"- **{title}**: {runs if of_study else ''}{n - n_missing} of {n} cells driven{share}")
    hours = sum(run["wall_s"] or 0.0 for run in evidence.runs) / 3600.0
    n_held_out = sum(row["n"] for row in evidence.held_out)
    counted = (
        f"{len(evidence.drives):,} episodes in worlds, {n_held_out:,} on held-out tracks; {hours:,.0f} h of training."
    )
    return "\n".join([said, "", *lines, "", counted])


def _trainings(trained: dict[tuple[str, ...], _Trained]) -> Grid:
    rows: list[Row] = []
    for (study, algorithm, reward, variant, asked), at in trained.items():
        done, begun = at.count("complete"), at.count("partial")
        kind: Kind = "good" if done == at.n_asked else "open" if done or begun else "missing"
        said = f"{done} of {at.n_asked}" + (f", {begun} begun" if begun else "")
        name = f"{algorithm} {reward.upper()}{f', {variant}' if variant else ''}"
        hours = f"{sum(run['wall_s'] or 0.0 for run in at.runs) / 3600:.1f}"
        numbers = (_span(at.runs, "episodes"), _span(at.runs, "steps"), hours)
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
    absent = Counter[tuple[str, str, str]]()
    for (study, method, setting, noise, sim), at in sorted(asked.items(), key=lambda item: _order(item[0])):
        n, n_missing = len(at.cells), len(at.missing)
        words = ", ".join(filter(None, (setting, noise))) or "-"
        if n == n_missing:
            absent[study, method, sim] += n
            continue
        kind: Kind = "open" if n_missing else "good"
        short: Kind = "open" if at.n_driven < at.n_wanted else "good" if at.n_wanted else ""
        episodes = Cell(f"{at.n_driven:,} of {at.n_wanted:,}" if at.n_wanted else "-", short)
        counts = Cell(f"{n - n_missing} of {n}", kind), episodes
        rows.append((STUDIES.get(study, study), method, words, sim, *counts, _named(at)))
    for (study, method, sim), n in absent.items():
        rows.append((STUDIES.get(study, study), method, "all others", sim, Cell(f"0 of {n}", "missing"), "-", "all"))
    head = ("budget", "method", "setting", "simulator", "cells driven", "episodes in those worlds", "not driven")
    return Grid(head, tuple(rows))


def _named(at: Asked) -> str:
    """Return where cells are missing, in words."""
    places = list(dict.fromkeys(cell.place for cell in at.missing))
    more = f" and {len(places) - _MOST_NAMED} more" if len(places) > _MOST_NAMED else ""
    return ", ".join(places[:_MOST_NAMED]) + more or "-"
