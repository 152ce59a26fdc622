"""The command that studies which scan representation sees a collision."""

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

from zebrat_bullet.cli.common import TRACKS, AddCommand, Result, note, progress_bar
from zebrat_bullet.cli.options import workers_option
from zebrat_bullet.config import TaskConfig
from zebrat_bullet.errors import ConfigError, ZebratError


def collisions(arguments: argparse.Namespace) -> Result:
    """Drive into walls and count which scan representation reports it; recommend a margin."""
    from zebrat_bullet.config import LidarConfig, NoiseConfig
    from zebrat_bullet.detection.cases import POSTS, cases, post_cases
    from zebrat_bullet.detection.scoring import Sensing
    from zebrat_bullet.detection.study import Study, run_study
    from zebrat_bullet.detection.summary import Results, recommended_margins, summaries
    from zebrat_bullet.report.collision_report import write_misses_mp4, write_report

    out = arguments.out or Path("results") / "collisions"
    drives = arguments.drives or out
    if arguments.drives and not drives.is_dir():
        raise ConfigError(f"--drives takes the --out of an earlier run, got {drives}, which is no folder")
    study = Study(
        worlds=tuple(arguments.worlds),
        drivers=tuple(arguments.drivers),
        walls=tuple(arguments.walls),
        n_events=arguments.events,
        seed=arguments.seed,
        policy=arguments.policy,
        task=TaskConfig(robot=arguments.robot),
    )
    sensing = Sensing(
        lidar=LidarConfig(caster=arguments.caster or "bullet"),
        noise=NoiseConfig(range_sigma_m=arguments.noise),
        rate_hz=arguments.rate_hz,
    )
    panels = ["base", *(panel for panel in arguments.panels if panel not in ("base", "posts"))]
    chosen = cases(panels, sensing, arguments.rays, arguments.margin)
    posts: dict[str, Results] = {}
    with progress_bar(arguments) as bar:
        shown = bar.add_task("driving")

        def on_progress(doing: str, done: int, total: int) -> None:
            bar.update(shown, description=doing, completed=done, total=total)

        results = run_study(study, chosen, drives, arguments.workers, on_progress)
        text = write_report(study, results, posts, out)
        if "posts" in arguments.panels:
            thin = post_cases(sensing, arguments.rays, arguments.margin)
            for field in POSTS:
                there = replace(
                    study, worlds=(field,), drivers=("random-smooth",), n_events=max(study.n_events // 5, 1)
                )
                posts[field] = run_study(there, thin, drives / field, arguments.workers, on_progress)
            text = write_report(study, results, posts, out)
    result: dict[str, Any] = {
        "counts": summaries(results),
        "recommended_margin_m": {
            walls: {kind: margin for kind, (margin, _) in recommended_margins(results, walls).items()}
            for walls in study.walls
        },
    }
    if not arguments.no_video:
        try:
            if video := write_misses_mp4(study, results, drives, out):
                result["video"] = str(video)
        except (ZebratError, OSError) as error:  # the counts are worth more than the film
            note(arguments, f"no video: {error}")
    return result, f"{text}\n\ntables, every contact and figures: {out}"


def add(command: AddCommand) -> None:
    """Add the commands of this file."""
    made = command(collisions, workers_option())
    made.add_argument("--events", type=int, default=1000, help="contacts to drive for (default 1000)")
    made.add_argument("--worlds", nargs="+", default=["big_track", *TRACKS[4:]], metavar="WORLD")
    made.add_argument("--drivers", nargs="+", default=["random", "random-smooth", "policy"], metavar="DRIVER")
    made.add_argument("--policy", default="shipped", help="the agent behind the driver `policy`")
    made.add_argument("--walls", nargs="+", default=["solid", "ghost"], help="solid stop the car, ghost let it through")
    made.add_argument("--rays", type=int, default=32, help="rays of each representation (default 32)")
    made.add_argument(
        "--margin",
        type=float,
        nargs="+",
        default=[0.0],
        help="margins in m; the first is that of the counts (default 0)",
    )
    made.add_argument("--rate-hz", type=float, default=5.0, help="sweeps a second (default 5)")
    made.add_argument("--caster", choices=("bullet", "embree"), default="embree", help="ray caster (default embree)")
    made.add_argument("--noise", type=float, default=0.0, help="lidar range noise, sigma in m")
    made.add_argument(
        "--panels",
        nargs="*",
        default=["margin"],
        metavar="PANEL",
        help="what else to vary: margin rays rate resolution noise caster posts (default: margin)",
    )
    made.add_argument(
        "--drives", type=Path, metavar="FOLDER", help="drives of an earlier --out, to count them otherwise"
    )
    made.add_argument("--no-video", action="store_true", help="leave out misses.mp4")
