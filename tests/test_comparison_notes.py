"""What the committed notes say in numbers is what the committed tables say: what their conclusions rest on."""

from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from zebrat_bullet.comparison.tables import read_tables
from zebrat_bullet.report.comparison.evidence import (
    TRACKS,
    UNSEEN,
    Drive,
    Evidence,
    backed_out,
    backed_up,
    collided,
    rate,
)
from zebrat_bullet.report.comparison.shares import compare, share
from zebrat_bullet.report.comparison.statistics import Difference, seeds_difference

RECORDS = Path(__file__).parents[1] / "docs" / "results" / "comparison"
FEATURES = ("track_4", "track_8")


@pytest.fixture(scope="module")
def evidence() -> Evidence:
    return Evidence(read_tables(RECORDS))


@pytest.fixture(scope="module")
def notes() -> str:
    return " ".join((RECORDS / "notes.md").read_text(encoding="utf-8").split())


def span(by: Difference) -> str:
    """Return an interval in points, as the notes have it."""
    return f"{100 * by.low:.0f} to {100 * min(by.high, 1.0):.0f}"


def apart(evidence: Evidence, a: str, b: str, places: tuple[str, ...]) -> Difference:
    compared = compare(evidence, "paper", a, b, places)
    assert compared is not None
    return compared.difference


def drives(evidence: Evidence, method: str, places: tuple[str, ...] = TRACKS) -> list[Drive]:
    return [drive for place in places for drive in evidence.drives_of("paper", method, place)]


def percent(evidence: Evidence, method: str, what: Callable[[Drive], bool]) -> float:
    return 100 * rate(drives(evidence, method), what).share


def test_what_the_rewards_do_at_the_papers_budget(evidence: Evidence, notes: str) -> None:
    o = apart(evidence, "RL_FOT", "RL_FT", TRACKS)
    both, m = apart(evidence, "RL_FOMT", "RL_FT", TRACKS), apart(evidence, "RL_FOMT", "RL_FOT", TRACKS)
    assert f"O adds {100 * o.value:.0f} points to F T ({span(o)}" in notes
    assert f"O and M together {100 * both.value:.0f} ({span(both)})" in notes
    assert f"is not decided ({100 * m.value:.0f}, {span(m)})" in notes
    here = apart(evidence, "RL_FOT", "RL_FT", FEATURES)
    assert f"{100 * here.value:.0f} in Tracks 4 and 8 ({span(here)})" in notes
    for method, said in (("RL_FOMT", "5 to 60"), ("RL_FOT", "9 to 28"), ("RL_FT", "0 to 12"), ("RL_WG", "0 to 32")):
        of_runs = evidence.seeds("paper", method, TRACKS)
        assert said == f"{100 * min(of_runs):.0f} to {100 * max(of_runs):.0f}"
    assert "in 5 to 60 % of the episodes, F O T in 9 to 28, F T in 0 to 12, waypoint guidance in 0 to 32" in notes


def test_who_backs_up_and_who_touches_at_the_papers_budget(evidence: Evidence, notes: str) -> None:
    assert rate(drives(evidence, "RL_FOMT"), backed_up).k == 0 and "in none of 2,800 drives" in notes
    shares = [percent(evidence, f"RL_{name}", backed_up) for name in ("FT", "WG", "FOT")]
    said = "F T does it in {:.0f} % of its drives, waypoint guidance in {:.1f}, F O T in {:.1f},".format(*shares)
    assert said in notes
    out = [rate(drives(evidence, f"RL_{name}"), backed_out).k for name in ("WG", "FT", "FOT")]
    assert "in {} of 2,800 drives of waypoint guidance".format(*out) in notes
    assert f"{out[1]} of F T, {out[2]} of F O T." in notes
    for name, said in (("FOT", "504, 330, 433, 336 and 412"), ("FT", "369, 448, 542, 295 and 440")):
        of_runs = evidence.of_seeds("paper", f"RL_{name}", TRACKS)
        counted = [rate([d for of in at.values() for d in of], collided).k for at in of_runs]
        assert "{}, {}, {}, {} and {}".format(*counted) == said and said in notes


def test_imitation_beside_f_o_m_t_where_neither_learned(evidence: Evidence, notes: str) -> None:
    def left(method: str, places: tuple[str, ...]) -> float:
        found = share(evidence, "paper", method, places)
        assert found is not None
        return 100 * (1 - found.value)

    seen = TRACKS[:3]
    il, ours = ([left(method, places) for places in (UNSEEN, seen)] for method in ("IL", "RL_FOMT"))
    said = "({:.0f} % of Tracks 4 to 8 not left, {:.0f} % of Tracks 1 to 3; of F O M T, beside it, {:.0f} and {:.0f} %)"
    assert said.format(*il, *ours) in notes


def test_planners_touch_where_their_pose_is_wrong(evidence: Evidence, notes: str) -> None:
    touched: dict[tuple[str, bool], int] = defaultdict(int)
    for drive in evidence.drives:
        known = drive.setting in ("radius 0.3", "radius 0.5") and drive.place in TRACKS
        if known and drive.method in ("DWA", "TEB"):
            touched[drive.setting, bool(drive.noise)] += collided(drive)
    wrong = touched["radius 0.3", True], touched["radius 0.5", True]
    assert "in {} of 240 episodes at 0.3 m and {} at 0.5".format(*wrong) in notes
    assert touched["radius 0.3", False] == touched["radius 0.5", False] == 0 and "they touch in none" in notes


def test_what_longer_runs_of_ddpg_and_sac_reach(evidence: Evidence, notes: str) -> None:
    best: dict[tuple[str, str], list[list[float]]] = {}
    for algorithm in ("ddpg", "sac"):
        for reward in ("fomt", "ft"):
            best[algorithm, reward] = [
                [
                    run["best_success"]
                    for run in evidence.runs
                    if (run["study"], run["algorithm"], run["reward"], run["variant"] or "", run["asked"])
                    == ("paper-at-scale", algorithm, reward, "", asked)
                ]
                for asked in ("0.1 million steps", "1 million steps", "10 million steps")
            ]
    means = {key: [100 * float(np.mean(of)) for of in lengths] for key, lengths in best.items()}
    assert "under F O M T, and {:.0f}, {:.0f} and {:.0f} % under F T".format(*means["ddpg", "ft"]) in notes
    assert "leaves {:.0f}, {:.0f} and {:.0f} % of the 500".format(*means["ddpg", "fomt"]) in notes
    sac = (*means["sac", "fomt"], *means["sac", "ft"])
    assert "SAC leaves {:.0f}, {:.0f} and {:.0f} % and {:.0f}, {:.0f} and {:.0f} %".format(*sac) in notes
    by = [seeds_difference(one, two) for one, two in zip(best["ddpg", "fomt"], best["ddpg", "ft"], strict=True)]
    said = [f"{100 * at.value:.0f} points apart ({span(at)})" if i == 0 else f"{100 * at.value:.0f} ({span(at)})"
            for i, at in enumerate(by)]  # fmt: skip
    assert ", ".join(said) in notes


def test_what_is_left_and_backed_out_of_on_held_out_tracks(evidence: Evidence, notes: str) -> None:
    plain = {name: evidence.on_sets(f"RL_{name}", ("uneven",), "success") for name in ("FT", "FMT", "FOT")}
    m, o = (seeds_difference(plain[name], plain["FT"]) for name in ("FMT", "FOT"))
    assert f"M alone adds {100 * m.value:.0f} points to F T (95 % interval {span(m)})" in notes
    assert f"O alone {100 * o.value:.0f} ({span(o)})" in notes
    backing: dict[str, list[int]] = defaultdict(lambda: [0, 0, 0])
    for row in evidence.held_out:
        if row["family"] == "deadends" and row["study"] == "scale" and evidence.variant(row["run"]) == "crash":
            at = backing[row["run"]]
            at[0] += row["n"]
            at[1] += row["n"] if row["backed"] else 0
            at[2] += row["n"] if row["outcome"] == "success" else 0
    counted: list[Any] = [at[1] for at in backing.values()]
    assert len(counted) == 20 and f"{min(counted)} to {max(counted)} of 200 dead ends" in notes
    assert f"in {min(counted) / 2:.0f} to {max(counted) / 2:.0f} % of their drives" in notes
    assert f"({sum(at[2] for at in backing.values())} of 4,000)" in notes
