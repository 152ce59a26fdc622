"""An episode record as a video: MP4 (H.264), 25 smooth frames a second, written one frame at a time."""

import math
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.config import TaskConfig
from zebrat_bullet.config_text import from_json
from zebrat_bullet.evaluation.records import EpisodeRecord
from zebrat_bullet.geometry import wrap_angle
from zebrat_bullet.render import Frame, Renderer
from zebrat_bullet.render.live import cast_cloud, region_outline
from zebrat_bullet.report.mp4 import check_mp4, write_mp4
from zebrat_bullet.robot import RobotModel
from zebrat_bullet.sensing.beams import beam_directions
from zebrat_bullet.sensing.casters import make_caster
from zebrat_bullet.types import Clearance, FlatScan, Pose2
from zebrat_bullet.world import World, parse_reference

DEFAULT_SIZE = (960, 540)
_STOPPED = "stopped"  # by the supervisor
_HOLD_S = 1.5  # the outcome stays on the screen this long


def write_video(
    record: EpisodeRecord,
    path: Path,
    robot: RobotModel,
    world: World,
    *,
    fps: int = 25,
    size: tuple[int, int] = DEFAULT_SIZE,
    max_seconds: float | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> None:
    """Write the episode as an MP4, whole or not at all.

    Args:
        record: the episode.
        path: the file to write; its name ends in .mp4.
        robot, world: what the episode was driven with.
        fps: frames a second; between control steps the motion is interpolated.
        size: width and height in px, both even.
        max_seconds: draws only this much of the episode.
        progress: called with (frames written, frames in all) after each frame.

    Raises:
        RenderError: a size or suffix that the encoder does not take.
        MissingSystemLibraryError: libOSMesa is absent.
    """
    check_mp4(path, size)
    times = _frame_times(record, fps, max_seconds)
    renderer = Renderer(robot, world, *size)

    def pictures() -> Iterator[NDArray[np.uint8]]:
        for n, frame in enumerate(episode_frames(record, robot, world, times), start=1):
            yield renderer.frame(frame)
            if progress is not None:
                progress(n, len(times))

    try:
        write_mp4(path, pictures(), fps, size)
    finally:
        renderer.close()


def _frame_times(record: EpisodeRecord, fps: int, max_seconds: float | None) -> NDArray[np.float64]:
    """Return the episode times to draw; the last one is repeated while the outcome is shown."""
    end = record.duration_s if max_seconds is None else min(record.duration_s, max_seconds)
    times = np.arange(math.floor(end * fps) + 1) / fps
    return times if end < record.duration_s else np.append(times, np.full(round(_HOLD_S * fps), end))


def episode_frames(
    record: EpisodeRecord, robot: RobotModel, world: World, times_s: NDArray[np.float64]
) -> Iterator[Frame]:
    """Yield the frames of an episode at (K,) times in s; the motion between control steps is interpolated."""
    task = from_json(TaskConfig, record.task)
    # Embree whatever the episode was driven with: it is fast enough to cast the cloud anew for every frame.
    caster = make_caster("embree", beam_directions(task.lidar), task.lidar.range_max_m, None)
    caster.set_world(world)
    outline = region_outline(robot, task.region.margin_m)
    driven: list[tuple[float, float]] = []
    refused = set(record.refused[:, 0].astype(int).tolist())
    for time_s in times_s:
        step, share = _locate(record.time_s, time_s)
        pose = _pose_at(record, step, share)
        driven.append((pose.x, pose.y))
        yield Frame(
            pose=pose,
            knuckle_rad=_between(record.knuckle_rad, step, share),
            wheel_rad=_between(record.wheel_rad, step, share),
            cloud_world=cast_cloud(caster, task.lidar, robot, pose),
            scan=FlatScan(record.scan_m[step], task.lidar.range_max_m),
            scan_pose=Pose2(*record.pose[step]),
            clearance=_clearance_at(record, step, share),
            region_base=outline,
            path_world=np.array(driven),
            speed_mps=float(_between(record.speed_mps, step, share)),
            steering_rad=float(_between(record.steering_rad, step, share)),
            time_s=float(time_s),
            terms=dict(zip(record.term_names, record.terms[min(step, len(record.terms) - 1)], strict=True)),
            title=f"{Path(parse_reference(record.world).name).stem} · {Path(record.agent.partition(':')[0]).stem}",
            status=record.outcome if time_s >= record.duration_s else _STOPPED if step in refused else "",
        )


def _locate(times_s: NDArray[np.float64], time_s: float) -> tuple[int, float]:
    """Return the control step that `time_s` lies in, and how far through it, in [0, 1)."""
    step = int(np.clip(np.searchsorted(times_s, time_s + 1e-9, side="right") - 1, 0, len(times_s) - 1))
    if step == len(times_s) - 1:
        return step, 0.0
    return step, float((time_s - times_s[step]) / (times_s[step + 1] - times_s[step]))


def _between(values: NDArray, step: int, share: float) -> NDArray:
    after = min(step + 1, len(values) - 1)
    return values[step] + share * (values[after] - values[step])


def _pose_at(record: EpisodeRecord, step: int, share: float) -> Pose2:
    x, y, _ = _between(record.pose, step, share)
    yaw, after = record.pose[step, 2], record.pose[min(step + 1, len(record.pose) - 1), 2]
    return Pose2(float(x), float(y), yaw + share * wrap_angle(after - yaw))


def _clearance_at(record: EpisodeRecord, step: int, share: float) -> Clearance:
    obs = _between(record.obs_m, step, share)
    return Clearance(obs, record.range_m, bool((obs <= record.range_m).any()))
