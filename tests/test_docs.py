"""The README and the pages in docs/ say what is so: links lead somewhere, commands parse, examples run."""

import argparse
import importlib.util
import json
import re
import shlex
import tomllib
import zipfile
from pathlib import Path
from types import ModuleType

import pyarrow.parquet as pq
import pytest

from zebrat_bullet.cli.main import main, make_parser
from zebrat_bullet.config import REWARD_PRESETS
from zebrat_bullet.envs.zebrat_env import ZebratEnv
from zebrat_bullet.evaluation.track_set import read_set
from zebrat_bullet.task.rewards import TERMS

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", *sorted(DOCS.glob("*.md"))]
FENCE = re.compile(r"^( *)```(\w*)\n(.*?)^\1```", re.DOTALL | re.MULTILINE)
LINK = re.compile(r"\]\(([^)\s]+)\)")
COMMANDS = next(a for a in make_parser()._actions if isinstance(a, argparse._SubParsersAction)).choices


def each_page():
    return pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)


def prose(page: Path) -> str:
    return FENCE.sub("", page.read_text(encoding="utf-8"))


def anchors(page: Path) -> set[str]:
    """Return what the headings of a page are called in links, as GitHub and the site do."""
    headings = re.findall(r"^#+ (.*)$", prose(page), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-") for heading in headings}


def commands(page: Path) -> list[list[str]]:
    """Return every `zebrat ...` in the page's shell blocks, as words; variables stand for themselves."""
    found = []
    for _, language, text in FENCE.findall(page.read_text(encoding="utf-8")):
        if language != "sh":
            continue
        for line in re.sub(r"\\\n", " ", text).splitlines():
            for part in re.split(r"\s&(?:\s|$)", line):
                words = shlex.split(part, comments=True)
                if words and words[0].rpartition("/")[2] == "zebrat":
                    found.append(words[1:])
    return found


def named(page: Path) -> list[list[str]]:
    """Return every `zebrat ...` in the page's text, as words; what is optional is in square brackets there."""
    spans = re.findall(r"`([^`]+)`", prose(page))
    texts = [" ".join(span.split()) for span in spans]
    return [text.split()[1:] for text in texts if text.startswith("zebrat ")]


def reference() -> ModuleType:
    spec = importlib.util.spec_from_file_location("reference", ROOT / "scripts" / "reference.py")
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@each_page()
def test_every_link_and_picture_is_there(page: Path) -> None:
    for link in LINK.findall(prose(page)):
        if link.startswith("http"):
            continue
        name, _, anchor = link.partition("#")
        target = (page.parent / name).resolve() if name else page
        assert target.exists(), f"{page.name} links {link}"
        assert page.parent == ROOT or target.is_relative_to(DOCS), f"{page.name} links {link}, which the site lacks"
        assert not anchor or anchor in anchors(target), f"{page.name} links {link}; there are {sorted(anchors(target))}"


@each_page()
def test_every_command_of_a_shell_block_parses(page: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for words in commands(page):
        try:
            make_parser().parse_args(words)
        except SystemExit as stopped:
            assert stopped.code == 0, f"{page.name}: zebrat {' '.join(words)}: {capsys.readouterr().err}"


@each_page()
def test_every_command_and_option_that_the_text_names_is_there(page: Path) -> None:
    for command, *words in named(page):
        if command in ("COMMAND", "--help"):
            continue
        assert command.strip("[],") in COMMANDS, f"{page.name}: zebrat {command}"
        options = [word.strip("[],;").partition("=")[0] for word in words if word.strip("[").startswith("--")]
        if "--ros-args" in options:
            continue
        known = COMMANDS[command]._option_string_actions
        assert not [option for option in options if option not in known], f"{page.name}: zebrat {command} {words}"


def test_the_patterns_find_links_and_commands() -> None:
    """The three tests above look at something."""
    assert sum(len(LINK.findall(prose(page))) for page in PAGES) > 150
    assert sum(len(commands(page)) for page in PAGES) > 100
    assert sum(len(named(page)) for page in PAGES) > 50


@pytest.mark.parametrize("name", ["cli.md", "settings.md", "world_files.md"])
def test_the_reference_pages_are_what_the_program_says(name: str) -> None:
    assert (DOCS / name).read_text(encoding="utf-8") == reference().pages()[name], (
        "run scripts/docs, and commit what it writes"
    )


def test_every_setting_has_a_meaning() -> None:
    assert not re.findall(r"^\| `.*\|\s*\|$", (DOCS / "settings.md").read_text(encoding="utf-8"), re.MULTILINE)


@pytest.mark.parametrize("page", ["environment", "your_own_reward", "train", "cli"])
def test_every_reward_is_named_where_rewards_are(page: str) -> None:
    text = (DOCS / f"{page}.md").read_text(encoding="utf-8")
    assert not [name for name in REWARD_PRESETS if not re.search(rf"\b{name}\b", text)]
    assert f"| {' '.join(REWARD_PRESETS)}, or own: the preset's" in text or page != "cli"
    assert all(f'"{name}"' in str(ZebratEnv.__doc__) for name in REWARD_PRESETS)


def test_every_page_is_in_the_navigation() -> None:
    def files(entry: object) -> list[str]:
        if isinstance(entry, str):
            return [entry]
        return [name for each in (entry.values() if isinstance(entry, dict) else entry) for name in files(each)]

    listed = files(tomllib.loads((ROOT / ".zensical.toml").read_text(encoding="utf-8"))["project"]["nav"])
    assert sorted(listed) == sorted(page.name for page in DOCS.glob("*.md"))


def test_the_families_of_the_readme_are_those_of_the_record() -> None:
    scores = json.loads((DOCS / "results" / "allround" / "families.json").read_text(encoding="utf-8"))
    table = re.search(
        r"^\| \| mixed.*\n\|--.*\n((?:.+\n)+)", (ROOT / "README.md").read_text(encoding="utf-8"), re.MULTILINE
    )
    assert table
    rows = [row.strip("| ").split(" | ") for row in table[1].splitlines()]
    assert len(rows) == 4
    for name, *cells in rows:
        agent = name.split("`")[1]
        assert cells == [f"{100 * at['success']:.3g}" for at in scores[agent].values()], name


def test_the_held_out_sets_of_the_docs_are_those_shipped_and_judged() -> None:
    judged = json.loads((DOCS / "results" / "allround" / "sets.json").read_text(encoding="utf-8"))
    rows = re.findall(
        r"^\| `([\w-]+)` \| (\d+ \| \w{12} \| .*) \|$", (DOCS / "families.md").read_text(encoding="utf-8"), re.MULTILINE
    )
    assert sorted(name for name, _ in rows) == sorted(path.stem for path in (ROOT / "worlds" / "sets").glob("*.json"))
    for name, said in rows:
        held_out = read_set(name)
        reversals = {track.reversals for track in held_out.tracks}
        cells = [
            str(len(held_out.tracks)),
            held_out.sha256[:12],
            "-".join(map(str, sorted({min(reversals), max(reversals)}))),
        ]
        for agent in ("shipped", "allround"):
            at = judged[name][agent]
            assert at["sha256"] == held_out.sha256, name
            share, (low, high), worst = (at["overall"][key] for key in ("success", "success_ci", "worst_tenth"))
            cells.append(f"{100 * share:.1f} ({100 * low:.1f}-{100 * high:.1f}), {100 * worst:.1f}")
        assert said.split(" | ") == cells, name


def test_the_seeds_of_the_docs_are_those_of_the_record() -> None:
    seeds = json.loads((DOCS / "results" / "allround" / "seeds.json").read_text(encoding="utf-8"))
    sets = [
        *(f"reversals-{k}" for k in range(1, 6)),
        "manoeuvres",
        "uturns",
        "uneven",
        "bottlenecks",
        "boxes",
        "niches",
    ]
    rows = re.findall(r"^\| (\d) \| (.*) \|$", (DOCS / "families.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert [seed for seed, _ in rows] == list(seeds)
    for seed, said in rows:
        cells = said.replace("*", "").split(" | ")
        at = seeds[seed]
        assert cells[:12] == [f"{100 * at[name]['success']:.1f}" for name in (*sets, "deadends")], seed
        for cell, worlds in zip(cells[12:14], ("twelve_worlds", "twelve_worlds, everything random"), strict=True):
            left, driven = (
                sum(w["causes"]["success"] if n else w["episodes"] for w in at[worlds].values()) for n in (1, 0)
            )
            assert cell == f"{left} of {driven}", seed
        some = [at["bullet_by_reversals"][k] for k in "123"]
        left, driven = round(sum(s["tracks"] * s["success"] for s in some)), sum(s["tracks"] for s in some)
        assert cells[14] == f"{at['bullet']['causes']['success']} of 100; {left} of {driven}", seed
        assert cells[15] == ", ".join(f"{at['width mastered, m'][turn]:.3f}" for turn in ("90", "180")), seed


@pytest.mark.parametrize("seed", range(5))
def test_what_the_seeds_of_the_papers_preset_reach_is_that_of_the_records(seed: int) -> None:
    text = (DOCS / "learning.md").read_text(encoding="utf-8")
    at = json.loads((DOCS / f"results/judged/fomt/ddpg-seed{seed}.json").read_text(encoding="utf-8"))
    shares = [of_world["success"] for of_world in at.values()]
    cells = " | ".join(f"{100 * share:.0f}" for share in [*shares, sum(shares) / len(shares)])
    assert f"| the paper's preset, seed {seed} | {cells} |" in text
    with zipfile.ZipFile(DOCS / "results/algorithms.zip") as archive:
        at = json.loads(archive.read(f"ddpg-fomt-big_track-seed{seed}/scores.json"))["big_track"]
    low, high = at["success_ci"]
    said = f"{at['success']:.0%} ({low:.0%}-{high:.0%})".replace("%", "").replace(" (", " % (").replace(")", " %)")
    (row,) = re.findall(rf"^\| (?:DDPG, )?seed {seed} \| [23]\d\d,.*$", text.split("What each run became")[1], re.M)[:1]
    assert f"{said}, {at['time_s']:.1f} s" in row
    kept = [("run", "=", f"paper-fomt/ddpg-fomt-big_track-seed{seed}"), ("place", "=", "big_track")]
    drives = pq.read_table(DOCS / "results/comparison/episodes.parquet", columns=["outcome"], filters=kept)
    assert drives.num_rows == at["episodes"] == 70
    assert drives["outcome"].to_pylist().count("success") == at["causes"]["success"]


def test_every_extra_is_in_the_table_of_extras() -> None:
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    told = re.findall(r"^\| `(\w+)` \|", (DOCS / "installing.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert sorted(told) == sorted(extras)


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_the_five_minute_start_does_what_it_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    page = DOCS / "start.md"
    done = []
    for _, language, text in FENCE.findall(page.read_text(encoding="utf-8").split("## What next")[0]):
        if language == "yaml":
            Path("my_track.yaml").write_text(text, encoding="utf-8")
        elif language == "python":
            exec(text, {})
        else:
            for line in text.splitlines():
                words = [word.replace("max_minutes=1", "max_minutes=0.02") for word in shlex.split(line)[1:]]
                if not words:
                    assert line == "scripts/setup" and (ROOT / line).is_file()
                    continue
                if words[0] == "video":  # tests/test_video.py films; this drive would take a minute
                    continue
                words += ["--workers", "1"] if words[0] == "evaluate" else []
                assert main([*words, "--quiet"]) == 0, line
                done.append((words[0], capfd.readouterr().out))
    assert [name for name, _ in done] == ["evaluate", "replay", "worlds", "evaluate", "train", "evaluate"]
    assert "| track_2 | 100%" in done[0][1]
    assert "every pose as recorded" in done[1][1]
    assert "| shipped | - | 100%" in done[3][1] and "| oracle | goal, map, pose | 100%" in done[3][1]
    for file in ("my_track.png", "runs/first/best.safetensors"):
        assert Path(file).stat().st_size > 5000, file


@pytest.mark.parametrize(
    "name, said",
    [
        ("your_own_reward.md", "-0.15"),
        ("compare.md", "collision"),
        ("staying.md", "dead ends: 273 to 448 in 70 steps, 3.9 to 6.4 a step"),
    ],
)
def test_the_examples_of_a_page_run(name: str, said: str, capsys: pytest.CaptureFixture[str]) -> None:
    kept = dict(TERMS)
    blocks = [
        text for _, language, text in FENCE.findall((DOCS / name).read_text(encoding="utf-8")) if language == "python"
    ]
    names = {"__name__": "page"}
    try:
        for text in blocks:
            exec(text, names)
    finally:
        TERMS.clear()
        TERMS.update(kept)
    assert blocks and said in capsys.readouterr().out
