"""How PyBullet and MuJoCo compare: motion under the same commands, steps a second, success side by side.

PYTHONPATH=. python scripts/engines.py motion > docs/results/mujoco/motion.json
PYTHONPATH=. python scripts/engines.py speed > docs/results/mujoco/speed.json
PYTHONPATH=. python scripts/engines.py success NAME=BULLET_SCORES,MUJOCO_SCORES ... > docs/results/mujoco/success.json
PYTHONPATH=. python scripts/engines.py table docs/results/mujoco/success.json
"""

import json
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.config import ENGINES, LidarConfig, TaskConfig, with_engine
from zebrat_bullet.robot import load_robot
from zebrat_bullet.sim.base import CarSimulation
from zebrat_bullet.sim.engine import make_simulation
from zebrat_bullet.task.drive import Drive
from zebrat_bullet.types import Command, Pose2
from zebrat_bullet.world import load_world

SECONDS, DRIVES = 5, 40


def motion() -> dict[str, object]:
    """Return how far apart the engines' cars are after each second of random commands that change once a second."""
    result = {}
    for name in ("zebrat", "hexagon", "long"):
        robot = load_robot(name)
        bullet, mujoco = (
            _poses(make_simulation(robot, with_engine(TaskConfig(robot=name), engine).physics)) for engine in ENGINES
        )
        apart_m = np.hypot(*(bullet - mujoco)[..., :2].transpose(2, 0, 1))[:, 4::5]
        turned_rad = np.abs(bullet - mujoco)[:, 4::5, 2]
        result[name] = {
            "after_s": list(range(1, SECONDS + 1)),
            **_spread("apart_m", apart_m),
            **_spread("turned_rad", turned_rad),
        }
    return result


def _poses(simulation: CarSimulation) -> NDArray[np.float64]:
    """Return (DRIVES, 5 * SECONDS, 3) poses after each control step."""
    rng = np.random.default_rng(0)
    poses = []
    for _ in range(DRIVES):
        simulation.reset(Pose2(0.0, 0.0, 0.0))
        for speed, steering in rng.uniform(-0.6, 0.6, (SECONDS, 2)).tolist():
            poses += [simulation.step(Command(speed, steering)).pose for _ in range(5)]
    simulation.close()
    return np.array(poses).reshape(DRIVES, 5 * SECONDS, 3)


def _spread(name: str, values: NDArray[np.float64]) -> dict[str, list[float]]:
    return {f"{name}_{q}": np.quantile(values, q / 100, axis=0).round(4).tolist() for q in (50, 95)}


def speed() -> dict[str, object]:
    """Return control steps a second of processor time on one core, the whole task, in `track_4`."""
    result, world = {}, load_world("track_4")
    for engine in ENGINES:
        for caster in (engine, "embree"):
            task = replace(with_engine(TaskConfig(), engine), lidar=LidarConfig(caster=caster))
            drive = Drive(task, world)
            rates = []
            for k in range(6):
                drive.reset(np.random.default_rng(k), whole_scans=True)
                began = time.process_time()
                for _ in range(15):
                    drive.step(Command(0.4, 0.1))
                rates.append(15 / (time.process_time() - began))
            drive.close()
            result[f"{engine}, {caster}"] = round(float(np.median(rates)))
    return result


def success(pairs: list[str]) -> dict[str, object]:
    """Return successes, episodes and causes of the rest by agent, world and engine, of two `scores.json` an agent."""
    result: dict[str, object] = {}
    for pair in pairs:
        name, _, files = pair.partition("=")
        scores = [json.loads(Path(file).read_text(encoding="utf-8")) for file in files.split(",")]
        result[name] = {
            world: {
                engine: {"episodes": at[world]["episodes"], "time_s": at[world]["time_s"], **at[world]["causes"]}
                for engine, at in zip(ENGINES, scores, strict=True)
            }
            for world in scores[0]
        }
    return result


def table(file: str) -> str:
    """Return success and mean time in s, PyBullet's and MuJoCo's, a row a world and a column an agent."""
    agents = json.loads(Path(file).read_text(encoding="utf-8"))
    worlds = list(next(iter(agents.values())))
    rows = [f"| world | {' | '.join(agents)} |", "|---" * (len(agents) + 1) + "|"]
    rows += [f"| {world} | {' | '.join(_cell(agents[name][world]) for name in agents)} |" for world in worlds]
    every = [[_rate([at[world][engine] for world in worlds]) for engine in ENGINES] for at in agents.values()]
    return "\n".join([*rows, f"| all | {' | '.join(' / '.join(rates) for rates in every)} |"])


def _cell(at: dict[str, dict[str, float]]) -> str:
    times = ["-" if each["time_s"] is None else f"{each['time_s']:.1f}" for each in at.values()]
    return f"{' / '.join(_rate([each]) for each in at.values())}, {' / '.join(times)}"


def _rate(ends: list[dict[str, float]]) -> str:
    return f"{sum(end.get('success', 0) for end in ends):.0f} of {sum(end['episodes'] for end in ends):.0f}"


if __name__ == "__main__":
    what, *rest = sys.argv[1:]
    made = {"motion": lambda: motion(), "speed": lambda: speed(), "success": lambda: success(rest)}
    print(table(rest[0]) if what == "table" else json.dumps(made[what]()))
