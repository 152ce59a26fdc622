"""Held-out sets: seeds that give the certified tracks again, made the same after a kill, and what is judged on them."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from zebrat_bullet.assets import find_asset, list_assets
from zebrat_bullet.cli import main
from zebrat_bullet.config import LidarConfig, TaskConfig
from zebrat_bullet.errors import AssetError, ConfigError, PolicyError, ZebratError
from zebrat_bullet.evaluation.endings import Endings
from zebrat_bullet.evaluation.generated import tracks_score
from zebrat_bullet.evaluation.held_out import SetJudgement, _score, judge_set
from zebrat_bullet.evaluation.make_set import Recipe, make_set
from zebrat_bullet.evaluation.set_episodes import load_set_episodes, save_set_episodes, set_episodes
from zebrat_bullet.evaluation.track_set import FOLDER, SetTrack, TrackSet, draw_set, read_set
from zebrat_bullet.planning.certify import certify
from zebrat_bullet.report.held_out import set_table
from zebrat_bullet.robot import load_robot
from zebrat_bullet.world import HELD_OUT_SEED, generate_track
from zebrat_bullet.world.fingerprint import fingerprint

TASK = TaskConfig(lidar=LidarConfig(caster="embree"))
RECIPE = Recipe(name="corners", n_tracks=4)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("sets")


@pytest.fixture(scope="module")
def made(folder: Path) -> TrackSet:
    return make_set(RECIPE, folder)[0]


def test_a_set_holds_certified_tracks_of_held_out_seeds_and_draws_them_again(folder: Path, made: TrackSet) -> None:
    again = read_set(str(folder / "corners.json"))
    assert again == made and len(made.tracks) == 4
    robot = load_robot("zebrat")
    for track, world in zip(made.tracks, draw_set(again), strict=True):
        assert track.seed >= HELD_OUT_SEED and world.name == f"corners-{track.seed}"
        assert track.difficulty == world.difficulty
        certificate = certify(world, robot)
        assert (track.reversals, track.length_m) == (certificate.n_reversals, certificate.length_m)
        assert track.least_time_s == certificate.least_time_s > 0


def test_a_set_made_after_a_kill_is_the_same_and_candidates_are_not_certified_again(
    folder: Path, made: TrackSet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = (folder / "candidates" / "zebrat" / "corners.csv").read_bytes()
    table = tmp_path / "candidates" / "zebrat" / "corners.csv"
    table.parent.mkdir(parents=True)
    table.write_bytes(whole[: len(whole) // 2])  # within a row
    assert make_set(RECIPE, tmp_path)[0] == made and table.read_bytes() == whole
    assert (tmp_path / "corners.json").read_bytes() == (folder / "corners.json").read_bytes()

    def refuse(*arguments: object, **named: object) -> None:
        raise AssertionError("certified again")

    monkeypatch.setattr("zebrat_bullet.evaluation.make_set.certify_all", refuse)
    assert make_set(RECIPE, tmp_path)[0] == made


def test_a_set_by_reversals_takes_none_else_and_says_where_there_are_too_few(folder: Path, made: TrackSet) -> None:
    recipe = Recipe(name="reversals-0", n_tracks=3, families=("corners",), most_seeds=32)
    assert {track.reversals for track in make_set(recipe, folder)[0].tracks} == {0}
    with pytest.raises(ConfigError, match="only 0 of 3 tracks among 32 of corners; allow more seeds"):
        make_set(replace(recipe, name="reversals-40"), folder)
    with pytest.raises(ConfigError, match="no set 'reversal-1' can be made; name a family"):
        Recipe(name="reversal-1", n_tracks=1)


def test_a_set_whose_seeds_give_other_tracks_is_refused(made: TrackSet) -> None:
    other = replace(made.tracks[0], seed=made.tracks[0].seed + 5_000)
    with pytest.raises(ConfigError, match="the generator has changed"):
        draw_set(replace(made, tracks=(other, *made.tracks[1:])))
    with pytest.raises(ConfigError, match=f"1 of 2, the first of seed {other.seed}"):
        draw_set(
            replace(made, tracks=(*made.tracks[:3], other)), only=[1, 3]
        )  # the hash of the whole tells nothing here


def test_a_part_of_a_set_is_those_tracks_in_their_order(made: TrackSet) -> None:
    whole, part = draw_set(made), draw_set(made, only=[3, 1])
    assert [fingerprint(world) for world in part] == [fingerprint(whole[i]) for i in (3, 1)]


def test_a_fingerprint_is_of_the_geometry_alone() -> None:
    one, same = (generate_track(np.random.default_rng(3), name=name) for name in ("one", "other"))
    assert fingerprint(one) == fingerprint(same)
    moved = replace(one, start=replace(one.start, range_y_m=one.start.range_y_m + 1e-4))
    assert fingerprint(moved) != fingerprint(one)


def test_what_is_no_set_is_refused(tmp_path: Path) -> None:
    (tmp_path / "x.json").write_text("{}", encoding="utf-8")
    with pytest.raises(ConfigError, match="is not a set of tracks"):
        read_set(str(tmp_path / "x.json"))
    with pytest.raises(AssetError, match="no worlds/sets named 'nowhere'"):
        read_set("nowhere")


@pytest.mark.parametrize("name", list_assets(FOLDER, ".json"))
def test_shipped_sets_hold_each_track_once(name: str) -> None:
    tracks = read_set(name)
    assert len({(track.family, track.seed) for track in tracks.tracks}) == len(tracks.tracks)
    assert all(track.seed >= HELD_OUT_SEED and track.clearance_m > 0 for track in tracks.tracks)


def test_scores_are_those_counted_by_hand() -> None:
    facts = [
        SetTrack(
            family="corners",
            seed=i,
            difficulty=d,
            reversals=r,
            clearance_m=c,
            length_m=9.0,
            least_time_s=10.0,
            fingerprint="",
        )
        for i, (d, r, c) in enumerate([(0.1, 0, 0.1), (0.15, 2, 0.008), (1.0, 2, 0.0079), (0.5, 9, 0.03)])
    ]
    outcome = np.array([[1, 1], [1, 2], [2, 2], [5, 1]], dtype=np.int8)
    tracks = TrackSet(name="s", robot="zebrat", sha256="0" * 64, tracks=tuple(facts))
    how = SetJudgement(episodes=2, task=TASK)
    n_reversals = np.array([[0, 3], [1, 2], [0, 4], [0, 2]])
    backed_m = np.array([[0.0, 0.05], [0.06, 1.0], [0.0, 2.0], [0.0, 0.049]])  # the last but as its commands say
    score = _score(tracks, facts, how, Endings(outcome, np.full((4, 2), 12.0), n_reversals, backed_m))
    assert score.overall.success == 0.5 and score.overall.by_track == (2, 1, 0, 1) and score.over_least == 1.2
    assert score.overall.causes["collision"] == 3 and score.overall.causes["stall"] == 1
    assert {name: (at.tracks, at.success) for name, at in score.by_difficulty.items()} == {
        "0.0-0.2": (2, 0.75), "0.4-0.6": (1, 0.5), "0.8-1.0": (1, 0.0),
    }  # fmt: skip
    assert {name: (at.tracks, at.success) for name, at in score.by_reversals.items()} == {
        "0": (1, 1.0), "2": (2, 0.25), "6+": (1, 0.5),
    }  # fmt: skip
    assert {name: at.backing for name, at in score.by_reversals.items()} == {"0": 0.5, "2": 0.75, "6+": 0.0}
    assert {name: (at.tracks, at.success) for name, at in score.by_clearance.items()} == {
        "from 30 mm": (2, 0.75), "8 to 30 mm": (1, 0.5), "under 8 mm": (1, 0.0),
    }  # fmt: skip
    told = set_table({"a": score})
    assert "| 0.0-0.2 | 2 | 75.0% (" in told and "| 2 | 2 | 75.0% |" in told


def test_the_worst_tenth_is_of_the_tracks() -> None:
    outcome = np.ones((20, 4), dtype=np.int8)
    outcome[3], outcome[7, :2] = 2, 2
    score = tracks_score(Endings(outcome, np.ones((20, 4)), np.zeros((20, 4), np.int64), np.zeros((20, 4))))
    assert score.worst_tenth == 0.25 and score.worst_tenth_ci[0] <= 0.25 <= score.worst_tenth_ci[1]


def test_policies_drive_a_set_on_planar_cars_and_any_agent_a_sample_of_it_in_bullet(made: TrackSet) -> None:
    how = SetJudgement(episodes=2, task=TASK)
    planar = judge_set(["shipped"], made, how)["shipped"]
    assert (
        planar.overall.tracks == 4
        and planar.overall.success > 0.5
        and planar.seeds == tuple(t.seed for t in made.tracks)
    )
    sample = replace(how, sim="bullet", n_tracks=2, episodes=1)
    bullet = judge_set(["random", "shipped"], made, sample)
    assert bullet["random"].seeds == bullet["shipped"].seeds and len(bullet["shipped"].seeds) == 2
    assert bullet["random"].overall.success == 0.0 < bullet["shipped"].overall.success
    with pytest.raises(PolicyError, match="'random' is none; drive it in PyBullet: --sim bullet"):
        judge_set(["shipped", "random"], made, how)
    with pytest.raises(ConfigError, match="has 4 tracks, asked for 5"):
        judge_set(["shipped"], made, replace(how, n_tracks=5))
    with pytest.raises(ConfigError, match="is for 'zebrat', not 'long'"):
        judge_set(["random"], made, replace(sample, task=replace(TASK, robot="long")))


def test_the_command_line_judges_on_a_set(
    folder: Path, made: TrackSet, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = str(folder / "corners.json")
    asked = ["evaluate", "--agent", "shipped", "--set", path, "--episodes", "2", "--workers", "1", "--quiet", "--json"]
    assert main([*asked, "--out", str(tmp_path)]) == 0
    answer = json.loads(capfd.readouterr().out)
    assert answer["shipped"]["sha256"] == made.sha256 and answer["shipped"]["overall"]["tracks"] == 4
    assert json.loads((tmp_path / "scores.json").read_text(encoding="utf-8")) == answer
    assert "corners (" in (tmp_path / "table.md").read_text(encoding="utf-8")


def test_every_episode_on_a_set_is_kept_with_the_facts_of_its_track(
    folder: Path, made: TrackSet, tmp_path: Path
) -> None:
    twin = tmp_path / "other" / "shipped.safetensors"
    twin.parent.mkdir()
    twin.write_bytes(find_asset("policies", "shipped", ".safetensors").read_bytes())
    agents = ["shipped", str(twin)]  # of the same name as files
    asked = ["evaluate", "--agent", *agents, "--set", str(folder / f"{made.name}.json"), "--episodes", "2", "--quiet"]
    assert main([*asked, "--workers", "1", "--out", str(tmp_path / "out")]) == 0
    kept = [load_set_episodes(path) for path in sorted((tmp_path / "out").glob("episodes-*.npz"))]
    assert {at.agent for at in kept} == set(agents)
    scores = json.loads((tmp_path / "out" / "scores.json").read_text(encoding="utf-8"))
    for at in kept:
        assert at.outcome.shape == at.time_s.shape == at.n_reversals.shape == at.backed_m.shape == (len(made.tracks), 2)
        assert (at.outcome == "success").sum(axis=1).tolist() == scores[at.agent]["overall"]["by_track"]
        facts = list(zip(at.family, at.track_seed, at.difficulty, at.reversals, strict=True))
        assert facts == [(track.family, track.seed, track.difficulty, track.reversals) for track in made.tracks]
        assert at.set == made.name and at.sim == "planar"


def test_episodes_that_do_not_fit_together_are_refused_by_name(tmp_path: Path) -> None:
    tracks = [
        SetTrack(
            family="corners",
            seed=HELD_OUT_SEED,
            difficulty=0.5,
            reversals=0,
            clearance_m=0.1,
            length_m=9.0,
            least_time_s=15.0,
            fingerprint="",
        )
    ]
    endings = Endings(np.array([[1, 2]], np.int8), np.array([[15.2, 8.0]]), np.array([[0, 3]]), np.array([[0.0, 0.7]]))
    whole = set_episodes("shipped", "corners", "planar", 0, tracks, endings)
    save_set_episodes(replace(whole, time_s=np.zeros((1, 3))), tmp_path / "bad.npz")
    with pytest.raises(ZebratError, match=r"bad\.npz: holds no episodes of a set .*time_s"):
        load_set_episodes(tmp_path / "bad.npz")
    save_set_episodes(whole, tmp_path / "good.npz")
    kept = load_set_episodes(tmp_path / "good.npz")
    assert kept.n_reversals.tolist() == [[0, 3]] and kept.backed_m.tolist() == [[0.0, 0.7]]
