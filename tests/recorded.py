"""One real episode, recorded once for all tests of recordings."""

from functools import cache

from zebrat_bullet.agents import load_agent
from zebrat_bullet.config import TaskConfig
from zebrat_bullet.evaluation.own_task import as_trained
from zebrat_bullet.recording.episode import WatchedEpisode, watch_episode
from zebrat_bullet.robot import load_robot
from zebrat_bullet.world import World, load_world

AGENT, WORLD = "shipped", "real_1"


@cache
def task() -> TaskConfig:
    return as_trained(TaskConfig(), AGENT, own_robot=True)[0]


@cache
def world() -> World:
    return load_world(WORLD, robot=load_robot(task().robot))


@cache
def episode() -> WatchedEpisode:
    """An episode of real_1, driven by the shipped policy in PyBullet."""
    return watch_episode(task(), world(), load_agent(AGENT, task()), seed=0, episode=0)
