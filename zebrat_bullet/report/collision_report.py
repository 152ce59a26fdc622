"""Everything that a study of representations leaves in its folder for people to read."""

from collections.abc import Mapping
from pathlib import Path

from zebrat_bullet.detection.study import Study, load_event_trace
from zebrat_bullet.detection.summary import Results, base_cases
from zebrat_bullet.report.collision_figures import draw_counts, draw_misses, draw_sweeps
from zebrat_bullet.report.collisions import posts_table, study_text, write_cases, write_events
from zebrat_bullet.report.miss_video import find_misses, write_miss_video
from zebrat_bullet.robot import load_robot


def write_report(study: Study, results: Results, posts: Mapping[str, Results], folder: Path) -> str:
    """Write events.csv, cases.csv, table.md, counts.png, misses.png and sweeps.png; return the tables as text.

    Args:
        study: what was driven.
        results: what came of it.
        posts: the same for each field of posts, by its name; may be empty.
        folder: where to.
    """
    folder.mkdir(parents=True, exist_ok=True)
    write_events(results, folder / "events.csv")
    write_cases(results, folder / "cases.csv")
    text = study_text(results, load_robot(study.task.robot).footprint_base)
    if posts:
        text += "\n\n**Posts**\n\n" + posts_table(posts)
    (folder / "table.md").write_text(text + "\n", encoding="utf-8")
    draw_counts(results, folder / "counts.png")
    draw_misses(results, study.task.robot, folder / "misses.png")
    draw_sweeps(results, folder / "sweeps.png")
    return text


def write_misses_mp4(study: Study, results: Results, drives: Path, folder: Path) -> Path | None:
    """Write misses.mp4, or nothing where nothing was missed; ghost walls, if they were driven, for they stop nobody.

    Args:
        study, results: what was driven and what came of it.
        drives: the folder that it was driven in.
        folder: where to.
    """
    misses = find_misses(results, "ghost" if "ghost" in study.walls else "solid")
    if not misses:
        return None
    cases = base_cases(results)
    scenes = [(cases[kind], event, load_event_trace(study, event, drives)) for kind, event in misses.items()]
    path = folder / "misses.mp4"
    write_miss_video(scenes, study.task.robot, path)
    return path
