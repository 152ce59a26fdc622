"""Training environments go on where they were left: a killed run drives its episode again."""

import numpy as np

from zebrat_bullet.config import LidarConfig, TaskConfig
from zebrat_bullet.envs.zebrat_env import ZebratEnv
from zebrat_bullet.training.vec_env import ReplayableEnv

TASK = TaskConfig(lidar=LidarConfig(caster="embree", n_channels=4))


def test_an_episode_goes_on_elsewhere_as_it_was():
    one, two = (ReplayableEnv(ZebratEnv("track_2", task=TASK)) for _ in range(2))
    one.reset(seed=3)
    one.step(np.array([-0.5, 0.0], dtype=np.float32))
    one.reset()
    for steering in (0.0, 0.4, -0.3):
        seen = one.step(np.array([0.8, steering], dtype=np.float32))
    place = one.place()
    assert place["episode"] == (3, 1) and len(place["actions"]) == 3
    two.go_to(place)
    assert two.place() == place
    assert two.unwrapped.drive.state.pose == one.unwrapped.drive.state.pose
    go_on = np.array([0.8, 0.2], dtype=np.float32)
    for ours, theirs in zip(one.step(go_on)[:4], two.step(go_on)[:4], strict=True):
        assert np.array_equal(ours, theirs)
    assert not np.array_equal(seen[0], one.step(go_on)[0])
    one.reset()
    two.reset()
    assert one.unwrapped.episode == two.unwrapped.episode == (3, 2)
    for env in (one, two):
        env.close()
