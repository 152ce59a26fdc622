"""The report on the comparison: one page that needs nothing else, the same bytes from the same tables."""

import json
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from comparison_tables import counts, episodes, everyone, run, tables
from selenium import webdriver

from zebrat_bullet.agents import load_agent
from zebrat_bullet.comparison.manifest import Driver, Judgement, Manifest, read_manifest
from zebrat_bullet.comparison.tables import write_tables
from zebrat_bullet.config import TaskConfig
from zebrat_bullet.config_text import with_overrides
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.evaluation.rollout import run_episode
from zebrat_bullet.report.comparison.build import build_report, make_document
from zebrat_bullet.report.comparison.document import Cards, Grid
from zebrat_bullet.report.comparison.evidence import TRACKS, Evidence
from zebrat_bullet.report.comparison.numbers import MISSING, points
from zebrat_bullet.report.comparison.section_drives import atlas_section, replay_commands
from zebrat_bullet.report.comparison.section_evaluation import ablation_section
from zebrat_bullet.report.comparison.section_finetuning import finetuning_section
from zebrat_bullet.report.comparison.section_run import run_section
from zebrat_bullet.report.comparison.section_scale import scale_section
from zebrat_bullet.report.comparison.settings import asked_for, asked_runs
from zebrat_bullet.task.drive import Drive
from zebrat_bullet.world import load_world

DOCS = Path(__file__).parent.parent / "docs"
ZEBRAT = [sys.executable, "-c", "import sys; from zebrat_bullet.cli.main import main; sys.exit(main())"]
FLAGS = (
    *("--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync"),
    *("--disable-background-networking", "--disable-component-update", "--window-size=1200,800"),
)
needs_chromium = pytest.mark.skipif(
    not (shutil.which("chromium") and shutil.which("chromedriver")),
    reason="needs Chromium: apt-get install chromium chromium-driver",
)
BRIEF = "task.episode.max_steps=4"
"""A film of few pictures is soon drawn."""
MANIFEST = Manifest(
    trainings={},
    judgements={
        "brief": Judgement(
            drivers=(Driver(method="RL_FT", agent="random", study="paper"),),
            worlds=("track_2",),
            episodes=2,
            options=("--caster", "embree", "--set", BRIEF),
        )
    },
    budgets={},
)
NOTES = "# Why\n\nIt *depends*. <script>alert(1)</script> ![x](http://example.invalid/x.png)\n"


@pytest.fixture(scope="module")
def failure() -> dict[str, Any]:
    """A real drive that runs out of time, as a row of `episodes` with the way it took."""
    task = with_overrides(TaskConfig(), ["lidar.caster=embree", BRIEF.removeprefix("task.")])
    world = load_world("track_2")
    drive = Drive(task, world)
    record = run_episode(drive, load_agent("random", task), 0, 1)
    drive.close()
    start, end = record.pose[0], record.pose[-1]
    return {
        **{"agent": "random", "method": "RL_FT", "setting": "", "study": "paper", "sim": "bullet", "place": "track_2"},
        **{"seed": 0, "episode": 1, "noise": "", "outcome": record.outcome, "duration_s": record.duration_s},
        **{"n_reversals": 1, **dict(zip(("x0", "y0", "yaw0"), start.tolist(), strict=True))},
        **dict(zip(("x1", "y1", "yaw1"), end.tolist(), strict=True)),
        **{"x": record.pose[:64, 0].tolist(), "y": record.pose[:64, 1].tolist()},
    }


@pytest.fixture(scope="module")
def made(failure: dict[str, Any]) -> dict[str, Any]:
    others = [row for row in everyone(2) if (row["method"], row["place"]) != ("RL_FT", "track_2")]
    runs = [run(f"{algo}-{seed}", algo, seed=seed) for algo in ("ddpg", "sac") for seed in range(3)]
    learning = [
        {"run": one["run"], "episode": 20 * i, "total_steps": 900 * i, "best_return": float(np.sin(i))}
        for one in runs
        for i in range(1, 6)
    ]
    collisions = [counts("sr", 900), counts("firect", 700), counts("fifr", 600)]
    rows = [*others, failure]
    return tables(runs=runs, learning=learning, episodes=rows, paths=[failure], collisions=collisions)


@pytest.fixture(scope="module")
def folder(made: dict[str, Any], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The tables and the page of them."""
    folder = tmp_path_factory.mktemp("comparison")
    write_tables(made, folder)
    (folder / "notes.md").write_text(NOTES, encoding="utf-8")
    build_report(folder, folder / "report.html", read_manifest())
    return folder


def test_the_command_writes_the_same_bytes_again(folder):
    again = folder / "again.html"
    command = [*ZEBRAT, "report", "--records", str(folder), "--out", str(again), "--json"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert json.loads(done.stdout)["files"] == 1
    assert again.read_bytes() == (folder / "report.html").read_bytes()


def test_the_committed_report_is_what_its_committed_records_make(tmp_path):
    """Where it is not: `zebrat report --out docs/report.html` makes it anew."""
    (page,) = build_report(DOCS / "results" / "comparison", tmp_path / "report.html", read_manifest())
    assert page.read_bytes() == (DOCS / "report.html").read_bytes(), (
        "make it anew: zebrat report --out docs/report.html"
    )


def test_a_changed_record_changes_the_page(folder, made, tmp_path):
    changed = made["episodes"].to_pylist()
    changed[0]["outcome"] = "collision"
    write_tables(made | {"episodes": tables(episodes=changed)["episodes"]}, tmp_path)
    build_report(tmp_path, tmp_path / "report.html", read_manifest())
    assert (tmp_path / "report.html").read_bytes() != (folder / "report.html").read_bytes()


def test_what_nobody_drove_is_marked_and_not_filled_in(folder):
    page = (folder / "report.html").read_text(encoding="utf-8")
    row = re.search(r"<th scope=\"row\">RL_FOMT</th>(.*?)</tr>", page).group(1)
    first = re.findall(r"<td[^>]*>(.*?)</td>", row)
    assert first[0] == "not driven" and "100 %" in first[1]  # big_track is asked for, track_1 was driven
    assert "0 of 25 runs" not in page and re.search(r"planners and imitators</strong>: \d+ of \d+ cells driven", page)


def test_the_notes_are_included_and_can_fetch_or_run_nothing(folder):
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert "It <em>depends</em>." in page and "<script" not in page and 'src="http' not in page


def test_what_the_notes_say_in_short_stands_at_the_top(made):
    document = make_document(made, read_manifest(), "- It *depends*.\n\n---\n\nOn what, is long.\n")
    assert "- It *depends*." in document.lead and "On what" not in document.lead
    (learned,) = [section for section in document.sections if section.title.startswith("What was learned")]
    assert learned.blocks[0].markdown.strip() == "On what, is long."


def test_the_markdown_says_the_same_and_its_pictures_are_there(folder, tmp_path):
    written = build_report(folder, tmp_path / "report.md", read_manifest())
    text = (tmp_path / "report.md").read_text(encoding="utf-8")
    pictures = re.findall(r"!\[[^\]]*\]\((report_pictures/[^)]+)\)", text)
    assert sorted(tmp_path / name for name in pictures) == sorted(written[1:])
    page = (folder / "report.html").read_text(encoding="utf-8")
    headings = re.findall(r"^#{2,4} (.+)$", text, re.MULTILINE)
    assert len(headings) > 15 and all(f">{escape(heading)}</h" in page for heading in headings)
    links = re.findall(r"\]\(#([^)]+)\)", text)
    named = {re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-") for heading in headings}
    assert links and set(links) <= named


def test_every_replay_command_drives_what_the_record_says(made, failure, tmp_path):
    commands = replay_commands(atlas_section(Evidence(made), MANIFEST))
    assert len(commands) == 1 and BRIEF in commands[0]
    for i, command in enumerate(commands):
        _, *words = shlex.split(command)
        done = subprocess.run(
            [*ZEBRAT, *words, "--json", "--quiet", "--out", str(tmp_path / f"{i}.mp4")], capture_output=True, text=True
        )
        assert done.returncode == 0, done.stderr
        said = json.loads(done.stdout)
        assert (said["outcome"], said["duration_s"]) == (failure["outcome"], failure["duration_s"])
        assert Path(said["video"]).stat().st_size > 10_000


def test_a_group_of_failures_says_what_drives_the_others_again():
    near = [
        row | {"outcome": "stall"}
        for row in everyone(1)
        if row["place"] == "track_2" and row["method"] in ("DWA", "IL")
    ]
    (card,) = (
        card
        for part in atlas_section(Evidence(tables(episodes=near)), read_manifest()).parts
        for block in part.blocks
        if isinstance(block, Cards)
        for card in block.cards
    )
    assert card.title.startswith("2 × stall") and "--agent dwa:inflation_radius_m=0.5 --world track_2" in card.command
    assert "**DWA, radius 0.5**: 1, episodes 0; **IL, 10,049 pairs** (`--agent il --caster embree`): 1" in card.text


def test_what_is_trained_is_counted_against_the_largest_budget():
    asked = asked_runs(read_manifest())
    assert asked["scale", "ppo", "fmt", "margin", "10 million steps"] == 5
    made = run_section(Evidence(tables(runs=[run("a"), run("b", state="partial")])), {}, asked)
    rows = {row[1:3]: row for part in made.parts for block in part.blocks for row in getattr(block, "rows", ())}
    assert rows["ddpg FOMT", "1000 episodes"][3].text == "1 of 8, 1 begun"
    assert rows["ppo FMT, margin", "10 million steps"][3].text == "0 of 5"
    # Five that the largest budget trains, and three that are kept and no budget trains.
    assert asked["paper", "ddpg", "fomt", "", "1000 episodes"] == 8


def test_a_cell_with_fewer_episodes_than_asked_for_says_so():
    manifest = read_manifest()
    runs = [run(f"seed{seed}", seed=seed) for seed in range(2)]
    rows = [row for one in runs for row in episodes("RL_FOMT", "track_2", "ssc", run=one["run"])]
    evidence = Evidence(tables(runs=runs, episodes=rows))
    at = asked_for(manifest, evidence)["paper", "RL_FOMT", "", "", "bullet"]
    assert (at.n_driven, at.n_wanted) == (6, 140) and len(at.cells) - len(at.missing) == 2
    made = run_section(evidence, {("paper", "RL_FOMT", "", "", "bullet"): at}, {})
    assert "2 of 60 cells driven, in worlds with 4% of the episodes" in made.blocks[0].markdown


def test_every_seed_is_shown_in_each_track_and_one_that_has_not_driven_all_has_no_total():
    drives = [row | {"run": "a"} for row in everyone(2) if row["method"] == "RL_FOMT" and row["place"] != "track_8"]
    drives += [row | {"run": "a"} for row in episodes("RL_FOMT", "track_8", "sc", backed_m=0.3)]
    drives += [row | {"run": "b"} for row in episodes("RL_FOMT", "track_1", "ccs")]
    runs = [run("a"), run("b", seed=1)]
    (part,) = ablation_section(Evidence(tables(runs=runs, episodes=drives))).parts
    rows = [tuple(getattr(cell, "text", cell) for cell in row) for row in part.blocks[0].rows]
    assert rows[0] == ("RL_FOMT", "0", "not driven", *["100"] * 7, "50", "6%", "12%")
    assert rows[1] == ("RL_FOMT", "1", "not driven", "33", *["not driven"] * 9)


def test_fine_tuning_stands_beside_what_it_began_with_on_the_same_starts():
    runs, drives = [], []
    for name, outcomes in (("before", "s" * 5 + "c" * 15), ("", "s" * 20), ("cloning", "s" * 4 + "c" * 16)):
        study = {"study": "paper" if name == "before" else "finetuning"}
        runs.append(run(name, **study, variant=name.removeprefix("before")))
        for place in TRACKS:
            drives += episodes("RL_FOMT", place, outcomes, **study, run=name)
    made = finetuning_section(Evidence(tables(runs=runs, episodes=drives)))
    grid = next(block for block in made.blocks if isinstance(block, Grid))
    n_worlds = len(TRACKS) + 1
    by_kind = {row[1].split(",")[1] if "," in row[1] else row[1]: row[4 + n_worlds :] for row in grid.rows}
    before, after, cloning = ([str(getattr(cell, "text", cell)) for cell in row] for row in by_kind.values())
    assert before[0].startswith("40 of 160") and before[1:] == ["", "", ""]
    assert after[:3] == [after[0], "120", "0"] and by_kind[" at the same rates"][3].kind == "good"
    assert cloning[1:3] == ["0", "8"] and by_kind[" drawn to the actions of its replay"][3].kind == "bad"
    assert next(iter(grid.rows))[4] == MISSING  # big_track, which nobody drove
    assert finetuning_section(Evidence(tables(episodes=everyone()))) is None


def test_every_seed_of_a_fine_tuning_has_a_row_with_what_its_own_evaluations_found_on_the_way():
    runs = [run("before"), *(run(f"after{seed}", study="finetuning", seed=seed) for seed in (0, 1))]
    drives = [row for place in TRACKS for row in episodes("RL_FOMT", place, "sc", run="before")]
    for seed, outcomes in ((0, "ss"), (1, "cc")):
        for place in TRACKS:
            drives += episodes("RL_FOMT", place, outcomes, study="finetuning", run=f"after{seed}")
    learning = [
        {"run": "after1", "episode": steps, "total_steps": steps, "success": success}
        for steps, success in ((200, 0.25), (0, 1.0), (100, 0.5), (150, None))
    ]
    made = finetuning_section(Evidence(tables(runs=runs, episodes=drives, learning=learning)))
    grid = next(block for block in made.blocks if isinstance(block, Grid))
    rows = [tuple(str(getattr(cell, "text", cell)) for cell in row) for row in grid.rows]
    assert [row[2:4] for row in rows] == [("", ""), ("0", "-"), ("1", "38, 25")]
    assert [row[-3:-1] for row in rows] == [("", ""), ("8", "0"), ("0", "8")]


def test_what_a_fine_tuning_began_with_is_shown_on_the_starts_that_were_driven_after_it_alone():
    runs = [run("before"), run("after", study="finetuning")]
    drives = [row for place in TRACKS for row in episodes("RL_FOMT", place, "s" * 5 + "c" * 15, run="before")]
    drives += [row for place in TRACKS for row in episodes("RL_FOMT", place, "s" * 10, study="finetuning", run="after")]
    made = finetuning_section(Evidence(tables(runs=runs, episodes=drives)))
    before, after = (row[-4].text for row in next(b for b in made.blocks if isinstance(b, Grid)).rows)
    assert before.startswith("40 of 80") and after.startswith("80 of 80")


def test_a_fine_tuning_whose_beginning_nobody_drove_is_compared_with_nothing():
    after = run("after", study="finetuning")
    rows = episodes("RL_FOMT", "track_1", "sc", study="finetuning", run="after")
    made = finetuning_section(Evidence(tables(runs=[after], episodes=rows)))
    (row,) = next(block for block in made.blocks if isinstance(block, Grid)).rows
    assert row[0] == "RL_FOMT" and row[-4:] == (MISSING,) * 4  # nor has it driven every track


def test_longer_runs_stand_by_length_with_a_curve_of_their_own_and_what_they_do_on_held_out_tracks():
    def longer(name: str, asked: str, steps: int, **more: Any) -> dict[str, Any]:
        return run(name, study="paper-at-scale", asked=asked, steps=steps, **more)

    runs = [longer("a", "10 million steps", 10**7, best_success=0.9), longer("b", "0.1 million steps", 10**5)]
    runs.append(longer("c", "0.1 million steps", 10**5, seed=1, best_success=0.3, best_collision=0.3))
    learning = [
        {"run": one["run"], "episode": 9, "total_steps": one["steps"] // 2, "success": one["best_success"]}
        for one in runs
    ]
    # What stands last in time, not in the table, is the last evaluation; a row without one is none.
    learning.insert(0, {"run": "b", "episode": 19, "total_steps": 10**5, "success": 0.1})
    learning.append({"run": "b", "episode": 29, "total_steps": 2 * 10**5, "best_return": 1.0})
    on_track = {"study": "paper-at-scale", "family": "corners", "reversals": 0, "sim": "planar"}
    drives = [
        row | on_track | {"run": name}
        for name, outcomes in (("b", "sscf"), ("c", "cccf"))
        for row in episodes("RL_FOMT", "corners", outcomes)
    ]
    made = scale_section(Evidence(tables(runs=runs, learning=learning, episodes=drives)))
    (part,) = (part for part in made.parts if part.title == "The paper's algorithms, longer")
    *curves, grid, apart = part.blocks
    assert [at.name for at in curves] == ["curve_longer_1", "curve_longer_2"]
    assert apart.rows == ()
    assert b"DDPG FOMT, 2 seeds" in curves[0].data and b"DDPG FOMT, 1 seed<" in curves[1].data
    rows = [tuple(getattr(cell, "text", cell) for cell in row) for row in grid.rows]
    short = ("2 of 2", "40 % (30-50)", "15 % (0-30)", "20 % (10-30)", "not driven", "25 % (0-50)", "50 % (25-75)")
    assert rows == [
        ("DDPG FOMT", "0.1 million steps", *short),
        ("DDPG FOMT", "10 million steps", "1 of 1", "90 %", "0 %", "90 %", *["not driven"] * 3),
    ]


def test_sets_of_one_length_that_differ_in_one_thing_are_held_against_each_other_by_best_and_last_evaluations():
    def three(algorithm: str, reward: str, *successes: float, **more: Any) -> list[dict[str, Any]]:
        named = {"algorithm": algorithm, "reward": reward, "study": "paper-at-scale", "asked": "1 step", "steps": 1}
        of_seeds = [{"seed": seed, "best_success": success, **named} for seed, success in enumerate(successes)]
        return [
            run(f"{algorithm} {reward} {of['seed']}", best_collision=0.1 * (reward == "ft"), **of, **more)
            for of in of_seeds
        ]

    runs = [
        *three("ddpg", "ft", 0.1, 0.2, 0.3),
        *three("ddpg", "fomt", 0.7, 0.8, 0.9),
        *three("sac", "fomt", 0.5, 0.5, 0.8),
    ]
    runs += three("sac", "ft", 0.1, 0.2) + three("sac", "ft", 0.9, state="partial")
    learning = [{"run": one["run"], "total_steps": 1, "success": one["best_success"] / 2} for one in runs]
    made = scale_section(Evidence(tables(runs=runs, learning=learning)))
    (part,) = (part for part in made.parts if part.title == "The paper's algorithms, longer")
    rows = [tuple(getattr(cell, "text", cell) for cell in row) for row in part.blocks[-1].rows]
    # Welch's interval of two times three values 0.1 apart: 2.776 x sqrt(2 x 0.01 / 3); of values all alike none.
    few = ("too few seeds",) * 3
    assert rows == [
        ("DDPG FOMT - DDPG FT", "1 step", "+60.0 (+37.3 to +82.7)", "+30.0 (+18.7 to +41.3)", "-10.0"),
        ("SAC FOMT - SAC FT", "1 step", *few),
        ("DDPG FOMT - SAC FOMT", "1 step", "+20.0 (-15.5 to +55.5)", "+10.0 (-7.7 to +27.7)", "+0.0"),
        ("DDPG FT - SAC FT", "1 step", *few),
    ]


def test_an_interval_of_points_ends_at_a_hundred():
    assert points([0.0, 1.0, 1.0], [0.0, 0.0, 1.0]) == "+33.3 (-97.5 to +100.0)"
    assert points([0.0, 0.0, 1.0], [0.0, 1.0, 1.0]) == "-33.3 (-100.0 to +97.5)"
    assert points([0.5] * 3, [0.25] * 3) == "+25.0"
    assert points([0.5] * 2, [0.25] * 3) == "too few seeds"


def test_another_ending_or_a_missing_table_is_refused(folder, tmp_path):
    with pytest.raises(ConfigError, match=r"\.html or \.md; got 'report.pdf'"):
        build_report(folder, tmp_path / "report.pdf", read_manifest())
    with pytest.raises(ConfigError, match="no such file"):
        build_report(tmp_path, tmp_path / "report.html", read_manifest())


@pytest.fixture(scope="module")
def chromium(tmp_path_factory: pytest.TempPathFactory) -> Iterator[webdriver.Chrome]:
    options = webdriver.ChromeOptions()
    options.binary_location = shutil.which("chromium")
    for flag in (*FLAGS, f"--user-data-dir={tmp_path_factory.mktemp('chromium')}"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    browser = webdriver.Chrome(options, webdriver.ChromeService(shutil.which("chromedriver")))
    yield browser
    browser.quit()


@needs_chromium
@pytest.mark.parametrize("width", [360, 1200])
def test_the_page_needs_nothing_else_in_a_browser(chromium, folder, width):
    metrics = {"width": width, "height": 800, "deviceScaleFactor": 1, "mobile": width < 500}
    chromium.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
    chromium.get("about:blank")
    chromium.get_log("performance")
    url = (folder / "report.html").as_uri()
    chromium.get(url)
    chromium.execute_script("document.querySelectorAll('details').forEach(each => { each.open = true; })")
    seen = "return [...document.images].map(at => [at.alt, at.complete && at.naturalWidth > 0, at.clientWidth > 50])"
    images = chromium.execute_script(seen)
    assert len(images) >= 8 and all(alt and there and shown for alt, there, shown in images), images
    assert chromium.execute_script("return document.documentElement.scrollWidth") <= width
    assert [entry for entry in chromium.get_log("browser") if entry["level"] == "SEVERE"] == []
    sent = [json.loads(entry["message"])["message"] for entry in chromium.get_log("performance")]
    asked = {at["params"]["request"]["url"] for at in sent if at["method"] == "Network.requestWillBeSent"}
    assert {address for address in asked if not address.startswith("data:")} == {url}
    links = (
        "return [...document.querySelectorAll('nav a')].filter(a => !document.getElementById(a.hash.slice(1))).length"
    )
    assert chromium.execute_script(links) == 0
