"""Spoils files of every kind and reads them: each must be taken, or refused by an error of ours that names it, soon.

The suite runs a few of each door (test_fuzz.py); by hand, for hours or until something slips through:

    python tests/fuzz.py --n 100000 [--door world] [--first 0]
"""

import argparse
import hashlib
import json
import random
import shutil
import signal
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import bags
import mutations as m
import numpy as np
import trimesh
import yaml
from PIL import Image
from rosbags.typesys import Stores

from zebrat_bullet.agents import load_agent
from zebrat_bullet.assets import asset_folder
from zebrat_bullet.config import EpisodeConfig, LidarConfig, TaskConfig
from zebrat_bullet.config_text import read_config, with_settings_of
from zebrat_bullet.deploy import Driver
from zebrat_bullet.deploy.network import Network
from zebrat_bullet.errors import ZebratError
from zebrat_bullet.evaluation.records import load_record
from zebrat_bullet.evaluation.rollout import drive_episodes
from zebrat_bullet.evaluation.track_set import SetTrack, TrackSet, read_set, save_set
from zebrat_bullet.imitation.demonstrations import encode_pairs, load_demonstrations, observation_of
from zebrat_bullet.planning.certificate import load_certificate
from zebrat_bullet.recording.bag import Bag
from zebrat_bullet.recording.open_loop import run_open_loop
from zebrat_bullet.recording.topics import choose_topics
from zebrat_bullet.report.curves import draw_learning_curve
from zebrat_bullet.report.learning_runs import read_groups
from zebrat_bullet.robot import load_robot
from zebrat_bullet.training.learner_settings import DDPGConfig
from zebrat_bullet.training.run_folder import read_summary, summarise
from zebrat_bullet.training.settings import TrainConfig
from zebrat_bullet.training.sweep import read_manifest
from zebrat_bullet.training.sweep_run import status
from zebrat_bullet.types import Clearance, Command, FlatScan, Reading, Waypoint
from zebrat_bullet.world import load_world

SECONDS = 10
"""What reading one file may take."""
TINY = TrainConfig(
    learner=DDPGConfig(hidden=(8, 8), batch_size=4, buffer_size=100, warmup_steps=5),
    worlds=("track_2",),
    episodes=2,
    eval_every=2,
    eval_episodes=1,
    checkpoint_every=1,
    task=TaskConfig(lidar=LidarConfig(caster="embree", n_channels=2), episode=EpisodeConfig(max_steps=8)),
)


@dataclass(frozen=True)
class Door:
    """One way in.

    Attributes:
        make: writes a good file, and what belongs to it, into an empty folder.
        name: the file in there that is spoiled.
        mutations: of which one is taken.
        read: reads it, given its path, as the package's commands do.
    """

    make: Callable[[Path], None]
    name: str
    mutations: Sequence[m.Mutate]
    read: Callable[[Path], object]


class TooSlowError(Exception):
    """Reading took too long."""


def attack(door: Door, good: Path, seed: int | None) -> str:
    """Spoil a copy of a good folder's file, unless the seed is None, and read it; return "taken" or "refused".

    Raises:
        AssertionError: an error names no file, or is none of ours.
        TooSlowError: it took longer than `SECONDS`.
    """
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) / "in"
        shutil.copytree(good, folder)
        path = folder / door.name
        if seed is not None:
            chance = random.Random(seed)
            path.write_bytes(chance.choice(door.mutations)(path.read_bytes(), chance))
        signal.signal(signal.SIGALRM, _too_slow)
        signal.alarm(SECONDS)
        try:
            door.read(path)
            return "taken"
        except ZebratError as error:
            assert seed is not None, f"a good file is refused: {error}"
            assert str(folder) in str(error) or path.stem in str(error), f"names no file: {error}"
            return "refused"
        finally:
            signal.alarm(0)


def _too_slow(signum: int, frame: object) -> None:
    raise TooSlowError


def long_run(names: Sequence[str], first: int, n: int) -> int:
    """Attack doors in turn and print whatever slips through; return how many did."""
    bad, counts = 0, Counter[str]()
    with tempfile.TemporaryDirectory() as temporary:
        good = {name: Path(temporary) / name for name in names}
        for name, folder in good.items():
            folder.mkdir()
            DOORS[name].make(folder)
        for seed in range(first, first + n):
            for name, folder in good.items():
                began = time.monotonic()
                try:
                    counts[f"{name} {attack(DOORS[name], folder, seed)}"] += 1
                except Exception:
                    bad += 1
                    print(f"--door {name} --first {seed} --n 1\n{traceback.format_exc(limit=-4)}", flush=True)
                if (took := time.monotonic() - began) > SECONDS / 2:
                    print(f"--door {name} --first {seed} --n 1 took {took:.1f} s", flush=True)
    print(json.dumps(counts, indent=1), file=sys.stderr)
    return bad


def _copy(source: Path, folder: Path) -> None:
    shutil.copyfile(source, folder / source.name)


def _write(name: str, text: str, folder: Path) -> None:
    (folder / name).write_text(text, encoding="utf-8")


def _free_space(folder: Path) -> None:
    ring = [[0, 0], [9, 0], [9, 1.4], [0, 1.4]]
    world = {"name": "mine", "free_space": [ring], "centre_line": [[0.5, 0.7], [10.0, 0.7]]}
    world |= {"open_line": [[9.0, 1.4], [9.0, 0.0]], "start": {"pose": [1.5, 0.7, 0.0]}}
    world |= {"obstacles": [{"post": [5.0, 0.2], "radius": 0.05}], "max_steps": 200}
    _write("world.yaml", yaml.safe_dump(world), folder)


def _map(folder: Path) -> None:
    cells = np.full((80, 160), 254, dtype=np.uint8)
    cells[[0, -1]] = cells[:, [0, -1]] = 0
    Image.fromarray(cells).save(folder / "map.pgm")
    fields = {"image": "map.pgm", "resolution": 0.05, "origin": [-1.0, -2.0, 0.0], "negate": 0}
    _write("map.yaml", yaml.safe_dump(fields | {"occupied_thresh": 0.65, "free_thresh": 0.196}), folder)


def _mesh(suffix: str, folder: Path) -> None:
    room = trimesh.util.concatenate(
        [trimesh.creation.box((4, 0.2, 1), trimesh.transformations.translation_matrix((0, y, 0.5))) for y in (-2, 2)]
    )
    room.export(folder / f"mesh{suffix}")


def _car(folder: Path) -> None:
    shutil.copytree(asset_folder("urdf"), folder, dirs_exist_ok=True)


def _policy(folder: Path) -> None:
    _copy(asset_folder("policies") / "shipped.safetensors", folder)


def _exported(folder: Path) -> None:
    from zebrat_bullet.agents.export import export_policy

    export_policy("shipped", folder)


def _drive_by(path: Path) -> None:
    Driver.load(path.parent).drive_scan(np.ones(360, np.float32))


def _network(path: Path) -> None:
    """Load a network as if its hash were right."""
    Network(path, 66, hashlib.sha256(path.read_bytes()).hexdigest())


def _record(folder: Path) -> None:
    from zebrat_bullet.evaluation.records import save_record

    (record,) = drive_episodes("shipped", TINY.task, load_world("track_2"), 0, [0])
    save_record(replace(record, outcome="success"), folder / "record.npz")


def _bag(storage: str, folder: Path) -> None:
    ros1 = storage == "ros1"
    messages = bags.Messages(Stores.ROS1_NOETIC) if ros1 else bags.Messages()
    angles = np.linspace(0.1, 6.2, 200)
    around = np.stack([2.0 * np.cos(angles), 2.0 * np.sin(angles), np.zeros(200)], axis=1)
    sent = [
        each
        for i in range(3)
        for each in (
            ("/points", bags.CLOUD, 0.2 * i, messages.cloud(around)),
            ("/cmd_vel", bags.TWIST_STAMPED, 0.2 * i + 0.05, messages.twist_stamped(0.3, 0.1)),
        )
    ]
    made = bags.write_bag(folder / ("drive.bag" if ros1 else "drive"), messages, sent, storage)
    if not ros1:
        (file,) = (each for each in made.iterdir() if each.suffix != ".yaml")
        file.rename(folder / file.name)
        shutil.rmtree(made)


def _ask(path: Path) -> object:
    task = TaskConfig()
    with Bag(path) as bag:
        return run_open_loop(bag, choose_topics(bag), load_agent("il", task), task)


def _labelled(folder: Path) -> None:
    _record(folder)
    np.save(folder / "record.labels.npy", load_record(folder / "record.npz").command)


def _run(folder: Path) -> None:
    from zebrat_bullet.training.run import train

    train(TINY, folder / "run")


def _zip(folder: Path) -> None:
    _run(folder)
    shutil.copy(folder / "run" / "best.zip", folder / "init.zip")


def _archive(folder: Path) -> None:
    _run(folder)
    shutil.make_archive(str(folder / "runs"), "zip", folder / "run")


def _policy_of(path: Path) -> None:
    agent = load_agent(str(path), TINY.task)
    n = agent.observation.n_rays
    clearance = Clearance(np.ones(n, np.float32), np.zeros(n, np.float32), False)
    waypoint = Waypoint(1.0, 0.0)
    agent.act(
        Reading(FlatScan(np.ones(360, np.float32), 6.0), clearance, Command(0.0, 0.0), 0.0, 0.0, waypoint=waypoint)
    )


def _set(folder: Path) -> None:
    track = SetTrack(
        family="corners",
        seed=900_000,
        difficulty=0.5,
        reversals=0,
        clearance_m=0.1,
        length_m=9.0,
        least_time_s=15.0,
        fingerprint="",
    )
    save_set(TrackSet(name="mine", robot="zebrat", sha256="0" * 64, tracks=(track, track)), folder)


def _imitate(path: Path) -> None:
    demonstrations = load_demonstrations(path.parent)
    encode_pairs(demonstrations, observation_of(demonstrations[0]))


def _run_config(path: Path) -> None:
    for world in read_config(TrainConfig, path).worlds:
        assert isinstance(world, str)


def _resume(path: Path) -> None:
    from zebrat_bullet.training.run import resume

    run = path if path.is_dir() else next(parent for parent in path.parents if parent.name == "run")
    (run / "summary.json").unlink()
    resume(run)


def _look_at_run(path: Path) -> None:
    status(path.parent)
    summarise(path.parent)
    read_summary(path.parent)
    draw_learning_curve(path.parent, path.parent / "curve.png")
    read_groups([path.parent])


def _init(path: Path) -> None:
    from zebrat_bullet.training.run import train

    train(replace(TINY, init=str(path), episodes=1), path.parent / "fine")


_TEXT = [m.some_bytes, m.some_text]
_YAML = [*_TEXT, m.yaml_values, m.yaml_values, m.yaml_values, m.yaml_values]
_JSON = [m.some_bytes, m.json_values, m.json_values, m.json_values]
_NPZ = [m.some_bytes, m.npz_values, m.npz_values, m.npz_values]
_TENSORS = [m.some_bytes, m.safetensors_values, m.safetensors_values, m.safetensors_weights, m.safetensors_weights]

DOORS = {
    "track": Door(partial(_copy, asset_folder("worlds") / "track_2.yaml"), "track_2.yaml", _YAML, load_world),
    "world": Door(_free_space, "world.yaml", _YAML, load_world),
    "map": Door(_map, "map.yaml", _YAML, load_world),
    "image": Door(_map, "map.pgm", [m.some_bytes, m.pgm_header], lambda path: load_world(path.with_suffix(".yaml"))),
    "obj": Door(partial(_mesh, ".obj"), "mesh.obj", _TEXT, load_world),
    "stl": Door(partial(_mesh, ".stl"), "mesh.stl", [m.some_bytes], load_world),
    "ply": Door(partial(_mesh, ".ply"), "mesh.ply", [m.some_bytes], load_world),
    "glb": Door(partial(_mesh, ".glb"), "mesh.glb", [m.some_bytes, m.glb_values, m.glb_values], load_world),
    "urdf": Door(
        _car,
        "zebrat.urdf",
        [*_TEXT, m.xml_values, m.xml_values, m.xml_values, m.xml_values],
        load_robot,
    ),
    "policy": Door(_policy, "shipped.safetensors", _TENSORS, _policy_of),
    "definition": Door(_exported, "policy.json", _JSON, _drive_by),
    "network": Door(_exported, "policy.onnx", [m.some_bytes], _network),
    "record": Door(_record, "record.npz", _NPZ, load_record),
    "mcap": Door(partial(_bag, "mcap"), "drive.mcap", [m.some_bytes], _ask),
    "db3": Door(partial(_bag, "sqlite3"), "drive.db3", [m.some_bytes], _ask),
    "bag": Door(partial(_bag, "ros1"), "drive.bag", [m.some_bytes], _ask),
    "labels": Door(_labelled, "record.labels.npy", [m.some_bytes], _imitate),
    "demonstrations": Door(_record, "record.npz", _NPZ, _imitate),
    "set": Door(
        _set,
        "mine.json",
        _JSON,
        lambda path: read_set(str(path)),
    ),
    "certificate": Door(
        partial(_copy, asset_folder("worlds/certificates") / "track_2.json"),
        "track_2.json",
        _JSON,
        lambda path: load_certificate(str(path)),
    ),
    "manifest": Door(
        partial(_write, "sweep.yaml", "algos: [ddpg, sac]\nseeds: [0, 1]\nset: [episodes=3]\n"),
        "sweep.yaml",
        _YAML,
        read_manifest,
    ),
    "settings": Door(
        partial(
            _write,
            "mine.yaml",
            "episodes: 7\nthreads: 1\nlearner: {hidden: [8, 8]}\ntask: {reward: {weights: {M: 0}}}\n",
        ),
        "mine.yaml",
        _YAML,
        lambda path: with_settings_of(TINY, path),
    ),
    "config": Door(_run, "run/config.json", _JSON, _run_config),
    "state": Door(_run, "run/checkpoint/state.json", _JSON, _resume),
    "arrays": Door(_run, "run/checkpoint/arrays.npz", _NPZ, _resume),
    "networks": Door(_run, "run/checkpoint/networks.safetensors", _TENSORS, _resume),
    "episodes": Door(_run, "run/episodes.csv", _TEXT, _look_at_run),
    "evaluations": Door(_run, "run/evaluations.csv", _TEXT, _look_at_run),
    "summary": Door(_run, "run/summary.json", _JSON, _look_at_run),
    "archive": Door(
        _archive,
        "runs.zip",
        [partial(m.zip_members, inner={".json": m.json_values, ".csv": m.some_text}), m.some_bytes],
        lambda path: read_groups([path]),
    ),
    "init": Door(_zip, "init.zip", [partial(m.zip_members, inner={}), m.some_bytes], _init),
}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--n", type=int, default=1000)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--door", nargs="+", default=list(DOORS), choices=list(DOORS))
    given = parser.parse_args()
    sys.exit(long_run(given.door, given.first, given.n) > 0)
