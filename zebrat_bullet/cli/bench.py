"""The command that measures speed: bench."""

import argparse
import json
from dataclasses import replace

from zebrat_bullet.cli.common import AddCommand, Result
from zebrat_bullet.config import TaskConfig
from zebrat_bullet.errors import ConfigError


def bench(arguments: argparse.Namespace) -> Result:
    """Time the environment step and its parts, for both ray casters; or planar cars, an agent, an export, learning."""
    from zebrat_bullet.bench import bench_agent, bench_text, run_bench

    show, robot = bench_text, arguments.robot
    if (arguments.planar or arguments.learning == "planar") and robot != TaskConfig().robot:
        raise ConfigError(f"planar cars are timed with {TaskConfig().robot}, got --robot {robot}; leave it out")
    if arguments.learning == "planar":
        from zebrat_bullet.bench.learning import bench_planar_learning

        result = bench_planar_learning(arguments.cars, arguments.device, arguments.rounds, arguments.seed)
    elif arguments.planar:
        from zebrat_bullet.bench.planar import bench_planar, planar_text

        show = planar_text
        result = bench_planar(arguments.steps, arguments.cars, arguments.device, arguments.rounds, arguments.seed)
    elif arguments.learning:
        from zebrat_bullet.bench.learning import bench_learning
        from zebrat_bullet.training.presets import TRAIN_PRESETS, with_task

        config = replace(TRAIN_PRESETS[arguments.learning], worlds=(arguments.world,), seed=arguments.seed)
        config = with_task(config, robot, None)
        result = bench_learning(config, arguments.steps, arguments.rounds)
    elif arguments.deploy:
        from zebrat_bullet.bench.deploy import bench_deploy

        policy = arguments.agent or "shipped"
        result = {policy: bench_deploy(policy, arguments.world, arguments.steps, arguments.seed)}
    elif arguments.agent:
        result = {arguments.agent: bench_agent(arguments.agent, arguments.world, arguments.seed, robot)}
    else:
        result = run_bench(
            *(arguments.world, arguments.steps, arguments.seed, arguments.rate_hz, arguments.bearings), robot=robot
        )
    if arguments.out:
        arguments.out.parent.mkdir(parents=True, exist_ok=True)
        arguments.out.write_text(json.dumps(result, indent=2), encoding="utf-8")
    return result, show(result)


def add(command: AddCommand) -> None:
    """Add the command of this file."""
    made = command(bench)
    made.add_argument("--world", default="big_track")
    made.add_argument("--agent", help="time this agent instead, in one episode")
    made.add_argument(
        "--learning", metavar="WHAT", choices=("paper", "planar"),
        help="time learning instead: the paper's DDPG beside Stable-Baselines3's own, or PPO on planar cars",
    )  # fmt: skip
    made.add_argument("--planar", action="store_true", help="time planar cars instead, beside one car of PyBullet")
    made.add_argument(
        "--deploy", action="store_true", help="time --agent (default shipped) as it is exported, on one core"
    )
    made.add_argument("--cars", type=int, default=1024, help="planar cars (default 1024)")
    made.add_argument("--device", default="cpu", help="of the planar cars: cpu (default) or cuda")
    made.add_argument("--steps", type=int, default=1000)
    made.add_argument("--rounds", type=int, default=5, help="of --learning and --planar (default 5)")
    made.add_argument("--rate-hz", type=float, default=None, help="physics rate (default: the task's)")
    made.add_argument(
        "--bearings",
        choices=("all", "region"),
        default="all",
        help="what a step casts: all, or what the region watches",
    )
