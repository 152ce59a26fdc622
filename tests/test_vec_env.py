"""Episodes that are tried again from where the car was before it failed, and driven again after a kill."""

import numpy as np
import pytest

from zebrat_bullet.config import LidarConfig, TaskConfig
from zebrat_bullet.envs.zebrat_env import ZebratEnv
from zebrat_bullet.training.vec_env import RETRY_STEPS, ReplayableEnv

TASK = TaskConfig(lidar=LidarConfig(caster="embree", n_channels=4))
INTO_THE_WALL = np.array([0.2, 0.0], dtype=np.float32)


@pytest.fixture
def make_env():
    made = []

    def make(retries):
        made.append(ReplayableEnv(ZebratEnv("track_2", task=TASK), retries))
        made[-1].reset(seed=3)
        return made[-1]

    yield make
    for env in made:
        env.close()


def drive_into_the_wall(env):
    """Return the poses of the car until it collides."""
    poses, done = [env.unwrapped.drive.state.pose], False
    while not done:
        *_, done, _, info = env.step(INTO_THE_WALL)
        poses.append(env.unwrapped.drive.state.pose)
    assert info["outcome"] == "collision"
    return poses


def begins(env):
    """Return number and start of the episode that a learner's reset begins."""
    _, info = env.reset()
    return env.unwrapped.episode[1], info["pose"]


def test_a_failed_episode_is_tried_again_from_a_pose_before_the_failure(make_env):
    env = make_env(retries=2)
    path = drive_into_the_wall(env)
    assert len(path) > 2 * RETRY_STEPS[1]  # so that no try begins where the episode did
    for _ in range(2):
        number, pose = begins(env)
        distances = [np.hypot(p.x - pose.x, p.y - pose.y) for p in path]
        at = int(np.argmin(distances))
        assert number == 0 and distances[at] < 0.002  # it settles on the floor
        assert RETRY_STEPS[0] <= len(path) - 1 - at < RETRY_STEPS[1]
        path = path[:at] + drive_into_the_wall(env)
    assert begins(env)[0] == 1


def test_without_retries_the_next_episode_follows_a_failure(make_env):
    env = make_env(retries=0)
    drive_into_the_wall(env)
    assert begins(env)[0] == 1


def test_an_episode_that_did_not_fail_is_not_tried_again(make_env):
    env = make_env(retries=2)
    env.step(INTO_THE_WALL)
    assert begins(env)[0] == 1


def test_a_try_goes_on_elsewhere_as_it_was(make_env):
    one, two = make_env(retries=3), make_env(retries=3)
    drive_into_the_wall(one)
    one.reset()
    one.step(INTO_THE_WALL)
    two.go_to(one.place())
    assert two.unwrapped.drive.state.pose == one.unwrapped.drive.state.pose
    for env in (one, two):
        drive_into_the_wall(env)
    assert begins(one) == begins(two)
