"""How far planar cars are from PyBullet, as tables (Markdown, CSV) and one figure."""

import csv
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from zebrat_bullet.evaluation.parity.drives import DRIVERS
from zebrat_bullet.evaluation.parity.study import SEEN_APART_M, Parity

_COLOURS = dict(zip(DRIVERS, ("#7d8a97", "#2a6f97", "#e07a3f"), strict=True))


def write_report(parity: Parity, folder: Path) -> str:
    """Write worlds.csv, drivers.csv, episodes.csv, table.md and parity.png; return the tables as text."""
    folder.mkdir(parents=True, exist_ok=True)
    _write_csv(folder / "worlds.csv", [*map(parity.row, parity.drives), parity.row()])
    _write_csv(folder / "drivers.csv", map(parity.driver_row, DRIVERS))
    _write_csv(folder / "episodes.csv", _episode_rows(parity))
    text = parity_text(parity)
    (folder / "table.md").write_text(text + "\n", encoding="utf-8")
    draw_parity(parity, folder / "parity.png")
    return text


def parity_text(parity: Parity) -> str:
    """Return all tables as Markdown: by driver, by world, and which episodes ended otherwise."""
    parts = [_driver_table(parity), _world_table(parity)]
    differing = [
        f"- {row['world']}, episode {row['episode']}: {row['outcome_bullet']} after {row['duration_bullet_s']:.1f} s "
        f"in PyBullet, {row['outcome_planar']} after {row['duration_planar_s']:.1f} s on the plane"
        for row in _episode_rows(parity)
        if row["outcome_bullet"] != row["outcome_planar"]
    ]
    if differing:
        parts.append("Episodes that ended otherwise:\n\n" + "\n".join(differing))
    return "\n\n".join(parts)


def _driver_table(parity: Parity) -> str:
    rows = [
        "| driver | drives of 1 s | apart, mm: median | 95 % | drives of 5 s | apart, mm: median | 95 % |",
        "|---" * 7 + "|",
    ]
    for row in (*map(parity.driver_row, DRIVERS), {**parity.row(), "driver": "all"}):
        cells = [row["driver"]]
        for after in ("1s", "5s"):
            cells += [row[f"drives_{after}"], *(_cell(row[f"apart_{after}_{what}_mm"]) for what in ("median", "p95"))]
        rows.append("| " + " | ".join(map(str, cells)) + " |")
    return "\n".join(rows)


def _world_table(parity: Parity) -> str:
    rows = [
        "| world | apart after 1 s, mm: median | 95 % | rays that differ | worst, mm | contact: planar car wrong "
        "| PyBullet wrong | episodes alike | successes in PyBullet | on the plane | durations apart, s: median | 95 % "
        "|",
        "|---" * 12 + "|",
    ]
    for row in (*map(parity.row, parity.drives), parity.row()):
        cells = [
            row["world"],
            _cell(row["apart_1s_median_mm"]),
            _cell(row["apart_1s_p95_mm"]),
            f"{row['rays_differing']} of {row['rays']}",
            _cell(1000.0 * row["rays_worst_m"]),
            f"{row['planar_wrong']} of {row['poses']}",
            f"{row['bullet_wrong']} of {row['poses']}",
            f"{row['episodes_alike']} of {row['episodes']}",
            row["success_bullet"],
            row["success_planar"],
            _cell(row["duration_apart_median_s"]),
            _cell(row["duration_apart_p95_s"]),
        ]
        rows.append("| " + " | ".join(map(str, cells)) + " |")
    return "\n".join(rows)


def _cell(value: float | None) -> str:
    return "-" if value is None else f"{value:.1f}" if value >= 0.05 or value == 0.0 else f"{value:.2g}"


def _episode_rows(parity: Parity) -> list[dict[str, Any]]:
    return [
        {
            "world": world,
            "episode": episode,
            "outcome_bullet": bullet.outcome,
            "outcome_planar": planar.outcome,
            "duration_bullet_s": round(bullet.duration_s, 6),
            "duration_planar_s": round(planar.duration_s, 6),
        }
        for world, pairs in parity.episodes.items()
        for episode, (bullet, planar) in enumerate(pairs)
    ]


def _write_csv(path: Path, rows: Iterable[Mapping[str, Any]]) -> None:
    listed: Sequence[Mapping[str, Any]] = list(rows)
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, list(listed[0]))
        writer.writeheader()
        writer.writerows(listed)


def draw_parity(parity: Parity, path: Path) -> None:
    """Draw how the cars come apart over time, and how much V_obs differs (PNG, SVG or PDF)."""
    figure = Figure(figsize=(10.0, 3.8), layout="constrained")
    FigureCanvasAgg(figure)
    motion, senses = figure.subplots(1, 2)
    _draw_motion(motion, parity)
    _draw_senses(senses, parity)
    for axes in (motion, senses):
        axes.grid(alpha=0.25)
        axes.spines[["top", "right"]].set_visible(False)
        axes.legend(frameon=False, fontsize=8, loc="lower right" if axes is motion else "upper right")
    figure.savefig(path, dpi=130)


def _draw_motion(axes: Axes, parity: Parity) -> None:
    step_s = parity.study.task.physics.control_step_s
    for driver in DRIVERS:
        apart_mm = 1000.0 * parity.apart_m(driver)
        apart_mm = apart_mm[:, np.isfinite(apart_mm).any(axis=0)]
        median, most = np.nanpercentile(apart_mm, (50, 95), axis=0)
        time_s = step_s * np.arange(len(median))
        axes.plot(time_s[1:], median[1:], color=_COLOURS[driver], label=f"{driver}: median, 95 % dotted")
        axes.plot(time_s[1:], most[1:], ":", color=_COLOURS[driver])
    axes.set_yscale("log")
    axes.set(xlabel="time driven, s", ylabel="base frames apart, mm", title="The same commands")


def _draw_senses(axes: Axes, parity: Parity) -> None:
    drives = [drive for of_world in parity.drives.values() for drive in of_world.values()]
    for label, colour, sights in (
        ("level car at the same pose", "#2a6f97", [drive.sight_m for drive in drives]),
        ("against the tilting car", "#e07a3f", [drive.rolling_m for drive in drives]),
    ):
        apart = np.sort(np.abs(np.concatenate([sight[np.isfinite(sight)] for sight in sights])))
        axes.plot(1000.0 * np.maximum(apart, 1e-8), 1.0 - np.arange(len(apart)) / len(apart), color=colour, label=label)
    axes.axvline(1000.0 * SEEN_APART_M, color="#555", lw=1, ls=":")
    axes.set(xscale="log", yscale="log", xlim=(1e-5, 1e4), xlabel="V_obs differs by more than, mm")
    axes.set(ylabel="share of rays", title="The same pose")
