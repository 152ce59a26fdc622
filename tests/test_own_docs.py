"""What docs/your_own_world.md and docs/your_own_policy.md show, done."""

import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import DummyVecEnv, VecFrameStack

from zebrat_bullet.agents import load_agent
from zebrat_bullet.cli import main
from zebrat_bullet.config import LidarConfig, TaskConfig
from zebrat_bullet.deploy import Driver
from zebrat_bullet.envs.zebrat_env import ZebratEnv

DOCS = Path(__file__).parent.parent / "docs"
BLOCK = re.compile(r"(?:`([\w.]+)`:\n\n)?```(python|yaml|sh)\n(.*?)```", re.DOTALL)
REFUSED = "# refused"


@pytest.mark.timeout(900)  # a dozen commands, processes of their own: over 300 s beside other work
def test_the_page_on_worlds_of_ones_own_does_what_it_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    done = []
    for name, language, text in BLOCK.findall((DOCS / "your_own_world.md").read_text(encoding="utf-8")):
        if language == "yaml":
            Path(name).write_text(text, encoding="utf-8")
        elif language == "python":
            exec(text, {})
        else:
            for line in text.splitlines():
                expected = 2 if REFUSED in line else 0
                words = shlex.split(line, comments=True)[1:]
                words += ["--workers", "1"] if words[0] == "evaluate" else []
                assert main([*words, "--quiet"]) == expected, line
                said = capsys.readouterr()
                done.append(line)
                if expected:
                    assert "It would stand free at (" in said.err
                if "oracle" in words:
                    assert "100%" in (Path(words[words.index("--out") + 1]) / "table.md").read_text(encoding="utf-8")
    assert len(done) >= 9
    for picture in ("look.png", "corridor.png", "room.png", "circuit.png"):
        assert Path(picture).stat().st_size > 5000


@pytest.mark.timeout(900)
def test_the_page_on_policies_of_ones_own_does_what_it_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    page, n_shorter = (DOCS / "your_own_policy.md").read_text(encoding="utf-8"), 0
    for long, short in ((r"total_timesteps=[\d_]+", "total_timesteps=64"), (r"range\(3000\)", "range(30)")):
        page, n = re.subn(long, short, page)
        n_shorter += n
    names: dict[str, object] = {"__name__": "page"}
    done = []
    for name, language, text in BLOCK.findall(page):
        if name:
            Path(name).write_text(text, encoding="utf-8")
        elif language == "python":
            exec(text, names)
        else:
            for line in text.splitlines():
                words = shlex.split(line, comments=True)[1:]
                words += [] if words[0] == "export" else ["--workers", "1"]
                assert main([*words, "--quiet"]) == 0, f"{line}: {capsys.readouterr().err}"
                done.append(words[0])
    assert n_shorter == 5
    assert done == ["evaluate", "evaluate", "families", "export", "evaluate", "evaluate", "evaluate"]
    assert Driver.load(tmp_path / "mine_policy").definition.name == "mine"
    _drives_as_its_model_behind_frames()


def _drives_as_its_model_behind_frames() -> None:
    """The driver of the page, beside what SB3 does with the same model in the same environment."""
    env = ZebratEnv("track_2", caster="embree")
    frames, model = VecFrameStack(DummyVecEnv([lambda: env]), 3), PPO.load("stacked.zip")
    driver = load_agent("stacked_driver.py:Stacked", TaskConfig(lidar=LidarConfig(caster="embree")))
    frames.seed(0)
    seen = frames.reset()
    driver.reset(0)
    for _ in range(6):
        action, _ = model.predict(seen, deterministic=True)
        command = driver.act(env.reading)
        np.testing.assert_allclose([command.speed_mps, command.steering_rad], action[0] * 0.6, atol=1e-6)
        seen, *_ = frames.step(action)
    frames.close()
