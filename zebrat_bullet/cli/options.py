"""The options that commands share, each as a parser to be a parent of others."""

import argparse

from zebrat_bullet.config import CASTERS, ENGINES, FOOTPRINTS, REWARD_PRESETS
from zebrat_bullet.deploy.supervisor import MARGIN_M
from zebrat_bullet.files import shown

_DIGITS = 18
"""Of a whole number; more would not fit into the 64 bits that a record has for it."""


def whole_number(text: str) -> int:
    """Return what an option says that takes a whole number from 0 up: a seed, the number of an episode, a count.

    Raises:
        ArgumentTypeError: it says something else.
    """
    if not (text.isascii() and text.isdecimal()) or len(text) > _DIGITS:
        raise argparse.ArgumentTypeError(
            f"takes a whole number from 0 up, of at most {_DIGITS} digits, got {shown(text)!r}"
        )
    return int(text)


def robot_options() -> argparse.ArgumentParser:
    """Return the options of the car."""
    made = argparse.ArgumentParser(add_help=False)
    made.add_argument(
        "--robot",
        default="zebrat",
        help="URDF or xacro file, or name of a shipped car (default zebrat, or what the agent was trained on)",
    )
    made.add_argument(
        "--joints",
        nargs="+",
        action="extend",
        default=[],
        metavar="ROLE=NAME",
        help="which joint of the URDF is what, e.g. left_rear_wheel_joint=rl_wheel lidar_mount=laser; also numbers "
        "that it lacks: steering_limit_rad=0.5 (docs/your_own_car.md; or CAR.roles.yaml beside it)",
    )
    made.add_argument(
        "--footprint",
        choices=FOOTPRINTS,
        help="outline of the body: of its collision shapes, the hull of all shapes, or whichever covers it (auto)",
    )
    return made


def task_options() -> argparse.ArgumentParser:
    """Return the options of the senses."""
    made = argparse.ArgumentParser(add_help=False)
    made.add_argument(
        "--caster",
        choices=CASTERS,
        help="ray caster of the lidar: embree, or that of the engine, bullet or mujoco (default)",
    )
    made.add_argument("--noise", type=float, default=0.0, help="lidar range noise, sigma in m")
    return made


def reward_options() -> argparse.ArgumentParser:
    """Return the option of the reward."""
    made = argparse.ArgumentParser(add_help=False)
    made.add_argument("--reward", choices=tuple(REWARD_PRESETS), default="fomt", help="reward preset")
    return made


def agents_option(planar_only: bool = False) -> argparse.ArgumentParser:
    """Return the option of one agent or several.

    Args:
        planar_only: nothing else drives but planar cars, which only policies can drive.
    """
    made = argparse.ArgumentParser(add_help=False)
    every = "shipped, il, dagger, dwa, dwa_tuned, teb:inflation_radius_m=0.5, oracle, a policy file, a run folder, "
    made.add_argument(
        "--agent",
        required=True,
        nargs="+",
        help="policies: shipped, allround, il, dagger, a policy file, a run folder"
        if planar_only
        else every + "my_driver.py:NAME",
    )
    return made


def sim_option(
    help: str = "what drives: planar cars (default, policies alone), PyBullet, or the second engine, MuJoCo",
) -> argparse.ArgumentParser:
    """Return the option of the simulator where planar cars may drive too."""
    made = argparse.ArgumentParser(add_help=False)
    made.add_argument("--sim", choices=("planar", *ENGINES), help=help)
    return made


def engine_option() -> argparse.ArgumentParser:
    """Return the option of the engine where planar cars do not drive."""
    made = argparse.ArgumentParser(add_help=False)
    made.add_argument("--sim", choices=ENGINES, default="bullet", help="engine: PyBullet (default) or MuJoCo")
    return made


def workers_option() -> argparse.ArgumentParser:
    """Return the option of how many processes share the work."""
    made = argparse.ArgumentParser(add_help=False)
    made.add_argument("--workers", type=int, help="processes (default: one a core)")
    return made


def noisy_options() -> argparse.ArgumentParser:
    """Return the option of noise on the commands."""
    made = argparse.ArgumentParser(add_help=False)
    made.add_argument("--action-noise", type=float, default=0.0, help="sigma on the commands, fraction of the limits")
    return made


def supervised_option() -> argparse.ArgumentParser:
    """Return the option of a supervisor between agent and car."""
    made = argparse.ArgumentParser(add_help=False)
    made.add_argument(
        "--supervised",
        nargs="?",
        type=float,
        const=MARGIN_M,
        metavar="MARGIN_M",
        help="commands go through the supervisor of the real car, which stops it before anything is nearer than this "
        f"(default {MARGIN_M:g} m)",
    )
    return made


def randomise_option() -> argparse.ArgumentParser:
    """Return the option of cars and sensors that differ from what is written of them."""
    made = argparse.ArgumentParser(add_help=False)
    made.add_argument(
        "--randomise",
        action="store_true",
        help="dynamics drawn for each episode (RANDOM_DYNAMICS) and the noise of a VLP-16",
    )
    return made


def place_options() -> argparse.ArgumentParser:
    """Return the options of where the car begins and ends in one world."""
    made = argparse.ArgumentParser(add_help=False)
    made.add_argument(
        "--start", nargs=3, type=float, metavar=("X", "Y", "YAW"), help="begin there: m, m and degrees, 90 along y"
    )
    made.add_argument("--goal", nargs=2, type=float, metavar=("X", "Y"), help="what is to be reached, in m")
    made.add_argument(
        "--exit",
        nargs=4,
        type=float,
        metavar=("X1", "Y1", "X2", "Y2"),
        help="both ends of the line over which a mesh or map is left, in m",
    )
    return made
