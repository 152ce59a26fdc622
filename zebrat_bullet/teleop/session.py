"""One sitting: a person drives episode after episode in a world, and each becomes a record of a data set."""

import json
from collections.abc import Callable
from itertools import count
from pathlib import Path

from zebrat_bullet.config import TaskConfig
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.evaluation.judge import record_path
from zebrat_bullet.evaluation.records import EpisodeRecord, save_record
from zebrat_bullet.evaluation.rollout import run_episode
from zebrat_bullet.outputs import require_writable
from zebrat_bullet.robot import load_robot
from zebrat_bullet.task.drive import Drive
from zebrat_bullet.teleop.hub import Hub
from zebrat_bullet.teleop.person import PersonAgent, RestartError, show_view
from zebrat_bullet.teleop.scene import car_of, view_of, walls_of
from zebrat_bullet.teleop.server import TeleopServer
from zebrat_bullet.world import load_world, require_winnable


def teleop(
    world: str,
    folder: Path,
    task: TaskConfig,
    *,
    host: str = "127.0.0.1",
    port: int = 8765,
    seed: int = 0,
    episodes: int | None = None,
    on_ready: Callable[[str], None] = lambda url: None,
    on_episode: Callable[[EpisodeRecord, Path], None] = lambda record, path: None,
) -> None:
    """Serve the page and record every episode that a person drives to its end.

    An attempt given up with R is not kept, and begins again from the same start. Episodes continue the numbers that
    the folder holds, so a data set grows over many sittings.

    Args:
        world: world name or file.
        folder: the data set.
        task: the task driven.
        host, port: where to listen; port 0 takes a free one.
        seed: of the start poses.
        episodes: end after so many; None goes on until interrupted (Ctrl-C), and then returns too.
        on_ready: told the address of the page.
        on_episode: told of every episode that was saved.

    Raises:
        ConfigError: the address cannot be listened on, or episodes is below 1.
        AssetError, WorldError: the world cannot be loaded, driven or won.
        OSError: the folder cannot be written to.
    """
    if episodes is not None and episodes < 1:
        raise ConfigError(f"episodes must be at least 1, got {episodes}; leave it out to drive until Ctrl-C")
    place = load_world(world, robot=load_robot(task.robot))
    require_winnable(place)
    require_writable(folder, folder=True)
    drive = Drive(task, place)
    hub = Hub()
    server = TeleopServer(host, port, hub, _world_json(drive, hub.sitting))
    on_ready(server.url)
    try:
        for saved in count(1):
            record = _drive_to_an_end(drive, hub, seed, _next_episode(folder, world))
            path = record_path(folder, world, record.episode)
            save_record(record, path)
            on_episode(record, path)
            _show_end(hub, record, saved)
            if saved == episodes:
                break
            hub.wait(hub.restart_struck)
    except KeyboardInterrupt:
        pass  # the usual way to leave
    finally:
        server.close()
        drive.close()


def _drive_to_an_end(drive: Drive, hub: Hub, seed: int, episode: int) -> EpisodeRecord:
    agent = PersonAgent(hub, drive.config.physics)
    while True:
        try:
            return run_episode(drive, agent, seed, episode)
        except RestartError:
            continue


def _next_episode(folder: Path, world: str) -> int:
    return next(k for k in count() if not record_path(folder, world, k).exists())


def _show_end(hub: Hub, record: EpisodeRecord, saved: int) -> None:
    x, y, yaw = record.pose[-1].tolist()
    view = view_of((x, y, yaw), record.scan_m[-1], record.duration_s, 0.0, float(record.steering_rad[-1]))
    hub.show(show_view("over", view, outcome=record.outcome, saved=saved))


def _world_json(drive: Drive, sitting: str) -> str:
    """Return what the page draws that never changes in this sitting."""
    world = {"sitting": sitting, "name": drive.world.name, "walls": walls_of(drive.world)}
    return json.dumps(world | car_of(drive))
