"""The study of representations as tables: Markdown for people, CSV with every event and every case."""

import csv
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.detection.scoring import Event
from zebrat_bullet.detection.summary import (
    PAPER_COUNTS,
    Results,
    base_tallies,
    recommended_margins,
    relative_difference,
    summarise,
)

_CORNER_M = 0.03
LABELS = {"sr": "SR", "firect": "FIRect", "fifr": "FIFR", "cloud": "cloud"}


def study_text(results: Results, outline: NDArray[np.float64]) -> str:
    """Return all tables of a study of the car with a (K, 2) footprint in its base frame."""
    kinds_of_walls = list(dict.fromkeys(walls for walls, _ in results))
    parts = []
    for walls in kinds_of_walls:
        parts += [f"**{walls} walls**", counts_table(results, walls), places_table(results, walls, outline)]
        if any(case.panel == "margin" for _, case in results):
            parts.append(margins_table(results, walls))
        if any(case.panel not in ("base", "margin") for _, case in results):
            parts.append(variations_table(results, walls))
    if "ghost" in kinds_of_walls:
        parts.append(paper_table(results, "ghost"))
    return "\n\n".join(parts)


def counts_table(results: Results, walls: str) -> str:
    """Return the base case of each representation: what it reported, when, and what it missed."""
    rows = []
    for kind, tally in base_tallies(results, walls).items():
        at = summarise(tally)
        low, high = at.recall_ci
        rows.append(
            (
                LABELS[kind],
                f"{at.in_time} of {at.contacts}",
                f"{at.recall:.1%} ({low:.1%}-{high:.1%})",
                f"{at.within_1_s}",
                f"{at.contacts - at.within_1_s}",
                f"{at.overlap_reports} of {at.overlap_sweeps}",
                f"{at.false_alarms} in {at.clear_minutes:.0f} min",
                "-" if at.precision is None else f"{at.precision:.1%}",
                "-" if at.lead_s is None else f"{at.lead_s:+.2f} s",
            )
        )
    return _markdown(
        (
            "representation",
            "contacts reported in time",
            "recall (95 %)",
            "within 1 s",
            "not within 1 s",
            "sweeps in collision reported",
            "false alarms",
            "precision",
            "median lead",
        ),
        rows,
    )


def margins_table(results: Results, walls: str) -> str:
    """Return the margin recommended for each representation, or that none of those tried is wide enough."""
    widest = max(case.representation.margin_m for _, case in results if case.panel == "margin")
    best = recommended_margins(results, walls)
    rows = []
    for kind, label in LABELS.items():
        if kind not in best:
            rows.append((label, f"none up to {widest * 100:g} cm", "-", "-", "-"))
            continue
        margin, at = best[kind]
        rows.append(
            (
                label,
                f"{margin * 100:.2f} cm",
                f"{at.recall:.2%} ({at.recall_ci[0]:.1%}-{at.recall_ci[1]:.1%})",
                f"{at.false_alarms} in {at.clear_minutes:.0f} min",
                "-" if at.precision is None else f"{at.precision:.1%}",
            )
        )
    return _markdown(("representation", "margin for 99.9 %", "recall (95 %)", "false alarms", "precision"), rows)


def paper_table(results: Results, walls: str) -> str:
    """Return the paper's counts beside ours: relative to the safety region, with 95 % bootstrap intervals."""
    tallies = base_tallies(results, walls)
    rows = []
    for kind, count in PAPER_COUNTS.items():
        at = summarise(tallies[kind])
        row = [LABELS[kind], f"{count} ({count / PAPER_COUNTS['sr'] - 1:+.1%})"]
        for name in ("in_time", "within_1_s", "overlap_reports"):
            difference, low, high = relative_difference(tallies[kind], tallies["sr"], name)
            interval = "" if kind == "sr" or np.isnan(low) else f" {low:+.1%} to {high:+.1%}"
            row.append(f"{getattr(at, name)} ({difference:+.1%}{interval and ';' + interval})")
        rows.append(row)
    return _markdown(
        ("representation", "paper", "ours: contacts in time", "ours: contacts within 1 s", "ours: sweeps in collision"),
        rows,
    )


def variations_table(results: Results, walls: str) -> str:
    """Return one row a setting of each panel but "base" and "margin": share reported in time, false alarms a minute."""
    rows: dict[tuple[str, str, float], dict[str, str]] = {}
    for (w, case), tally in results.items():
        if w == walls and case.panel not in ("base", "margin"):
            at = summarise(tally)
            row = rows.setdefault((case.panel, case.setting, case.representation.margin_m), {})
            row[case.representation.kind] = f"{at.recall:.0%}, {at.false_alarms / max(at.clear_minutes, 1e-9):.1f}"
    return _markdown(
        (f"varied, {walls} walls", "setting", "margin", *LABELS.values()),
        [
            (panel, setting, f"{margin * 100:g} cm", *(row.get(kind, "-") for kind in LABELS))
            for (panel, setting, margin), row in rows.items()
        ],
    )


def places_table(results: Results, walls: str, outline: NDArray[np.float64]) -> str:
    """Return, for each part of the body, the share of the contacts there that was reported in time, and within 1 s.

    Args:
        results, walls: which.
        outline: (K, 2) footprint of the car in its base frame, m.
    """
    tallies = base_tallies(results, walls)
    places = np.array([_place(event, outline) for event in next(iter(tallies.values())).events])
    rows = []
    for place in dict.fromkeys(sorted(places)):
        here = places == place
        shares = [f"{t.in_time[here].mean():.0%} ({np.isfinite(t.lead_s[here]).mean():.0%})" for t in tallies.values()]
        rows.append((place, str(here.sum()), *shares))
    return _markdown((f"where, {walls} walls", "contacts", *(LABELS[kind] for kind in tallies)), rows)


def _place(event: Event, outline: NDArray[np.float64]) -> str:
    """Return the part of a convex (K, 2) counter-clockwise outline that a contact lies on."""
    at = np.array([event.contact_x, event.contact_y])
    end = "front" if event.contact_x > 0.0 else "rear"
    if np.hypot(*(outline - at).T).min() < _CORNER_M:
        return f"{end} corners"
    sides = np.roll(outline, -1, axis=0) - outline
    normals = np.stack([sides[:, 1], -sides[:, 0]], axis=1) / np.hypot(*sides.T)[:, None]
    nearest = int(np.argmin(np.abs(np.einsum("kd,kd->k", normals, at - outline))))
    return end if abs(normals[nearest, 0]) > abs(normals[nearest, 1]) else "flanks"


def posts_table(posts: Mapping[str, Results]) -> str:
    """Return the share of contacts with thin round posts that is reported in time, by diameter."""
    rows: dict[tuple[str, str, str], dict[str, str]] = {}
    for field, results in posts.items():
        for (walls, case), tally in results.items():
            what, at = case.representation, summarise(tally)
            rays = "all" if what.kind == "cloud" else str(what.n_rays)
            row = rows.setdefault((walls, f"{what.margin_m * 100:g} cm", f"{LABELS[what.kind]}, {rays} rays"), {})
            row[field] = f"{at.recall:.0%} ({at.recall_ci[0]:.0%}-{at.recall_ci[1]:.0%})"
    head = ("walls", "margin", "representation", *(f"{float(field.split('-')[1]) * 100:g} cm posts" for field in posts))
    return _markdown(head, [(*name, *(row[field] for field in posts)) for name, row in rows.items()])


def write_events(results: Results, path: Path) -> None:
    """Write one row a contact: where and how it happened, and what each base case made of it (CSV)."""
    kinds_of_walls = list(dict.fromkeys(walls for walls, _ in results))
    with path.open("w", encoding="utf-8", newline="") as file:
        writer: csv.DictWriter[str] | None = None
        for walls in kinds_of_walls:
            tallies = base_tallies(results, walls)
            for e, event in enumerate(next(iter(tallies.values())).events):
                row = {name: _rounded(value) for name, value in asdict(event).items()}
                for kind, tally in tallies.items():
                    row[f"{kind}_in_time"] = int(tally.in_time[e])
                    row[f"{kind}_lead_s"] = "" if np.isnan(tally.lead_s[e]) else _rounded(tally.lead_s[e])
                if writer is None:
                    writer = csv.DictWriter(file, list(row))
                    writer.writeheader()
                writer.writerow(row)


def write_cases(results: Results, path: Path) -> None:
    """Write one row a case and kind of walls (CSV)."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer: csv.DictWriter[str] | None = None
        for (walls, case), tally in results.items():
            what, at = case.representation, asdict(summarise(tally))
            low, high = at.pop("recall_ci")
            row: dict[str, object] = {
                "walls": walls,
                "panel": case.panel,
                "setting": case.setting,
                "representation": what.kind,
            }
            row |= {"rays": what.n_rays, "margin_m": what.margin_m, "recall_low": low, "recall_high": high} | at
            line = {name: _rounded(value) for name, value in row.items()}
            if writer is None:
                writer = csv.DictWriter(file, list(line))
                writer.writeheader()
            writer.writerow(line)


def _rounded(value: object) -> object:
    if value is None:
        return ""
    return round(float(value), 4) if isinstance(value, float | np.floating) else value


def _markdown(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)
