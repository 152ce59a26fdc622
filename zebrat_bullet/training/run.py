"""One training run, from its settings to its folder: config, versions, episode log, best and last policy."""

import json
import platform
import subprocess
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import torch
from stable_baselines3.common.logger import configure
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

from zebrat_bullet.config import TaskConfig
from zebrat_bullet.config_text import read_config, to_json
from zebrat_bullet.envs.planar_env import PlanarVectorEnv
from zebrat_bullet.envs.zebrat_env import ZebratEnv
from zebrat_bullet.errors import ConfigError, ZebratError
from zebrat_bullet.files import is_file, refusing
from zebrat_bullet.outputs import written_whole
from zebrat_bullet.planar.drive import PlanarDrive
from zebrat_bullet.planar.simulation import find_device
from zebrat_bullet.processes import usable_cores
from zebrat_bullet.robot import load_robot
from zebrat_bullet.task.trail import PARTS
from zebrat_bullet.training.callbacks import Progress, RunCallback
from zebrat_bullet.training.checkpoint import load_checkpoint
from zebrat_bullet.training.learner_settings import PPOConfig
from zebrat_bullet.training.learners import DISCRETE, OFF_POLICY, WITHOUT_END, build_learner
from zebrat_bullet.training.places import (
    car_and_worlds,
    changed_since,
    from_any_folder,
    judging_worlds,
    training_worlds,
)
from zebrat_bullet.training.planar_callback import PlanarCallback
from zebrat_bullet.training.planar_vec_env import PlanarVecEnv
from zebrat_bullet.training.run_folder import POLICY_FILES, SUMMARY, has_checkpoint, is_finished, summarise
from zebrat_bullet.training.settings import VALIDATION_SEED, TrainConfig, require_init
from zebrat_bullet.training.tensors import begin_with
from zebrat_bullet.training.vec_env import OverlappedVecEnv, learn_meanwhile, make_vec_env
from zebrat_bullet.world import generate_tracks

VERSIONED = ("zebrat-bullet", "pybullet", "open3d", "numpy", "torch", "stable-baselines3", "gymnasium", "warp-lang")


def train(config: TrainConfig, folder: Path, on_progress: Callable[[Progress], None] = lambda progress: None) -> None:
    """Train from the beginning.

    Args:
        config: the run.
        folder: where its results go; must not hold another run.
        on_progress: told after every episode.

    Raises:
        ConfigError: the folder holds a run already, or there is no such world or model to begin with.
    """
    if has_checkpoint(folder) or is_finished(folder):
        raise ConfigError(f"{folder} holds a run already; continue it with --resume or name another folder")
    if any((folder / name).exists() for name in POLICY_FILES):
        raise ConfigError(
            f"{folder} holds the policy of a run that ended before its first checkpoint, so it cannot be resumed; name "
            "another folder, or delete this one"
        )
    require_init(config)
    config = from_any_folder(config)
    begun_with = car_and_worlds(config)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "config.json").write_text(to_json(config), encoding="utf-8")
    (folder / "versions.json").write_text(json.dumps(run_versions() | begun_with, indent=2), encoding="utf-8")
    _run_where(config)(config, folder, on_progress, resume=False)
    _finish(folder)


def resume(folder: Path, on_progress: Callable[[Progress], None] = lambda progress: None) -> None:
    """Continue a killed run from its last checkpoint; its settings are read from its folder. A finished one is kept.

    Raises:
        ConfigError: the folder holds no run, or its car or a world is no longer what it was.
        ZebratError: it was killed before its first checkpoint.
    """
    require_run(folder)
    if is_finished(folder):
        return
    config = read_config(TrainConfig, folder / "config.json")
    _require_unchanged(config, folder)
    _run_where(config)(config, folder, on_progress, resume=True)
    _finish(folder)


def require_run(folder: Path) -> None:
    """Raise unless the folder holds a run.

    Raises:
        ConfigError: it does not.
    """
    if not (folder / "config.json").is_file():
        raise ConfigError(f"{folder} holds no training run (no config.json); name the folder given to `zebrat train`")


def _require_unchanged(config: TrainConfig, folder: Path) -> None:
    if changed := changed_since(folder, config.task.robot, car_and_worlds(config)):
        best = folder / "best.zip"
        learned = f" with what this one has learned: --set init={best}" if is_file(best) else ""
        raise ConfigError(
            f"{folder} cannot be resumed: {', '.join(changed)} changed since it began; put it back as it was, or begin "
            f"a new run{learned}"
        )


def _finish(folder: Path) -> None:
    """Write the summary, whose presence says that the run is over."""
    with written_whole(folder / SUMMARY) as part:
        part.write_text(json.dumps(summarise(folder), indent=2), encoding="utf-8")


def _run_where(config: TrainConfig) -> Callable[..., None]:
    """Return what runs a training: on PyBullet's car, or on planar ones."""
    return _run_in_bullet if config.planar is None else _run_on_plane


def _run_in_bullet(config: TrainConfig, folder: Path, on_progress: Callable[[Progress], None], resume: bool) -> None:
    torch.set_num_threads(config.threads)
    algo = config.learner.algo
    train_worlds = training_worlds(config.worlds, config.task)
    eval_worlds = judging_worlds(config.eval_worlds, config.task) or train_worlds[:1]
    vec_env = make_vec_env(
        config.n_envs, config.overlap, world=train_worlds, task=config.task, discrete=algo in DISCRETE
    )
    judge = ZebratEnv(eval_worlds, task=_from_the_start(config.task))
    observation = judge.spec_observation
    try:
        model, state = build_learner(config, vec_env), dict[str, Any]()
        if resume:
            state, _ = load_checkpoint(folder / "checkpoint", model)
            with refusing(folder, ZebratError, "cannot be resumed", "begin the run anew in another folder"):
                for i, place in enumerate(state["places"]):
                    vec_env.env_method("go_to", place, indices=i)
        elif config.init:
            begin_with(model, Path(config.init), _n_new(config))
        model.set_logger(configure(str(folder / "tensorboard"), ["tensorboard"]))
        if isinstance(model, OffPolicyAlgorithm):
            learn_meanwhile(model, vec_env)
        provenance = {"config": json.loads(to_json(config))} | run_versions()
        callback = RunCallback(config, folder, judge.drive, eval_worlds, observation, provenance, on_progress, state)
        model.learn(WITHOUT_END, callback, log_interval=1, reset_num_timesteps=not resume)
    finally:
        vec_env.close()
        judge.close()


def _run_on_plane(config: TrainConfig, folder: Path, on_progress: Callable[[Progress], None], resume: bool) -> None:
    assert config.planar is not None
    torch.set_num_threads(config.threads)
    planar, algo, workers = config.planar, config.learner.algo, usable_cores()
    if algo in DISCRETE:
        raise ConfigError(f"planar cars take continuous actions, {algo} has none; choose ppo, ddpg or sac")
    find_device(planar.device)  # before minutes go into tracks
    robot = load_robot(config.task.robot)
    generate = partial(generate_tracks, family=planar.families, robot=robot, workers=workers)
    worlds = [
        *training_worlds(config.worlds, config.task),
        *generate(range(planar.n_tracks), difficulty=planar.difficulty),
    ]
    own = config.eval_worlds or (() if planar.n_eval_tracks else config.worlds)
    eval_worlds = [
        *judging_worlds(own, config.task),
        *generate(range(VALIDATION_SEED, VALIDATION_SEED + planar.n_eval_tracks)),
    ]
    cars = PlanarVecEnv(
        PlanarVectorEnv(planar.n_cars, worlds, task=config.task, device=planar.device, margin_m=planar.margin_m)
    )
    cars.seed(config.seed)
    n_judged = len(eval_worlds) * planar.n_eval_starts
    judge = PlanarDrive(_from_the_start(config.task), eval_worlds, n_judged, device=planar.device)
    # PPO learns between its rollouts, the others while they drive.
    driven = OverlappedVecEnv(cars) if algo in OFF_POLICY else cars
    model, state = build_learner(config, driven), dict[str, Any]()
    if resume:
        state, arrays = load_checkpoint(folder / "checkpoint", model)
        with refusing(folder, ZebratError, "cannot be resumed", "begin the run anew in another folder"):
            cars.load(state["cars"], arrays)
    elif config.init:
        begin_with(model, Path(config.init), _n_new(config))
    model.set_logger(configure(str(folder / "tensorboard"), ["tensorboard"]))
    provenance = {"config": json.loads(to_json(config))} | run_versions()
    if isinstance(model, OffPolicyAlgorithm):
        assert isinstance(driven, OverlappedVecEnv)
        learn_meanwhile(model, driven, planar.gradient_steps)
    callback = PlanarCallback(config, planar, folder, cars, judge, provenance, on_progress, state)
    model.learn(WITHOUT_END, callback, log_interval=1, reset_num_timesteps=not resume)


def _n_new(config: TrainConfig) -> int:
    """Return how many numbers of the observation the networks to begin with may not have known: the trail's.

    It comes last in what PPO's networks see; the critics of the others see an action behind it.
    """
    return PARTS * len(config.task.observation.trail_steps) if isinstance(config.learner, PPOConfig) else 0


def _from_the_start(task: TaskConfig) -> TaskConfig:
    return replace(task, episode=replace(task.episode, start="start"))


def run_versions() -> dict[str, object]:
    """Return the versions of what a run's result depends on, and the git hash of the checkout."""
    here = Path(__file__).parent
    git = subprocess.run(["git", "-C", here, "rev-parse", "HEAD"], capture_output=True, text=True, check=False)
    return {
        "versions": {name: version(name) for name in VERSIONED},
        "python": platform.python_version(),
        "git": git.stdout.strip() or None,
    }
