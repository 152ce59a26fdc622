"""What was trained elsewhere becomes a policy of this package that acts alike, or is refused by name."""

from pathlib import Path

import gymnasium
import numpy as np
import pytest
import torch
from sb3_contrib import RecurrentPPO
from stable_baselines3 import A2C, DDPG, DQN, PPO, SAC, TD3
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecFrameStack, VecNormalize
from torch import nn

import zebrat_bullet  # noqa: F401  (registers the environments)
from zebrat_bullet.agents import load_agent, trained_task
from zebrat_bullet.agents.policy import PolicyAgent, save_policy
from zebrat_bullet.config import TaskConfig
from zebrat_bullet.envs.planar_env import PlanarVectorEnv
from zebrat_bullet.envs.zebrat_env import ZebratEnv
from zebrat_bullet.errors import PolicyError
from zebrat_bullet.task.observation import DISCRETE_COMMANDS
from zebrat_bullet.training.own_policy import policy_of, policy_of_layers
from zebrat_bullet.training.planar_vec_env import PlanarVecEnv

SEEN = np.random.default_rng(7).uniform(-1.0, 1.0, (300, 34)).astype(np.float32)
SMALL = {"buffer_size": 10}
LEARNERS = {
    **{"ppo": (PPO, {}), "a2c": (A2C, {}), "sac": (SAC, SMALL), "td3": (TD3, SMALL), "ddpg": (DDPG, SMALL)},
    "dqn": (DQN, SMALL),
}


@pytest.fixture(scope="module")
def cars():
    env = PlanarVecEnv(PlanarVectorEnv(4, "track_2", task={"episode": {"max_steps": 77}}))
    yield env
    env.close()


@pytest.fixture(scope="module")
def six_actions():
    env = ZebratEnv("track_2", discrete=True, caster="embree")
    yield env
    env.close()


def made(name, env, activation=nn.ReLU, **how):
    kind, settings = LEARNERS[name]
    arch = how.pop("net_arch", [16, 12])
    model = kind(
        "MlpPolicy", env, seed=1, policy_kwargs={"net_arch": arch, "activation_fn": activation}, **settings, **how
    )
    with torch.no_grad():  # networks begin with outputs so small that neither head nor activation shows
        for parameter in model.policy.parameters():
            parameter.mul_(30.0 if name in ("ppo", "a2c") and parameter.shape[0] in (2, 6) else 2.0)
    return model


def kept(agent: PolicyAgent, folder: Path) -> PolicyAgent:
    save_policy(agent, folder / "mine.safetensors")
    loaded = load_agent(str(folder / "mine.safetensors"), TaskConfig())
    assert isinstance(loaded, PolicyAgent)
    return loaded


@pytest.mark.parametrize("activation", [nn.ReLU, nn.Tanh, nn.ELU])
@pytest.mark.parametrize("name", LEARNERS)
def test_every_learner_becomes_a_policy_that_acts_as_it_predicts(name, activation, cars, six_actions, tmp_path):
    env = six_actions if name == "dqn" else cars
    model = made(name, env, activation)
    agent = kept(policy_of(model, env), tmp_path)
    actions, _ = model.predict(SEEN, deterministic=True)
    expected = np.array(DISCRETE_COMMANDS)[actions] if name == "dqn" else actions
    np.testing.assert_allclose(agent.action(SEEN), expected, atol=1e-5)
    assert (np.ptp(expected, axis=0) > 0.5).all()


@pytest.mark.parametrize("arch", [[], [9]])
@pytest.mark.parametrize("name", ["ppo", "sac", "td3"])
def test_a_network_may_be_as_small_as_it_likes(name, arch, cars):
    model = made(name, cars, nn.Tanh, net_arch=arch)
    np.testing.assert_allclose(
        policy_of(model, cars).action(SEEN), model.predict(SEEN, deterministic=True)[0], atol=1e-5
    )


def test_the_six_actions_of_ppo_and_a_squashed_one(cars, six_actions):
    model = made("ppo", six_actions)
    chosen, _ = model.predict(SEEN, deterministic=True)
    np.testing.assert_array_equal(policy_of(model, six_actions).action(SEEN), np.float32(DISCRETE_COMMANDS)[chosen])
    squashed = PPO("MlpPolicy", cars, use_sde=True, policy_kwargs={"squash_output": True, "net_arch": [8]}, seed=0)
    assert policy_of(squashed, cars).head == "tanh"


@pytest.mark.parametrize("name", ["ppo", "sac", "td3"])
@pytest.mark.parametrize("norm_obs", [True, False])
def test_a_vec_normalize_becomes_the_first_layer_its_clip_included(name, norm_obs, cars, tmp_path):
    rng, normalise = np.random.default_rng(0), VecNormalize(cars, clip_obs=3.0, norm_obs=norm_obs)
    if norm_obs:
        normalise.obs_rms.mean, normalise.obs_rms.var = rng.uniform(-0.5, 0.5, 34), rng.uniform(0.005, 0.2, 34)
    model = made(name, normalise, nn.Tanh)
    normalised = normalise.normalize_obs(SEEN)
    assert (np.abs(normalised) == 3.0).any() == norm_obs
    agent = kept(policy_of(model, normalise, normalise), tmp_path)
    np.testing.assert_allclose(agent.action(SEEN), model.predict(normalised, deterministic=True)[0], atol=1e-5)


def test_a_vec_normalize_that_is_known_cannot_be_left_out(cars):
    normalise = VecNormalize(cars)
    with pytest.raises(PolicyError, match="give it too, as normalise="):
        policy_of(made("ppo", normalise), cars)
    with pytest.raises(PolicyError, match="give it too, as normalise="):
        policy_of(made("ppo", cars), normalise)
    with pytest.raises(PolicyError, match="normalise is a VecNormalize of Stable-Baselines3, got str"):
        policy_of(made("ppo", cars), cars, "vn.pkl")
    with pytest.raises(PolicyError, match=r"shape \(68,\), the environment's is \(34,\)"):
        policy_of(made("ppo", cars), cars, VecNormalize(VecFrameStack(cars, 2)))


def test_the_policy_is_judged_under_the_task_of_its_environment(cars, tmp_path):
    agent = policy_of(made("ppo", cars), cars)
    save_policy(agent, tmp_path / "mine.safetensors")
    assert trained_task(str(tmp_path / "mine.safetensors")) == cars.env.task
    assert cars.env.task.episode.max_steps == 77 and agent.provenance["learner"].startswith(
        "PPO of Stable-Baselines3 2"
    )


@pytest.mark.parametrize("vectorised", [DummyVecEnv, SubprocVecEnv, None])
def test_an_environment_may_stand_within_wrappers(vectorised, cars):
    def make():
        return gymnasium.make("zebrat_bullet:ZebraT/Track2-v0", caster="embree", max_episode_steps=60)

    env = vectorised([make]) if vectorised else make()
    assert policy_of(made("ppo", cars), env).observation == cars.env.spec_observation
    env.close()


def test_the_layers_of_pytorch_become_a_policy(cars, tmp_path):
    torch.manual_seed(0)
    network = nn.Sequential(
        nn.Linear(34, 16), nn.Tanh(), nn.Sequential(nn.Linear(16, 8, bias=False), nn.ELU()), nn.Linear(8, 2)
    )
    network.double()
    with torch.no_grad():
        network[3].weight.mul_(8.0)
        output = network(torch.from_numpy(SEEN).double()).numpy()
    heads = {"clip": np.clip(output, -1.0, 1.0), "tanh": np.tanh(output)}
    for head, expected in heads.items():
        agent = kept(policy_of_layers(network, cars, head), tmp_path)
        np.testing.assert_allclose(agent.action(SEEN), expected, atol=1e-5)
    assert agent.activation == "tanh elu"
    np.testing.assert_allclose(policy_of_layers([*network, nn.Tanh()], cars).action(SEEN), heads["tanh"], atol=1e-5)
    six = [*network[:3], nn.Linear(8, 6)]
    chosen = nn.Sequential(*six).double()(torch.from_numpy(SEEN).double()).argmax(1)
    actions = policy_of_layers(six, cars, "argmax").action(SEEN)
    np.testing.assert_array_equal(actions, np.float32(DISCRETE_COMMANDS)[chosen.numpy()])


@pytest.mark.parametrize(
    ("layers", "head", "said"),
    [
        ([nn.Linear(34, 8), nn.GELU(), nn.Linear(8, 2)], "clip", "cannot express GELU.* as part 2 of the network"),
        ([nn.Linear(34, 8), nn.ELU(0.5), nn.Linear(8, 2)], "clip", "cannot express ELU.alpha=0.5. as part 2"),
        ([nn.Linear(34, 8), nn.Linear(8, 2)], "clip", "cannot express Linear.* as part 2"),
        ([nn.LSTM(34, 8), nn.Linear(8, 2)], "clip", "cannot express LSTM.* as part 1 .* FILE.py:NAME"),
        ([nn.Linear(34, 8), nn.ReLU(), nn.Linear(9, 2)], "clip", "Linear.in_features=9.* behind a layer of 8 outputs"),
        ([nn.Linear(34, 2), nn.ReLU()], "clip", "the last layer is followed by ReLU"),
        ([nn.Linear(34, 6), nn.Tanh()], "argmax", "squashed by nn.Tanh, which does not go with the head 'argmax'"),
        ([nn.Linear(34, 3)], "clip", "has 3 outputs, its head 'clip' needs 2"),
        ([nn.Linear(68, 2)], "clip", "takes 68 numbers, the environment's observation has 34; of stacked frames"),
        ([nn.Linear(34, 2)], "sign", "head is .* got 'sign'"),
        ([], "clip", "the network has no nn.Linear"),
        (nn.LSTM(34, 2), "clip", "LSTM does not say in which order its layers act"),
    ],
)  # fmt: skip
def test_layers_that_cannot_be_expressed_are_refused_by_name(layers, head, said, cars):
    with pytest.raises(PolicyError, match=said):
        policy_of_layers(layers, cars, head)


class Halved(BaseFeaturesExtractor):
    def __init__(self, space):
        super().__init__(space, 34)

    def forward(self, observations):
        return observations / 2


def test_models_that_cannot_be_expressed_are_refused_by_name(cars, six_actions):
    recurrent = RecurrentPPO("MlpLstmPolicy", cars, policy_kwargs={"lstm_hidden_size": 8, "net_arch": [8]})
    halved = PPO("MlpPolicy", cars, policy_kwargs={"features_extractor_class": Halved})
    stacked = VecFrameStack(cars, 3)
    raw = ZebratEnv("track_2", raw=True, caster="embree")
    flipped = gymnasium.wrappers.TransformObservation(six_actions, lambda seen: seen[::-1], None)
    refused = [
        (recurrent, cars, "RecurrentPPO has a RecurrentActorCriticPolicy.*FILE.py:NAME"),
        (halved, cars, "through a Halved"),
        (made("ppo", cars, nn.GELU), cars, "cannot express GELU"),
        (made("td3", stacked), stacked, r"the model observes .*102.*stacked frames"),
        (made("ppo", raw), raw, "this environment is raw"),
        (made("ppo", flipped), flipped, "TransformObservation changes what is observed"),
        (made("ppo", flipped), DummyVecEnv([lambda: flipped]), "an ObservationWrapper changes what is observed"),
        (made("ppo", gymnasium.make("Pendulum-v1")), cars, "the model observes"),
        (made("ppo", cars), gymnasium.make("Pendulum-v1"), "none of this package; give one, say"),
        (nn.Linear(34, 2), cars, "policy_of_layers takes"),
    ]
    for model, env, said in refused:
        with pytest.raises(PolicyError, match=said):
            policy_of(model, env)
    raw.close()


def test_a_policy_that_acts_otherwise_than_its_model_is_never_returned(cars):
    model = made("ppo", cars)
    model.policy.action_net.register_forward_hook(lambda module, seen, output: output * 0.9)
    with pytest.raises(PolicyError, match="acts otherwise than the model, by up to 0"):
        policy_of(model, cars)
    diverged = made("sac", cars)
    with torch.no_grad():
        diverged.actor.mu.weight[0, 0] = float("nan")
    with pytest.raises(PolicyError, match="not finite"):
        policy_of(diverged, cars)


def test_a_zip_as_an_agent_names_the_way(cars, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    made("ppo", cars).save("mine.zip")
    with pytest.raises(PolicyError, match=r"own_policy.policy_of \(docs/your_own_policy.md\)"):
        load_agent("mine.zip", TaskConfig())
