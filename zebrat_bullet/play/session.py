"""One sitting: a page is served on which passages are drawn and driven, until Ctrl-C."""

import threading
from collections.abc import Callable, Sequence

from zebrat_bullet.agents import load_agent
from zebrat_bullet.assets import list_assets
from zebrat_bullet.config import TaskConfig
from zebrat_bullet.errors import ConfigError, ZebratError
from zebrat_bullet.evaluation.own_task import as_trained
from zebrat_bullet.play.race import PERSON
from zebrat_bullet.play.server import PlayServer
from zebrat_bullet.play.stage import PACES, Stage
from zebrat_bullet.robot import load_robot
from zebrat_bullet.teleop.hub import Hub

DRIVERS = {
    "shipped": "learned; sees the lidar only",
    "allround": "learned to back up too; lidar only",
    "fomt": "learned on the paper's reward; lidar only",
    "il": "imitates the oracle, lidar only",
    "dagger": "imitates and was corrected, lidar only",
    "teb_tuned": "TEB planner; knows map, pose and goal",
    "dwa_tuned": "DWA planner; knows map, pose and goal",
    "oracle": "plans the whole drive; knows map, pose and goal",
}
"""Who may drive, and what the page says of them; the first is chosen unless another is."""
LIMIT_S = 30.0


def play(
    task: TaskConfig,
    *,
    agents: Sequence[str] = (),
    host: str = "127.0.0.1",
    port: int = 8766,
    seed: int = 0,
    limit_s: float = LIMIT_S,
    on_ready: Callable[[str], None] = lambda url: None,
) -> None:
    """Serve the page until interrupted (Ctrl-C).

    Args:
        task: the task driven; each policy has its own senses.
        agents: more who may drive, as `load_agent` takes them; named first.
        host, port: where to listen; port 0 takes a free one.
        seed: of the start poses.
        limit_s: most time of a search for a way out.
        on_ready: told the address of the page.

    Raises:
        ConfigError: the address cannot be listened on, or the limit is not above 0.
        ZebratError: an agent that was named cannot drive.
    """
    if not 0.0 < limit_s <= 3600.0:
        raise ConfigError(f"the limit of a search is above 0 s and at most 3600 s, got {limit_s}")
    drivers = {agent: "yours" for agent in agents if agent not in DRIVERS} | DRIVERS
    for agent in agents:
        load_agent(agent, as_trained(task, agent, own_robot=False)[0])
    able = {agent: said for agent, said in drivers.items() if agent in agents or _can_drive(agent, task)}
    hub = Hub()
    stage = Stage(task, hub, list(able), seed, limit_s)
    try:
        options = {
            "drivers": [{"name": name, "text": said} for name, said in able.items()],
            "first": agents[0] if agents else next(iter(able)),
            "person": PERSON,
            "paces": PACES,
            "worlds": list_assets("worlds", ".yaml"),
            "car_m": _size(task),
        }
        server = PlayServer(host, port, hub, stage, options)
        on_ready(server.url)
        try:
            threading.Event().wait()
        except KeyboardInterrupt:
            pass  # the usual way to leave
        finally:
            server.close()
    finally:
        stage.close()


def _can_drive(agent: str, task: TaskConfig) -> bool:
    try:
        load_agent(agent, as_trained(task, agent, own_robot=False)[0])
    except ZebratError:  # a policy for another car
        return False
    return True


def _size(task: TaskConfig) -> tuple[float, float]:
    x, y = load_robot(task.robot).footprint_base.T
    return float(x.max() - x.min()), float(y.max() - y.min())
