"""One ruler: reward, rules, region, observation and action are defined once, and mean the same for one car and many."""

import ast
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from boxes import box_world

from zebrat_bullet.arrays import Array, namespace, on_host
from zebrat_bullet.config import EpisodeConfig, LidarConfig, ObservationConfig, RewardConfig, TaskConfig
from zebrat_bullet.envs.planar_env import PlanarVectorEnv
from zebrat_bullet.envs.zebrat_env import ZebratEnv
from zebrat_bullet.planar.drive import PlanarDrive
from zebrat_bullet.robot import load_robot
from zebrat_bullet.sensing.safety_region import make_region
from zebrat_bullet.task.drive import Drive
from zebrat_bullet.task.episode import EpisodeRules, Outcome
from zebrat_bullet.task.observation import observation_spec
from zebrat_bullet.task.rewards import TERMS, RewardInput, rewards, weighted_terms
from zebrat_bullet.types import Command, Commands, Pose2
from zebrat_bullet.world.world import World

N = 50
PACKAGE = Path(__file__).parent.parent / "zebrat_bullet"
TASK = TaskConfig(lidar=LidarConfig(caster="embree"), episode=EpisodeConfig(open_width_m=20.0))
REGION = make_region(load_robot(), TASK.region, 360)
IN = {"numpy": lambda values: values, "torch": torch.from_numpy}


def seen(numbers: dict[str, np.ndarray], made: str, rows: slice = slice(None)) -> RewardInput:
    """Return what the terms look at for some of N cars, in the arrays of a library."""
    of = {name: IN[made](values[rows]) for name, values in numbers.items()}
    clearance = REGION.clearances(of["obs"])
    weights = RewardConfig(weights=dict.fromkeys(TERMS, 1.0))
    return RewardInput(clearance, REGION, of["speed"], Commands(of["v"], of["delta"]), weights, of["nearer"])


@pytest.fixture(scope="module")
def numbers() -> dict[str, np.ndarray]:
    """Ranges and motions of N cars, some of them with walls inside of the outline."""
    rng = np.random.default_rng(0)
    uniform = {"speed": 0.6, "v": 0.6, "delta": 0.6, "nearer": 0.1}
    drawn = {name: rng.uniform(-most, most, N).astype(np.float32) for name, most in uniform.items()}
    return drawn | {"obs": rng.uniform(0.05, 6.0, (N, len(REGION.indices))).astype(np.float32)}


@pytest.mark.parametrize("made", IN)
@pytest.mark.parametrize("name", TERMS)
def test_a_term_of_many_cars_is_the_term_of_each_car_alone(numbers, name, made):
    whole = on_host(TERMS[name](seen(numbers, made)))
    alone = [on_host(TERMS[name](seen(numbers, "numpy", slice(i, i + 1)))) for i in range(N)]
    assert whole.shape == (N,)
    np.testing.assert_allclose(whole, np.concatenate(alone), rtol=3e-6, atol=3e-6)


@pytest.mark.parametrize("made", IN)
def test_the_reward_is_the_sum_of_the_terms_and_at_the_end_what_the_end_pays_alone(numbers, made):
    step = seen(numbers, made)
    terms = weighted_terms(step)
    outcome = (np.arange(N) % (len(Outcome) + 1)).astype(np.int8)
    paid = on_host(rewards(terms, IN[made](outcome), step.config))
    total = sum(on_host(term) for term in terms.values())
    ends = {Outcome.COLLISION: -50.0, Outcome.SUCCESS: 50.0, Outcome.FALSE_EXIT: 50.0}
    for i, code in enumerate(outcome):
        assert paid[i] == pytest.approx(ends.get(Outcome.of(int(code)), total[i]), rel=1e-6)


def test_what_the_region_observation_and_action_say_does_not_depend_on_the_library(numbers):
    spec = observation_spec(replace(TASK, observation=ObservationConfig(log_gaps=True)), REGION, load_robot())
    command = np.stack([numbers["v"], numbers["delta"]], axis=1)
    by_numpy, by_torch = (
        (
            spec.encode_cars(make(numbers["obs"]), make(command)),
            spec.decode_cars(make(command * 3)).speed_mps,
            REGION.clearances(make(numbers["obs"])).collision,
        )
        for make in IN.values()
    )
    for ours, theirs in zip(by_numpy, by_torch, strict=True):
        np.testing.assert_allclose(ours, on_host(theirs), atol=1e-6)
    assert by_numpy[2].any() and not by_numpy[2].all()


def test_the_rules_do_not_depend_on_the_library():
    rng = np.random.default_rng(1)
    config, robot = EpisodeConfig(max_steps=30, stall_steps=7), load_robot()
    lines = np.tile(np.float32([[2.0, -0.5], [2.0, 0.5]]), (N, 1, 1))
    most = np.full(N, 30, np.int32)
    ours, theirs = (EpisodeRules(config, robot, make(np.zeros((N, 3), np.float32))) for make in IN.values())
    poses = np.zeros((N, 3), np.float32)
    codes = set()
    for rules, make in ((ours, IN["numpy"]), (theirs, IN["torch"])):
        rules.begin(np.arange(N), make(poses), make(lines), make(most))
    for _ in range(30):
        moved = rng.uniform((-0.02, -0.05, -0.1), (0.18, 0.05, 0.1), (N, 3)).astype(np.float32)
        moved[::3] = 0.0
        poses += moved
        contact, collision = rng.random((2, N)) < 0.004
        width = rng.uniform(1.0, 8.1, N).astype(np.float32)
        code, again = (
            on_host(rules.judge(make(poses), make(contact), make(collision), make(width)))
            for rules, make in ((ours, IN["numpy"]), (theirs, IN["torch"]))
        )
        assert np.array_equal(code, again) and code.dtype == again.dtype == np.int8
        codes |= set(code.tolist())
    assert codes == {0, *(outcome.code for outcome in Outcome)}


def steer_term(step: RewardInput) -> Array:
    """S: minus how far the wheels are asked to turn, and the nearest range: what a user may well write."""
    xp = namespace(step.clearance.obs_m)
    nearest = xp.min(step.clearance.obs_m, axis=-1)
    return nearest - xp.abs(step.command.steering_rad) + 0.0 * step.speed_mps


def boxed_in() -> World:
    """Walls 1 m to the left, 2 m to the right, 3 m ahead and 4 m behind the middle of the car."""
    return box_world(
        ((-5.0, 4.0), (1.0, 2.0), (0.0, 1.0)),
        ((-5.0, 4.0), (-3.0, -2.0), (0.0, 1.0)),
        ((3.0, 4.0), (-2.0, 1.0), (0.0, 1.0)),
        ((-5.0, -4.0), (-2.0, 1.0), (0.0, 1.0)),
    )


def test_a_new_term_works_in_both_simulations_and_says_the_same_of_the_same_state(monkeypatch):
    monkeypatch.setitem(TERMS, "S", steer_term)
    reward = RewardConfig(weights={"S": 2.0, "O": 1.0, "M": 1.0, "T": 1.0})
    one = ZebratEnv(boxed_in(), task=TASK, reward=reward)
    many = PlanarVectorEnv(3, boxed_in(), task=TASK, reward=reward)
    one.reset(seed=0)
    many.reset(seed=0)
    action = np.array([0.0, 0.5], np.float32)  # the car stands and turns its wheels by 0.3 rad
    _, reward_here, _, _, here = one.step(action)
    _, reward_there, _, _, there = many.step(np.tile(action, (3, 1)))
    one.close()
    assert here["terms"]["S"] == pytest.approx(2.0 * (1.0 - 0.3), abs=1e-3)  # the left wall is the nearest
    assert here["terms"].keys() == there["terms"].keys() == set("FOMTWS")
    for name, term in here["terms"].items():
        assert there["terms"][name] == pytest.approx(np.full(3, term), abs=2e-3), name
    assert reward_there == pytest.approx(np.full(3, reward_here), abs=5e-3)


def test_both_simulations_pay_the_same_drive_the_same():
    commands = [Command(0.6, 0.0)] * 6 + [Command(0.4, -0.3)] * 5
    one, many = Drive(TASK, boxed_in()), PlanarDrive(TASK, [boxed_in()], 1)
    one.reset(np.random.default_rng(0), pose=Pose2(-1.5, -0.4, 0.0))
    many.begin_at(np.array([0]), [Pose2(-1.5, -0.4, 0.0)])
    for command in commands:
        here = one.step(command)
        there = many.follow(Commands(np.float32([command.speed_mps]), np.float32([command.steering_rad])))
        assert float(there.reward[0]) == pytest.approx(here.reward, abs=0.1)
        for name, term in here.terms.items():
            assert float(there.terms[name][0]) == pytest.approx(term, abs=0.1), name
        assert here.outcome is None and there.outcome[0] == 0
    one.close()


def definitions(name: str) -> list[str]:
    """Return the modules that define a function or class of this name."""
    found = []
    for path in sorted(PACKAGE.rglob("*.py")):
        nodes = ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        kinds = (ast.FunctionDef, ast.ClassDef)
        found += [str(path.relative_to(PACKAGE)) for node in nodes if isinstance(node, kinds) and node.name == name]
    return found


@pytest.mark.parametrize(
    ("name", "where"),
    [
        *((term.__name__, "task/rewards.py") for term in TERMS.values()),
        *((name, "task/rewards.py") for name in ("weighted_terms", "rewards", "RewardInput")),
        *((name, "task/episode.py") for name in ("EpisodeRules", "start_pose", "anywhere_poses")),
        *((name, "task/observation.py") for name in ("ObservationSpec", "encode_cars", "decode_cars")),
        *((name, "sensing/safety_region.py") for name in ("SafetyRegion", "FIRect", "FIFR", "make_region")),
        ("draw_dynamics", "task/dynamics.py"),
    ],
)
def test_what_the_paper_defines_is_defined_once(name, where):
    assert definitions(name) == [where]


SIMULATIONS = [path for stage in ("planar", "sim") for path in sorted((PACKAGE / stage).glob("*.py"))]


@pytest.mark.parametrize("path", SIMULATIONS, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_a_simulation_holds_no_reward_rule_or_setting_of_its_own(path):
    """Numbers of the paper: 8 m, discount 0.9, 50 at the end, 70 and 1000 steps, 13 gaps."""
    paper = {(type(number), number) for number in (8.0, 0.9, 50.0, 70, 1000, 13)}
    outcomes = {str(outcome) for outcome in Outcome}
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Constant):
            assert not (isinstance(node.value, str) and node.value in {*outcomes, *TERMS}), node.value
            assert (type(node.value), node.value) not in paper, node.value
        if isinstance(node, ast.FunctionDef):
            assert not node.name.endswith("_term")
