"""The command that speaks ROS 2: ros."""

import argparse
from dataclasses import replace
from typing import Any

from zebrat_bullet.cli.common import AddCommand, Result, given
from zebrat_bullet.cli.options import whole_number
from zebrat_bullet.config import TaskConfig
from zebrat_bullet.errors import ConfigError

LOCKSTEP_S = 5.0
_OF_DRIVE = ("policy",)
_OF_SIM = ("world", "episode", "caster", "noise", "rate", "lockstep", "wait", "seed", "robot", "joints", "footprint")


def ros(arguments: argparse.Namespace) -> Result:
    """Drive a car over ROS 2 (drive), or be one: our PyBullet car as a robot that obeys commands (sim)."""
    is_drive = arguments.node == "drive"
    of_other, other = (_OF_SIM, "sim") if is_drive else (_OF_DRIVE, "drive")
    if others := given(arguments, of_other):
        raise ConfigError(
            f"{', '.join(others)} is for `zebrat ros {other}`: `zebrat ros {arguments.node}` knows no such"
        )
    return _drive(arguments) if is_drive else _sim(arguments)


def _drive(arguments: argparse.Namespace) -> Result:
    from zebrat_bullet.ros.drive import drive

    made = drive(arguments.policy, arguments.ros_args)
    return made, (
        f"{made['policy']}: {made['commands']} commands from {made['scans']} scans, {made['refused']} of them stops; "
        f"work {_shown_ms(made['work_ms'])}; age of the scans when answered {_shown_ms(made['scan_age_ms'])}"
    )


def _sim(arguments: argparse.Namespace) -> Result:
    from zebrat_bullet.ros.sim import simulate

    task = TaskConfig(robot=arguments.robot or TaskConfig().robot)
    task = replace(
        task,
        lidar=replace(task.lidar, caster=arguments.caster),
        noise=replace(task.noise, range_sigma_m=arguments.noise),
    )
    made = simulate(
        arguments.world,
        task,
        arguments.ros_args,
        seed=arguments.seed,
        episode=arguments.episode,
        rate=arguments.rate,
        lockstep_s=arguments.lockstep,
        wait_s=arguments.wait,
    )
    return made, (
        f"{made['world']}: {made['outcome']} after {made['time_s']:.1f} s; of {made['steps']} scans "
        f"{made['unanswered']} were not answered within their step, {made['braked']} steps braked for want of a fresh "
        f"command; from scan to command {_shown_ms(made['latency_ms'])}"
    )


def _shown_ms(times: dict[str, Any]) -> str:
    return ", ".join(f"{name} {value:g} ms" for name, value in times.items()) or "not measured"


def add(command: AddCommand) -> None:
    """Add the command of this file."""
    made = command(ros)
    made.set_defaults(robot=None)  # what drives needs no URDF
    made.add_argument("node", choices=("drive", "sim"), help="which node to run")
    made.add_argument(
        "--ros-args",
        nargs=argparse.REMAINDER,
        default=[],
        metavar="ARG",
        help="the last option: what ROS takes: -p NAME:=VALUE, --params-file FILE, -r OLD:=NEW (docs/ros.md)",
    )
    drive = made.add_argument_group("drive")
    drive.add_argument("--policy", default="", help="folder of zebrat export, or a shipped policy")
    sim = made.add_argument_group("sim")
    sim.add_argument("--world", default="track_2", help="world to drive in (default track_2)")
    sim.add_argument("--episode", type=whole_number, default=0, help="number of the episode, of --seed (default 0)")
    sim.add_argument("--caster", choices=("bullet", "embree"), default="bullet", help="ray caster of the lidar")
    sim.add_argument("--noise", type=float, default=0.0, help="lidar range noise, sigma in m")
    sim.add_argument(
        "--rate",
        type=float,
        default=1.0,
        help="simulated seconds in a second (default 1: real time); at any other the driver needs use_sim_time",
    )
    sim.add_argument(
        "--lockstep",
        type=float,
        nargs="?",
        const=LOCKSTEP_S,
        metavar="S",
        help=f"wait for the command that answers each scan, for S seconds at most ({LOCKSTEP_S:g}); the driver needs "
        "use_sim_time",
    )
    sim.add_argument("--wait", type=float, default=60.0, metavar="S", help="for the first command (default 60)")
