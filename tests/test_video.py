"""Episode records as MP4 files."""

from dataclasses import replace

import imageio_ffmpeg
import numpy as np
import pytest

from zebrat_bullet.config import EpisodeConfig, LidarConfig, TaskConfig
from zebrat_bullet.errors import RenderError
from zebrat_bullet.evaluation.rollout import run_episode
from zebrat_bullet.report.video import episode_frames, write_video
from zebrat_bullet.robot import load_robot
from zebrat_bullet.task.drive import Drive
from zebrat_bullet.types import Command
from zebrat_bullet.world import load_world

SIZE = (320, 180)
HOLD_FRAMES = 38  # 1.5 s at 25 frames a second, rounded to even


class SlowlyAhead:
    name = "slowly_ahead"
    privileged: frozenset[str] = frozenset()

    def reset(self, seed):
        """Nothing to reset."""

    def act(self, reading):
        return Command(0.2, 0.0)


@pytest.fixture(scope="module")
def world():
    return load_world("track_2")


@pytest.fixture(scope="module")
def robot():
    return load_robot()


@pytest.fixture(scope="module")
def record(world):
    task = TaskConfig(lidar=LidarConfig(caster="embree"), episode=EpisodeConfig(max_steps=5))
    drive = Drive(task, world)
    episode = run_episode(drive, SlowlyAhead(), seed=1, episode=0)
    drive.close()
    return episode


def test_the_video_is_h264_of_the_size_and_length_asked_for(tmp_path, record, robot, world):
    path = tmp_path / "new_folder" / "drive.mp4"
    told = []
    write_video(record, path, robot, world, size=SIZE, progress=lambda n, n_all: told.append((n, n_all)))
    reader = imageio_ffmpeg.read_frames(str(path))
    meta = next(reader)
    frames = [np.frombuffer(data, np.uint8).astype(int) for data in reader]
    # 1 s of driving is 26 frames with both ends.
    assert record.duration_s == pytest.approx(1.0)
    assert len(frames) == 26 + HOLD_FRAMES
    assert (meta["codec"], meta["fps"], tuple(meta["size"])) == ("h264", 25.0, SIZE)
    assert meta["pix_fmt"].startswith("yuv420p")
    assert (np.abs(frames[25] - frames[0]) > 40).sum() > 100
    assert told[-1] == (26 + HOLD_FRAMES, 26 + HOLD_FRAMES)
    assert [file.name for file in path.parent.iterdir()] == ["drive.mp4"]


def test_max_seconds_cuts_the_drive_and_its_outcome(tmp_path, record, robot, world):
    path = tmp_path / "cut.mp4"
    write_video(record, path, robot, world, size=SIZE, max_seconds=0.4)
    n_frames, _ = imageio_ffmpeg.count_frames_and_secs(str(path))
    assert n_frames == 11


def test_a_video_that_fails_leaves_the_folder_as_it_was(tmp_path, record, robot, world):
    path = tmp_path / "drive.mp4"
    path.write_bytes(b"an older video")

    def interrupt(n, n_all):
        if n == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_video(record, path, robot, world, size=SIZE, progress=interrupt)
    assert [file.name for file in tmp_path.iterdir()] == ["drive.mp4"]
    assert path.read_bytes() == b"an older video"


@pytest.mark.parametrize(("name", "size"), [("v.mp4", (321, 180)), ("v.mp4", (320, 181)), ("v.avi", SIZE)])
def test_sizes_and_suffixes_that_no_encoder_takes_are_refused(tmp_path, record, robot, world, name, size):
    with pytest.raises(RenderError):
        write_video(record, tmp_path / name, robot, world, size=size)
    assert list(tmp_path.iterdir()) == []


def test_motion_between_control_steps_is_interpolated(record, robot, world):
    start, half, end = episode_frames(record, robot, world, np.array([0.4, 0.5, 0.6]))
    assert half.pose.x == pytest.approx((start.pose.x + end.pose.x) / 2)
    np.testing.assert_allclose(half.wheel_rad, (start.wheel_rad + end.wheel_rad) / 2)
    np.testing.assert_allclose(half.clearance.obs_m, (start.clearance.obs_m + end.clearance.obs_m) / 2, rtol=1e-5)


def test_a_heading_across_the_seam_turns_the_short_way(record, robot, world):
    pose = record.pose.copy()
    pose[:, 2] = np.pi - 0.1
    pose[1:, 2] = -np.pi + 0.1
    (frame,) = episode_frames(replace(record, pose=pose), robot, world, np.array([0.1]))
    assert np.cos(frame.pose.yaw) == pytest.approx(-1.0)


def test_the_outcome_shows_at_the_end_and_not_before(record, robot, world):
    frames = list(episode_frames(record, robot, world, np.array([0.0, 0.9, record.duration_s])))
    assert [frame.status for frame in frames] == ["", "", "timeout"]


def test_the_cloud_lies_on_walls_and_floor(record, robot, world):
    (frame,) = episode_frames(record, robot, world, np.array([0.0]))
    heights = frame.cloud_world[:, 2]
    assert heights.min() > -1e-4
    assert 0.5 < heights.max() < 3.0
    assert len(heights) > 1000
