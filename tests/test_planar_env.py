"""Planar cars under the contracts of gymnasium's VectorEnv and of Stable-Baselines3's VecEnv."""

import warnings
from collections.abc import Callable
from dataclasses import replace

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.wrappers.vector import (
    ClipReward,
    DictInfoToList,
    NormalizeReward,
    RecordEpisodeStatistics,
    RescaleAction,
    TransformReward,
)
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecCheckNan, VecMonitor, VecNormalize

import zebrat_bullet  # noqa: F401 (registers the ids)
from zebrat_bullet.config import EpisodeConfig, RewardConfig, TaskConfig
from zebrat_bullet.envs.planar_env import PlanarVectorEnv
from zebrat_bullet.envs.zebrat_env import ZebratEnv
from zebrat_bullet.errors import ConfigError, EpisodeError
from zebrat_bullet.training.planar_vec_env import PlanarVecEnv

SHORT = TaskConfig(episode=EpisodeConfig(max_steps=20))
N = 16


def env_of(**settings: object) -> PlanarVectorEnv:
    return PlanarVectorEnv(N, ["track_1", "track_2"], **({"task": SHORT} | settings))


def actions(n_steps: int) -> np.ndarray:
    return np.random.default_rng(0).uniform(-1.0, 1.0, (n_steps, N, 2)).astype(np.float32)


def test_make_vec_makes_it_and_it_declares_that_it_resets_in_the_same_step() -> None:
    env = gymnasium.make_vec("ZebraT/Planar-v0", num_envs=3, worlds=["track_1", "track_2"])
    assert env.num_envs == 3 and env.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    observation, info = env.reset(seed=0)
    assert observation in env.observation_space and observation.dtype == np.float32 and set(info) == {"terms"}
    assert observation[0] in env.single_observation_space
    env.action_space.seed(0)
    assert env.action_space.sample().shape == (3, 2) and env.single_action_space.shape == (2,)
    env.close()


@pytest.mark.parametrize("settings", [{}, {"raw": True}, {"reward": "fot"}], ids=["scaled", "raw", "fot"])
def test_spaces_and_types_are_those_of_the_single_env(settings: dict) -> None:
    env, one = env_of(**settings), ZebratEnv("track_1", caster="embree", **settings)
    assert env.single_observation_space == one.observation_space and env.single_action_space == one.action_space
    one.close()
    env.reset(seed=0)
    for action in actions(15):
        observation, reward, terminated, truncated, info = env.step(action)
        assert observation in env.observation_space and observation.dtype == np.float32
        assert reward.shape == (N,) and np.issubdtype(reward.dtype, np.floating)
        assert terminated.dtype == truncated.dtype == np.bool_ and not (terminated & truncated).any()
        assert set(info["terms"]) == set("FOMTW")


def test_an_info_tells_of_the_episodes_that_ended() -> None:
    env = env_of()
    _, info = env.reset(seed=0)
    assert set(info) == {"terms"} and all((term == np.zeros(N)).all() for term in info["terms"].values())
    assert set(info["terms"]) == set("FOMTW")
    outcomes = set()
    for action in actions(60):
        observation, _, terminated, truncated, info = env.step(action)
        ended = terminated | truncated
        if not ended.any():
            assert set(info) == {"terms"}
            continue
        assert np.array_equal(info["_final_obs"], ended) and np.array_equal(info["_outcome"], ended)
        for car in range(N):
            if ended[car]:
                assert info["final_obs"][car] in env.single_observation_space
                assert info["final_obs"][car][-2:] == pytest.approx(action[car], abs=1e-6)
                assert (observation[car, -2:] == 0.0).all()
                assert truncated[car] == (info["outcome"][car] in ("timeout", "stall"))
                outcomes.add(info["outcome"][car])
            else:
                assert info["final_obs"][car] is None and info["outcome"][car] is None
    assert outcomes >= {"collision", "timeout"}


def test_a_stall_is_the_end_of_the_task_only_where_it_costs() -> None:
    for stall, ends in ((None, False), (-30.0, True)):
        task = replace(SHORT, reward=RewardConfig(stall=stall), episode=EpisodeConfig(stall_steps=5))
        env = PlanarVectorEnv(2, "track_2", task=task)
        env.reset(seed=0)
        *_, last = (env.step(np.zeros((2, 2), dtype=np.float32)) for _ in range(5))
        assert last[4]["outcome"].tolist() == ["stall"] * 2
        assert (last[2] == ends).all() and (last[3] != ends).all() and (last[1] == -30.0).all() == ends


def test_a_seed_fixes_all_that_follows_and_no_seed_goes_on() -> None:
    one, two = env_of(), env_of()
    assert np.array_equal(one.reset(seed=3)[0], two.reset(seed=3)[0])
    for action in actions(15):
        assert all(np.array_equal(a, b) for a, b in zip(one.step(action)[:4], two.step(action)[:4], strict=True))
    third = one.reset()[0]
    assert np.array_equal(third, two.reset()[0]) and not np.array_equal(third, one.reset(seed=3)[0])


def test_without_any_seed_two_begin_differently() -> None:
    one, two = PlanarVecEnv(env_of()), PlanarVecEnv(env_of())
    first = one.reset()
    assert not np.array_equal(first, two.reset())


def test_where_a_seed_was_named_a_reset_without_one_goes_on() -> None:
    one, two = env_of(), env_of()
    for env in (one, two):
        env.drive.reset(7)
    assert np.array_equal(one.reset()[0], two.reset()[0])


def test_options_are_refused_for_there_are_none() -> None:
    with pytest.raises(ConfigError, match=r"takes no options, got \{'episode': 3\}"):
        env_of().reset(seed=0, options={"episode": 3})
    env_of().reset(seed=0, options={})


def test_gymnasiums_wrappers_work_on_it() -> None:
    env = TransformReward(RecordEpisodeStatistics(env_of()), lambda reward: 0.1 * reward)
    env.reset(seed=0)
    returns, lengths, plain = np.zeros(N), np.zeros(N, int), env_of()
    plain.reset(seed=0)
    for action in actions(25):
        _, scaled, terminated, truncated, info = env.step(action)
        reward = plain.step(action)[1]
        assert scaled == pytest.approx(0.1 * reward, rel=1e-5)
        returns, lengths = returns + reward, lengths + 1
        ended = terminated | truncated
        for car in np.flatnonzero(ended):
            assert float(info["episode"]["r"][car]) == pytest.approx(returns[car], rel=1e-5)
            assert int(info["episode"]["l"][car]) == lengths[car]
        returns[ended], lengths[ended] = 0.0, 0


@pytest.mark.parametrize(
    "wrap",
    [
        DictInfoToList,
        NormalizeReward,
        lambda env: ClipReward(env, -1.0, 1.0),
        lambda env: RescaleAction(env, np.float32(-2), np.float32(2)),
    ],
    ids=["infos", "normalize-rewards", "clip-rewards", "rescale-actions"],
)
def test_wrappers_of_infos_rewards_and_actions_work_too(wrap: Callable[[VectorEnv], VectorEnv]) -> None:
    """Gymnasium's wrappers of observations take no vector env that resets in the same step."""
    env = wrap(env_of())
    env.reset(seed=0)
    ends = 0
    for action in actions(25):
        observation, reward, terminated, truncated, _ = env.step(action)
        assert np.isfinite(reward).all() and observation in env.observation_space
        ends += int((terminated | truncated).sum())
    assert ends >= N


def test_sb3_gets_terminal_observations_returns_and_lengths() -> None:
    """The same actions in the gymnasium env say what every number must be."""
    vec, env = PlanarVecEnv(env_of()), env_of()
    vec.seed(0)
    assert np.array_equal(vec.reset(), env.reset(seed=0)[0])
    returns, lengths = np.zeros(N), np.zeros(N, int)
    for action in actions(50):
        observation, reward, done, infos = vec.step(action)
        expected, paid, terminated, truncated, info = env.step(action)
        assert np.array_equal(observation, expected) and np.array_equal(reward, paid.astype(np.float32))
        assert np.array_equal(done, terminated | truncated)
        returns, lengths = returns + paid, lengths + 1
        for car, told in enumerate(infos):
            if not done[car]:
                assert told == {}
                continue
            assert np.array_equal(told["terminal_observation"], info["final_obs"][car])
            assert told["TimeLimit.truncated"] is bool(truncated[car]) and told["outcome"] == info["outcome"][car]
            assert told["episode"]["l"] == lengths[car]
            assert told["episode"]["r"] == pytest.approx(returns[car], rel=1e-5)
        returns[done], lengths[done] = 0.0, 0


def test_sb3_goes_on_where_a_state_was_taken() -> None:
    vec, other = PlanarVecEnv(env_of()), PlanarVecEnv(env_of())
    vec.reset()
    for action in actions(7):
        vec.step(action)
    state = vec.state()
    here = [vec.step(action) for action in actions(12)]
    other.load(*state)
    for action, (observation, reward, done, infos) in zip(actions(12), here, strict=True):
        again = other.step(action)
        assert all(np.array_equal(a, b) for a, b in zip((observation, reward, done), again[:3], strict=True))
        assert [info.get("episode") for info in infos] == [info.get("episode") for info in again[3]]


def test_sb3s_wrappers_and_ppo_learn_on_it() -> None:
    vec = VecNormalize(VecCheckNan(VecMonitor(PlanarVecEnv(env_of())), raise_exception=True), norm_obs=False)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        model = PPO("MlpPolicy", vec, n_steps=16, batch_size=64, n_epochs=1, seed=0, policy_kwargs={"net_arch": [16]})
        before = model.policy.state_dict()["action_net.weight"].clone()
        model.learn(3 * 16 * N)
    assert model.num_timesteps == 3 * 16 * N and not (model.policy.state_dict()["action_net.weight"] == before).all()
    assert len(model.ep_info_buffer) > N and {"r", "l"} <= set(model.ep_info_buffer[0])
    assert vec.get_attr("num_envs") == [N] * N and vec.env_is_wrapped(VecMonitor) == [False] * N
    vec.close()


def test_closed_cars_neither_begin_nor_drive() -> None:
    env = env_of()
    env.reset(seed=0)
    env.close()
    for use in (env.reset, lambda: env.step(actions(1)[0])):
        with pytest.raises(EpisodeError, match="is closed; make a new one"):
            use()
